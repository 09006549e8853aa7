//! Directions: every pattern of signs, rays in planes, rays along faces.

use std::collections::BTreeSet;

use brickfell_tests::trees::{path_in_box, sample};

use super::*;

/// Thin constants and bricks of all sizes in a tree of 64 m, and a finer, smaller one that shares the face x = 64.
pub(super) fn thin_trees(layout: SampleLayout) -> Stage {
    let west = header(DVec3::ZERO, 1.0, 3, layout, 1);
    let east = header(DVec3::new(64.0, 8.0, -8.0), 0.5, 3, layout, 1);
    let mut maker = Maker::new();
    for tree in [west, east] {
        let grey = |alpha: u8| [alpha / 2, alpha / 3, alpha, alpha];
        let kind = move |level: u8, p: UVec3| {
            let h = hash([i32::from(level), p.x as i32, p.y as i32, p.z as i32]);
            match h % 8 {
                0 | 1 if level > 0 => Kind::Leaf(grey((h >> 8) as u8 % 30)),
                2 if level > 0 => Kind::Leaf([0; 4]),
                _ => Kind::Brick,
            }
        };
        maker = maker.tree(tree, kind, move |level, p| {
            let wave = (p.as_dvec3() * DVec3::new(0.3, 0.4, 0.5))
                .map(f64::sin)
                .element_sum();
            sample(grey((8.0 + 2.0 * wave + f64::from(level)) as u8))
        });
    }
    Stage::new(maker)
}

/// Nine rays in directions of which each component is -1, 0 or 1; zeros have the sign of `zero`.
pub(super) fn fan(eye: DVec3, forward: DVec3, zero: f64) -> Camera {
    let signed = |v: DVec3| DVec3::select(v.cmpeq(DVec3::ZERO), DVec3::splat(zero), v);
    let up = DVec3::new(forward.z.abs(), forward.x.abs(), forward.y.abs());
    Camera {
        eye,
        forward: signed(forward),
        right: signed(forward.cross(up)),
        up: signed(up),
        // A pixel is as wide as it is far away.
        fov_y: 2.0 * 1.5f64.atan(),
        width: 3,
        height: 3,
    }
}

#[test]
fn all_sign_patterns_from_faces_edges_and_corners() {
    exactly(
        "directions::all_sign_patterns_from_faces_edges_and_corners",
        || {
            // Outside; in faces of trees, bricks and voxels; in a voxel. All three alike: corners; two: edges.
            let places = [-9.0, 0.0, 8.0, 19.0, 19.5, 64.0];
            let forwards = DVec3::AXES.into_iter().flat_map(|a| [a, -a]);
            let mut stage = thin_trees(Centre);
            let mut patterns = BTreeSet::new();
            for (k, forward) in forwards.cycle().take(6 * 216).enumerate() {
                let eye = k / 6;
                let eye = DVec3::new(places[eye % 6], places[eye / 6 % 6], places[eye / 36]);
                let zero = if hash([k as i32]) & 1 == 0 { 0.0 } else { -0.0 };
                let camera = fan(eye, forward, zero);
                // The finest level alone, or levels mixed on the way.
                let settings = biased(if hash([k as i32]) & 2 == 0 { -20.0 } else { -4.3 });
                let what = format!("{eye} along {forward} with {zero:?}");
                let both = stage.check(&what, &camera, &settings, SMOOTH);
                assert!(alpha_apart(&both) < 1e-3, "{what}: {both:?}");
                for (k, pixel) in both.gpu.pixels.iter().enumerate() {
                    if pixel[3] > 0.0 {
                        let ray = camera.ray((k % 3) as f64, (k / 3) as f64);
                        patterns.insert(ray.to_array().map(|c| c.round() as i32));
                    }
                }
            }
            assert_eq!(patterns.len(), 26, "{patterns:?}");
        },
    );
}

#[test]
fn rays_along_the_axes_from_faces_edges_and_corners() {
    exactly(
        "directions::rays_along_the_axes_from_faces_edges_and_corners",
        || {
            let mut stage = Stage::new(neighbours());
            let eyes = [
                DVec3::new(0.0, 8.0, 1.0),   // in the face that the trees share
                DVec3::new(0.0, 4.0, -3.0),  // a corner of one, in a face of the other
                DVec3::new(-16.0, 0.0, 0.0), // a corner
                DVec3::new(-8.0, 8.0, 8.0),  // a corner of eight bricks
                DVec3::new(2.0, 6.0, -1.0),  // inside a brick, on voxel planes
                DVec3::new(8.0, 12.0, 5.0),  // the high corner
                DVec3::new(0.0, -30.0, 1.0), // outside, in the plane of the shared face
                DVec3::new(-40.0, 4.0, 4.0), // outside, in the plane of a face
            ];
            let axes = [DVec3::X, DVec3::Y, DVec3::Z];
            let mut hits = 0;
            for eye in eyes {
                for axis in axes.into_iter().flat_map(|a| [a, -a]) {
                    let camera = look(eye, axis, 17, 17);
                    let flip = |v: DVec3| DVec3::select(v.cmpeq(DVec3::ZERO), -v, v);
                    // The same directions with the zeros' signs turned.
                    let turned = Camera {
                        forward: flip(camera.forward),
                        right: flip(camera.right),
                        up: flip(camera.up),
                        ..camera
                    };
                    let what = format!("{eye} along {axis}");
                    let both = stage.close(&what, &camera);
                    stage.close(&format!("{what}, zeros turned"), &turned);
                    let pixel = both.gpu.pixels[both.gpu.pixels.len() / 2];
                    hits += u32::from(pixel[3] > 0.5);
                }
            }
            assert!(hits > 8, "{hits} of the rays along axes hit");
        },
    );
}

/// A camera of one pixel, of which it is told what an axis is.
fn one_ray(eye: DVec3, forward: DVec3) -> Camera {
    let mut camera = world::camera(eye, eye + forward, 1.0, [1, 1]);
    camera.forward = forward;
    camera
}

#[test]
fn a_ray_in_the_plane_between_two_trees_belongs_to_the_upper_one() {
    exactly(
        "directions::a_ray_in_the_plane_between_two_trees_belongs_to_the_upper_one",
        || {
            // Metres that f64 holds and metres that it does not, near the world's origin and some trees farther.
            let lattices = [(1.0, 1), (0.1, 1), (0.1, 4), (0.3, 8)];
            for (axis, (voxel, number)) in (0..3).flat_map(|axis| lattices.map(|l| (axis, l))) {
                let side = 16.0 * voxel;
                // The lower one red, the upper one green, both thin, of bricks and constants.
                let mut maker = Maker::new();
                for (color, number) in [([50, 0, 0, 20], number - 1), ([0, 50, 0, 20], number)] {
                    let mut origin = DVec3::ZERO;
                    origin[axis] = f64::from(16 * number) * voxel;
                    let tree = header(origin, voxel, 1, Corner, 1);
                    let kind = move |level, p: UVec3| match level == 1 && p.x == p.y {
                        true => Kind::Leaf(color),
                        false => Kind::Brick,
                    };
                    maker = maker.tree(tree, kind, move |_, _| sample(color));
                }
                let mut stage = Stage::new(maker);
                let opacity = |path: f64| 1.0 - (1.0 - 20.0 / 255.0f64).powf(16.0 * path / side);
                for along in (0..3).filter(|along| *along != axis) {
                    // From outside, from inside, and from beyond; in the plane, and as near to it as no f32 can say.
                    for (start, sign) in [
                        (-5.0, 1.0),
                        (0.2 * side, 1.0),
                        (0.2 * side, -1.0),
                        (3.0 * side, -1.0),
                    ] {
                        for (above, seen) in [(-1e-9, 0), (0.0, 1), (1e-9, 1)] {
                            let mut eye = DVec3::splat(0.3 * side);
                            eye[along] = start;
                            eye[axis] = f64::from(16 * number) * voxel + above * side;
                            let forward = DVec3::AXES[along] * sign;
                            let path = if sign > 0.0 {
                                side - start.max(0.0)
                            } else {
                                start.min(side)
                            };
                            let what = format!("{eye} along {forward}");
                            let both = stage.check(&what, &one_ray(eye, forward), &biased(-20.0), SMOOTH);
                            for (caster, picture) in both.each() {
                                let pixel = picture.pixels[0];
                                let off = (f64::from(pixel[3]) - opacity(path)).abs();
                                assert!(
                                    pixel[1 - seen] == 0.0 && off < 1e-5,
                                    "{caster}, {what}: {pixel:?}"
                                );
                            }
                        }
                    }
                }
            }
        },
    );
}

#[test]
fn rays_that_graze_a_face_stay_as_long_as_they_should() {
    exactly(
        "directions::rays_that_graze_a_face_stay_as_long_as_they_should",
        || {
            for bricks in [true, false] {
                let tree = header(DVec3::ZERO, 1.0, 2, Centre, 1);
                let color = [60, 50, 40, 12];
                let kind = |level, p: UVec3| match bricks && (level < 2 || p.z == 3) {
                    true => Kind::Brick,
                    false => Kind::Leaf(color),
                };
                let mut stage = Stage::new(Maker::new().tree(tree, kind, |_, _| sample(color)));
                let [lo, hi] = tree.bounds();
                for exponent in 1..=7 {
                    let slope = 10f64.powi(-exponent);
                    // Through the top face in the middle of the way, inwards and outwards; and below it all the way.
                    for (eye, slope) in [
                        (DVec3::new(-10.0, 9.3, 32.0 + 26.0 * slope), -slope),
                        (DVec3::new(-10.0, 9.3, 32.0 - 26.0 * slope), slope),
                        (DVec3::new(4.0, 9.3, 32.0 - 12.0 * slope), slope),
                        (DVec3::new(-10.0, 9.3, 32.0), -slope),
                        (DVec3::new(-10.0, 9.3, 24.0 + 26.0 * slope), -slope),
                    ] {
                        let forward = DVec3::new(1.0, 0.3 * slope, slope).normalize();
                        let path = path_in_box(eye, forward, lo, hi);
                        let voxel = if bricks { 1.0 } else { 4.0 };
                        let opacity = 1.0 - (1.0 - 12.0 / 255.0f64).powf(path / voxel);
                        let what = format!("bricks {bricks}, {eye} with slope {slope}");
                        // The GPU places the eye to 3e-8 of a voxel, which is 3e-8 / slope on the ray's way.
                        let rounding = (1.5e-9 / slope.abs()).max(1e-3);
                        let bound = Bound {
                            worst: 255.0 * rounding + 1.0,
                            share: 0.0,
                            ..SMOOTH
                        };
                        let both = stage.check(&what, &one_ray(eye, forward), &biased(-20.0), bound);
                        for (picture, bound) in [(&both.gpu, rounding), (&both.reference, 1e-3)] {
                            let off = (f64::from(picture.pixels[0][3]) - opacity).abs();
                            assert!(off < bound, "{what}: {both:?}, {opacity}");
                        }
                    }
                }
            }
        },
    );
}
