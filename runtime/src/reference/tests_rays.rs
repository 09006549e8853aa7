//! The way of rays through trees: hard directions, hard eyes, far eyes.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::Stored;
use glam::{DVec3, UVec3, dvec3};
use proptest::prelude::*;

use super::testing::*;
use super::tree::FromRoot;
use super::{Reference, Scene};
use crate::march::{Ray, Transport, Walk};
use crate::settings::RenderSettings;

/// A number from numbers, the same every time.
pub(super) fn hash(values: &[i32]) -> u32 {
    let mixed = values.iter().fold(0x9e37_79b9u32, |h, v| {
        let h = (h ^ *v as u32).wrapping_mul(0x85eb_ca6b);
        (h ^ h >> 15).wrapping_mul(0xc2b2_ae35)
    });
    mixed ^ mixed >> 16
}

const DEPTH: u8 = 3;

/// What a node of the irregular tree is: constant leaves at all levels, some of them empty.
fn irregular(level: u8, p: UVec3) -> Kind {
    let h = hash(&[i32::from(level), p.x as i32, p.y as i32, p.z as i32]);
    if level == DEPTH || (level > 0 && h.is_multiple_of(4)) {
        Kind::Leaf([0, 0, 0, if h & 16 == 0 { 0 } else { (h >> 8) as u8 % 30 }])
    } else {
        Kind::Inner([0, 0, 0, 77])
    }
}

fn irregular_tree() -> Reference {
    let mut store = Store::default();
    let head = header(DVec3::ZERO, 1.0, DEPTH, SampleLayout::Centre, 1);
    store.add("t.oct", head, irregular, |_, _| Stored::default());
    store.open(&["t.oct"])
}

/// ln of the transmittance per metre at a point of the irregular tree.
fn density(p: DVec3) -> f64 {
    (0..=DEPTH)
        .find_map(|level| {
            let node = (p / f64::from(64 >> level)).floor().as_uvec3();
            match irregular(level, node) {
                Kind::Leaf(c) => Some((1.0 - f64::from(c[3]) / 255.0).ln() / f64::from(8 >> level)),
                _ => None,
            }
        })
        .unwrap()
}

/// Transmittance by cutting the ray at all planes between finest nodes. `nudge` moves the sampled points off planes that
/// the ray lies in.
fn brute_force(eye: DVec3, direction: DVec3, nudge: f64) -> f64 {
    let mut cuts = vec![0.0];
    for axis in 0..3 {
        let d = direction[axis];
        if d != 0.0 {
            cuts.extend(
                (0..=8)
                    .map(|k| (f64::from(k) * 8.0 - eye[axis]) / d)
                    .filter(|z| *z > 0.0),
            );
        }
    }
    cuts.sort_by(f64::total_cmp);
    let sum: f64 = cuts
        .windows(2)
        .filter(|w| w[1] > w[0])
        .map(|w| (eye + direction * (0.5 * (w[0] + w[1])) + nudge, w[1] - w[0]))
        .filter(|(p, _)| p.cmpge(DVec3::ZERO).all() && p.cmplt(DVec3::splat(64.0)).all())
        .map(|(p, dz)| density(p) * dz * direction.length())
        .sum();
    sum.exp()
}

#[test]
fn all_sign_patterns_from_faces_edges_and_corners_are_exact() {
    let reference = irregular_tree();
    let places = [-9.0, 0.0, 8.0, 19.5, 32.0, 56.0, 64.0, 70.0];
    for k in 0..512 {
        let eye = dvec3(places[k & 7], places[k >> 3 & 7], places[k >> 6]);
        for direction in sign_patterns() {
            let (rgba, counters) = shoot(&reference, eye, direction, 0.0, 1.0);
            // Rays in a plane between nodes belong to the upper ones, as half-open boxes say.
            let expected = brute_force(eye, direction, 1e-9);
            assert!(
                (1.0 - rgba[3] - expected).abs() < 1e-3,
                "{eye} {direction}: {rgba:?} {expected}"
            );
            assert!(
                expected < 1.0 / 1024.0 || (1.0 - rgba[3] - expected).abs() < 1e-9,
                "{eye} {direction}"
            );
            assert!(counters.nodes < 24 * 4);
        }
    }
}

proptest! {
    #[test]
    fn transmittance_is_that_of_brute_force(
        eye in prop::array::uniform3(-80.0..140.0f64),
        target in prop::array::uniform3(0.0..64.0f64),
        tiny in prop::sample::select(vec![1.0, 1e-3, 1e-9, 1e-17, 1e-300, 0.0, -0.0]),
        axis in 0usize..3,
    ) {
        let eye = DVec3::from(eye);
        let mut direction = (DVec3::from(target) - eye) / 50.0;
        direction[axis] *= tiny;
        prop_assume!(direction.length() > 1e-3);
        let (rgba, _) = shoot(&irregular_tree(), eye, direction, 0.0, 1.0);
        let expected = brute_force(eye, direction, 0.0);
        let tolerance = if expected < 1e-3 { 1e-3 } else { 1e-9 };
        prop_assert!((1.0 - rgba[3] - expected).abs() < tolerance, "{eye} {direction}");
    }
}

/// Two trees side by side along `axis`, the lower one red, the upper one green, both thin.
fn two_trees(axis: usize) -> Reference {
    let mut store = Store::default();
    let mut origin = DVec3::ZERO;
    for (name, color) in [("red.oct", [50, 0, 0, 20]), ("green.oct", [0, 50, 0, 20])] {
        let head = header(origin, 0.1, 1, SampleLayout::Corner, 1);
        let kind = |level, p: UVec3| {
            if level == 1 && p.x == p.y {
                Kind::Leaf(color)
            } else {
                Kind::Brick
            }
        };
        store.add(name, head, kind, |_, _| Stored {
            color,
            normal: [0; 4],
        });
        origin[axis] += head.side();
    }
    // The farther one is named first: order must come from the rays.
    store.open(&["green.oct", "red.oct"])
}

#[test]
fn a_ray_in_a_shared_face_belongs_to_the_upper_tree_only() {
    for axis in 0..3 {
        let reference = two_trees(axis);
        let side = header(DVec3::ZERO, 0.1, 1, SampleLayout::Corner, 1).side();
        let opacity = |metres: f64| 1.0 - (1.0 - 20.0 / 255.0f64).powf(metres / 0.1);
        for along in 0..3 {
            // In the plane, from outside the trees and from inside the shared face.
            if along == axis {
                continue;
            }
            for start in [-5.0, 0.3] {
                let mut eye = DVec3::splat(0.4);
                eye[axis] = side;
                eye[along] = start;
                let direction = DVec3::AXES[along];
                let (rgba, _) = shoot(&reference, eye, direction, 0.0, 1.0);
                let path = side - start.max(0.0);
                assert!(
                    rgba[0] == 0.0 && (rgba[3] - opacity(path)).abs() < 1e-9,
                    "{eye} {direction} {rgba:?}"
                );
            }
        }
        // Across the face, from inside it: each direction sees the tree it looks into.
        let mut eye = DVec3::splat(0.4);
        eye[axis] = side;
        for (sign, seen, unseen) in [(1.0, 1, 0), (-1.0, 0, 1)] {
            let (rgba, _) = shoot(&reference, eye, DVec3::AXES[axis] * sign, 0.0, 1.0);
            assert!(rgba[unseen] == 0.0 && rgba[seen] > 0.01, "{axis} {sign} {rgba:?}");
            assert!((rgba[3] - opacity(side)).abs() < 1e-9);
        }
        // Through both: the nearer colour covers the farther one.
        for (start, sign, front) in [(-3.0, 1.0, 0), (6.0, -1.0, 1)] {
            eye[axis] = start;
            let (rgba, _) = shoot(&reference, eye, DVec3::AXES[axis] * sign, 0.0, 1.0);
            assert!(rgba[front] > rgba[1 - front] * 1.5, "{axis} {sign} {rgba:?}");
        }
    }
}

/// A hill with a surface of bricks, at a world position.
fn hill(origin: DVec3) -> Reference {
    let mut store = Store::default();
    let head = header(origin, 0.25, 3, SampleLayout::Centre, 2);
    let height = |x: f64, y: f64| 7.0 + 3.0 * (x * 0.6).sin() * (y * 0.5).cos();
    let kind = move |level: u8, p: UVec3| {
        let size = 8.0 * head.level_voxel_size(level);
        let low = f64::from(p.z) * size;
        match (low > 11.0, low + size < 3.0) {
            (true, _) => Kind::Leaf([0; 4]),
            (_, true) => Kind::Leaf([70, 80, 60, 132]),
            _ => Kind::Brick,
        }
    };
    let sample = move |level: u8, p: glam::IVec3| {
        let v = head.level_voxel_size(level);
        let at = (p.as_dvec3() + 0.5) * v;
        let inside = (0.5 + (height(at.x, at.y) - at.z) / v).clamp(0.0, 1.0);
        let alpha = (132.0 * inside) as u8;
        let shade = (alpha / 2).saturating_add(if (at.x * 0.8).sin() > 0.0 { alpha / 4 } else { 0 });
        Stored {
            color: [shade, alpha / 2, alpha / 3, alpha],
            normal: [10, 20, (110.0 * inside) as i8, 0],
        }
    };
    store.add("hill.oct", head, kind, sample);
    store.open(&["hill.oct"])
}

/// Share of pixels that differ by more than `tolerance`.
fn differing(a: &crate::picture::Picture, b: &crate::picture::Picture, tolerance: f32) -> f64 {
    let worse = |(a, b): (&[f32; 4], &[f32; 4])| a.iter().zip(b).any(|(a, b)| (a - b).abs() > tolerance);
    a.pixels.iter().zip(&b.pixels).filter(|p| worse(*p)).count() as f64 / a.pixels.len() as f64
}

#[test]
fn a_very_far_eye_sees_what_a_far_eye_sees() {
    let reference = hill(DVec3::ZERO);
    let target = DVec3::splat(8.0);
    let axis = dvec3(0.3, -0.6, 0.8).normalize();
    let picture = |distance: f64| {
        let fov = (2.0 * (10.0 / distance).atan()).to_degrees();
        let camera = Camera::look_at(target + axis * distance, target, fov, 60, 60).unwrap();
        reference.render(&camera, &RenderSettings::default()).unwrap()
    };
    let ((near, counters), (far, _), (farthest, _)) = (picture(1e6), picture(1e7), picture(1e8));
    assert!(counters.rays_hit > 1500 && counters.samples > counters.rays_hit);
    assert_eq!(
        (differing(&near, &far, 0.01), differing(&near, &farthest, 0.01)),
        (0.0, 0.0)
    );
}

#[test]
fn the_picture_does_not_depend_on_where_the_world_is() {
    let picture = |offset: f64| {
        let origin = dvec3(offset, -offset, 2.0 * offset);
        let camera = Camera::look_at(origin + dvec3(-6.0, -9.0, 20.0), origin + 8.0, 50.0, 60, 40).unwrap();
        hill(origin)
            .render(&camera, &RenderSettings::default())
            .unwrap()
            .0
    };
    let here = picture(0.0);
    for offset in [1e3, 1e6, 1e9] {
        assert_eq!(differing(&here, &picture(offset), 1.0 / 255.0), 0.0, "{offset}");
    }
}

#[test]
fn depth_twenty_is_walked_to_the_end() {
    // Only the nodes around one finest node exist; it is opaque and nothing else is.
    let fine = UVec3::new(0x5_5555, 0x3_3333, 0xf_ffff);
    let mut store = Store::default();
    let head = header(DVec3::splat(-1000.0), 0.001, 20, SampleLayout::Corner, 1);
    let kind = |level: u8, p: UVec3| match p == fine >> u32::from(20 - level) {
        true if level == 20 => Kind::BrickLeaf,
        true => Kind::Inner([0; 4]),
        false => Kind::Leaf([0; 4]),
    };
    store.add("t.oct", head, kind, |_, _| grey(200, 255));
    let reference = store.open(&["t.oct"]);
    let middle = head.origin + (fine.as_dvec3() + 0.5) * 0.008;
    for direction in sign_patterns() {
        for distance in [1e-3, 5.0, 1e4] {
            let eye = middle - direction.normalize() * distance;
            let (rgba, counters) = shoot(&reference, eye, direction, 0.0, 1.0);
            assert_eq!(rgba[3], 1.0, "{direction} {distance}");
            // A corner of the first voxel may be all that the ray has of it: then it goes on into the second.
            assert!(
                counters.nodes >= 21 && (1..=2).contains(&counters.samples),
                "{direction} {counters:?}"
            );
            // A voxel beside it there is nothing.
            let side = direction.any_orthonormal_vector() * 0.016;
            assert_eq!(
                shoot(&reference, eye + side, direction, 0.0, 1.0).0,
                [0.0; 4],
                "{direction}"
            );
        }
    }
}

#[test]
fn a_ray_that_needs_more_segments_than_its_cap_is_counted() {
    let reference = hill(DVec3::ZERO);
    let camera = Camera::look_at(dvec3(-5.0, 8.1, 10.5), dvec3(40.0, 8.3, 10.4), 1.0, 1, 1).unwrap();
    let scene = Scene::new(&reference, &camera, &RenderSettings::default()).unwrap();
    let direction = camera.ray(0.0, 0.0);
    let (tree, view) = &scene.trees[0];
    let capped = |cap: Option<u64>| {
        let mut nodes = FromRoot(tree);
        let ray = Ray::new(DVec3::ZERO, direction);
        let passage = view.passage(&ray).unwrap();
        let mut walk = Walk::<_, _, false>::new(view, &scene.lens, &scene.shading, &mut nodes, &ray, passage);
        walk.cap = cap.unwrap_or(walk.cap);
        let mut transport = Transport::default();
        walk.run(&mut transport).unwrap();
        transport.counters.capped
    };
    assert_eq!((capped(None), capped(Some(3))), (0, 1));
}
