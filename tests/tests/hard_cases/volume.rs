//! The volume integral: opacity does not depend on steps, bricks, levels, their mix, or cuts between trees.
//!
//! The bound on transmittance is 1e-3, absolute, of which ending a ray at 1/1024 takes 0.98e-3 at most.

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
                    let both = stage.close(&what, &camera);
                    for (caster, picture) in both.each() {
                        let mut worst = 0f64;
                        for (k, pixel) in picture.pixels.iter().enumerate() {
                            let ray = camera.ray((k % 32) as f64, (k / 32) as f64);
                            // A constant's alpha is its opacity across an eighth of its side.
                            let voxels = path_in_box(eye, ray, lo, hi) / (side / 8.0);
                            let through = (1.0 - f64::from(alpha) / 255.0).powf(voxels);
                            let expected = if through < 1.0 / 1024.0 { 0.0 } else { through };
                            worst = worst.max((1.0 - f64::from(pixel[3]) - expected).abs());
                        }
                        assert!(worst < 1e-4, "{caster}, {what}: off by {worst}");
                    }
                }
            }
        },
    );
}

/// Opacities, level 0 first, that are nearly one density: of all 8-bit codes these differ least, by 0.24 %.
const DENSITY: [u8; 4] = [168, 106, 60, 32];

/// How a box of one density is stored.
#[derive(Clone, Copy, Debug)]
enum Stored {
    Bricks,
    /// Constant nodes down to the finest level.
    Constants,
    /// One constant node.
    Root,
    /// Bricks and constants of the finest level, and constants that end above it.
    Mixed,
}

/// Adds a tree of 8·2^depth voxels of a metre.
fn dense_tree(maker: Maker, origin: DVec3, depth: u8, layout: SampleLayout, stored: Stored) -> Maker {
    let color = move |level: u8| {
        let alpha = DENSITY[usize::from(level + 3 - depth)];
        [alpha / 2, alpha / 4, alpha, alpha]
    };
    let kind = move |level: u8, p: UVec3| {
        let h = hash([i32::from(level), p.x as i32, p.y as i32, p.z as i32]) % 4;
        match stored {
            Stored::Bricks => Kind::Brick,
            Stored::Constants if level < depth => Kind::Inner(color(level)),
            Stored::Constants | Stored::Root => Kind::Leaf(color(level)),
            Stored::Mixed if level == depth && h < 2 => Kind::Leaf(color(level)),
            Stored::Mixed if level > 0 && h == 0 => Kind::Leaf(color(level)),
            Stored::Mixed if h == 1 => Kind::Inner(color(level)),
            Stored::Mixed => Kind::Brick,
        }
    };
    maker.tree(header(origin, 1.0, depth, layout, 1), kind, move |level, _| {
        sample(color(level))
    })
}

/// Optical depth per metre that the finest level stores, and the mean of all.
fn densities() -> [f64; 2] {
    let of = |level: usize| -(-f64::from(DENSITY[level]) / 255.0).ln_1p() / f64::from(8 >> level);
    let all = (0..4).map(of);
    [
        of(3),
        (all.clone().fold(f64::MAX, f64::min) + all.fold(0.0, f64::max)) * 0.5,
    ]
}

#[test]
fn a_box_of_one_density_lets_through_what_its_density_says() {
    exactly(
        "volume::a_box_of_one_density_lets_through_what_its_density_says",
        || {
            let [finest, mean] = densities();
            // A box of 192 × 64 × 64 m from x = 0, whole trees in a row or cut into trees of half the size.
            let (lo, hi) = (DVec3::ZERO, DVec3::new(192.0, 64.0, 64.0));
            let cuts = |depth: u8| {
                let side = f64::from(8u32 << depth);
                let [nx, n] = [192.0 / side, 64.0 / side].map(|n| n as i32);
                (0..nx * n * n).map(move |k| IVec3::new(k / (n * n), k / n % n, k % n).as_dvec3() * side)
            };
            let mut span = [f64::MAX, 0.0];
            let mut ended = 0;
            for (layout, stored, depth) in [
                (Centre, Stored::Bricks, 3),
                (Centre, Stored::Constants, 3),
                (Corner, Stored::Root, 3),
                (Centre, Stored::Mixed, 3),
                (Corner, Stored::Mixed, 3),
                (Centre, Stored::Mixed, 2),
                (Corner, Stored::Bricks, 2),
            ] {
                let maker = cuts(depth).fold(Maker::new(), |m, origin| {
                    dense_tree(m, origin, depth, layout, stored)
                });
                let mut stage = Stage::large(maker);
                for (place, camera) in [
                    (
                        "across",
                        world::camera(DVec3::new(70.0, -90.0, 110.0), hi * 0.5, 40.0, [24, 18]),
                    ),
                    (
                        "along",
                        world::camera(
                            DVec3::new(-60.0, 30.0, 33.0),
                            DVec3::new(96.0, 33.0, 32.0),
                            30.0,
                            [12, 9],
                        ),
                    ),
                    (
                        "inside",
                        world::camera(
                            DVec3::new(67.3, 12.1, 40.7),
                            DVec3::new(0.0, 40.0, 0.0),
                            90.0,
                            [12, 9],
                        ),
                    ),
                    // Rays of this row meet the box where it is from 7 mm to a voxel thick.
                    (
                        "an edge",
                        world::camera(
                            DVec3::new(-9.75, -9.75, 20.2),
                            DVec3::new(0.2, 0.0, 20.0),
                            2.0,
                            [96, 1],
                        ),
                    ),
                ] {
                    for bias in [-20.0, -2.6, -1.1, 0.4, 2.0] {
                        let what = format!("{layout:?} {stored:?} depth {depth}, {place}, bias {bias}");
                        let both = stage.check(&what, &camera, &biased(bias), SMOOTH);
                        for (caster, picture) in both.each() {
                            for (k, pixel) in picture.pixels.iter().enumerate() {
                                let (column, row) = (k as u32 % camera.width, k as u32 / camera.width);
                                let ray = camera.ray(f64::from(column), f64::from(row));
                                let path = path_in_box(camera.eye, ray, lo, hi);
                                let tau = path * if bias < -9.0 { finest } else { mean };
                                let through = 1.0 - f64::from(pixel[3]);
                                assert!(
                                    (through - (-tau).exp()).abs() < 1e-3,
                                    "{caster}, {what}: {through} of {} over {path} m",
                                    (-tau).exp()
                                );
                                if tau > 0.0 {
                                    span = [span[0].min(tau), span[1].max(tau)];
                                }
                                // Opaque by decree, not because nothing came through.
                                ended += usize::from(through == 0.0 && (-tau).exp() > 0.5e-3);
                            }
                        }
                    }
                }
            }
            assert!(
                span[0] < 1e-3 && span[1] > 20.0 && ended > 100,
                "{span:?}, {ended} ended"
            );
        },
    );
}

#[test]
fn haze_of_the_least_opacity_adds_up_over_kilometres() {
    exactly(
        "volume::haze_of_the_least_opacity_adds_up_over_kilometres",
        || {
            // Two kilometres of voxels of a metre; there is one row of finest nodes.
            for bricks in [true, false] {
                let tree = header(DVec3::ZERO, 1.0, 8, Centre, 1);
                let color = [0, 0, 0, 1];
                let kind = |level: u8, p: UVec3| match (p.y, p.z) == (100 >> (8 - level), 50 >> (8 - level)) {
                    true if bricks => Kind::Brick,
                    true if level < 8 => Kind::Inner(color),
                    _ => Kind::Leaf(color),
                };
                let mut stage = Stage::new(Maker::new().tree(tree, kind, |_, _| sample(color)));
                for (start, slope) in [
                    (-70.0, 0.0),
                    (-70.0, 1e-3),
                    (0.0, 0.0),
                    (1000.3, 2e-3),
                    (1937.1, 0.0),
                    (2047.7, 0.01),
                ] {
                    let eye = DVec3::new(start, 802.4, 404.3);
                    let forward = DVec3::new(1.0, slope, 0.7 * slope).normalize();
                    let [lo, hi] = tree.bounds();
                    let path = path_in_box(eye, forward, lo, hi);
                    let camera = world::camera(eye, eye + forward, 0.1, [1, 1]);
                    let what = format!("bricks {bricks}, {path} m");
                    let tau = -(-1.0 / 255.0f64).ln_1p() * path;
                    for (caster, picture) in stage.check(&what, &camera, &biased(-20.0), SMOOTH).each() {
                        let through = 1.0 - f64::from(picture.pixels[0][3]);
                        assert!(
                            (through - (-tau).exp()).abs() < 1e-3,
                            "{caster}, {what}: {through}, {}",
                            (-tau).exp()
                        );
                    }
                }
            }
        },
    );
}

/// The largest difference of neighbours.
fn largest_step(values: &[f32]) -> f32 {
    values.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f32::max)
}

#[test]
fn opacity_is_continuous_across_levels() {
    exactly("volume::opacity_is_continuous_across_levels", || {
        // Each level has another density; the eye is so far away that a ray changes its level at once.
        for (layout, bricks) in [(Centre, true), (Corner, true), (Centre, false)] {
            let alpha = [40u8, 5, 20, 3].map(|a| [0, 0, 0, a]);
            let kind = |level: u8, _| match bricks {
                true => Kind::Brick,
                false => Kind::Inner(alpha[usize::from(level)]),
            };
            let tree = header(DVec3::ZERO, 1.0, 3, layout, 1);
            let maker = Maker::new().tree(tree, kind, |level, _| sample(alpha[usize::from(level)]));
            let mut stage = Stage::new(maker);
            // A pixel is as wide as a finest voxel where bias is 0.
            let eye = DVec3::new(20.3, 30.2, 1e5);
            let camera = world::camera(
                eye,
                eye - DVec3::Z,
                (2.0 * (0.5 / 1e5f64).atan()).to_degrees(),
                [1, 1],
            );
            let mut sweep = |fade: f64| {
                let mut values = [Vec::new(), Vec::new()];
                for k in -70..=230 {
                    let settings = RenderSettings {
                        fade,
                        ..biased(f64::from(k) / 64.0)
                    };
                    let (gpu, _) = settled(&mut stage.renderer, &camera, &settings);
                    let reference = stage.world.reference(&camera, &settings);
                    values[0].push(gpu.pixels[0][3]);
                    values[1].push(reference.pixels[0][3]);
                }
                values
            };
            let (mixed, nearest) = (sweep(1.0), sweep(0.0));
            for (caster, mixed, nearest) in [
                ("GPU", &mixed[0], &nearest[0]),
                ("reference", &mixed[1], &nearest[1]),
            ] {
                let (smooth, jump) = (largest_step(mixed), largest_step(nearest));
                assert!(
                    smooth < 0.04 && jump > 0.15,
                    "{caster}, {layout:?}, bricks {bricks}: {smooth} {jump}"
                );
            }
            let apart = mixed[0]
                .iter()
                .zip(&mixed[1])
                .map(|(g, r)| (g - r).abs())
                .fold(0.0, f32::max);
            assert!(apart < 1e-3, "{layout:?}, bricks {bricks}: {apart}");
        }
    });
}

#[test]
fn opacity_is_continuous_across_nodes_and_trees() {
    exactly("volume::opacity_is_continuous_across_nodes_and_trees", || {
        // Level 1 is equal up to sample 8, so nodes x = 0 are constant there; level 0 changes from sample 4 on, which
        // reaches into those nodes by the rim. 16/255 a metre and 31/255 two metres are the same density.
        for layout in LAYOUTS {
            let value = |level: u8, x: i32| match level {
                0 => {
                    if x < 4 {
                        31
                    } else {
                        120
                    }
                }
                _ => {
                    if x < 9 {
                        16
                    } else {
                        60
                    }
                }
            };
            let mut maker = Maker::new();
            for tree_x in [0, 16] {
                let tree = header(DVec3::new(f64::from(tree_x), 0.0, 0.0), 1.0, 1, layout, 1);
                let kind = move |level, p: UVec3| match level == 1 && p.x == 0 && tree_x == 0 {
                    true => Kind::Leaf([0, 0, 0, 16]),
                    false => Kind::Brick,
                };
                maker = maker.tree(tree, kind, move |level, p| {
                    sample([0, 0, 0, value(level, p.x + (tree_x >> (1 - level)))])
                });
            }
            let mut stage = Stage::new(maker);
            for (y, bias) in [(5.3, 0.5), (0.4, 0.5), (15.7, 0.3), (8.0, 0.8)] {
                // A row across the constant node's face at x = 8 and the trees' at x = 16; a pixel is 16 mm wide.
                let eye = DVec3::new(11.9, y, 1e5);
                let fov = (2.0 * (0.5 * 0.016 / 1e5f64).atan()).to_degrees();
                let camera = world::camera(eye, eye - DVec3::Z, fov, [1024, 1]);
                let what = format!("{layout:?} y {y}");
                let settings = RenderSettings {
                    fade: 1.0,
                    ..biased(bias - 0.016f64.log2())
                };
                for (caster, picture) in stage.check(&what, &camera, &settings, SMOOTH).each() {
                    let values: Vec<f32> = picture.pixels.iter().map(|p| p[3]).collect();
                    let step = largest_step(&values);
                    assert!(step < 0.01, "{caster}, {what}: {step}");
                    assert!(
                        values[1023] - values[0] > 0.05,
                        "{caster}, {what}: nothing changes"
                    );
                }
            }
        }
    });
}
