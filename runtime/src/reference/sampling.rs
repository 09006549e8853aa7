//! Filtering of bricks as they are stored, sample by sample. Pure functions of plain values: any thread.

use std::sync::LazyLock;

use brickfell_formats::blocks::{NORMAL_SCALE, NORMAL_ZERO, Texels};
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::value::{decode_normal, srgb_to_linear_f64};
use glam::DVec3;

use crate::march::{self, ALL, Mask, Value};

/// Linear light of every sRGB code.
static LINEAR: LazyLock<[f64; 256]> = LazyLock::new(|| std::array::from_fn(|c| srgb_to_linear_f64(c as u8)));

/// Components of every normal code, by the code's bits.
static NORMAL: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|c| decode_normal([c as u8 as i8, 0, 0, 0])[0]));

/// The samples of one brick, x fastest.
#[derive(Clone, Copy)]
pub(crate) enum Samples<'a> {
    /// As they are stored, each multiplied with its own alpha.
    Stored {
        /// Stored colours.
        color: &'a [[u8; 4]],
        /// Stored normals.
        normal: &'a [[i8; 4]],
        /// Stored opacities against the axes, if there are any.
        opacity: Option<&'a [[u8; 4]]>,
    },
    /// Of a brick in blocks, to be multiplied with alpha once they are filtered.
    Looks(&'a Texels),
}

/// One sample, decoded.
struct Sample {
    rgb: [f64; 3],
    normal: [f64; 3],
    axes: Option<[f64; 3]>,
}

impl Samples<'_> {
    fn alpha(&self, at: usize) -> u8 {
        match self {
            Self::Stored { color, .. } => color[at][3],
            Self::Looks(texels) => texels.color[at][3],
        }
    }

    fn has_axes(&self) -> bool {
        match self {
            Self::Stored { opacity, .. } => opacity.is_some(),
            Self::Looks(texels) => !texels.share.is_empty(),
        }
    }

    fn sample(&self, at: usize) -> Sample {
        let (rgb, normal, axes) = match *self {
            Self::Stored {
                color,
                normal,
                opacity,
            } => {
                let ([r, g, b, _], [x, y, z, _]) = (color[at], normal[at]);
                let axes = opacity.map(|o| {
                    let [x, y, z, _] = o[at];
                    [x, y, z]
                });
                let normal = [x, y, z].map(|c| NORMAL[usize::from(c as u8)]);
                ([r, g, b], normal, axes)
            }
            Self::Looks(texels) => {
                let ([r, g, b, _], codes) = (texels.color[at], texels.normal[at]);
                let normal = std::array::from_fn(|k| {
                    (f64::from(codes[k]) - f64::from(NORMAL_ZERO[k])) / f64::from(NORMAL_SCALE[k])
                });
                ([r, g, b], normal, texels.share.get(at).copied())
            }
        };
        Sample {
            rgb: rgb.map(|c| LINEAR[usize::from(c)]),
            normal,
            axes: axes.map(|a| a.map(|x| f64::from(x) / 255.0)),
        }
    }
}

/// A brick.
#[derive(Clone, Copy)]
pub(crate) struct Brick<'a> {
    /// Its samples.
    pub(crate) samples: Samples<'a>,
    /// Where the samples lie.
    pub(crate) layout: SampleLayout,
}

impl march::Brick<f64> for Brick<'_> {
    /// All of it: every voxel is looked at, so that what is skipped elsewhere can be checked.
    fn occupied(&self) -> &Mask {
        &ALL
    }

    fn value(&self, local: [f64; 3], reads: &mut u64) -> Value<f64> {
        let side = self.layout.side() as usize;
        let local = DVec3::from(local).clamp(DVec3::ZERO, DVec3::splat(f64::from(BRICK_VOXELS)));
        let texel = (local * 256.0 + 0.5).floor() / 256.0 + (self.layout.texel_offset() - 0.5);
        let base = texel.floor().min(DVec3::splat(side as f64 - 2.0));
        let t = texel - base;
        let first = (base.z as usize * side + base.y as usize) * side + base.x as usize;
        *reads += 1;
        let corners: [usize; 8] =
            std::array::from_fn(|k| first + (k & 1) + (k >> 1 & 1) * side + (k >> 2) * side * side);
        let mut out = Value::default();
        if corners.iter().all(|c| self.samples.alpha(*c) == 0) {
            return out;
        }
        *reads += 1 + u64::from(self.samples.has_axes());
        for (k, corner) in corners.into_iter().enumerate() {
            let pick = |axis: usize| {
                if k >> axis & 1 == 1 {
                    t[axis]
                } else {
                    1.0 - t[axis]
                }
            };
            let weight = pick(0) * pick(1) * pick(2);
            let sample = self.samples.sample(corner);
            let add = |sum: [f64; 3], part: [f64; 3]| std::array::from_fn(|k| sum[k] + part[k] * weight);
            out.rgb = add(out.rgb, sample.rgb);
            out.normal = add(out.normal, sample.normal);
            out.alpha += f64::from(self.samples.alpha(corner)) / 255.0 * weight;
            out.axes = sample.axes.map(|axes| add(out.axes.unwrap_or_default(), axes));
        }
        if let Samples::Looks(_) = self.samples {
            let fade = (2.0 * out.alpha).min(1.0);
            out.rgb = out.rgb.map(|c| c * out.alpha);
            out.normal = out.normal.map(|c| c * fade);
            out.axes = out.axes.map(|axes| axes.map(|c| c * out.alpha));
        }
        out
    }
}
