//! The volume integral.

use brickfell_tests::trees::{path_in_box, sample};

use super::*;

#[test]
fn a_constant_root_lets_light_through_as_beers_law_says() {
    exactly(
        "volume::a_constant_root_lets_light_through_as_beers_law_says",
        || {
            for (alpha, voxel, depth) in [(40u8, 1.0, 0u8), (3, 0.5, 3), (1, 1000.0, 4), (254, 0.01, 1)] {
                let tree = header(DVec3::splat(-voxel), voxel, depth, Centre, 1);
                let mut stage = Stage::new(Maker::new().tree(
                    tree,
                    |_, _| Kind::Leaf([alpha, 0, 0, alpha]),
                    |_, _| sample([0; 4]),
                ));
                let side = tree.side();
                let [lo, hi] = tree.bounds();
                for eye in [DVec3::new(-1.3, -0.9, 1.7), DVec3::new(0.4, 0.3, 0.2)] {
                    let eye = lo + eye * side;
                    let camera = world::camera(eye, (lo + hi) * 0.5, 50.0, [32, 32]);
                    let what = format!("alpha {alpha}, voxel {voxel}, depth {depth}, from {eye}");
                    let picture = stage.close(&what, &camera).gpu;
                    let mut worst = 0f64;
                    for (k, pixel) in picture.pixels.iter().enumerate() {
                        let ray = camera.ray((k % 32) as f64, (k / 32) as f64);
                        // A constant's alpha is its opacity across an eighth of its side.
                        let tau = -(-f64::from(alpha) / 255.0).ln_1p() * path_in_box(eye, ray, lo, hi)
                            / (side / 8.0);
                        let transmittance = if (-tau).exp() < 1.0 / 1024.0 {
                            0.0
                        } else {
                            (-tau).exp()
                        };
                        worst = worst.max((1.0 - f64::from(pixel[3]) - transmittance).abs());
                    }
                    assert!(worst < 1e-4, "{what}: off by {worst}");
                }
            }
        },
    );
}
