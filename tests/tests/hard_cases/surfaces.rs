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
