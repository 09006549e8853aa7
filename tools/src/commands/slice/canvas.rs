//! The picture of a cut or a map: linear light, premultiplied, filled from the front to the back.

use std::ops::Range;
use std::path::Path;

use brickfell_formats::value::linear_to_srgb;
use glam::DVec3;
use image::{ImageError, Rgba, RgbaImage};

use crate::commands::CommandError;

/// Most pixels of a side, and of a picture.
const MOST_SIDE: f64 = 16_384.0;
const MOST_PIXELS: f64 = 67_108_864.0;
/// Below which nothing more is seen through a pixel.
const NOTHING: f32 = 1.0 / 512.0;
/// Squares of the checkerboard, pixels, and their linear light.
const SQUARE: u32 = 8;
const SQUARES: [f32; 2] = [0.6, 0.3];

/// A picture under way.
pub(super) struct Canvas {
    /// The world's axes that are to the right, up, and across the picture.
    pub(super) axes: [usize; 3],
    /// The lower left corner on the first two of these, metres.
    pub(super) low: [f64; 2],
    /// Side of a pixel, metres.
    pub(super) pixel: f64,
    /// Pixels to the right and up.
    pub(super) size: [u32; 2],
    /// Where the third axis is cut; a map from above has none.
    pub(super) at: Option<f64>,
    /// Row 0 is the lowest.
    light: Vec<[f32; 4]>,
}

impl Canvas {
    /// An empty picture of a box of the world.
    pub(super) fn new(
        axes: [usize; 3],
        [min, max]: [DVec3; 2],
        pixel: f64,
        at: Option<f64>,
    ) -> Result<Self, CommandError> {
        // A side that is a whole number of pixels may come out a little longer.
        let side = |k: usize| ((max[axes[k]] - min[axes[k]]) / pixel - 1e-6).ceil().max(1.0);
        let (w, h) = (side(0), side(1));
        if !(w.max(h) <= MOST_SIDE && w * h <= MOST_PIXELS) {
            return Err(CommandError::new(
                format!("a picture of {w} × {h} pixels is too large"),
                "give a coarser --level, a larger --voxel, or one --tree",
            ));
        }
        Ok(Self {
            axes,
            low: [min[axes[0]], min[axes[1]]],
            pixel,
            size: [w as u32, h as u32],
            at,
            light: vec![[0.0; 4]; w as usize * h as usize],
        })
    }

    /// The pixels along an axis of the picture whose middles are in a half-open interval of the world.
    pub(super) fn pixels(&self, k: usize, interval: [f64; 2]) -> Range<u32> {
        let first = |v: f64| ((v - self.low[k]) / self.pixel - 0.5).ceil();
        let [a, b] = interval.map(|v| first(v).clamp(0.0, f64::from(self.size[k])) as u32);
        a..b.max(a)
    }

    /// The middle of a pixel along an axis of the picture, world metres.
    pub(super) fn middle(&self, k: usize, pixel: u32) -> f64 {
        self.low[k] + (f64::from(pixel) + 0.5) * self.pixel
    }

    /// Whether anything is seen that is added to a pixel.
    pub(super) fn is_open(&self, x: u32, y: u32) -> bool {
        self.light[self.place(x, y)][3] < 1.0 - NOTHING
    }

    /// Adds straight linear colour of an opacity behind what is there.
    pub(super) fn add(&mut self, x: u32, y: u32, rgb: [f64; 3], opacity: f64) {
        let place = self.place(x, y);
        let pixel = &mut self.light[place];
        let share = (1.0 - pixel[3]) * opacity as f32;
        for (sum, c) in pixel.iter_mut().zip(rgb) {
            *sum += share * c as f32;
        }
        pixel[3] += share;
    }

    fn place(&self, x: u32, y: u32) -> usize {
        y as usize * self.size[0] as usize + x as usize
    }

    /// Writes the PNG, transparent or over a checkerboard.
    pub(super) fn save(&self, path: &Path, checker: bool) -> Result<(), ImageError> {
        let [w, h] = self.size;
        let image = RgbaImage::from_fn(w, h, |x, row| {
            let [r, g, b, a] = self.light[self.place(x, h - 1 - row)];
            if checker {
                let under = (1.0 - a) * SQUARES[((x / SQUARE + row / SQUARE) % 2) as usize];
                let [r, g, b] = [r, g, b].map(|c| linear_to_srgb(c + under));
                return Rgba([r, g, b, 255]);
            }
            let [r, g, b] = [r, g, b].map(|c| linear_to_srgb(c / a.max(NOTHING)));
            Rgba([r, g, b, (a * 255.0).round() as u8])
        });
        image.save_with_format(path, image::ImageFormat::Png)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn canvas(pixel: f64) -> Canvas {
        let bounds = [DVec3::new(10.0, 0.0, -4.0), DVec3::new(12.0, 8.0, 4.0)];
        Canvas::new([0, 2, 1], bounds, pixel, Some(1.0)).ok().unwrap()
    }

    #[test]
    fn pixels_are_those_whose_middles_are_inside() {
        let canvas = canvas(0.5);
        assert_eq!(canvas.size, [4, 16]);
        assert_eq!(canvas.pixels(0, [10.0, 12.0]), 0..4);
        assert_eq!(canvas.pixels(0, [10.25, 10.75]), 0..1);
        assert_eq!(canvas.pixels(0, [10.26, 10.75]), 1..1);
        assert_eq!(canvas.pixels(1, [-100.0, 100.0]), 0..16);
        assert_eq!(canvas.pixels(1, [5.0, 6.0]), 16..16);
        assert_eq!(canvas.middle(1, 0), -3.75);
    }

    #[test]
    fn what_is_behind_shows_as_far_as_the_front_lets_it() {
        let mut canvas = canvas(1.0);
        canvas.add(1, 2, [1.0, 0.0, 0.0], 0.5);
        canvas.add(1, 2, [0.0, 1.0, 0.0], 1.0);
        canvas.add(1, 2, [0.0, 0.0, 1.0], 1.0);
        assert_eq!(canvas.light[canvas.place(1, 2)], [0.5, 0.5, 0.0, 1.0]);
        assert!(!canvas.is_open(1, 2) && canvas.is_open(0, 2));
    }

    #[test]
    fn pictures_that_no_memory_holds_are_refused() {
        for pixel in [1e-9, f64::MIN_POSITIVE] {
            let bounds = [DVec3::ZERO, DVec3::ONE];
            assert!(Canvas::new([0, 1, 2], bounds, pixel, None).is_err());
        }
    }
}
