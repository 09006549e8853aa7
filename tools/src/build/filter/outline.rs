//! Outlines of triangles in finest voxels: which of a voxel's 8×8 lines along each axis a triangle stops.
//!
//! A line is stopped in the voxel that holds the point where it meets the triangle, so pieces of a surface in voxels behind one
//! another complete each other. Lines stand on an 8×8 grid that is shifted by a hash of the place in the cross-section,
//! lest a pole thinner than their distance is met along all of its length or nowhere.

use glam::DVec3;

use super::coverage::{BITS, Cover, hash};

/// Rows that are done side by side.
const TOGETHER: usize = 4;

/// So far from the ends of a cell no error of computation matters.
const WITHIN: f64 = 1e-6;

/// Lines of a voxel per axis of a cross-section.
const LINES: usize = 8;

/// Triangles with a common side both have what is on it.
const BAND: f64 = 1e-9;

/// Lower or upper bounds of u by two sides, `at + slope·v` each; one that is no bound is infinite, one alone is there twice.
type Bounds = [(f64, f64); 2];

/// A triangle seen along one axis: where its lines are, and how deep it lies there.
#[derive(Clone, Copy, Debug)]
struct View {
    lower: Bounds,
    upper: Bounds,
    /// Range of v.
    rows: [f64; 2],
    /// Range of depths.
    depths: [f64; 2],
    /// Depth over u and v.
    at: f64,
    du: f64,
    dv: f64,
    inverse_du: f64,
}

/// Bits of a row from a line on, and up to the line before one.
const FROM: [u8; 16] = [255, 254, 252, 248, 240, 224, 192, 128, 0, 0, 0, 0, 0, 0, 0, 0];
const BEFORE: [u8; 16] = [
    0, 1, 3, 7, 15, 31, 63, 127, 255, 255, 255, 255, 255, 255, 255, 255,
];

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
        let (mut lower, mut upper) = ([(f64::NEG_INFINITY, 0.0); 2], [(f64::INFINITY, 0.0); 2]);
        let mut count = [0; 2];
        for (p, q) in [(b, c), (c, a), (a, b)] {
            // Weight of the third corner: its gradient, and its value (0) at p.
            let (gu, gv) = ((p[1] - q[1]) / area, (q[0] - p[0]) / area);
            let bound = (p[0] + (gv * p[1] - BAND) / gu, -gv / gu);
            let (bounds, count) = if gu > 0.0 {
                (&mut lower, &mut count[0])
            } else if gu < 0.0 {
                (&mut upper, &mut count[1])
            } else {
                continue;
            };
            bounds[usize::from(*count > 0)] = bound;
            if *count == 0 {
                bounds[1] = bound;
            }
            *count += 1;
        }
        let (bu, bv, bd) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
        let (cu, cv, cd) = (c[0] - a[0], c[1] - a[1], c[2] - a[2]);
        let du = (bd * cv - cd * bv) / area;
        let dv = (cd * bu - bd * cu) / area;
        Some(View {
            lower,
            upper,
            rows: [a[1].min(b[1]).min(c[1]) - BAND, a[1].max(b[1]).max(c[1]) + BAND],
            depths: [a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2])],
            at: a[2] - du * a[0] - dv * a[1],
            du,
            dv,
            inverse_du: 1.0 / du,
        })
    }

    /// The lines that stop in a cell, whose first corner is given; `shift` is where the first line stands in the cell.
    fn mask(&self, cell: [f64; 3], shift: [f64; 2]) -> u64 {
        let first = (self.rows[0] - cell[1]) * LINES as f64 - shift[1];
        let last = (self.rows[1] - cell[1]) * LINES as f64 - shift[1];
        let (first, last) = (at_or_above(first), past(last));
        if first >= last {
            return 0;
        }
        let inside = self.depths[0] > cell[2] + WITHIN && self.depths[1] < cell[2] + 1.0 - WITHIN;
        let mut mask = 0;
        for group in first / TOGETHER..last.div_ceil(TOGETHER) {
            let row = group * TOGETHER;
            let (starts, ends) = if inside {
                self.lines::<false>(cell, shift, row)
            } else {
                self.lines::<true>(cell, shift, row)
            };
            for (k, (start, end)) in starts.into_iter().zip(ends).enumerate() {
                let bits = FROM[start & 15] & BEFORE[end & 15];
                mask |= u64::from(bits) << (LINES * (row + k));
            }
        }
        // Rows that do not count are cut off.
        mask & u64::MAX << (LINES * first) & u64::MAX >> (LINES * (LINES - last))
    }

    /// For some rows from one on the first line that stops in a cell, and the first behind those that do. All at once, so that
    /// they are done side by side. `CUT` says that some of the triangle lies before or behind the cell.
    #[inline]
    fn lines<const CUT: bool>(
        &self,
        cell: [f64; 3],
        shift: [f64; 2],
        row: usize,
    ) -> ([usize; TOGETHER], [usize; TOGETHER]) {
        const STEP: f64 = 1.0 / LINES as f64;
        let (mut starts, mut ends) = ([0; TOGETHER], [0; TOGETHER]);
        let first = row as f64 + shift[1];
        for (k, (start, end)) in starts.iter_mut().zip(&mut ends).enumerate() {
            let v = cell[1] + (first + k as f64) * STEP;
            let bound = |(at, slope): (f64, f64)| at + slope * v;
            let mut from = max(max(cell[0], bound(self.lower[0])), bound(self.lower[1]));
            let mut to = min(min(cell[0] + 1.0, bound(self.upper[0])), bound(self.upper[1]));
            if CUT {
                // The part of the row that lies in the cell; where depth does not change along it, all or nothing.
                let depth = self.at + self.dv * v - cell[2];
                let (near, far) = (-depth * self.inverse_du, (1.0 - depth) * self.inverse_du);
                let (near, far) = if self.du != 0.0 {
                    (min(near, far), max(near, far))
                } else if (0.0..1.0).contains(&depth) {
                    (f64::NEG_INFINITY, f64::INFINITY)
                } else {
                    (f64::INFINITY, f64::NEG_INFINITY)
                };
                (from, to) = (max(from, near), min(to, far));
            }
            let place = |u: f64| (u - cell[0]) * LINES as f64 - shift[0];
            *start = at_or_above(place(from));
            *end = past(place(to));
        }
        (starts, ends)
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

/// Added, it leaves the nearest whole number of a small one in the last bits, without a conversion that would keep rows from
/// being done side by side.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// The last bits of a whole number in 0..16.
#[inline]
fn whole(x: f64) -> usize {
    ((x + ROUND).to_bits() & 15) as usize
}

/// The first line at or above a place in lines, at most [`LINES`].
#[inline]
fn at_or_above(x: f64) -> usize {
    let x = min(max(x, 0.0), LINES as f64);
    let near = (x + ROUND) - ROUND;
    whole(if near < x { near + 1.0 } else { near })
}

/// The line after the last one at or below a place in lines, at most [`LINES`].
#[inline]
fn past(x: f64) -> usize {
    let x = min(max(x, -1.0), (LINES - 1) as f64) + 1.0;
    let near = (x + ROUND) - ROUND;
    whole(if near > x { near - 1.0 } else { near })
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
        let mut cover = Cover::default();
        for (axis, view) in self.views.iter().enumerate() {
            if let Some(view) = view {
                let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
                let shift = hash(cell[i], cell[j], axis as i64);
                let shift = [shift, shift >> 32].map(|s| (f64::from(s as u32) + 0.5) * 2f64.powi(-32));
                cover.0[axis] = view.mask([local[i], local[j], local[axis]], shift);
            }
        }
        cover
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
