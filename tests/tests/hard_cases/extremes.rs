//! Extremes of pictures, pools and numbers.

use super::*;

#[test]
fn pictures_of_one_pixel_and_of_one_row() {
    exactly("extremes::pictures_of_one_pixel_and_of_one_row", || {
        let mut stage = Stage::new(neighbours());
        for (width, height, fov) in [
            (1, 1, 40.0),
            (16384, 1, 0.004),
            (1, 16384, 60.0),
            (16384, 3, 0.01),
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
