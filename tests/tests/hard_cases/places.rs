//! Places: eyes on and in everything, deep trees, far worlds.

use brickfell_tests::pictures::{SAME, assert_alike};
use brickfell_tests::trees::sample;

use super::*;

#[test]
fn an_eye_inside_a_solid_sees_its_colour() {
    exactly("places::an_eye_inside_a_solid_sees_its_colour", || {
        let colour = [120, 60, 30, 255];
        let tree = header(DVec3::ZERO, 1.0, 1, Corner, 1);
        let mut stage = Stage::new(Maker::new().tree(tree, all_bricks, |_, _| sample(colour)));
        for eye in [DVec3::splat(8.0), DVec3::splat(3.3), DVec3::new(0.0, 5.0, 15.9)] {
            let camera = look(eye, DVec3::new(0.6, 0.3, -0.4), 9, 9);
            let both = stage.close("inside", &camera);
            for pixel in both.gpu.pixels.iter().chain(&both.reference.pixels) {
                let red = brickfell_formats::value::srgb_to_linear(colour[0]);
                assert!(
                    pixel[3] >= 0.999 && (pixel[0] - red).abs() < 0.002,
                    "{eye}: {pixel:?}"
                );
            }
        }
    });
}

#[test]
fn the_picture_is_the_same_far_from_the_worlds_origin() {
    exactly(
        "places::the_picture_is_the_same_far_from_the_worlds_origin",
        || {
            let picture = |offset: DVec3| {
                let west = header(offset, 1.0, 2, Centre, 2);
                let east = header(offset + DVec3::new(32.0, 0.0, -8.0), 1.0, 2, Centre, 2);
                let world = blob_tree(blob_tree(Maker::new(), west), east).finish();
                let eye = offset + DVec3::new(20.0, -30.0, 24.0);
                let camera = world::camera(eye, offset + DVec3::new(31.0, 16.0, 8.0), 60.0, [160, 120]);
                let mut renderer = world.renderer();
                let (picture, _) = settled(&mut renderer, &camera, &RenderSettings::default());
                (picture, world.reference(&camera, &RenderSettings::default()))
            };
            let (here, reference) = picture(DVec3::ZERO);
            assert!(covered(&here) > 4000);
            assert_alike("at the origin", &here, &reference, BOUND);
            for distance in [1.1e3, 1.1e6, 1.1e9] {
                let (there, reference) = picture(DVec3::new(distance, -distance, 1e-3 * distance));
                assert_alike(&format!("at {distance} m"), &here, &there, SAME);
                assert_alike(
                    &format!("at {distance} m against the reference"),
                    &there,
                    &reference,
                    BOUND,
                );
            }
        },
    );
}
