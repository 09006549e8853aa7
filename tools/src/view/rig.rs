//! How the window's camera moves: flying, around a point, on foot; to a point that was pointed at, and home.
//!
//! A plain value, advanced once a frame by the window's thread. World metres, Z up; angles in radians, the heading clockwise from
//! north. On foot the eye goes only to places whose ground is known, and so is never below it.

use glam::{DVec2, DVec3, dvec2, dvec3};

/// Height of the eye over the ground on foot, metres.
pub(super) const EYE_HEIGHT: f64 = 1.7;
/// What turns at most upwards or downwards: straight up and down have no heading.
const STEEPEST: f64 = 1.55;
/// Metres per second on foot.
const WALK: f64 = 3.0;
/// Part of its height over the ground that a flying camera goes in a second, and the slowest it does.
const FLIGHT: f64 = 0.7;
const SLOWEST: f64 = 2.0;
/// What `fast` multiplies speeds by.
const FAST: f64 = 4.0;
/// Seconds that a flight to a point takes.
const TRAVEL_SECONDS: f64 = 1.5;
/// Longest frame that counts, seconds: what took longer is not made up for.
const LONGEST: f64 = 0.25;

/// Kinds of movement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    /// Freely.
    #[default]
    Fly,
    /// Around a point.
    Orbit,
    /// On the ground.
    Walk,
}

impl Mode {
    /// The next one, around in a circle.
    pub(super) fn next(self) -> Self {
        match self {
            Self::Fly => Self::Orbit,
            Self::Orbit => Self::Walk,
            Self::Walk => Self::Fly,
        }
    }

    /// For the user.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Fly => "fly",
            Self::Orbit => "orbit",
            Self::Walk => "walk",
        }
    }
}

/// What keys and mouse ask for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Wish {
    /// -1 to 1: right, forward, up.
    pub(super) go: DVec3,
    /// Radians to the right and upwards.
    pub(super) turn: DVec2,
    /// Notches of the wheel, away from the user.
    pub(super) wheel: f64,
    /// Faster.
    pub(super) fast: bool,
}

/// A way from one view to another.
#[derive(Clone, Copy, Debug)]
struct Travel {
    from: (DVec3, DVec2),
    to: (DVec3, DVec2),
    part: f64,
}

/// The camera's place and how it moves.
#[derive(Clone, Debug)]
pub(super) struct Rig {
    mode: Mode,
    eye: DVec3,
    /// Heading, and angle above the horizon.
    angles: DVec2,
    /// log2 of what the wheel multiplies speeds by.
    gear: f64,
    /// What is orbited.
    pivot: DVec3,
    home: (DVec3, DVec3),
    travel: Option<Travel>,
    /// Height of the ground below the eye, if it is known.
    ground: Option<f64>,
    /// On foot, where to go once the ground there is known.
    step: Option<DVec3>,
}

fn angles_of(direction: DVec3) -> DVec2 {
    let flat = direction.truncate().length();
    dvec2(direction.x.atan2(direction.y), direction.z.atan2(flat)).clamp(
        dvec2(f64::NEG_INFINITY, -STEEPEST),
        dvec2(f64::INFINITY, STEEPEST),
    )
}

fn direction_of(angles: DVec2) -> DVec3 {
    let ((sin, cos), (rise, flat)) = (angles.x.sin_cos(), angles.y.sin_cos());
    dvec3(sin * flat, cos * flat, rise)
}

impl Rig {
    /// A camera at home.
    pub(super) fn new(eye: DVec3, target: DVec3) -> Self {
        let mut rig = Self {
            mode: Mode::Fly,
            eye,
            angles: DVec2::ZERO,
            gear: 0.0,
            pivot: target,
            home: (eye, target),
            travel: None,
            ground: None,
            step: None,
        };
        rig.look(eye, target);
        rig
    }

    /// Eye and a point in sight.
    pub(super) fn view(&self) -> (DVec3, DVec3) {
        (self.eye, self.eye + direction_of(self.angles) * self.reach())
    }

    /// Kind of movement.
    pub(super) fn mode(&self) -> Mode {
        self.mode
    }

    /// Height over the ground, if that is known.
    pub(super) fn height(&self) -> Option<f64> {
        self.ground.map(|ground| self.eye.z - ground)
    }

    /// Whether the camera goes somewhere by itself.
    pub(super) fn travels(&self) -> bool {
        self.travel.is_some() || self.step.is_some()
    }

    /// Distance to the point in sight: in an orbit, the pivot.
    fn reach(&self) -> f64 {
        self.eye.distance(self.pivot).max(1e-3)
    }

    /// Moves otherwise from now on; an orbit is around what is in the middle of the picture, as far away as the last pivot.
    pub(super) fn set_mode(&mut self, mode: Mode) {
        if mode == Mode::Orbit {
            self.pivot = self.eye + direction_of(self.angles) * self.reach();
        }
        self.mode = mode;
        self.travel = None;
        self.step = (mode == Mode::Walk).then_some(self.eye);
    }

    /// At once to a view.
    pub(super) fn look(&mut self, eye: DVec3, target: DVec3) {
        (self.eye, self.pivot) = (eye, target);
        self.angles = angles_of(target - eye);
        (self.travel, self.ground, self.step) = (None, None, None);
    }

    fn travel(&mut self, eye: DVec3, target: DVec3) {
        let mut to = angles_of(target - eye);
        // The short way round.
        let turn = to.x - self.angles.x;
        to.x = self.angles.x + turn - (turn / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        self.pivot = target;
        self.step = None;
        self.travel = Some(Travel {
            from: (self.eye, self.angles),
            to: (eye, to),
            part: 0.0,
        });
    }

    /// Flies to where it began.
    pub(super) fn go_home(&mut self) {
        if self.mode == Mode::Walk {
            self.mode = Mode::Fly;
        }
        let (eye, target) = self.home;
        self.travel(eye, target);
    }

    /// Flies most of the way towards a point, looking at it.
    pub(super) fn approach(&mut self, point: DVec3) {
        let away = self.eye - point;
        let left = (0.25 * away.length()).max(3.0).min(away.length());
        self.travel(point + away.normalize_or(DVec3::Z) * left, point);
    }

    /// Flies to a place without turning.
    pub(super) fn go_to(&mut self, eye: DVec3) {
        let ahead = direction_of(self.angles) * self.reach();
        self.travel(eye, eye + ahead);
    }

    /// Moves for `dt` seconds. Returns the place whose ground is asked for: [`Self::answer`] takes it.
    pub(super) fn advance(&mut self, wish: &Wish, dt: f64) -> DVec3 {
        let dt = dt.clamp(0.0, LONGEST);
        let wanted = wish.go != DVec3::ZERO || wish.turn != DVec2::ZERO || wish.wheel != 0.0;
        if wanted {
            self.travel = None;
        }
        if let Some(travel) = &mut self.travel {
            travel.part = (travel.part + dt / TRAVEL_SECONDS).min(1.0);
            let s = travel.part * travel.part * (3.0 - 2.0 * travel.part);
            self.eye = travel.from.0.lerp(travel.to.0, s);
            self.angles = travel.from.1.lerp(travel.to.1, s);
            if travel.part == 1.0 {
                self.travel = None;
                if self.mode == Mode::Walk {
                    self.step = Some(self.eye);
                }
            }
            return self.step.unwrap_or(self.eye);
        }
        let fast = if wish.fast { FAST } else { 1.0 };
        match self.mode {
            Mode::Fly => {
                self.turn(wish.turn);
                self.gear = (self.gear + 0.25 * wish.wheel).clamp(-6.0, 6.0);
                let height = self.height().unwrap_or(self.reach()).abs();
                let speed = (FLIGHT * height).max(SLOWEST) * self.gear.exp2() * fast;
                let step = self.along(wish.go, direction_of(self.angles)) * (speed * dt);
                self.eye += step;
                self.pivot += step;
            }
            Mode::Orbit => {
                self.turn(dvec2(wish.turn.x, wish.turn.y) + dvec2(wish.go.x, wish.go.z) * (dt * fast));
                let closer = 0.15 * wish.wheel + wish.go.y * dt * fast;
                let reach = (self.reach() * (-closer).exp()).clamp(0.1, 1e7);
                self.eye = self.pivot - direction_of(self.angles) * reach;
            }
            Mode::Walk => {
                self.turn(wish.turn);
                self.gear = (self.gear + 0.25 * wish.wheel).clamp(-2.0, 4.0);
                let flat = direction_of(dvec2(self.angles.x, 0.0));
                let go = self.along(dvec3(wish.go.x, wish.go.y, 0.0), flat);
                if self.step.is_none() && go != DVec3::ZERO {
                    self.step = Some(self.eye + go * (WALK * self.gear.exp2() * fast * dt));
                }
            }
        }
        self.step.unwrap_or(self.eye)
    }

    /// Takes the height of the ground at a place that [`Self::advance`] asked for; `None` where there is none, to which nobody walks.
    pub(super) fn answer(&mut self, place: DVec3, ground: Option<f64>) {
        if let Some(step) = self.step.filter(|step| *step == place) {
            self.step = None;
            if let Some(ground) = ground {
                self.eye = step.truncate().extend(ground + EYE_HEIGHT);
                self.pivot = self.eye + direction_of(self.angles) * 10.0;
                self.ground = Some(ground);
            }
        } else if self.mode != Mode::Walk {
            self.ground = ground;
        }
    }

    fn turn(&mut self, by: DVec2) {
        let reach = self.reach();
        self.angles.x = (self.angles.x + by.x) % std::f64::consts::TAU;
        self.angles.y = (self.angles.y + by.y).clamp(-STEEPEST, STEEPEST);
        if self.mode != Mode::Orbit {
            self.pivot = self.eye + direction_of(self.angles) * reach;
        }
    }

    /// The unit vector of a wish, or nothing, by a view's direction.
    fn along(&self, go: DVec3, forward: DVec3) -> DVec3 {
        let right = dvec3(self.angles.x.cos(), -self.angles.x.sin(), 0.0);
        (right * go.x + forward * go.y + DVec3::Z * go.z).normalize_or_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORWARD: Wish = Wish {
        go: DVec3::Y,
        turn: DVec2::ZERO,
        wheel: 0.0,
        fast: false,
    };

    fn rig() -> Rig {
        Rig::new(dvec3(0.0, -10.0, 100.0), dvec3(0.0, 90.0, 0.0))
    }

    #[test]
    fn flight_is_as_fast_as_it_is_high() {
        let mut low = rig();
        let (mut high, wish) = (low.clone(), FORWARD);
        low.answer(low.eye, Some(90.0));
        high.answer(high.eye, Some(0.0));
        let (a, b) = (low.eye, high.eye);
        low.advance(&wish, 0.1);
        high.advance(&wish, 0.1);
        let (slow, fast) = (low.eye.distance(a), high.eye.distance(b));
        assert!((fast / slow - 10.0).abs() < 1e-9, "{slow} {fast}");
        // The wheel and the fast key.
        let before = low.eye;
        low.advance(
            &Wish {
                wheel: 4.0,
                fast: true,
                ..wish
            },
            0.1,
        );
        assert!(low.eye.distance(before) > 7.0 * slow);
        // A frame that took long is no jump.
        let before = high.eye;
        high.advance(&wish, 100.0);
        assert!(high.eye.distance(before) < 3.0 * fast);
    }

    #[test]
    fn an_orbit_keeps_its_pivot_in_the_middle() {
        let mut rig = rig();
        rig.set_mode(Mode::Orbit);
        let reach = rig.reach();
        let pivot = rig.pivot;
        for turn in [dvec2(0.3, 0.1), dvec2(-2.0, -3.0), dvec2(9.0, 0.2)] {
            rig.advance(
                &Wish {
                    turn,
                    ..Wish::default()
                },
                0.1,
            );
            let (eye, target) = rig.view();
            assert!((eye.distance(pivot) - reach).abs() < 1e-6);
            assert!(target.distance(pivot) < 1e-6);
        }
        rig.advance(
            &Wish {
                wheel: 5.0,
                ..Wish::default()
            },
            0.1,
        );
        assert!(rig.reach() < 0.6 * reach && rig.pivot == pivot);
    }

    #[test]
    fn on_foot_the_eye_is_over_the_ground_wherever_it_is() {
        // A steep slope, and answers that come some frames late.
        let ground = |p: DVec3| 3.0 * p.y.abs();
        let mut rig = rig();
        rig.set_mode(Mode::Walk);
        let mut asked = Vec::new();
        for frame in 0..400 {
            asked.push(rig.advance(
                &Wish {
                    fast: frame % 2 == 0,
                    ..FORWARD
                },
                0.1,
            ));
            if frame % 3 == 2 {
                let place = asked[asked.len() - 1];
                rig.answer(place, Some(ground(place)));
                asked.clear();
            }
            if frame > 3 {
                let height = rig.eye.z - ground(rig.eye);
                assert!((height - EYE_HEIGHT).abs() < 1e-9, "{height} in frame {frame}");
            }
        }
        assert!(rig.eye.y > 10.0);
        // No ground, no step.
        let before = rig.eye;
        let place = rig.advance(&FORWARD, 0.1);
        rig.answer(place, None);
        assert_eq!(rig.eye, before);
    }

    #[test]
    fn ways_end_where_they_lead_and_give_way_to_keys() {
        let mut rig = rig();
        rig.go_to(dvec3(500.0, 500.0, 50.0));
        for _ in 0..100 {
            rig.advance(&Wish::default(), 0.1);
        }
        assert_eq!(rig.eye, dvec3(500.0, 500.0, 50.0));
        rig.approach(dvec3(500.0, 700.0, 0.0));
        rig.advance(&Wish::default(), 0.1);
        assert!(rig.travels());
        for _ in 0..100 {
            rig.advance(&Wish::default(), 0.1);
        }
        let (eye, target) = rig.view();
        assert!(
            (target - eye)
                .normalize()
                .dot((dvec3(500.0, 700.0, 0.0) - eye).normalize())
                > 0.999
        );
        rig.go_home();
        rig.advance(&FORWARD, 0.1);
        assert!(!rig.travels());
        rig.go_home();
        for _ in 0..100 {
            rig.advance(&Wish::default(), 0.1);
        }
        assert_eq!(rig.eye, rig.home.0);
    }
}
