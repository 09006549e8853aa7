//! A sample while it is being built, the mean of samples, and the step to what is stored.
//!
//! A sample keeps apart what a stored alpha puts together: `skin`, the opacity of open surfaces (0..2; above 1 it is
//! over-saturated so that a skin stays opaque at every phase of the interpolation), and `solid`, the filled part of the
//! voxel (0..1). Colour and normal have a weight of their own, the part of the voxel that surfaces meet: solid ground
//! has none, so it never tints a coarser voxel. Every step is rounded the same way whatever tree asks for it.

use bytemuck::{Pod, Zeroable};

use brickfell_formats::steps::Steps;
use brickfell_formats::value::{Codes, SOLID_ALPHA, Stored, opacity_level, opacity_of_level};

use super::ground::Hint;

/// Full solid.
pub(crate) const SOLID: u16 = u16::MAX;
/// Code of skin 1.
const SKIN_ONE: f32 = 32767.0;
/// Most of a skin: opaque at every phase of the interpolation.
pub(crate) const SKIN_MAX: f32 = 2.0;
const NORMAL_ONE: f32 = 32767.0;

/// One sample: 20 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Sample {
    /// Weight of colour and normal, 0..1; a float since it falls by 8 a level where surfaces are small.
    pub(crate) weight: f32,
    skin: u16,
    solid: u16,
    rgb: [u16; 3],
    normal: [i16; 3],
}

/// A sample before rounding. Colour: straight linear light. Normal: length ≤ 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Look {
    pub(crate) skin: f32,
    pub(crate) solid: f32,
    pub(crate) weight: f32,
    pub(crate) rgb: [f32; 3],
    pub(crate) normal: [f32; 3],
}

fn code(v: f32, one: f32) -> u16 {
    (v * one + 0.5) as u16
}

/// The nearest code of a signed value; a call to `round` would cost more than the rest.
fn signed_code(v: f32) -> i16 {
    ((v + 32768.5) as i32 - 32768) as i16
}

impl Sample {
    /// Solid all through, met by no surface.
    pub(crate) const DEEP: Sample = Sample {
        weight: 0.0,
        skin: 0,
        solid: SOLID,
        rgb: [0; 3],
        normal: [0; 3],
    };

    /// Rounds a look.
    pub(crate) fn new(look: &Look) -> Self {
        Self {
            weight: look.weight,
            skin: code(look.skin.clamp(0.0, SKIN_MAX), SKIN_ONE),
            solid: code(look.solid.clamp(0.0, 1.0), f32::from(SOLID)),
            rgb: look.rgb.map(|c| code(c.clamp(0.0, 1.0), 65535.0)),
            normal: look.normal.map(|c| signed_code(c.clamp(-1.0, 1.0) * NORMAL_ONE)),
        }
    }

    /// Opacity of open surfaces, 0..2.
    pub(crate) fn skin(&self) -> f32 {
        f32::from(self.skin) / SKIN_ONE
    }

    /// The same with another skin.
    pub(crate) fn with_skin(self, skin: f32) -> Self {
        Self {
            skin: code(skin.min(SKIN_MAX), SKIN_ONE),
            ..self
        }
    }

    /// Whether nothing is there.
    pub(crate) fn is_empty(&self) -> bool {
        self.skin == 0 && self.solid == 0 && self.weight == 0.0
    }

    /// Whether some of it is solid.
    pub(crate) fn is_partly_solid(&self) -> bool {
        self.solid > 0
    }

    /// Whether it is solid all through and met by no surface.
    pub(crate) fn is_deep(&self) -> bool {
        self.solid == SOLID && self.skin == 0 && self.weight == 0.0
    }

    /// What is stored of its opacity if that against each axis is told apart.
    pub(crate) fn opacities(&self, skins: [f32; 3]) -> [u8; 3] {
        skins.map(|skin| self.alpha(code(skin.min(SKIN_MAX), SKIN_ONE)))
    }

    /// The alpha to be stored with a skin: in steps of which nobody sees that they are not finer, as noise in them is a tenth of a file
    /// of a mesh.
    fn alpha(&self, skin: u16) -> u8 {
        let skin = f32::from(skin) * (127.5 / SKIN_ONE);
        let solid = f32::from(self.solid) * (f32::from(SOLID_ALPHA) / f32::from(SOLID));
        opacity_of_level(opacity_level((skin + solid + 0.5) as u8))
    }

    /// Whether a surface meets it.
    pub(crate) fn is_surface(&self) -> bool {
        self.weight > 0.0
    }

    /// Whether a surface meets it and its ground is not stored as solid all through.
    pub(crate) fn is_open(&self) -> bool {
        self.is_surface() && self.alpha(0) != SOLID_ALPHA
    }

    /// Colour and normal of its surfaces in steps of a byte.
    pub(crate) fn codes(&self) -> Codes {
        Codes::new(
            self.rgb.map(|c| f32::from(c) / 65535.0),
            self.normal.map(|c| f32::from(c) / NORMAL_ONE),
        )
    }

    /// What is stored with a look, its own or, of solid that no surface gives one, that of the ground above.
    pub(crate) fn stored(&self, look: &Codes) -> Stored {
        match self.alpha(self.skin) {
            0 => Stored::default(),
            alpha => look.store(alpha),
        }
    }
}

/// What is stored of deep solid with a look, in steps.
pub(crate) fn stored_solid(look: &Hint, steps: Steps) -> Stored {
    look.codes().in_steps(steps).store(SOLID_ALPHA)
}

impl Hint {
    /// In steps of a byte.
    pub(crate) fn codes(&self) -> Codes {
        Codes::new(self.rgb, self.normal)
    }
}

/// A weighted mean of samples, weights adding up to 1.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mean {
    skin: f32,
    solid: f32,
    weight: f32,
    rgb: [f32; 3],
    normal: [f32; 3],
}

impl Mean {
    /// Adds a sample.
    #[inline]
    pub(crate) fn add(&mut self, s: &Sample, share: f32) {
        self.skin += f32::from(s.skin) * share;
        self.solid += f32::from(s.solid) * share;
        if s.weight > 0.0 {
            let w = s.weight * share;
            self.weight += w;
            for k in 0..3 {
                self.rgb[k] += f32::from(s.rgb[k]) * w;
                self.normal[k] += f32::from(s.normal[k]) * w;
            }
        }
    }

    /// Mean of the skins, 0..2.
    #[inline]
    pub(crate) fn skin(&self) -> f32 {
        self.skin / SKIN_ONE
    }

    /// Mean of the weights.
    #[inline]
    pub(crate) fn weight(&self) -> f32 {
        self.weight
    }

    /// The sample one level up, with the skin that the filter gives it.
    #[inline]
    pub(crate) fn sample(&self, skin: f32) -> Sample {
        let inverse = if self.weight > 0.0 { 1.0 / self.weight } else { 0.0 };
        Sample {
            weight: self.weight,
            skin: code(skin.min(SKIN_MAX), SKIN_ONE),
            solid: (self.solid + 0.5) as u16,
            rgb: self.rgb.map(|c| (c * inverse + 0.5) as u16),
            normal: self.normal.map(|c| signed_code(c * inverse)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_formats::value::{SKIN_ALPHA, decode_color};

    fn stored(sample: &Sample, hint: Hint) -> Stored {
        let look = if sample.is_surface() {
            sample.codes()
        } else {
            hint.codes()
        };
        sample.stored(&look)
    }

    fn mean(samples: &[Sample; 8]) -> Sample {
        let mut mean = Mean::default();
        samples.iter().for_each(|s| mean.add(s, 0.125));
        mean.sample(0.0)
    }

    #[test]
    fn solid_and_skin_are_stored_opaque() {
        assert_eq!(size_of::<Sample>(), 20);
        let up = Hint {
            rgb: [0.5; 3],
            normal: [0.0, 0.0, 1.0],
        };
        let deep = stored(&Sample::DEEP, up);
        assert_eq!(deep, stored_solid(&up, Steps::within(0)));
        assert_eq!((deep.color[3], deep.normal), (SOLID_ALPHA, [0, 0, 127, 0]));
        let skin = Look {
            skin: 2.0,
            weight: 1.0,
            rgb: [1.0, 0.5, 0.0],
            normal: [0.0, 0.0, 1.0],
            solid: 0.0,
        };
        let texel = stored(&Sample::new(&skin), Hint::default());
        assert_eq!((texel.color[3], texel.normal), (SKIN_ALPHA, [0, 0, 127, 0]));
        let c = decode_color(texel.color);
        assert!((c[1] - 0.5).abs() < 0.01 && c[2] == 0.0);
    }

    #[test]
    fn solid_never_tints() {
        let red = Look {
            weight: 1.0,
            solid: 0.5,
            rgb: [0.8, 0.0, 0.0],
            ..Look::default()
        };
        let mixed = [Sample::new(&red), Sample::DEEP, Sample::DEEP, Sample::DEEP];
        let all = mean(&std::array::from_fn(|k| mixed[k % 4]));
        let green = Hint {
            rgb: [0.0, 1.0, 0.0],
            ..Hint::default()
        };
        let texel = stored(&all, green);
        let c = decode_color(texel.color);
        assert!((c[0] / c[3] - 0.8).abs() < 0.01 && c[1] == 0.0, "{c:?}");
    }
}
