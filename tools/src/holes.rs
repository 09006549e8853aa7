//! Holes: pixels that show the background where the reference says that there is none.

use brickfell_runtime::picture::Picture;

/// Alpha of the reference from which a ray counts as hitting.
const HIT: f32 = 0.99;
/// Alpha of the truth where all of its rays are stopped, with room for the rounding of their sum.
const OPAQUE: f32 = 0.9999;
/// Alpha below which a pixel is a hole.
const OPEN: f32 = 0.5;

/// The alphas of the pixels of `picture` whose 5×5 neighbourhood (as far as it lies in the picture) has an alpha of `least` or
/// more in the reference. Both pictures have one size.
fn inside<'a>(picture: &'a Picture, reference: &'a Picture, least: f32) -> impl Iterator<Item = f32> + 'a {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let solid = move |x: usize, y: usize| {
        (y.saturating_sub(2)..(y + 3).min(height)).all(|v| {
            (x.saturating_sub(2)..(x + 3).min(width)).all(|u| reference.pixels[v * width + u][3] >= least)
        })
    };
    (0..height)
        .flat_map(move |y| (0..width).map(move |x| (x, y)))
        .filter(move |(x, y)| solid(*x, *y))
        .map(move |(x, y)| picture.pixels[y * width + x][3])
}

/// Pixels of `picture` with an alpha below 0.5 whose 5×5 neighbourhood is hit by every ray of the reference. Both pictures have
/// one size.
pub fn count_holes(picture: &Picture, reference: &Picture) -> usize {
    inside(picture, reference, HIT)
        .filter(|alpha| *alpha < OPEN)
        .count()
}

/// The least alpha of the pixels whose 5×5 neighbourhood is opaque in the truth; `None` if there is no such pixel. Both
/// pictures have one size.
pub fn least_alpha_inside(picture: &Picture, truth: &Picture) -> Option<f32> {
    inside(picture, truth, OPAQUE).reduce(f32::min)
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
        assert_eq!(least_alpha_inside(&picture, &full), Some(0.2));
        for k in [3 * 9 + 3, 4 * 9 + 8] {
            picture.pixels[k][3] = 0.7;
        }
        assert_eq!(least_alpha_inside(&picture, &reference), Some(0.7));
        reference.pixels.iter_mut().for_each(|p| p[3] = 0.99);
        assert_eq!(least_alpha_inside(&picture, &reference), None);
    }
}
