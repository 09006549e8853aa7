//! Least and greatest heights over rectangles of a height map, for planning, from one pass over its samples.
//!
//! The map is divided into squares, few enough to take some megabytes whatever its size. What is said about a rectangle
//! holds for all squares that it touches, so it may be too wide by a square's content, never too narrow.

use std::ops::Range;

use super::block_cache::Cell;

/// Smallest side of a square, pixels.
const SIDE_LOG2: u32 = 4;
/// Most squares, roughly.
const SQUARES: u64 = 1 << 20;

/// Least and greatest valid heights of squares.
#[derive(Debug, Clone)]
pub(crate) struct Ranges {
    side_log2: u32,
    across: usize,
    squares: Vec<(f32, f32)>,
}

const NONE: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

fn merge(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    (a.0.min(b.0), a.1.max(b.1))
}

impl Ranges {
    /// Nothing yet, of a map of some size.
    pub(crate) fn new(width: u32, height: u32) -> Self {
        let mut side_log2 = SIDE_LOG2;
        let count = |log2: u32| u64::from(width.div_ceil(1 << log2)) * u64::from(height.div_ceil(1 << log2));
        while count(side_log2) > SQUARES {
            side_log2 += 1;
        }
        Self {
            side_log2,
            across: width.div_ceil(1 << side_log2) as usize,
            squares: vec![NONE; count(side_log2) as usize],
        }
    }

    /// Takes in samples of a row from a column on.
    pub(crate) fn add(&mut self, column: u32, row: u32, cells: &[Cell]) {
        let start = (row >> self.side_log2) as usize * self.across;
        let side = 1usize << self.side_log2;
        let mut rest = cells;
        let mut at = column as usize;
        while !rest.is_empty() {
            let (part, more) = rest.split_at(rest.len().min(side - at % side));
            if let Some(square) = self.squares.get_mut(start + (at >> self.side_log2)) {
                // NaN is neither less nor greater.
                *square = part.iter().fold(*square, |range, cell| {
                    let h = f32::from_le_bytes(*cell);
                    merge(range, (h, h))
                });
            }
            at += part.len();
            rest = more;
        }
    }

    /// Over a rectangle of samples; `None` without a valid one in the squares it touches.
    pub(crate) fn over(&self, columns: Range<u32>, rows: Range<u32>) -> Option<(f32, f32)> {
        if columns.is_empty() || rows.is_empty() {
            return None;
        }
        let squares = |r: Range<u32>| {
            (r.start >> self.side_log2) as usize..((r.end - 1) >> self.side_log2) as usize + 1
        };
        let columns = squares(columns);
        let range = squares(rows)
            .flat_map(|row| {
                let row = row * self.across;
                self.squares
                    .get(row + columns.start..row + columns.end.min(self.across))
            })
            .flatten()
            .fold(NONE, |a, b| merge(a, *b));
        (range.0 <= range.1).then_some(range)
    }

    /// Over the whole map.
    pub(crate) fn all(&self) -> Option<(f32, f32)> {
        let range = self.squares.iter().fold(NONE, |a, b| merge(a, *b));
        (range.0 <= range.1).then_some(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_rectangle_is_covered_and_not_by_far(
            (w, h) in (1u32..90, 1u32..90), seed in 0u32..1000, (x0, x1, y0, y1) in (0u32..90, 0u32..90, 0u32..90, 0u32..90),
        ) {
            let height = |c: u32, r: u32| if (c + r + seed).is_multiple_of(3) { f32::NAN } else { ((c * 7 + r * 13 + seed) % 101) as f32 };
            let mut ranges = Ranges::new(w, h);
            for r in 0..h {
                let cells: Vec<Cell> = (0..w).map(|c| height(c, r).to_le_bytes()).collect();
                let (left, right) = cells.split_at((seed % (w + 1)) as usize);
                ranges.add(0, r, left);
                ranges.add(left.len() as u32, r, right);
            }
            let (x0, x1, y0, y1) = (x0.min(x1).min(w), x1.max(x0).min(w), y0.min(y1).min(h), y1.max(y0).min(h));
            let brute = |x0: u32, x1: u32, y0: u32, y1: u32| {
                let all = (y0..y1).flat_map(|r| (x0..x1).map(move |c| height(c, r))).filter(|h| !h.is_nan());
                all.fold(NONE, |a, h| merge(a, (h, h)))
            };
            let exact = brute(x0, x1, y0, y1);
            let wide = brute(x0 & !15, ((x1 + 15) & !15).min(w), y0 & !15, ((y1 + 15) & !15).min(h));
            match ranges.over(x0..x1, y0..y1) {
                Some(range) => prop_assert_eq!(range, wide),
                None => prop_assert!(exact == NONE),
            }
        }
    }
}
