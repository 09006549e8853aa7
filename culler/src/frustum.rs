//! Box against view frustum, with plane masks carried down the hierarchy.
//!
//! The frustum is the infinite pyramid of the picture: there is no near or far plane. All its planes pass through
//! the eye, and boxes are taken relative to the eye before anything else, so precision follows the distance from the
//! eye and not that from the world's origin.
//!
//! Besides the four sides and the plane through the eye there are *support planes*: planes through the eye with the
//! whole pyramid on one side, perpendicular to an axis, or parallel to an axis and through an edge of the pyramid.
//! A box outside of one of them cannot be seen though it may straddle several sides; with them the test is a complete
//! separating axis test, exact but for rounding. At most 17 dot products, and a child tests only what its parent
//! straddled.
//!
//! Invariant: a box that shares a point with the pyramid is never `Outside`. Plain value: any thread.

use crate::bounds::Aabb;
use crate::camera::Camera;
use glam::DVec3;

/// The planes a box still straddles, one bit each; a child need not test what its parent was inside of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaneMask(u32);

impl PlaneMask {
    /// Nothing left to test: wholly inside.
    pub const NONE: PlaneMask = PlaneMask(0);

    /// Whether nothing is left to test.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// Where a box lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Containment {
    /// No point of the box is in the frustum.
    Outside,
    /// Part of it may be; children need test only these planes.
    Intersects(PlaneMask),
    /// All of it is; children need no test.
    Inside,
}

/// 4 sides, the eye plane, at most 2 directions for each of 3 axes, at most 2 silhouette planes for each of 3 axes.
const MAX_PLANES: usize = 17;
/// Bits of the four sides, the only ones that bound the pyramid; the others merely reject.
const SIDES: u32 = 0b1111;

/// A camera's view pyramid.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    eye: DVec3,
    /// Inward normals of planes through the eye; the first four are the sides.
    normals: [DVec3; MAX_PLANES],
    count: usize,
}

impl Frustum {
    /// The pyramid over the whole picture, to the outer edges of its border pixels.
    pub fn new(camera: &Camera) -> Frustum {
        let half = camera.screen_half_extent();
        let Camera {
            eye,
            forward,
            right,
            up,
            ..
        } = *camera;
        let mut frustum = Frustum {
            eye,
            normals: [DVec3::ZERO; MAX_PLANES],
            count: 0,
        };
        frustum.push(forward * half.x - right);
        frustum.push(forward * half.x + right);
        frustum.push(forward * half.y - up);
        frustum.push(forward * half.y + up);
        frustum.push(forward);

        let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
            .map(|(x, y)| forward + right * (x * half.x) + up * (y * half.y));
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            frustum.push_support(axis, &corners, None);
            for (index, corner) in corners.iter().enumerate() {
                frustum.push_support(corner.cross(axis), &corners, Some(index));
            }
        }
        frustum
    }

    /// The mask to start a hierarchy with: every plane is to be tested.
    pub fn full_mask(&self) -> PlaneMask {
        PlaneMask((1 << self.count) - 1)
    }

    /// Classifies a box against the planes in `mask`, which must come from [`Frustum::full_mask`] or from the
    /// classification of a box around this one.
    pub fn classify(&self, bounds: &Aabb, mask: PlaneMask) -> Containment {
        let lower = bounds.min - self.eye;
        let upper = bounds.max - self.eye;
        let mut left = mask.0;
        let mut open = mask.0;
        while left != 0 {
            let bit = left & left.wrapping_neg();
            left ^= bit;
            let normal = self.normals[bit.trailing_zeros() as usize];
            let positive = normal.cmpge(DVec3::ZERO);
            let farthest = normal.dot(DVec3::select(positive, upper, lower));
            if farthest < 0.0 {
                return Containment::Outside;
            }
            let nearest = normal.dot(DVec3::select(positive, lower, upper));
            if nearest >= 0.0 {
                open ^= bit;
            }
        }
        if open & SIDES == 0 {
            Containment::Inside
        } else {
            Containment::Intersects(PlaneMask(open))
        }
    }

    fn push(&mut self, normal: DVec3) {
        self.normals[self.count] = normal;
        self.count += 1;
    }

    /// Adds the plane if all corner rays lie on one side of it, apart from the one that spans it.
    fn push_support(&mut self, normal: DVec3, corners: &[DVec3; 4], spanned_by: Option<usize>) {
        let mut above = true;
        let mut below = true;
        for (index, corner) in corners.iter().enumerate() {
            if Some(index) != spanned_by {
                let side = normal.dot(*corner);
                above &= side > 0.0;
                below &= side < 0.0;
            }
        }
        if (above || below) && self.count < MAX_PLANES {
            self.push(if above { normal } else { -normal });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Random, box_meets_pyramid, random_camera};
    use glam::dvec3;
    use proptest::prelude::*;

    #[test]
    fn classifies_in_front_beside_and_behind() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::X, 90.0, 100, 100).unwrap();
        let frustum = Frustum::new(&camera);
        let classify = |min: [f64; 3], max: [f64; 3]| {
            let bounds = Aabb::new(DVec3::from(min), DVec3::from(max)).unwrap();
            frustum.classify(&bounds, frustum.full_mask())
        };
        assert_eq!(
            classify([10.0, -1.0, -1.0], [12.0, 1.0, 1.0]),
            Containment::Inside
        );
        assert_eq!(
            classify([-3.0, -1.0, -1.0], [-2.0, 1.0, 1.0]),
            Containment::Outside
        );
        assert_eq!(
            classify([10.0, 13.0, -1.0], [12.0, 15.0, 1.0]),
            Containment::Outside
        );
        assert!(matches!(
            classify([10.0, 9.0, -1.0], [12.0, 15.0, 1.0]),
            Containment::Intersects(_)
        ));
        // Around the eye, and on the far side of the world.
        assert!(matches!(
            classify([-1.0; 3], [1.0; 3]),
            Containment::Intersects(_)
        ));
        assert_eq!(
            classify([1e12, 0.0, 0.0], [1e12 + 1.0, 1.0, 1.0]),
            Containment::Inside
        );
    }

    #[test]
    fn big_box_across_several_planes_is_rejected() {
        // Straddles the left, the bottom and the eye plane at once, yet lies beside the pyramid.
        let camera = Camera::look_at(DVec3::ZERO, dvec3(1.0, 1.0, 0.0), 60.0, 100, 100).unwrap();
        let frustum = Frustum::new(&camera);
        let bounds = Aabb::new(dvec3(-900.0, -900.0, -900.0), dvec3(900.0, -1.0, 900.0)).unwrap();
        let sides = PlaneMask(SIDES | 1 << 4);
        assert!(
            matches!(frustum.classify(&bounds, sides), Containment::Intersects(_)),
            "sides alone keep it"
        );
        assert_eq!(
            frustum.classify(&bounds, frustum.full_mask()),
            Containment::Outside
        );
    }

    #[test]
    fn keeps_at_most_the_planes_counted() {
        let mut random = Random::new(5);
        let mut most = 0;
        for _ in 0..20_000 {
            most = most.max(Frustum::new(&random_camera(&mut random, 50.0)).count);
        }
        assert!(most > 5 && most <= MAX_PLANES, "{most}");
    }

    /// Small boxes around the eye's neighbourhood, judged by clipping their faces to the pyramid.
    #[test]
    fn false_keeps_stay_below_five_percent() {
        let mut random = Random::new(1);
        let (mut hidden, mut kept, mut kept_by_sides) = (0u32, 0u32, 0u32);
        for _ in 0..2_000 {
            let camera = random_camera(&mut random, 20.0);
            let frustum = Frustum::new(&camera);
            for _ in 0..50 {
                let low = random.point(30.0);
                let bounds = Aabb::new(low, low + random.size(0.1, 8.0)).unwrap();
                let outside = frustum.classify(&bounds, frustum.full_mask()) == Containment::Outside;
                if box_meets_pyramid(&bounds, &camera) {
                    assert!(!outside, "culled {bounds:?} in view of {camera:?}");
                } else {
                    hidden += 1;
                    kept += u32::from(!outside);
                    let sides = PlaneMask(SIDES | 1 << 4);
                    kept_by_sides += u32::from(frustum.classify(&bounds, sides) != Containment::Outside);
                }
            }
        }
        assert!(hidden > 50_000, "{hidden}");
        assert!(
            kept * 1000 < hidden,
            "{kept} of {hidden} kept; by the sides alone {kept_by_sides}"
        );
        assert!(
            kept_by_sides > kept,
            "support planes earn their place: {kept_by_sides} against {kept}"
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn culled_box_contains_no_point_of_the_frustum(
            seed in any::<u64>(),
            offset in prop::sample::select(vec![0.0, 1e3, 1e6, 1e9]),
            (sx, sy, depth) in (-1.0..1.0f64, -1.0..1.0f64, -2.0..4.0f64),
            share in prop::array::uniform3(0.0..1.0f64),
            size in prop::array::uniform3(-3.0..4.0f64),
        ) {
            let mut random = Random::new(seed);
            let mut camera = random_camera(&mut random, 20.0);
            camera.eye += DVec3::splat(offset);
            let half = camera.screen_half_extent() * (1.0 - 1e-6);
            // A point in view, and a box grown around it.
            let ray = camera.forward + camera.right * (sx * half.x) + camera.up * (sy * half.y);
            let point = camera.eye + ray * 10f64.powf(depth);
            prop_assume!(camera.eye.distance(point) > offset * 1e-8);
            let size = DVec3::from(size.map(|s| 10f64.powf(s)));
            let low = point - size * DVec3::from(share);
            let bounds = Aabb::new(low, low + size).unwrap();
            prop_assume!(bounds.contains(point));
            let frustum = Frustum::new(&camera);
            let containment = frustum.classify(&bounds, frustum.full_mask());
            prop_assert_ne!(containment, Containment::Outside);

            // A box inside of it inherits the mask, and must come to the same verdict as with all planes.
            if let Containment::Intersects(mask) = containment {
                let inner_low = low + size * DVec3::from(share) * 0.5;
                let inner = Aabb::new(inner_low, inner_low + size * 0.25).unwrap();
                let by_mask = frustum.classify(&inner, mask);
                let by_all = frustum.classify(&inner, frustum.full_mask());
                prop_assert_eq!(by_mask == Containment::Outside, by_all == Containment::Outside);
                prop_assert_eq!(by_mask == Containment::Inside, by_all == Containment::Inside);
            }
        }
    }
}
