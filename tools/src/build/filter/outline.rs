//! Outlines of triangles in finest voxels: which of a voxel's 8×8 lines along each axis a triangle stops.
//!
//! A line is stopped in the voxel that holds the point where it meets the triangle, so pieces of a surface in voxels behind one
//! another complete each other. Lines stand on an 8×8 grid that is shifted by a hash of the place in the cross-section,
//! lest a pole thinner than their distance is met along all of its length or nowhere.

use glam::DVec3;

use super::coverage::{BITS, Cover, hash};

/// Lines of a voxel per axis of a cross-section.
const LINES: usize = 8;

/// Triangles with a common side both have what is on it.
const BAND: f64 = 1e-9;

/// A side as a bound of u: `at + slope·v`.
#[derive(Clone, Copy, Debug, Default)]
struct Bound {
    at: f64,
    slope: f64,
}

/// A triangle seen along one axis: where its lines are, and how deep it lies there.
#[derive(Clone, Copy, Debug, Default)]
struct View {
    /// Of the sides, for u: lower ones and upper ones, and how many of each.
    lower: [Bound; 3],
    upper: [Bound; 3],
    count: [usize; 2],
    /// Range of v.
    rows: [f64; 2],
    /// Depth over u and v.
    at: f64,
    du: f64,
    dv: f64,
    inverse_du: f64,
}

impl View {
    /// `None` if it is seen edge-on. Corners in (u, v, depth).
    fn new([a, b, c]: [[f64; 3]; 3]) -> Option<Self> {
        let cross = |p: [f64; 3], q: [f64; 3], r: [f64; 3]| {
            (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        };
        let area = cross(a, b, c);
        if area.abs() < 1e-12 {
            return None;
        }
        let mut view = View {
            rows: [a[1].min(b[1]).min(c[1]) - BAND, a[1].max(b[1]).max(c[1]) + BAND],
            ..View::default()
        };
        for (p, q) in [(b, c), (c, a), (a, b)] {
            // Weight of the third corner: its gradient, and its value (0) at p.
            let (gu, gv) = ((p[1] - q[1]) / area, (q[0] - p[0]) / area);
            let bound = Bound {
                at: p[0] + (gv * p[1] - BAND) / gu,
                slope: -gv / gu,
            };
            if gu > 0.0 {
                view.lower[view.count[0]] = bound;
                view.count[0] += 1;
            } else if gu < 0.0 {
                view.upper[view.count[1]] = bound;
                view.count[1] += 1;
            }
        }
        let (bu, bv, bd) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
        let (cu, cv, cd) = (c[0] - a[0], c[1] - a[1], c[2] - a[2]);
        view.du = (bd * cv - cd * bv) / area;
        view.dv = (cd * bu - bd * cu) / area;
        view.inverse_du = 1.0 / view.du;
        view.at = a[2] - view.du * a[0] - view.dv * a[1];
        Some(view)
    }

    /// The lines that stop in a cell, whose first corner is given; `shift` is where the first line stands in the cell.
    fn mask(&self, cell: [f64; 3], shift: [f64; 2]) -> u64 {
        const STEP: f64 = 1.0 / LINES as f64;
        let first = (self.rows[0] - cell[1]) * LINES as f64 - shift[1];
        let last = (self.rows[1] - cell[1]) * LINES as f64 - shift[1];
        let (first, last) = (ceil_clamped(first), floor_clamped(last));
        let mut mask = 0;
        for row in first..=last {
            let v = cell[1] + (f64::from(row) + shift[1]) * STEP;
            let (mut from, mut to) = (cell[0], cell[0] + 1.0);
            for bound in &self.lower[..self.count[0]] {
                from = max(from, bound.at + bound.slope * v);
            }
            for bound in &self.upper[..self.count[1]] {
                to = min(to, bound.at + bound.slope * v);
            }
            // The part of the row that lies in the cell; where depth does not change along it, all or nothing.
            let depth = self.at + self.dv * v - cell[2];
            if self.du == 0.0 {
                if !(0.0..1.0).contains(&depth) {
                    continue;
                }
            } else {
                let (a, b) = (-depth * self.inverse_du, (1.0 - depth) * self.inverse_du);
                (from, to) = (max(from, min(a, b)), min(to, max(a, b)));
            }
            let lines = |u: f64| (u - cell[0]) * LINES as f64 - shift[0];
            let (from, to) = (ceil_clamped(lines(from)), floor_clamped(lines(to)));
            if from <= to {
                mask |= ((1u64 << (to - from + 1)) - 1) << (LINES as i32 * row + from);
            }
        }
        mask
    }
}

/// The larger one; the second if either is no number, which costs less than the rule of `f64::max`.
#[inline]
fn max(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller one; likewise.
#[inline]
fn min(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The first line at or above a place in lines, at least 0.
#[inline]
fn ceil_clamped(x: f64) -> i32 {
    let x = min(max(x, 0.0), LINES as f64);
    let whole = x as i32;
    whole + i32::from(f64::from(whole) < x)
}

/// The last line at or below a place in lines, -1 if there is none.
#[inline]
fn floor_clamped(x: f64) -> i32 {
    (min(max(x, -1.0), (LINES - 1) as f64) + 1.0) as i32 - 1
}

/// A triangle ready for its outlines in cells. Corners are given from a corner of the lattice, `base`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outlines {
    views: [Option<View>; 3],
    base: [i64; 3],
}

impl Outlines {
    pub(crate) fn new(corners: &[DVec3; 3], base: [i64; 3]) -> Self {
        let view = |axis: usize| {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            View::new(corners.map(|p| [p[i], p[j], p[axis]]))
        };
        Self {
            views: [view(0), view(1), view(2)],
            base,
        }
    }

    /// What it covers of a cell.
    pub(crate) fn cover(&self, cell: [i64; 3]) -> Cover {
        let local: [f64; 3] = std::array::from_fn(|k| (cell[k] - self.base[k]) as f64);
        Cover(std::array::from_fn(|axis| {
            let Some(view) = &self.views[axis] else { return 0 };
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            let shift = hash(cell[i], cell[j], axis as i64);
            let shift = [shift, shift >> 32].map(|s| (f64::from(s as u32) + 0.5) * 2f64.powi(-32));
            view.mask([local[i], local[j], local[axis]], shift)
        }))
    }
}

/// A part of an outline: each line is left in with a probability. `key` tells apart what is to be independent.
pub(crate) fn thinned(cover: Cover, part: f32, cell: [i64; 3], key: i64) -> Cover {
    if part >= 1.0 {
        return cover;
    }
    let mut h = hash(hash(cell[0], cell[1], cell[2]) as i64, key, 0);
    Cover(cover.0.map(|mask| {
        (0..BITS).filter(|bit| mask >> bit & 1 == 1).fold(0, |thin, bit| {
            h = h
                .wrapping_mul(0x5851_f42d_4c95_7f2d)
                .wrapping_add(0x1405_7b7e_f767_814f);
            thin | u64::from(((h >> 40) as f32) < part * (1 << 24) as f32) << bit
        })
    }))
}
