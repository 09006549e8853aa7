//! Cuts through nested groups: what is drawn by coarse trees, in which order, and what it costs.

use super::order_tests::misordered;
use super::*;
use crate::scene::{GroupId, NodeKind};
use crate::testing::{Random, random_camera};
use glam::{DVec3, dvec3};
use std::cell::RefCell;
use std::collections::HashSet;

/// Side of the square that [`nested`] fills.
const SIDE: f64 = 64.0;

/// A quadtree of `2^levels` columns a side, each of one or two trees, whose groups have a stack of coarse trees each with 16
/// voxels a side. Gives the scene and, for each id, the ids of the coarse trees of every group around it.
fn nested(random: &mut Random, levels: u32) -> (SceneGraph, Vec<Vec<Vec<u32>>>) {
    let mut builder = SceneGraph::builder();
    let mut around: Vec<Vec<Vec<u32>>> = Vec::new();
    let leaf = SIDE / f64::from(1 << levels);
    let stack = |x: f64, y: f64, size: f64, low: f64, count: usize| {
        (0..count).map(move |k| {
            let min = dvec3(x, y, low + size * k as f64);
            Aabb::new(min, min + size).unwrap()
        })
    };
    let mut cells = vec![(GroupId::ROOT, -SIDE / 2.0, -SIDE / 2.0, SIDE, Vec::new())];
    while let Some((group, x, y, size, outer)) = cells.pop() {
        if size <= leaf {
            let low = (random.below(9) as f64 - 4.0) * size / 8.0;
            for bounds in stack(x, y, size, low, 1 + random.below(2)) {
                let id = TreeId(around.len() as u32);
                builder.add_tree(Some(group), id, bounds).unwrap();
                around.push(outer.clone());
            }
            continue;
        }
        let mut own = Vec::new();
        // All heights that trees have.
        for bounds in stack(x, y, size, -leaf, (4.0 * leaf / size).ceil() as usize) {
            let id = TreeId(around.len() as u32);
            builder.add_coarse(group, id, bounds, size / 16.0).unwrap();
            around.push(outer.clone());
            own.push(id.0);
        }
        let mut outer = outer;
        outer.push(own);
        let half = size / 2.0;
        for (dx, dy) in [(0.0, 0.0), (half, 0.0), (0.0, half), (half, half)] {
            let inner = if half <= leaf {
                group
            } else {
                builder.add_group(Some(group)).unwrap()
            };
            cells.push((inner, x + dx, y + dy, half, outer.clone()));
        }
    }
    (builder.finish(), around)
}

fn ids(trees: &[VisibleTree]) -> HashSet<u32> {
    trees.iter().map(|tree| tree.tree.0).collect()
}

#[test]
fn a_cut_covers_every_tree_once_and_in_order() {
    let mut random = Random::new(31);
    let (mut pairs, mut mixed, mut waiting) = (0, 0, 0);
    for round in 0..12 {
        let (scene, around) = nested(&mut random, 4);
        let mut culler = Culler::new();
        for _ in 0..40 {
            let camera = random_camera(&mut random, 60.0);
            let footprint = 0.1 * 0.03f64.powf(random.unit());
            // Whether all, or any one tree, is loaded is a coin's throw that stays what it is.
            let (share, seed) = (random.below(3), random.bits());
            let readiness = |tree: TreeId| match Random::new(seed ^ u64::from(tree.0)).below(3) < share {
                true => Readiness::Awaited,
                false => Readiness::Ready,
            };
            let cut = Cut {
                footprint,
                readiness: &readiness,
            };
            let listed = culler.cull_cut(&scene, &camera, &cut, 0).clone();
            assert!(listed.order_exact);
            let wrong = misordered(&mut random, &listed.visible, camera.eye, 30, &mut pairs);
            assert_eq!(wrong, 0, "round {round}");
            let drawn = ids(&listed.visible);
            let coarse = listed.visible.iter().filter(|tree| tree.beyond.is_some()).count();
            mixed += usize::from(coarse > 0 && coarse < listed.visible.len());
            waiting += usize::from(
                listed
                    .visible
                    .iter()
                    .any(|v| readiness(v.tree) == Readiness::Awaited),
            );
            for tree in &drawn {
                let groups = &around[*tree as usize];
                assert!(
                    !groups.iter().flatten().any(|outer| drawn.contains(outer)),
                    "{tree} is there twice"
                );
            }
            for tree in ids(&culler.cull(&scene, &camera, 0).visible) {
                let groups = &around[tree as usize];
                let stood_for = groups
                    .iter()
                    .any(|group| group.iter().any(|outer| drawn.contains(outer)));
                assert!(drawn.contains(&tree) || stood_for, "{tree} is missing");
            }
            for tree in &listed.wanted {
                assert!(!drawn.contains(&tree.tree.0), "wanted and drawn");
            }
        }
    }
    assert!(
        pairs > 100_000 && mixed > 30 && waiting > 20,
        "{pairs} {mixed} {waiting}"
    );
}

#[test]
fn far_groups_are_drawn_by_their_coarse_trees_and_say_how_far() {
    let (scene, _) = nested(&mut Random::new(32), 4);
    let cut = |footprint: f64| Cut {
        footprint,
        readiness: &|_| Readiness::Ready,
    };
    let mut culler = Culler::new();
    let camera = Camera::look_at(dvec3(0.0, -1000.0, 1000.0), DVec3::ZERO, 20.0, 64, 64).unwrap();
    let mut last = usize::MAX;
    for step in 0..60 {
        let footprint = 1e-4 * 1.2f64.powi(step);
        let result = culler.cull_cut(&scene, &camera, &cut(footprint), 0);
        assert!(result.visible.len() <= last);
        last = result.visible.len();
        for tree in &result.visible {
            let (Some(beyond), width) = (tree.beyond, tree.bounds.size().x) else {
                // No farther than the other end of its group, from where that would be far.
                let nearest = tree.bounds.depth_range(camera.eye, camera.forward).0;
                assert!((nearest - 40.0) * footprint < 8.0 / 16.0);
                continue;
            };
            let nearest = tree.bounds.depth_range(camera.eye, camera.forward).0;
            assert!(beyond >= 0.0 && nearest * footprint >= width / 16.0);
            assert!((nearest * footprint / (width / 16.0)).log2() >= beyond);
        }
    }
    assert!(last <= 2, "only the root's are left, not {last}");
    assert_eq!(culler.cull(&scene, &camera, 0).wanted, []);
}

/// Loads as a pager does, a few trees a frame, while the camera comes nearer, goes away and jumps.
#[test]
fn once_the_root_is_there_nothing_in_view_is_missing() {
    let (scene, _) = nested(&mut Random::new(33), 4);
    let loaded = RefCell::new(HashSet::new());
    let readiness = |tree: TreeId| match loaded.borrow().contains(&tree.0) {
        true => Readiness::Ready,
        false => Readiness::Awaited,
    };
    let mut culler = Culler::new();
    let (mut reached, mut stood_in) = (0, 0);
    for frame in 0..400 {
        let distance = match frame {
            0..200 => 2000.0 * 0.97f64.powi(frame),
            200..300 => 4.5 * 1.06f64.powi(frame - 200),
            _ => [10.0, 800.0][frame as usize / 25 % 2],
        };
        let eye = dvec3(3.0, -0.8, 0.6) * distance;
        let camera = Camera::look_at(eye, DVec3::ZERO, 40.0, 64, 64).unwrap();
        let cut = Cut {
            footprint: 0.01,
            readiness: &readiness,
        };
        let result = culler.cull_cut(&scene, &camera, &cut, 0);
        let awaited: Vec<u32> = (result.visible.iter().chain(&result.wanted))
            .map(|tree| tree.tree.0)
            .filter(|tree| !loaded.borrow().contains(tree))
            .collect();
        if frame > 10 {
            let holes = result
                .visible
                .iter()
                .filter(|v| awaited.contains(&v.tree.0))
                .count();
            assert_eq!(holes, 0, "frame {frame}");
        }
        reached += usize::from(result.visible.iter().any(|v| v.beyond.is_none()));
        stood_in += result.visible.iter().filter(|v| v.beyond == Some(0.0)).count();
        // Whatever is neither drawn nor wanted is thrown out again.
        let used = ids(&result.visible)
            .union(&ids(&result.wanted))
            .copied()
            .collect::<HashSet<u32>>();
        loaded.borrow_mut().retain(|tree| used.contains(tree));
        loaded.borrow_mut().extend(awaited.into_iter().take(3));
    }
    assert!(reached > 50 && stood_in > 20, "{reached} {stood_in}");
}

#[test]
fn what_failed_is_not_waited_for() {
    let (scene, around) = nested(&mut Random::new(34), 2);
    let camera = Camera::look_at(dvec3(90.0, 80.0, 70.0), DVec3::ZERO, 60.0, 64, 64).unwrap();
    let mut culler = Culler::new();
    let all = culler.cull(&scene, &camera, 0).visible.clone();
    let root: HashSet<u32> = around
        .iter()
        .filter_map(|groups| groups.first())
        .flatten()
        .copied()
        .collect();
    // The root's coarse trees are damaged: what is inside is drawn, however far.
    let far = Cut {
        footprint: 1.0,
        readiness: &|tree| {
            if root.contains(&tree.0) {
                Readiness::Failed
            } else {
                Readiness::Ready
            }
        },
    };
    let seen = culler.cull_cut(&scene, &camera, &far, 0);
    assert!(!seen.visible.is_empty() && !seen.visible.iter().any(|v| root.contains(&v.tree.0)));
    assert!(!seen.wanted.iter().any(|v| root.contains(&v.tree.0)));
    // A damaged tree keeps nobody from being seen nearer.
    let broken = all[0].tree;
    let near = Cut {
        footprint: 1e-6,
        readiness: &|tree| {
            if tree == broken {
                Readiness::Failed
            } else {
                Readiness::Ready
            }
        },
    };
    assert_eq!(
        ids(&culler.cull_cut(&scene, &camera, &near, 0).visible),
        ids(&all)
    );
}

#[test]
fn a_large_terrain_seen_from_afar_costs_little_and_allocates_nothing() {
    let mut random = Random::new(35);
    let (scene, _) = nested(&mut random, 9);
    assert!(scene.len() > 262_144 && scene.coarse_count() > 87_381);
    let mut culler = Culler::new();
    let mut visited = Vec::new();
    for round in 0..2 {
        let before = culler.capacity();
        for distance in [100.0, 250.0, 1000.0, 4000.0] {
            let camera =
                Camera::look_at(dvec3(0.1, -0.6, 0.8) * distance, DVec3::ZERO, 60.0, 1920, 1080).unwrap();
            let cut = Cut {
                footprint: camera.pixel_size(),
                readiness: &|_| Readiness::Ready,
            };
            let result = culler.cull_cut(&scene, &camera, &cut, 0);
            assert!(!result.visible.is_empty());
            visited.push((result.visible.len(), result.groups_visited, result.wanted.len()));
        }
        assert!(round == 0 || culler.capacity() == before, "allocates");
    }
    // A picture of 1920 pixels has room for 240 × 135 bricks of 8 voxels; far less of it shows the terrain.
    assert!(
        visited[1].0 < 4000 && visited[2].0 < 400 && visited[3].0 < 40,
        "{visited:?}"
    );
    for (trees, groups, wanted) in visited {
        assert!(
            groups <= trees + trees / 2 + 20 && wanted <= trees + 40,
            "{trees} {groups} {wanted}"
        );
    }
}

#[test]
fn a_scene_scaled_as_a_whole_is_cut_alike() {
    let mut random = Random::new(29);
    let (scene, around) = nested(&mut random, 4);
    let footprint = 0.02;
    for scale in [1.0 / 1024.0, 4.0, 65_536.0] {
        // The same tree of groups, by its ids.
        let mut scaled = SceneGraph::builder();
        let larger = |b: &Aabb| Aabb::new(b.min * scale, b.max * scale).unwrap();
        let mut groups = vec![(0usize, GroupId::ROOT)];
        while let Some((at, group)) = groups.pop() {
            let NodeKind::Group {
                first, count, coarse, ..
            } = scene.nodes()[at].kind
            else {
                unreachable!()
            };
            for child in first..first + count {
                let node = scene.nodes()[child as usize];
                match node.kind {
                    NodeKind::Tree => scaled
                        .add_tree(Some(group), TreeId(node.id), larger(&node.bounds))
                        .unwrap(),
                    _ => groups.push((child as usize, scaled.add_group(Some(group)).unwrap())),
                }
            }
            for tree in first + count..first + count + coarse.count {
                let node = scene.nodes()[tree as usize];
                scaled
                    .add_coarse(group, TreeId(node.id), larger(&node.bounds), coarse.voxel * scale)
                    .unwrap();
            }
        }
        let scaled = scaled.finish();
        let (mut culler, mut other) = (Culler::new(), Culler::new());
        let mut coarse = 0;
        for frame in 0..100 {
            let camera = random_camera(&mut random, SIDE);
            let moved = Camera {
                eye: camera.eye * scale,
                ..camera
            };
            let cut = Cut {
                footprint,
                readiness: &|_| Readiness::Ready,
            };
            let here = ids(&culler.cull_cut(&scene, &camera, &cut, frame).visible);
            let there = ids(&other.cull_cut(&scaled, &moved, &cut, frame).visible);
            assert_eq!(here, there, "scale {scale}");
            coarse += here.iter().filter(|id| around[**id as usize].len() < 4).count();
        }
        assert!(coarse > 50, "groups are drawn by their coarse trees: {coarse}");
    }
}
