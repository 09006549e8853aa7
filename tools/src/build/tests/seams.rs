//! Borders, constants and the cut into trees.

use super::super::filter::Target;
use super::super::finest::{Sources, voxelise};
use super::super::ground::{GroundGrid, Hints};
use super::super::lattice::TreePlace;
use super::super::plan::Plan;
use super::super::texels::TexelLevel;
use super::*;

const VOXEL: f64 = 0.225;

fn db(inputs: &Inputs, tree: u32, layout: SampleLayout, filter: Filter) -> Db {
    let folder = tempfile::tempdir().unwrap();
    build_filtered(folder.path(), inputs, VOXEL, tree, layout, filter);
    Db::read(
        folder.path(),
        Lattice {
            voxel: VOXEL,
            depth: (tree / 8).ilog2() as u8,
            layout,
        },
    )
}

#[test]
fn large_and_small_trees_store_the_same_samples() {
    for (layout, filter) in layouts_and_filters() {
        // All of it in one large tree, and in 2×2 columns of small ones.
        let inputs = hills(DVec2::splat(5.0));
        let large = db(&inputs, 128, layout, filter);
        let small = db(&inputs, 64, layout, filter);
        assert_eq!((large.trees, small.trees), (1, 6));
        assert_eq!(large.surface_voxels, small.surface_voxels);
        // Solid goes down by root voxels, which are not the same; compare above.
        let bottom = |lattice: &Lattice| {
            let plan = Plan::new(lattice, &inputs.layers, &bins(&inputs, *lattice)).unwrap();
            plan.columns.values().filter_map(|c| c.bottom).max().unwrap()
        };
        let bottom = bottom(&large.lattice).max(bottom(&small.lattice));
        let mut compared = [0usize; 4];
        // A root's voxels have no neighbours that are known, so skins by coverage are judged by other rules there.
        let levels = if filter.covers() { 3 } else { 4 };
        for mip in 0..levels {
            let above = |cell: [i64; 3]| (cell[2] - 1) << mip >= bottom;
            let keys = large.samples.keys().chain(small.samples.keys());
            for (_, cell) in keys.filter(|k| k.0 == mip && above(k.1)) {
                let values = [&large, &small].map(|db| db.samples.get(&(mip, *cell)).copied());
                // In the corner layout a sample on the outermost faces may belong to a tree that is not there.
                if layout == SampleLayout::Centre || values.iter().all(Option::is_some) {
                    let [mut a, b] = values.map(Option::unwrap_or_default);
                    // Deep solid takes its look from its neighbours, in the coarsest level from the ground above.
                    let deep = [SOLID_ALPHA; 3];
                    if mip > 2 && (a.2, b.2) == (deep, deep) {
                        (a.0, a.1) = (b.0, b.1);
                    }
                    assert!(
                        same(a, b),
                        "{layout:?} {filter:?} mip {mip} {cell:?}: {a:?} {b:?}"
                    );
                }
                compared[usize::from(mip)] += usize::from(values.iter().flatten().any(|v| v.0[3] > 0));
            }
        }
        assert!(
            compared[..usize::from(levels)].iter().all(|n| *n > 30),
            "{compared:?}"
        );
    }
}

#[test]
fn neighbouring_trees_agree_about_the_samples_that_both_store() {
    for (layout, filter) in layouts_and_filters() {
        // Reading compares them, at all levels up to the root.
        let db = db(&hills(DVec2::ZERO), 128, layout, filter);
        assert_eq!((db.trees, db.lattice.depth), (4, 4));
    }
}

#[test]
fn constants_expand_to_what_bricks_would_store() {
    for (layout, filter) in layouts_and_filters() {
        let inputs = hills(DVec2::ZERO);
        let db = db(&inputs, 64, layout, filter);
        assert!(db.constants > 10);
        let lattice = db.lattice;
        let bins = bins(&inputs, lattice);
        let plan = Plan::new(&lattice, &inputs.layers, &bins).unwrap();
        for place in &plan.trees {
            let region = lattice.tree(TreePlace { origin: place.origin });
            let support = region.support(0);
            let grids: Vec<_> = inputs
                .layers
                .iter()
                .filter_map(|l| GroundGrid::new(l, &lattice, &support).unwrap())
                .collect();
            // Trees of this size are one tile each.
            let faces = bins.near(region.own.lo, &support).unwrap();
            let (mut samples, _) = voxelise(&Sources {
                lattice,
                region,
                grids: &grids,
                bottom: &|c| plan.bottom(c),
                materials: &bins.materials,
                faces: &faces,
                inside: None,
                by: Voxelise::Conservative,
                covers: filter.covers(),
            })
            .unwrap();
            let mut hints = Hints::finest(&grids, &support);
            for mip in 0..=lattice.depth {
                if mip > 0 {
                    let cells = region.support(mip);
                    hints = hints.coarser(layout, &cells);
                    samples = samples.coarser(filter, &Target { layout, mip, cells });
                }
                let area = region.stored(layout, mip);
                let texels = TexelLevel::new(
                    &samples.samples,
                    samples.skins(filter, mip < lattice.depth),
                    Steps::within(0),
                    &hints,
                    area,
                    &region.support(mip),
                );
                let side = area.hi[0] - area.lo[0];
                for k in 0..side * side * side {
                    let cell = [
                        area.lo[0] + k % side,
                        area.lo[1] + k / side % side,
                        area.lo[2] + k / side / side,
                    ];
                    let texel = texels.at(cell);
                    let (color, [nx, ny, nz, _]) = (texel.stored.color, texel.stored.normal);
                    let [x, y, z] = match filter {
                        Filter::Axes => [0, 1, 2].map(|k| texel.opacity[k]),
                        _ => [color[3]; 3],
                    };
                    let made = (color, [nx, ny, nz], [x, y, z]);
                    let stored = db.at(mip, cell);
                    assert!(same(stored, made), "mip {mip} {cell:?}: {stored:?} {made:?}");
                }
            }
        }
    }
}

#[test]
fn cells_without_heights_are_empty_all_the_way_down() {
    let inputs = hills(DVec2::ZERO);
    let db = db(&inputs, 64, SampleLayout::Centre, Filter::default());
    let cell = |v: f64| (v / VOXEL).floor() as i64;
    let column =
        |x: f64, y: f64| -> Vec<u8> { (-40..40).map(|z| db.at(0, [cell(x), cell(y), z]).0[3]).collect() };
    assert!(column(10.0, 4.0).iter().all(|a| *a == 0));
    let ground = column(15.0, 4.0);
    assert!(ground.iter().filter(|a| **a == SOLID_ALPHA).count() > 8);
    assert_eq!(
        ground.iter().rev().skip_while(|a| **a == 0).count(),
        ground.iter().rposition(|a| *a > 0).unwrap() + 1
    );
}

#[test]
fn clear_texels_leave_no_voxels() {
    let half = |alpha: u8| Raster {
        width: 64,
        height: 1,
        pixels: (0..64)
            .map(|k| [255, 255, 255, if k < 32 { alpha } else { 255 }])
            .collect(),
    };
    let count = |alpha: u8| {
        let mesh = sheet(
            DVec3::splat(0.5),
            DVec3::X * 16.0,
            DVec3::Y * 16.0,
            Some(half(alpha)),
        );
        let folder = tempfile::tempdir().unwrap();
        let inputs = Inputs {
            layers: vec![],
            meshes: vec![mesh],
        };
        let report = build_into(folder.path(), &inputs, 0.25, 64, SampleLayout::Centre);
        report.surface_voxels
    };
    let (whole, cut) = (count(255), count(0));
    assert_eq!(whole, 65 * 65);
    // Interpolation between texels leaves a voxel or two on either side of the clear half.
    assert!((65 * 33..=65 * 36).contains(&cut), "{cut}");
}

#[test]
fn a_speck_is_found_below_levels_that_do_not_show_it() {
    let speck = sheet(DVec3::splat(30.1), DVec3::X * 0.01, DVec3::Y * 0.01, None);
    let folder = tempfile::tempdir().unwrap();
    // By coverage it does not show at the finest level either.
    build_filtered(
        folder.path(),
        &Inputs {
            layers: vec![],
            meshes: vec![speck],
        },
        0.25,
        256,
        SampleLayout::Centre,
        Filter::Double,
    );
    let lattice = Lattice {
        voxel: 0.25,
        depth: 5,
        layout: SampleLayout::Centre,
    };
    let db = Db::read(folder.path(), lattice);
    assert_eq!(db.at(5, [3; 3]), Value::default());
    assert_eq!((db.at(0, [120; 3]).0[3], db.surface_voxels), (255, 1));
}
