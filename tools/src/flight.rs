//! Camera paths: the JSON of `fly --path`, its interpolation, and the orbit that is flown when there is none.
//!
//! ```json
//! {"keys": [{"t": 0, "eye": [0, 0, 50], "target": [100, 0, 0]}, {"t": 5, "eye": [90, 0, 30], "target": [100, 0, 0]}]}
//! ```
//! Times are seconds and rise; positions are world metres. Between keys, eye and target follow a Catmull-Rom spline with the
//! keys' times, so that the speed does not jump at a key.

use std::path::Path;

use brickfell_culler::Aabb;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Most keys of a path.
const MAX_KEYS: usize = 100_000;

/// A path that cannot be flown; the message names the file.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {message}")]
pub struct FlightError {
    path: String,
    message: String,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Key {
    t: f64,
    eye: [f64; 3],
    target: [f64; 3],
}

/// Seconds, eye and target.
pub type TimedView = (f64, DVec3, DVec3);

/// A camera path.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Flight {
    keys: Vec<Key>,
}

impl Flight {
    /// Reads a path.
    ///
    /// # Errors
    /// If the file cannot be read, is not such JSON, has no key, times that do not rise or numbers that are not finite.
    pub fn load(path: &Path) -> Result<Self, FlightError> {
        let fail = |message: String| FlightError {
            path: path.display().to_string(),
            message,
        };
        let text = std::fs::read_to_string(path).map_err(|e| fail(e.to_string()))?;
        let flight: Self = serde_json::from_str(&text).map_err(|e| fail(e.to_string()))?;
        flight.validate().map_err(fail)?;
        Ok(flight)
    }

    /// A path through views at times, which is to be written to a file.
    ///
    /// # Errors
    /// As [`Self::load`], and if there are fewer than two views.
    pub fn from_views(views: &[TimedView], file: &Path) -> Result<Self, FlightError> {
        let key = |(t, eye, target): &TimedView| Key {
            t: *t,
            eye: eye.to_array(),
            target: target.to_array(),
        };
        let flight = Self {
            keys: views.iter().map(key).collect(),
        };
        let result = match views.len() {
            0 | 1 => Err("nothing was recorded".to_string()),
            _ => flight.validate(),
        };
        let path = file.display().to_string();
        result.map_err(|message| FlightError { path, message })?;
        Ok(flight)
    }

    /// Writes the path.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FlightError> {
        let write = serde_json::to_vec_pretty(self)
            .map_err(std::io::Error::from)
            .and_then(|text| std::fs::write(path, text));
        write.map_err(|e| FlightError {
            path: path.display().to_string(),
            message: e.to_string(),
        })
    }

    fn validate(&self) -> Result<(), String> {
        if self.keys.is_empty() || self.keys.len() > MAX_KEYS {
            return Err(format!(
                "a path has 1 to {MAX_KEYS} keys, this one {}",
                self.keys.len()
            ));
        }
        for (k, key) in self.keys.iter().enumerate() {
            let numbers = key.eye.iter().chain(&key.target).chain([&key.t]);
            if !numbers.into_iter().all(|v| v.is_finite()) {
                return Err(format!("key {k} has a number that is not finite"));
            }
            if key.eye == key.target {
                return Err(format!("key {k} looks at its own eye"));
            }
            if k > 0 && key.t <= self.keys[k - 1].t {
                return Err(format!(
                    "key {k}: its time {} does not come after {}",
                    key.t,
                    self.keys[k - 1].t
                ));
            }
        }
        Ok(())
    }

    /// One turn around a box in `seconds`, looking down at the middle of its floor.
    pub fn orbit(bounds: &Aabb, seconds: f64) -> Self {
        let center = bounds.center();
        let size = bounds.size();
        // Close enough that the terrain fills most of the picture, high enough to see over its own relief.
        let radius = 0.55 * size.truncate().length().max(size.z);
        let height = bounds.max.z + 0.28 * radius;
        let steps = 32;
        let keys = (0..=steps)
            .map(|k| {
                let angle = std::f64::consts::TAU * f64::from(k) / f64::from(steps) - 0.7;
                Key {
                    t: seconds * f64::from(k) / f64::from(steps),
                    eye: [
                        center.x + radius * angle.cos(),
                        center.y + radius * angle.sin(),
                        height,
                    ],
                    target: [center.x, center.y, bounds.min.z],
                }
            })
            .collect();
        Self { keys }
    }

    /// Seconds from the first key to the last.
    pub fn duration(&self) -> f64 {
        match (self.keys.first(), self.keys.last()) {
            (Some(first), Some(last)) => last.t - first.t,
            _ => 0.0,
        }
    }

    /// Eye and target at `t` seconds after the first key; before it and after the last one the path stands still.
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let t = t + self.keys[0].t;
        let next = self
            .keys
            .partition_point(|k| k.t <= t)
            .clamp(1, self.keys.len().max(2) - 1);
        if self.keys.len() == 1 {
            return (self.keys[0].eye.into(), self.keys[0].target.into());
        }
        let (a, b) = (&self.keys[next - 1], &self.keys[next]);
        let u = ((t - a.t) / (b.t - a.t)).clamp(0.0, 1.0);
        let blend = |pick: fn(&Key) -> [f64; 3]| {
            let p = |k: &Key| DVec3::from_array(pick(k));
            // Slopes over the neighbours, one-sided at the ends.
            let slope = |k: usize| {
                let (lo, hi) = (
                    &self.keys[k.saturating_sub(1)],
                    &self.keys[(k + 1).min(self.keys.len() - 1)],
                );
                (p(hi) - p(lo)) / (hi.t - lo.t)
            };
            let span = b.t - a.t;
            let (m0, m1) = (slope(next - 1) * span, slope(next) * span);
            let (u2, u3) = (u * u, u * u * u);
            p(a) * (2.0 * u3 - 3.0 * u2 + 1.0)
                + m0 * (u3 - 2.0 * u2 + u)
                + p(b) * (3.0 * u2 - 2.0 * u3)
                + m1 * (u3 - u2)
        };
        (blend(|k| k.eye), blend(|k| k.target))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(times: &[f64]) -> Flight {
        let keys = times.iter().map(|t| Key {
            t: *t,
            eye: [t * 10.0, 0.0, 5.0],
            target: [t * 10.0, 9.0, 0.0],
        });
        Flight { keys: keys.collect() }
    }

    #[test]
    fn a_straight_path_is_flown_at_even_speed_and_stands_still_outside() {
        let path = flight(&[1.0, 2.0, 4.0]);
        for (t, x) in [
            (-1.0, 10.0),
            (0.0, 10.0),
            (0.5, 15.0),
            (1.0, 20.0),
            (2.5, 35.0),
            (3.0, 40.0),
            (9.0, 40.0),
        ] {
            assert!((path.at(t).0.x - x).abs() < 1e-9, "{t}: {}", path.at(t).0);
        }
        assert_eq!(path.duration(), 3.0);
        assert_eq!(flight(&[3.0]).at(1.0).0.x, 30.0);
    }

    #[test]
    fn bad_paths_are_refused() {
        assert!(flight(&[]).validate().is_err());
        assert!(flight(&[1.0, 1.0]).validate().is_err());
        assert!(flight(&[f64::NAN]).validate().is_err());
        assert!(flight(&[0.0, 1.0]).validate().is_ok());
        assert!(
            serde_json::from_str::<Flight>(r#"{"keys":[{"t":0,"eye":[0,0,0],"target":[1,0,0],"up":1}]}"#)
                .is_err()
        );
    }

    #[test]
    fn the_orbit_closes_and_stays_outside() {
        let bounds = Aabb::new(DVec3::new(-5.0, 10.0, 0.0), DVec3::new(95.0, 110.0, 30.0)).unwrap();
        let path = Flight::orbit(&bounds, 10.0);
        assert!((path.at(0.0).0 - path.at(10.0).0).length() < 1e-6);
        for k in 0..100 {
            let (eye, target) = path.at(f64::from(k) * 0.1);
            assert!(
                !bounds.contains(eye)
                    && eye.z > bounds.max.z
                    && (target - bounds.center()).truncate().length() < 1e-9
            );
        }
    }
}
