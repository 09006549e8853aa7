//! The two precisions in which rays are marched: f64, which is right, and f32, which is fast.
//!
//! What differs between them is here: conversions, and how logarithms and powers are worked out. Plain values: any thread.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// The most opacity across a voxel: a voxel of it ends a ray, and the opacity of a short segment is continuous in the value.
const MOST_OPAQUE: f64 = 1.0 - 1.0 / 2048.0;

/// Added to a number up to [`ROUNDED`] it leaves the nearest whole one in the last bits.
const ROUND: f32 = 12_582_912.0;
/// See [`ROUND`].
const ROUNDED: f32 = 4_194_304.0;

/// A number to march with.
pub(crate) trait Real:
    Copy
    + Default
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Send
    + Sync
    + 'static
{
    /// Has digits only for what is near.
    const IS_SHORT: bool;
    /// Zero.
    const ZERO: Self;
    /// One.
    const ONE: Self;
    /// A half.
    const HALF: Self;
    /// Farther than anything.
    const INFINITY: Self;
    /// The largest number below one.
    const BELOW_ONE: Self;

    /// The nearest number.
    fn of(x: f64) -> Self;
    /// The number in f64.
    fn wide(self) -> f64;
    /// A whole number, exact up to 2^24.
    fn whole(i: i32) -> Self;
    /// The largest whole number not above it, at the ends of i32 where that is beyond them.
    fn floor(self) -> i32;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Logarithm to the base 2 of a positive number.
    fn log2(self) -> Self;
    /// Optical depth -ln(1 - a) across a voxel of opacity `a`, 0..1, of which no more than nearly all counts.
    fn optical_depth(self) -> Self;
    /// Opacity 1 - exp(-depth) of an optical depth, 0 or more.
    fn opacity(self) -> Self;

    /// The smaller number; the other one if `self` is not a number.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    /// The larger number; the other one if `self` is not a number.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

impl Real for f64 {
    const IS_SHORT: bool = false;
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const HALF: Self = 0.5;
    const INFINITY: Self = f64::INFINITY;
    const BELOW_ONE: Self = 1.0 - f64::EPSILON / 2.0;

    fn of(x: f64) -> Self {
        x
    }

    fn wide(self) -> f64 {
        self
    }

    fn whole(i: i32) -> Self {
        f64::from(i)
    }

    fn floor(self) -> i32 {
        f64::floor(self) as i32
    }

    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    fn log2(self) -> Self {
        f64::log2(self)
    }

    fn optical_depth(self) -> Self {
        -(-f64::min(self, MOST_OPAQUE)).ln_1p()
    }

    fn opacity(self) -> Self {
        -(-self).exp_m1()
    }
}

impl Real for f32 {
    const IS_SHORT: bool = true;
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const HALF: Self = 0.5;
    const INFINITY: Self = f32::INFINITY;
    const BELOW_ONE: Self = 1.0 - f32::EPSILON / 2.0;

    #[inline(always)]
    fn of(x: f64) -> Self {
        x as f32
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn whole(i: i32) -> Self {
        i as f32
    }

    #[inline(always)]
    fn floor(self) -> i32 {
        let nearest = if self.abs() < ROUNDED {
            ((self + ROUND).to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32)
        } else {
            self as i32
        };
        nearest - i32::from(self < nearest as f32)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }

    /// Off by 3·10⁻⁷ of the result or of 1, whichever is more: `ln m = 2 artanh((m-1)/(m+1))`, four terms of the series.
    #[inline(always)]
    fn log2(self) -> Self {
        const SCALE: f32 = 2.0 * std::f32::consts::LOG2_E;
        // The mantissa between the roots of 1/2 and 2.
        let bits = self.to_bits() as i32;
        let exponent = (bits - 0x3f35_04f3) >> 23;
        let m = f32::from_bits((bits - (exponent << 23)) as u32);
        let s = (m - 1.0) / (m + 1.0);
        let q = s * s;
        let series = 1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0)));
        exponent as f32 + SCALE * s * series
    }

    /// Off by 4·10⁻⁷ of the result or of 1, whichever is more.
    #[inline(always)]
    fn optical_depth(self) -> Self {
        -std::f32::consts::LN_2 * Real::log2(1.0 - Real::min(self, MOST_OPAQUE as f32))
    }

    /// Off by 4·10⁻⁷.
    #[inline(always)]
    fn opacity(self) -> Self {
        1.0 - exp2(-std::f32::consts::LOG2_E * self)
    }
}

/// 2^x for x up to 0, off by 2·10⁻⁷: the series of exp to the sixth power around the nearest whole number.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    let x = Real::max(x, -126.0);
    let rounded = x + ROUND;
    let r = (x - (rounded - ROUND)) * std::f32::consts::LN_2;
    let q = r * r;
    let high = (1.0 / 24.0 + r * (1.0 / 120.0)) + q * (1.0 / 720.0);
    let series = (1.0 + r) + q * ((0.5 + r * (1.0 / 6.0)) + q * high);
    f32::from_bits((series.to_bits()).wrapping_add(rounded.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_functions_keep_their_errors() {
        for k in 1..200_000u32 {
            let x = k as f32 * 1e-3;
            let exact = f64::from(x).log2();
            assert!(
                (f64::from(Real::log2(x)) - exact).abs() <= 3e-7 * exact.abs().max(1.0),
                "{x}"
            );
            let exact = (-f64::from(x)).exp2();
            assert!((f64::from(exp2(-x)) - exact).abs() <= 2e-7, "{x}");
            let a = k as f32 / 200_000.0;
            let (depth, exact) = (a.optical_depth(), f64::from(a).optical_depth());
            assert!(
                (f64::from(depth) - exact).abs() <= 4e-7 * exact.max(1.0),
                "{a}: {depth} {exact}"
            );
            let (part, exact) = (x.opacity(), f64::from(x).opacity());
            assert!((f64::from(part) - exact).abs() <= 4e-7, "{x}: {part} {exact}");
        }
        assert_eq!([0.0f32.optical_depth(), 0.0f32.opacity()], [0.0; 2]);
        assert!(1.0f32.optical_depth() > 7.6 && 1e30f32.opacity() == 1.0);
        let numbers = [
            -1.5f32, -1.0, -0.25, 0.0, 0.75, 3.0, 2.5, 3.5, 4e6, 6e6, -6e6, 1e30,
        ];
        let floors = [
            -2,
            -1,
            -1,
            0,
            0,
            3,
            2,
            3,
            4_000_000,
            6_000_000,
            -6_000_000,
            i32::MAX,
        ];
        assert_eq!(numbers.map(Real::floor), floors);
    }
}
