//! Height maps: samples at pixel centres, in metres, placed in the world.
//!
//! Units: horizontal coordinates × the linear unit of their system; heights × (the option, else the file's vertical
//! unit, else the horizontal unit; metres for degrees). A file without any georeference gets pixels of 1 m (or the size
//! asked for) with row 0 in the north and the lower-left outer corner at (0, 0). Samples are kept whole or read in parts
//! (`cells`). Immutable once loaded; read from many threads.

use std::path::Path;
use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::block_cache::RasterCache;
use super::cells::{Cells, Window};
use super::error::InputError;
use super::georef::{GeoTransform, Georef, Placement};
use super::height_samples::HeightFile;
use super::place::{Frame, Place};
use super::ranges::Ranges;

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

/// How heights are coded in the colours of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TerrainRgb {
    /// `(65536·R + 256·G + B) / 10 − 10000` metres.
    Mapbox,
    /// `256·R + G + B / 256 − 32768` metres.
    Terrarium,
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
    /// How heights are coded in files with colours; without it such files are refused.
    pub terrain_rgb: Option<TerrainRgb>,
}

/// A raster of heights.
#[derive(Debug)]
pub struct HeightMap {
    /// Samples per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What the file says about where its samples lie.
    pub georef: Georef,
    /// What was taken for granted, one line each.
    pub notes: Vec<String>,
    pub(super) cells: Cells,
    pub(super) ranges: Ranges,
    pub(super) place: Place,
    frame: Option<String>,
    min_max: (f32, f32),
}

impl HeightMap {
    /// A height map of samples in metres, NaN where there are none, row by row. `path` is named in errors.
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
        let cells: Vec<_> = data.into_iter().map(f32::to_le_bytes).collect();
        let mut ranges = Ranges::new(size.0, size.1);
        for (row, cells) in (0..).zip(cells.chunks(size.0.max(1) as usize)) {
            ranges.add(0, row, cells);
        }
        Ok(HeightMap {
            width: size.0,
            height: size.1,
            notes: Vec::new(),
            cells: Cells::whole(size.0, size.1, cells),
            min_max: some_height(path, &ranges)?,
            ranges,
            place: Place::affine(path, georef.to_world())?,
            frame: georef.crs.clone(),
            georef,
        })
    }

    /// Reads a height file into its place in a frame.
    pub(crate) fn read(
        path: &Path,
        file: HeightFile,
        place: &Placement,
        frame: &Frame,
        options: &HeightOptions,
        cache: &Arc<RasterCache>,
    ) -> Result<Self, InputError> {
        let (width, height) = (file.width, file.height);
        let unit = place.linear_unit.unwrap_or(1.0);
        let world = Place::new(path, place, frame)?;
        let (cells, ranges) = file.read(place, unit, options, cache)?;
        Ok(HeightMap {
            width,
            height,
            georef: place.georef().unwrap_or(Georef::pixels(height)),
            notes: Vec::new(),
            min_max: some_height(path, &ranges)?,
            cells,
            ranges,
            place: world,
            frame: frame.name(),
        })
    }

    /// Name of the coordinate system of the world, if it is known.
    pub fn world_system(&self) -> Option<&str> {
        self.frame.as_deref()
    }

    /// Lengths in metres of a step to the next column and to the next row.
    pub fn pixel_size(&self) -> DVec2 {
        self.place.pixel_size((self.width, self.height))
    }

    /// A box around the outer pixel edges, world metres: (least, greatest).
    pub fn bounds(&self) -> (DVec2, DVec2) {
        self.place.bounds((self.width, self.height), self.min_max)
    }

    /// Least and greatest valid height, metres.
    pub fn min_max(&self) -> (f32, f32) {
        self.min_max
    }

    /// Height of the ground (its z) in metres at world metres `(x, y)`: bilinear between samples, constant across the
    /// outer half pixel. `None` outside the outer edges and where a sample that counts is nodata.
    ///
    /// # Errors
    /// If a part of the file cannot be read.
    pub fn height_at(&self, x: f64, y: f64) -> Result<Option<f64>, InputError> {
        let mut z = [0.0];
        let columns = super::mapping::Columns { step: 1.0, zero: 0.0 };
        self.heights(columns, [x, y], 1, &mut z)?;
        Ok(Some(z[0]).filter(|z| !z.is_nan()))
    }

    /// The map as an affine one in memory, for rays. One that is not affine is resampled at its finest pixel.
    pub(crate) fn relief(&self) -> Result<Relief<'_>, InputError> {
        if let Place::Affine { to_world, to_pixel } = &self.place {
            return Ok(Relief {
                width: self.width,
                height: self.height,
                to_world: *to_world,
                to_pixel: *to_pixel,
                cells: self.cells.all()?,
            });
        }
        let (min, max) = self.bounds();
        let step = self.pixel_size().min_element();
        let size = ((max - min) / step).ceil();
        let (width, height) = (size.x as u32, size.y as u32);
        super::image_file::check_whole(Path::new("height map"), width, height)?;
        let columns = super::mapping::Columns { step, zero: 0.0 };
        let mut z = vec![0.0; width as usize * height as usize];
        self.heights(columns, (min / step + 0.5).to_array(), width as usize, &mut z)?;
        let to_world = GeoTransform {
            origin: min,
            column: DVec2::new(step, 0.0),
            row: DVec2::new(0.0, step),
        };
        let cells = z.iter().map(|z| (*z as f32).to_le_bytes()).collect();
        Ok(Relief {
            width,
            height,
            to_world,
            to_pixel: to_world.inverse().unwrap_or(to_world),
            cells: Window::owned(width, height, cells),
        })
    }

    /// The height over the ellipsoid, or whatever the file's heights count from, of a point of the world.
    pub(crate) fn height_of(&self, world: DVec3) -> f64 {
        self.place.pixel(world).z
    }
}

fn some_height(path: &Path, ranges: &Ranges) -> Result<(f32, f32), InputError> {
    ranges.all().ok_or_else(|| InputError::NoHeights {
        path: path.to_path_buf(),
    })
}

/// A height map whose samples are all at hand, on a grid that the world is an affine image of.
#[derive(Debug)]
pub(crate) struct Relief<'a> {
    /// Samples per row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    to_world: GeoTransform,
    to_pixel: GeoTransform,
    cells: Window<'a>,
}

impl Relief<'_> {
    /// A sample, metres; NaN is nodata.
    #[inline]
    pub(crate) fn sample(&self, column: usize, row: usize) -> f64 {
        self.cells
            .get(column, row)
            .map_or(f64::NAN, |h| f32::from_le_bytes(h).into())
    }

    /// World metres of a position in pixel space (sample `(c, r)` lies at `(c + ½, r + ½)`).
    pub(crate) fn pixel_to_world(&self, pixel: DVec2) -> DVec2 {
        self.to_world.at(pixel)
    }

    /// Position in pixel space of world metres.
    pub(crate) fn world_to_pixel(&self, world: DVec2) -> DVec2 {
        self.to_pixel.at(world)
    }

    /// What a step of world metres is in pixel space.
    #[inline]
    pub(crate) fn direction_to_pixel(&self, world: DVec2) -> DVec2 {
        self.to_pixel.column * world.x + self.to_pixel.row * world.y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::Layer;
    use crate::input::layer::load_layer;
    use crate::input::test_data::{TagValue, data, float_tiff};
    use std::fs;
    use std::path::PathBuf;

    fn load(path: &Path, options: HeightOptions) -> Result<HeightMap, InputError> {
        load_layer(path, None, options).map(|layer| layer.map)
    }

    fn height(map: &HeightMap, x: f64, y: f64) -> Option<f64> {
        map.height_at(x, y).unwrap()
    }

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
        let map = load(&path, HeightOptions::default()).unwrap();
        assert_eq!(map.bounds(), (DVec2::ZERO, DVec2::new(3.0, 2.0)));
        assert_eq!(height(&map, 0.5, 0.5), Some(4.0));
        assert_eq!(height(&map, 2.5, 1.5), Some(3.0));
        assert_eq!(height(&map, 1.0, 1.0), Some(3.0));
        assert_eq!(height(&map, 0.0, 0.0), Some(4.0));
        assert_eq!(height(&map, 3.01, 1.0), None);
        assert_eq!(map.min_max(), (1.0, 6.0));
        let options = HeightOptions {
            pixel_size: Some(2.0),
            range: Some((10.0, 75.535)),
            ..Default::default()
        };
        let map = load(&path, options).unwrap();
        assert_eq!(map.bounds().1, DVec2::new(6.0, 4.0));
        close(height(&map, 1.0, 3.0).unwrap(), 10.001, 1e-5);
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
        let map = load(&path, HeightOptions::default()).unwrap();
        assert_eq!(map.bounds(), (DVec2::new(100.0, 200.0), DVec2::new(101.0, 201.0)));
        assert_eq!(height(&map, 100.25, 200.75), Some(-5.0));
        assert_eq!(height(&map, 100.75, 200.75), Some(20.0));
        assert_eq!(
            height(&map, 100.25, 200.25),
            Some(45.0),
            "nodata with weight zero does not count"
        );
        assert_eq!(height(&map, 100.5, 200.5), None, "nodata counts");
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
        let map = load(&path, HeightOptions::default()).unwrap();
        close(map.bounds().0.x, 304.8, 1e-9);
        close(map.bounds().1.y, 609.6, 1e-9);
        let relief = map.relief().unwrap();
        close(relief.sample(0, 0), 30.48, 1e-5);
        let samples = (0..6).map(|k| relief.sample(k % 3, k / 3));
        assert_eq!(samples.filter(|h| h.is_nan()).count(), 4);
        let options = HeightOptions {
            height_unit: Some(HeightUnit::Metres),
            ..Default::default()
        };
        assert_eq!(load(&path, options).unwrap().min_max(), (100.0, 200.0));
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
        assert_eq!(height(&map, 5.5, 6.0), Some(1.5));
        let relief = map.relief().unwrap();
        assert_eq!(
            relief.world_to_pixel(relief.pixel_to_world(DVec2::new(1.25, 0.5))),
            DVec2::new(1.25, 0.5)
        );
    }

    #[test]
    fn faults_are_one_line_naming_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        fs::write(&path, float_tiff(2, 1, &[f32::NAN; 2], Vec::new())).unwrap();
        let none = load(&path, HeightOptions::default()).unwrap_err();
        assert!(matches!(none, InputError::NoHeights { .. }));
        fs::write(&path, float_tiff(2, 2, &[1.0; 3], Vec::new())).unwrap();
        let short = load(&path, HeightOptions::default()).unwrap_err().to_string();
        assert!(short.contains("a.tif") && !short.contains('\n'), "{short}");
        let rgb = dir.path().join("rgb.png");
        image::RgbImage::new(2, 2).save(&rgb).unwrap();
        let bands = load(&rgb, HeightOptions::default()).unwrap_err().to_string();
        assert!(bands.contains("one band"), "{bands}");
        let missing = load(&dir.path().join("none.png"), HeightOptions::default()).unwrap_err();
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
        let Layer { map, imagery } = load_layer(&heights, Some(&image), HeightOptions::default()).unwrap();
        close(map.pixel_size().x, 2.0 * 0.3048, 1e-12);
        close(map.bounds().1.y, 30.48, 1e-9);
        close(f64::from(map.min_max().0), 3.048, 1e-6);
        assert_eq!(imagery.unwrap().place.bounds((4, 4), (0.0, 0.0)), map.bounds());
    }

    #[test]
    fn autzen_is_in_feet() {
        let Some(heights) = data("autzen_lidar_ortho/autzen_dsm_1ft.tif") else {
            return;
        };
        let Some(image) = data("autzen_lidar_ortho/autzen.jpg") else {
            return;
        };
        let Layer { map, imagery } = load_layer(&heights, Some(&image), HeightOptions::default()).unwrap();
        let (min, max) = map.bounds();
        close(max.x - min.x, 990.0, 0.5);
        close(max.y - min.y, 1336.6, 0.5);
        close(f64::from(map.min_max().0), 124.0, 1.0);
        close(f64::from(map.min_max().1), 187.5, 1.0);
        let (imagery_min, _) = imagery.unwrap().place.bounds((map.width, map.height), (0.0, 0.0));
        assert!((imagery_min - min).length() < 1e-3);
    }

    #[test]
    fn sertig_is_in_metres_and_santabarbara_in_degrees() {
        let Some(heights) = data("sertig_valley_ch/sertig_valley.tif") else {
            return;
        };
        let map = load(&heights, HeightOptions::default()).unwrap();
        assert_eq!(map.georef.crs.as_deref(), Some("EPSG:21781"));
        close(map.bounds().1.x - map.bounds().0.x, 6410.0, 1e-6);
        close(f64::from(map.min_max().1), 3002.0, 1.0);
        let Some(degrees) = data("santabarbara/sba_elev32_wgs84_512x512.tif") else {
            return;
        };
        let map = load(&degrees, HeightOptions::default()).unwrap();
        // 512 pixels of 3.03e-5 degrees at 34.4 degrees north; the metre per degree is that of WGS84 there.
        let size = map.pixel_size();
        close(size.x, 3.03e-5 * 91_900.0, 0.01);
        close(size.y, 3.03e-5 * 110_930.0, 0.01);
        let middle = height(&map, 0.0, 0.0).unwrap();
        assert!((2.0..21.0).contains(&middle), "{middle}");
    }
}
