//! Where the pixels of a raster lie in the world, and the frame in which several rasters lie together.
//!
//! The [`Frame`] is the projected system of the first height map, as it is; or, where that one is in degrees or
//! geocentric coordinates, the east-north-up frame at the middle of all height maps. A raster in the frame's own system
//! is placed by an affine map. Any other is placed by way of longitude and latitude ([`Warp`]), in three dimensions: where
//! the earth curves away, the height above the ellipsoid is not the world's z.
//!
//! *Pixel space* is as in [`super::georef`]; with the height above the ellipsoid, metres, as third coordinate it is the
//! source's space here. Any thread.

use std::path::Path;
use std::sync::Arc;

use glam::{DMat4, DVec2, DVec3};

use super::crs::{Crs, Projection};
use super::error::InputError;
use super::geodesy::{EastNorthUp, geocentric, geodetic};
use super::georef::{GeoTransform, Placement};

/// Farthest place from the origin of a local frame, degrees: beyond, verticals differ too much from its Z.
const REACH: f64 = 10.0;

/// Of rasters that lie where their own pixels are, which no one asks for a place.
const PIXELS: GeoTransform = GeoTransform {
    origin: DVec2::ZERO,
    column: DVec2::X,
    row: DVec2::Y,
};

/// What world coordinates mean.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Frame {
    /// Coordinates of a projected system (or of files that say nothing about theirs), and metres per unit of them.
    Plane(Crs, f64),
    /// East, north and up from a place on the WGS84 ellipsoid; degrees of the system are taken as they are.
    Local(Crs, EastNorthUp),
}

impl Frame {
    /// The frame of height maps, given with their sizes.
    ///
    /// # Errors
    /// Degrees or geocentric coordinates first and a map that cannot be related to them, or is too far from the others.
    pub(crate) fn of(maps: &[(&Path, &Placement, (u32, u32))]) -> Result<Self, InputError> {
        let Some((_, first, _)) = maps.iter().find(|(_, place, _)| place.is_placed()) else {
            return Ok(Frame::plane(&Placement::default()));
        };
        if !first.crs.geographic && first.geocentric.is_none() {
            return Ok(Frame::plane(first));
        }
        let mut around: Option<(DVec2, DVec2)> = None;
        for (path, place, (w, h)) in maps {
            if !place.is_placed() {
                continue;
            }
            let source = Source::new(path, place, &first.crs)?;
            for corner in [(0, 0), (*w, 0), (0, *h), (*w, *h)] {
                let mut degrees = source.degrees(DVec2::new(corner.0.into(), corner.1.into())).0;
                if let Some((min, _)) = around {
                    degrees.x = near(degrees.x, min.x);
                }
                let (min, max) = around.unwrap_or((degrees, degrees));
                around = Some((min.min(degrees), max.max(degrees)));
                if !degrees.is_finite() || degrees.y.abs() > 90.001 || (max - min).max_element() > 2.0 * REACH
                {
                    return Err(InputError::georef(
                        path,
                        format!(
                            "degrees are placed up to {REACH}° around the middle of all height maps; this is at {degrees}"
                        ),
                    ));
                }
            }
        }
        let (min, max) = around.unwrap_or_default();
        // So that what is told of the frame is exact.
        let origin = ((min + max) * 0.5 * 1e6).round() / 1e6;
        Ok(Frame::Local(first.crs.clone(), EastNorthUp::new(origin)))
    }

    fn plane(place: &Placement) -> Self {
        Frame::Plane(place.crs.clone(), place.linear_unit.unwrap_or(1.0))
    }

    /// The system's name, or the frame as a PROJ string.
    pub(crate) fn name(&self) -> Option<String> {
        match self {
            Frame::Plane(crs, _) => crs.name.clone(),
            Frame::Local(_, local) => Some(format!(
                "+proj=topocentric +ellps=WGS84 +lon_0={} +lat_0={} +h_0=0",
                local.origin.x, local.origin.y
            )),
        }
    }
}

/// A longitude, turned to within half a circle of another.
fn near(longitude: f64, other: f64) -> f64 {
    longitude - ((longitude - other) / 360.0).round() * 360.0
}

/// Between source space and the world.
#[derive(Debug, Clone)]
pub(crate) enum Place {
    Affine {
        to_world: GeoTransform,
        to_pixel: GeoTransform,
    },
    Warped(Arc<Warp>),
}

/// Between source space and another system's world.
#[derive(Debug)]
pub(crate) struct Warp {
    source: Source,
    world: World,
}

#[derive(Debug)]
enum World {
    Plane(Box<Projection>, f64),
    Local(EastNorthUp),
}

/// Between source space and degrees.
#[derive(Debug)]
struct Source {
    to_coordinates: GeoTransform,
    to_pixel: GeoTransform,
    /// Coordinates that are neither of these are degrees on WGS84.
    projection: Option<Projection>,
    /// Source space (column, row, height) to geocentric metres, and back.
    geocentric: Option<(DMat4, DMat4)>,
    /// A longitude in the raster.
    longitude: f64,
}

impl Source {
    /// Degrees in the system `first` are taken as they are.
    fn new(path: &Path, place: &Placement, first: &Crs) -> Result<Self, InputError> {
        let matrix = place.geocentric.map(|m| (m, m.inverse()));
        let transform = place.transform.unwrap_or(PIXELS);
        let as_degrees = place.crs.geographic && (place.crs.name.is_none() || place.crs.name == first.name);
        let projection = if matrix.is_some() || as_degrees {
            None
        } else {
            let projection = Projection::new(&place.crs);
            Some(projection.map_err(|why| cannot_relate(path, &place.crs, first, &place.crs, &why))?)
        };
        let mut source = Self {
            to_coordinates: transform,
            to_pixel: transform
                .inverse()
                .ok_or_else(|| InputError::georef(path, "the pixel size is zero"))?,
            projection,
            geocentric: matrix,
            longitude: 0.0,
        };
        source.longitude = source.degrees(DVec2::ZERO).0.x;
        Ok(source)
    }

    /// Longitude and latitude of a pixel position, and its place at height 0.
    fn degrees(&self, pixel: DVec2) -> (DVec2, f64) {
        if let Some((to_geocentric, _)) = &self.geocentric {
            return geodetic(to_geocentric.transform_point3(pixel.extend(0.0)));
        }
        let at = self.to_coordinates.at(pixel);
        (self.projection.as_ref().map_or(at, |p| p.degrees(at)), 0.0)
    }

    /// Geocentric metres of a position in source space.
    fn geocentric(&self, at: DVec3) -> DVec3 {
        match &self.geocentric {
            Some((to_geocentric, _)) => to_geocentric.transform_point3(at),
            None => geocentric(self.degrees(at.truncate()).0, at.z),
        }
    }

    /// The position in source space of degrees and a height.
    fn of_degrees(&self, degrees: DVec2, height: f64) -> DVec3 {
        if self.geocentric.is_some() {
            return self.of_geocentric(geocentric(degrees, height));
        }
        let at = match &self.projection {
            Some(projection) => projection.coordinates(degrees),
            None => DVec2::new(near(degrees.x, self.longitude), degrees.y),
        };
        self.to_pixel.at(at).extend(height)
    }

    /// The position in source space of geocentric metres.
    fn of_geocentric(&self, p: DVec3) -> DVec3 {
        match &self.geocentric {
            Some((_, to_pixel)) => to_pixel.transform_point3(p),
            None => {
                let (degrees, height) = geodetic(p);
                self.of_degrees(degrees, height)
            }
        }
    }
}

impl Warp {
    /// The position in source space of a point of the world; NaN where there is none.
    fn pixel(&self, world: DVec3) -> DVec3 {
        match &self.world {
            World::Local(frame) => self.source.of_geocentric(frame.to_geocentric(world)),
            World::Plane(projection, unit) => {
                let degrees = projection.degrees(world.truncate() / *unit);
                self.source.of_degrees(degrees, world.z)
            }
        }
    }

    fn world(&self, at: DVec3) -> DVec3 {
        match &self.world {
            World::Local(frame) => frame.to_local(self.source.geocentric(at)),
            World::Plane(projection, unit) => {
                let (degrees, height) = match &self.source.geocentric {
                    Some((to_geocentric, _)) => geodetic(to_geocentric.transform_point3(at)),
                    None => (self.source.degrees(at.truncate()).0, at.z),
                };
                (projection.coordinates(degrees) * *unit).extend(height)
            }
        }
    }
}

impl Place {
    /// Of an affine map to world metres.
    pub(crate) fn affine(path: &Path, to_world: GeoTransform) -> Result<Self, InputError> {
        let to_world = to_world.checked(path)?;
        let to_pixel = to_world
            .inverse()
            .ok_or_else(|| InputError::georef(path, "the pixel size is zero"))?;
        Ok(Place::Affine { to_world, to_pixel })
    }

    /// Of a raster in a frame. `place` has a transform.
    ///
    /// # Errors
    /// A system that cannot be related to the frame's.
    pub(crate) fn new(path: &Path, place: &Placement, frame: &Frame) -> Result<Self, InputError> {
        let (world, crs) = match frame {
            Frame::Plane(crs, unit) if place.geocentric.is_none() && place.crs.same_as(crs) => {
                let transform = place.transform.unwrap_or(PIXELS);
                return Place::affine(path, transform.scaled(place.linear_unit.unwrap_or(*unit)));
            }
            Frame::Plane(crs, unit) => {
                let projection =
                    Projection::new(crs).map_err(|why| cannot_relate(path, &place.crs, crs, crs, &why))?;
                (World::Plane(Box::new(projection), *unit), crs)
            }
            Frame::Local(crs, local) => (World::Local(*local), crs),
        };
        let source = Source::new(path, place, crs)?;
        Ok(Place::Warped(Arc::new(Warp { source, world })))
    }

    /// The position in source space of a point of the world, metres; NaN where there is none.
    #[inline]
    pub(crate) fn pixel(&self, world: DVec3) -> DVec3 {
        match self {
            Place::Affine { to_pixel, .. } => to_pixel.at(world.truncate()).extend(world.z),
            Place::Warped(warp) => warp.pixel(world),
        }
    }

    /// The world's point of a position in source space; NaN where there is none.
    pub(crate) fn world(&self, at: DVec3) -> DVec3 {
        match self {
            Place::Affine { to_world, .. } => to_world.at(at.truncate()).extend(at.z),
            Place::Warped(warp) => warp.world(at),
        }
    }

    /// Whether the height is z, and column and row are the same all along a vertical.
    pub(crate) fn is_level(&self) -> bool {
        match self {
            Place::Affine { .. } => true,
            Place::Warped(warp) => matches!(warp.world, World::Plane(..)) && warp.source.geocentric.is_none(),
        }
    }

    /// A box around the outer pixel edges at a range of heights, world metres: exact if the map is affine, and a
    /// little too large else.
    pub(crate) fn bounds(&self, size: (u32, u32), heights: (f32, f32)) -> (DVec2, DVec2) {
        const STEPS: u32 = 16;
        if let Place::Affine { to_world, .. } = self {
            return to_world.bounds(size);
        }
        let part = |k: u32, size: u32| f64::from(k) / f64::from(STEPS) * f64::from(size);
        let points = (0..=STEPS).flat_map(|j| (0..=STEPS).map(move |i| (part(i, size.0), part(j, size.1))));
        let (min, max) = points
            .flat_map(|(u, v)| {
                [heights.0, heights.1].map(|h| self.world(DVec3::new(u, v, h.into())).truncate())
            })
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(min, max), p| {
                (min.min(p), max.max(p))
            });
        // Between the points that were looked at, edges bulge.
        let margin = (max - min).max_element() / f64::from(STEPS);
        (min - margin, max + margin)
    }

    /// Lengths in metres of a step to the next column and to the next row, in the middle of the raster.
    pub(crate) fn pixel_size(&self, size: (u32, u32)) -> DVec2 {
        let middle = DVec3::new(f64::from(size.0), f64::from(size.1), 0.0) * 0.5;
        let step = |d: DVec3| {
            (self.world(middle + d) - self.world(middle - d))
                .truncate()
                .length()
        };
        DVec2::new(step(DVec3::X * 0.5), step(DVec3::Y * 0.5))
    }
}

fn cannot_relate(path: &Path, own: &Crs, other: &Crs, fault: &Crs, why: &str) -> InputError {
    InputError::Mismatch {
        path: path.to_path_buf(),
        what: format!(
            "the file is in {own} and the terrain in {other}, and {fault} cannot be related to other systems ({why}); \
             project one of them"
        ),
    }
}
