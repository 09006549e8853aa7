//! Colours and normals: looks, each predicted from looks that are known, and what is stored of them.
//!
//! The encoder is free to choose among the looks of which the same is stored, many where little is opaque; it takes the one that was
//! expected if it is among them, and one that samples further down may share. So ground, which has one look from its
//! surface down, is coded once per column.

use std::ops::Range;

use super::coder::{Coder, Model, Prob, residual};
use super::grid::{Grid, runs};
use super::meter::Part;
use super::slope;
use super::tables::{self, Look, flip};
use crate::steps::Steps;

/// What is known of a look.
#[derive(Clone, Copy)]
pub(super) struct Guess {
    /// The look that it may well be.
    pub(super) same: Look,
    /// What it is near to, if it is not that.
    near: Look,
    /// Where these are from: below [`SOURCES`].
    source: usize,
    /// How rough the surface is that the normal is from, 1 to 7; 0 if it is from normals.
    rough: usize,
}

impl Guess {
    pub(super) fn new(look: Look, source: usize) -> Self {
        Self {
            same: look,
            near: look,
            source,
            rough: 0,
        }
    }
}

/// Kinds of guesses.
const SOURCES: usize = 12;
/// Steps of [`Activity::step`].
const STEPS: usize = 6;

/// Means of how wrong guesses were of late.
#[derive(Clone, Copy, Default)]
struct Activity {
    color: i32,
    normal: i32,
}

impl Activity {
    fn step(mean: i32) -> usize {
        [4, 12, 32, 80, 200]
            .iter()
            .filter(|limit| mean >= **limit)
            .count()
    }

    fn add(&mut self, color: i32, normal: i32) {
        self.color += color * 4 - self.color / 4;
        self.normal += normal * 4 - self.normal / 4;
    }
}

/// Looks and what is stored of them.
pub(super) struct Looks {
    same: [Prob; SOURCES * STEPS],
    /// Whether the rest of a run has another look than its top; by how long it is.
    whole: [Prob; 3],
    /// By component and source, and by component and the residual before.
    residuals: [[Vec<Model>; 3]; 6],
    activity: [Activity; SOURCES],
    /// What looks are told in, but for those that are as expected.
    pub(super) steps: Steps,
    /// Whether something else is stored than that of some looks.
    odds: bool,
    /// Whether of this, and by how much it is off.
    odd: Prob,
    off: Vec<Model>,
}

/// Residuals told apart by those before.
const BEFORE: usize = 5;

fn size_class(residual: i8) -> usize {
    match residual.unsigned_abs() {
        0 => 0,
        1 => 1,
        2..4 => 2,
        4..8 => 3,
        _ => 4,
    }
}

impl Looks {
    pub(super) fn new(coder: &mut impl Coder, grid: &Grid) -> Self {
        let models = |n: usize| vec![Model::default(); n];
        Self {
            same: [Prob::default(); SOURCES * STEPS],
            whole: [Prob::default(); 3],
            residuals: std::array::from_fn(|_| {
                [
                    models(SOURCES * STEPS),
                    models(BEFORE * STEPS),
                    models(8 * BEFORE),
                ]
            }),
            activity: [Activity::default(); SOURCES],
            steps: Steps::within(coder.bits(4, u32::from(grid.error())) as u8),
            odds: coder.bits(1, u32::from(grid.odd_looks)) == 1,
            odd: Prob::default(),
            off: models(6),
        }
    }

    /// Codes the looks of a column's partial samples, of which all opacities are known, in the columns around too.
    pub(super) fn column<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, column: usize) {
        let first = column * grid.height;
        for run in runs(grid.columns[column].partial()) {
            let (top, end) = (first + run.start, first + run.end);
            let guess = sheet_guess(grid, column, top);
            let under = end + (grid.columns[column].solid >> run.end & 1) as usize;
            self.look(coder, grid, top..under, &guess);
            if end - top > 1 {
                coder.part(Part::Same);
                let differs = C::ENCODES && !has_looks(grid, top..end, &grid.look[top]);
                let context = (end - top).min(4) - 2;
                if coder.bit(&mut self.whole[context], differs) {
                    for at in top + 1..end {
                        let guess = below_guess(grid, at);
                        self.look(coder, grid, at..under, &guess);
                    }
                } else {
                    let look = grid.look[top];
                    grid.look[top + 1..end].fill(look);
                }
            }
            for at in top..end {
                self.stored(coder, grid, at);
            }
        }
    }

    /// Codes the look of a partial sample of whose column what is further down is not known.
    pub(super) fn surface<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, at: usize) {
        let column = at / grid.height;
        let place = at % grid.height;
        let partial = grid.columns[column].partial();
        let guess = if partial >> (place - 1) & 1 == 1 {
            below_guess(grid, at)
        } else {
            sheet_guess(grid, column, at)
        };
        let end = place + (partial >> place).trailing_ones() as usize;
        // Solid below has the look of its surface.
        let end = end + (grid.columns[column].solid >> end & 1) as usize;
        self.look(coder, grid, at..column * grid.height + end, &guess);
    }

    pub(super) fn look<C: Coder>(
        &mut self,
        coder: &mut C,
        grid: &mut Grid,
        run: Range<usize>,
        guess: &Guess,
    ) {
        let at = run.start;
        let activity = self.activity[guess.source];
        let row = guess.source * STEPS;
        let bounds = if C::ENCODES {
            shared_looks(grid, run, self.steps)
        } else {
            [[0; 2]; 6]
        };
        let nearest =
            |guess: &Look| -> Look { std::array::from_fn(|k| guess[k].clamp(bounds[k][0], bounds[k][1])) };
        let differs = C::ENCODES && nearest(&guess.same) != guess.same;
        let context = row + Activity::step(activity.color + activity.normal);
        coder.part(Part::Same);
        if !coder.bit(&mut self.same[context], differs) {
            grid.look[at] = guess.same;
            self.activity[guess.source].add(0, 0);
            return;
        }
        let contexts = [activity.color, activity.normal].map(|mean| row + Activity::step(mean));
        let mut found = guess.near;
        let mut wrong = [0; 2];
        let mut before = size_class(0);
        let mut green = 0;
        for k in [1, 0, 2, 3, 4, 5] {
            let near = guess.near[k];
            let expected = match k {
                // Red and blue are off where green is, as far as they are as bright.
                0 | 2 => {
                    let bright = i32::from(guess.near[1]).max(1);
                    let part = (2 * green * i32::from(near) + bright * green.signum()) / (2 * bright);
                    (i32::from(near) + part).clamp(0, 255) as u8
                }
                5 => third(&guess.near, &found),
                _ => near,
            };
            let zero = tables::ZERO[k];
            let expected = self.steps.number(zero, expected);
            let goal = if C::ENCODES {
                let [first, last] = self.steps.in_range(zero, bounds[k]);
                expected.clamp(first, last.max(first))
            } else {
                0
            };
            // Where all codes are steps, 256 of them are none.
            let off = (goal - expected) as i8;
            let [own, after, rough] = &mut self.residuals[k];
            let steps = contexts[k / 3];
            coder.part(LOOK[k]);
            let after = &mut after[before * STEPS + steps % STEPS];
            let off = if k < 3 || guess.rough == 0 {
                residual(coder, [&mut own[steps], after], off)
            } else {
                residual(coder, [&mut rough[guess.rough * BEFORE + before], after], off)
            };
            before = size_class(off);
            found[k] = self.steps.code(zero, expected + i32::from(off));
            wrong[k / 3] += i32::from(off).abs();
            if k == 1 {
                green = i32::from(off) * self.steps.step();
            }
        }
        grid.look[at] = found;
        self.activity[guess.source].add(wrong[0], wrong[1]);
    }

    /// Codes what is stored of a sample whose look and opacity are known.
    pub(super) fn stored(&mut self, coder: &mut impl Coder, grid: &mut Grid, at: usize) {
        let expected = tables::stored(grid.alpha[at], &grid.look[at]);
        let goal = grid.stored[at];
        grid.stored[at] = expected;
        coder.part(Part::Odd);
        if self.odds && coder.bit(&mut self.odd, goal != expected) {
            for (k, model) in self.off.iter_mut().enumerate() {
                let off = goal[k].wrapping_sub(expected[k]).cast_signed();
                let off = residual(coder, [model], off);
                grid.stored[at][k] = expected[k].wrapping_add(off.cast_unsigned());
            }
        }
    }
}

/// First and last of the looks of which a sample is stored, by component, and of those below it too as far as that goes.
fn shared_looks(grid: &Grid, run: Range<usize>, steps: Steps) -> [[u8; 2]; 6] {
    let looks = |at: usize| tables::looks(grid.alpha[at], &grid.stored[at]);
    let mut shared = looks(run.start);
    let mut open = [true; 6];
    for at in run.skip(1) {
        let next = looks(at);
        for k in 0..6 {
            let both = [shared[k][0].max(next[k][0]), shared[k][1].min(next[k][1])];
            open[k] &= both[0] <= both[1] && tables::has_step(steps, k, both);
            if open[k] {
                shared[k] = both;
            }
        }
    }
    shared
}

/// The median of two neighbours and of the plane through them and the one that both have (after the predictor of LOCO-I).
pub(super) fn plane(west: &Look, south: &Look, corner: &Look) -> Look {
    std::array::from_fn(|k| {
        let (low, high) = (west[k].min(south[k]), west[k].max(south[k]));
        let plane = i16::from(west[k]) + i16::from(south[k]) - i16::from(corner[k]);
        plane.clamp(low.into(), high.into()) as u8
    })
}

fn middle(a: &Look, b: &Look) -> Look {
    std::array::from_fn(|k| a[k].midpoint(b[k]))
}

/// The parts of a look, for a meter.
const LOOK: [Part; 6] = [
    Part::Red,
    Part::Green,
    Part::Blue,
    Part::NormalX,
    Part::NormalY,
    Part::NormalZ,
];

/// Whether all samples are stored as this look says.
fn has_looks(grid: &Grid, mut samples: Range<usize>, look: &Look) -> bool {
    samples.all(|n| tables::stored(grid.alpha[n], look) == grid.stored[n])
}

/// The sum of squares of the normal's x and y, and of its z.
fn squares(look: &Look) -> [i32; 2] {
    let [.., x, y, z] = *look;
    let [x, y, z] = [x, y, z].map(|v| i32::from(flip(v).cast_signed()));
    [x * x + y * y, z * z]
}

/// Below the first, the z of a normal is nearly level: small errors of the other parts are large ones of it. From the second on
/// they are not.
const LEVEL: [u8; 2] = [40, 80];

/// The normal's z by the other two, if it is as long as another.
fn third(near: &Look, found: &Look) -> u8 {
    const UNIT: i32 = 127 * 127;
    let [across, up] = squares(near);
    let long = across + up;
    // As good as one: rounding makes it shorter or longer.
    let long = if long > 125 * 125 { UNIT } else { long };
    let left = (long - squares(found)[0]).max(0) as u32;
    // Rounded.
    let z = (4 * left).isqrt().div_ceil(2);
    let z = z.min(127) as u8;
    let z = if near[5] < 0x80 { 0x80 - z } else { 0x80 + z };
    match z.abs_diff(0x80) {
        up if up < LEVEL[0] => near[5],
        up if up < LEVEL[1] => z.midpoint(near[5]),
        _ => z,
    }
}

/// The look of a partial sample below another.
fn below_guess(grid: &Grid, at: usize) -> Guess {
    let [dx, dy, dz] = grid.steps();
    // The sheet goes on as it does beside.
    let above = grid.look[at - dz];
    let is_partial = |n: usize| grid.columns[n / grid.height].partial() >> (n % grid.height) & 1 == 1;
    let beside = [at - dx, at - dy]
        .into_iter()
        .filter(|n| is_partial(*n) && is_partial(n - dz));
    let (mut change, mut count) = ([0i16; 6], 0);
    for n in beside {
        count += 1;
        (0..6).for_each(|k| change[k] += i16::from(grid.look[n][k]) - i16::from(grid.look[n - dz][k]));
    }
    let near = std::array::from_fn(|k| (i16::from(above[k]) + change[k] / count.max(1)).clamp(0, 255) as u8);
    Guess {
        same: above,
        near,
        source: 5,
        rough: 0,
    }
}

/// The look of a partial sample at the top of a run, by those of the columns before, at the nearest height.
fn sheet_guess(grid: &Grid, column: usize, at: usize) -> Guess {
    let place = at % grid.height;
    let near = |column: usize| grid.nearest(column, place).map(|n| grid.look[n]);
    let (west, south, corner) = (
        near(column - 1),
        near(column - grid.row),
        near(column - grid.row - 1),
    );
    let mut guess = match (west, south, corner) {
        (Some(west), Some(south), Some(corner)) => Guess::new(plane(&west, &south, &corner), 0),
        (Some(west), Some(south), None) => Guess::new(middle(&west, &south), 1),
        (Some(west), None, _) => Guess::new(west, 2),
        (None, Some(south), _) => Guess::new(south, 3),
        (None, None, Some(corner)) => Guess::new(corner, 3),
        (None, None, None) => Guess::new([128, 128, 128, 128, 128, 255], 4),
    };
    if !grid.axes
        && let Some((normal, rough)) = slope::normal(grid, column, at)
    {
        guess.near[3..].copy_from_slice(&normal);
        guess.rough = rough;
    }
    guess
}
