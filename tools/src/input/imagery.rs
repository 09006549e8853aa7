//! Pictures laid over height maps, and the colours of ground without a picture.
//!
//! A colour is the box filter of the picture over a rectangle, in linear light: pixels count by the part of them that is
//! covered, a rectangle narrower than a pixel is widened to one pixel (which is bilinear interpolation). Of a rectangle
//! that lies askew in the picture it is the box around it. Immutable once loaded; any thread.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use super::block_cache::RasterCache;
use super::cells::{Cells, Window};
#[cfg(test)]
use super::crs::Crs;
use super::error::InputError;
use super::georef::Placement;
use super::heights::HeightMap;
#[cfg(test)]
use super::image_file::Raster;
use super::image_file::read_colors;
use super::linear::{LINEAR, linear_of, premultiplied};
use super::place::{Frame, Place};

/// A picture and where it lies.
#[derive(Debug)]
pub struct Imagery {
    pub(super) cells: Cells,
    pub(super) place: Place,
    linear: Box<[f32; 256]>,
}

impl Imagery {
    /// A picture in memory that is laid over heights. Without a georeference it covers the height map exactly.
    ///
    /// # Errors
    /// Another coordinate system than the heights', no overlap with them.
    #[cfg(test)]
    pub(crate) fn place(
        path: &Path,
        raster: Raster,
        placement: Placement,
        heights: &HeightMap,
    ) -> Result<Imagery, InputError> {
        let ground = Placement {
            transform: Some(heights.georef.transform),
            crs: Crs {
                name: heights.georef.crs.clone(),
                ..Crs::default()
            },
            linear_unit: Some(heights.georef.linear_unit_metres),
            ..Placement::default()
        };
        let frame = Frame::of(&[(path, &ground, (heights.width, heights.height))])?;
        let size = (raster.width, raster.height);
        let placement = placement.over(&ground, (heights.width, heights.height), size);
        let cells = Cells::whole(raster.width, raster.height, raster.pixels);
        Imagery::new(path, cells, Place::new(path, &placement, &frame)?, heights)
    }

    /// Reads the picture that belongs to `heights`. Pixels that equal a declared nodata value in all bands become
    /// transparent (not in JPEG, which keeps no exact values).
    pub(crate) fn read(
        path: &Path,
        placement: Placement,
        heights: &HeightMap,
        ground: &Placement,
        frame: &Frame,
        cache: &Arc<RasterCache>,
    ) -> Result<Imagery, InputError> {
        let code = placement
            .nodata
            .filter(|v| (0.0..=255.0).contains(v) && v.fract() == 0.0);
        let cells = read_colors(path, code.map(|code| code as u8), cache, None)?;
        let placement = placement.over(
            ground,
            (heights.width, heights.height),
            (cells.width, cells.height),
        );
        Imagery::new(path, cells, Place::new(path, &placement, frame)?, heights)
    }

    fn new(path: &Path, cells: Cells, place: Place, heights: &HeightMap) -> Result<Imagery, InputError> {
        let size = (cells.width, cells.height);
        let ((image_min, image_max), (min, max)) = (place.bounds(size, heights.min_max()), heights.bounds());
        if image_min.cmpge(max).any() || image_max.cmple(min).any() {
            let what = format!(
                "the image ({image_min:.1} to {image_max:.1} m) does not overlap the heights ({min:.1} to {max:.1} m)"
            );
            return Err(InputError::Mismatch {
                path: path.to_path_buf(),
                what,
            });
        }
        Ok(Imagery {
            cells,
            place,
            linear: Box::new(*LINEAR),
        })
    }

    /// Mean colour over a box in pixel space, given by its middle and half of its sides: premultiplied linear-light
    /// RGBA. Where the box reaches over the edge, the part inside counts. `None` outside the picture and where all of
    /// it is transparent.
    #[inline]
    pub(crate) fn mean(&self, window: &Window, middle: [f64; 2], half: [f64; 2]) -> Option<[f32; 4]> {
        let columns = Span::new(middle[0], half[0], window.size.0)?;
        let rows = Span::new(middle[1], half[1], window.size.1)?;
        self.mean_of(window, &columns, &rows)
    }

    #[inline]
    pub(super) fn mean_of(&self, window: &Window, columns: &Span, rows: &Span) -> Option<[f32; 4]> {
        if columns.pixels.len() == 1 && rows.pixels.len() == 1 {
            let color = premultiplied(&self.linear, window.get(columns.pixels.start, rows.pixels.start)?);
            return (color[3] > 0.0).then_some(color);
        }
        let mut sum = [0.0f32; 4];
        let mut weight = 0.0f32;
        for row in rows.pixels.clone() {
            let row_weight = rows.weight(row);
            for (column, pixel) in columns
                .pixels
                .clone()
                .zip(window.row(row, columns.pixels.clone()))
            {
                let w = row_weight * columns.weight(column);
                let color = premultiplied(&self.linear, *pixel);
                for (total, channel) in sum.iter_mut().zip(color) {
                    *total += w * channel;
                }
                weight += w;
            }
        }
        (sum[3] > 0.0 && weight > 0.0).then(|| sum.map(|s| s / weight))
    }
}

/// The part of one axis that a box covers, pixels.
#[derive(Clone, Debug)]
pub(super) struct Span {
    pub(super) pixels: Range<usize>,
    low: f64,
    high: f64,
}

impl Span {
    /// The pixels that a box of `half` around `center` touches; `None` if the box lies outside 0..`size` (or is NaN).
    #[inline]
    pub(super) fn new(center: f64, half: f64, size: u32) -> Option<Span> {
        let size = f64::from(size);
        if !(center - half < size && center + half > 0.0) {
            return None;
        }
        let half = half.max(0.5);
        // A box mostly outside still covers something of the first or last pixel.
        let center = center.clamp(0.5 - half + 1e-3, size - 0.5 + half - 1e-3);
        let (low, high) = ((center - half).max(0.0), (center + half).min(size));
        let first = low as usize;
        // The end, rounded up without a call: it is at least 0.
        let last = high as usize;
        let last = if high > last as f64 { last + 1 } else { last };
        Some(Span {
            pixels: first..last,
            low,
            high,
        })
    }

    /// How much of pixel `index` is covered, 0..1.
    #[inline]
    fn weight(&self, index: usize) -> f32 {
        let start = index as f64;
        ((start + 1.0).min(self.high) - start.max(self.low)).max(0.0) as f32
    }
}

/// Colour of ground without a picture: straight linear-light RGBA, alpha 1.
///
/// `height01` is the height between the terrain's lowest (0) and highest (1) point, `up` the z of the unit normal
/// (1 is level, 0 a wall). Sand, grass, heath, scree and snow by height; steep ground is rock.
pub fn ramp_color(height01: f32, up: f32) -> [f32; 4] {
    const STOPS: [(f32, [f32; 3]); 6] = [
        (0.00, [0.62, 0.57, 0.42]),
        (0.06, [0.42, 0.50, 0.25]),
        (0.35, [0.33, 0.42, 0.20]),
        (0.60, [0.47, 0.43, 0.30]),
        (0.82, [0.55, 0.52, 0.48]),
        (1.00, [0.93, 0.94, 0.95]),
    ];
    const ROCK: [f32; 3] = [0.42, 0.39, 0.36];
    let t = if height01.is_nan() {
        0.0
    } else {
        height01.clamp(0.0, 1.0)
    };
    let above = STOPS
        .iter()
        .position(|stop| stop.0 >= t)
        .unwrap_or(STOPS.len() - 1)
        .max(1);
    let ((t0, low), (t1, high)) = (STOPS[above - 1], STOPS[above]);
    let k = (t - t0) / (t1 - t0);
    let steep = ((0.85 - up) / 0.25).clamp(0.0, 1.0);
    let channel = |i: usize| {
        let flat = low[i] + k * (high[i] - low[i]);
        linear_of(flat + steep * (ROCK[i] - flat))
    };
    [channel(0), channel(1), channel(2), 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::georef::{GeoTransform, Georef};
    use crate::input::heights::HeightOptions;
    use crate::input::layer::load_layer;
    use brickfell_formats::value::srgb_to_linear;
    use glam::{DVec2, DVec3};
    use std::fs;

    fn flat_heights(width: u32, height: u32) -> HeightMap {
        let georef = Georef {
            transform: GeoTransform::north_up(DVec2::ZERO, 1.0, height),
            crs: None,
            linear_unit_metres: 1.0,
            vertical_unit_metres: None,
            geographic: false,
        };
        HeightMap::new(
            Path::new("h"),
            (width, height),
            vec![0.0; (width * height) as usize],
            georef,
        )
        .unwrap()
    }

    fn imagery(width: u32, height: u32, pixels: Vec<[u8; 4]>, heights: &HeightMap) -> Imagery {
        let raster = Raster {
            width,
            height,
            pixels,
        };
        Imagery::place(Path::new("i"), raster, Placement::default(), heights).unwrap()
    }

    impl Imagery {
        /// Over a rectangle of the world.
        fn color_at_area(&self, x0: f64, y0: f64, x1: f64, y1: f64) -> Option<[f32; 4]> {
            let [a, b] = [(x0, y0), (x1, y1)].map(|(x, y)| self.place.pixel(DVec3::new(x, y, 0.0)));
            let (middle, half) = ((a + b) * 0.5, (b - a).abs() * 0.5);
            self.mean(&self.cells.all().unwrap(), [middle.x, middle.y], [half.x, half.y])
        }
    }

    const RED: [u8; 4] = [255, 0, 0, 255];
    const GREEN: [u8; 4] = [0, 255, 0, 255];
    const CLEAR: [u8; 4] = [255, 255, 255, 0];

    #[test]
    fn covers_the_heights_with_row_0_in_the_north() {
        let image = imagery(1, 2, vec![RED, GREEN], &flat_heights(4, 4));
        assert_eq!(
            image.color_at_area(1.0, 3.0, 1.1, 3.1),
            Some([1.0, 0.0, 0.0, 1.0])
        );
        assert_eq!(
            image.color_at_area(1.0, 0.5, 1.1, 0.6),
            Some([0.0, 1.0, 0.0, 1.0])
        );
        assert_eq!(image.color_at_area(4.1, 1.0, 4.2, 1.1), None);
    }

    #[test]
    fn box_weights_are_fractional_and_linear() {
        let image = imagery(
            4,
            1,
            vec![RED, GREEN, [188, 188, 188, 255], CLEAR],
            &flat_heights(4, 1),
        );
        let mean = image.color_at_area(0.5, 0.0, 2.0, 1.0).unwrap();
        assert!(
            (mean[0] - 1.0 / 3.0).abs() < 1e-6 && (mean[1] - 2.0 / 3.0).abs() < 1e-6,
            "{mean:?}"
        );
        let grey = image.color_at_area(2.2, 0.4, 2.8, 0.6).unwrap();
        assert!((grey[0] - srgb_to_linear(188) * grey[3]).abs() < 1e-6);
        assert_eq!(image.color_at_area(3.5, 0.0, 4.0, 1.0), None, "fully transparent");
        let edge = image.color_at_area(-5.0, 0.0, 1.0, 1.0).unwrap();
        assert_eq!(edge, [1.0, 0.0, 0.0, 1.0], "only the part inside counts");
    }

    #[test]
    fn narrow_rectangles_interpolate() {
        let image = imagery(2, 1, vec![RED, GREEN], &flat_heights(2, 1));
        let mean = image.color_at_area(0.74, 0.49, 0.76, 0.51).unwrap();
        assert!(
            (mean[0] - 0.75).abs() < 1e-3 && (mean[1] - 0.25).abs() < 1e-3,
            "{mean:?}"
        );
        let edge = image.color_at_area(0.0, 0.4, 0.01, 0.41).unwrap();
        assert_eq!(edge, [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn wrong_places_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("i.png");
        image::RgbImage::new(2, 2).save(&path).unwrap();
        fs::write(dir.path().join("i.pgw"), "1\n0\n0\n-1\n1000\n1000\n").unwrap();
        let heights = dir.path().join("h.png");
        image::GrayImage::new(4, 4).save(&heights).unwrap();
        fs::write(dir.path().join("h.pgw"), "1\n0\n0\n-1\n0.5\n3.5\n").unwrap();
        let message = load_layer(&heights, Some(&path), HeightOptions::default());
        let message = message.unwrap_err().to_string();
        assert!(
            message.contains("i.png") && message.contains("does not overlap"),
            "{message}"
        );
        let mut heights = flat_heights(4, 4);
        heights.georef.crs = Some("EPSG:1".into());
        let placement = Placement {
            crs: Crs {
                name: Some("EPSG:2".into()),
                ..Crs::default()
            },
            transform: Some(GeoTransform::north_up(DVec2::ZERO, 1.0, 1)),
            ..Placement::default()
        };
        let raster = Raster {
            width: 1,
            height: 1,
            pixels: vec![RED],
        };
        assert!(Imagery::place(&path, raster, placement, &heights).is_err());
    }

    #[test]
    fn declared_nodata_is_transparent() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("i.png");
        image::RgbImage::from_raw(2, 1, vec![0, 0, 0, 0, 9, 0])
            .unwrap()
            .save(&path)
            .unwrap();
        fs::write(
            dir.path().join("i.png.aux.xml"),
            "<PAMDataset><PAMRasterBand band=\"1\"><NoDataValue>0</NoDataValue></PAMRasterBand></PAMDataset>",
        )
        .unwrap();
        let heights = dir.path().join("h.png");
        image::GrayImage::new(2, 1).save(&heights).unwrap();
        let layer = load_layer(&heights, Some(&path), HeightOptions::default()).unwrap();
        let imagery = layer.imagery.unwrap();
        assert_eq!(
            imagery.cells.all().unwrap().row(0, 0..2),
            [[0; 4], [0, 9, 0, 255]]
        );
    }

    #[test]
    fn ramp_is_continuous_and_rocky_on_walls() {
        let mut last = ramp_color(0.0, 1.0);
        for i in 1..=1000 {
            let next = ramp_color(i as f32 / 1000.0, 1.0);
            assert!(last.iter().zip(next).all(|(a, b)| (a - b).abs() < 0.01));
            last = next;
        }
        assert_eq!(ramp_color(0.1, 0.0), ramp_color(0.9, 0.0));
        assert!(ramp_color(f32::NAN, 1.0).iter().all(|c| c.is_finite()));
    }
}
