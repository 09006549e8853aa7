//! What values do to a ray over a segment: opacity, light, compositing.
//!
//! A stored opacity is that of one voxel of the sample's level; a segment of `s` voxels has `1-(1-a)^s`. Colours are
//! premultiplied linear light. Pure functions of plain values: any thread.

use brickfell_formats::value::decode_color;
use glam::DVec3;

use super::real::Real;
use crate::picture::RayCounters;
use crate::settings::RenderSettings;

/// Three components.
pub(crate) type Triple<T> = [T; 3];

/// What a segment adds to a ray.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Layer<T> {
    /// Premultiplied linear rgb and opacity.
    pub(crate) rgba: [T; 4],
    /// Its unit normal times what is lit of it.
    pub(crate) facing: Triple<T>,
    /// Opacity of what is lit, and that times the cosine between normal and sun.
    pub(crate) lit: [T; 2],
}

#[inline(always)]
pub(crate) fn dot<T: Real>(a: &Triple<T>, b: &Triple<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A value before opacity is converted to a segment's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Value<T> {
    /// Linear rgb times stored alpha.
    pub(crate) rgb: Triple<T>,
    /// Stored alpha, the tree's gain not applied.
    pub(crate) alpha: T,
    /// Mean normal times opacity, world axes.
    pub(crate) normal: Triple<T>,
    /// Stored opacities against the axes, the gain not applied, where they are told apart.
    pub(crate) axes: Option<Triple<T>>,
}

impl<T: Real> Value<T> {
    /// What a constant node shows everywhere.
    pub(crate) fn constant(color: [u8; 4]) -> Self {
        let [r, g, b, alpha] = decode_color(color).map(T::of);
        Self {
            rgb: [r, g, b],
            alpha,
            ..Self::default()
        }
    }
}

/// Turns values into what a segment adds to a ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shading<T> {
    sun: Triple<T>,
    ambient: T,
    diffuse: T,
    /// Below it lengths and opacities count as nothing.
    tiny: T,
    weight: T,
}

impl<T: Real> Shading<T> {
    /// The light of a picture.
    pub(crate) fn new(settings: &RenderSettings) -> Self {
        Self {
            sun: settings.sun.to_array().map(T::of),
            ambient: T::of(settings.ambient),
            diffuse: T::of(settings.diffuse),
            tiny: T::of(1e-6),
            weight: T::of(8.0),
        }
    }

    /// The layer of a segment that is `length` voxels of the value's level long, along a direction (of length 1).
    #[inline(always)]
    pub(crate) fn layer(&self, value: &Value<T>, gain: T, length: T, direction: &Triple<T>) -> Layer<T> {
        if !(value.alpha > T::ZERO && length > T::ZERO) {
            return Layer::default();
        }
        let a = (gain * value.alpha).min(T::ONE);
        let normal = dot(&value.normal, &value.normal).sqrt();
        let depth = match value.axes {
            None => a.optical_depth(),
            Some(axes) => {
                let depths = axes.map(|x| (gain * x).optical_depth());
                let n = normal.max(self.tiny);
                let flat = ((n + n) / a.max(self.tiny)).min(T::ONE);
                let along = dot(direction, &value.normal) / n;
                let sheet = dot(&depths, &depths) * along * along;
                let across = [0, 1, 2].map(|k| depths[k] * direction[k]);
                let cloud = dot(&across, &across);
                (cloud + flat * (sheet - cloud)).max(T::ZERO).sqrt()
            }
        };
        let [lit, sunlit] = self.lit(&value.normal, normal, a);
        let light = T::ONE + lit * (self.ambient - T::ONE) + sunlit * self.diffuse;
        let opacity = (length * depth).opacity();
        let scale = opacity * (light / value.alpha);
        let [r, g, b] = value.rgb.map(|c| c * scale);
        Layer {
            rgba: [r, g, b, opacity],
            facing: value.normal.map(|n| n * (lit * opacity / normal.max(self.tiny))),
            lit: [lit * opacity, sunlit * opacity],
        }
    }

    /// How much is lit, for a normal times opacity `a`, and that times the cosine between normal and sun. Where the normals of a place
    /// cancel out there is no surface to light, so short normals fade to unlit.
    #[inline(always)]
    fn lit(&self, normal: &Triple<T>, length: T, a: T) -> [T; 2] {
        if length < self.tiny {
            return [T::ZERO; 2];
        }
        let lit = (self.weight * length / a.max(self.tiny)).min(T::ONE);
        [lit, lit * (dot(normal, &self.sun) / length).max(T::ZERO)]
    }
}

/// Mixes two layers of the same segment, `weight` for `b`.
#[inline(always)]
pub(crate) fn mix<T: Real>(a: &Layer<T>, b: &Layer<T>, weight: T) -> Layer<T> {
    let mix = |a: T, b: T| a * (T::ONE - weight) + b * weight;
    Layer {
        rgba: [0, 1, 2, 3].map(|k| mix(a.rgba[k], b.rgba[k])),
        facing: [0, 1, 2].map(|k| mix(a.facing[k], b.facing[k])),
        lit: [0, 1].map(|k| mix(a.lit[k], b.lit[k])),
    }
}

/// Transmittance below which a ray is taken to be opaque.
const OPAQUE: f64 = 1.0 / 1024.0;

/// Components from here on count as not finite.
const LARGEST: f64 = 1e6;

/// The surface that a ray sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Surface {
    /// Depth where the ray has lost half of its light, or if it never does the mean depth of what it sees.
    pub(crate) depth: f64,
    /// Finest voxel there, metres.
    pub(crate) finest: f64,
    /// Mean unit normal of what is lit, times its share of what is seen.
    pub(crate) facing: DVec3,
    /// Share of what is seen that is lit, and that times the cosine between normal and sun.
    pub(crate) lit: [f64; 2],
}

/// What a ray has gathered, front to back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transport<T> {
    color: Triple<T>,
    transmittance: T,
    opaque: T,
    /// Sums over what is lit, see [`Surface`], and of depths, by what each adds to the ray's opacity.
    facing: Triple<T>,
    lit: [T; 2],
    mean_depth: f64,
    /// Where half of the light is lost, once it is, and the finest voxel of the tree there or of the last one.
    half_depth: Option<f64>,
    finest: f64,
    /// Counts of this ray; `rays_hit` and `not_finite` are not used.
    pub(crate) counters: RayCounters,
}

impl<T: Real> Default for Transport<T> {
    fn default() -> Self {
        Self {
            color: [T::ZERO; 3],
            transmittance: T::ONE,
            opaque: T::of(OPAQUE),
            facing: [T::ZERO; 3],
            lit: [T::ZERO; 2],
            mean_depth: 0.0,
            half_depth: None,
            finest: 0.0,
            counters: RayCounters::default(),
        }
    }
}

impl<T: Real> Transport<T> {
    /// True once nothing behind can be seen.
    #[inline(always)]
    pub(crate) fn saturated(&self) -> bool {
        self.transmittance == T::ZERO
    }

    /// Light that is left.
    pub(crate) fn transmittance(&self) -> f64 {
        self.transmittance.wide()
    }

    /// Notes what a layer that is about to be added, `dz` metres from depth `z` on, has of the surface that is seen.
    #[inline(always)]
    pub(crate) fn note(&mut self, layer: &Layer<T>, z: f64, dz: f64, finest: f64) {
        let (before, a) = (self.transmittance, layer.rgba[3]);
        if a <= T::ZERO {
            return;
        }
        self.facing = [0, 1, 2].map(|k| self.facing[k] + layer.facing[k] * before);
        self.lit = [0, 1].map(|k| self.lit[k] + layer.lit[k] * before);
        if self.half_depth.is_some() {
            return;
        }
        self.finest = finest;
        self.mean_depth += (before * a).wide() * (z + 0.5 * dz);
        let after = before * (T::ONE - a);
        if after <= T::HALF {
            // Light falls off by the same part with each length.
            let part = (before + before).log2() / (before / after.max(T::of(1e-30))).log2();
            self.half_depth = Some(z + part.wide() * dz);
        }
    }

    /// The surface that is seen, if there is any.
    pub(crate) fn surface(&self) -> Option<Surface> {
        let seen = 1.0 - self.transmittance();
        (seen > 0.0).then(|| Surface {
            depth: self.half_depth.unwrap_or(self.mean_depth / seen),
            finest: self.finest,
            facing: DVec3::from(self.facing.map(Real::wide)) / seen,
            lit: self.lit.map(|x| x.wide() / seen),
        })
    }

    /// Adds a layer behind what is there.
    #[inline(always)]
    pub(crate) fn under(&mut self, [r, g, b, a]: [T; 4]) {
        let t = self.transmittance;
        self.color = [
            self.color[0] + r * t,
            self.color[1] + g * t,
            self.color[2] + b * t,
        ];
        self.transmittance = t * (T::ONE - a);
        if self.transmittance < self.opaque {
            let part = T::ONE - self.transmittance;
            self.color = self.color.map(|c| c / part);
            self.transmittance = T::ZERO;
        }
    }

    /// Premultiplied linear colour, in a share of its light, and alpha, and the counters of a picture with this ray: what is not finite
    /// is nothing, and of rays that hit nothing only the cap counts.
    pub(crate) fn finish(&self, light: T) -> ([T; 4], RayCounters) {
        let [r, g, b] = self.color.map(|c| c * light);
        let rgba = [r, g, b, T::ONE - self.transmittance];
        let mut counters = RayCounters {
            capped: self.counters.capped,
            ..RayCounters::default()
        };
        // Not-a-number is not below anything.
        let largest = T::of(LARGEST);
        if !rgba.iter().all(|c| *c < largest && -largest < *c) {
            counters.not_finite = 1;
            return ([T::ZERO; 4], counters);
        }
        if rgba[3] > T::ZERO {
            counters = RayCounters {
                rays_hit: 1,
                ..self.counters
            };
        }
        (rgba, counters)
    }
}
