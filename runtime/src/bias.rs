//! The one owner of the footprint bias: what keeps the working set inside the pool, or what keeps a frame in its time
//! ([`crate::effort`]), whichever is more.
//!
//! `demand` is what the last frame's rays used, with what is above it, and lacked, in bricks. Above 90 % of the pool the bias rises by half the
//! binary logarithm of the excess (a bias of one halves the resolution: a quarter of the bricks on a surface). It falls
//! only below 70 %, and never while the camera rests, because a plain integrator cycles for ever. Called by the render
//! thread, once for each read-back.

use brickfell_culler::Camera;

const HIGH: f64 = 0.9;
const LOW: f64 = 0.7;
/// Frames between two changes: the read-back's latency and one more.
const SETTLE_FRAMES: u32 = 4;
const MAX: f64 = 12.0;

/// Raises and lowers the bias.
#[derive(Clone, Debug, Default)]
pub struct BiasController {
    /// What memory asks for.
    extra: f64,
    /// What the time of a frame asks for.
    time: f64,
    changed: u32,
    /// The last demand was too high, and the last change too young to know what comes of it.
    waiting: bool,
    camera: Option<Camera>,
}

impl BiasController {
    /// What is added to the wanted bias.
    pub fn extra(&self) -> f64 {
        self.extra.max(self.time)
    }

    /// The part of [`Self::extra`] that memory asks for.
    pub fn memory(&self) -> f64 {
        self.extra
    }

    /// Sets what the time of the frame to come asks for, at least 0.
    pub fn set_time(&mut self, extra: f64) {
        self.time = extra;
    }

    /// True if another look at the same demand may change it.
    pub fn is_waiting(&self) -> bool {
        self.waiting
    }

    /// Looks at a frame's demand and capacity, both in the same unit, for each resource; the scarcest decides.
    pub fn update(&mut self, frame: u32, camera: &Camera, demands: &[(f64, f64)]) {
        let load = demands
            .iter()
            .map(|(demand, capacity)| demand / capacity.max(1.0))
            .fold(0.0, f64::max);
        let rests = self.camera.replace(*camera) == Some(*camera);
        let young = frame.saturating_sub(self.changed) < SETTLE_FRAMES;
        self.waiting = load > HIGH && self.extra < MAX && young;
        if young {
            return;
        }
        if load > HIGH {
            // The demand is that of the bias in effect.
            self.extra = (self.extra() + 0.5 * (load / HIGH).log2()).min(MAX);
            self.changed = frame;
        } else if load < LOW && self.extra > 0.0 && !rests {
            let enough = self.extra() - 0.5 * (LOW / load.max(0.01)).log2();
            self.extra = enough.clamp(0.0, self.extra);
            self.changed = frame;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn camera(x: f64) -> Camera {
        Camera::look_at(DVec3::new(x, 0.0, 0.0), DVec3::new(x, 1.0, 0.0), 60.0, 8, 8).unwrap()
    }

    #[test]
    fn a_working_set_of_four_pools_settles_at_rest_and_recovers_in_motion() {
        let mut bias = BiasController::default();
        let mut changes = 0;
        for frame in 1..400 {
            let before = bias.extra();
            bias.update(frame, &camera(0.0), &[(4000.0 / 4f64.powf(before), 1000.0)]);
            changes += u32::from(bias.extra() != before);
        }
        assert!(
            changes < 10 && 4000.0 / 4f64.powf(bias.extra()) <= 900.0 + 1e-6,
            "{bias:?}"
        );
        for frame in 400..800 {
            bias.update(
                frame,
                &camera(f64::from(frame)),
                &[(100.0 / 4f64.powf(bias.extra()), 1000.0)],
            );
        }
        assert_eq!(bias.extra(), 0.0);
    }

    #[test]
    fn the_larger_of_memory_and_time_holds() {
        let mut bias = BiasController::default();
        bias.set_time(0.5);
        bias.update(4, &camera(0.0), &[(0.5, 1.0)]);
        assert_eq!((bias.extra(), bias.memory()), (0.5, 0.0));
        // Four times too much in spite of it: one octave on top.
        bias.update(8, &camera(1.0), &[(3.6, 1.0)]);
        assert_eq!((bias.extra(), bias.memory()), (1.5, 1.5));
        // At two octaves a load of 0.35 leaves room for half an octave, which memory does not need.
        bias.set_time(2.0);
        bias.update(12, &camera(2.0), &[(0.35, 1.0)]);
        assert_eq!((bias.extra(), bias.memory()), (2.0, 1.5));
        bias.set_time(0.0);
        assert_eq!(bias.extra(), 1.5);
    }
}
