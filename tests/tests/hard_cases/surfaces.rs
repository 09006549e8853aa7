//! Surfaces: skins, walls, what alternates.

use brickfell_formats::value::{SKIN_ALPHA, SOLID_ALPHA};
use brickfell_tests::trees::sample;

use super::*;

#[test]
fn trees_of_different_size_stand_side_by_side_without_a_gap() {
    exactly(
        "surfaces::trees_of_different_size_stand_side_by_side_without_a_gap",
        || {
            // Ground of one colour in three trees, flush where they meet.
            let solid = [90, 90, 90, SOLID_ALPHA];
            let ground = |level_voxel: f64, z0: f64| {
                move |z: i32| {
                    let height = z0 + (f64::from(z) + 0.5) * level_voxel;
                    sample(if height < 2.0 { solid } else { [0; 4] })
                }
            };
            let mut maker = Maker::new();
            for (origin, voxel, depth) in [
                (DVec3::new(-16.0, 0.0, 0.0), 0.5, 2u8),
                (DVec3::new(0.0, 0.0, -4.0), 0.25, 2),
                (DVec3::new(0.0, 8.0, -4.0), 0.5, 1),
            ] {
                let tree = header(origin, voxel, depth, Centre, 2);
                maker = maker.tree(tree, all_bricks, move |level, p| {
                    ground(tree.level_voxel_size(level), origin.z)(p.z)
                });
            }
            let mut stage = Stage::new(maker);
            for (eye, target) in [
                (DVec3::new(-7.0, 1.0, 9.0), DVec3::new(3.0, 8.0, 2.0)),
                (DVec3::new(0.0, 8.0, 12.0), DVec3::new(0.0, 8.0, 0.0)),
                (DVec3::new(-10.0, 8.0, 2.6), DVec3::new(6.0, 8.0, 1.9)),
            ] {
                let camera = world::camera(eye, target, 30.0, [64, 64]);
                let both = stage.close(&format!("{eye}"), &camera);
                for (k, pixel) in both
                    .gpu
                    .pixels
                    .iter()
                    .enumerate()
                    .chain(both.reference.pixels.iter().enumerate())
                {
                    let ray = camera.ray((k % 64) as f64, (k / 64) as f64);
                    let hit = eye + ray * ((eye.z - 2.0) / -ray.z);
                    let inside = ray.z < 0.0 && hit.x > -15.0 && hit.x < 7.0 && hit.y > 1.0 && hit.y < 15.0;
                    assert!(!inside || pixel[3] > 0.99, "{eye}, pixel {k} at {hit}: {pixel:?}");
                }
            }
        },
    );
}

#[test]
fn a_skin_one_voxel_thick_is_opaque_at_every_phase() {
    exactly(
        "surfaces::a_skin_one_voxel_thick_is_opaque_at_every_phase",
        || {
            for layout in LAYOUTS {
                let tree = header(DVec3::ZERO, 1.0, 2, layout, 2);
                let skin = |level: u8, p: IVec3| match p.z == 13 >> (2 - level) {
                    true => sample([200, 180, 160, SKIN_ALPHA]),
                    false => sample([0; 4]),
                };
                let mut stage = Stage::new(Maker::new().tree(tree, all_bricks, skin));
                for phase in 0..8 {
                    let shift = f64::from(phase) / 8.0;
                    let eye = DVec3::new(15.0 + shift, 14.3 + 0.37 * shift, 29.0 + shift);
                    let target = DVec3::new(16.0 - shift, 16.4, 13.0 + shift);
                    let camera = world::camera(eye, target, 35.0, [48, 48]);
                    let what = format!("{layout:?} phase {phase}");
                    for (caster, picture) in stage.close(&what, &camera).each() {
                        let least = picture.pixels.iter().map(|p| p[3]).fold(1.0, f32::min);
                        assert!(least >= 0.99, "{what}, {caster}: {least}");
                    }
                }
            }
        },
    );
}

#[test]
fn a_thin_wall_seen_edge_on_stays_thin() {
    exactly("surfaces::a_thin_wall_seen_edge_on_stays_thin", || {
        // One voxel thick at x = 13 of 32, along y and z; coarser levels hold the mean.
        for layout in LAYOUTS {
            let tree = header(DVec3::ZERO, 1.0, 2, layout, 2);
            let wall = |level: u8, p: IVec3| {
                let shift = 2 - level;
                let alpha = if p.x == 13 >> shift {
                    SKIN_ALPHA >> shift
                } else {
                    0
                };
                sample([alpha / 2, alpha / 2, alpha / 2, alpha])
            };
            let mut stage = Stage::new(Maker::new().tree(tree, all_bricks, wall));
            let centre = 13.0 + layout.sample_offset();
            for (off, bias) in [(0.0, -20.0), (0.3, -20.0), (-0.45, -20.0), (0.0, -0.5)] {
                // Sixteen pixels a voxel at the near edge, from one tree side away.
                let eye = DVec3::new(centre + off, -32.0, 16.0);
                let fov = (2.0 * (1.5f64 / 32.0).atan()).to_degrees();
                let camera = world::camera(eye, eye + DVec3::Y, fov, [64, 48]);
                let what = format!("{layout:?}, off by {off}, bias {bias}");
                for (caster, picture) in stage.check(&what, &camera, &biased(bias), CLOSE).each() {
                    for row in picture.pixels.chunks(64) {
                        let wide = row.iter().filter(|p| p[3] > 0.0).count();
                        let opaque = row.iter().filter(|p| p[3] > 0.99).count();
                        // Filtered, the wall is up to two voxels wide, and opaque in the middle.
                        assert!(
                            (16..=48).contains(&wide) && opaque >= 8,
                            "{caster}, {what}: {wide}, {opaque}"
                        );
                    }
                }
            }
        }
    });
}

#[test]
fn a_wall_hides_the_colour_of_the_one_behind_it() {
    exactly("surfaces::a_wall_hides_the_colour_of_the_one_behind_it", || {
        for layout in LAYOUTS {
            // Both two voxels thick, six voxels between them: their means share no sample one level up.
            let tree = header(DVec3::ZERO, 1.0, 2, layout, 2);
            let walls = |level: u8, p: IVec3| match p.y << (2 - level) {
                8..=9 => sample([180, 0, 0, SOLID_ALPHA]),
                16..=17 => sample([0, 180, 0, SOLID_ALPHA]),
                _ => sample([0; 4]),
            };
            let mut stage = Stage::new(Maker::new().tree(tree, all_bricks, walls));
            for phase in 0..8 {
                let shift = f64::from(phase) / 8.0;
                for (y, hidden) in [(-20.0 + shift, 1), (50.0 + shift, 0)] {
                    let eye = DVec3::new(11.0 + shift, y, 14.0 + 0.3 * shift);
                    let camera = world::camera(eye, DVec3::new(17.0, 13.0, 16.0 - shift), 20.0, [40, 30]);
                    for bias in [-20.0, -2.0] {
                        let what = format!("{layout:?} phase {phase}, from {y}, bias {bias}");
                        for (caster, picture) in stage.check(&what, &camera, &biased(bias), CLOSE).each() {
                            let shows = picture.pixels.iter().map(|p| p[hidden]).fold(0.0, f32::max);
                            let least = picture.pixels.iter().map(|p| p[3]).fold(1.0, f32::min);
                            assert!(
                                shows < 1e-3 && least > 0.999,
                                "{caster}, {what}: {shows}, {least}"
                            );
                        }
                    }
                }
            }
        }
    });
}

#[test]
fn what_alternates_from_voxel_to_voxel_is_filtered_alike() {
    exactly(
        "surfaces::what_alternates_from_voxel_to_voxel_is_filtered_alike",
        || {
            for (layout, board) in LAYOUTS.into_iter().flat_map(|l| [(l, true), (l, false)]) {
                let tree = header(DVec3::ZERO, 1.0, 2, layout, 1);
                let value = move |level: u8, p: IVec3| {
                    let odd = if board { p.element_sum() } else { p.z } & 1 == 1;
                    let alpha = match (level, odd) {
                        (2, true) => 200,
                        (2, false) => 0,
                        _ => 100,
                    };
                    sample([alpha, alpha / 2, alpha / 4, alpha])
                };
                let mut stage = Stage::new(Maker::new().tree(tree, all_bricks, value));
                // Along z a ray meets the middle of each voxel; there samples lie, or it is midway between them.
                let eye = DVec3::new(9.5, 17.5, 40.0);
                let straight = look(eye, DVec3::NEG_Z, 1, 1);
                let both = stage.check("straight", &straight, &biased(-20.0), SMOOTH);
                let opacity = if layout == Centre {
                    [200.0, 0.0]
                } else {
                    [100.0, 100.0]
                };
                let transmittance: f64 = (0..32).map(|k| 1.0 - opacity[k % 2] / 255.0).product();
                for (caster, picture) in both.each() {
                    let off = 1.0 - f64::from(picture.pixels[0][3]) - transmittance;
                    assert!(off.abs() < 1e-3, "{caster}, {layout:?}, board {board}: {off}");
                }
                for (k, direction) in [DVec3::new(0.2, 0.1, -1.0), DVec3::new(-1.0, 0.9, -0.8)]
                    .into_iter()
                    .enumerate()
                {
                    for bias in [-20.0, -1.0, 0.6] {
                        let what = format!("{layout:?}, board {board}, direction {k}, bias {bias}");
                        let camera = look(DVec3::splat(16.0) - direction * 40.0, direction, 40, 30);
                        stage.check(&what, &camera, &biased(bias), CLOSE);
                    }
                }
            }
        },
    );
}
