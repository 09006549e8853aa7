//! Where a ray is in a tree, kept so that it can neither turn back nor stand still.
//!
//! Lengths are finest voxels of the tree, from its low corner. All planes at which a segment may end are integers there,
//! at most 2²³, so f64 holds them exactly. A [`Trail`] knows the finest cell that the ray is in as integers; rounding of
//! `origin + z * direction` may push a cell forward by one but never back, and a ray that crosses a plane is put behind
//! it whatever the rounded position says. So every segment that ends at a plane advances a cell by at least one, and
//! the number of segments is bounded by the lattice. Plain values: any thread.

use glam::{DVec3, I64Vec3, i64vec3};

/// A box of finest cells: `lo` inclusive, `hi` exclusive; also the box in space between those planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellBox {
    /// Low corner.
    pub(super) lo: I64Vec3,
    /// High corner.
    pub(super) hi: I64Vec3,
}

impl CellBox {
    /// The box of the aligned cube with a side of `size` cells around a cell.
    pub(super) fn around(cell: I64Vec3, size: i64) -> Self {
        let lo = i64vec3(
            cell.x.div_euclid(size),
            cell.y.div_euclid(size),
            cell.z.div_euclid(size),
        ) * size;
        Self { lo, hi: lo + size }
    }

    /// The box made smaller by `rim` on all sides.
    pub(super) fn shrunk(&self, rim: i64) -> Self {
        Self {
            lo: self.lo + rim,
            hi: self.hi - rim,
        }
    }

    /// True if the box holds the cell.
    pub(super) fn contains(&self, cell: I64Vec3) -> bool {
        self.lo.cmple(cell).all() && cell.cmplt(self.hi).all()
    }
}

/// A ray's way through the lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trail {
    /// The eye.
    origin: DVec3,
    /// What one metre of depth adds.
    direction: DVec3,
    /// The cell the ray is in; it only ever moves in the ray's direction.
    cell: I64Vec3,
}

impl Trail {
    /// The trail of a ray that is at depth `z`, somewhere in a box.
    pub(super) fn new(origin: DVec3, direction: DVec3, z: f64, within: &CellBox) -> Self {
        let mut trail = Self {
            origin,
            direction,
            cell: I64Vec3::ZERO,
        };
        let p = trail.at(z);
        trail.cell = i64vec3(trail.settle(p, 0), trail.settle(p, 1), trail.settle(p, 2))
            .clamp(within.lo, within.hi - 1);
        trail
    }

    /// The position at a depth.
    pub(super) fn at(&self, z: f64) -> DVec3 {
        self.origin + self.direction * z
    }

    /// The cell the ray is in.
    pub(super) fn cell(&self) -> I64Vec3 {
        self.cell
    }

    /// The cell of a position on one axis: a ray that runs downwards and is on a plane is below it.
    fn settle(&self, p: DVec3, axis: usize) -> i64 {
        if self.direction[axis] < 0.0 {
            p[axis].ceil() as i64 - 1
        } else {
            p[axis].floor() as i64
        }
    }

    /// Depth of a plane across an axis that the ray moves along.
    fn depth(&self, plane: i64, axis: usize) -> f64 {
        (plane as f64 - self.origin[axis]) / self.direction[axis]
    }

    /// The plane through which the ray leaves a box on an axis, `None` if it runs parallel.
    fn far_plane(&self, bounds: &CellBox, axis: usize) -> Option<i64> {
        let d = self.direction[axis];
        if d > 0.0 {
            Some(bounds.hi[axis])
        } else if d < 0.0 {
            Some(bounds.lo[axis])
        } else {
            None
        }
    }

    /// Depth at which the ray leaves a box that holds its cell.
    pub(super) fn exit(&self, bounds: &CellBox) -> f64 {
        (0..3)
            .filter_map(|axis| Some(self.depth(self.far_plane(bounds, axis)?, axis)))
            .fold(f64::INFINITY, f64::min)
    }

    /// Moves the ray to depth `z`, and behind the exit planes of `left` that lie no deeper.
    pub(super) fn advance(&mut self, z: f64, left: &CellBox) {
        let p = self.at(z);
        for axis in 0..3 {
            self.push(axis, self.settle(p, axis));
            if let Some(plane) = self.far_plane(left, axis)
                && self.depth(plane, axis) <= z
            {
                self.push_behind(axis, plane);
            }
        }
    }

    fn push_behind(&mut self, axis: usize, plane: i64) {
        self.push(
            axis,
            if self.direction[axis] < 0.0 {
                plane - 1
            } else {
                plane
            },
        );
    }

    fn push(&mut self, axis: usize, cell: i64) {
        let d = self.direction[axis];
        if d > 0.0 {
            self.cell[axis] = self.cell[axis].max(cell);
        } else if d < 0.0 {
            self.cell[axis] = self.cell[axis].min(cell);
        }
    }
}
