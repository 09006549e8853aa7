//! Extremes of pictures, pools and numbers.

use std::sync::Arc;

use brickfell::holes::count_holes;
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::renderer::RendererConfig;
use brickfell_runtime::terrain::Terrain;
use brickfell_tests::pictures::assert_alike;

use super::directions::{fan, thin_trees};
use super::*;

#[test]
fn pictures_of_one_pixel_and_of_one_row() {
    exactly("extremes::pictures_of_one_pixel_and_of_one_row", || {
        let mut stage = Stage::new(neighbours());
        for (width, height, fov) in [
            (1, 1, 40.0),
            (16384, 1, 0.004),
            (1, 16384, 60.0),
            (16384, 16, 0.05),
            (7, 5, 60.0),
        ] {
            let eye = DVec3::new(-6.0, -20.0, 12.0);
            let camera = world::camera(eye, DVec3::new(-3.0, 8.0, 3.0), fov, [width, height]);
            let what = format!("{width}x{height}");
            let picture = stage.close(&what, &camera).gpu;
            assert_eq!(picture.pixels.len() as u32, width * height);
            assert!(covered(&picture) > 0, "{what}");
        }
    });
}

#[test]
fn an_empty_scene_is_empty() {
    exactly("extremes::an_empty_scene_is_empty", || {
        let camera = look(DVec3::ZERO, DVec3::X, 20, 10);
        let behind = look(DVec3::new(50.0, 0.0, 0.0), DVec3::X, 20, 10);
        for (what, maker, camera) in [
            ("empty", Maker::new(), camera),
            ("behind the eye", neighbours(), behind),
        ] {
            let both = Stage::new(maker).close(what, &camera);
            assert!(both.gpu.pixels.iter().all(|p| *p == [0.0; 4]), "{what}");
        }
    });
}

#[test]
fn footprints_from_a_thousandth_of_a_voxel_to_a_thousand() {
    exactly(
        "extremes::footprints_from_a_thousandth_of_a_voxel_to_a_thousand",
        || {
            for layout in LAYOUTS {
                let tree = header(DVec3::ZERO, 1.0, 3, layout, 2);
                let mut stage = Stage::new(blob_tree(Maker::new(), tree));
                let target = DVec3::new(30.0, 33.0, 31.0);
                let eye = target - DVec3::new(70.0, -55.0, -60.0);
                let distance = eye.distance(target);
                for exponent in -10..=10 {
                    // By the lens as far as it shows something, the rest by the bias; and all of it by the bias.
                    let lens = exponent.min(1);
                    for (lens, bias) in [(lens, exponent - lens), (0, exponent)] {
                        let pixel = f64::from(lens).exp2() / distance;
                        let fov = (2.0 * (0.5 * 24.0 * pixel).atan()).to_degrees();
                        let camera = world::camera(eye, target, fov, [32, 24]);
                        let what = format!("{layout:?}, 2^{exponent} voxels, 2^{lens} by the lens");
                        stage.check(&what, &camera, &biased(f64::from(bias)), CLOSE);
                    }
                }
            }
        },
    );
}

#[test]
fn what_was_loaded_before_does_not_show() {
    exactly("extremes::what_was_loaded_before_does_not_show", || {
        // Nodes come ahead of bricks, and few rays load little: constants are there before what they are mixed with.
        for first in [-20.0, -4.0, 0.0] {
            let mut stage = thin_trees(Centre);
            for eye in [DVec3::new(19.5, 8.0, -9.0), DVec3::new(-9.0, 19.0, 8.0)] {
                for forward in DVec3::AXES {
                    let camera = fan(eye, forward, 0.0);
                    stage.check("first", &camera, &biased(first), SMOOTH);
                    for bias in [-5.0, -4.3, -3.6, -2.9] {
                        let what = format!("{bias} after {first}, from {eye} along {forward}");
                        let both = stage.check(&what, &camera, &biased(bias), SMOOTH);
                        assert!(alpha_apart(&both) < 1e-3, "{what}: {}", alpha_apart(&both));
                    }
                }
            }
        }
    });
}

#[test]
fn the_smallest_pool_has_no_hole_and_comes_to_rest() {
    exactly(
        "extremes::the_smallest_pool_has_no_hole_and_comes_to_rest",
        || {
            let world = neighbours().finish();
            let open = |gpu_budget: u64| {
                let config = RendererConfig {
                    gpu_budget,
                    ..RendererConfig::default()
                };
                let terrain = Terrain::open(&world.store).unwrap();
                Renderer::new(world::gpu(), Arc::clone(&world.store), terrain, config)
            };
            // Eight bricks of 10³ samples of 8 bytes, with what belongs to them.
            let least = 8 * 8240;
            assert!(matches!(open(least - 1), Err(RuntimeError::Budget { .. })));
            let mut renderer = open(least).unwrap();
            assert_eq!(renderer.brick_slots(), 8);
            let settings = RenderSettings::default();
            for (eye, direction) in [
                (DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6)),
                (DVec3::new(-3.0, 8.0, 12.0), DVec3::new(0.4, 0.1, -1.0)),
                (DVec3::new(2.0, 8.0, 4.6), DVec3::new(0.4, 0.1, -1.0)),
            ] {
                let camera = look(eye, direction, 48, 36);
                let (picture, report) = settled(&mut renderer, &camera, &settings);
                let what = format!("{eye}: {report:?}");
                assert!(covered(&picture) > 100, "{what}");
                assert_eq!(
                    count_holes(&picture, &world.reference(&camera, &settings)),
                    0,
                    "{what}"
                );
                let coarse = world.reference(&camera, &biased(report.bias));
                assert_alike(&what, &picture, &coarse, CLOSE);
                let loads = renderer.pager_stats().loads;
                for _ in 0..20 {
                    let rest = renderer.frame(&camera, &settings).unwrap();
                    let moved = (rest.uploads, rest.node_updates, rest.pending, rest.bias);
                    assert_eq!(moved, (0, 0, 0, report.bias), "{rest:?}");
                }
                assert_eq!(renderer.pager_stats().loads, loads);
                assert!(picture == renderer.read_picture().unwrap());
            }
        },
    );
}
