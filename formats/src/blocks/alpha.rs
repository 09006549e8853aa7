//! Opacities of 4×4 texels in eight bytes: the alpha half of BC3.
//!
//! A block is two end points and for each texel one of eight values: both ends and six between them, or, where the first end point
//! is not the larger one, four between them, 0 and 255. Pure functions: any thread.
//!
//! The encoder promises more than a small error: what is nothing stays nothing, what is something stays something, and what is
//! opaque under the builder's gain stays so. Both ways of reading are tried, since many blocks are nothing, over-saturated skin and one
//! value besides.

use super::{Between, OPAQUE};
use crate::value::SOLID_ALPHA;

/// Bytes of a block.
pub(super) const BYTES: usize = 8;

/// How far from where they began end points are moved in search of a smaller error.
const STEPS: [i16; 4] = [8, 4, 2, 1];

/// The values that indices of a block name.
fn palette([a, b]: [u8; 2], between: Between) -> [u8; 8] {
    std::array::from_fn(|index| match (index, a > b) {
        (0, _) => a,
        (1, _) => b,
        (6, false) => 0,
        (7, false) => 255,
        (_, true) => between.mix(a, b, index as u16 - 1, 7),
        (_, false) => between.mix(a, b, index as u16 - 1, 5),
    })
}

/// The texels of a block, x fastest.
pub(super) fn decode(block: [u8; BYTES], between: Between) -> [u8; 16] {
    let [a, b, indices @ ..] = block;
    let values = palette([a, b], between);
    let indices = indices
        .iter()
        .rev()
        .fold(0u64, |bits, byte| bits << 8 | u64::from(*byte));
    std::array::from_fn(|t| values[(indices >> (3 * t) & 7) as usize])
}

/// The values of indices: the nearest, and rounded down.
fn values(ends: [u8; 2]) -> [[u8; 2]; 8] {
    let [near, low] = [Between::Nearest, Between::Floored].map(|between| palette(ends, between));
    std::array::from_fn(|index| [near[index], low[index]])
}

/// Whether a value may stand for another one, however it is rounded. What is opaque keeps the margin that solid ground has.
fn serves(value: [u8; 2], wanted: u8) -> bool {
    let [near, low] = value;
    let is_there = value.iter().all(|v| (*v == 0) == (wanted == 0));
    is_there && (wanted < OPAQUE || near >= wanted.min(SOLID_ALPHA) && low >= OPAQUE)
}

/// The index of the nearest value that may stand for a wanted one, and the square of the error.
fn nearest(values: &[[u8; 2]; 8], wanted: u8) -> Option<(u64, u32)> {
    (0..)
        .zip(values)
        .filter(|(_, value)| serves(**value, wanted))
        .map(|(index, value)| (index, u32::from(value[0].abs_diff(wanted)).pow(2)))
        .min_by_key(|(_, error)| *error)
}

/// Sum of the squares of the errors, `None` if some value has none that may stand for it.
fn error(ends: [u8; 2], histogram: &[(u8, u32)]) -> Option<u32> {
    let values = values(ends);
    histogram
        .iter()
        .map(|(wanted, count)| Some(nearest(&values, *wanted)?.1 * count))
        .sum()
}

/// Codes texels.
pub(super) fn encode(texels: &[u8; 16]) -> [u8; BYTES] {
    let mut sorted = *texels;
    sorted.sort_unstable();
    let histogram: Vec<(u8, u32)> = sorted
        .chunk_by(|a, b| a == b)
        .map(|equal| (equal[0], equal.len() as u32))
        .collect();
    let [low, .., high] = sorted;
    let mut inner = sorted.iter().copied().filter(|v| !matches!(v, 0 | 255));
    let first = inner.next().unwrap_or(low);
    let last = inner.next_back().unwrap_or(first);
    // Highest and lowest serve for all: the rule for opaque ones is met by the highest, that for nothing by the lowest.
    let mut best = ([high, low], error([high, low], &histogram).unwrap_or(u32::MAX));
    if let Some(error) = error([first, last], &histogram)
        && error < best.1
    {
        best = ([first, last], error);
    }
    for by in STEPS {
        if best.1 == 0 {
            break;
        }
        let ends = best.0;
        for (end, by) in [(0, by), (0, -by), (1, by), (1, -by)] {
            let mut moved = ends;
            moved[end] = (i16::from(moved[end]) + by).clamp(0, 255) as u8;
            let same_mode = (moved[0] > moved[1]) == (ends[0] > ends[1]);
            if same_mode
                && let Some(error) = error(moved, &histogram)
                && error < best.1
            {
                best = (moved, error);
            }
        }
    }
    let values = values(best.0);
    let mut indices = 0u64;
    for (t, wanted) in texels.iter().enumerate() {
        let index = nearest(&values, *wanted).map_or(0, |(index, _)| index);
        indices |= index << (3 * t);
    }
    let [i0, i1, i2, i3, i4, i5, ..] = indices.to_le_bytes();
    [best.0[0], best.0[1], i0, i1, i2, i3, i4, i5]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn both_modes_are_read_as_the_specification_says() {
        // Indices 0 to 7, then 0.
        let indices = [0b1000_1000, 0b1100_0110, 0b1111_1010, 0, 0, 0];
        let block = |a, b| {
            let [i0, i1, i2, i3, i4, i5] = indices;
            [a, b, i0, i1, i2, i3, i4, i5]
        };
        assert_eq!(
            decode(block(210, 0), Between::Nearest)[..9],
            [210, 0, 180, 150, 120, 90, 60, 30, 210]
        );
        assert_eq!(
            decode(block(100, 200), Between::Nearest)[..9],
            [100, 200, 120, 140, 160, 180, 0, 255, 100]
        );
        assert_eq!(
            decode(block(7, 7), Between::Nearest)[..8],
            [7, 7, 7, 7, 7, 7, 0, 255]
        );
    }

    #[test]
    fn what_terrain_has_is_kept_exactly() {
        for values in [[0, 132, 255, 132], [0, 0, 255, 255], [0, 4, 255, 4], [132; 4]] {
            let texels = std::array::from_fn(|t| values[t * 7 % 4]);
            assert_eq!(decode(encode(&texels), Between::Nearest), texels);
        }
    }

    proptest! {
        #[test]
        fn nothing_something_and_opaque_stay_what_they_are(
            texels in any::<[u8; 16]>(), clear in any::<u16>(), solid in any::<u16>(),
        ) {
            let texels = std::array::from_fn(|t| match (clear >> t & 1, solid >> t & 1) {
                (1, _) => 0,
                (_, 1) => 132,
                _ => texels[t],
            });
            let (low, high) = (texels.iter().min().unwrap(), texels.iter().max().unwrap());
            // However a device rounds.
            for (wanted, got) in texels.into_iter().zip(decode(encode(&texels), Between::Floored)) {
                prop_assert_eq!(wanted == 0, got == 0);
                prop_assert!(wanted < OPAQUE || got >= OPAQUE, "{} became {}", wanted, got);
            }
            for (wanted, got) in texels.into_iter().zip(decode(encode(&texels), Between::Nearest)) {
                prop_assert_eq!(wanted == 0, got == 0);
                prop_assert!(wanted < OPAQUE || got >= wanted.min(SOLID_ALPHA), "{} became {}", wanted, got);
                // Half a step of the range is usual; a whole one where the nearest may not stand for it, and some more where that
                // serves the others.
                let step = u32::from(high - low).div_ceil(7);
                prop_assert!(u32::from(wanted.abs_diff(got)) <= 2 * step, "{} became {}", wanted, got);
            }
        }

        #[test]
        fn any_bytes_are_read(block in any::<[u8; BYTES]>()) {
            for between in [Between::Nearest, Between::Floored] {
                decode(block, between);
            }
        }
    }
}
