//! What a stored sample means, in one place. Everything that writes or reads samples goes through here.
//!
//! A sample is `[r, g, b, a]` (8 bits each) and `[nx, ny, nz, 0]` (8 bits signed each).
//!
//! - `a/255 · gain`, clamped to 1, is the **opacity across one voxel of the sample's own level** (for a constant node:
//!   across an eighth of the node's side). The gain is a property of the tree: built trees store at half scale (gain 2) so
//!   that open skins can be over-saturated and stay opaque at every phase of the interpolation; hand-written trees may
//!   use gain 1.
//! - `rgb` is the linear-light colour times `a/255`, stored in the sRGB encoding (`sRGB(colour · a/255)`): filtering happens
//!   after decoding, in linear light, and dark colours keep their precision.
//! - Where a file has them, `[x, y, z, 0]` are opacities like `a`, against the three axes: of a ray along that axis. Then `a` is
//!   the largest of them, and only what the colour is multiplied by.
//! - `n` is the mean normal (world axes, length ≤ 1: short where normals disagree) times the opacity, over 127.

use std::sync::LazyLock;

use crate::steps::{COLOR_ZERO, NORMAL_ZERO, Steps};

/// The gain of trees written by the builder.
pub const BUILD_GAIN: u8 = 2;

/// Stored alpha of solid ground under [`BUILD_GAIN`]: opaque with a margin of some rounding steps of a texture unit.
pub const SOLID_ALPHA: u8 = 132;

/// Opacities that builders keep to: up to solid in steps of [`OPACITY_STEP`], beyond it in [`SKIN_STEPS`] to [`SKIN_ALPHA`], where
/// only the interpolation with emptier samples tells them apart.
static OPACITIES: [u8; 64] = {
    let mut levels = [SKIN_ALPHA; 64];
    let mut k = 0;
    while k < SOLID_LEVEL + SKIN_STEPS {
        levels[k] = if k <= SOLID_LEVEL {
            k as u8 * OPACITY_STEP
        } else {
            SOLID_ALPHA + ((SKIN_ALPHA - SOLID_ALPHA) as usize * (k - SOLID_LEVEL) / SKIN_STEPS) as u8
        };
        k += 1;
    }
    levels
};
const OPACITY_STEP: u8 = 4;
const SOLID_LEVEL: usize = (SOLID_ALPHA / OPACITY_STEP) as usize;
const SKIN_STEPS: usize = 12;

static OPACITY_LEVELS: [u8; 256] = {
    let mut levels = [0; 256];
    let mut level = 0;
    let mut v = 1;
    while v < 256 {
        while level < 63
            && OPACITIES[level + 1] as usize + OPACITIES[level] as usize <= 2 * v
            && OPACITIES[level] < SKIN_ALPHA
        {
            level += 1;
        }
        levels[v] = if level == 0 { 1 } else { level as u8 };
        v += 1;
    }
    levels
};

/// The opacity of a level.
#[inline]
pub fn opacity_of_level(level: u8) -> u8 {
    OPACITIES[usize::from(level) % OPACITIES.len()]
}

/// The level of the nearest opacity that builders keep to; only of nothing it is nothing.
#[inline]
pub fn opacity_level(alpha: u8) -> u8 {
    OPACITY_LEVELS[usize::from(alpha)]
}

/// Stored alpha of an over-saturated open skin under [`BUILD_GAIN`].
pub const SKIN_ALPHA: u8 = 255;

/// A stored sample of all layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// Premultiplied, sRGB-encoded colour and linear alpha.
    pub color: [u8; 4],
    /// Mean normal × opacity × 127, and a spare zero.
    pub normal: [i8; 4],
}

/// A sample before storing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Value {
    /// Linear-light colour, not premultiplied, 0..1.
    pub rgb: [f32; 3],
    /// Opacity across one voxel divided by the gain, 0..1; with a gain of 2, values above ½ are over-saturated.
    pub alpha: f32,
    /// Mean normal in world axes, length ≤ 1.
    pub normal: [f32; 3],
}

static TO_LINEAR: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| srgb_decode(i as f64 / 255.0)));

/// Linear values at which the rounded sRGB code steps up: code k for values in `STEP[k]..STEP[k+1]`.
static STEP: LazyLock<[f32; 257]> = LazyLock::new(|| {
    std::array::from_fn(|i| match i {
        0 => f32::NEG_INFINITY,
        256 => f32::INFINITY,
        _ => srgb_decode((i as f64 - 0.5) / 255.0) as f32,
    })
});

static GUESS: LazyLock<[u8; 4097]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let x = i as f32 / 4096.0;
        (STEP.partition_point(|s| *s <= x).clamp(1, 256) - 1) as u8
    })
});

/// Linear light of a value in the sRGB encoding, both 0..1.
pub(crate) fn srgb_decode(s: f64) -> f64 {
    if s <= 0.04045 {
        s / 12.92
    } else {
        ((s + 0.055) / 1.055).powf(2.4)
    }
}

/// Linear light (0..1) of an sRGB code.
#[inline]
pub fn srgb_to_linear(code: u8) -> f32 {
    TO_LINEAR[usize::from(code)] as f32
}

/// Linear light (0..1) of an sRGB code, in full precision.
pub fn srgb_to_linear_f64(code: u8) -> f64 {
    TO_LINEAR[usize::from(code)]
}

/// The sRGB code nearest to a linear value; values outside 0..1 and NaN are clamped.
#[inline]
pub fn linear_to_srgb(x: f32) -> u8 {
    let x = if x > 0.0 { x.min(1.0) } else { 0.0 };
    let mut code = usize::from(GUESS[(x * 4096.0) as usize]);
    while x >= STEP[code + 1] {
        code += 1;
    }
    code as u8
}

impl Value {
    /// Quantises to what is stored, with the tree's gain.
    pub fn store(&self, gain: u8) -> Stored {
        let a = (self.alpha.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        if a == 0 {
            return Stored::default();
        }
        let v = f32::from(a) / 255.0;
        let opacity = (v * f32::from(gain)).min(1.0);
        let n = self
            .normal
            .map(|c| (c * opacity * 127.0).round().clamp(-127.0, 127.0) as i8);
        let [r, g, b] = self.rgb.map(|c| linear_to_srgb(c * v));
        Stored {
            color: [r, g, b, a],
            normal: [n[0], n[1], n[2], 0],
        }
    }
}

/// A straight colour and a normal in steps of a byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Codes {
    /// sRGB.
    pub rgb: [u8; 3],
    /// World axes, 127ths.
    pub normal: [i8; 3],
}

/// What is stored of the codes of a colour, and of a normal, by alpha.
static STORED: LazyLock<Vec<[[u8; 256]; 2]>> = LazyLock::new(|| {
    let stored = |alpha: u8, code: u8| {
        let codes = Codes {
            rgb: [code; 3],
            normal: [code.cast_signed(); 3],
        };
        Value {
            rgb: codes.linear(),
            alpha: f32::from(alpha) / 255.0,
            normal: codes.direction(),
        }
        .store(BUILD_GAIN)
    };
    let tables = (0..=255).map(|alpha| {
        let mut tables = [[0; 256]; 2];
        for code in 0..=255 {
            let Stored { color, normal } = stored(alpha, code);
            tables[0][usize::from(code)] = color[0];
            tables[1][usize::from(code)] = normal[0].cast_unsigned();
        }
        tables
    });
    tables.collect()
});

/// The nearest whole number of a small one, halves away from zero; what the instruction set at large lacks.
#[inline]
fn round(x: f32) -> i32 {
    let whole = x as i32;
    let rest = x - whole as f32;
    whole + i32::from(rest >= 0.5) - i32::from(rest <= -0.5)
}

impl Codes {
    /// The nearest to a colour (linear light) and a normal (length ≤ 1).
    #[inline]
    pub fn new(rgb: [f32; 3], normal: [f32; 3]) -> Self {
        Self {
            rgb: rgb.map(linear_to_srgb),
            normal: normal.map(|c| round(c * 127.0) as i8),
        }
    }

    /// The nearest in steps.
    #[inline]
    pub fn in_steps(&self, steps: Steps) -> Self {
        let normal = |c: i8| {
            let code = c.cast_unsigned() ^ NORMAL_ZERO;
            (steps.nearest(NORMAL_ZERO, code) ^ NORMAL_ZERO).cast_signed()
        };
        Self {
            rgb: self.rgb.map(|c| steps.nearest(COLOR_ZERO, c)),
            normal: self.normal.map(normal),
        }
    }

    /// The colour in linear light.
    #[inline]
    pub fn linear(&self) -> [f32; 3] {
        self.rgb.map(srgb_to_linear)
    }

    /// The normal.
    #[inline]
    pub fn direction(&self) -> [f32; 3] {
        self.normal.map(|c| f32::from(c) / 127.0)
    }

    /// What is stored of it with an alpha under [`BUILD_GAIN`]: the same as [`Value::store`] gives, from tables.
    #[inline]
    pub fn store(&self, alpha: u8) -> Stored {
        let [colors, normals] = &STORED[usize::from(alpha)];
        let [r, g, b] = self.rgb.map(|c| colors[usize::from(c)]);
        let [x, y, z] = self
            .normal
            .map(|c| normals[usize::from(c.cast_unsigned())].cast_signed());
        Stored {
            color: [r, g, b, alpha],
            normal: [x, y, z, 0],
        }
    }
}

/// Decodes a stored colour to linear light: premultiplied rgb and the stored alpha, all 0..1 (the gain is not applied).
pub fn decode_color(c: [u8; 4]) -> [f64; 4] {
    [
        srgb_to_linear_f64(c[0]),
        srgb_to_linear_f64(c[1]),
        srgb_to_linear_f64(c[2]),
        f64::from(c[3]) / 255.0,
    ]
}

/// Decodes a stored normal (8-bit signed normalised, as texture units do): mean normal × opacity.
pub fn decode_normal(n: [i8; 4]) -> [f64; 3] {
    [n[0], n[1], n[2]].map(|c| (f64::from(c) / 127.0).max(-1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_codes_round_trip_and_are_nearest() {
        for code in 0..=255u8 {
            assert_eq!(linear_to_srgb(srgb_to_linear(code)), code);
        }
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.0;
            let best = (0..=255u8)
                .min_by(|a, b| {
                    let d = |c: &u8| (srgb_encode(f64::from(x)) * 255.0 - f64::from(*c)).abs();
                    d(a).total_cmp(&d(b))
                })
                .unwrap();
            let got = linear_to_srgb(x);
            let from_step = (srgb_encode(f64::from(x)) * 255.0).fract() - 0.5;
            assert!(got == best || from_step.abs() < 1e-4, "{x}");
        }
        assert_eq!(
            (
                linear_to_srgb(f32::NAN),
                linear_to_srgb(-1.0),
                linear_to_srgb(9.0)
            ),
            (0, 0, 255)
        );
    }

    fn srgb_encode(x: f64) -> f64 {
        if x <= 0.003_130_8 {
            x * 12.92
        } else {
            1.055 * x.powf(1.0 / 2.4) - 0.055
        }
    }

    #[test]
    fn solid_alpha_is_opaque_after_rounding_errors_of_a_texture_unit() {
        let lowest = (f32::from(SOLID_ALPHA) - 1.8) / 255.0 * f32::from(BUILD_GAIN);
        assert!(lowest >= 1.0);
    }

    #[test]
    fn codes_are_stored_as_values_are() {
        for k in 0..200_000u32 {
            let bits = |shift: u32| (k.wrapping_mul(0x9e37_79b9) >> shift) as u8;
            let codes = Codes {
                rgb: [bits(0), bits(8), bits(16)],
                normal: [bits(3), bits(11), bits(19)].map(|b| (b / 2) as i8 - 63),
            };
            assert_eq!(Codes::new(codes.linear(), codes.direction()), codes);
            let value = Value {
                rgb: codes.linear(),
                alpha: f32::from(bits(24)) / 255.0,
                normal: codes.direction(),
            };
            assert_eq!(codes.store(bits(24)), value.store(BUILD_GAIN));
        }
        let x = (0..=2000).map(|k| (k as f32 - 1000.0) / 8.0);
        assert!(x.into_iter().all(|x| round(x) == x.round() as i32));
        assert_eq!([0.499_999_97, -0.499_999_97].map(round), [0, 0]);
    }

    #[test]
    fn storing_keeps_colour_and_normal_within_rounding() {
        let value = Value {
            rgb: [0.2, 0.5, 0.9],
            alpha: 0.5,
            normal: [0.0, 0.6, 0.8],
        };
        let stored = value.store(BUILD_GAIN);
        let c = decode_color(stored.color);
        for (k, rgb) in value.rgb.iter().enumerate() {
            assert!((c[k] / c[3] - f64::from(*rgb)).abs() < 0.008, "{c:?}");
        }
        let n = decode_normal(stored.normal);
        assert!((n[1] - 0.6).abs() < 0.005 && (n[2] - 0.8).abs() < 0.005);
        assert_eq!(
            Value {
                alpha: 0.001,
                ..value
            }
            .store(BUILD_GAIN),
            Stored::default()
        );
    }
}
