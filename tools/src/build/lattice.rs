//! The global voxel lattice and the places of trees on it.
//!
//! Cell `i` of mip `m` stands for the sample with that index at a level whose voxel is `2^m` finest voxels (mip 0 is the
//! finest level of a tree, mip `depth` its root). In *cell coordinates* finest cell `i` is the interval `[i, i+1)`:
//! `world / voxel`, shifted by half a voxel in the corner layout, where a sample stands for the half voxels around it.
//! Nothing here depends on a tree, so trees that share samples agree about them.

use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use glam::DVec3;

/// Voxels of a brick, and of a block of samples, per axis.
pub(crate) const SIDE: i64 = BRICK_VOXELS as i64;

/// The lattice of a terrain: one voxel size, trees of one depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lattice {
    /// Finest voxel, metres.
    pub(crate) voxel: f64,
    /// Deepest level of every tree.
    pub(crate) depth: u8,
    /// Where samples lie.
    pub(crate) layout: SampleLayout,
}

/// A tree's place: the low corner in finest voxels. X and Y are multiples of the tree's side, Z of the root voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct TreePlace {
    pub(crate) origin: [i64; 3],
}

/// A box of finest cells that is made at a time, with the levels above it: a tree, or a tile of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Region {
    /// Its own finest cells.
    pub(crate) own: CellBox,
    /// The coarsest mip that is made of it. Its margin is one cell of that.
    pub(crate) top: u8,
}

/// A half-open box of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CellBox {
    pub(crate) lo: [i64; 3],
    pub(crate) hi: [i64; 3],
}

impl Lattice {
    /// Finest voxels of a tree per axis.
    pub(crate) fn side(&self) -> i64 {
        SIDE << self.depth
    }

    /// Finest voxels of a voxel of the root brick: the margin from which a tree's coarsest apron is made.
    pub(crate) fn root_voxel(&self) -> i64 {
        1 << self.depth
    }

    /// Distance, in voxels, from a cell's low face to the place that its index names.
    pub(crate) fn shift(&self) -> f64 {
        0.5 - self.layout.sample_offset()
    }

    /// Cell coordinate of a world coordinate.
    pub(crate) fn cell_of(&self, world: f64) -> f64 {
        world / self.voxel + self.shift()
    }

    /// Cell coordinates of a world position.
    pub(crate) fn cells_of(&self, world: DVec3) -> DVec3 {
        world / self.voxel + self.shift()
    }

    /// Low corner of a tree in the world, metres.
    pub(crate) fn tree_corner(&self, place: TreePlace) -> DVec3 {
        DVec3::from_array(place.origin.map(|o| o as f64 * self.voxel))
    }

    /// The column of trees that has a finest cell.
    pub(crate) fn column_of(&self, x: i64, y: i64) -> (i64, i64) {
        (x.div_euclid(self.side()), y.div_euclid(self.side()))
    }

    /// A tree as a region: all its levels up to the root.
    pub(crate) fn tree(&self, place: TreePlace) -> Region {
        Region {
            own: self.own(place),
            top: self.depth,
        }
    }

    /// A tree's own finest cells.
    pub(crate) fn own(&self, place: TreePlace) -> CellBox {
        CellBox {
            lo: place.origin,
            hi: place.origin.map(|o| o + self.side()),
        }
    }

    /// Name of a tree's folder. Z counts root voxels.
    pub(crate) fn tree_name(&self, place: TreePlace) -> String {
        let [x, y, z] = place.origin;
        let (n, r) = (self.side(), self.root_voxel());
        format!("x{}_y{}_z{}", x.div_euclid(n), y.div_euclid(n), z.div_euclid(r))
    }
}

impl Region {
    /// Its own cells of a mip.
    pub(crate) fn cells(&self, mip: u8) -> CellBox {
        CellBox {
            lo: self.own.lo.map(|v| v >> mip),
            hi: self.own.hi.map(|v| v >> mip),
        }
    }

    /// Cells of a mip that its bricks of this level, and what it makes of all coarser ones, are made from.
    pub(crate) fn support(&self, mip: u8) -> CellBox {
        self.cells(mip).grown(1 << (self.top - mip))
    }

    /// Cells of a mip that are stored in its bricks, aprons included.
    pub(crate) fn stored(&self, layout: SampleLayout, mip: u8) -> CellBox {
        let low = i64::from(layout.low_apron());
        let high = i64::from(layout.side()) - SIDE - low;
        let CellBox { lo, hi } = self.cells(mip);
        CellBox {
            lo: lo.map(|v| v - low),
            hi: hi.map(|v| v + high),
        }
    }
}

impl CellBox {
    /// The smallest box of whole blocks around it, in blocks.
    pub(crate) fn blocks(&self) -> CellBox {
        CellBox {
            lo: self.lo.map(|v| v.div_euclid(SIDE)),
            hi: self.hi.map(|v| (v + SIDE - 1).div_euclid(SIDE)),
        }
    }

    /// The box with so many more cells on each side.
    pub(crate) fn grown(&self, by: i64) -> CellBox {
        CellBox {
            lo: self.lo.map(|v| v - by),
            hi: self.hi.map(|v| v + by),
        }
    }

    /// The cells that two boxes share; empty boxes have `lo >= hi` on some axis.
    pub(crate) fn intersection(&self, other: &CellBox) -> CellBox {
        CellBox {
            lo: std::array::from_fn(|k| self.lo[k].max(other.lo[k])),
            hi: std::array::from_fn(|k| self.hi[k].min(other.hi[k])),
        }
    }

    /// Whether there is no cell in it.
    pub(crate) fn is_empty(&self) -> bool {
        (0..3).any(|k| self.lo[k] >= self.hi[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn support_of_a_level_covers_what_the_next_coarser_one_reads() {
        for layout in [SampleLayout::Corner, SampleLayout::Centre] {
            let lattice = Lattice {
                voxel: 0.5,
                depth: 4,
                layout,
            };
            let place = TreePlace {
                origin: [-128, 256, -48],
            };
            let tree = lattice.tree(place);
            for mip in 0..4 {
                let (fine, coarse) = (tree.support(mip), tree.stored(layout, mip + 1));
                let taps = match layout {
                    SampleLayout::Centre => (0, 1),
                    SampleLayout::Corner => (-1, 1),
                };
                for k in 0..3 {
                    assert!(2 * coarse.lo[k] + taps.0 >= fine.lo[k]);
                    assert!(2 * (coarse.hi[k] - 1) + taps.1 < fine.hi[k]);
                }
            }
        }
    }

    #[test]
    fn a_corner_sample_stands_for_the_half_voxels_around_it() {
        let corner = Lattice {
            voxel: 2.0,
            depth: 0,
            layout: SampleLayout::Corner,
        };
        assert_eq!((corner.cell_of(7.0), corner.cell_of(8.9)), (4.0, 4.95));
        let centre = Lattice {
            layout: SampleLayout::Centre,
            ..corner
        };
        assert_eq!(centre.cell_of(8.0), 4.0);
        assert_eq!(centre.tree_name(TreePlace { origin: [-8, 8, -3] }), "x-1_y1_z-3");
    }
}
