//! What a node shows at a point, and what that does to a ray over a segment: filtering, light, opacity.
//!
//! A stored opacity is that of one voxel of the sample's level; a segment of `s` voxels has `1-(1-a)^s`. Colours are
//! premultiplied linear light. Pure functions of plain values: any thread.

use std::sync::LazyLock;

use brickfell_formats::blocks::{NORMAL_SCALE, NORMAL_ZERO, Texels};
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::NodeData;
use brickfell_formats::value::{decode_color, decode_normal, srgb_to_linear_f64};
use glam::DVec3;

use super::ReferenceError;
use super::tree::Tree;
use crate::settings::RenderSettings;

/// Premultiplied linear rgb and opacity of a segment.
pub(super) type Layer = [f64; 4];

/// Linear light of every sRGB code.
static LINEAR: LazyLock<[f64; 256]> = LazyLock::new(|| std::array::from_fn(|c| srgb_to_linear_f64(c as u8)));

/// Components of every normal code, by the code's bits.
static NORMAL: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|c| decode_normal([c as u8 as i8, 0, 0, 0])[0]));

/// A value before opacity is converted to a segment's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Value {
    /// Linear rgb times stored alpha.
    pub(super) rgb: DVec3,
    /// Stored alpha, the tree's gain not applied.
    pub(super) alpha: f64,
    /// Mean normal times opacity, world axes.
    pub(super) normal: DVec3,
    /// Stored opacities against the axes, the gain not applied, where they are told apart.
    pub(super) axes: Option<DVec3>,
}

impl Value {
    /// What a constant node shows everywhere.
    pub(super) fn constant(color: [u8; 4]) -> Self {
        let [r, g, b, alpha] = decode_color(color);
        Self {
            rgb: DVec3::new(r, g, b),
            alpha,
            normal: DVec3::ZERO,
            axes: None,
        }
    }

    const EMPTY: Self = Self {
        rgb: DVec3::ZERO,
        alpha: 0.0,
        normal: DVec3::ZERO,
        axes: None,
    };
}

/// The samples of one brick, x fastest.
#[derive(Clone, Copy)]
pub(super) enum Samples<'a> {
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

    /// One sample, decoded.
    fn value(&self, at: usize) -> Value {
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
        Value {
            rgb: DVec3::from(rgb.map(|c| LINEAR[usize::from(c)])),
            alpha: f64::from(self.alpha(at)) / 255.0,
            normal: DVec3::from(normal),
            axes: axes.map(|a| DVec3::from(a.map(f64::from)) / 255.0),
        }
    }
}

/// A brick.
#[derive(Clone, Copy)]
pub(super) struct Brick<'a> {
    /// Its samples.
    pub(super) samples: Samples<'a>,
    /// Where the samples lie.
    pub(super) layout: SampleLayout,
}

impl Brick<'_> {
    /// Trilinear value at a position in the brick (voxels of its level from its low corner, 0..8 per axis), which is
    /// rounded to 1/256 voxel. `reads` counts the trilinear reads: one for an empty place, else
    /// colour, normal, and the opacities if there are any.
    pub(super) fn value(&self, local: DVec3, reads: &mut u64) -> Value {
        let side = self.layout.side() as usize;
        let local = local.clamp(DVec3::ZERO, DVec3::splat(f64::from(BRICK_VOXELS)));
        let texel = (local * 256.0 + 0.5).floor() / 256.0 + (self.layout.texel_offset() - 0.5);
        let base = texel.floor().min(DVec3::splat(side as f64 - 2.0));
        let t = texel - base;
        let first = (base.z as usize * side + base.y as usize) * side + base.x as usize;
        *reads += 1;
        let corners: [usize; 8] =
            std::array::from_fn(|k| first + (k & 1) + (k >> 1 & 1) * side + (k >> 2) * side * side);
        if corners.iter().all(|c| self.samples.alpha(*c) == 0) {
            return Value::EMPTY;
        }
        *reads += 1 + u64::from(self.samples.has_axes());
        let mut out = Value::EMPTY;
        for (k, corner) in corners.into_iter().enumerate() {
            let pick = |axis: usize| {
                if k >> axis & 1 == 1 {
                    t[axis]
                } else {
                    1.0 - t[axis]
                }
            };
            let weight = pick(0) * pick(1) * pick(2);
            let sample = self.samples.value(corner);
            out.rgb += sample.rgb * weight;
            out.normal += sample.normal * weight;
            out.alpha += sample.alpha * weight;
            if let Some(axes) = sample.axes {
                out.axes = Some(out.axes.unwrap_or_default() + axes * weight);
            }
        }
        if let Samples::Looks(_) = self.samples {
            out.rgb *= out.alpha;
            out.normal *= (2.0 * out.alpha).min(1.0);
            out.axes = out.axes.map(|axes| axes * out.alpha);
        }
        out
    }
}

/// What a node shows at its own level, ready to be evaluated.
#[derive(Clone, Copy)]
pub(super) enum Shown<'t> {
    /// One value everywhere.
    Constant(Value),
    /// A brick.
    Brick(Brick<'t>),
}

impl<'t> Shown<'t> {
    /// Fetches what a node of a level shows.
    pub(super) fn fetch(tree: &'t Tree, level: u8, data: NodeData) -> Result<Self, ReferenceError> {
        Ok(match data {
            NodeData::Constant(color) => Self::Constant(Value::constant(color)),
            NodeData::Brick(number) => Self::Brick(tree.brick(level, number)?),
        })
    }

    /// Value at a position in the node, in voxels of its level from its low corner.
    pub(super) fn value(&self, local: DVec3, reads: &mut u64) -> Value {
        match self {
            Self::Constant(value) => *value,
            Self::Brick(brick) => brick.value(local, reads),
        }
    }
}

/// Turns values into what a segment adds to a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shading {
    sun: DVec3,
    ambient: f64,
    diffuse: f64,
}

/// The most opacity across a voxel: a voxel of it ends a ray, and the opacity of a short segment is continuous in the value.
const MOST_OPAQUE: f64 = 1.0 - 1.0 / 2048.0;

impl Shading {
    /// The light of a picture.
    pub(super) fn new(settings: &RenderSettings) -> Self {
        Self {
            sun: settings.sun,
            ambient: settings.ambient,
            diffuse: settings.diffuse,
        }
    }

    /// The layer of a segment that is `length` voxels of the value's level long, along a direction (of length 1).
    pub(super) fn layer(&self, value: &Value, gain: f64, length: f64, direction: DVec3) -> Layer {
        if value.alpha <= 0.0 || length <= 0.0 {
            return [0.0; 4];
        }
        let a = (gain * value.alpha).min(1.0);
        let depth_of = |a: f64| -(-a.min(MOST_OPAQUE)).ln_1p();
        let depth = match value.axes {
            None => depth_of(a),
            Some(axes) => {
                let depths = DVec3::from((gain * axes).to_array().map(depth_of));
                let length = value.normal.length().max(1e-6);
                let flat = (2.0 * length / a.max(1e-6)).min(1.0);
                let sheet = depths.length_squared() * (direction.dot(value.normal) / length).powi(2);
                let cloud = (depths * direction).length_squared();
                (cloud + flat * (sheet - cloud)).sqrt()
            }
        };
        let opacity = -(-length * depth).exp_m1();
        let [r, g, b] = (value.rgb * (opacity / value.alpha * self.light(value.normal, a))).to_array();
        [r, g, b, opacity]
    }

    /// Share of the albedo that is seen, for a normal times opacity `a`. Where the normals of a place cancel out there
    /// is no surface to light, so short normals fade to unlit.
    fn light(&self, normal: DVec3, a: f64) -> f64 {
        let length = normal.length();
        if length < 1e-6 {
            return 1.0;
        }
        let weight = (8.0 * length / a.max(1e-6)).clamp(0.0, 1.0);
        let lit = self.ambient + self.diffuse * (normal / length).dot(self.sun).max(0.0);
        1.0 + weight * (lit - 1.0)
    }
}

/// Mixes two layers of the same segment, `weight` for `b`.
pub(super) fn mix(a: &Layer, b: &Layer, weight: f64) -> Layer {
    std::array::from_fn(|k| a[k] * (1.0 - weight) + b[k] * weight)
}
