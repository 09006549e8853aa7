//! The cells that triangles meet, by bins and tiles, against a test of every triangle with every cell.

use proptest::prelude::*;

use super::super::finest::{Sources, voxelise};
use super::super::overlap::tests::separation;
use super::super::plan::Plan;
use super::super::tile::tiles;
use super::*;

/// What is nearer than this to being met, in voxels, may count or not.
const BAND: f64 = 1e-6;

/// Triangles given in cells around `far`: all cells that tiles say are met, and no others, are so by separating axes.
fn check(triangles: &[[DVec3; 3]], far: DVec3) {
    let lattice = Lattice {
        voxel: 0.5,
        depth: 2,
        layout: SampleLayout::Centre,
    };
    let moved: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|p| p + far)).collect();
    let mesh = Mesh {
        positions: moved.iter().flatten().map(|p| *p * lattice.voxel).collect(),
        triangles: (0..moved.len() as u32)
            .map(|k| Triangle {
                v: [3 * k, 3 * k + 1, 3 * k + 2],
                uv: [Vec2::ZERO; 3],
                n: None,
                material: 0,
            })
            .collect(),
        materials: vec![Material {
            name: String::new(),
            color: [1.0; 4],
            texture: None,
            cutout: false,
        }],
        ..Mesh::default()
    };
    let inputs = Inputs {
        layers: vec![],
        meshes: vec![mesh],
    };
    let bins = bins(&inputs, lattice);
    let plan = Plan::new(&lattice, &[], &bins).unwrap();
    let mut met = std::collections::HashSet::new();
    for tile in plan.trees.iter().flat_map(|tree| tiles(&lattice, *tree)) {
        let faces = bins.near(tile.region.own.lo, &tile.region.support(0)).unwrap();
        let (level, count) = voxelise(&Sources {
            lattice,
            region: tile.region,
            grids: &[],
            bottom: &|_| None,
            materials: &bins.materials,
            faces: &faces,
            inside: None,
            by: Voxelise::Conservative,
            covers: false,
        })
        .unwrap();
        let own = tile.region.own;
        let before = met.len();
        for z in own.lo[2]..own.hi[2] {
            for y in own.lo[1]..own.hi[1] {
                for x in own.lo[0]..own.hi[0] {
                    if let super::super::cells::Cell::Held(sample) = level.samples.at([x, y, z])
                        && sample.weight > 0.0
                    {
                        met.insert([x, y, z]);
                    }
                }
            }
        }
        assert_eq!(count.count as usize, met.len() - before);
    }
    let corners = || moved.iter().flatten();
    let lo = corners().fold(DVec3::INFINITY, |m, p| m.min(*p)).floor() - 2.0;
    let hi = corners().fold(DVec3::NEG_INFINITY, |m, p| m.max(*p)).floor() + 2.0;
    let mut inside = 0;
    for z in lo.z as i64..=hi.z as i64 {
        for y in lo.y as i64..=hi.y as i64 {
            for x in lo.x as i64..=hi.x as i64 {
                let cell = DVec3::new(x as f64, y as f64, z as f64) - far;
                let gap = triangles
                    .iter()
                    .map(|t| separation(t, cell))
                    .fold(f64::INFINITY, f64::min);
                let found = met.contains(&[x, y, z]);
                inside += usize::from(found);
                assert!(gap > -BAND || found, "missing {x} {y} {z}: {gap}");
                assert!(gap < BAND || !found, "extra {x} {y} {z}: {gap}");
            }
        }
    }
    assert_eq!(inside, met.len(), "cells outside all triangles");
}

fn point(range: f64) -> impl Strategy<Value = DVec3> {
    (-range..range, -range..range, -range..range).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

fn triangle() -> impl Strategy<Value = [DVec3; 3]> {
    let lattice = |p: DVec3| p.round();
    prop_oneof![
        (point(20.0), point(20.0), point(20.0)).prop_map(|(a, b, c)| [a, b, c]),
        // Slivers, and specks.
        (point(20.0), point(20.0), point(1e-3)).prop_map(|(a, b, c)| [a, b, b + c]),
        (point(20.0), point(0.05), point(0.05)).prop_map(|(a, b, c)| [a, a + b, a + c]),
        // Corners of voxels, and planes between them.
        (point(20.0), point(20.0), point(20.0)).prop_map(move |(a, b, c)| [a, b, c].map(lattice)),
        (point(20.0), point(20.0), point(20.0))
            .prop_map(move |(a, b, c)| { [a, b, c].map(|p| DVec3::new(p.x, p.y, a.z.round())) }),
    ]
    .prop_filter("area", |[a, b, c]| (*b - *a).cross(*c - *a).length() > 1e-6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn tiles_have_the_cells_of_the_brute_force_test(soup in prop::collection::vec(triangle(), 1..6)) {
        check(&soup, DVec3::ZERO);
    }

    #[test]
    fn far_from_the_origin_too(soup in prop::collection::vec(triangle(), 1..4), x in -2e7..2e7f64, y in -2e7..2e7f64) {
        // Corners that 64 bits keep exactly at that distance: what is tested are the cells, not the file's rounding.
        let exact = |p: DVec3| (p * 1024.0).round() / 1024.0;
        let soup: Vec<_> = soup.into_iter().map(|t| t.map(exact)).collect();
        prop_assume!(soup.iter().all(|[a, b, c]| (*b - *a).cross(*c - *a).length() > 1e-4));
        check(&soup, DVec3::new(x.round(), y.round(), -3.0));
    }
}
