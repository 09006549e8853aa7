//! Samples that neighbouring bricks in different chunks both store must be equal, or a seam shows.
//!
//! ```text
//!   corner (9³)     brick p   0 … 8          its sample 8 is sample 0 of the next
//!                   brick q         0 … 8
//!   centre (10³)    brick p   0 … 8 9        its samples 8, 9 are samples 0, 1 of the next
//!                   brick q       0 1 … 9
//! ```
//! Chunks are decoded one by one and forgotten; a seam keeps a fingerprint of the shared samples from either side. Inside
//! a chunk shared samples are stored once and cannot differ.

use std::hash::{DefaultHasher, Hasher};

use brickfell_formats::chunk::{Chunk, brick_positions};
use brickfell_formats::layout::BRICK_VOXELS;
use brickfell_formats::morton;
use glam::{IVec3, UVec3};

/// What one brick stores of the samples it shares with a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Seam {
    /// Morton codes of the two bricks, the smaller one first.
    pair: (u64, u64),
    /// Fingerprint of the shared samples.
    samples: u64,
}

/// The seams of a chunk with its corner at brick `corner`, towards those bricks of the level (Morton codes, ascending)
/// that lie in other chunks.
pub(super) fn seams(chunk: &Chunk, corner: UVec3, chunk_log2: u8, bricks: &[u64]) -> Vec<Seam> {
    let mut seams = Vec::new();
    for (k, place) in brick_positions(chunk.mask).enumerate() {
        let position = corner + place;
        for direction in neighbours() {
            let other = position.as_ivec3() + direction;
            if other.min_element() < 0 {
                continue;
            }
            let other = other.as_uvec3();
            let code = morton::encode(other);
            let same_chunk = other >> u32::from(chunk_log2) == position >> u32::from(chunk_log2);
            if same_chunk || bricks.binary_search(&code).is_err() {
                continue;
            }
            let own = morton::encode(position);
            seams.push(Seam {
                pair: (own.min(code), own.max(code)),
                samples: fingerprint(chunk, k, direction),
            });
        }
    }
    seams
}

/// The number of pairs of bricks that disagree, and the positions of the first. A brick whose neighbour's chunk could not
/// be decoded has nothing to disagree with.
pub(super) fn disagreements(mut seams: Vec<Seam>) -> (usize, Option<(UVec3, UVec3)>) {
    seams.sort_unstable();
    let mut pairs = seams
        .windows(2)
        .filter(|w| w[0].pair == w[1].pair && w[0].samples != w[1].samples)
        .map(|w| w[0].pair);
    let first = pairs.next();
    let count = usize::from(first.is_some()) + pairs.count();
    (count, first.map(|(a, b)| (morton::decode(a), morton::decode(b))))
}

/// The 26 directions to neighbours.
fn neighbours() -> impl Iterator<Item = IVec3> {
    (0..27)
        .map(|i| IVec3::new(i % 3, i / 3 % 3, i / 9) - 1)
        .filter(|d| *d != IVec3::ZERO)
}

/// Fingerprint of the samples that brick `k` of a chunk shares with its neighbour in a direction.
fn fingerprint(chunk: &Chunk, k: usize, direction: IVec3) -> u64 {
    let side = chunk.layout.side();
    let range = |toward: i32| match toward {
        0 => 0..side,
        1 => BRICK_VOXELS..side,
        _ => 0..side - BRICK_VOXELS,
    };
    let (color, normal) = (chunk.brick_color(k), chunk.brick_normal(k));
    let opacity = chunk.brick_opacity(k);
    let mut hasher = DefaultHasher::new();
    for z in range(direction.z) {
        for y in range(direction.y) {
            for x in range(direction.x) {
                let sample = ((z * side + y) * side + x) as usize;
                hasher.write(&color[sample]);
                hasher.write(&normal[sample].map(|v| v as u8));
                if let Some(opacity) = opacity {
                    hasher.write(&opacity[sample]);
                }
            }
        }
    }
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_formats::layout::SampleLayout;

    /// Chunks of one brick each whose samples are a function of their place in the level.
    fn chunk(position: UVec3, layout: SampleLayout, value: impl Fn(IVec3) -> u8) -> Chunk {
        let (side, low) = (layout.side() as i32, layout.low_apron() as i32);
        let first = position.as_ivec3() * BRICK_VOXELS as i32 - low;
        let at = |i: i32| first + IVec3::new(i % side, i / side % side, i / side / side);
        Chunk {
            mask: 1,
            layout,
            color: (0..side.pow(3)).map(|i| [value(at(i)); 4]).collect(),
            normal: vec![[0; 4]; layout.samples()],
            opacity: Vec::new(),
        }
    }

    fn count(layout: SampleLayout, value: impl Fn(UVec3, IVec3) -> u8) -> (usize, Option<(UVec3, UVec3)>) {
        let positions: Vec<UVec3> = (0..8).map(morton::decode).collect();
        let bricks: Vec<u64> = (0..8).collect();
        let all = positions.iter().flat_map(|p| {
            let chunk = chunk(*p, layout, |at| value(*p, at));
            seams(&chunk, *p, 0, &bricks)
        });
        disagreements(all.collect())
    }

    fn of_place(at: IVec3) -> u8 {
        (at.x * 7 + at.y * 31 + at.z * 101) as u8
    }

    #[test]
    fn equal_samples_make_no_seam() {
        for layout in [SampleLayout::Corner, SampleLayout::Centre] {
            assert_eq!(count(layout, |_, at| of_place(at)), (0, None), "{layout:?}");
        }
    }

    #[test]
    fn one_wrong_sample_shows_to_all_that_share_it() {
        for layout in [SampleLayout::Corner, SampleLayout::Centre] {
            // The sample in the middle of the eight bricks, as one of them stores it.
            let wrong =
                |p: UVec3, at: IVec3| of_place(at) ^ u8::from(p == UVec3::ZERO && at == IVec3::splat(8));
            let (pairs, first) = count(layout, wrong);
            assert_eq!((pairs, first), (7, Some((UVec3::ZERO, UVec3::X))), "{layout:?}");
            // A sample that no other brick stores.
            let inner =
                |p: UVec3, at: IVec3| of_place(at) ^ u8::from(p == UVec3::ZERO && at == IVec3::splat(3));
            assert_eq!(count(layout, inner), (0, None));
        }
    }

    #[test]
    fn bricks_of_one_chunk_are_not_compared() {
        let mut chunk = chunk(UVec3::ZERO, SampleLayout::Corner, of_place);
        chunk.mask = 0b11;
        chunk.color.extend(vec![[9; 4]; 729]);
        chunk.normal.extend(vec![[0; 4]; 729]);
        assert_eq!(seams(&chunk, UVec3::ZERO, 1, &[0, 1]), []);
    }
}
