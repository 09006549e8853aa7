//! The flights of suite `pager`: where the camera is at each moment. All end at rest.

use brickfell_culler::{Camera, CameraError};
use glam::{DVec3, dvec3};

/// Picture of the flights, pixels: what rays want, not what a screen shows.
pub(super) const SIZE: (u32, u32) = (96, 54);
/// Vertical field of view, degrees.
const FOV: f64 = 60.0;
/// Height above the highest ground around, metres.
const ABOVE: f64 = 25.0;

/// A way of moving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// Along a line, metres per second.
    Straight(f64),
    /// Twice around on the spot, at whatever pace.
    Spin,
    /// At 50 m/s, then at once to the other side of the terrain.
    Teleport,
    /// At 200 m/s, turning by a right angle every half second.
    ZigZag,
    /// Nearly on the spot: half a metre around.
    Hover,
}

/// A flight over a square terrain.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flight {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    pub(super) seconds: f64,
}

/// The flights; `quick` ones are shorter.
pub(super) fn flights(quick: bool) -> [Flight; 6] {
    let flight = |name, kind, seconds: f64| Flight {
        name,
        kind,
        seconds: if quick { seconds / 2.0 } else { seconds },
    };
    [
        flight("straight 100 m/s", Kind::Straight(100.0), 8.0),
        flight("straight 1000 m/s", Kind::Straight(1000.0), 2.0),
        flight("spin", Kind::Spin, 16.0),
        flight("teleport", Kind::Teleport, 4.0),
        flight("zig-zag", Kind::ZigZag, 8.0),
        flight("hover", Kind::Hover, 4.0),
    ]
}

impl Flight {
    /// The camera after so many seconds; `ground` is the highest ground around a place of a terrain with this side.
    pub(super) fn camera(
        &self,
        t: f64,
        side: f64,
        ground: &dyn Fn(f64, f64) -> f64,
    ) -> Result<Camera, CameraError> {
        let t = t.clamp(0.0, self.seconds);
        let start = dvec3(0.1 * side, 0.3 * side, 0.0);
        let (place, heading) = match self.kind {
            Kind::Straight(speed) => (start + DVec3::X * speed * t, 0.0),
            Kind::Spin => (start, 2.0 * std::f64::consts::TAU * t / self.seconds),
            Kind::Teleport if t < self.seconds / 2.0 => (start + DVec3::X * 50.0 * t, 0.0),
            Kind::Teleport => (dvec3(0.8 * side, 0.75 * side, 0.0), 2.5),
            Kind::ZigZag => {
                let (turns, rest) = ((t / 0.5).floor(), t % 0.5);
                let legs = dvec3(((turns + 1.0) / 2.0).floor(), (turns / 2.0).floor(), 0.0) * 0.5;
                let heading = if turns % 2.0 == 0.0 {
                    0.0
                } else {
                    std::f64::consts::FRAC_PI_2
                };
                let way = legs + dvec3(heading.cos(), heading.sin(), 0.0) * rest;
                (start + way * 200.0, heading)
            }
            Kind::Hover => (start + dvec3((3.0 * t).sin(), (2.0 * t).cos(), 0.0) * 0.5, 0.0),
        };
        let eye = place.with_z(ground(place.x, place.y) + ABOVE);
        let target = eye + dvec3(heading.cos(), heading.sin(), -0.45);
        Camera::look_at(eye, target, FOV, SIZE.0, SIZE.1)
    }

    /// When the camera jumps, if it does.
    pub(super) fn jump(&self) -> Option<f64> {
        (self.kind == Kind::Teleport).then_some(self.seconds / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_are_steady_but_for_the_jump_and_stay_on_the_terrain() {
        for flight in flights(false) {
            let at = |t: f64| flight.camera(t, 2000.0, &|_, _| 7.0).unwrap();
            let mut jumps = 0;
            let steps = (flight.seconds * 200.0) as u32;
            for k in 1..=steps {
                let (a, b) = (at(f64::from(k - 1) / 200.0).eye, at(f64::from(k) / 200.0).eye);
                jumps += u32::from(a.distance(b) > 10.0);
                assert!(
                    (0.0..=3000.0).contains(&b.x) && (0.0..=2000.0).contains(&b.y),
                    "{flight:?} {b}"
                );
                assert_eq!(b.z, 32.0);
            }
            assert_eq!(jumps, u32::from(flight.jump().is_some()), "{flight:?}");
            assert_eq!(at(1e9), at(flight.seconds));
        }
    }
}
