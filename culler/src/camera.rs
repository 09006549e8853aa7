//! The one camera value that culling and drawing share.
//!
//! World metres, Z up, f64. Culling with a camera that is one frame older than the one that draws opens gaps at the
//! picture's edges, so this is a plain value to be passed to both. Pixels are square and the picture's centre is the
//! view axis. The screen is measured in tangents: a point at depth `d` along `forward` and `x` along `right` has the
//! screen coordinate `x / d`. Plain value: any thread.

use glam::{DVec2, DVec3, dvec2, dvec3};
use thiserror::Error;

/// Why a camera cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CameraError {
    /// The eye or the target has a NaN or infinite coordinate, or they are too far apart for f64.
    #[error("camera eye {eye} and target {target} must be finite")]
    NotFinite {
        /// The eye as given.
        eye: DVec3,
        /// The target as given.
        target: DVec3,
    },
    /// Eye and target coincide, so there is no direction to look in.
    #[error("camera eye and target are the same point {0}")]
    NoDirection(DVec3),
    /// The vertical field of view is not between 0 and 180 degrees, or too small for f64.
    #[error("camera field of view must lie between 0 and 180 degrees, not {0}")]
    FieldOfView(f64),
    /// The picture has no pixels.
    #[error("camera picture size must not be zero, but is {width}x{height}")]
    EmptyPicture {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
}

/// A pinhole camera. Make it with [`Camera::look_at`], which is what refuses bad values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Centre of projection, world metres.
    pub eye: DVec3,
    /// Unit view direction.
    pub forward: DVec3,
    /// Unit direction of growing pixel columns.
    pub right: DVec3,
    /// Unit direction of falling pixel rows.
    pub up: DVec3,
    /// Vertical field of view in radians, between 0 and pi.
    pub fov_y: f64,
    /// Picture width in pixels.
    pub width: u32,
    /// Picture height in pixels.
    pub height: u32,
}

/// Below this horizontal share of the view direction its azimuth is rounding noise, and the camera looks straight
/// up or down.
const STRAIGHT: f64 = 1e-10;

impl Camera {
    /// A level camera (`right` is horizontal) at `eye` looking at `target`. Straight up and straight down take +Y,
    /// north, as the up hint instead of +Z: looking down, north is at the top of the picture.
    ///
    /// # Errors
    /// [`CameraError`] for NaN or infinite values, `eye == target`, a field of view outside (0, 180) degrees, or a
    /// picture without pixels.
    pub fn look_at(
        eye: DVec3,
        target: DVec3,
        fov_y_degrees: f64,
        width: u32,
        height: u32,
    ) -> Result<Camera, CameraError> {
        let offset = target - eye;
        if !(eye.is_finite() && target.is_finite() && offset.is_finite()) {
            return Err(CameraError::NotFinite { eye, target });
        }
        let largest = offset.abs().max_element();
        if largest == 0.0 {
            return Err(CameraError::NoDirection(eye));
        }
        let fov_y = fov_y_degrees.to_radians();
        // Written so that NaN fails too; the tangent check catches angles that f64 cannot tell from 0.
        if !(fov_y_degrees > 0.0 && fov_y_degrees < 180.0 && (0.5 * fov_y).tan() > f64::MIN_POSITIVE) {
            return Err(CameraError::FieldOfView(fov_y_degrees));
        }
        if width == 0 || height == 0 {
            return Err(CameraError::EmptyPicture { width, height });
        }
        // Scaled before squaring: offsets of 1e-200 m or 1e200 m are as good as any.
        let forward = (offset / largest).normalize();
        let right = if forward.x.hypot(forward.y) < STRAIGHT {
            forward.cross(DVec3::Y)
        } else {
            dvec3(forward.y, -forward.x, 0.0)
        }
        .normalize();
        let up = right.cross(forward).normalize();
        Ok(Camera {
            eye,
            forward,
            right,
            up,
            fov_y,
            width,
            height,
        })
    }

    /// Screen coordinates, in tangents, of the centre of pixel (`px`, `py`): the pixel's ray is
    /// `forward + x * right + y * up`. Pixel (0, 0) is top left; fractions address points inside a pixel.
    pub fn screen(&self, px: f64, py: f64) -> DVec2 {
        let size = self.pixel_size();
        let x = px + 0.5 - 0.5 * f64::from(self.width);
        let y = 0.5 * f64::from(self.height) - py - 0.5;
        dvec2(x * size, y * size)
    }

    /// Direction of the ray through the centre of pixel (`px`, `py`), not normalised: its depth along `forward` is 1,
    /// so that a ray parameter is a depth in metres.
    pub fn ray(&self, px: f64, py: f64) -> DVec3 {
        let screen = self.screen(px, py);
        self.forward + self.right * screen.x + self.up * screen.y
    }

    /// Size of a pixel in the plane at depth 1, which is a pixel's footprint in metres per metre of depth.
    pub fn pixel_size(&self) -> f64 {
        2.0 * (0.5 * self.fov_y).tan() / f64::from(self.height)
    }

    /// Half the picture's extent in screen coordinates, measured to the outer edges of the border pixels.
    pub fn screen_half_extent(&self) -> DVec2 {
        dvec2(f64::from(self.width), f64::from(self.height)) * (0.5 * self.pixel_size())
    }

    /// Pixel coordinates and depth (metres along `forward`) of a world point, the inverse of [`Camera::ray`];
    /// `None` for points that are not in front of the eye.
    pub fn project(&self, point: DVec3) -> Option<DVec3> {
        let offset = point - self.eye;
        let depth = self.forward.dot(offset);
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let scale = 1.0 / (depth * self.pixel_size());
        let x = self.right.dot(offset) * scale + 0.5 * f64::from(self.width) - 0.5;
        let y = 0.5 * f64::from(self.height) - self.up.dot(offset) * scale - 0.5;
        Some(dvec3(x, y, depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(a: DVec3, b: DVec3, tolerance: f64) -> bool {
        (a - b).abs().max_element() <= tolerance
    }

    #[test]
    fn refuses_what_no_picture_can_be_made_of() {
        let at = |eye, target, fov, w, h| Camera::look_at(eye, target, fov, w, h);
        let (o, x) = (DVec3::ZERO, DVec3::X);
        assert!(matches!(
            at(DVec3::NAN, x, 60.0, 8, 8),
            Err(CameraError::NotFinite { .. })
        ));
        assert!(matches!(
            at(o, x * f64::INFINITY, 60.0, 8, 8),
            Err(CameraError::NotFinite { .. })
        ));
        assert!(matches!(
            at(x * f64::MAX, x * -f64::MAX, 60.0, 8, 8),
            Err(CameraError::NotFinite { .. })
        ));
        assert!(matches!(at(x, x, 60.0, 8, 8), Err(CameraError::NoDirection(_))));
        for fov in [0.0, -1.0, 180.0, 1e9, f64::NAN, f64::INFINITY, 1e-323] {
            assert!(
                matches!(at(o, x, fov, 8, 8), Err(CameraError::FieldOfView(_))),
                "{fov}"
            );
        }
        assert!(matches!(
            at(o, x, 60.0, 0, 8),
            Err(CameraError::EmptyPicture { .. })
        ));
        assert!(matches!(
            at(o, x, 60.0, 8, 0),
            Err(CameraError::EmptyPicture { .. })
        ));
        for fov in [1e-9, 179.9999] {
            assert!(at(o, x, fov, 16384, 1).is_ok(), "{fov}");
        }
    }

    #[test]
    fn level_camera_sees_east_right_when_looking_north() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Y * 7.0, 90.0, 200, 100).unwrap();
        assert!(close(camera.right, DVec3::X, 1e-15) && close(camera.up, DVec3::Z, 1e-15));
        // 90 degrees: the picture's edges are at tangent 1 vertically and, twice as wide, 2 horizontally.
        assert!((camera.pixel_size() - 0.02).abs() < 1e-15);
        assert!((camera.screen_half_extent() - dvec2(2.0, 1.0)).length() < 1e-14);
        assert!((camera.screen(0.0, 0.0) - dvec2(-1.99, 0.99)).length() < 1e-14);
        assert!(close(camera.ray(199.0, 99.0), dvec3(1.99, 1.0, -0.99), 1e-14));
    }

    #[test]
    fn straight_down_and_up_take_north_as_hint() {
        let down = Camera::look_at(dvec3(5.0, 6.0, 100.0), dvec3(5.0, 6.0, 0.0), 60.0, 64, 64).unwrap();
        assert_eq!(
            (down.forward, down.right, down.up),
            (DVec3::NEG_Z, DVec3::X, DVec3::Y)
        );
        let up = Camera::look_at(DVec3::ZERO, DVec3::Z, 60.0, 64, 64).unwrap();
        assert_eq!((up.forward, up.right, up.up), (DVec3::Z, DVec3::NEG_X, DVec3::Y));
    }

    proptest! {
        #[test]
        fn axes_are_orthonormal_and_rays_round_trip(
            eye in prop::array::uniform3(-1e6..1e6f64),
            direction in prop::array::uniform3(-1.0..1.0f64),
            exponent in -3.0..9.0f64,
            fov in 1e-3..179.0f64,
            (width, height) in (1u32..5000, 1u32..5000),
            (u, v, depth) in (0.0..1.0f64, 0.0..1.0f64, 1.0..1e4f64),
        ) {
            let direction = DVec3::from(direction);
            prop_assume!(direction.length() > 1e-3);
            let target = DVec3::from(eye) + direction * 10f64.powf(exponent);
            let camera = Camera::look_at(DVec3::from(eye), target, fov, width, height).unwrap();
            let Camera { forward, right, up, .. } = camera;
            for (a, b) in [(forward, right), (right, up), (up, forward)] {
                prop_assert!(a.dot(b).abs() < 1e-14 && (a.length() - 1.0).abs() < 1e-14);
            }
            prop_assert!(close(right.cross(forward), up, 1e-14), "right-handed");
            prop_assert!(up.z >= 0.0 && right.z.abs() < 1e-14, "level");

            let (px, py) = (u * f64::from(width - 1), v * f64::from(height - 1));
            let ray = camera.ray(px, py);
            prop_assert!((ray.dot(forward) - 1.0).abs() < 1e-9);
            let screen = camera.screen(px, py);
            prop_assert!((ray.dot(right) - screen.x).abs() < 1e-9 * (1.0 + screen.x.abs()));
            prop_assert!((ray.dot(up) - screen.y).abs() < 1e-9 * (1.0 + screen.y.abs()));
            // The next pixel is one pixel size away, and rows grow downwards.
            let step = camera.screen(px + 1.0, py + 1.0) - screen;
            prop_assert!((step - dvec2(1.0, -1.0) * camera.pixel_size()).length() < 1e-9);

            // From the origin, so that the round trip is not limited by the eye's own rounding.
            let local = Camera { eye: DVec3::ZERO, ..camera };
            let seen = local.project(ray * depth).unwrap();
            prop_assert!((seen.z / depth - 1.0).abs() < 1e-9);
            prop_assert!(close(seen, dvec3(px, py, seen.z), 1e-5 / camera.pixel_size().min(1.0)
                * camera.pixel_size().max(1e-3)), "{seen} for {px},{py}");
            prop_assert!(local.project(-ray * depth).is_none());
        }
    }
}
