//! How far two pictures are from each other: RMSE, PSNR, FLIP, the worst pixel.
//!
//! Pictures are opaque and in linear light, [`LinearImage`]; a rendered picture becomes one over the sky that a user sees
//! ([`crate::picture_file::linear_over_sky`]). One decoded from a file has the 8-bit steps of its file: PSNR between two
//! such pictures does not tell apart what is below those steps, which is above some 56 dB. Any thread.

mod flip;

pub use flip::{PIXELS_PER_DEGREE, flip, heat};

use brickfell_formats::value::linear_to_srgb;
use serde::Serialize;

/// PSNR of equal pictures, dB; no PSNR is above it.
pub const MAX_PSNR: f64 = 99.0;
/// A pixel differs if one of its components does by more than this many 8-bit sRGB steps.
const STEPS: u8 = 2;

/// An opaque picture in linear light; row 0 at the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub rgb: Vec<[f32; 3]>,
}

/// What there is to say about two pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Root of the mean square difference of components in linear light.
    pub rmse: f64,
    /// PSNR in linear light, dB, at most [`MAX_PSNR`].
    pub psnr: f64,
    /// PSNR in sRGB encoding (not rounded to 8 bits), dB, at most [`MAX_PSNR`].
    pub psnr_srgb: f64,
    /// Mean FLIP, 0 to 1.
    pub flip: f64,
    /// The pixel with the largest difference of a component in 8-bit sRGB steps.
    pub worst: Worst,
    /// Share of the pixels of which a component differs by more than 2/255 in 8-bit sRGB.
    pub share_over_2: f64,
}

/// The worst pixel, the first of several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Worst {
    /// 8-bit sRGB steps.
    pub steps: u8,
    /// Column, from the left.
    pub x: u32,
    /// Row, from the top.
    pub y: u32,
}

/// Two pictures that cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompareError {
    /// Pictures of different sizes.
    #[error("one picture has {}x{} pixels, the other {}x{}", .0.0, .0.1, .1.0, .1.1)]
    Size((u32, u32), (u32, u32)),
    /// No pixel to compare.
    #[error("the pictures have no pixels")]
    Empty,
}

/// An sRGB value, 0 to 1 and not rounded, of linear light.
fn srgb(linear: f32) -> f64 {
    let x = f64::from(linear).clamp(0.0, 1.0);
    if x <= 0.003_130_8 {
        x * 12.92
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    }
}

/// PSNR of a mean square error of components from 0 to 1, dB, at most [`MAX_PSNR`].
pub fn psnr(mean_square: f64) -> f64 {
    if mean_square > 0.0 {
        (-10.0 * mean_square.log10()).min(MAX_PSNR)
    } else {
        MAX_PSNR
    }
}

/// Refuses pictures of different sizes and such without pixels.
fn check(a: &LinearImage, b: &LinearImage) -> Result<(), CompareError> {
    let (of_a, of_b) = ((a.width, a.height), (b.width, b.height));
    if of_a != of_b || a.rgb.len() != b.rgb.len() {
        return Err(CompareError::Size(of_a, of_b));
    }
    if a.rgb.is_empty() || a.rgb.len() != a.width as usize * a.height as usize {
        return Err(CompareError::Empty);
    }
    Ok(())
}

fn mean_square(a: &LinearImage, b: &LinearImage, value: impl Fn(f32) -> f64) -> f64 {
    let pairs = a.rgb.iter().flatten().zip(b.rgb.iter().flatten());
    let sum: f64 = pairs.map(|(x, y)| (value(*x) - value(*y)).powi(2)).sum();
    sum / (a.rgb.len() * 3) as f64
}

/// Compares two pictures; also gives the FLIP of every pixel, row by row.
///
/// # Errors
/// Pictures of different sizes or without pixels.
pub fn compare(a: &LinearImage, b: &LinearImage) -> Result<(Errors, Vec<f32>), CompareError> {
    check(a, b)?;
    let square = mean_square(a, b, f64::from);
    let (mut worst, mut over) = (Worst::default(), 0u64);
    for (k, (p, q)) in a.rgb.iter().zip(&b.rgb).enumerate() {
        let steps = (0..3).map(|c| linear_to_srgb(p[c]).abs_diff(linear_to_srgb(q[c])));
        let steps = steps.max().unwrap_or(0);
        over += u64::from(steps > STEPS);
        if steps > worst.steps {
            let (x, y) = (k as u32 % a.width, k as u32 / a.width);
            worst = Worst { steps, x, y };
        }
    }
    let map = flip(a, b, PIXELS_PER_DEGREE)?;
    let count = a.rgb.len() as f64;
    let errors = Errors {
        rmse: square.sqrt(),
        psnr: psnr(square),
        psnr_srgb: psnr(mean_square(a, b, srgb)),
        flip: map.iter().map(|f| f64::from(*f)).sum::<f64>() / count,
        worst,
        share_over_2: over as f64 / count,
    };
    Ok((errors, map))
}

/// RMSE in linear light that the noise of one of two pictures alone makes, given two of the same truth with different
/// seeds: an error near it is not one that [`crate::truth`] can tell.
///
/// # Errors
/// Pictures of different sizes or without pixels.
pub fn noise_floor(a: &LinearImage, b: &LinearImage) -> Result<f64, CompareError> {
    check(a, b)?;
    Ok((mean_square(a, b, f64::from) * 0.5).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: u32, height: u32, rgb: [f32; 3]) -> LinearImage {
        LinearImage {
            width,
            height,
            rgb: vec![rgb; (width * height) as usize],
        }
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let a = flat(7, 5, [0.2, 0.5, 0.9]);
        let (errors, map) = compare(&a, &a).unwrap();
        assert_eq!(
            (errors.rmse, errors.psnr, errors.psnr_srgb, errors.flip),
            (0.0, 99.0, 99.0, 0.0)
        );
        assert_eq!((errors.worst, errors.share_over_2), (Worst::default(), 0.0));
        assert_eq!(map, [0.0; 35]);
        assert_eq!(noise_floor(&a, &a), Ok(0.0));
    }

    #[test]
    fn rmse_and_psnr_are_what_paper_says() {
        let mut b = flat(4, 3, [0.25; 3]);
        let a = b.clone();
        // One component of 36 differs by 0.6: 188 against 238 in sRGB codes.
        b.rgb[6][1] = 0.85;
        let (errors, _) = compare(&a, &b).unwrap();
        assert!((errors.rmse - 0.1).abs() < 1e-7 && (errors.psnr - 20.0).abs() < 1e-5);
        let encoded = |x: f64| 1.055 * x.powf(1.0 / 2.4) - 0.055;
        let expected = -10.0 * ((encoded(0.85) - encoded(0.25)).powi(2) / 36.0).log10();
        assert!((errors.psnr_srgb - expected).abs() < 1e-5);
        let steps = linear_to_srgb(0.85) - linear_to_srgb(0.25);
        assert_eq!(errors.worst, Worst { steps, x: 2, y: 1 });
        assert!((errors.share_over_2 - 1.0 / 12.0).abs() < 1e-12);
        assert!((noise_floor(&a, &b).unwrap() - 0.1 / 2f64.sqrt()).abs() < 1e-7);
    }

    #[test]
    fn pictures_that_do_not_match_are_refused() {
        let (a, b) = (flat(4, 3, [0.0; 3]), flat(3, 4, [0.0; 3]));
        assert_eq!(compare(&a, &b), Err(CompareError::Size((4, 3), (3, 4))));
        let none = LinearImage::default();
        assert_eq!(compare(&none, &none), Err(CompareError::Empty));
        assert_eq!(noise_floor(&none, &none), Err(CompareError::Empty));
    }
}
