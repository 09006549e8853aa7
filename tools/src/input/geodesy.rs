//! The WGS84 ellipsoid: geodetic, geocentric and local east-north-up coordinates.
//!
//! Angles are degrees here, longitude first; heights are metres above the ellipsoid. From geocentric to geodetic
//! coordinates by Bowring's formula ("Transformation from spatial to geographical coordinates", Survey Review 23, 1976)
//! with one step of Newton's method behind it: within 1e-9 degrees (0.1 mm) from 10 km below the ellipsoid to 10 000 km
//! above it. Any thread.

use glam::{DMat3, DVec2, DVec3};

/// Semi-major axis, metres.
pub(crate) const AXIS: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Square of the first eccentricity.
const E2: f64 = FLATTENING * (2.0 - FLATTENING);

/// Radius of curvature in the prime vertical.
fn normal_radius(sine: f64) -> f64 {
    AXIS / (1.0 - E2 * sine * sine).sqrt()
}

/// Geocentric metres of longitude and latitude at a height.
pub(crate) fn geocentric(place: DVec2, height: f64) -> DVec3 {
    let (sin_lon, cos_lon) = place.x.to_radians().sin_cos();
    let (sine, cosine) = place.y.to_radians().sin_cos();
    let n = normal_radius(sine);
    let r = (n + height) * cosine;
    DVec3::new(r * cos_lon, r * sin_lon, (n * (1.0 - E2) + height) * sine)
}

/// Longitude, latitude and height of geocentric metres.
pub(crate) fn geodetic(p: DVec3) -> (DVec2, f64) {
    let r = p.x.hypot(p.y);
    let b = AXIS * (1.0 - FLATTENING);
    let (s, c) = (p.z * AXIS).atan2(r * b).sin_cos();
    let start = (p.z + E2 / (1.0 - E2) * b * s.powi(3)).atan2(r - E2 * AXIS * c.powi(3));
    // Newton's method on the foot of the normal: r·tan φ = z + e²·N·sin φ.
    let sine = start.sin();
    let latitude = (p.z + E2 * normal_radius(sine) * sine).atan2(r);
    let (sine, cosine) = latitude.sin_cos();
    // The form that cancels neither at the poles nor at the equator.
    let height = r * cosine + p.z * sine - AXIS * (1.0 - E2 * sine * sine).sqrt();
    (
        DVec2::new(p.y.atan2(p.x).to_degrees(), latitude.to_degrees()),
        height,
    )
}

/// A right-handed frame tangent to the ellipsoid: X east, Y north, Z up, metres, with its origin on the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EastNorthUp {
    /// Longitude and latitude of the origin.
    pub(crate) origin: DVec2,
    centre: DVec3,
    /// Columns are east, north and up.
    axes: DMat3,
}

impl EastNorthUp {
    pub(crate) fn new(origin: DVec2) -> Self {
        let (sin_lon, cos_lon) = origin.x.to_radians().sin_cos();
        let (sine, cosine) = origin.y.to_radians().sin_cos();
        Self {
            origin,
            centre: geocentric(origin, 0.0),
            axes: DMat3::from_cols(
                DVec3::new(-sin_lon, cos_lon, 0.0),
                DVec3::new(-sine * cos_lon, -sine * sin_lon, cosine),
                DVec3::new(cosine * cos_lon, cosine * sin_lon, sine),
            ),
        }
    }

    /// Geocentric metres of a point of the frame.
    pub(crate) fn to_geocentric(self, local: DVec3) -> DVec3 {
        self.centre + self.axes * local
    }

    /// The point of the frame of geocentric metres.
    pub(crate) fn to_local(self, p: DVec3) -> DVec3 {
        self.axes.transpose() * (p - self.centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn dms(degrees: f64, minutes: f64, seconds: f64) -> f64 {
        degrees + minutes / 60.0 + seconds / 3600.0
    }

    /// EPSG Guidance Note 7-2, 4.1.1 (geographic to geocentric) and 4.1.2 (topocentric).
    #[test]
    fn published_values() {
        let place = DVec2::new(dms(2.0, 7.0, 46.380), dms(53.0, 48.0, 33.820));
        let p = geocentric(place, 73.0);
        let published = DVec3::new(3_771_793.968, 140_253.342, 5_124_304.349);
        assert!((p - published).abs().max_element() < 6e-4, "{p}");
        let (back, height) = geodetic(published);
        assert!(
            (back - place).abs().max_element() < 1e-8 && (height - 73.0).abs() < 1e-3,
            "{back} {height}"
        );
        // The topocentric example has its origin at a height of 200 m, which only moves Z.
        let frame = EastNorthUp::new(DVec2::new(5.0, 55.0));
        let local = frame.to_local(p) - DVec3::new(0.0, 0.0, 200.0);
        let published = DVec3::new(-189_013.869, -128_642.040, -4_220.171);
        assert!((local - published).abs().max_element() < 2e-3, "{local}");
    }

    proptest! {
        #[test]
        fn there_and_back(lon in -180.0f64..180.0, lat in -90.0f64..90.0, height in -1e4f64..1e7) {
            let (place, h) = geodetic(geocentric(DVec2::new(lon, lat), height));
            prop_assert!((place.y - lat).abs() < 1e-9, "{place} {lat}");
            prop_assert!((place.x - lon).abs() * lat.to_radians().cos() < 1e-9, "{place} {lon}");
            prop_assert!((h - height).abs() < 1e-7, "{h} {height}");
            let frame = EastNorthUp::new(DVec2::new(lat, lon * 0.5));
            let p = DVec3::new(lon * 1e3, lat * 1e3, height);
            prop_assert!((frame.to_local(frame.to_geocentric(p)) - p).length() < 1e-6);
        }
    }
}
