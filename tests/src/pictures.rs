//! How far two pictures are apart: per pixel, the largest difference of a component in 8-bit steps, colours in sRGB over
//! black, alpha as it is. Nothing is rounded before it is compared.

use brickfell_runtime::picture::Picture;

/// The bound between the two renderers: steps that all but one pixel in ten thousand keep, and that all keep.
pub const BOUND: Bound = Bound {
    near: 1.0,
    share: 0.9999,
    worst: 16.0,
};

/// The bound between pictures that show the same thing at different places of number ranges.
pub const SAME: Bound = Bound {
    near: 1.0,
    share: 0.9999,
    worst: 16.0,
};

/// What is allowed.
#[derive(Clone, Copy, Debug)]
pub struct Bound {
    /// Steps that nearly all pixels keep.
    pub near: f64,
    /// How many: a share of all.
    pub share: f64,
    /// Steps that all pixels keep.
    pub worst: f64,
}

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Difference {
    /// Pixels beyond [`Bound::near`].
    pub beyond: usize,
    /// Steps of the worst pixel.
    pub worst: f64,
    /// Its column and row, and its values in both pictures.
    pub at: String,
}

fn srgb(linear: f32) -> f64 {
    let x = f64::from(linear).clamp(0.0, 1.0);
    if x <= 0.003_130_8 {
        x * 12.92
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    }
}

fn steps(a: [f32; 4], b: [f32; 4]) -> f64 {
    if !a.iter().chain(&b).all(|c| c.is_finite()) {
        return f64::INFINITY;
    }
    let colors = (0..3).map(|k| (srgb(a[k]) - srgb(b[k])).abs());
    colors.fold(f64::from((a[3] - b[3]).abs()), f64::max) * 255.0
}

/// Compares two pictures.
///
/// # Panics
/// If their sizes differ.
pub fn compare(a: &Picture, b: &Picture, bound: Bound) -> Difference {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let mut found = Difference::default();
    for (k, (p, q)) in a.pixels.iter().zip(&b.pixels).enumerate() {
        let steps = steps(*p, *q);
        found.beyond += usize::from(steps > bound.near);
        if steps > found.worst {
            found.worst = steps;
            let (column, row) = (k % a.width as usize, k / a.width as usize);
            found.at = format!("column {column}, row {row}: {p:?} against {q:?}");
        }
    }
    found
}

/// Compares two pictures and reports what they are of.
///
/// # Panics
/// If they are farther apart than the bound.
pub fn assert_alike(what: &str, a: &Picture, b: &Picture, bound: Bound) {
    let found = compare(a, b, bound);
    let allowed = a.pixels.len() as f64 * (1.0 - bound.share);
    println!(
        "{what}: {} of {} pixels beyond {}, worst {:.2} at {}",
        found.beyond,
        a.pixels.len(),
        bound.near,
        found.worst,
        found.at
    );
    assert!(
        found.beyond as f64 <= allowed && found.worst <= bound.worst,
        "{what}: {found:?}, {allowed:.1} pixels allowed"
    );
}

fn is_hit(pixel: &[f32; 4]) -> bool {
    pixel[3] > 0.5
}

/// Pixels that something was hit in: alpha above one half.
pub fn covered(picture: &Picture) -> usize {
    picture.pixels.iter().filter(|p| is_hit(p)).count()
}

/// Pixels hit in one picture and missed in the other, outside the band where `b` has a silhouette: pixels whose eight
/// neighbours in `b` are not all hit or all missed as they are.
///
/// # Panics
/// If the sizes differ.
pub fn disagreements(a: &Picture, b: &Picture) -> usize {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let (width, height) = (a.width as usize, a.height as usize);
    let is_even = |k: usize, hit: bool| {
        let (column, row) = (k % width, k / width);
        (row.saturating_sub(1)..(row + 2).min(height))
            .flat_map(|row| (column.saturating_sub(1)..(column + 2).min(width)).map(move |c| row * width + c))
            .all(|k| is_hit(&b.pixels[k]) == hit)
    };
    (0..a.pixels.len())
        .filter(|k| {
            let hit = is_hit(&b.pixels[*k]);
            is_hit(&a.pixels[*k]) != hit && is_even(*k, hit)
        })
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: f32) -> Picture {
        let mut pixels = vec![[0.5, 0.5, 0.5, 1.0]; 20_000];
        pixels[7] = [value, 0.5, 0.5, 1.0];
        Picture {
            width: 100,
            height: 200,
            pixels,
        }
    }

    #[test]
    fn one_pixel_in_ten_thousand_may_be_off_a_little() {
        let (same, near, far) = (picture(0.5), picture(0.53), picture(0.65));
        assert_alike("same", &same, &same, BOUND);
        assert_alike("near", &same, &near, BOUND);
        assert!(compare(&same, &near, BOUND).at.starts_with("column 7, row 0"));
        assert!(std::panic::catch_unwind(|| assert_alike("far", &same, &far, BOUND)).is_err());
        let odd = picture(f32::NAN);
        assert!(std::panic::catch_unwind(|| assert_alike("odd", &same, &odd, BOUND)).is_err());
        let exact = Bound { share: 1.0, ..BOUND };
        assert!(std::panic::catch_unwind(|| assert_alike("exact", &same, &near, exact)).is_err());
    }

    #[test]
    fn only_silhouettes_may_differ_in_what_is_hit() {
        // Hit from column 50 on.
        let half = |edge: usize| {
            let mut picture = picture(0.5);
            for (k, pixel) in picture.pixels.iter_mut().enumerate() {
                pixel[3] = f32::from(k % 100 >= edge);
            }
            picture
        };
        assert_eq!(disagreements(&half(51), &half(50)), 0);
        assert_eq!(disagreements(&half(49), &half(50)), 0);
        assert_eq!(disagreements(&half(52), &half(50)), 200);
        let mut holed = half(50);
        holed.pixels[999] = [0.0; 4];
        assert_eq!(disagreements(&holed, &half(50)), 1);
    }
}
