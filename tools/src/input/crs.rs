//! Coordinate systems as far as they can be related to each other: to longitude and latitude on WGS84 and back.
//!
//! Systems with an EPSG code, or a description in well-known text, as proj4rs (a port of PROJ.4) has them; projections
//! agree with the published examples to millimetres. Shifts between datums are those of three or seven parameters;
//! systems whose datum needs a grid file (NAD27) cannot be related. Any thread.

use std::fmt;

use glam::DVec2;
use proj4rs::Proj;
use proj4rs::transform::transform;

/// Geographic coordinates on WGS84.
const WGS84: &str = "+proj=longlat +datum=WGS84 +no_defs";

/// What a file says about its coordinate system.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct Crs {
    /// `EPSG:code`, or the system's name.
    pub(crate) name: Option<String>,
    /// As a PROJ string, where the file describes the system.
    pub(crate) definition: Option<String>,
    /// Whether coordinates are degrees.
    pub(crate) geographic: bool,
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.name, self.geographic) {
            (Some(name), _) => f.write_str(name),
            (None, true) => f.write_str("degrees"),
            (None, false) => f.write_str("an unnamed system"),
        }
    }
}

impl Crs {
    fn code(&self) -> Option<u16> {
        self.name.as_deref()?.strip_prefix("EPSG:")?.parse().ok()
    }

    /// Whether coordinates of both are taken to be the same. Systems known by name only are, whatever their names:
    /// every program has its own.
    pub(crate) fn same_as(&self, other: &Crs) -> bool {
        self.geographic == other.geographic
            && match (self.code(), other.code()) {
                (Some(a), Some(b)) => a == b,
                _ => true,
            }
    }
}

/// The way between a system's coordinates and degrees.
#[derive(Debug)]
pub(crate) struct Projection {
    system: Proj,
    wgs84: Proj,
}

impl Projection {
    /// # Errors
    /// Why the system cannot be related to others.
    pub(crate) fn new(crs: &Crs) -> Result<Self, String> {
        let described = || match (&crs.definition, crs.geographic) {
            (Some(definition), _) => Proj::from_proj_string(definition).map_err(|e| e.to_string()),
            (None, true) if crs.name.is_none() => Proj::from_proj_string(WGS84).map_err(|e| e.to_string()),
            _ => Err("it has no EPSG code and is not described".to_string()),
        };
        let system = match crs.code() {
            Some(code) => match Proj::from_epsg_code(code) {
                Ok(system) => Ok(system),
                Err(proj4rs::errors::Error::NadGridNotAvailable) => {
                    Err("its datum needs a grid file".to_string())
                }
                Err(e) => described().map_err(|_| e.to_string()),
            },
            None => described(),
        };
        Ok(Self {
            system: system?,
            wgs84: Proj::from_proj_string(WGS84).map_err(|e| e.to_string())?,
        })
    }

    /// Degrees of coordinates; NaN where the system has none.
    pub(crate) fn degrees(&self, at: DVec2) -> DVec2 {
        let at = if self.system.is_latlong() { radians(at) } else { at };
        let p = convert(&self.system, &self.wgs84, at);
        DVec2::new(p.x.to_degrees(), p.y.to_degrees())
    }

    /// Coordinates of degrees; NaN where the system has none.
    pub(crate) fn coordinates(&self, degrees: DVec2) -> DVec2 {
        let p = convert(&self.wgs84, &self.system, radians(degrees));
        if self.system.is_latlong() {
            DVec2::new(p.x.to_degrees(), p.y.to_degrees())
        } else {
            p
        }
    }
}

fn radians(degrees: DVec2) -> DVec2 {
    DVec2::new(degrees.x.to_radians(), degrees.y.to_radians())
}

fn convert(from: &Proj, to: &Proj, at: DVec2) -> DVec2 {
    let mut point = (at.x, at.y, 0.0);
    match transform(from, to, &mut point) {
        Ok(()) => DVec2::new(point.0, point.1),
        Err(_) => DVec2::NAN,
    }
}

/// The PROJ string of well-known text, if its datum is one within metres of WGS84 or says how it is shifted.
pub(crate) fn definition(wkt: &str) -> Option<String> {
    let text = proj4wkt::wkt_to_projstring(wkt).ok()?;
    let modern = [
        "+datum=WGS84",
        "+datum=NAD83",
        "+a=6378137",
        "+ellps=GRS80",
        "+ellps=WGS84",
        "+towgs84",
    ];
    modern.iter().any(|part| text.contains(part)).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dms(degrees: f64, minutes: f64, seconds: f64) -> f64 {
        degrees + minutes / 60.0 + seconds / 3600.0
    }

    fn epsg(code: u16) -> Projection {
        let name = Some(format!("EPSG:{code}"));
        Projection::new(&Crs {
            name,
            ..Crs::default()
        })
        .unwrap()
    }

    fn described(definition: &str) -> Projection {
        let definition = Some(definition.to_string());
        Projection::new(&Crs {
            definition,
            ..Crs::default()
        })
        .unwrap()
    }

    #[track_caller]
    fn holds(projection: &Projection, degrees: DVec2, published: DVec2, tolerance: f64) {
        let p = projection.coordinates(degrees);
        assert!(
            (p - published).abs().max_element() <= tolerance,
            "{p} is not {published}"
        );
        let back = projection.degrees(p);
        assert!(
            (back - degrees).abs().max_element() < 1e-9,
            "{back} is not {degrees}"
        );
    }

    /// Snyder, Map Projections: A Working Manual (USGS 1395), p. 269.
    #[test]
    fn transverse_mercator_as_published() {
        let utm = described("+proj=tmerc +lat_0=0 +lon_0=-75 +k=0.9996 +ellps=clrk66 +towgs84=0,0,0");
        let clarke = Proj::from_proj_string("+proj=longlat +ellps=clrk66").unwrap();
        let p = convert(&clarke, &utm.system, radians(DVec2::new(-73.5, 40.5)));
        assert!(
            (p - DVec2::new(127_106.5, 4_484_124.4)).abs().max_element() < 0.05,
            "{p}"
        );
    }

    /// Zones and hemispheres: the central meridian is at 500 km, the southern equator at 10 000 km; Karney's series
    /// ("Transverse Mercator with an accuracy of a few nanometers", 2011) gives the meridian's quarter k₀ × 10001965.7293 m.
    #[test]
    fn utm_zones() {
        holds(
            &epsg(32633),
            DVec2::new(15.0, 0.0),
            DVec2::new(500_000.0, 0.0),
            1e-6,
        );
        holds(
            &epsg(32733),
            DVec2::new(15.0, 0.0),
            DVec2::new(500_000.0, 1e7),
            1e-6,
        );
        holds(
            &epsg(26910),
            DVec2::new(-123.0, 0.0),
            DVec2::new(500_000.0, 0.0),
            1e-6,
        );
        let pole = epsg(32633).coordinates(DVec2::new(15.0, 89.999_999_999)).y;
        assert!((pole - 0.9996 * 10_001_965.729_3).abs() < 1e-3, "{pole}");
    }

    /// EPSG Guidance Note 7-2: popular visualisation pseudo-Mercator; Lambert conic conformal (2SP) in feet.
    #[test]
    fn other_projections_as_published() {
        let place = DVec2::new(-dms(100.0, 20.0, 0.0), dms(24.0, 22.0, 54.433));
        holds(&epsg(3857), place, DVec2::new(-11_169_055.58, 2_800_000.0), 0.01);
        let lambert = described(
            "+proj=lcc +lat_1=28.38333333333333 +lat_2=30.28333333333333 +lat_0=27.83333333333333 +lon_0=-99 \
             +x_0=609601.2192024384 +y_0=0 +ellps=clrk66 +towgs84=0,0,0 +units=us-ft",
        );
        let clarke = Proj::from_proj_string("+proj=longlat +ellps=clrk66 +towgs84=0,0,0").unwrap();
        let p = convert(&clarke, &lambert.system, radians(DVec2::new(-96.0, 28.5)));
        assert!(
            (p - DVec2::new(2_963_503.91, 254_759.80)).abs().max_element() < 0.02,
            "{p}"
        );
    }

    /// The old observatory of Berne, origin of the Swiss grid (swisstopo): 46°57'03.9" N, 7°26'19.1" E on WGS84.
    #[test]
    fn a_datum_is_shifted() {
        let p = epsg(21781).coordinates(DVec2::new(dms(7.0, 26.0, 19.077), dms(46.0, 57.0, 3.898)));
        assert!((p - DVec2::new(600_000.0, 200_000.0)).length() < 2.0, "{p}");
    }

    #[test]
    fn what_cannot_be_related_says_why() {
        let of = |name: &str| {
            let name = Some(name.to_string());
            Projection::new(&Crs {
                name,
                ..Crs::default()
            })
            .unwrap_err()
        };
        assert!(of("EPSG:26710").contains("grid"));
        assert!(of("my site").contains("EPSG"));
        assert!(!of("EPSG:1").is_empty());
    }

    #[test]
    fn text_describes_modern_datums_only() {
        let utm = |spheroid: &str| {
            format!(
                r#"PROJCS["x",GEOGCS["g",DATUM["d",SPHEROID[{spheroid}]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",0.0],PARAMETER["Central_Meridian",-123.0],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],UNIT["Meter",1.0]]"#
            )
        };
        assert_eq!(
            definition(&utm(r#""Clarke_1866",6378206.4,294.978698213898"#)),
            None
        );
        let text = definition(&utm(r#""GRS_1980",6378137.0,298.257222101"#)).unwrap();
        let place = DVec2::new(-122.3, 44.1);
        let (a, b) = (
            described(&text).coordinates(place),
            epsg(26910).coordinates(place),
        );
        assert!((a - b).length() < 1e-3, "{a} {b}");
    }
}
