//! Level choice and the mixing of two levels.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::Stored;
use glam::{DVec3, UVec3, dvec3};

use super::testing::*;
use super::{Reference, tests_rays::hash};
use crate::settings::RenderSettings;

const LAYOUTS: [SampleLayout; 2] = [SampleLayout::Corner, SampleLayout::Centre];

/// Largest difference of neighbouring values.
fn largest_step(values: &[f64]) -> f64 {
    values.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max)
}

#[test]
fn opacity_is_continuous_across_levels() {
    // Every level has another density; an eye far away makes the whole ray change its level at once.
    for (layout, bricks) in [(LAYOUTS[0], true), (LAYOUTS[1], true), (LAYOUTS[0], false)] {
        let mut store = Store::default();
        let alpha = [40u8, 5, 20, 3].map(|a| grey(0, a));
        let head = header(DVec3::ZERO, 1.0, 3, layout, 1);
        let kind = |level, _| {
            if bricks {
                Kind::Brick
            } else {
                Kind::Inner(alpha[usize::from(level)].color)
            }
        };
        store.add("t.oct", head, kind, |level, _| alpha[usize::from(level)]);
        let reference = store.open(&["t.oct"]);
        let eye = dvec3(20.3, 30.2, 1e6);
        let sweep = |fade: f64| -> Vec<f64> {
            (-1200..=2800)
                .map(|k| {
                    let footprint = (f64::from(k) / 512.0).exp2() * 1e-6;
                    1.0 - shoot(&reference, eye, DVec3::NEG_Z, footprint, fade).0[3]
                })
                .collect()
        };
        let (mixed, nearest) = (sweep(1.0), sweep(0.0));
        for (end, level) in [(0, 3u8), (mixed.len() - 1, 0)] {
            let voxels = 64.0 / head.level_voxel_size(level);
            let a = f64::from(alpha[usize::from(level)].color[3]) / 255.0;
            let expected = (1.0 - a).powf(voxels);
            assert!(
                (mixed[end] - expected).abs() < 1e-12 && (nearest[end] - expected).abs() < 1e-12,
                "{level}"
            );
        }
        let (smooth, jump) = (largest_step(&mixed), largest_step(&nearest));
        assert!(smooth < 0.006 && jump > 0.15, "{layout:?}: {smooth} {jump}");
    }
}

#[test]
fn the_wanted_level_is_where_a_voxel_fits_the_footprint() {
    let mut store = Store::default();
    let head = header(DVec3::ZERO, 1.0, 4, SampleLayout::Centre, 1);
    let kind = |level, _| {
        if level == 4 {
            Kind::Leaf([0; 4])
        } else {
            Kind::Inner([0; 4])
        }
    };
    store.add("t.oct", head, kind, |_, _| Stored::default());
    // Opaque markers instead of empty nodes would stop the ray, so the depth of the descent is read from the counter.
    let mut lit = Store::default();
    let kind = |level, _| {
        if level == 4 {
            Kind::Leaf([0, 0, 0, 255])
        } else {
            Kind::Inner([0, 0, 0, 255])
        }
    };
    lit.add("t.oct", head, kind, |_, _| Stored::default());
    let lit = lit.open(&["t.oct"]);
    let nodes = |footprint: f64, fade| {
        shoot(
            &lit,
            dvec3(3.0, 3.0, 1e6),
            DVec3::NEG_Z,
            footprint / (1e6 - 128.0),
            fade,
        )
        .1
        .nodes
    };
    // Voxels are 16, 8, 4, 2, 1 m at levels 0 to 4; the finer of two mixed levels is at least as fine as wanted.
    for (footprint, mixed, nearest) in [
        (0.5, 5, 5),
        (0.99, 5, 5),
        (1.1, 5, 5),
        (1.5, 5, 4),
        (2.1, 4, 4),
        (7.0, 3, 2),
        (8.1, 2, 2),
        (100.0, 1, 1),
    ] {
        assert_eq!(
            (nodes(footprint, 1.0), nodes(footprint, 0.0)),
            (mixed, nearest),
            "{footprint}"
        );
    }
    assert_eq!(
        shoot(
            &store.open(&["t.oct"]),
            dvec3(3.0, 3.0, 1e6),
            DVec3::NEG_Z,
            1e-6,
            1.0
        )
        .0,
        [0.0; 4]
    );
}

#[test]
fn closed_forms_end_where_the_level_changes() {
    // Voxels of 8 and 4 m at levels 0 and 1; from the top face down, the footprint is one of them at known depths.
    let a = |code: u8| f64::from(code) / 255.0;
    let head = header(DVec3::ZERO, 1.0, 3, SampleLayout::Centre, 1);
    let transmittance = |kind: &dyn Fn(u8) -> Kind, footprint| {
        let mut store = Store::default();
        store.add("t.oct", head, |level, _| kind(level), |_, _| grey(0, 30));
        1.0 - shoot(
            &store.open(&["t.oct"]),
            dvec3(20.0, 20.0, 64.0),
            DVec3::NEG_Z,
            footprint,
            1.0,
        )
        .0[3]
    };
    let coarse = Kind::Inner([0, 0, 0, 30]);

    // Where both nodes are constant but differ, segments of the finer one's voxel, 4 m, are mixed by the weight at their start.
    let weight = |footprint: f64, z: f64| (8.0 / (footprint * z)).log2();
    let pair = |w: f64, fine: f64, metres: f64| {
        (1.0 - w) * (1.0 - a(30)).powf(metres / 8.0) + w * (1.0 - fine).powf(metres / 4.0)
    };

    // The data ends at level 1: alone to 10 m, mixed with the root to 20 m, the root alone from there.
    let mixed = transmittance(
        &|level| {
            if level == 0 {
                coarse
            } else {
                Kind::Leaf([0, 0, 0, 10])
            }
        },
        0.4,
    );
    let expected = (1.0 - a(10)).powf(12.0 / 4.0)
        * pair(weight(0.4, 12.0), a(10), 4.0)
        * pair(weight(0.4, 16.0), a(10), 4.0)
        * (1.0 - a(30)).powf(44.0 / 8.0);
    assert!((mixed - expected).abs() < 1e-12, "{mixed} {expected}");

    // Levels 1 and 2 are empty: skipped to 5 m, then the root comes in; the segment that begins at 8 m ends at 12 m.
    let kind = |level| match level {
        0 => coarse,
        1 => Kind::Inner([0; 4]),
        _ => Kind::Leaf([0; 4]),
    };
    let expected = pair(weight(0.8, 8.0), 0.0, 4.0) * (1.0 - a(30)).powf(52.0 / 8.0);
    let skipped = transmittance(&kind, 0.8);
    assert!((skipped - expected).abs() < 1e-12, "{skipped} {expected}");

    // Inside the rim the parent's brick counts as equal to the node, until it stands alone at 20 m.
    let inner = transmittance(
        &|level| {
            if level == 0 {
                Kind::Brick
            } else {
                Kind::Leaf([0; 4])
            }
        },
        0.4,
    );
    let expected = (1.0 - a(30)).powf(44.0 / 8.0);
    assert!((inner - expected).abs() < 1e-12, "{inner} {expected}");

    // Seen from afar, half mixed: the rims of two nodes, 4 m each at both ends, show half of the parent.
    let mut store = Store::default();
    let kind = |level, _| {
        if level == 0 {
            Kind::Brick
        } else {
            Kind::Leaf([0; 4])
        }
    };
    store.add("t.oct", head, kind, |_, _| grey(0, 30));
    let eye = dvec3(20.0, 20.0, 1e9);
    let [.., alpha] = shoot(
        &store.open(&["t.oct"]),
        eye,
        DVec3::NEG_Z,
        32f64.sqrt() * 1e-9,
        1.0,
    )
    .0;
    let expected = (1.0 - 0.5 * (1.0 - (1.0 - a(30)).sqrt())).powi(4);
    assert!((1.0 - alpha - expected).abs() < 1e-6, "{alpha} {expected}");
}

#[test]
fn values_are_continuous_from_a_constant_node_to_its_sibling() {
    // Level 1 is equal up to sample 8, so its node x = 0 is constant; level 0 changes from sample 4 on, which reaches
    // into that node by the rim. 16/255 per metre and 31/255 per two metres are the same density.
    for layout in LAYOUTS {
        let mut store = Store::default();
        let head = header(DVec3::ZERO, 1.0, 1, layout, 1);
        let kind = |level, p: UVec3| {
            if level == 1 && p.x == 0 {
                Kind::Leaf([0, 0, 0, 16])
            } else {
                Kind::Brick
            }
        };
        let sample = |level: u8, p: glam::IVec3| match level {
            0 => grey(0, if p.x < 4 { 31 } else { 120 }),
            _ => grey(0, if p.x < 9 { 16 } else { 60 }),
        };
        store.add("t.oct", head, kind, sample);
        let reference = store.open(&["t.oct"]);
        let at = |x: f64, y: f64| {
            let footprint = 2f64.sqrt() * 1e-6;
            1.0 - shoot(&reference, dvec3(x, y, 1e6), DVec3::NEG_Z, footprint, 1.0).0[3]
        };
        for y in [5.3, 0.4, 15.7] {
            let values: Vec<f64> = (0..=8 * 256).map(|k| at(4.0 + f64::from(k) / 256.0, y)).collect();
            let deep = values[0];
            let face = values[4 * 256];
            assert!(
                largest_step(&values) < 0.01,
                "{layout:?}: {}",
                largest_step(&values)
            );
            assert!(
                deep - face > 0.05,
                "the parent is mixed in at the face: {deep} {face}"
            );
        }
        // The closed form of the inner box and the sampled rim agree: obliquely, too, the ray may cross both.
        let oblique = |dx: f64| {
            shoot(
                &reference,
                dvec3(3.0 + dx, 5.0, 30.0),
                dvec3(0.1, 0.02, -1.0),
                0.05,
                1.0,
            )
            .0[3]
        };
        let values: Vec<f64> = (0..512).map(|k| oblique(f64::from(k) / 256.0)).collect();
        assert!(
            largest_step(&values) < 0.01,
            "{layout:?}: {}",
            largest_step(&values)
        );
    }
}

/// A smooth cloud in world space, as a tree with its low corner at `origin`.
fn cloud(tree: &mut Store, name: &str, origin: DVec3, depth: u8, layout: SampleLayout) {
    let head = header(origin, 1.0, depth, layout, 2);
    let sample = |level: u8, p: glam::IVec3| {
        let x = origin + (p.as_dvec3() + layout.sample_offset()) * head.level_voxel_size(level);
        let wave = (x * dvec3(0.5, 0.4, 0.7)).map(f64::sin).element_sum();
        let alpha = (8.0 + 2.5 * wave + f64::from(depth - level)) as u8;
        Stored {
            color: [alpha * 3, alpha, alpha * 2, alpha],
            normal: [3, -5, (wave * 4.0) as i8, 0],
        }
    };
    let kind = |level: u8, p: UVec3| {
        let low = origin + p.as_dvec3() * 8.0 * head.level_voxel_size(level);
        if level == depth && hash(&low.as_ivec3().to_array()).is_multiple_of(3) {
            Kind::Leaf([30, 20, 10, 9])
        } else {
            Kind::Brick
        }
    };
    tree.add(name, head, kind, sample);
}

fn one_tree(layout: SampleLayout) -> Reference {
    let mut store = Store::default();
    cloud(&mut store, "all.oct", DVec3::ZERO, 2, layout);
    store.open(&["all.oct"])
}

fn eight_trees(layout: SampleLayout) -> Reference {
    let mut store = Store::default();
    let names: Vec<String> = (0..8).map(|k| format!("{k}.oct")).collect();
    for (k, name) in names.iter().enumerate() {
        let cell = UVec3::new(k as u32 & 1, k as u32 >> 1 & 1, k as u32 >> 2);
        cloud(&mut store, name, cell.as_dvec3() * 16.0, 1, layout);
    }
    store.open(&names.iter().map(String::as_str).collect::<Vec<_>>())
}

#[test]
fn a_terrain_cut_into_trees_is_the_same_terrain() {
    for layout in LAYOUTS {
        let (one, eight) = (one_tree(layout), eight_trees(layout));
        for (bias, fade) in [(-4.0, 1.0), (-0.5, 1.0), (-0.5, 0.0), (-0.5, 0.25), (-0.25, 1.0)] {
            let settings = RenderSettings {
                bias,
                fade,
                ..RenderSettings::default()
            };
            for eye in [
                dvec3(60.0, 50.0, 40.0),
                dvec3(-30.0, 16.0, 70.0),
                dvec3(16.0, 16.0, 80.0),
            ] {
                let camera = Camera::look_at(eye, DVec3::splat(16.0), 40.0, 40, 30).unwrap();
                let (a, counters) = one.render(&camera, &settings).unwrap();
                let (b, _) = eight.render(&camera, &settings).unwrap();
                assert!(counters.rays_hit > 300 && counters.samples > 5000);
                for (k, (a, b)) in a.pixels.iter().zip(&b.pixels).enumerate() {
                    let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                    assert!(worst < 1e-6, "{layout:?} {bias} {eye} pixel {k}: {a:?} {b:?}");
                }
            }
        }
    }
}

#[test]
fn footprints_from_tiny_to_huge_are_finite() {
    for layout in LAYOUTS {
        let reference = one_tree(layout);
        for exponent in -30..30 {
            for direction in [dvec3(1.0, 0.3, 0.2), dvec3(0.2, -1.0, 0.001), DVec3::NEG_Z] {
                let footprint = f64::from(exponent).exp2();
                let (rgba, _) = shoot(&reference, dvec3(9.1, 8.0, 16.0), direction, footprint, 1.0);
                assert!(rgba[3] > 0.1, "{footprint} {direction}: {rgba:?}");
            }
        }
    }
}
