//! Coverage: masks of what a voxel covers of its cross-sections, kept while a tree is built.
//!
//! A voxel has a mask of 8×8 bits for each axis, its outline against that axis. Going up, masks are joined: one behind the
//! other by OR, side by side each in its place, which gives 16×16 bits; every 2×2 of them make one. That is exact for three levels,
//! as long as the four bits are alike. Further up, k of the four are set, and the bit is if k is above a threshold
//! 0..3 that belongs to its place in the cross-section: so the mean coverage is kept, and what is alike at two depths stays
//! alike. Thresholds are 2×2 Bayer patterns, turned by a hash of the place lest lines fall into step with them.

use std::sync::LazyLock;

use super::step::{Parts, Rule};
use crate::build::sample::{SKIN_MAX, Sample};

/// Outlines of a voxel against x, y, z. Against axis a, bit `8 v + u` is the place u along axis a + 1, v along a + 2 (mod 3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cover(pub(crate) [u64; 3]);

impl Cover {
    /// What two of them cover together.
    pub(crate) fn with(self, other: Self) -> Self {
        Self(std::array::from_fn(|axis| self.0[axis] | other.0[axis]))
    }

    /// Skins against the axes.
    pub(crate) fn skins(&self) -> [f32; 3] {
        // Against axis a + 1 rows, and against a + 2 columns, are the depths of axis a.
        const ROWS: u64 = 0xff00_0000_0000_00ff;
        const COLUMNS: u64 = 0x8181_8181_8181_8181;
        std::array::from_fn(|axis| {
            let [next, last] = [1, 2].map(|k| self.0[(axis + k) % 3]);
            mask_skin(self.0[axis], next & ROWS != 0 || last & COLUMNS != 0)
        })
    }

    /// The largest of the skins.
    pub(crate) fn skin(&self) -> f32 {
        let [x, y, z] = self.skins();
        x.max(y).max(z)
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

/// The skin of a mask, between that of a layer of its own and twice the coverage.
///
/// A plane that is not parallel to a face leaves a voxel through the one behind, where the rest of its outline lies. Its pieces
/// have to be opaque together, as interpolation adds them up: so they get shares of a skin. Leaves end where they end.
/// The two look different: a piece of a plane has one border, of some length at most, scattered leaves have borders
/// all over. `leaves` tells whether anything is at the voxel's ends in depth at all.
fn mask_skin(mask: u64, leaves: bool) -> f32 {
    let bits = mask.count_ones() as usize;
    if bits == 0 || bits == BITS || !leaves {
        return SKIN[bits];
    }
    let part = bits as f32 / BITS as f32;
    // Borders along u and v, in parts of what a random mask of this coverage has.
    let across = (mask ^ mask >> 1) & 0x7f7f_7f7f_7f7f_7f7f;
    let along = (mask ^ mask >> 8) & (u64::MAX >> 8);
    let borders = across.count_ones().max(along.count_ones()) as f32 / (112.0 * part * (1.0 - part));
    let scattered = ((borders - 0.5) / 0.45).clamp(0.0, 1.0);
    // A tenth more: of a steep plane's three pieces the largest, interpolated, may fall short of one half.
    let sheet = SKIN_MAX * (1.1 * part).min(1.0);
    sheet + scattered * (SKIN[bits] - sheet)
}

/// A hash of a place.
pub(super) fn hash(a: i64, b: i64, c: i64) -> u64 {
    let mut h = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (c as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    h = (h ^ h >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ h >> 32).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^ h >> 31
}

/// Halves a cross-section of 16×16 bits. `seed` tells axis and level apart, `at` is the mask's place in the cross-section.
fn halve(rows: [u16; 16], seed: i64, at: [i64; 2]) -> u64 {
    /// Of the four bits of an output place: left below, right below, left above, right above.
    const BAYER: [u32; 4] = [0, 2, 3, 1];
    let mut mask = 0;
    for y in 0..8 {
        let (a, b) = (rows[2 * y], rows[2 * y + 1]);
        let four = [a, a >> 1, b, b >> 1].map(|bits| bits & 0x5555);
        let all = four.iter().fold(0x5555, |m, bits| m & bits);
        let any = four.iter().fold(0, |m, bits| m | bits);
        for x in 0..8 {
            let bit = 1 << (2 * x);
            let set = if all & bit == any & bit {
                any & bit != 0
            } else {
                let count = four.iter().filter(|bits| **bits & bit != 0).count() as u32;
                let (u, v) = (8 * at[0] + x, 8 * at[1] + y as i64);
                let turn = hash(u >> 1, v >> 1, seed) & 3;
                count > BAYER[((u & 1 | (v & 1) << 1) ^ turn as i64) as usize]
            };
            mask |= u64::from(set) << (8 * y as i64 + x);
        }
    }
    mask
}

/// The rule: the largest of the three axes' coverages, so that a plane is what it is from its front.
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
        (cover.skin(), cover)
    }
}
