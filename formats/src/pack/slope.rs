//! Where the surface is in a run of partial samples, and how steep: what a height field tells of opacities and normals.
//!
//! Depths are down from a column's top, in 1/256 of a sample. A run's surface is where solid would begin if all that is in the run lay at
//! its foot.

use super::grid::Grid;
use crate::value::SOLID_ALPHA;

/// A sample.
pub(super) const UNIT: i32 = 256;

/// The depth at a run's surface, and how it changes per column along x and y.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub(super) depth: i32,
    pub(super) slope: [i32; 2],
}

impl Surface {
    /// How full a sample is, of 8 times [`UNIT`]: the fan of triangles between a column's corners and its centre, taken for five
    /// heights as the builder does.
    #[inline]
    pub(super) fn full(&self, place: usize) -> i32 {
        let below = (place as i32 + 1) * UNIT - self.depth;
        let [x, y] = self.slope.map(|s| s / 2);
        let part = |height: i32| (below + height).clamp(0, UNIT);
        part(x + y) + part(x - y) + part(y - x) + part(-x - y) + 4 * part(0)
    }

    /// Of how much of [`Self::full`] a change in depth tells.
    #[inline]
    fn share(&self, place: usize) -> i32 {
        let below = (place as i32 + 1) * UNIT - self.depth;
        let [x, y] = self.slope.map(|s| s / 2);
        let part = |height: i32| i32::from((0..=UNIT).contains(&(below + height)));
        part(x + y) + part(x - y) + part(y - x) + part(-x - y) + 4 * part(0)
    }

    /// The surface that has so much in a sample, if it is as steep as expected.
    #[inline]
    pub(super) fn corrected(mut self, place: usize, full: i32) -> Self {
        let off = full - self.full(place);
        if off != 0 {
            self.depth -= (off / self.share(place).max(1)).clamp(-UNIT, UNIT);
        }
        self
    }
}

/// What is expected of a run by the columns before.
pub(super) fn expected(grid: &Grid, column: usize, top: usize, length: usize) -> Surface {
    let middle = top + length / 2;
    let near = |column: usize| grid.nearest(column, middle).map(|n| i32::from(grid.depth[n]));
    let row = grid.row;
    let around = [column - 1, column - row, column - row - 1, column - row + 1].map(near);
    let centre = (2 * top + length) as i32 * (UNIT / 2);
    let [west, south, corner, east] = around;
    let slope = |a: Option<i32>, b: Option<i32>| Some(b? - a?);
    // Each slope in the row or column before.
    let x = slope(corner, south).or(slope(south, east)).unwrap_or(0);
    let y = slope(corner, west).unwrap_or(0);
    let depth = match (west, south) {
        (Some(w), Some(s)) => (w + x + s + y) / 2,
        (Some(w), None) => w + x,
        (None, Some(s)) => s + y,
        (None, None) => centre,
    };
    // A run is as long as it is steep.
    let rise = (length as i32 - 1).max(0) * UNIT;
    let depth = depth.clamp(centre - UNIT / 2, centre + UNIT / 2);
    let total = x.abs() + y.abs();
    let slope = if total == 0 {
        [rise / 2, rise / 2]
    } else {
        let goal = total.clamp((rise - UNIT / 2).max(0), rise + UNIT / 2);
        [x, y].map(|v| v.clamp(-0x7fff, 0x7fff) * goal / total)
    };
    Surface { depth, slope }
}

/// Sets where the surface of a run is, of which the opacities are known.
pub(super) fn settle(grid: &mut Grid, column: usize, top: usize, end: usize) {
    let first = column * grid.height;
    let samples = first + top..first + end;
    let full: i32 = grid.alpha[samples.clone()]
        .iter()
        .map(|a| i32::from((*a).min(SOLID_ALPHA)))
        .sum();
    let depth = end as i32 * UNIT - full * UNIT / i32::from(SOLID_ALPHA);
    grid.depth[samples].fill(depth as i16);
}

/// The normal of a run (as in a look) by the depths of the columns around it, and how rough the surface is there, 1 to 7; `None` where
/// there is no column on either side along an axis.
pub(super) fn normal(grid: &Grid, column: usize, at: usize) -> Option<([u8; 3], usize)> {
    let own = i32::from(grid.depth[at]);
    let middle = (own / UNIT) as usize;
    let near = |column: usize| grid.nearest(column, middle).map(|n| i32::from(grid.depth[n]));
    let slope = |column: usize, step: usize| Some(near(column + step)? - near(column - step)?);
    let along = |step: usize, across: usize| {
        let (before, after) = (near(column - step), near(column + step));
        match (before, after) {
            (Some(a), Some(b)) => {
                let bent = (a + b - 2 * own).abs();
                // The builder's slopes are those of corners, so of three rows.
                let d = match (slope(column - across, step), slope(column + across, step)) {
                    (Some(c), Some(d)) => (2 * (b - a) + c + d) / 8,
                    _ => (b - a) / 2,
                };
                Some((d, bent))
            }
            (Some(a), None) => Some((own - a, UNIT)),
            (None, Some(b)) => Some((b - own, UNIT)),
            (None, None) => None,
        }
    };
    let ((x, bent), (y, bent_too)) = (along(1, grid.row)?, along(grid.row, 1)?);
    // All below 2^15, so squares add up to below 2^31.
    let long = ((x * x + y * y + UNIT * UNIT) as u32).isqrt() as i32;
    let part = |v: i32| ((v * 127 * 2 / long + if v < 0 { -1 } else { 1 }) / 2 + 128) as u8;
    let rough = match bent + bent_too {
        0..12 => 1,
        12..32 => 2,
        32..80 => 3,
        80..160 => 4,
        160..320 => 5,
        320..640 => 6,
        _ => 7,
    };
    Some(([x, y, UNIT].map(part), rough))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::UVec3;

    /// A plane that falls by so much per column, as a builder stores it: full below, empty above, as full as it is between.
    fn plane(slope: [i32; 2]) -> Grid {
        let mut grid = Grid::new(UVec3::splat(18), false, 0);
        for (x, y) in (0..18).flat_map(|y| (0..18).map(move |x| (x, y))) {
            let first = grid.index([x, y, 0]);
            let depth =
                (first % grid.height) as i32 * UNIT + 2000 + slope[0] * x as i32 + slope[1] * y as i32;
            let surface = Surface { depth, slope };
            for down in 0..18 {
                let full = surface.full((first + down) % grid.height);
                let alpha = (full * i32::from(SOLID_ALPHA) / (8 * UNIT)) as u8;
                let color = if alpha == 0 { [0; 4] } else { [9, 9, 9, alpha] };
                assert!(grid.set(first + down, color, [0; 4], [0; 4]));
            }
        }
        grid
    }

    #[test]
    fn the_fill_of_a_sample_follows_depth_and_slope() {
        let flat = Surface {
            depth: 3 * UNIT + UNIT / 4,
            slope: [0; 2],
        };
        assert_eq!([2, 3, 4].map(|k| flat.full(k)), [0, 6 * UNIT, 8 * UNIT]);
        // Half a sample up on one side, half down on the other.
        let steep = Surface {
            slope: [UNIT, 0],
            ..flat
        };
        assert!(steep.full(2) > 0 && steep.full(3) < 6 * UNIT);
        let moved = flat.corrected(3, 2 * UNIT);
        assert_eq!(moved.full(3), 2 * UNIT);
    }

    #[test]
    fn planes_are_expected_where_they_are_and_as_steep() {
        for slope in [[40, 0], [-90, 60], [100, -120]] {
            let mut grid = plane(slope);
            let columns: Vec<usize> = grid.inside().collect();
            for column in &columns {
                for run in super::super::grid::runs(grid.columns[*column].partial()) {
                    settle(&mut grid, *column, run.start, run.end);
                }
            }
            let column = columns[9 * 18 + 9];
            let top = grid.columns[column].partial().trailing_zeros() as usize;
            let length = (grid.columns[column].partial() >> top).trailing_ones() as usize;
            let at = column * grid.height + top;
            let found = expected(&grid, column, top, length);
            assert!((found.depth - i32::from(grid.depth[at])).abs() < 24, "{found:?}");
            let ([x, y, z], rough) = normal(&grid, column, at).unwrap();
            let long = f64::from(slope[0].pow(2) + slope[1].pow(2) + UNIT.pow(2)).sqrt();
            for (part, v) in [(x, slope[0]), (y, slope[1]), (z, UNIT)] {
                let wanted = f64::from(v) / long * 127.0 + 128.0;
                assert!(
                    (f64::from(part) - wanted).abs() < 3.0,
                    "{slope:?}: {part} {wanted}"
                );
            }
            assert!(rough < 4);
        }
    }
}
