//! Axis-aligned boxes in world space.
//!
//! A tree owns the half-open box `[min, max)`, so that two trees that share a face never both own a point of it.
//! Constructors refuse non-finite and inverted corners; everything behind them relies on that and only compares.
//! Plain values: any thread.

use glam::DVec3;
use thiserror::Error;

/// Why two corners do not make a box.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum BoundsError {
    /// A coordinate is NaN or infinite.
    #[error("bounds are not finite: min {min}, max {max}")]
    NotFinite {
        /// The lower corner as given.
        min: DVec3,
        /// The upper corner as given.
        max: DVec3,
    },
    /// A lower coordinate exceeds the upper one of the same axis.
    #[error("bounds are inverted: min {min}, max {max}")]
    Inverted {
        /// The lower corner as given.
        min: DVec3,
        /// The upper corner as given.
        max: DVec3,
    },
}

/// An axis-aligned box in world metres, half-open where it stands for what a tree owns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lower corner, inclusive.
    pub min: DVec3,
    /// Upper corner, exclusive.
    pub max: DVec3,
}

impl Aabb {
    /// A box between two corners.
    ///
    /// # Errors
    /// [`BoundsError`] if a coordinate is not finite or `min` exceeds `max` on an axis. Zero sizes are accepted.
    pub fn new(min: DVec3, max: DVec3) -> Result<Aabb, BoundsError> {
        let bounds = Aabb { min, max };
        bounds.validate()?;
        Ok(bounds)
    }

    /// Checks a box that was put together from its public fields.
    ///
    /// # Errors
    /// As [`Aabb::new`].
    pub fn validate(&self) -> Result<(), BoundsError> {
        let Aabb { min, max } = *self;
        if !(min.is_finite() && max.is_finite()) {
            return Err(BoundsError::NotFinite { min, max });
        }
        if min.cmpgt(max).any() {
            return Err(BoundsError::Inverted { min, max });
        }
        Ok(())
    }

    /// Edge lengths in metres.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// The middle of the box.
    pub fn center(&self) -> DVec3 {
        // Halves first: the sum of two finite corners may overflow.
        self.min * 0.5 + self.max * 0.5
    }

    /// Whether the half-open box holds no point at all: zero size on some axis.
    pub fn is_empty(&self) -> bool {
        self.min.cmpge(self.max).any()
    }

    /// Whether `point` lies in the half-open box.
    pub fn contains(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmplt(self.max).all()
    }

    /// Whether `other` lies wholly inside this box; shared faces count as inside.
    pub fn encloses(&self, other: &Aabb) -> bool {
        self.min.cmple(other.min).all() && other.max.cmple(self.max).all()
    }

    /// Whether the two half-open boxes share a point; boxes that only touch do not.
    pub fn overlaps(&self, other: &Aabb) -> bool {
        self.min.max(other.min).cmplt(self.max.min(other.max)).all()
    }

    /// The smallest box around both.
    pub fn union(&self, other: &Aabb) -> Aabb {
        Aabb {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Metres from `point` to the nearest point of the closed box; 0 inside and on its faces.
    pub fn distance_to_point(&self, point: DVec3) -> f64 {
        (self.min - point).max(point - self.max).max(DVec3::ZERO).length()
    }

    /// Least and greatest depth of the box's points, measured from `origin` along `direction` (metres if that has
    /// unit length). Negative depths lie behind.
    pub fn depth_range(&self, origin: DVec3, direction: DVec3) -> (f64, f64) {
        let lower = self.min - origin;
        let upper = self.max - origin;
        let positive = direction.cmpge(DVec3::ZERO);
        let near = DVec3::select(positive, lower, upper);
        let far = DVec3::select(positive, upper, lower);
        (direction.dot(near), direction.dot(far))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;
    use proptest::prelude::*;

    fn cube(min: f64, max: f64) -> Aabb {
        Aabb::new(DVec3::splat(min), DVec3::splat(max)).unwrap()
    }

    #[test]
    fn refuses_nan_infinite_and_inverted_corners() {
        let nan = Aabb::new(dvec3(0.0, f64::NAN, 0.0), DVec3::ONE).unwrap_err();
        assert!(matches!(nan, BoundsError::NotFinite { .. }));
        assert!(nan.to_string().contains("NaN"), "{nan}");
        assert!(Aabb::new(DVec3::ZERO, dvec3(1.0, 1.0, f64::INFINITY)).is_err());
        let inverted = Aabb::new(dvec3(0.0, 2.0, 0.0), DVec3::ONE).unwrap_err();
        assert!(matches!(inverted, BoundsError::Inverted { .. }));
        assert!(Aabb::new(DVec3::ONE, DVec3::ONE).unwrap().is_empty());
    }

    #[test]
    fn half_open_boxes_share_no_face_point() {
        let low = cube(0.0, 1.0);
        let high = Aabb::new(dvec3(1.0, 0.0, 0.0), dvec3(2.0, 1.0, 1.0)).unwrap();
        let on_face = dvec3(1.0, 0.5, 0.5);
        assert!(!low.contains(on_face) && high.contains(on_face));
        assert!(low.contains(DVec3::ZERO) && !low.contains(DVec3::ONE));
        assert!(!low.overlaps(&high) && low.overlaps(&cube(0.5, 2.0)));
        // A box without volume overlaps nothing, even from within.
        assert!(!low.overlaps(&cube(0.5, 0.5)));
    }

    #[test]
    fn distance_is_zero_inside_and_euclidean_outside() {
        let unit = cube(0.0, 1.0);
        assert_eq!(unit.distance_to_point(DVec3::splat(0.3)), 0.0);
        assert_eq!(unit.distance_to_point(DVec3::ONE), 0.0);
        assert_eq!(unit.distance_to_point(dvec3(4.0, 5.0, 0.5)), 5.0);
        assert_eq!(unit.distance_to_point(dvec3(0.5, 0.5, -2.0)), 2.0);
    }

    #[test]
    fn union_and_center_survive_huge_coordinates() {
        let both = cube(0.0, 1.0).union(&cube(-3.0, -2.0));
        assert_eq!(both, cube(-3.0, 1.0));
        assert!(both.encloses(&cube(0.0, 1.0)) && !cube(0.0, 1.0).encloses(&both));
        assert_eq!(both.size(), DVec3::splat(4.0));
        assert_eq!(
            cube(f64::MAX / 2.0, f64::MAX).center(),
            DVec3::splat(f64::MAX * 0.75)
        );
    }

    proptest! {
        #[test]
        fn depth_range_is_that_of_the_corners(
            low in prop::array::uniform3(-50.0..50.0f64),
            size in prop::array::uniform3(0.0..20.0f64),
            origin in prop::array::uniform3(-50.0..50.0f64),
            direction in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let (low, size) = (DVec3::from(low), DVec3::from(size));
            let (origin, direction) = (DVec3::from(origin), DVec3::from(direction));
            let bounds = Aabb::new(low, low + size).unwrap();
            let depths = (0..8).map(|corner| {
                let pick = |axis: usize| {
                    if corner >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] }
                };
                direction.dot(dvec3(pick(0), pick(1), pick(2)) - origin)
            });
            let (least, greatest) = depths.fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(d), b.max(d)));
            prop_assert_eq!(bounds.depth_range(origin, direction), (least, greatest));
        }
    }
}
