//! Samples to looks and back: what a sample is, without how much of it is there.
//!
//! Filtering mixes the looks of empty samples in where something begins, so these have the look of what is beside them. Looks that
//! nothing is near to weigh nothing. Pure functions: any thread.

use super::{NORMAL_SCALE, NORMAL_ZERO, Texels};
use crate::chunk::{Chunk, Layers};
use crate::layout::SampleLayout;
use crate::value::{linear_to_srgb, srgb_to_linear};

/// What an empty sample's look weighs for each of its neighbours that are not.
const BESIDE: f32 = 1.0 / 16.0;

/// The looks of a brick, components 0..255 of what blocks hold, x fastest.
pub(super) struct Looks {
    pub(super) color: Vec<[f32; 3]>,
    pub(super) normal: Vec<[f32; 3]>,
    /// None where the chunk has no opacities against the axes.
    pub(super) share: Option<Vec<[f32; 3]>>,
    /// How much errors matter.
    pub(super) weight: Vec<f32>,
}

/// Opacity under the builder's gain, by which normals are multiplied.
fn opacity(alpha: u8) -> f32 {
    (f32::from(alpha) * (2.0 / 255.0)).min(1.0)
}

impl Looks {
    /// The looks of brick k.
    pub(super) fn new(chunk: &Chunk, k: usize) -> Self {
        let (color, normal) = (chunk.brick_color(k), chunk.brick_normal(k));
        let share = |[x, y, z, _]: [u8; 4], a: u8| {
            [x, y, z].map(|v| (f32::from(v) / f32::from(a.max(1)) * 255.0).min(255.0))
        };
        let share = chunk.brick_opacity(k).map(|opacity| {
            let pairs = opacity.iter().zip(color);
            pairs.map(|(o, [.., a])| share(*o, *a)).collect::<Vec<_>>()
        });
        let mut looks = Self {
            color: color.iter().map(|c| straight_color(*c)).collect(),
            normal: (normal.iter().zip(color))
                .map(|(n, [.., a])| straight_normal(*n, *a))
                .collect(),
            share,
            weight: color
                .iter()
                .map(|[.., a]| 0.25 * f32::from(u8::from(*a > 0)) + 0.75 * opacity(*a))
                .collect(),
        };
        looks.spread(color, chunk.layout);
        looks
    }

    /// Gives empty samples the mean look of those around them.
    fn spread(&mut self, color: &[[u8; 4]], layout: SampleLayout) {
        let side = layout.side() as usize;
        let around = |v: usize| v.saturating_sub(1)..(v + 2).min(side);
        for at in (0..color.len()).filter(|at| color[*at][3] == 0) {
            let [x, y, z] = [at % side, at / side % side, at / (side * side)];
            let mut count = 0.0;
            let mut sums = [[0f32; 3]; 3];
            for near in around(z).flat_map(|z| around(y).map(move |y| (z * side + y) * side)) {
                for near in around(x).map(|x| near + x).filter(|near| color[*near][3] > 0) {
                    let weight = f32::from(color[near][3]);
                    count += weight;
                    let looks = [
                        self.color[near],
                        self.normal[near],
                        self.share.as_ref().map_or([0.0; 3], |s| s[near]),
                    ];
                    for (sum, look) in sums.iter_mut().zip(looks) {
                        for (sum, v) in sum.iter_mut().zip(look) {
                            *sum += weight * v;
                        }
                    }
                }
            }
            if count > 0.0 {
                let [color, normal, share] = sums.map(|sum| sum.map(|v| v / count));
                (self.color[at], self.normal[at]) = (color, normal);
                if let Some(shares) = &mut self.share {
                    shares[at] = share;
                }
                self.weight[at] = BESIDE * (count / 255.0).min(8.0);
            }
        }
    }
}

/// The colour that was multiplied with its alpha.
fn straight_color([r, g, b, a]: [u8; 4]) -> [f32; 3] {
    if a == 0 {
        return [0.0; 3];
    }
    let scale = 255.0 / f32::from(a);
    [r, g, b].map(|c| f32::from(linear_to_srgb(srgb_to_linear(c) * scale)))
}

/// The code of a normal that was multiplied with its opacity.
fn straight_normal(n: [i8; 4], a: u8) -> [f32; 3] {
    let scale = 1.0 / (127.0 * opacity(a.max(1)));
    std::array::from_fn(|k| {
        let straight = (f32::from(n[k]) * scale).clamp(-1.0, 1.0);
        f32::from(NORMAL_ZERO[k]) + straight * f32::from(NORMAL_SCALE[k])
    })
}

/// Adds the samples of a brick to a chunk.
pub(super) fn append(texels: &Texels, chunk: &mut Chunk) {
    let layers = if texels.share.is_empty() {
        Layers::Plain
    } else {
        Layers::Axes
    };
    for (at, [r, g, b, a]) in texels.color.iter().copied().enumerate() {
        let part = f32::from(a) / 255.0;
        let [r, g, b] = [r, g, b].map(|c| linear_to_srgb(srgb_to_linear(c) * part));
        chunk.color.push([r, g, b, a]);
        let code = texels.normal[at];
        let [x, y, z] = std::array::from_fn(|k| {
            let straight = (f32::from(code[k]) - f32::from(NORMAL_ZERO[k])) / f32::from(NORMAL_SCALE[k]);
            (straight * opacity(a) * 127.0).round().clamp(-127.0, 127.0) as i8
        });
        chunk.normal.push([x, y, z, 0]);
        if layers == Layers::Axes {
            let [x, y, z] = texels.share[at].map(|s| (f32::from(s) * part + 0.5) as u8);
            chunk.opacity.push([x, y, z, 0]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::{Between, BlockChunk};
    use crate::value::{BUILD_GAIN, Value};

    const SIDE: usize = 10;

    /// One sample in a brick of nothing, and opacities against the axes.
    fn single(value: Value, at: usize, shares: [u8; 3]) -> Chunk {
        let samples = SampleLayout::Centre.samples();
        let mut chunk = Chunk {
            mask: 1,
            layout: SampleLayout::Centre,
            color: vec![[0; 4]; samples],
            normal: vec![[0; 4]; samples],
            opacity: vec![[0; 4]; samples],
        };
        let stored = value.store(BUILD_GAIN);
        (chunk.color[at], chunk.normal[at]) = (stored.color, stored.normal);
        let [x, y, z] = shares;
        chunk.opacity[at] = [x, y, z, 0];
        chunk
    }

    #[test]
    fn looks_know_nothing_of_alpha_and_spread_to_what_is_beside_them() {
        let at = (4 * SIDE + 5) * SIDE + 6;
        for alpha in [8u8, 132, 255] {
            let value = Value {
                rgb: [0.5, 0.25, 0.75],
                alpha: f32::from(alpha) / 255.0,
                normal: [0.0, -0.6, 0.8],
            };
            let looks = Looks::new(&single(value, at, [alpha, alpha / 2, 0]), 0);
            let near = |a: [f32; 3], b: [f32; 3], bound: f32| {
                assert!(
                    (0..3).all(|k| (a[k] - b[k]).abs() <= bound),
                    "{alpha}: {a:?} {b:?}"
                );
            };
            // Small alphas leave few codes.
            let bound = if alpha < 100 { 12.0 } else { 2.0 };
            let [beside, corner, far] = [at + 1, at - 1 - SIDE - SIDE * SIDE, at + 2];
            for place in [at, beside, corner] {
                near(looks.color[place], [188.0, 137.0, 225.0], bound);
                near(looks.normal[place], [132.0, 55.0, 230.4], bound);
                let shares = looks.share.as_ref().unwrap()[place];
                near(shares, [255.0, 127.5, 0.0], 1.0);
            }
            assert_eq!(looks.weight[far], 0.0);
            assert!(looks.weight[at] > looks.weight[beside] && looks.weight[beside] > 0.0);
        }
    }

    #[test]
    fn texels_become_the_samples_that_they_were() {
        let at = 333;
        let value = Value {
            rgb: [0.9, 0.1, 0.4],
            alpha: 200.0 / 255.0,
            normal: [-0.8, 0.0, 0.6],
        };
        let chunk = single(value, at, [200, 50, 100]);
        let texels = BlockChunk::encode(&chunk).texels(0, Between::Nearest);
        // The look of a lone sample is all that its blocks have to code.
        let beside = texels.color[at + SIDE];
        assert_eq!(beside[3], 0);
        assert!((0..3).all(|k| beside[k].abs_diff(texels.color[at][k]) <= 8));
        let back = BlockChunk::encode(&chunk).samples();
        assert_eq!(back.color[at + SIDE], [0; 4]);
        let off = |a: [u8; 4], b: [u8; 4]| (0..4).map(|k| a[k].abs_diff(b[k])).max();
        assert!(
            off(back.color[at], chunk.color[at]) <= Some(3),
            "{:?}",
            back.color[at]
        );
        assert!(
            off(back.opacity[at], chunk.opacity[at]) <= Some(4),
            "{:?}",
            back.opacity[at]
        );
        let turned = (0..3)
            .map(|k| back.normal[at][k].abs_diff(chunk.normal[at][k]))
            .max();
        assert!(turned <= Some(4), "{:?}", back.normal[at]);
        assert_eq!(back.normal[at][1], 0, "nothing is exactly nothing");
    }
}
