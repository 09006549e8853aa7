//! Helpers of the tests: a seeded generator, random cameras, and geometry written a second, independent way.

pub(crate) mod scenes;

use crate::bounds::Aabb;
use crate::camera::Camera;
use glam::{DVec3, dvec3};

/// SplitMix64: the same numbers on every machine.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `[0, 1)`.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `0..count`.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    /// Uniform in the cube of half edge `reach`.
    pub(crate) fn point(&mut self, reach: f64) -> DVec3 {
        dvec3(
            self.unit() * 2.0 - 1.0,
            self.unit() * 2.0 - 1.0,
            self.unit() * 2.0 - 1.0,
        ) * reach
    }

    /// Edge lengths between the two, each axis on its own.
    pub(crate) fn size(&mut self, least: f64, greatest: f64) -> DVec3 {
        let spread = greatest - least;
        dvec3(self.unit() * spread, self.unit() * spread, self.unit() * spread) + least
    }

    /// A direction with no zero component.
    pub(crate) fn direction(&mut self) -> DVec3 {
        loop {
            let d = self.point(1.0);
            if d.length() < 1.0 && d.abs().min_element() > 1e-6 {
                return d.normalize();
            }
        }
    }
}

/// A camera in the cube of half edge `reach`, now and then along an axis, with any field of view and shape.
pub(crate) fn random_camera(random: &mut Random, reach: f64) -> Camera {
    let eye = random.point(reach);
    let direction = if random.below(8) == 0 {
        [
            DVec3::X,
            DVec3::NEG_X,
            DVec3::Y,
            DVec3::NEG_Y,
            DVec3::Z,
            DVec3::NEG_Z,
        ][random.below(6)]
    } else {
        random.direction()
    };
    let fov = 5.0 + 120.0 * random.unit();
    let (width, height) = (1 + random.below(2000) as u32, 1 + random.below(2000) as u32);
    Camera::look_at(eye, eye + direction * 10.0, fov, width, height).unwrap()
}

/// Whether box and view pyramid meet, by clipping each face of the box to the four sides of the pyramid.
pub(crate) fn box_meets_pyramid(bounds: &Aabb, camera: &Camera) -> bool {
    if bounds.contains(camera.eye) {
        return true;
    }
    let half = camera.screen_half_extent();
    let inside = |p: &DVec3, side: usize| {
        let o = *p - camera.eye;
        let (x, y, z) = (camera.right.dot(o), camera.up.dot(o), camera.forward.dot(o));
        [half.x * z - x, half.x * z + x, half.y * z - y, half.y * z + y][side]
    };
    (0..6).any(|face| {
        let (axis, upper) = (face % 3, face / 3 == 1);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |a: f64, b: f64| {
            let mut p = DVec3::ZERO;
            p[axis] = if upper { bounds.max[axis] } else { bounds.min[axis] };
            p[u] = a;
            p[v] = b;
            p
        };
        let mut polygon = vec![
            corner(bounds.min[u], bounds.min[v]),
            corner(bounds.max[u], bounds.min[v]),
            corner(bounds.max[u], bounds.max[v]),
            corner(bounds.min[u], bounds.max[v]),
        ];
        for side in 0..4 {
            let mut clipped = Vec::new();
            for (i, p) in polygon.iter().enumerate() {
                let q = &polygon[(i + 1) % polygon.len()];
                let (a, b) = (inside(p, side), inside(q, side));
                if a >= 0.0 {
                    clipped.push(*p);
                }
                if (a >= 0.0) != (b >= 0.0) {
                    clipped.push(p.lerp(*q, a / (a - b)));
                }
            }
            polygon = clipped;
        }
        !polygon.is_empty()
    })
}

/// The stretch `[enter, leave]` of ray parameters, from 0 on, that lies in the half-open box, if it has a length.
pub(crate) fn ray_span(bounds: &Aabb, eye: DVec3, direction: DVec3) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - eye[axis], bounds.max[axis] - eye[axis]);
        let d = direction[axis];
        if d == 0.0 {
            if low > 0.0 || high <= 0.0 {
                return None;
            }
        } else {
            let (a, b) = (low / d, high / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    (leave > enter).then_some((enter, leave))
}
