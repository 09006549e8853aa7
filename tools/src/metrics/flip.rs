//! LDR-FLIP: how different two pictures look to someone who flips between them.
//!
//! Written after P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild, "FLIP: A
//! Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020; sums of Gaussians
//! are filtered one by one, each along rows, then columns. The figures in the tests were found once with the authors'
//! implementation (the crate nv-flip 0.1.2, which is no dependency since it needs a C++ compiler).
//!
//! Beyond the edges a picture goes on with its edge pixels. Any thread; rows are spread over the rayon pool of the caller.

use rayon::prelude::*;

use super::{CompareError, LinearImage, check};

/// Pixels per degree of sight that FLIP's authors propose: a 4K screen, 0.7 m wide, from 0.7 m.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Exponent of the colour difference.
const COLOR_POWER: f64 = 0.7;
/// Share of the largest colour difference from which on differences are compressed, and where that share is mapped to.
const KNEE: (f64, f64) = (0.4, 0.95);
/// Width of the feature filters, degrees.
const FEATURE_DEGREES: f64 = 0.082;
/// Exponent of the feature difference.
const FEATURE_POWER: f64 = 0.5;
/// Contrast sensitivity of the eye, in degrees: (weight, width) of the Gaussians of Y, Cx and Cz.
const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];

/// Linear sRGB to CIE XYZ under the white D65.
const XYZ: [[f64; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];

/// XYZ relative to the white.
fn xyz(rgb: [f64; 3]) -> [f64; 3] {
    XYZ.map(|row| {
        let sum = row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2];
        sum / (row[0] + row[1] + row[2])
    })
}

/// Linear sRGB of XYZ relative to the white: Cramer's rule on [`xyz`].
fn rgb([x, y, z]: [f64; 3]) -> [f64; 3] {
    let matrix = glam::DMat3::from_cols_array_2d(&XYZ).transpose();
    let white = glam::DVec3::from_array(XYZ.map(|row| row.iter().sum()));
    (matrix.inverse() * (glam::DVec3::new(x, y, z) * white)).to_array()
}

/// The linear version of CIELab in which the eye's filters work.
fn ycc([x, y, z]: [f64; 3]) -> [f64; 3] {
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn xyz_of_ycc([l, a, b]: [f64; 3]) -> [f64; 3] {
    let y = (l + 16.0) / 116.0;
    [y + a / 500.0, y, y - b / 200.0]
}

/// CIELab after Hunt's effect: colours are weaker in the dark.
fn hunt_lab(xyz: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let [x, y, z] = xyz.map(|v| {
        if v > DELTA.powi(3) {
            v.cbrt()
        } else {
            v / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    });
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
}

/// HyAB distance: city blocks between lightness and colour, Euclid between colours.
fn hyab(p: [f64; 3], q: [f64; 3]) -> f64 {
    (p[0] - q[0]).abs() + (p[1] - q[1]).hypot(p[2] - q[2])
}

/// One component of a picture.
struct Plane {
    width: usize,
    values: Vec<f64>,
}

impl Plane {
    /// Filtered with one odd kernel along rows, then with one along columns.
    fn filtered(&self, along_rows: &[f64], along_columns: &[f64]) -> Plane {
        let (width, height) = (self.width, self.values.len() / self.width);
        let sum = |kernel: &[f64], at: usize, end: usize, value: &dyn Fn(usize) -> f64| -> f64 {
            let half = kernel.len() / 2;
            let taps = kernel.iter().enumerate();
            taps.map(|(k, w)| w * value((at + k).saturating_sub(half).min(end - 1)))
                .sum()
        };
        let pass = |value: &(dyn Fn(usize, usize) -> f64 + Sync)| -> Vec<f64> {
            let rows = (0..height).into_par_iter();
            rows.flat_map_iter(|y| (0..width).map(move |x| value(x, y)))
                .collect()
        };
        let rows = pass(&|x, y| sum(along_rows, x, width, &|x| self.values[y * width + x]));
        let values = pass(&|x, y| sum(along_columns, y, height, &|y| rows[y * width + x]));
        Plane { width, values }
    }
}

/// `value` at −radius to radius.
fn kernel(radius: f64, value: impl Fn(f64) -> f64) -> Vec<f64> {
    let radius = radius.ceil() as i64;
    (-radius..=radius).map(|x| value(x as f64)).collect()
}

/// Parts that add up to 1, and such that add up to −1.
fn normalised(kernel: Vec<f64>) -> Vec<f64> {
    let sum = |sign: f64| kernel.iter().map(|w| (w * sign).max(0.0)).sum::<f64>();
    let (up, down) = (sum(1.0), sum(-1.0));
    kernel
        .into_iter()
        .map(|w| {
            if w > 0.0 {
                w / up
            } else {
                w / down.max(f64::MIN_POSITIVE)
            }
        })
        .collect()
}

/// A picture in the eye's colour space, by component.
fn planes(image: &LinearImage) -> [Plane; 3] {
    let pixels: Vec<[f64; 3]> = image
        .rgb
        .iter()
        .map(|p| ycc(xyz(p.map(|c| f64::from(c).clamp(0.0, 1.0)))))
        .collect();
    std::array::from_fn(|k| Plane {
        width: image.width as usize,
        values: pixels.iter().map(|p| p[k]).collect(),
    })
}

/// What the eye sees of a picture: filtered by its contrast sensitivity, as CIELab after Hunt.
fn seen(planes: &[Plane; 3], per_degree: f64) -> Vec<[f64; 3]> {
    use std::f64::consts::PI;
    let widest = SENSITIVITY
        .iter()
        .copied()
        .flatten()
        .map(|g| g.1)
        .fold(0.0, f64::max);
    let radius = 3.0 * (widest / (2.0 * PI * PI)).sqrt() * per_degree;
    let filtered: Vec<Vec<f64>> = planes
        .iter()
        .zip(SENSITIVITY)
        .map(|(plane, gaussians)| {
            let mut sum = vec![0.0; plane.values.len()];
            let mut total = 0.0;
            for (weight, width) in gaussians {
                let kernel = kernel(radius, |x| (-(PI * x / per_degree).powi(2) / width).exp());
                let share = weight * (PI / width).sqrt() * kernel.iter().sum::<f64>().powi(2);
                let kernel = normalised(kernel);
                let part = plane.filtered(&kernel, &kernel).values;
                sum.iter_mut().zip(part).for_each(|(s, p)| *s += share * p);
                total += share;
            }
            sum.into_iter().map(|s| s / total).collect()
        })
        .collect();
    (0..planes[0].values.len())
        .into_par_iter()
        .map(|k| {
            let linear = rgb(xyz_of_ycc([filtered[0][k], filtered[1][k], filtered[2][k]]));
            hunt_lab(xyz(linear.map(|c| c.clamp(0.0, 1.0))))
        })
        .collect()
}

/// How strong edges and points are at each pixel.
fn features(lightness: &Plane, per_degree: f64) -> Vec<[f64; 2]> {
    let sigma = 0.5 * FEATURE_DEGREES * per_degree;
    let make = |f: &dyn Fn(f64, f64) -> f64| {
        let bell = |x: f64| (-x * x / (2.0 * sigma * sigma)).exp();
        normalised(kernel(3.0 * sigma, |x| f(x, bell(x))))
    };
    let smooth = make(&|_, g| g);
    let edge = make(&|x, g| -x * g);
    let point = make(&|x, g| (x * x / (sigma * sigma) - 1.0) * g);
    let strength = |kernel: &[f64]| -> Vec<f64> {
        let across = lightness.filtered(kernel, &smooth).values;
        let down = lightness.filtered(&smooth, kernel).values;
        across.iter().zip(down).map(|(x, y)| x.hypot(y)).collect()
    };
    let points = strength(&point);
    strength(&edge)
        .into_iter()
        .zip(points)
        .map(|(e, p)| [e, p])
        .collect()
}

/// FLIP of every pixel, 0 to 1, row by row. Components of the pictures are clamped to 0..1.
///
/// # Errors
/// Pictures of different sizes or without pixels.
pub fn flip(a: &LinearImage, b: &LinearImage, pixels_per_degree: f64) -> Result<Vec<f32>, CompareError> {
    check(a, b)?;
    let (green, blue) = (hunt_lab(xyz([0.0, 1.0, 0.0])), hunt_lab(xyz([0.0, 0.0, 1.0])));
    let largest = hyab(green, blue).powf(COLOR_POWER);
    let knee = KNEE.0 * largest;
    let look = |image: &LinearImage| {
        let mut planes = planes(image);
        let colors = seen(&planes, pixels_per_degree);
        planes[0].values.iter_mut().for_each(|l| *l = (*l + 16.0) / 116.0);
        (colors, features(&planes[0], pixels_per_degree))
    };
    let ((colors_a, features_a), (colors_b, features_b)) = (look(a), look(b));
    let pixel = |k: usize| {
        let color = hyab(colors_a[k], colors_b[k]).powf(COLOR_POWER);
        let color = if color < knee {
            color * KNEE.1 / knee
        } else {
            KNEE.1 + (color - knee) / (largest - knee) * (1.0 - KNEE.1)
        };
        let feature = (0..2).map(|f| (features_a[k][f] - features_b[k][f]).abs());
        let feature = (feature.fold(0.0, f64::max) / 2f64.sqrt()).powf(FEATURE_POWER);
        color.powf(1.0 - feature) as f32
    };
    Ok((0..a.rgb.len()).into_par_iter().map(pixel).collect())
}

/// The colour of a FLIP value in a heat map, sRGB: black where there is no difference, then blue, red, yellow, white.
pub fn heat(flip: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [0.0, 0.0, 0.0],
        [60.0, 20.0, 140.0],
        [205.0, 45.0, 60.0],
        [250.0, 190.0, 40.0],
        [255.0, 255.0, 255.0],
    ];
    let at = flip.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let k = (at as usize).min(STOPS.len() - 2);
    std::array::from_fn(|c| (STOPS[k][c] + (at - k as f32) * (STOPS[k + 1][c] - STOPS[k][c])).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_formats::value::srgb_to_linear;

    fn image(width: u32, height: u32, code: impl Fn(u32, u32) -> [u8; 3]) -> LinearImage {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        LinearImage {
            width,
            height,
            rgb: pixels.map(|(x, y)| code(x, y).map(srgb_to_linear)).collect(),
        }
    }

    fn mix(x: u32, y: u32) -> u32 {
        let h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
        (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d) >> 8
    }

    fn mean(map: &[f32]) -> f64 {
        map.iter().map(|f| f64::from(*f)).sum::<f64>() / map.len() as f64
    }

    /// Pairs of pictures, made up here, of 48 × 32 pixels.
    fn pairs() -> Vec<(LinearImage, LinearImage)> {
        let scene = |x: u32, y: u32| [(x * 5) as u8, (y * 7) as u8, ((x + y) * 3) as u8];
        let noisy = |x: u32, y: u32| scene(x, y).map(|c| c.saturating_add((mix(x, y) % 24) as u8));
        let disc = |cx: u32| {
            move |x: u32, y: u32| {
                let inside = (x.abs_diff(cx)).pow(2) + y.abs_diff(16).pow(2) < 80;
                if inside { [230, 40, 30] } else { [40, 90, 200] }
            }
        };
        let of = |code: &dyn Fn(u32, u32) -> [u8; 3]| image(48, 32, code);
        vec![
            (of(&scene), of(&noisy)),
            (of(&disc(20)), of(&disc(23))),
            (of(&|_, _| [0; 3]), of(&|_, _| [255; 3])),
            (of(&|_, _| [0, 255, 0]), of(&|_, _| [0, 0, 255])),
            (
                of(&|x, _| [128 + (x % 2) as u8 * 100; 3]),
                of(&|x, _| [228 - (x % 2) as u8 * 100; 3]),
            ),
        ]
    }

    #[test]
    fn means_and_pixels_are_those_of_the_authors_implementation() {
        // Mean, and the pixels (0, 0) and (24, 16), at 67 and at 20 pixels per degree. That implementation works in f32,
        // which is off by up to 1e-4 where differences cancel (the last pair).
        let expected = [
            [[0.227648, 0.082246, 0.209885], [0.227895, 0.005118, 0.150144]],
            [[0.123263, 0.000000, 0.309852], [0.096464, 0.000000, 0.000000]],
            [[0.967392, 0.967392, 0.967392], [0.967391, 0.967391, 0.967391]],
            [[1.000000, 1.000000, 1.000000], [1.000000, 1.000000, 1.000000]],
            [[0.050311, 0.430717, 0.027844], [0.708843, 0.714652, 0.708588]],
        ];
        for (k, (a, b)) in pairs().iter().enumerate() {
            for (per_degree, expected) in [67.0, 20.0].into_iter().zip(expected[k]) {
                let map = flip(a, b, per_degree).unwrap();
                let found = [mean(&map), map[0].into(), map[16 * 48 + 24].into()];
                for (f, e) in found.iter().zip(expected) {
                    assert!(
                        (f - e).abs() < 1e-4,
                        "pair {k} at {per_degree}: {found:?} is not {expected:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn equal_pictures_have_none_and_order_does_not_matter() {
        for (a, b) in pairs() {
            assert!(flip(&a, &a, PIXELS_PER_DEGREE).unwrap().iter().all(|f| *f == 0.0));
            assert_eq!(flip(&a, &b, 67.0), flip(&b, &a, 67.0));
        }
    }

    #[test]
    fn heat_grows_brighter_from_black_to_white() {
        assert_eq!(
            (heat(0.0), heat(1.0), heat(f32::INFINITY)),
            ([0; 3], [255; 3], [255; 3])
        );
        let light = |f: f32| heat(f).iter().map(|c| u32::from(*c)).sum::<u32>();
        assert!((0..100).all(|k| light(k as f32 * 0.01) <= light(k as f32 * 0.01 + 0.01)));
    }
}
