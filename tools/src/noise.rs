//! Deterministic randomness: a hash of lattice points, gradient noise on it, and a small generator.

use glam::DVec2;

/// A well-mixed 64-bit hash (the finaliser of SplitMix64).
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Random numbers in a sequence: the same seed gives the same numbers on every machine.
#[derive(Clone)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Random(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)))
    }

    /// Uniform in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// Uniform in 0..1 for a cell of the integer lattice.
pub(crate) fn cell(seed: u64, x: i64, y: i64) -> f64 {
    let key = seed
        ^ (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    (mix(mix(key)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Gradient noise, about -1..1, features one unit wide.
pub(crate) fn noise(seed: u64, p: DVec2) -> f64 {
    let base = p.floor();
    let f = p - base;
    let corner = |dx: i64, dy: i64| {
        let angle = std::f64::consts::TAU * cell(seed, base.x as i64 + dx, base.y as i64 + dy);
        DVec2::from_angle(angle).dot(f - DVec2::new(dx as f64, dy as f64))
    };
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let bottom = lerp(corner(0, 0), corner(1, 0), s.x);
    let top = lerp(corner(0, 1), corner(1, 1), s.x);
    lerp(bottom, top, s.y) * std::f64::consts::SQRT_2
}

/// Octaves of noise, each half as wide and half as strong; about -1..1.
pub(crate) fn fractal(seed: u64, p: DVec2, octaves: u64) -> f64 {
    // Octaves are turned against each other, or the lattice shows through.
    let turn = DVec2::from_angle(0.61);
    let (mut sum, mut weight, mut total, mut q) = (0.0, 1.0, 0.0, p);
    for octave in 0..octaves {
        sum += weight * noise(seed.wrapping_add(octave * 7919), q);
        total += weight;
        weight *= 0.5;
        q = turn.rotate(q) * 2.03;
    }
    sum / total * 1.6
}

pub(crate) fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// 0 below `low`, 1 above `high`, smooth between; falling if `low > high`.
pub(crate) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
