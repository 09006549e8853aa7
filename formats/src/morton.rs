//! Morton (Z-order) codes: the order of nodes in a level, bricks in a chunk and chunks in a file.
//!
//! Bit 0 of the code is bit 0 of x, bit 1 of y, bit 2 of z, so the code's last three bits are the octant `x + 2y + 4z`.

use glam::UVec3;

/// Bits per axis that a code holds.
pub const BITS: u32 = 21;

fn spread(v: u32) -> u64 {
    let mut x = u64::from(v) & 0x1f_ffff;
    x = (x | x << 32) & 0x1f_0000_0000_ffff;
    x = (x | x << 16) & 0x1f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

fn compact(code: u64) -> u32 {
    let mut x = code & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x1f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x1f_0000_0000_ffff;
    (x | x >> 32) as u32 & 0x1f_ffff
}

/// The code of a cell; coordinates below 2^21.
pub fn encode(p: UVec3) -> u64 {
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}

/// The cell of a code.
pub fn decode(code: u64) -> UVec3 {
    UVec3::new(compact(code), compact(code >> 1), compact(code >> 2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn round_trips(x in 0u32..1 << BITS, y in 0u32..1 << BITS, z in 0u32..1 << BITS) {
            let p = UVec3::new(x, y, z);
            prop_assert_eq!(decode(encode(p)), p);
            prop_assert_eq!(encode(p) & 7, u64::from(x & 1 | (y & 1) << 1 | (z & 1) << 2));
        }
    }
}
