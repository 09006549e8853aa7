//! What coarse levels look like: ground stays opaque, solid never tints.

use super::*;
use brickfell_formats::value::decode_color;

/// Skins against the vertical (opacities that may be above 1) of the samples over a point, interpolated. The point is given
/// in cells of the mip.
fn skins_above(db: &Db, mip: u8, x: f64, y: f64, heights: std::ops::Range<i64>) -> Vec<f64> {
    let offset = db.lattice.layout.sample_offset();
    let (x, y) = (x - offset, y - offset);
    let alpha = |cell: [i64; 3]| f64::from(db.at(mip, cell).2[2]) / 255.0;
    let layer = |z: i64| {
        let (i, j) = (x.floor() as i64, y.floor() as i64);
        let (tx, ty) = (x - x.floor(), y - y.floor());
        let row = |j: i64| alpha([i, j, z]) * (1.0 - tx) + alpha([i + 1, j, z]) * tx;
        row(j) * (1.0 - ty) + row(j + 1) * ty
    };
    heights.map(|z| 2.0 * layer(z)).collect()
}

/// The least, over levels and vertical lines inside, of what `opacity` makes of the skins on a line.
fn least(
    inputs: &Inputs,
    layout: SampleLayout,
    filter: Filter,
    opacity: fn(&[f64]) -> f64,
    inside: impl Fn(f64, f64, f64) -> bool,
) -> f64 {
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
    let mut least = 1.0f64;
    for mip in 0..=3u8 {
        let side = voxel * f64::from(1 << mip);
        let mut lines = 0;
        for k in 0..1600 {
            let (x, y) = (f64::from(k % 40) * 0.507, f64::from(k / 40) * 0.507);
            if inside(x, y, side) {
                lines += 1;
                least = least.min(opacity(&skins_above(
                    &db,
                    mip,
                    x / side,
                    y / side,
                    -40 >> mip..160 >> mip,
                )));
            }
        }
        assert!(lines > 300);
    }
    least
}

/// The greatest opacity, which is that of a sample: it is linear between them.
fn greatest(skins: &[f64]) -> f64 {
    skins.iter().fold(0.0, |a, b| a.max(b.min(1.0)))
}

/// What a ray stops, the mean over phases.
fn stopped(skins: &[f64]) -> f64 {
    1.0 - super::filters::through(skins)
}

#[test]
fn hilly_ground_is_opaque_at_every_level() {
    for (layout, filter) in layouts_and_filters() {
        let height = |x: f64, y: f64| 20.0 + 3.0 * (x * 1.3).sin() + 2.0 * (y * 2.1 + x).cos();
        let inputs = Inputs {
            layers: vec![layer(80, 0.25, DVec2::ZERO, height)],
            meshes: vec![],
        };
        let within = |v: f64, side: f64| v > side && v < 20.0 - side;
        let opacity = least(&inputs, layout, filter, greatest, |x, y, s| {
            within(x, s) && within(y, s)
        });
        assert!(opacity > 0.99, "{layout:?} {filter:?}: {opacity}");
    }
}

#[test]
fn an_open_sheet_is_opaque_at_every_level_whatever_its_tilt() {
    // The mean turns planes to glass, and its power only slows that down.
    for (layout, filter) in layouts_and_filters().filter(|f| ![Filter::Mean, Filter::Pow].contains(&f.1)) {
        for (a, b) in [(0.0, 0.0), (0.1, 0.03), (0.45, -0.3), (1.0, 0.7)] {
            for lift in [0.0, 0.13] {
                let (u, v) = (DVec3::new(20.0, 0.0, 20.0 * a), DVec3::new(0.0, 20.0, 20.0 * b));
                let inputs = Inputs {
                    layers: vec![],
                    meshes: vec![sheet(DVec3::new(0.0, 0.0, 4.0 + lift), u, v, None)],
                };
                let within = |v: f64, side: f64| v > 1.5 * side && v < 20.0 - 1.5 * side;
                let inside = |x, y, s| within(x, s) && within(y, s);
                // Twice the mean is opaque at every phase, coverage but for a part of the light where pieces are small.
                let opacity = match filter.covers() {
                    true => least(&inputs, layout, filter, stopped, inside),
                    false => least(&inputs, layout, filter, greatest, inside),
                };
                assert!(opacity > 0.85, "{layout:?} {filter:?} {a} {b}: {opacity}");
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
        // Solid that no surface is near has its colour in steps.
        assert!(
            a == 0.0 || (r / a > 0.92 || a < 0.02) && g < 0.003 * a && b < 0.003 * a,
            "{mip} {cell:?} {color:?}"
        );
    }
}

#[test]
fn the_colour_of_a_plateau_does_not_run_down_its_cliff() {
    // A red cliff between green ground and a white plateau.
    let step = || {
        let step = layer(128, 0.25, DVec2::ZERO, |x, _| if x < 16.0 { 4.0 } else { 20.0 });
        painted(step, |column, _| match column {
            0..62 => [0, 255, 0],
            62..66 => [255, 0, 0],
            _ => [255; 3],
        })
    };
    for layout in [SampleLayout::Corner, SampleLayout::Centre] {
        let folder = tempfile::tempdir().unwrap();
        let layers = vec![step()];
        build_into(
            folder.path(),
            &Inputs {
                layers,
                meshes: vec![],
            },
            0.25,
            128,
            layout,
        );
        let lattice = Lattice {
            voxel: 0.25,
            depth: 4,
            layout,
        };
        let db = Db::read(folder.path(), lattice);
        // The coarsest level does not know the neighbours of all its voxels.
        for mip in 0..=3u8 {
            let (row, up) = (64 >> mip, 48 >> mip);
            let into = (60 >> mip..).map(|x| db.at(mip, [x, row, up]).0);
            let solid: Vec<[u8; 4]> = into.skip_while(|c| c[3] == 0).take(2).collect();
            for color in solid {
                let [r, g, _, a] = decode_color(color);
                assert!(
                    a > 0.0 && r / a > 0.9 && g / a < 0.2,
                    "{layout:?} {mip} {color:?}"
                );
            }
        }
    }
}
