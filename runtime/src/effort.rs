//! Adaptive effort: the extra bias and the scale of the picture that keep a frame within a time.
//!
//! Efforts are the rungs of one ladder. Rung r asks for levels r/8 octaves coarser than wanted, and the picture is drawn at
//! the largest of the scales 1, 2^-¼, 2^-½, 2^-¾ and ½ whose pixels are no larger than that: levels change by an eighth of an octave at
//! a time, which their fade hides, and do not change when the scale does; a scaled picture has no more voxels to a pixel
//! than a whole one.
//!
//! Costs are predicted from what was measured: time of the rays ∝ pixels, times a ratio per octave of bias that is fitted to the
//! measurements, and what else a frame takes as it was. Each measurement comes with how its frame was drawn, so
//! it does not matter how late it is.
//!
//! - A miss, the median of the last five predictions for the rung in use, begins a descent: one rung a frame, until nine
//!   tenths of the time are not exceeded.
//! - It goes back a rung only if the finer one is predicted to take less than 80 %, and not before a wait; four times that where the
//!   scale changes. A miss soon after going back is answered by the rung it came from alone, and multiplies the wait, until the load
//!   is lighter by a fifth than it was then. So a constant load has no cycle but between two neighbours, of a long period.
//! - While the camera rests the picture sharpens by a rung a frame, up to full effort, and stays. The next movement begins at the rung of the last
//!   one.
//!
//! Pure and deterministic. Called by the render thread, once a frame.

use std::collections::VecDeque;

use crate::caster::Feedback;

/// Rungs to an octave of bias: as much of a change as the fade hides.
const RUNGS: u32 = 8;
/// The last rung: beyond two octaves voxels are wider than the pixels of the smallest picture.
const LAST: u32 = 2 * RUNGS;
/// Part of the time that a descent is content with.
const AIM: f64 = 0.9;
/// Part of the time that a finer rung may take by prediction.
const RETURN: f64 = 0.8;
/// Measurements of which the median tells a miss, and whose mean predicts what a finer rung takes.
const FEW: usize = 5;
const MANY: usize = 32;
/// Frames between two rungs on the way back, at first and at most, and how it grows.
const WAIT: u32 = 8;
const LONGEST_WAIT: u32 = 2048;
const WAIT_GROWTH: u32 = 4;
/// What the wait for a larger picture is multiplied by.
const SCALE_WAITS: u32 = 4;
/// A miss within so many frames of going back came of it.
const PROBATION: u32 = 256;
/// Frames after the answer to it until measurements are those of that answer.
const GRACE: u32 = 5;
/// Frames at rest before the picture sharpens: a camera may halt for a frame.
const REST: u32 = 4;
/// Part of the load that once was too much below which it counts as another one.
const LIGHTER: f64 = 0.8;

/// How much of a picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Added to the wanted bias, at least 0; in octaves of the whole picture's pixels.
    pub bias: f64,
    /// Part of the pixels per axis that are drawn.
    pub scale: f64,
}

impl Effort {
    /// All of it.
    pub const FULL: Self = Self {
        bias: 0.0,
        scale: 1.0,
    };

    fn of(rung: u32) -> Self {
        let quarters = (rung * 4 / RUNGS).min(4);
        Self {
            bias: f64::from(rung) / f64::from(RUNGS),
            scale: (-0.25 * f64::from(quarters)).exp2(),
        }
    }

    /// Pixels that are drawn of a picture of `width` × `height`; at least one.
    pub fn size(self, width: u32, height: u32) -> [u32; 2] {
        [width, height].map(|side| ((f64::from(side) * self.scale).round() as u32).max(1))
    }
}

/// How a frame was drawn and what it took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Rays.
    pub pixels: f64,
    /// Bias in effect, all parts of it.
    pub bias: f64,
    /// Milliseconds of the rays.
    pub cast_ms: f64,
    /// Milliseconds of all else.
    pub other_ms: f64,
}

impl Cost {
    /// With the time on the device added, to the submission by `self`: that of the rays by timestamps, where there are any, else until
    /// the device was heard to be done.
    pub(crate) fn on_device(self, feedback: &Feedback, uploaded: bool) -> Self {
        let [upload, cast, compaction] = feedback.gpu_ms;
        let upload = if uploaded { upload } else { 0.0 };
        Self {
            cast_ms: if cast > 0.0 { cast } else { feedback.done_ms },
            other_ms: self.other_ms + upload + compaction,
            ..self
        }
    }
}

/// What is asked of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Milliseconds that it may take.
    pub target_ms: f64,
    /// Pixels of the whole picture.
    pub pixels: f64,
    /// The user's bias.
    pub bias: f64,
    /// What memory adds to it at least.
    pub memory: f64,
    /// Whether the camera is that of the frame before.
    pub rests: bool,
}

/// By how much a picture gets cheaper with each octave of bias: the slope of a line through the logarithms of
/// (bias, milliseconds per pixel), which forgets, and which is drawn to what is usual until biases have differed.
#[derive(Clone, Debug, Default)]
struct Octave {
    mean: Option<[f64; 2]>,
    spread: f64,
    product: f64,
}

impl Octave {
    const FORGET: f64 = 0.02;
    const USUAL: f64 = 1.3;
    /// Variance of biases, in octaves², with which the measured slope counts as much as the usual one.
    const WEIGHT: f64 = 0.02;
    /// Cheaper per octave than a surface's bricks get fewer is not to be believed.
    const MOST: f64 = 4.0;

    fn learn(&mut self, bias: f64, log_cost: f64) {
        let mean = self.mean.get_or_insert([bias, log_cost]);
        let [x, y] = [bias - mean[0], log_cost - mean[1]];
        mean[0] += Self::FORGET * x;
        mean[1] += Self::FORGET * y;
        // What says nothing new takes the place of nothing known.
        let kept = 1.0 - Self::FORGET * (x * x / Self::WEIGHT).min(1.0);
        self.spread = kept * self.spread + Self::FORGET * x * x;
        self.product = kept * self.product + Self::FORGET * x * y;
    }

    /// What a cost is divided by for one more octave; at least 1.
    fn ratio(&self) -> f64 {
        let slope = (self.product - Self::WEIGHT * Self::USUAL.ln()) / (self.spread + Self::WEIGHT);
        (-slope).exp().clamp(1.0, Self::MOST)
    }
}

/// Chooses the effort of each frame.
#[derive(Clone, Debug)]
pub struct EffortController {
    /// The rung of movements, and the one in use, which is finer at rest.
    moving: u32,
    shown: u32,
    costs: VecDeque<Cost>,
    octave: Octave,
    descending: bool,
    /// Frames in motion since the rung changed, and since it last became finer.
    calm: u32,
    since_return: u32,
    resting: u32,
    wait: u32,
    grace: u32,
    /// The rung on which going back last failed, and milliseconds of its frames as predicted after that, from the coarser one:
    /// what is compared later is predicted from there, too.
    failed: Option<(u32, Option<f64>)>,
}

impl Default for EffortController {
    fn default() -> Self {
        Self {
            moving: 0,
            shown: 0,
            costs: VecDeque::with_capacity(MANY),
            octave: Octave::default(),
            descending: false,
            calm: 0,
            since_return: PROBATION,
            resting: 0,
            wait: WAIT,
            grace: 0,
            failed: None,
        }
    }
}

impl EffortController {
    /// Takes a frame's cost, whenever it is known.
    pub fn measured(&mut self, cost: Cost) {
        let log_cost = (cost.cast_ms / cost.pixels).ln();
        if !(log_cost.is_finite() && cost.bias.is_finite() && cost.other_ms.is_finite()) {
            return;
        }
        self.octave.learn(cost.bias, log_cost);
        if self.costs.len() == MANY {
            self.costs.pop_front();
        }
        self.costs.push_back(cost);
    }

    /// The effort of the next frame; full without a target, which changes nothing about the next movement with one.
    pub fn next(&mut self, wanted: Option<&Wanted>) -> Effort {
        let Some(wanted) = wanted else {
            self.shown = 0;
            return Effort::FULL;
        };
        if wanted.rests {
            self.resting += 1;
            if self.resting > REST {
                self.shown = self.shown.saturating_sub(1);
            }
        } else {
            self.resting = 0;
            self.adapt(wanted);
            self.shown = self.moving;
        }
        Effort::of(self.shown)
    }

    fn adapt(&mut self, wanted: &Wanted) {
        self.calm = self.calm.saturating_add(1);
        self.since_return = self.since_return.saturating_add(1);
        let Some(now) = self.few(wanted, self.moving) else {
            return;
        };
        self.grace = self.grace.saturating_sub(1);
        let is_miss = now > wanted.target_ms && self.grace == 0 && self.moving < LAST;
        if is_miss && !self.descending && self.since_return < PROBATION {
            self.wait = (self.wait * WAIT_GROWTH).min(LONGEST_WAIT);
            self.failed = Some((self.moving, None));
            self.moving += 1;
            (self.calm, self.since_return, self.grace) = (0, PROBATION, GRACE);
            return;
        }
        let goes_on = self.descending && now > AIM * wanted.target_ms && self.moving < LAST;
        self.descending = is_miss || goes_on;
        if self.descending {
            self.moving += 1;
            self.calm = 0;
            return;
        }
        let Some(finer) = self.moving.checked_sub(1) else {
            return;
        };
        if let Some((rung, then)) = self.failed {
            let ms = self.many(wanted, rung);
            if then.is_some_and(|then| ms < LIGHTER * then) {
                (self.wait, self.failed) = (WAIT, None);
            } else if then.is_none() && self.calm >= MANY as u32 {
                self.failed = Some((rung, Some(ms)));
            }
        }
        let is_larger = Effort::of(finer).scale > Effort::of(self.moving).scale;
        let wait = if is_larger {
            SCALE_WAITS * self.wait
        } else {
            self.wait
        };
        let most = RETURN * wanted.target_ms;
        let fits = |ms: f64| ms < most;
        if self.calm >= wait && self.few(wanted, finer).is_some_and(fits) && fits(self.many(wanted, finer)) {
            self.moving = finer;
            (self.calm, self.since_return) = (0, 0);
        }
    }

    /// What a frame on a rung would take, by the latest measurements, newest first.
    fn predictions(&self, wanted: &Wanted, rung: u32) -> impl Iterator<Item = f64> {
        let Effort { bias, scale } = Effort::of(rung);
        let bias = wanted.bias + bias.max(wanted.memory);
        let pixels = wanted.pixels * scale * scale;
        let ratio = self.octave.ratio();
        (self.costs.iter().rev())
            .map(move |c| c.other_ms + c.cast_ms * (pixels / c.pixels) * ratio.powf(c.bias - bias))
    }

    fn few(&self, wanted: &Wanted, rung: u32) -> Option<f64> {
        let mut few: Vec<f64> = self.predictions(wanted, rung).take(FEW).collect();
        few.sort_by(f64::total_cmp);
        few.get(few.len() / 2).copied()
    }

    fn many(&self, wanted: &Wanted, rung: u32) -> f64 {
        self.predictions(wanted, rung).sum::<f64>() / self.costs.len() as f64
    }
}

#[cfg(test)]
mod tests;
