//! Where the pixels of a file lie in the world: affine transforms, coordinate systems, units.
//!
//! Pixel space: column to the right, row down; (0, 0) is the outer corner of the top-left pixel, its centre is
//! (½, ½). Whatever a source of georeference calls a pixel (its corner or its centre) is converted to that here.
//! Sources in order: GDAL side file, the file's own tags, world file (with a `.prj` beside it).

use std::fs;
use std::path::Path;

use glam::{DMat4, DVec2, DVec3};

use super::crs::Crs;
use super::error::InputError;
use super::image_file::Kind;
use super::{ascii_grid, geokeys, hgt, pam, tiff_file, usgs_dem, wkt, world_file};

/// An affine map from pixel space to coordinates: `origin + column · c + row · r`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeoTransform {
    /// Coordinates of pixel-space (0, 0).
    pub origin: DVec2,
    /// Step from one column to the next.
    pub column: DVec2,
    /// Step from one row to the next (its y is negative where row 0 is north).
    pub row: DVec2,
}

impl GeoTransform {
    /// North-up pixels of `size` with the lower-left outer corner of `rows` rows at `corner`.
    pub fn north_up(corner: DVec2, size: f64, rows: u32) -> Self {
        GeoTransform {
            origin: corner + DVec2::new(0.0, size * f64::from(rows)),
            column: DVec2::new(size, 0.0),
            row: DVec2::new(0.0, -size),
        }
    }

    /// Coordinates of a position in pixel space.
    #[inline]
    pub fn at(&self, pixel: DVec2) -> DVec2 {
        self.origin + self.column * pixel.x + self.row * pixel.y
    }

    /// Signed area of a pixel.
    pub fn determinant(&self) -> f64 {
        self.column.perp_dot(self.row)
    }

    /// The map back, from coordinates to pixel space, as the same kind of transform. `None` if pixels have no area.
    pub fn inverse(&self) -> Option<GeoTransform> {
        let determinant = self.determinant();
        if !determinant.is_finite() || determinant == 0.0 {
            return None;
        }
        let column = DVec2::new(self.row.y, -self.column.y) / determinant;
        let row = DVec2::new(-self.row.x, self.column.x) / determinant;
        let inverse = GeoTransform {
            origin: DVec2::ZERO,
            column,
            row,
        };
        Some(GeoTransform {
            origin: -inverse.at(self.origin),
            column,
            row,
        })
    }

    /// The same pixels with coordinates multiplied by `unit`.
    pub fn scaled(&self, unit: f64) -> Self {
        GeoTransform {
            origin: self.origin * unit,
            column: self.column * unit,
            row: self.row * unit,
        }
    }

    /// The transform of another raster of `to` pixels (columns, rows) over the extent of this one's `from` pixels.
    pub fn resized(&self, from: (u32, u32), to: (u32, u32)) -> Self {
        GeoTransform {
            origin: self.origin,
            column: self.column * (f64::from(from.0) / f64::from(to.0)),
            row: self.row * (f64::from(from.1) / f64::from(to.1)),
        }
    }

    /// Smallest box around `size` pixels (columns, rows): least and greatest coordinates of the outer edges.
    pub fn bounds(&self, size: (u32, u32)) -> (DVec2, DVec2) {
        let (w, h) = (f64::from(size.0), f64::from(size.1));
        let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(x, y)| self.at(DVec2::new(x, y)));
        let min = corners.iter().fold(corners[0], |m, c| m.min(*c));
        let max = corners.iter().fold(corners[0], |m, c| m.max(*c));
        (min, max)
    }

    /// Refuses numbers that are not finite and pixels without area; `path` is the file they come from.
    pub(crate) fn checked(self, path: &Path) -> Result<Self, InputError> {
        if !(self.origin.is_finite() && self.column.is_finite() && self.row.is_finite()) {
            return Err(InputError::georef(
                path,
                "the transform has a number that is not finite",
            ));
        }
        match self.inverse() {
            Some(_) => Ok(self),
            None => Err(InputError::georef(path, "the pixel size is zero")),
        }
    }
}

/// Where a raster lies: its transform, the coordinate system and its units.
#[derive(Debug, Clone, PartialEq)]
pub struct Georef {
    /// Pixel space to coordinates of the system, in its own unit.
    pub transform: GeoTransform,
    /// `EPSG:code`, or the system's name, if known.
    pub crs: Option<String>,
    /// Metres per unit of the coordinates.
    pub linear_unit_metres: f64,
    /// Metres per unit of the heights, if the file says so.
    pub vertical_unit_metres: Option<f64>,
    /// Whether the coordinates are degrees.
    pub geographic: bool,
}

impl Georef {
    /// Of a raster that lies on its own pixels, 1 m each, with the lower-left outer corner in the origin.
    pub(crate) fn pixels(rows: u32) -> Self {
        Georef {
            transform: GeoTransform::north_up(DVec2::ZERO, 1.0, rows),
            crs: None,
            linear_unit_metres: 1.0,
            vertical_unit_metres: None,
            geographic: false,
        }
    }

    /// Pixel space to world metres.
    pub fn to_world(&self) -> GeoTransform {
        self.transform.scaled(self.linear_unit_metres)
    }
}

/// What the sources of georeference of one file say, each of them possibly nothing.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct Placement {
    pub(crate) transform: Option<GeoTransform>,
    /// Pixel space and height to geocentric metres, instead of a transform.
    pub(crate) geocentric: Option<DMat4>,
    pub(crate) crs: Crs,
    pub(crate) linear_unit: Option<f64>,
    pub(crate) vertical_unit: Option<f64>,
    pub(crate) nodata: Option<f64>,
    pub(crate) scale: Option<f64>,
    pub(crate) offset: Option<f64>,
}

impl Placement {
    pub(crate) fn set_crs(&mut self, system: wkt::System) {
        self.crs = system.crs;
        self.linear_unit = system.linear_unit;
        self.vertical_unit = system.vertical_unit;
    }

    /// Whether it says where pixels lie.
    pub(crate) fn is_placed(&self) -> bool {
        self.transform.is_some() || self.geocentric.is_some()
    }

    /// The same extent divided into other pixels: columns and rows before and after.
    pub(crate) fn resized(&self, from: (u32, u32), to: (u32, u32)) -> Self {
        let scale = DVec3::new(
            f64::from(from.0) / f64::from(to.0),
            f64::from(from.1) / f64::from(to.1),
            1.0,
        );
        Placement {
            transform: self.transform.map(|t| t.resized(from, to)),
            geocentric: self.geocentric.map(|m| m * DMat4::from_scale(scale)),
            crs: self.crs.clone(),
            linear_unit: self.linear_unit,
            ..Placement::default()
        }
    }

    /// What is missing of a picture's placement taken from the ground's below it; sizes are columns and rows.
    pub(crate) fn over(mut self, ground: &Placement, ground_size: (u32, u32), size: (u32, u32)) -> Self {
        if !self.is_placed() {
            return ground.resized(ground_size, size);
        }
        if !self.has_system() {
            self.linear_unit = ground.linear_unit;
            self.crs = ground.crs.clone();
        }
        self
    }

    /// Whether it says in which system.
    pub(crate) fn has_system(&self) -> bool {
        self.crs != Crs::default() || self.linear_unit.is_some() || self.geocentric.is_some()
    }

    /// Fills what is missing here from a source of less weight.
    pub(crate) fn or(mut self, other: Placement) -> Placement {
        if !self.has_system() {
            self.crs = other.crs;
            self.linear_unit = other.linear_unit;
        } else {
            if self.linear_unit.is_none() && self.crs == other.crs {
                self.linear_unit = other.linear_unit;
            }
            if self.crs.name.is_none() || self.crs.name == other.crs.name {
                self.crs.definition = self.crs.definition.or(other.crs.definition);
            }
        }
        if !self.is_placed() {
            self.geocentric = other.geocentric;
        }
        self.transform = self.transform.or(other.transform);
        self.vertical_unit = self.vertical_unit.or(other.vertical_unit);
        self.nodata = self.nodata.or(other.nodata);
        self.scale = self.scale.or(other.scale);
        self.offset = self.offset.or(other.offset);
        self
    }

    /// Takes coordinates of no stated system for degrees where nothing else is likely: all of them are longitudes and
    /// latitudes, and pixels are smaller than a hundredth. Says whether it did.
    pub(crate) fn guess_degrees(&mut self, size: (u32, u32)) -> bool {
        let Some(transform) = self.transform.filter(|_| !self.has_system()) else {
            return false;
        };
        let (min, max) = transform.bounds(size);
        let on_earth = min.cmpge(DVec2::new(-180.5, -90.5)).all() && max.cmple(DVec2::new(360.5, 90.5)).all();
        self.crs.geographic = on_earth && transform.column.length().max(transform.row.length()) < 0.01;
        self.crs.geographic
    }

    /// The georeference, in a system without a stated unit taken as metres. `None` without a transform.
    pub(crate) fn georef(&self) -> Option<Georef> {
        self.transform.map(|transform| Georef {
            transform,
            crs: self.crs.name.clone(),
            linear_unit_metres: self.linear_unit.unwrap_or(1.0),
            vertical_unit_metres: self.vertical_unit,
            geographic: self.crs.geographic,
        })
    }
}

/// Everything that the file, its side file and its world file say about where the pixels lie.
///
/// # Errors
/// Sources that are there but damaged.
pub(crate) fn read(path: &Path) -> Result<Placement, InputError> {
    let mut placement = pam::read_beside(path)?;
    placement = placement.or(match Kind::of(path)? {
        Kind::Tiff => geokeys::placement(path, &tiff_file::read_tags(path)?)?,
        Kind::Ascii => ascii_grid::Header::read(path)?.placement(),
        Kind::Hgt => hgt::placement(path)?,
        Kind::UsgsDem => usgs_dem::Header::read(path)?.placement(path)?,
        Kind::Picture => Placement::default(),
    });
    let mut beside = read_prj(path)?;
    if !placement.is_placed() {
        beside.transform = world_file::read_beside(path)?;
    }
    Ok(placement.or(beside))
}

/// The coordinate system from the `.prj` file that often goes with a world file.
fn read_prj(image: &Path) -> Result<Placement, InputError> {
    let mut placement = Placement::default();
    let path = image.with_extension("prj");
    if let Ok(bytes) = fs::read(&path) {
        placement
            .set_crs(wkt::parse(&String::from_utf8_lossy(&bytes)).map_err(|e| InputError::georef(&path, e))?);
    }
    Ok(placement)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotated_transform_inverts() {
        let transform = GeoTransform {
            origin: DVec2::new(2.6e6, 1.2e6),
            column: DVec2::new(0.3, 0.4),
            row: DVec2::new(0.5, -0.25),
        };
        let pixel = DVec2::new(123.25, 4567.5);
        let back = transform.inverse().unwrap().at(transform.at(pixel));
        assert!((back - pixel).length() < 1e-6, "{back}");
        let flat = GeoTransform {
            row: transform.column,
            ..transform
        };
        assert!(flat.inverse().is_none());
        assert!(flat.checked(Path::new("a")).is_err());
    }

    #[test]
    fn north_up_bounds() {
        let transform = GeoTransform::north_up(DVec2::new(10.0, 20.0), 2.0, 5);
        assert_eq!(
            transform.bounds((3, 5)),
            (DVec2::new(10.0, 20.0), DVec2::new(16.0, 30.0))
        );
        assert_eq!(transform.at(DVec2::ZERO).y, 30.0);
        assert_eq!(
            transform.resized((3, 5), (6, 10)).bounds((6, 10)),
            transform.bounds((3, 5))
        );
    }

    #[test]
    fn only_fine_pixels_on_the_earth_are_taken_for_degrees() {
        let degrees = |corner: DVec2, size: f64, unit: Option<f64>| {
            let mut placement = Placement {
                transform: Some(GeoTransform::north_up(corner, size, 100)),
                linear_unit: unit,
                ..Placement::default()
            };
            placement.guess_degrees((100, 100))
        };
        assert!(degrees(DVec2::new(-119.8, 34.4), 3.03e-5, None));
        assert!(!degrees(DVec2::new(-119.8, 34.4), 3.03e-5, Some(1.0)));
        assert!(!degrees(DVec2::new(0.0, 0.0), 0.1, None), "a site of 10 m");
        assert!(!degrees(DVec2::new(557_805.0, 5_107_965.0), 0.005, None));
    }

    #[test]
    fn side_file_comes_before_world_file_and_prj_gives_the_unit() {
        let dir = tempfile::tempdir().unwrap();
        let image = dir.path().join("a.png");
        image::GrayImage::new(2, 2).save(&image).unwrap();
        fs::write(dir.path().join("a.pgw"), "1\n0\n0\n-1\n0.5\n1.5\n").unwrap();
        fs::write(dir.path().join("a.prj"), "PROJCS[\"p\",UNIT[\"foot\",0.3048]]").unwrap();
        let placement = read(&image).unwrap();
        assert_eq!(
            placement.georef().unwrap().to_world().bounds((2, 2)).1,
            DVec2::splat(2.0 * 0.3048)
        );
        fs::write(
            dir.path().join("a.png.aux.xml"),
            "<PAMDataset><GeoTransform>0,5,0,10,0,-5</GeoTransform></PAMDataset>",
        )
        .unwrap();
        let georef = read(&image).unwrap().georef().unwrap();
        assert_eq!(georef.transform.column.x, 5.0);
        assert_eq!(georef.crs.as_deref(), Some("p"));
        fs::write(
            dir.path().join("a.prj"),
            "GEOGCS[\"WGS 84\",UNIT[\"degree\",0.01745]]",
        )
        .unwrap();
        let placement = read(&image).unwrap();
        assert!(placement.crs.geographic && placement.linear_unit.is_none());
    }
}
