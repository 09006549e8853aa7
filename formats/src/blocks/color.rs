//! Three components of 4×4 texels in eight bytes: BC1, and the colour half of BC3.
//!
//! A block is two end points of 5, 6 and 5 bits and, for each texel, which of four values on the line between them it has. BC1
//! reads three values and nothing where the first end point is not the larger one; it is never written so but with both equal,
//! where all texels have the first, so the same eight bytes mean the same in both. Pure functions: any thread.
//!
//! The encoder takes the range of the texels along their principal axis and refines both ends by least squares, each texel by its
//! weight. A texel of weight 0 may become anything.

use std::sync::LazyLock;

use super::Between;

/// Bytes of a block.
pub(super) const BYTES: usize = 8;

/// Rounds of least squares: more change nothing that could be seen.
const ROUNDS: usize = 3;

/// Largest code of each component of an end point.
const MOST: [u16; 3] = [31, 63, 31];

/// An end point: codes of 5, 6 and 5 bits.
type End = [u16; 3];

fn pack(end: End) -> u16 {
    end[0] << 11 | end[1] << 5 | end[2]
}

fn unpack(word: u16) -> End {
    [word >> 11, word >> 5 & 63, word & 31]
}

/// The bytes that an end point stands for.
fn widen([r, g, b]: End) -> [u8; 3] {
    [r << 3 | r >> 2, g << 2 | g >> 4, b << 3 | b >> 2].map(|v| v as u8)
}

/// The code whose byte is nearest.
fn narrow(color: [f32; 3]) -> End {
    std::array::from_fn(|k| {
        let most = f32::from(MOST[k]);
        (color[k] * (most / 255.0) + 0.5).clamp(0.0, most) as u16
    })
}

/// The values that indices of a block name. `four`: the block is the colour half of BC3, in which the order of the end points
/// means nothing.
fn palette(ends: [u16; 2], four: bool, between: Between) -> [[u8; 3]; 4] {
    let [a, b] = ends.map(|word| widen(unpack(word)));
    if four || ends[0] > ends[1] {
        let on_line = |part| std::array::from_fn(|k| between.mix(a[k], b[k], part, 3));
        [a, b, on_line(1), on_line(2)]
    } else {
        let middle = std::array::from_fn(|k| (u16::from(a[k]) + u16::from(b[k])).div_ceil(2) as u8);
        [a, b, middle, [0; 3]]
    }
}

/// The texels of a block, x fastest.
pub(super) fn decode(block: [u8; BYTES], four: bool, between: Between) -> [[u8; 3]; 16] {
    let [a0, a1, b0, b1, indices @ ..] = block;
    let ends = [u16::from_le_bytes([a0, a1]), u16::from_le_bytes([b0, b1])];
    let values = palette(ends, four, between);
    let indices = u32::from_le_bytes(indices);
    std::array::from_fn(|k| values[(indices >> (2 * k) & 3) as usize])
}

/// Codes texels (components 0..255) so that the sum of squares of their errors, each times its weight, is small.
pub(super) fn encode(texels: &[[f32; 3]; 16], weights: &[f32; 16]) -> [u8; BYTES] {
    let total: f32 = weights.iter().sum();
    if total <= 0.0 {
        return [0; BYTES];
    }
    let mean: [f32; 3] = std::array::from_fn(|k| weighted(weights, |t| texels[t][k]) / total);
    let differs = |t: usize| weights[t] > 0.0 && (0..3).any(|k| (texels[t][k] - mean[k]).abs() > 0.5);
    if !(0..16).any(differs) {
        return Block::even(mean).bytes();
    }
    let mut best = Block::between(range(texels, weights, mean), texels, weights);
    for _ in 0..ROUNDS {
        let Some(ends) = refined(texels, weights, best.indices) else {
            break;
        };
        let next = Block::between(ends, texels, weights);
        if next.error >= best.error {
            break;
        }
        best = next;
    }
    best.bytes()
}

/// Sum over the texels.
fn weighted(weights: &[f32; 16], value: impl Fn(usize) -> f32) -> f32 {
    (0..16).map(|t| weights[t] * value(t)).sum()
}

/// The ends of the texels' range along their principal axis.
fn range(texels: &[[f32; 3]; 16], weights: &[f32; 16], mean: [f32; 3]) -> [[f32; 3]; 2] {
    let from_mean = |t: usize| -> [f32; 3] { std::array::from_fn(|k| texels[t][k] - mean[k]) };
    let covariance: [[f32; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| weighted(weights, |t| from_mean(t)[i] * from_mean(t)[j]))
    });
    // Powers of the matrix, from its longest row: that is not across the axis.
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let longer = |a: &[f32; 3], b: &[f32; 3]| dot(*a, *a).total_cmp(&dot(*b, *b));
    let mut axis = covariance.into_iter().max_by(longer).unwrap_or([1.0; 3]);
    for _ in 0..8 {
        let next = covariance.map(|row| dot(row, axis));
        let length = dot(next, next).sqrt();
        if length <= f32::MIN_POSITIVE {
            break;
        }
        axis = next.map(|v| v / length);
    }
    let square = dot(axis, axis).max(f32::MIN_POSITIVE);
    let (mut low, mut high) = (0f32, 0f32);
    for t in (0..16).filter(|t| weights[*t] > 0.0) {
        let along = dot(from_mean(t), axis) / square;
        (low, high) = (low.min(along), high.max(along));
    }
    [high, low].map(|along| std::array::from_fn(|k| mean[k] + along * axis[k]))
}

/// The end points that serve best the texels with these indices, if the indices say anything of both.
fn refined(texels: &[[f32; 3]; 16], weights: &[f32; 16], indices: u32) -> Option<[[f32; 3]; 2]> {
    // How much of the first end point is in each of the values.
    let share = |t: usize| [1.0, 0.0, 2.0 / 3.0, 1.0 / 3.0][(indices >> (2 * t) & 3) as usize];
    let aa = weighted(weights, |t| share(t) * share(t));
    let ab = weighted(weights, |t| share(t) * (1.0 - share(t)));
    let bb = weighted(weights, |t| (1.0 - share(t)) * (1.0 - share(t)));
    let determinant = aa * bb - ab * ab;
    if determinant.abs() < 1e-6 * (aa + bb) * (aa + bb) {
        return None;
    }
    let sums: [[f32; 2]; 3] = std::array::from_fn(|k| {
        [
            weighted(weights, |t| share(t) * texels[t][k]),
            weighted(weights, |t| (1.0 - share(t)) * texels[t][k]),
        ]
    });
    Some([
        sums.map(|[a, b]| (bb * a - ab * b) / determinant),
        sums.map(|[a, b]| (aa * b - ab * a) / determinant),
    ])
}

/// A block under construction; the larger end point is the first.
#[derive(Clone, Copy)]
struct Block {
    ends: [u16; 2],
    /// Two bits a texel.
    indices: u32,
    error: f32,
}

impl Block {
    /// The best indices for a pair of end points.
    fn between(ends: [[f32; 3]; 2], texels: &[[f32; 3]; 16], weights: &[f32; 16]) -> Self {
        let [a, b] = ends.map(|end| pack(narrow(end)));
        let ends = [a.max(b), a.min(b)];
        let values = palette(ends, true, Between::Nearest).map(|v| v.map(f32::from));
        let (mut indices, mut error) = (0, 0.0);
        for t in (0..16).filter(|t| weights[*t] > 0.0) {
            let off = |value: [f32; 3]| -> f32 {
                (0..3)
                    .map(|k| (value[k] - texels[t][k]) * (value[k] - texels[t][k]))
                    .sum()
            };
            // The first of equals: where both ends are the same, all texels have index 0, which is what both modes agree about.
            let mut nearest = (off(values[0]), 0);
            for (index, value) in (1..).zip(&values[1..]) {
                let off = off(*value);
                if off < nearest.0 {
                    nearest = (off, index);
                }
            }
            error += weights[t] * nearest.0;
            indices |= nearest.1 << (2 * t);
        }
        Self { ends, indices, error }
    }

    /// One value everywhere: each component is a third of the way between two codes, or a code.
    fn even(color: [f32; 3]) -> Self {
        let bytes = color.map(|c| (c + 0.5).clamp(0.0, 255.0) as usize);
        let pairs: [[u16; 2]; 3] = std::array::from_fn(|k| EVEN[usize::from(MOST[k] == 63)][bytes[k]]);
        let [a, b] = [0, 1].map(|end| pack(pairs.map(|pair| pair[end])));
        // The value is nearer to `a`, whichever of the two is written first.
        let index: u32 = match a.cmp(&b) {
            std::cmp::Ordering::Greater => 2,
            std::cmp::Ordering::Equal => 0,
            std::cmp::Ordering::Less => 3,
        };
        Self {
            ends: [a.max(b), a.min(b)],
            indices: index * 0x5555_5555,
            error: 0.0,
        }
    }

    fn bytes(self) -> [u8; BYTES] {
        let [a, b] = self.ends.map(u16::to_le_bytes);
        let i = self.indices.to_le_bytes();
        [a[0], a[1], b[0], b[1], i[0], i[1], i[2], i[3]]
    }
}

/// For 5 and for 6 bits and each byte, the two codes of which a third of the way from the first comes nearest; of equally near
/// ones those that are closest together.
static EVEN: LazyLock<[[[u16; 2]; 256]; 2]> = LazyLock::new(|| {
    [5, 6].map(|bits: u32| {
        let byte = |code: u16| (code << (8 - bits) | code >> (2 * bits - 8)) as u8;
        std::array::from_fn(|wanted| {
            let codes = 0..1u16 << bits;
            let pairs = codes.clone().flat_map(|a| codes.clone().map(move |b| [a, b]));
            let rank = |[a, b]: &[u16; 2]| {
                let third = Between::Nearest.mix(byte(*a), byte(*b), 1, 3);
                let off = i32::from(third) - wanted as i32;
                (off.abs(), a.abs_diff(*b))
            };
            pairs.min_by_key(rank).unwrap_or_default()
        })
    })
});

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn both_modes_are_read_as_the_specification_says() {
        // Red over blue, all four indices in the first row.
        let four = [0x00, 0xf8, 0x1f, 0x00, 0b1110_0100, 0, 0, 0];
        assert_eq!(
            decode(four, false, Between::Nearest)[..4],
            [[255, 0, 0], [0, 0, 255], [170, 0, 85], [85, 0, 170]]
        );
        // The other way round there are three values and nothing, but not in BC3.
        let three = [0x1f, 0x00, 0x00, 0xf8, 0b1110_0100, 0, 0, 0];
        assert_eq!(
            decode(three, false, Between::Nearest)[..4],
            [[0, 0, 255], [255, 0, 0], [128, 0, 128], [0, 0, 0]]
        );
        assert_eq!(
            decode(three, true, Between::Nearest)[..4],
            [[0, 0, 255], [255, 0, 0], [85, 0, 170], [170, 0, 85]]
        );
    }

    #[test]
    fn devices_may_round_what_is_between() {
        let block = [0x00, 0xf8, 0x1f, 0x00, 0b1110_0100, 0, 0, 0];
        assert_eq!(
            decode(block, false, Between::Floored)[2..4],
            [[170, 0, 84], [85, 0, 169]]
        );
    }

    #[test]
    fn every_even_block_is_within_two_steps() {
        for byte in 0..=255u8 {
            let color = [byte, 255 - byte, byte / 2];
            let block = encode(&[color.map(f32::from); 16], &[1.0; 16]);
            for texel in decode(block, false, Between::Nearest) {
                for k in 0..3 {
                    assert!(texel[k].abs_diff(color[k]) <= 2, "{color:?} became {texel:?}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn two_colours_are_kept_and_weightless_texels_cost_nothing(
            colors in any::<[[u8; 3]; 2]>(), junk in any::<[u8; 3]>(), which in any::<u16>(), without in any::<u16>(),
        ) {
            let texels = std::array::from_fn(|t| {
                let color = if without >> t & 1 == 1 { junk } else { colors[usize::from(which >> t & 1)] };
                color.map(f32::from)
            });
            let weights = std::array::from_fn(|t| f32::from(u8::from(without >> t & 1 == 0)));
            let decoded = decode(encode(&texels, &weights), false, Between::Nearest);
            for t in (0..16).filter(|t| without >> t & 1 == 0) {
                for k in 0..3 {
                    let off = (f32::from(decoded[t][k]) - texels[t][k]).abs();
                    prop_assert!(off <= 5.0, "texel {}: {:?} became {:?}", t, texels[t], decoded[t]);
                }
            }
        }

        #[test]
        fn blocks_mean_the_same_in_bc1_and_bc3(texels in any::<[[u8; 3]; 16]>(), weights in any::<[u8; 16]>()) {
            let block = encode(&texels.map(|t| t.map(f32::from)), &weights.map(f32::from));
            prop_assert_eq!(decode(block, false, Between::Nearest), decode(block, true, Between::Nearest));
        }

        #[test]
        fn a_ramp_is_cut_into_no_less_than_four_steps(from in any::<[u8; 3]>(), to in any::<[u8; 3]>()) {
            let texels: [[f32; 3]; 16] = std::array::from_fn(|t| {
                std::array::from_fn(|k| {
                    f32::from(from[k]) + (f32::from(to[k]) - f32::from(from[k])) * t as f32 / 15.0
                })
            });
            let decoded = decode(encode(&texels, &[1.0; 16]), false, Between::Nearest);
            for (texel, got) in texels.iter().zip(decoded) {
                for k in 0..3 {
                    let step = f32::from(from[k].abs_diff(to[k])) / 6.0;
                    prop_assert!((f32::from(got[k]) - texel[k]).abs() <= step + 7.0);
                }
            }
        }
    }
}
