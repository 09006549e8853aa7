//! Coverage: masks of what a voxel covers of its cross-sections, kept while a tree is built.
//!
//! A voxel has a mask of 8×8 bits for each axis, its outline against that axis. Going up, masks are joined: one behind the
//! other by OR, side by side each in its place, which gives 16×16 bits; every 2×2 of them make one. That is exact for three levels,
//! as long as the four bits are alike. Further up, k of the four are set, and the bit is if k is above a threshold
//! 0..3 that belongs to its place in the cross-section: so the mean coverage is kept, and what is alike at two depths stays
//! alike. Thresholds are 2×2 Bayer patterns, turned by a hash of the place lest lines fall into step with them.

use std::sync::LazyLock;

use bytemuck::{Pod, Zeroable};

use super::step::{Parts, Rule};
use crate::build::blocks::{Block, Blocks};
use crate::build::cells::{Cells, in_block};
use crate::build::lattice::SIDE;
use crate::build::sample::{SKIN_MAX, Sample};

/// Outlines of a voxel against x, y, z. Against axis a, bit `8 v + u` is the place u along axis a + 1, v along a + 2 (mod 3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(crate) struct Cover(pub(crate) [u64; 3]);

impl Cover {
    /// All of a voxel.
    pub(crate) const WHOLE: Self = Self([u64::MAX; 3]);

    /// What two of them cover together.
    pub(crate) fn with(self, other: Self) -> Self {
        Self(std::array::from_fn(|axis| self.0[axis] | other.0[axis]))
    }
}

/// Bits of a mask.
pub(super) const BITS: usize = 64;

/// Skin by the number of bits that are covered.
static SKIN: LazyLock<[f32; BITS + 1]> =
    LazyLock::new(|| std::array::from_fn(|k| skin(k as f32 / BITS as f32)));

/// The skin that lets through `1 - coverage` where it lies in one layer of voxels between empty ones.
///
/// Interpolated, such a layer has the opacity q (1 - |x|), x in voxels from it, at most 1. Rays read it in steps of a voxel, so at
/// two places, f and 1 - f away; over all phases f they see `T = 1 - q + q²/6` for q ≤ 1, `(2 - q)³ / 6q` up to 2, from
/// where on the layer is opaque at every phase. This is the inverse.
fn skin(coverage: f32) -> f32 {
    let through = f64::from(1.0 - coverage);
    if through >= 1.0 / 6.0 {
        return (3.0 - (3.0 + 6.0 * through).sqrt()) as f32;
    }
    let (mut low, mut high) = (1.0, f64::from(SKIN_MAX));
    for _ in 0..40 {
        let q = 0.5 * (low + high);
        if (2.0 - q).powi(3) > 6.0 * q * through {
            low = q;
        } else {
            high = q;
        }
    }
    high as f32
}

/// The skin of a mask between what lies before and behind it.
///
/// A plane that is not parallel to a face leaves a voxel through the one behind, where the rest of its outline lies. Interpolation
/// adds up what is stored of both, so they get shares of the skin of their common outline. Where that is whole there is a
/// surface, and the shares are the roots of the parts: a rough one has its pieces less in line than a plane, and leaks where
/// they get the parts themselves. What ends in a voxel, as leaves do, has that outline for itself.
fn shared_skin(own: u64, around: u64) -> f32 {
    let [own, all] = [own, own | around].map(u64::count_ones);
    // Dithered, pieces of a plane leave some bits open between them, the more the more lies in the other pieces; and of a
    // steep plane's three pieces the largest, interpolated, may fall short of one half.
    let open = (BITS as u32 - all) as usize;
    let others = (all - own) as usize;
    let part = own as f32 / all.max(1) as f32;
    let skin = if open <= others.div_ceil(2) {
        1.1 * SKIN[BITS] * part.sqrt()
    } else {
        SKIN[all as usize + others.div_ceil(4)] * part
    };
    skin.min(SKIN_MAX)
}

/// What is to be stored of a level by what its samples cover.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skins<'a> {
    pub(super) covers: &'a Blocks<Cells<Cover>>,
    /// The level's voxels are known two beyond what is stored. Where they are not, as of the root, all pieces count as such of
    /// planes.
    pub(super) neighbours: bool,
    /// Axes are told apart, else the largest counts.
    pub(crate) axes: bool,
}

impl Skins<'_> {
    /// Skins of a cell against the axes.
    pub(crate) fn at(&self, cell: [i64; 3]) -> [f32; 3] {
        let [x, y, z] = cell;
        let column = self.covers.column(x.div_euclid(SIDE), y.div_euclid(SIDE));
        let Block::Mixed(block) = column.get(z.div_euclid(SIDE)) else {
            return [0.0; 3];
        };
        let Some(own) = block.value(in_block(x, y, z)) else {
            return [0.0; 3];
        };
        let skins: [f32; 3] = std::array::from_fn(|axis| {
            let beside = |step: i64| {
                let mut at = cell;
                at[axis] += step;
                // Most neighbours are in the same block.
                if at[axis].div_euclid(SIDE) == cell[axis].div_euclid(SIDE) {
                    block
                        .value(in_block(at[0], at[1], at[2]))
                        .map_or(0, |c| c.0[axis])
                } else {
                    self.cover(at).0[axis]
                }
            };
            match own.0[axis] {
                0 => 0.0,
                own if self.neighbours => shared_skin(own, beside(-1) | beside(1)),
                own => shared_skin(own, u64::MAX),
            }
        });
        if self.axes {
            return skins;
        }
        [skins[0].max(skins[1]).max(skins[2]); 3]
    }

    #[inline]
    fn cover(&self, [x, y, z]: [i64; 3]) -> Cover {
        let column = self.covers.column(x.div_euclid(SIDE), y.div_euclid(SIDE));
        match column.get(z.div_euclid(SIDE)) {
            Block::Mixed(covers) => covers.value(in_block(x, y, z)).copied().unwrap_or_default(),
            _ => Cover::default(),
        }
    }
}

/// A hash of a place.
#[inline]
pub(super) fn hash(a: i64, b: i64, c: i64) -> u64 {
    let mut h = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (c as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    h = (h ^ h >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ h >> 32).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^ h >> 31
}

/// Every second bit of a row of sixteen, from the first on.
fn even(row: u16) -> u64 {
    let row = row & 0x5555;
    let row = (row | row >> 1) & 0x3333;
    let row = (row | row >> 2) & 0x0f0f;
    u64::from((row | row >> 4) & 0xff)
}

/// Of four bits, the places in a 2×2 pattern (bits 0, 1, 8, 9 of a mask) that have each threshold 0..3, by how the pattern is
/// turned.
static PATTERNS: [[u64; 4]; 4] = {
    /// Left below, right below, left above, right above.
    const BAYER: [usize; 4] = [0, 2, 3, 1];
    let mut patterns = [[0; 4]; 4];
    let mut turn = 0;
    while turn < 4 {
        let mut place = 0;
        while place < 4 {
            patterns[turn][BAYER[place ^ turn]] |= 1 << (place % 2 + 8 * (place / 2));
            place += 1;
        }
        turn += 1;
    }
    patterns
};

/// Halves a cross-section of 16×16 bits. `seed` tells axis and level apart, `at` is the mask's place in the cross-section.
fn halve(rows: [u16; 16], seed: i64, at: [i64; 2]) -> u64 {
    // Of the four bits of each output place: left below, right below, left above, right above.
    let (mut a, mut b, mut c, mut d) = (0, 0, 0, 0);
    for y in 0..8 {
        let (below, above) = (rows[2 * y], rows[2 * y + 1]);
        a |= even(below) << (8 * y);
        b |= even(below >> 1) << (8 * y);
        c |= even(above) << (8 * y);
        d |= even(above >> 1) << (8 * y);
    }
    let (all, any) = (a & b & c & d, a | b | c | d);
    let two = a & b | c & d | (a | b) & (c | d);
    let three = a & b & (c | d) | c & d & (a | b);
    let open = any & !all;
    let mut mask = all;
    // What decides in the 2×2 places that are turned together.
    let groups = open | open >> 1;
    let mut left = (groups | groups >> 8) & 0x0055_0055_0055_0055;
    while left != 0 {
        let bit = left.trailing_zeros();
        left &= left - 1;
        let (x, y) = (i64::from(bit % 8), i64::from(bit / 8));
        let turn = hash((8 * at[0] + x) >> 1, (8 * at[1] + y) >> 1, seed) & 3;
        let [first, second, third, _] = PATTERNS[turn as usize].map(|places| places << bit);
        mask |= open & (first & any | second & two | third & three);
    }
    mask
}

/// The rule: covers go up, skins are made of them only where a level is stored ([`Skins`]).
pub(super) struct Coverage;

impl Rule for Coverage {
    type Kept = Cover;

    fn finest(&self, sample: &Sample) -> Cover {
        Cover([if sample.skin() > 0.0 { u64::MAX } else { 0 }; 3])
    }

    fn up(&self, _: f32, parts: &Parts<Cover>) -> (f32, Cover) {
        let taps = parts.taps();
        let cover = Cover(std::array::from_fn(|axis| {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut outline = [[0u64; 3]; 3];
            let (mut any, mut all) = (0, u64::MAX);
            for (v, row) in outline.iter_mut().enumerate().take(taps) {
                for (u, mask) in row.iter_mut().enumerate().take(taps) {
                    for depth in 0..taps {
                        let mut at = [depth; 3];
                        (at[i], at[j]) = (u, v);
                        *mask |= parts.at(at).0[axis];
                    }
                    (any, all) = (any | *mask, all & *mask);
                }
            }
            if any == all {
                return any;
            }
            // Of three parts a side the outer ones belong to the voxel by half.
            let skip = 4 * (taps - 2);
            let rows = std::array::from_fn(|y| {
                let (v, y) = ((y + skip) / 8, (y + skip) % 8);
                let row = outline[v]
                    .iter()
                    .enumerate()
                    .fold(0, |row, (u, mask)| row | (*mask >> (8 * y) & 0xff) << (8 * u));
                (row >> skip) as u16
            });
            let place = [parts.cell[i], parts.cell[j]];
            halve(rows, i64::from(parts.mip) << 2 | axis as i64, place)
        }));
        (0.0, cover)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bit by bit, as the module says it.
    fn halved(rows: [u16; 16], seed: i64, at: [i64; 2]) -> u64 {
        const BAYER: [u32; 4] = [0, 2, 3, 1];
        let mut mask = 0;
        for (x, y) in (0..64).map(|k| (k % 8, k / 8)) {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| rows[2 * y + j] >> (2 * x + i) & 1);
            let (u, v) = (8 * at[0] + x as i64, 8 * at[1] + y as i64);
            let turn = hash(u >> 1, v >> 1, seed) & 3;
            let threshold = BAYER[((u & 1 | (v & 1) << 1) ^ turn as i64) as usize];
            let count = four.map(u32::from).iter().sum::<u32>();
            if count == 4 || count > threshold {
                mask |= 1 << (8 * y + x);
            }
        }
        mask
    }

    proptest! {
        #[test]
        fn all_places_are_halved_at_once(a in any::<[u16; 16]>(), b in any::<[u16; 16]>(), full in any::<[bool; 16]>(),
                                         seed in -99..99i64, at in [-9..9i64, -9..9i64]) {
            let rows = std::array::from_fn(|k| if full[k] { a[k] | b[k] } else { a[k] & b[k] });
            prop_assert_eq!(halve(rows, seed, at), halved(rows, seed, at));
        }
    }
}
