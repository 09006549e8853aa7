//! Places: eyes on and in everything, deep trees, far worlds.

use brickfell_tests::pictures::{SAME, assert_alike};
use brickfell_tests::trees::{sample, sign_patterns};

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

#[test]
fn an_eye_may_be_anywhere() {
    exactly("places::an_eye_may_be_anywhere", || {
        for layout in LAYOUTS {
            let west = header(DVec3::new(-16.0, 0.0, 0.0), 1.0, 1, layout, 2);
            let east = header(DVec3::new(0.0, 4.0, -3.0), 0.25, 2, layout, 2);
            let mut stage = Stage::new(blob_tree(blob_tree(Maker::new(), west), east));
            for (place, eye) in [
                ("on a corner of the tree", DVec3::new(0.0, 4.0, -3.0)),
                ("on its high corner", DVec3::new(8.0, 12.0, 5.0)),
                ("on its edge", DVec3::new(0.0, 7.1, -3.0)),
                ("on its face", DVec3::new(3.3, 6.1, 5.0)),
                ("on the face of two trees", DVec3::new(0.0, 7.7, 2.3)),
                ("on a corner of eight bricks", DVec3::new(4.0, 8.0, 1.0)),
                ("on an edge of four bricks", DVec3::new(-8.0, 8.0, 3.1)),
                ("on a face of two bricks", DVec3::new(2.0, 6.1, 0.3)),
                ("on a corner of eight voxels", DVec3::new(1.25, 5.5, -1.75)),
                ("in a voxel", DVec3::new(1.3, 5.6, -1.85)),
                ("below the border of a brick", DVec3::new(1.95, 5.95, -1.05)),
                ("above the border of a brick", DVec3::new(2.05, 6.05, -0.95)),
                ("in the border of a tree", DVec3::new(-0.1, 7.9, 2.2)),
            ] {
                for direction in [DVec3::new(0.6, 0.3, -0.4), DVec3::new(-0.5, -0.7, 0.2)] {
                    let what = format!("{layout:?}, {place}, along {direction}");
                    stage.close(&what, &look(eye, direction, 24, 18));
                }
            }
        }
    });
}

/// Edges that are seen from so far away that 10⁻⁷ of the distance is a fiftieth of a voxel.
const FAR: Bound = Bound {
    near: 2.0,
    share: 0.95,
    worst: 16.0,
};

#[test]
fn depth_twenty_is_walked_to_the_end() {
    exactly("places::depth_twenty_is_walked_to_the_end", || {
        // Voxels of a millimetre in a tree of eight kilometres: only the nodes around one finest brick exist.
        let fine = UVec3::new(0x5_5555, 0x3_3333, 0xf_fff0);
        let tree = header(DVec3::splat(-1000.0), 0.001, 20, Centre, 1);
        let kind = |level: u8, p: UVec3| match p == fine >> u32::from(20 - level) {
            true if level == 20 => Kind::BrickLeaf,
            true => Kind::Inner([0; 4]),
            false => Kind::Leaf([0; 4]),
        };
        // Two colours, so that the place in the brick is seen, too.
        let maker = Maker::new().tree(tree, kind, |_, p| match p.x & 7 < 4 {
            true => sample([200, 0, 0, 255]),
            false => sample([0, 0, 200, 255]),
        });
        let mut stage = Stage::new(maker);
        let middle = tree.origin + (fine.as_dvec3() + 0.5) * 0.008;
        for direction in sign_patterns() {
            let direction = direction.normalize();
            for distance in [0.03, 1.0, 200.0] {
                let eye = middle - direction * distance;
                let fov = (2.0 * (0.012 / distance).atan()).to_degrees();
                let camera = world::camera(eye, middle, fov, [15, 15]);
                let what = format!("{distance} m along {direction}");
                let both = stage.check(&what, &camera, &biased(-20.0), FAR);
                for (caster, picture) in both.each() {
                    let [first, centre] = [0, 112].map(|k| picture.pixels[k]);
                    assert!(centre[3] == 1.0 && first == [0.0; 4], "{caster}, {what}");
                    assert!(covered(picture) >= 20, "{caster}, {what}: {}", covered(picture));
                }
            }
        }
    });
}
