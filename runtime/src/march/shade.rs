//! What values do to a ray over a segment: opacity, light, compositing.
//!
//! A stored opacity is that of one voxel of the sample's level; a segment of `s` voxels has `1-(1-a)^s`. Colours are
//! premultiplied linear light. Pure functions of plain values: any thread.

use brickfell_formats::value::decode_color;

use super::real::Real;
use crate::picture::RayCounters;
use crate::settings::RenderSettings;

/// Three components.
pub(crate) type Triple<T> = [T; 3];

/// Premultiplied linear rgb and opacity of a segment.
pub(crate) type Layer<T> = [T; 4];

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
            return [T::ZERO; 4];
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
        let albedo = self.light(&value.normal, normal, a) / value.alpha;
        let opacity = (length * depth).opacity();
        let scale = opacity * albedo;
        let [r, g, b] = value.rgb.map(|c| c * scale);
        [r, g, b, opacity]
    }

    /// Share of the albedo that is seen, for a normal times opacity `a`. Where the normals of a place cancel out there
    /// is no surface to light, so short normals fade to unlit.
    #[inline(always)]
    fn light(&self, normal: &Triple<T>, length: T, a: T) -> T {
        if length < self.tiny {
            return T::ONE;
        }
        let weight = (self.weight * length / a.max(self.tiny)).min(T::ONE);
        let lit = self.ambient + self.diffuse * (dot(normal, &self.sun) / length).max(T::ZERO);
        T::ONE + weight * (lit - T::ONE)
    }
}

/// Mixes two layers of the same segment, `weight` for `b`.
#[inline(always)]
pub(crate) fn mix<T: Real>(a: &Layer<T>, b: &Layer<T>, weight: T) -> Layer<T> {
    [0, 1, 2, 3].map(|k| a[k] * (T::ONE - weight) + b[k] * weight)
}

/// Transmittance below which a ray is taken to be opaque.
const OPAQUE: f64 = 1.0 / 1024.0;

/// Components from here on count as not finite.
const LARGEST: f64 = 1e6;

/// What a ray has gathered, front to back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transport<T> {
    color: Triple<T>,
    transmittance: T,
    opaque: T,
    /// Counts of this ray; `rays_hit` and `not_finite` are not used.
    pub(crate) counters: RayCounters,
}

impl<T: Real> Default for Transport<T> {
    fn default() -> Self {
        Self {
            color: [T::ZERO; 3],
            transmittance: T::ONE,
            opaque: T::of(OPAQUE),
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

    /// Adds a layer behind what is there.
    #[inline(always)]
    pub(crate) fn under(&mut self, [r, g, b, a]: Layer<T>) {
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

    /// Premultiplied linear colour and alpha, and the counters of a picture with this ray: what is not finite is nothing, and of
    /// rays that hit nothing only the cap counts.
    pub(crate) fn finish(&self) -> ([T; 4], RayCounters) {
        let [r, g, b] = self.color;
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
