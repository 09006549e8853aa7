//! Holes and outlines: pixels that show the background where the reference says that there is none, and the reverse.

use brickfell_runtime::picture::Picture;

/// Alpha of the reference from which a ray counts as hitting.
const HIT: f32 = 0.99;
/// Alpha of the truth where all of its rays are stopped, with room for the rounding of their sum.
const OPAQUE: f32 = 0.9999;
/// Alpha below which a pixel is a hole.
const OPEN: f32 = 0.5;

/// The pixels (by index) around which, `reach` pixels to each side as far as they lie in the picture, `holds` for all.
fn all_around(
    picture: &Picture,
    reach: usize,
    holds: impl Fn(&[f32; 4]) -> bool,
) -> impl Iterator<Item = usize> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let around = move |k: usize, n: usize| k.saturating_sub(reach)..(k + reach + 1).min(n);
    (0..width * height).filter(move |k| {
        around(k / width, height)
            .all(|v| around(k % width, width).all(|u| holds(&picture.pixels[v * width + u])))
    })
}

/// The pixels (by index) whose 5×5 neighbourhood is opaque in the truth.
pub fn inside(truth: &Picture) -> impl Iterator<Item = usize> {
    all_around(truth, 2, |p| p[3] >= OPAQUE)
}

/// Pixels of `picture` with an alpha below 0.5 whose 5×5 neighbourhood is hit by every ray of the reference. Both pictures have
/// one size.
pub fn count_holes(picture: &Picture, reference: &Picture) -> usize {
    all_around(reference, 2, |p| p[3] >= HIT)
        .filter(|k| picture.pixels[*k][3] < OPEN)
        .count()
}

/// The least alpha of the pixels whose 5×5 neighbourhood is opaque in the truth; `None` if there is no such pixel. Both
/// pictures have one size.
pub fn least_alpha_inside(picture: &Picture, truth: &Picture) -> Option<f32> {
    inside(truth).map(|k| picture.pixels[k][3]).reduce(f32::min)
}

/// Pixels of `picture` that are covered, by an alpha above 0.5, though all of their 3×3 neighbourhood is open in the truth:
/// outlines that are thicker than the truth's by more than a pixel. Both pictures have one size.
pub fn count_thick(picture: &Picture, truth: &Picture) -> usize {
    all_around(truth, 1, |p| p[3] == 0.0)
        .filter(|k| picture.pixels[*k][3] > OPEN)
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_open_pixels_well_inside_the_reference_count() {
        let full = Picture {
            width: 9,
            height: 9,
            pixels: vec![[0.0, 0.0, 0.0, 1.0]; 81],
        };
        let mut reference = full.clone();
        reference.pixels[0][3] = 0.0;
        let mut picture = full.clone();
        for k in [2 * 9 + 2, 3 * 9 + 3, 4 * 9 + 8] {
            picture.pixels[k][3] = 0.2;
        }
        assert_eq!(count_holes(&picture, &full), 3);
        assert_eq!(count_holes(&picture, &reference), 2);
        assert_eq!(count_holes(&full, &full), 0);
        assert_eq!((inside(&full).count(), inside(&reference).count()), (81, 72));
        let mut open = full.clone();
        open.pixels.iter_mut().for_each(|p| p[3] = 0.0);
        assert_eq!((count_thick(&full, &open), count_thick(&open, &open)), (81, 0));
        open.pixels[0][3] = 0.1;
        assert_eq!(count_thick(&full, &open), 77);
        assert_eq!(least_alpha_inside(&picture, &full), Some(0.2));
        for k in [3 * 9 + 3, 4 * 9 + 8] {
            picture.pixels[k][3] = 0.7;
        }
        assert_eq!(least_alpha_inside(&picture, &reference), Some(0.7));
        reference.pixels.iter_mut().for_each(|p| p[3] = 0.99);
        assert_eq!(least_alpha_inside(&picture, &reference), None);
    }
}
