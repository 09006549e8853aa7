//! Where a brick shows anything, so that rays pass over the rest without reading samples.

use crate::layout::SampleLayout;

/// Cells of a brick per axis, of 2³ voxels each.
const CELLS: usize = 4;
/// Places between neighbouring samples per axis; where a layout has one less, the last is that of the last sample alone.
pub const GAPS: usize = 9;
/// Words of [`Occupancy::gaps`].
pub const GAP_WORDS: usize = (GAPS * GAPS * GAPS).div_ceil(32);

/// Where interpolation in a brick finds anything but nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occupancy {
    /// Whether anywhere in each cell of 2³ voxels: bit `x + 4y + 16z`.
    pub cells: u64,
    /// Whether between each 2³ neighbouring samples, from sample x, y, z on: bit `x + 9y + 81z`, the first 32 in the first word.
    pub gaps: [u32; GAP_WORDS],
}

impl Occupancy {
    /// Of a brick of which `some` tells whether a sample (x fastest) is something.
    pub fn new(layout: SampleLayout, some: impl Fn(usize) -> bool) -> Self {
        let side = layout.side() as usize;
        // Samples as bits of rows, rows by y and z; with nothing behind the last.
        let mut rows = [[0u32; GAPS + 2]; GAPS + 2];
        for (z, plane) in rows.iter_mut().enumerate().take(side) {
            for (y, row) in plane.iter_mut().enumerate().take(side) {
                let first = (z * side + y) * side;
                *row = (0..side).fold(0, |bits, x| bits | u32::from(some(first + x)) << x);
            }
        }
        let mut gaps = [0; GAP_WORDS];
        for (z, y) in (0..GAPS).flat_map(|z| (0..GAPS).map(move |y| (z, y))) {
            let all = rows[z][y] | rows[z][y + 1] | rows[z + 1][y] | rows[z + 1][y + 1];
            let bits = u64::from((all | all >> 1) & ((1 << GAPS) - 1));
            let at = (z * GAPS + y) * GAPS;
            gaps[at / 32] |= (bits << (at % 32)) as u32;
            if at % 32 + GAPS > 32 {
                gaps[at / 32 + 1] |= (bits << (at % 32) >> 32) as u32;
            }
        }
        // A cell interpolates between its samples from 2c on, so many.
        let reach = side - 6;
        let mut cells = 0;
        for k in 0..CELLS * CELLS {
            let [y, z] = [k % CELLS, k / CELLS];
            let near = rows[2 * z..2 * z + reach]
                .iter()
                .flat_map(|plane| &plane[2 * y..2 * y + reach]);
            let bits = near.fold(0, |bits, row| bits | row);
            for x in (0..CELLS).filter(|x| bits >> (2 * x) & ((1 << reach) - 1) != 0) {
                cells |= 1 << (x + CELLS * k);
            }
        }
        Self { cells, gaps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_where_interpolation_reads_something(
            corner in any::<bool>(), places in prop::collection::vec(0..729usize, 0..4), at in prop::array::uniform3(0.0..=8.0f64),
        ) {
            let layout = if corner { SampleLayout::Corner } else { SampleLayout::Centre };
            let side = layout.side() as usize;
            let mut some = vec![false; layout.samples()];
            for place in places {
                some[place * (layout.samples() - 1) / 728] = true;
            }
            let occupancy = Occupancy::new(layout, |at| some[at]);
            // From the middle of the first sample, in samples.
            let texel = at.map(|p| p + layout.texel_offset() - 0.5);
            let first = texel.map(|t| t as usize);
            let read = (0..8).any(|k| {
                let [x, y, z]: [usize; 3] = std::array::from_fn(|a| (first[a] + (k >> a & 1)).min(side - 1));
                some[(z * side + y) * side + x]
            });
            let gap = (first[2] * GAPS + first[1]) * GAPS + first[0];
            prop_assert_eq!(occupancy.gaps[gap / 32] >> (gap % 32) & 1 == 1, read);
            let cell = at.map(|p| (p as usize / 2).min(CELLS - 1));
            let cell = cell[0] + CELLS * (cell[1] + CELLS * cell[2]);
            prop_assert!(!read || occupancy.cells >> cell & 1 == 1);
        }
    }

    /// Cells say no more than that.
    #[test]
    fn a_sample_shows_in_the_cells_that_it_reaches() {
        let only = |at: usize| move |k: usize| k == at;
        let cells = |layout, at| Occupancy::new(layout, only(at)).cells;
        assert_eq!(cells(SampleLayout::Centre, 0), 1);
        assert_eq!(cells(SampleLayout::Centre, 2), 0b11);
        assert_eq!(cells(SampleLayout::Centre, 4), 0b110);
        assert_eq!(cells(SampleLayout::Centre, 999), 1 << 63);
        assert_eq!(cells(SampleLayout::Corner, 1), 1);
        assert_eq!(cells(SampleLayout::Corner, 2), 0b11);
        assert_eq!(cells(SampleLayout::Corner, 728), 1 << 63);
    }
}
