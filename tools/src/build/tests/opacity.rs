//! What coarse levels look like: ground stays opaque, solid never tints.

use super::*;
use brickfell_formats::value::decode_color;

/// Greatest opacity on the vertical line over a point (cells of the mip, as positions), interpolated.
fn opacity_above(db: &Db, mip: u8, x: f64, y: f64, heights: std::ops::Range<i64>) -> f64 {
    let offset = db.lattice.layout.sample_offset();
    let (x, y) = (x - offset, y - offset);
    let alpha = |cell: [i64; 3]| f64::from(db.at(mip, cell).0[3]) / 255.0;
    let layer = |z: i64| {
        let (i, j) = (x.floor() as i64, y.floor() as i64);
        let (tx, ty) = (x - x.floor(), y - y.floor());
        let row = |j: i64| alpha([i, j, z]) * (1.0 - tx) + alpha([i + 1, j, z]) * tx;
        row(j) * (1.0 - ty) + row(j + 1) * ty
    };
    // Linear between layers: the greatest value lies on one.
    heights.map(|z| (2.0 * layer(z)).min(1.0)).fold(0.0, f64::max)
}

fn check(inputs: &Inputs, layout: SampleLayout, filter: Filter, inside: impl Fn(f64, f64, f64) -> bool) {
    let folder = tempfile::tempdir().unwrap();
    let (voxel, tree) = (0.25, 64);
    build_filtered(folder.path(), inputs, voxel, tree, layout, filter);
    let db = Db::read(
        folder.path(),
        Lattice {
            voxel,
            depth: 3,
            layout,
        },
    );
    for mip in 0..=3u8 {
        let side = voxel * f64::from(1 << mip);
        let mut lines = 0;
        for k in 0..1600 {
            let (x, y) = (f64::from(k % 40) * 0.507, f64::from(k / 40) * 0.507);
            if !inside(x, y, side) {
                continue;
            }
            lines += 1;
            let opacity = opacity_above(&db, mip, x / side, y / side, -40 >> mip..160 >> mip);
            assert!(
                opacity > 0.99,
                "{layout:?} {filter:?} mip {mip} at {x} {y}: {opacity}"
            );
        }
        assert!(lines > 300);
    }
}

#[test]
fn hilly_ground_is_opaque_at_every_level() {
    for (layout, filter) in layouts_and_filters() {
        let height = |x: f64, y: f64| 20.0 + 3.0 * (x * 1.3).sin() + 2.0 * (y * 2.1 + x).cos();
        let ground = layer(80, 0.25, DVec2::ZERO, height);
        let within = |v: f64, side: f64| v > side && v < 20.0 - side;
        check(
            &Inputs {
                layers: vec![ground],
                meshes: vec![],
            },
            layout,
            filter,
            |x, y, s| within(x, s) && within(y, s),
        );
    }
}

#[test]
fn an_open_sheet_is_opaque_at_every_level_whatever_its_tilt() {
    // The mean turns planes to glass, and its power only slows that down.
    for (layout, filter) in layouts_and_filters().filter(|f| ![Filter::Mean, Filter::Pow].contains(&f.1)) {
        for (a, b) in [(0.0, 0.0), (0.1, 0.03), (0.45, -0.3), (1.0, 0.7)] {
            for lift in [0.0, 0.13] {
                let (u, v) = (DVec3::new(20.0, 0.0, 20.0 * a), DVec3::new(0.0, 20.0, 20.0 * b));
                let mesh = sheet(DVec3::new(0.0, 0.0, 4.0 + lift), u, v, None);
                let within = |v: f64, side: f64| v > 1.5 * side && v < 20.0 - 1.5 * side;
                let inputs = Inputs {
                    layers: vec![],
                    meshes: vec![mesh],
                };
                check(&inputs, layout, filter, |x, y, s| within(x, s) && within(y, s));
            }
        }
    }
}

#[test]
fn coarse_ground_has_the_mean_colour_of_its_surface() {
    for (layout, filter) in layouts_and_filters() {
        let flat = layer(64, 0.5, DVec2::ZERO, |_, _| 3.3);
        let checks = painted(flat, |c, r| {
            if (c + r) % 2 == 0 {
                [255, 0, 0]
            } else {
                [0, 255, 0]
            }
        });
        let folder = tempfile::tempdir().unwrap();
        let inputs = Inputs {
            layers: vec![checks],
            meshes: vec![],
        };
        let report = build_filtered(folder.path(), &inputs, 0.5, 64, layout, filter);
        let db = Db::read(
            folder.path(),
            Lattice {
                voxel: 0.5,
                depth: 3,
                layout,
            },
        );
        if layout == SampleLayout::Centre {
            assert_eq!(report.surface_voxels, 64 * 64);
        }
        for mip in 1..=3 {
            let middle = 32 >> mip;
            let column = (-8..20)
                .rev()
                .map(|z| db.at(mip, [middle, middle, z]).0)
                .find(|c| c[3] > 60)
                .unwrap();
            let [r, g, b, a] = decode_color(column);
            assert!(
                (r / a - 0.5).abs() < 0.02 && (g / a - 0.5).abs() < 0.02 && b == 0.0,
                "{mip} {column:?}"
            );
        }
    }
}

#[test]
fn a_dark_hint_under_bright_ground_does_not_show() {
    // Steep ground, where much solid shares a coarse voxel with little surface.
    let steep = layer(64, 0.5, DVec2::ZERO, |x, _| 2.0 + 0.8 * x);
    let red = painted(steep, |_, _| [255, 0, 0]);
    let folder = tempfile::tempdir().unwrap();
    build_into(
        folder.path(),
        &Inputs {
            layers: vec![red],
            meshes: vec![],
        },
        0.5,
        64,
        SampleLayout::Centre,
    );
    let db = Db::read(
        folder.path(),
        Lattice {
            voxel: 0.5,
            depth: 3,
            layout: SampleLayout::Centre,
        },
    );
    for ((mip, cell), (color, ..)) in &db.samples {
        let [r, g, b, a] = decode_color(*color);
        assert!(
            a == 0.0 || (r / a > 0.97 || a < 0.02) && g == 0.0 && b == 0.0,
            "{mip} {cell:?} {color:?}"
        );
    }
}
