//! What the culler lists, against every tree tested on its own; stamps, prefetch and cost.

use super::*;
use crate::scene::GroupId;
use crate::testing::scenes::{overlapping_groups, quadtree, regular_grid};
use crate::testing::{Random, box_meets_pyramid, random_camera};
use glam::{DVec3, dvec3};

#[test]
fn lists_what_meets_the_frustum_and_prefetches_by_margin() {
    let mut random = Random::new(13);
    let mut builder = SceneGraph::builder();
    quadtree(&mut random, &mut builder);
    let scene = builder.finish();
    let mut culler = Culler::new();
    culler.set_prefetch_margin(6.0);
    let mut extra = 0;
    for frame in 0..300u64 {
        let camera = random_camera(&mut random, 15.0);
        let result = culler.cull(&scene, &camera, frame).clone();
        let distance = |bounds: &Aabb| bounds.distance_to_point(camera.eye);
        for (tree, bounds) in scene.trees() {
            let listed = result.visible.iter().find(|v| v.tree == tree);
            let soon = result.soon_visible.iter().find(|v| v.tree == tree);
            if let Some(listed) = listed {
                assert_eq!((listed.bounds, listed.distance), (bounds, distance(&bounds)));
                assert_eq!(culler.last_access(tree), Some(frame));
                extra += usize::from(!box_meets_pyramid(&bounds, &camera));
            } else {
                assert!(
                    !box_meets_pyramid(&bounds, &camera),
                    "{tree:?} is missing from frame {frame}"
                );
                assert_ne!(culler.last_access(tree), Some(frame));
            }
            assert_eq!(soon.is_some(), listed.is_none() && distance(&bounds) < 6.0);
        }
        assert!(result.soon_visible.is_sorted_by(|a, b| a.distance <= b.distance));
        assert_eq!(
            culler.cull(&scene, &camera, frame),
            &result,
            "culling twice changes nothing"
        );
    }
    assert!(extra < 10, "{extra} trees listed for nothing");
}

#[test]
fn what_throws_a_shadow_into_view_is_listed() {
    let mut random = Random::new(29);
    let mut builder = SceneGraph::builder();
    quadtree(&mut random, &mut builder);
    let scene = builder.finish();
    let floor = scene.bounds().unwrap().min.z;
    let (mut culler, mut shadowing) = (Culler::new(), 0);
    for frame in 0..300u64 {
        let camera = random_camera(&mut random, 15.0);
        let up = 0.1 + 0.9 * random.unit();
        let sun = dvec3(random.unit() - 0.5, random.unit() - 0.5, up).normalize();
        culler.set_shadows(Some(sun));
        let visible = culler.cull(&scene, &camera, frame).visible.clone();
        for (tree, bounds) in scene.trees() {
            // The shadow, cut into boxes.
            let length = (bounds.max.z - floor) / sun.z;
            let falls = (0..=32).any(|k| {
                let fall = -sun * (length * f64::from(k) / 32.0);
                let shadow = Aabb::new(bounds.min + fall, bounds.max + fall).unwrap();
                box_meets_pyramid(&shadow, &camera)
            });
            let is_listed = visible.iter().any(|v| v.tree == tree);
            assert!(is_listed || !falls, "{tree:?} is missing from frame {frame}");
            shadowing += u32::from(falls && !box_meets_pyramid(&bounds, &camera));
        }
    }
    assert!(shadowing > 100, "{shadowing} shadows from out of view");
}

#[test]
fn stamps_are_those_of_visible_frames_only() {
    let mut builder = SceneGraph::builder();
    regular_grid(&mut builder);
    let flat = Aabb::new(dvec3(0.0, 0.0, 50.0), dvec3(9.0, 9.0, 50.0)).unwrap();
    builder.add_tree(None, TreeId(60), flat).unwrap();
    let scene = builder.finish();
    let mut culler = Culler::new();
    assert_eq!(culler.last_access(TreeId(0)), None);
    let towards = Camera::look_at(DVec3::splat(-20.0), DVec3::splat(8.0), 90.0, 64, 64).unwrap();
    let away = Camera::look_at(DVec3::splat(-20.0), DVec3::splat(-40.0), 90.0, 64, 64).unwrap();
    assert_eq!(culler.cull(&scene, &towards, 3).visible.len(), 48);
    let behind = culler.cull(&scene, &away, 4);
    assert_eq!(
        (behind.visible.len(), behind.groups_culled, behind.trees_culled),
        (0, 1, 0)
    );
    assert_eq!(culler.last_access(TreeId(0)), Some(3));
    // A box without volume holds nothing to see, and an unknown tree was never seen.
    assert_eq!(culler.last_access(TreeId(60)), None);
    assert_eq!(culler.last_access(TreeId(1 << 20)), None);
}

#[test]
fn far_from_the_origin_the_list_is_the_same() {
    let mut seed = 14;
    let mut lists = Vec::new();
    for offset in [0.0, 1e3, 1e6, 1e9] {
        let mut builder = SceneGraph::builder();
        quadtree(&mut Random::new(seed), &mut builder);
        let mut shifted = SceneGraph::builder();
        for (tree, bounds) in builder.finish().trees() {
            let bounds = Aabb::new(bounds.min + offset, bounds.max + offset).unwrap();
            shifted.add_tree(None, tree, bounds).unwrap();
        }
        let scene = shifted.finish();
        let eye = dvec3(-10.25, 3.5, 6.75) + offset;
        let camera = Camera::look_at(eye, DVec3::splat(offset), 60.0, 320, 240).unwrap();
        let mut culler = Culler::new();
        let result = culler.cull(&scene, &camera, 0);
        lists.push(
            result
                .visible
                .iter()
                .map(|v| (v.tree, v.distance))
                .collect::<Vec<_>>(),
        );
        seed = 14;
    }
    assert!(lists[0].len() > 20);
    assert!(lists.iter().all(|list| *list == lists[0]));
}

#[test]
fn steady_state_allocates_nothing() {
    let mut random = Random::new(15);
    let mut builder = SceneGraph::builder();
    overlapping_groups(&mut random, &mut builder);
    let scene = builder.finish();
    let mut culler = Culler::new();
    culler.set_prefetch_margin(10.0);
    let spin = |culler: &mut Culler| {
        for step in 0..90 {
            let angle = f64::from(step) * 0.07;
            let target = dvec3(angle.cos(), angle.sin(), -0.1);
            let camera = Camera::look_at(DVec3::ZERO, target, 70.0, 640, 360).unwrap();
            culler.cull(&scene, &camera, step as u64);
        }
        (
            culler.capacity(),
            culler.result.visible.as_ptr(),
            culler.stack.as_ptr(),
            culler.children.as_ptr(),
        )
    };
    let warm = spin(&mut culler);
    assert!(warm.0 > 0);
    assert_eq!(spin(&mut culler), warm);
}

#[test]
fn work_follows_the_view_and_not_the_terrain() {
    let mut visited = Vec::new();
    for levels in [5, 7, 9] {
        let mut builder = SceneGraph::builder();
        let side = f64::from(1 << levels);
        let mut cells = vec![(GroupId::ROOT, -side / 2.0, -side / 2.0, side)];
        let mut next = 0;
        while let Some((group, x, y, size)) = cells.pop() {
            if size == 1.0 {
                let min = dvec3(x, y, 0.0);
                builder
                    .add_tree(Some(group), TreeId(next), Aabb::new(min, min + 1.0).unwrap())
                    .unwrap();
                next += 1;
                continue;
            }
            let half = size / 2.0;
            for (dx, dy) in [(0.0, 0.0), (half, 0.0), (0.0, half), (half, half)] {
                cells.push((builder.add_group(Some(group)).unwrap(), x + dx, y + dy, half));
            }
        }
        let scene = builder.finish();
        let camera = Camera::look_at(dvec3(0.3, 0.4, 8.0), dvec3(1.3, 1.4, 0.0), 60.0, 640, 360).unwrap();
        let mut culler = Culler::new();
        let result = culler.cull(&scene, &camera, 0);
        assert!(result.order_exact && result.visible.len() > 100);
        visited.push((result.visible.len(), result.groups_visited));
    }
    // Two levels more of nesting above what is seen, and no more.
    assert_eq!(visited[0].0, visited[2].0);
    assert!(visited[2].1 <= visited[0].1 + 16, "{visited:?}");
}

#[test]
fn what_is_too_small_is_left_out_and_nothing_else() {
    let mut random = Random::new(17);
    let mut builder = SceneGraph::builder();
    quadtree(&mut random, &mut builder);
    let scene = builder.finish();
    let (mut culler, mut all) = (Culler::new(), Culler::new());
    culler.set_smallest_feature(40.0);
    let mut left_out = 0;
    for frame in 0..200 {
        let camera = random_camera(&mut random, 60.0);
        let seen = culler.cull(&scene, &camera, frame).clone();
        let width = 40.0 * camera.pixel_size();
        for tree in &all.cull(&scene, &camera, frame).visible {
            let (nearest, _) = tree.bounds.depth_range(camera.eye, camera.forward);
            let diagonal = tree.bounds.size().length();
            let listed = seen.visible.iter().any(|v| v.tree == tree.tree);
            // A group is left out by its own box, which is larger than those in it.
            assert!(listed || diagonal < width * nearest, "{tree:?} is large enough");
            assert!(
                !listed || nearest <= 0.0 || diagonal >= width * nearest,
                "{tree:?} is too small"
            );
            left_out += usize::from(!listed);
        }
        assert!(seen.order_exact);
    }
    assert!(left_out > 500, "{left_out}");
    culler.set_smallest_feature(0.0);
    let camera = random_camera(&mut random, 60.0);
    assert_eq!(culler.cull(&scene, &camera, 0), all.cull(&scene, &camera, 0));
}
