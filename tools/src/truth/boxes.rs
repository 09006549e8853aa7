//! A bounding volume hierarchy in f32 around primitives that are met in f64.
//!
//! Boxes are relative to the middle of the scene and widened by more than f32 can err over its extent, and a ray starts
//! where it enters the scene: so no primitive is missed, however far the scene is from the world's origin and the eye
//! from the scene. What is met exactly, and where, is the caller's to say. Any thread.

use glam::{DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ray::{Ray, RayHit};
use std::time::Duration;

/// Boxes are widened by this part of the scene's extent. Rounding errs by some 2⁻²² of it, and the hierarchy takes
/// components of directions below 2⁻²³ for that.
const WIDENED: f64 = 1.0 / (1 << 20) as f64;

/// A hierarchy of boxes.
pub(super) struct Boxes {
    bvh: Bvh2,
    /// World place of the hierarchy's origin.
    origin: DVec3,
    /// The scene, relative to it.
    bounds: (DVec3, DVec3),
    /// What boxes were widened by, metres.
    pad: f64,
}

impl Boxes {
    /// Over boxes given by least and greatest corners, world metres; `None` without any.
    pub(super) fn new(boxes: &[(DVec3, DVec3)]) -> Option<Self> {
        let (min, max) = boxes
            .iter()
            .copied()
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        let origin = (min + max) * 0.5;
        let pad = ((max - min).max_element() * WIDENED).max(f64::from(f32::MIN_POSITIVE));
        let single = |p: DVec3| Vec3A::from(p.as_vec3());
        let boxes: Vec<Aabb> = boxes
            .iter()
            .map(|(lo, hi)| Aabb::new(single(*lo - origin - pad), single(*hi - origin + pad)))
            .collect();
        let bvh = build_bvh2(&boxes, BvhBuildParams::fast_build(), &mut Duration::default());
        Some(Self {
            bvh,
            origin,
            bounds: (min - origin - pad, max - origin + pad),
            pad,
        })
    }

    /// Calls `test` with the numbers of boxes that the ray `eye + t · d` meets behind depth `from`, nearer ones first as
    /// a rule. `test` gives the depth behind which the caller is not interested any more.
    pub(super) fn visit(&self, eye: DVec3, d: DVec3, from: f64, mut test: impl FnMut(usize) -> f64) {
        let eye = eye - self.origin;
        let (mut enter, mut leave) = (from, f64::INFINITY);
        for k in 0..3 {
            let (lo, hi) = (self.bounds.0[k] - eye[k], self.bounds.1[k] - eye[k]);
            if d[k] == 0.0 {
                if lo > 0.0 || hi < 0.0 {
                    return;
                }
            } else {
                let (a, b) = (lo / d[k], hi / d[k]);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        let scale = d.abs().max_element();
        if enter > leave || scale == 0.0 {
            return;
        }
        let single = |p: DVec3| Vec3A::from(p.as_vec3());
        let ray = Ray::new(single(eye + d * enter), single(d / scale), 0.0, f32::INFINITY);
        self.bvh.ray_traverse(ray, &mut RayHit::none(), |_, k| {
            let far = test(self.bvh.primitive_indices[k] as usize);
            ((far - enter) * scale * (1.0 + WIDENED) + self.pad) as f32
        });
    }
}
