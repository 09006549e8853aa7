//! Height maps: samples at pixel centres, in metres, placed in the world.
//!
//! Units: horizontal coordinates × the linear unit of their system; heights × (the option, else the file's vertical
//! unit, else the horizontal unit). A file without any georeference gets pixels of 1 m (or the size asked for) with
//! row 0 in the north and the lower-left outer corner at (0, 0). Immutable once loaded; read from many threads.

use std::path::Path;

use glam::DVec2;
use rayon::prelude::*;

use super::error::InputError;
use super::georef::{self, GeoTransform, Georef};
use super::height_samples::Samples;
use super::image_file::Raster;
use super::imagery::Imagery;

/// How far outside the outer edge, in pixels, a position still counts as on it (rounding of the transforms).
const EDGE_TOLERANCE: f64 = 1e-6;

/// The unit of the heights in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeightUnit {
    /// Metres.
    Metres,
    /// International feet, 0.3048 m.
    Feet,
}

impl HeightUnit {
    /// Metres per unit.
    pub fn metres(self) -> f64 {
        match self {
            HeightUnit::Metres => 1.0,
            HeightUnit::Feet => 0.3048,
        }
    }
}

/// What a user can say about a height map that the file does not.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct HeightOptions {
    /// Unit of the heights; overrides the file.
    pub height_unit: Option<HeightUnit>,
    /// Pixel size in metres of a file without a georeference of its own.
    pub pixel_size: Option<f64>,
    /// Heights of the least and the greatest code of an unsigned integer file; overrides scale and offset.
    pub range: Option<(f32, f32)>,
}

/// A raster of heights.
#[derive(Debug, Clone)]
pub struct HeightMap {
    /// Samples per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` heights in metres, row by row in the order of the file; NaN is nodata.
    pub data: Vec<f32>,
    /// Where the samples lie.
    pub georef: Georef,
    to_world: GeoTransform,
    to_pixel: GeoTransform,
    min_max: (f32, f32),
}

impl HeightMap {
    /// Puts a height map together. `path` is named in errors.
    ///
    /// # Errors
    /// Pixels without area, or no valid height at all.
    pub fn new(path: &Path, size: (u32, u32), data: Vec<f32>, georef: Georef) -> Result<Self, InputError> {
        if data.len() != size.0 as usize * size.1 as usize {
            return Err(InputError::damaged(
                path,
                format!("{} heights for {} x {} pixels", data.len(), size.0, size.1),
            ));
        }
        let to_world = georef.to_world().checked(path)?;
        let to_pixel = to_world
            .inverse()
            .ok_or_else(|| InputError::georef(path, "the pixel size is zero"))?;
        let min_max = data
            .par_iter()
            .filter(|h| !h.is_nan())
            .fold(
                || (f32::INFINITY, f32::NEG_INFINITY),
                |(lo, hi), h| (h.min(lo), h.max(hi)),
            )
            .reduce(
                || (f32::INFINITY, f32::NEG_INFINITY),
                |a, b| (a.0.min(b.0), a.1.max(b.1)),
            );
        if min_max.0 > min_max.1 {
            return Err(InputError::NoHeights {
                path: path.to_path_buf(),
            });
        }
        Ok(HeightMap {
            width: size.0,
            height: size.1,
            data,
            georef,
            to_world,
            to_pixel,
            min_max,
        })
    }

    /// Reads a height map: PNG with 8 or 16 bits, TIFF or GeoTIFF with integers or floats, one band.
    ///
    /// # Errors
    /// A missing, damaged or unsupported file, degrees, no valid height.
    pub fn load(path: &Path, options: HeightOptions) -> Result<HeightMap, InputError> {
        let placement = georef::read(path)?;
        Samples::read(path)?.place(path, placement, options)
    }

    /// World metres of a position in pixel space (sample `(c, r)` lies at `(c + ½, r + ½)`).
    pub fn pixel_to_world(&self, pixel: DVec2) -> DVec2 {
        self.to_world.at(pixel)
    }

    /// Position in pixel space of world metres.
    pub fn world_to_pixel(&self, world: DVec2) -> DVec2 {
        self.to_pixel.at(world)
    }

    /// What a step of world metres is in pixel space.
    #[inline]
    pub fn direction_to_pixel(&self, world: DVec2) -> DVec2 {
        self.to_pixel.column * world.x + self.to_pixel.row * world.y
    }

    /// Lengths in metres of a step to the next column and to the next row.
    pub fn pixel_size(&self) -> DVec2 {
        DVec2::new(self.to_world.column.length(), self.to_world.row.length())
    }

    /// Smallest box around the outer pixel edges, world metres: (least, greatest).
    pub fn bounds(&self) -> (DVec2, DVec2) {
        self.to_world.bounds((self.width, self.height))
    }

    /// Least and greatest valid height, metres.
    pub fn min_max(&self) -> (f32, f32) {
        self.min_max
    }

    /// Height in metres at world metres `(x, y)`: bilinear between samples, constant across the outer half pixel.
    /// `None` outside the outer edges and where a sample that counts is nodata.
    #[inline]
    pub fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let pixel = self.to_pixel.at(DVec2::new(x, y));
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let inside = pixel.x >= -EDGE_TOLERANCE
            && pixel.y >= -EDGE_TOLERANCE
            && pixel.x <= w + EDGE_TOLERANCE
            && pixel.y <= h + EDGE_TOLERANCE;
        if !inside {
            return None;
        }
        let fx = (pixel.x - 0.5).clamp(0.0, w - 1.0);
        let fy = (pixel.y - 0.5).clamp(0.0, h - 1.0);
        let (column, row) = (fx as usize, fy as usize);
        let (tx, ty) = (fx - column as f64, fy - row as f64);
        // A neighbour of weight zero must not spoil the result, nor lie outside the raster.
        let right = usize::from(tx > 0.0);
        let below = if ty > 0.0 { self.width as usize } else { 0 };
        let at = row * self.width as usize + column;
        let sample = |index: usize| self.data.get(index).map_or(f64::NAN, |h| f64::from(*h));
        let top = sample(at) + tx * (sample(at + right) - sample(at));
        let bottom = sample(at + below) + tx * (sample(at + below + right) - sample(at + below));
        let height = top + ty * (bottom - top);
        (!height.is_nan()).then_some(height)
    }
}

/// Loads a height map and, if given, the image that belongs to it.
///
/// Where only one of the two files has a georeference it serves both: an image without one covers exactly the height
/// map, and heights without one (and without `pixel_size`) cover exactly the image. A missing linear unit is taken
/// from the other file likewise.
///
/// # Errors
/// Those of [`HeightMap::load`] and [`Imagery::load`].
pub fn load_layer(
    heights: &Path,
    imagery: Option<&Path>,
    options: HeightOptions,
) -> Result<(HeightMap, Option<Imagery>), InputError> {
    let Some(image_path) = imagery else {
        return Ok((HeightMap::load(heights, options)?, None));
    };
    let mut place = georef::read(heights)?;
    let image_place = georef::read(image_path)?;
    let samples = Samples::read(heights)?;
    let raster = Raster::load(image_path)?;
    if place.transform.is_none() && options.pixel_size.is_none() {
        place.transform = image_place
            .transform
            .map(|t| t.resized((raster.width, raster.height), (samples.width, samples.height)));
    }
    if place.transform.is_some() && place.crs.is_none() && place.linear_unit.is_none() {
        place.crs = image_place.crs.clone();
        place.linear_unit = image_place.linear_unit;
    }
    let map = samples.place(heights, place, options)?;
    let imagery = Imagery::place(image_path, raster, image_place, &map)?;
    Ok((map, Some(imagery)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::test_data::{TagValue, data, float_tiff};
    use std::fs;
    use std::path::PathBuf;

    fn png16(dir: &Path, name: &str, w: u32, h: u32, values: &[u16]) -> PathBuf {
        let path = dir.join(name);
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(w, h, values.to_vec())
            .unwrap()
            .save(&path)
            .unwrap();
        path
    }

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b}");
    }

    #[test]
    fn without_georeference_row_0_is_north_and_the_corner_is_the_origin() {
        let dir = tempfile::tempdir().unwrap();
        let path = png16(dir.path(), "a.png", 3, 2, &[1, 2, 3, 4, 5, 6]);
        let map = HeightMap::load(&path, HeightOptions::default()).unwrap();
        assert_eq!(map.bounds(), (DVec2::ZERO, DVec2::new(3.0, 2.0)));
        assert_eq!(map.height_at(0.5, 0.5), Some(4.0));
        assert_eq!(map.height_at(2.5, 1.5), Some(3.0));
        assert_eq!(map.height_at(1.0, 1.0), Some(3.0));
        assert_eq!(map.height_at(0.0, 0.0), Some(4.0));
        assert_eq!(map.height_at(3.01, 1.0), None);
        assert_eq!(map.min_max(), (1.0, 6.0));
        let options = HeightOptions {
            pixel_size: Some(2.0),
            range: Some((10.0, 75.535)),
            ..Default::default()
        };
        let map = HeightMap::load(&path, options).unwrap();
        assert_eq!(map.bounds().1, DVec2::new(6.0, 4.0));
        close(map.height_at(1.0, 3.0).unwrap(), 10.001, 1e-5);
    }

    #[test]
    fn world_file_and_scale_of_a_side_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = png16(dir.path(), "a.png", 2, 2, &[0, 100, 200, 65535]);
        fs::write(dir.path().join("a.pgw"), "0.5\n0\n0\n-0.5\n100.25\n200.75\n").unwrap();
        fs::write(
            dir.path().join("a.png.aux.xml"),
            "<PAMDataset><PAMRasterBand band=\"1\"><NoDataValue>65535</NoDataValue><Offset>-5</Offset>\
             <Scale>0.25</Scale></PAMRasterBand></PAMDataset>",
        )
        .unwrap();
        let map = HeightMap::load(&path, HeightOptions::default()).unwrap();
        assert_eq!(map.bounds(), (DVec2::new(100.0, 200.0), DVec2::new(101.0, 201.0)));
        assert_eq!(map.height_at(100.25, 200.75), Some(-5.0));
        assert_eq!(map.height_at(100.75, 200.75), Some(20.0));
        assert_eq!(
            map.height_at(100.25, 200.25),
            Some(45.0),
            "nodata with weight zero does not count"
        );
        assert_eq!(map.height_at(100.5, 200.5), None, "nodata counts");
    }

    #[test]
    fn feet_scale_everything_unless_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        let keys = vec![1, 1, 0, 1, 3076, 0, 1, 9002];
        let tags = vec![
            (33550, TagValue::Double(vec![10.0, 10.0, 0.0])),
            (33922, TagValue::Double(vec![0.0, 0.0, 0.0, 1000.0, 2000.0, 0.0])),
            (34735, TagValue::Short(keys)),
            (42113, TagValue::Ascii("-9999".into())),
        ];
        let samples = [100.0, -9999.0, f32::NAN, f32::INFINITY, 2e6, 200.0];
        fs::write(&path, float_tiff(3, 2, &samples, tags)).unwrap();
        let map = HeightMap::load(&path, HeightOptions::default()).unwrap();
        close(map.bounds().0.x, 304.8, 1e-9);
        close(map.bounds().1.y, 609.6, 1e-9);
        close(f64::from(map.data[0]), 30.48, 1e-5);
        assert_eq!(map.data.iter().filter(|h| h.is_nan()).count(), 4);
        let options = HeightOptions {
            height_unit: Some(HeightUnit::Metres),
            ..Default::default()
        };
        assert_eq!(HeightMap::load(&path, options).unwrap().min_max(), (100.0, 200.0));
    }

    #[test]
    fn rotated_grid() {
        let georef = Georef {
            transform: GeoTransform {
                origin: DVec2::new(5.0, 5.0),
                column: DVec2::Y,
                row: DVec2::X,
            },
            crs: None,
            linear_unit_metres: 1.0,
            vertical_unit_metres: None,
            geographic: false,
        };
        let map = HeightMap::new(Path::new("a"), (2, 1), vec![1.0, 2.0], georef).unwrap();
        assert_eq!(map.bounds(), (DVec2::new(5.0, 5.0), DVec2::new(6.0, 7.0)));
        assert_eq!(map.height_at(5.5, 6.0), Some(1.5));
        assert_eq!(
            map.world_to_pixel(map.pixel_to_world(DVec2::new(1.25, 0.5))),
            DVec2::new(1.25, 0.5)
        );
    }

    #[test]
    fn faults_are_one_line_naming_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        fs::write(&path, float_tiff(2, 1, &[f32::NAN; 2], Vec::new())).unwrap();
        let none = HeightMap::load(&path, HeightOptions::default()).unwrap_err();
        assert!(matches!(none, InputError::NoHeights { .. }));
        fs::write(&path, float_tiff(2, 2, &[1.0; 3], Vec::new())).unwrap();
        let short = HeightMap::load(&path, HeightOptions::default())
            .unwrap_err()
            .to_string();
        assert!(short.contains("a.tif") && !short.contains('\n'), "{short}");
        let rgb = dir.path().join("rgb.png");
        image::RgbImage::new(2, 2).save(&rgb).unwrap();
        let bands = HeightMap::load(&rgb, HeightOptions::default())
            .unwrap_err()
            .to_string();
        assert!(bands.contains("one band"), "{bands}");
        let missing = HeightMap::load(&dir.path().join("none.png"), HeightOptions::default()).unwrap_err();
        assert!(missing.to_string().contains("none.png"));
    }

    #[test]
    fn the_image_places_heights_without_georeference() {
        let dir = tempfile::tempdir().unwrap();
        let heights = png16(dir.path(), "h.png", 2, 2, &[10; 4]);
        let image = dir.path().join("i.png");
        image::RgbImage::new(4, 4).save(&image).unwrap();
        fs::write(
            dir.path().join("i.png.aux.xml"),
            "<PAMDataset><SRS>PROJCS[\"p\",UNIT[\"foot\",0.3048]]</SRS>\
             <GeoTransform>100,1,0,100,0,-1</GeoTransform></PAMDataset>",
        )
        .unwrap();
        let (map, imagery) = load_layer(&heights, Some(&image), HeightOptions::default()).unwrap();
        close(map.pixel_size().x, 2.0 * 0.3048, 1e-12);
        close(map.bounds().1.y, 30.48, 1e-9);
        close(f64::from(map.min_max().0), 3.048, 1e-6);
        assert_eq!(imagery.unwrap().georef.to_world().bounds((4, 4)), map.bounds());
    }

    #[test]
    fn autzen_is_in_feet() {
        let Some(heights) = data("autzen_lidar_ortho/autzen_dsm_1ft.tif") else {
            return;
        };
        let Some(image) = data("autzen_lidar_ortho/autzen.jpg") else {
            return;
        };
        let (map, imagery) = load_layer(&heights, Some(&image), HeightOptions::default()).unwrap();
        let (min, max) = map.bounds();
        close(max.x - min.x, 990.0, 0.5);
        close(max.y - min.y, 1336.6, 0.5);
        close(f64::from(map.min_max().0), 124.0, 1.0);
        close(f64::from(map.min_max().1), 187.5, 1.0);
        let (imagery_min, _) = imagery.unwrap().georef.to_world().bounds((map.width, map.height));
        assert!((imagery_min - min).length() < 1e-3);
    }

    #[test]
    fn sertig_is_in_metres_and_santabarbara_in_degrees() {
        let Some(heights) = data("sertig_valley_ch/sertig_valley.tif") else {
            return;
        };
        let map = HeightMap::load(&heights, HeightOptions::default()).unwrap();
        assert_eq!(map.georef.crs.as_deref(), Some("EPSG:21781"));
        close(map.bounds().1.x - map.bounds().0.x, 6410.0, 1e-6);
        close(f64::from(map.min_max().1), 3002.0, 1.0);
        let Some(degrees) = data("santabarbara/sba_elev32_wgs84_512x512.tif") else {
            return;
        };
        let message = HeightMap::load(&degrees, HeightOptions::default())
            .unwrap_err()
            .to_string();
        assert!(message.contains("degrees"), "{message}");
    }
}
