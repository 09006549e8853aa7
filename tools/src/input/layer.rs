//! A height map with the picture that lies over it: the ground, and its colour.
//!
//! Immutable once loaded; read from many threads.

use std::path::Path;

use glam::DVec2;

use super::error::InputError;
use super::heights::{HeightMap, HeightOptions, load_layer};
use super::imagery::{Imagery, ramp_color};

/// A height map and the picture laid over it.
#[derive(Debug)]
pub struct Layer {
    /// The heights.
    pub map: HeightMap,
    /// The picture; without one, ground is coloured by height and slope.
    pub imagery: Option<Imagery>,
}

impl Layer {
    /// Reads a height map and, if given, its picture.
    ///
    /// # Errors
    /// Those of [`load_layer`].
    pub fn load(heights: &Path, imagery: Option<&Path>, options: HeightOptions) -> Result<Self, InputError> {
        let (map, imagery) = load_layer(heights, imagery, options)?;
        Ok(Self { map, imagery })
    }

    /// Colour of the ground over the world rectangle from `min` to `max`, metres: straight linear light. `height` is the
    /// ground's there, metres, and `up` the z of its unit normal.
    #[inline]
    pub fn color(&self, min: DVec2, max: DVec2, height: f64, up: f32) -> [f32; 3] {
        let picture = self
            .imagery
            .as_ref()
            .and_then(|i| i.color_at_area(min.x, min.y, max.x, max.y));
        let [r, g, b, a] = picture.filter(|c| c[3] > 0.0).unwrap_or_else(|| {
            let (low, high) = self.map.min_max();
            let above = (height as f32 - low) / (high - low).max(f32::MIN_POSITIVE);
            ramp_color(above, up)
        });
        [r / a, g / a, b / a]
    }
}
