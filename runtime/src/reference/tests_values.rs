//! What samples turn into: opacity over paths, filtering, light.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::{SOLID_ALPHA, Stored, srgb_to_linear_f64};
use glam::{DVec3, dvec3};

use super::testing::*;
use crate::settings::RenderSettings;

const LAYOUTS: [SampleLayout; 2] = [SampleLayout::Corner, SampleLayout::Centre];

#[test]
fn constant_nodes_follow_the_closed_form_off_axis() {
    // The same stored alpha at levels 0 and 2 means voxels of 4 m and 1 m, so different densities.
    for (level, alpha) in [(0u8, 1u8), (0, 90), (2, 1), (2, 40), (2, 200)] {
        let mut store = Store::default();
        let head = header(dvec3(-10.0, 3.0, 7.0), 1.0, 2, SampleLayout::Centre, 1);
        let kind = |l, _| {
            if l == level {
                Kind::Leaf([20, 30, 40, alpha])
            } else {
                Kind::Inner([0; 4])
            }
        };
        store.add("t.oct", head, kind, |_, _| Stored::default());
        let reference = store.open(&["t.oct"]);
        let [lo, hi] = head.bounds();
        for k in 0..200 {
            let k = f64::from(k);
            let eye = dvec3(-60.0 + 0.3 * k, -30.0, 20.0 + 5.0 * (k * 0.7).sin());
            let direction = dvec3((k * 0.31).sin(), 1.5, 0.4 * (k * 0.17).cos());
            let path = path_in_box(eye, direction, lo, hi);
            let a = f64::from(alpha) / 255.0;
            let transmittance = (path / head.level_voxel_size(level) * (1.0 - a).ln()).exp();
            let (rgba, counters) = shoot(&reference, eye, direction, 0.0, 1.0);
            let cut = if transmittance < 1.0 / 1024.0 { 1e-3 } else { 1e-12 };
            assert!(
                (1.0 - rgba[3] - transmittance).abs() < cut,
                "{level} {alpha} {k}: {rgba:?} {transmittance}"
            );
            for (c, code) in [20u8, 30, 40].into_iter().enumerate() {
                let expected = srgb_to_linear_f64(code) / a * rgba[3];
                assert!((rgba[c] - expected).abs() < 1e-12, "{rgba:?} {expected}");
            }
            assert_eq!(counters.samples, 0);
        }
    }
}

#[test]
fn a_brick_of_equal_samples_is_a_constant_node() {
    // 16/255 per voxel of level 2 and 31/255 per voxel of level 1, twice as large, are the same density.
    let thin = |level| if level < 2 { [0, 0, 0, 31] } else { [0, 0, 0, 16] };
    let solid = |_| [60, 50, 40, 255];
    let pick = |thick: bool| if thick { solid } else { thin };
    for layout in LAYOUTS {
        for (thick, fade) in [(false, 1.0), (false, 0.0), (false, 0.3), (true, 1.0), (true, 0.0)] {
            let picture = |bricks: bool| {
                let mut store = Store::default();
                let kind = |level, p: glam::UVec3| match (level, p.x & 1) {
                    (2, 1) if bricks => Kind::Brick,
                    (2, _) => Kind::Leaf(pick(thick)(level)),
                    _ => Kind::Brick,
                };
                let head = header(dvec3(1.0, 2.0, 3.0), 0.5, 2, layout, 1);
                let sample = |level, _| Stored {
                    color: pick(thick)(level),
                    normal: [0; 4],
                };
                store.add("t.oct", head, kind, sample);
                let eye = dvec3(-30.0, -20.0, 35.0);
                let camera = Camera::look_at(eye, head.origin + 8.0, 40.0, 24, 16).unwrap();
                let settings = RenderSettings {
                    fade,
                    bias: -2.3,
                    ..RenderSettings::default()
                };
                store.open(&["t.oct"]).render(&camera, &settings).unwrap()
            };
            let ((with, counters), (without, fewer)) = (picture(true), picture(false));
            assert!(counters.samples > fewer.samples && counters.rays_hit > 50);
            for (a, b) in with.pixels.iter().zip(&without.pixels) {
                for (a, b) in a.iter().zip(b) {
                    assert!((a - b).abs() < 1e-4, "{layout:?}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn filtering_is_linear_between_sample_positions() {
    // Alpha grows by 8 codes a sample along x; along a ray in x the middles of the voxels are met.
    for layout in LAYOUTS {
        let mut store = Store::default();
        let head = header(DVec3::ZERO, 0.25, 0, layout, 1);
        store.add(
            "t.oct",
            head,
            |_, _| Kind::Brick,
            |_, p| grey(0, (40 + 8 * p.x) as u8),
        );
        let reference = store.open(&["t.oct"]);
        let transmittance: f64 = (0..8)
            .map(|voxel| 1.0 - (40.0 + 8.0 * (f64::from(voxel) + 0.5 - layout.sample_offset())) / 255.0)
            .product();
        for (eye, direction) in [(-3.0, 1.0), (9.0, -1.0)] {
            let (rgba, counters) = shoot(&reference, dvec3(eye, 0.7, 1.1), DVec3::X * direction, 0.0, 1.0);
            assert!(
                (1.0 - rgba[3] - transmittance).abs() < 1e-12,
                "{layout:?} {rgba:?} {transmittance}"
            );
            assert_eq!(
                (counters.nodes, counters.samples, counters.texture_reads),
                (1, 8, 16)
            );
        }
    }
}

#[test]
fn solid_ground_is_opaque_within_a_voxel_from_everywhere() {
    let color = [120, 130, 140, SOLID_ALPHA];
    let normal = [0, 0, 127, 0];
    let sun = RenderSettings::default().sun;
    for layout in LAYOUTS {
        for brick in [true, false] {
            let mut store = Store::default();
            let head = header(dvec3(-4.0, -4.0, -4.0), 1.0, 0, layout, 2);
            let kind = |_, _| if brick { Kind::Brick } else { Kind::Leaf(color) };
            store.add("t.oct", head, kind, |_, _| Stored { color, normal });
            let reference = store.open(&["t.oct"]);
            let light = if brick { 0.3 + 0.7 * sun.z } else { 1.0 };
            let unit = 255.0 / f64::from(SOLID_ALPHA);
            for direction in sign_patterns() {
                let eye = direction * -20.0 + 0.3;
                let (rgba, counters) = shoot(&reference, eye, direction, 0.0, 1.0);
                assert_eq!(rgba[3], 1.0, "{direction}");
                // Where the ray enters it has only a corner of the first voxel, of the second its whole width.
                let voxels = if brick { 1..=2 } else { 0..=0 };
                assert!(
                    voxels.contains(&counters.samples) && counters.nodes == 1,
                    "{direction} {counters:?}"
                );
                for (c, code) in [120u8, 130, 140].into_iter().enumerate() {
                    let expected = srgb_to_linear_f64(code) * unit * light;
                    assert!(
                        (rgba[c] - expected).abs() < 1e-9,
                        "{direction}: {rgba:?} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn short_normals_fade_to_unlit() {
    let shade = |normal: i8| {
        let mut store = Store::default();
        let head = header(DVec3::ZERO, 1.0, 0, SampleLayout::Centre, 1);
        let sample = Stored {
            color: [255; 4],
            normal: [0, 0, normal, 0],
        };
        store.add("t.oct", head, |_, _| Kind::Brick, |_, _| sample);
        shoot(
            &store.open(&["t.oct"]),
            dvec3(4.2, 4.2, 40.0),
            DVec3::NEG_Z,
            0.0,
            1.0,
        )
        .0[0]
    };
    // The underside gets the ambient light only; an eighth of a normal is enough for full light.
    let (lit, under) = (0.3 + 0.7 * RenderSettings::default().sun.z, 0.3);
    assert!((shade(127) - lit).abs() < 1e-12 && (shade(16) - lit).abs() < 1e-12);
    assert!((shade(-127) - under).abs() < 1e-12);
    assert!((shade(0) - 1.0).abs() < 1e-12);
    assert!((shade(8) - (1.0 + 64.0 / 127.0 * (lit - 1.0))).abs() < 1e-12);
}
