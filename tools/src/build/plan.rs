//! Which trees a terrain needs: the columns of trees that inputs reach, and the range of heights in each.

use std::collections::BTreeMap;

use glam::DVec3;

use super::bins::Bins;
use super::error::BuildError;
use super::lattice::{Lattice, TreePlace};
use crate::input::Layer;

/// Farthest cell from the origin of the lattice.
const MAX_CELL: f64 = (1u64 << 40) as f64;
/// Most columns of trees, and most trees.
pub(super) const MAX_TREES: usize = brickfell_formats::scene::MAX_ITEMS;
/// Solid ground goes on below the lowest height for this many root voxels, so that it is opaque at every level.
const SOLID_ROOT_VOXELS: i64 = 2;

/// A column of trees.
#[derive(Debug, Default)]
pub(crate) struct TreeColumn {
    /// Lowest solid cell, where there is ground.
    pub(crate) bottom: Option<i64>,
    /// Heights that trees must cover: lowest cell, and the one above the highest; multiples of the root voxel.
    range: Option<(i64, i64)>,
}

/// All columns of trees by (x, y) in tree sides.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) columns: BTreeMap<(i64, i64), TreeColumn>,
    pub(crate) trees: Vec<TreePlace>,
}

impl TreeColumn {
    fn cover(&mut self, lo: i64, hi: i64) {
        self.range = Some(self.range.map_or((lo, hi), |(l, h)| (l.min(lo), h.max(hi))));
    }
}

impl Plan {
    /// Plans the trees.
    ///
    /// # Errors
    /// Inputs too far from the origin for the lattice, or too many trees.
    pub(crate) fn new(lattice: &Lattice, layers: &[Layer], faces: &Bins) -> Result<Self, BuildError> {
        let mut columns = BTreeMap::new();
        for layer in layers {
            add_layer(lattice, layer, &mut columns)?;
        }
        for (at, (low, high)) in &faces.columns {
            let r = lattice.root_voxel();
            let root = |z: f64| (z.floor() as i64).div_euclid(r);
            column(lattice, &mut columns, *at)?.cover((root(*low) - 1) * r, (root(*high) + 2) * r);
        }
        let mut trees = Vec::new();
        for ((x, y), column) in &columns {
            let Some((lo, hi)) = column.range else { continue };
            let side = lattice.side();
            let count = ((hi - lo + side - 1) / side) as usize;
            if trees.len() + count > MAX_TREES {
                return Err(BuildError::TooManyTrees {
                    limit: MAX_TREES,
                    voxel: lattice.voxel,
                    tree: side,
                });
            }
            trees.extend((0..count as i64).map(|k| TreePlace {
                origin: [x * side, y * side, lo + k * side],
            }));
        }
        Ok(Self { columns, trees })
    }

    /// Lowest solid cell of a column of trees.
    pub(crate) fn bottom(&self, column: (i64, i64)) -> Option<i64> {
        self.columns.get(&column).and_then(|c| c.bottom)
    }
}

/// Whether a place (cells) is on the lattice.
///
/// # Errors
/// If it is too far from the origin.
pub(super) fn check(lattice: &Lattice, p: DVec3) -> Result<(), BuildError> {
    if p.abs().max_element() <= MAX_CELL {
        Ok(())
    } else {
        Err(BuildError::TooLarge {
            metres: p.abs().max_element() * lattice.voxel,
            voxel: lattice.voxel,
        })
    }
}

type Columns = BTreeMap<(i64, i64), TreeColumn>;

fn column<'a>(
    lattice: &Lattice,
    columns: &'a mut Columns,
    at: (i64, i64),
) -> Result<&'a mut TreeColumn, BuildError> {
    if columns.len() >= MAX_TREES && !columns.contains_key(&at) {
        return Err(BuildError::TooManyTrees {
            limit: MAX_TREES,
            voxel: lattice.voxel,
            tree: lattice.side(),
        });
    }
    Ok(columns.entry(at).or_default())
}

fn add_layer(lattice: &Lattice, layer: &Layer, columns: &mut Columns) -> Result<(), BuildError> {
    let (min, max) = layer.map.bounds();
    let (low, high) = layer.map.min_max();
    check(lattice, lattice.cells_of(min.extend(low.into())))?;
    check(lattice, lattice.cells_of(max.extend(high.into())))?;
    let (lo, hi) = layer.extent(lattice);
    let (first, last) = (
        lattice.column_of(lo[0], lo[1]),
        lattice.column_of(hi[0] - 1, hi[1] - 1),
    );
    if (last.0 - first.0 + 1).saturating_mul(last.1 - first.1 + 1) > MAX_TREES as i64 {
        return Err(BuildError::TooManyTrees {
            limit: MAX_TREES,
            voxel: lattice.voxel,
            tree: lattice.side(),
        });
    }
    let (n, r) = (lattice.side(), lattice.root_voxel());
    for y in first.1..=last.1 {
        for x in first.0..=last.0 {
            let Some((low, high)) = layer.range(lattice, [x * n, y * n], [(x + 1) * n, (y + 1) * n]) else {
                continue;
            };
            // Voxels beside the column, too: a cliff at its edge fills them in part only, and solid has to be behind.
            let beside = layer.range(
                lattice,
                [x * n - r, y * n - r],
                [(x + 1) * n + r, (y + 1) * n + r],
            );
            let low = beside.map_or(low, |beside| beside.0);
            let root = |z: f64| (z.floor() as i64).div_euclid(r);
            let bottom = (root(low) - SOLID_ROOT_VOXELS) * r;
            let column = column(lattice, columns, (x, y))?;
            column.bottom = Some(column.bottom.map_or(bottom, |b| b.min(bottom)));
            column.cover(bottom, (root(high) + 2) * r);
        }
    }
    Ok(())
}

/// Least and greatest height of the part of a triangle over a rectangle (x0, y0, x1, y1), if there is one.
pub(super) fn heights_inside(triangle: &[DVec3; 3], rectangle: [f64; 4]) -> Option<(f64, f64)> {
    let mut polygon = triangle.to_vec();
    let [x0, y0, x1, y1] = rectangle;
    for (axis, sign, limit) in [(0, 1.0, x0), (1, 1.0, y0), (0, -1.0, -x1), (1, -1.0, -y1)] {
        let inside = |p: &DVec3| p[axis] * sign - limit;
        let mut clipped = Vec::with_capacity(polygon.len() + 1);
        for (k, p) in polygon.iter().enumerate() {
            let q = &polygon[(k + 1) % polygon.len()];
            let (dp, dq) = (inside(p), inside(q));
            if dp >= 0.0 {
                clipped.push(*p);
            }
            if (dp >= 0.0) != (dq >= 0.0) {
                clipped.push(*p + (*q - *p) * (dp / (dp - dq)));
            }
        }
        polygon = clipped;
    }
    let heights = || polygon.iter().map(|p| p.z);
    let range = (
        heights().fold(f64::INFINITY, f64::min),
        heights().fold(f64::NEG_INFINITY, f64::max),
    );
    (range.0 <= range.1).then_some(range)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_inside_a_rectangle() {
        let t = [
            DVec3::new(0.0, 0.0, 0.0),
            DVec3::new(10.0, 0.0, 10.0),
            DVec3::new(0.0, 10.0, 0.0),
        ];
        assert_eq!(heights_inside(&t, [2.0, 0.0, 4.0, 1.0]), Some((2.0, 4.0)));
        assert_eq!(heights_inside(&t, [6.0, 6.0, 8.0, 8.0]), None);
        assert_eq!(heights_inside(&t, [-5.0, -5.0, 50.0, 50.0]), Some((0.0, 10.0)));
    }
}
