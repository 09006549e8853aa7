//! Colours and normals: looks, each predicted from looks that are known, and what is stored of them.
//!
//! The encoder is free to choose among the looks of which the same is stored, many where little is opaque; it takes the one that was
//! expected if it is among them, and one that samples further down may share. So ground, which has one look from its
//! surface down, is coded once per column.

use std::ops::Range;

use super::coder::{Coder, Model, Prob, residual};
use super::grid::{Grid, PARTIAL, SOLID};
use super::tables::{self, Look};
use crate::value::SOLID_ALPHA;

/// What is known of a look.
#[derive(Clone, Copy)]
struct Guess {
    /// The look that it may well be.
    same: Look,
    /// What it is near to, if it is not that.
    near: Look,
    /// Where these are from: below [`SOURCES`].
    source: usize,
}

impl Guess {
    fn new(look: Look, source: usize) -> Self {
        Self {
            same: look,
            near: look,
            source,
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
    /// By component and source, and by component and the residual before.
    residuals: [[Vec<Model>; 2]; 6],
    activity: [Activity; SOURCES],
    /// Whether a column of solid is not as expected.
    solid: Prob,
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
            residuals: std::array::from_fn(|_| [models(SOURCES * STEPS), models(BEFORE * STEPS)]),
            activity: [Activity::default(); SOURCES],
            solid: Prob::default(),
            odds: coder.bits(1, u32::from(grid.has_odd_looks())) == 1,
            odd: Prob::default(),
            off: models(6),
        }
    }

    /// Codes the look of a partial sample. `column` goes on below it.
    pub(super) fn surface<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, at: usize, end: usize) {
        let guess = surface_guess(grid, at);
        let run = (at..end).find(|k| grid.class[*k] != PARTIAL).unwrap_or(end);
        // Solid below has the look of its surface.
        let run = run + usize::from(grid.class[run] == SOLID);
        self.look(coder, grid, at..run, &guess);
    }

    /// Codes looks and colours of all solid samples of a column; partial ones are known, also in the columns around.
    pub(super) fn solid<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, column: Range<usize>) {
        if !grid.class[column.clone()].contains(&SOLID) {
            return;
        }
        // Mostly it is all as expected.
        let differs = C::ENCODES
            && !expected_solid(grid, column.clone(), |grid, at, look| {
                tables::stored(SOLID_ALPHA, look) == grid.stored[at]
            });
        if coder.bit(&mut self.solid, differs) {
            self.each_solid(coder, grid, column);
        } else if !C::ENCODES {
            expected_solid(grid, column, |grid, at, look| {
                grid.stored[at] = tables::stored(SOLID_ALPHA, look);
                true
            });
        }
    }

    fn each_solid<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, column: Range<usize>) {
        let mut above = None;
        for at in column {
            if grid.class[at] != SOLID {
                above = (grid.class[at] == PARTIAL).then(|| grid.look[at]);
                continue;
            }
            let (guess, beside) = solid_guess(grid, at, above);
            self.look(coder, grid, at..at + 1, &guess);
            self.stored(coder, grid, at);
            if !beside {
                above = Some(grid.look[at]);
            }
        }
    }

    fn look<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, run: Range<usize>, guess: &Guess) {
        let at = run.start;
        let activity = self.activity[guess.source];
        let row = guess.source * STEPS;
        let bounds = if C::ENCODES {
            shared_looks(grid, run)
        } else {
            [[0; 2]; 6]
        };
        let nearest =
            |guess: &Look| -> Look { std::array::from_fn(|k| guess[k].clamp(bounds[k][0], bounds[k][1])) };
        let differs = C::ENCODES && nearest(&guess.same) != guess.same;
        let context = row + Activity::step(activity.color + activity.normal);
        if !coder.bit(&mut self.same[context], differs) {
            grid.look[at] = guess.same;
            self.activity[guess.source].add(0, 0);
            return;
        }
        let goal = if C::ENCODES {
            nearest(&guess.near)
        } else {
            guess.near
        };
        let contexts = [activity.color, activity.normal].map(|mean| row + Activity::step(mean));
        let mut found = guess.near;
        let mut wrong = [0; 2];
        let mut before = size_class(0);
        // Red and blue are off where green is.
        let mut green = 0i32;
        for k in [1, 0, 2, 3, 4, 5] {
            let expected = match k {
                0 | 2 => (i32::from(guess.near[k]) + green).clamp(0, 255) as u8,
                _ => guess.near[k],
            };
            let off = goal[k].wrapping_sub(expected).cast_signed();
            let [own, after] = &mut self.residuals[k];
            let steps = contexts[k / 3];
            let off = residual(
                coder,
                [&mut own[steps], &mut after[before * STEPS + steps % STEPS]],
                off,
            );
            before = size_class(off);
            found[k] = expected.wrapping_add(off.cast_unsigned());
            wrong[k / 3] += i32::from(off).abs();
            if k == 1 {
                green = i32::from(off);
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
fn shared_looks(grid: &Grid, run: Range<usize>) -> [[u8; 2]; 6] {
    let looks = |at: usize| tables::looks(grid.alpha[at], &grid.stored[at]);
    let mut shared = looks(run.start);
    let mut open = [true; 6];
    for at in run.skip(1) {
        let next = looks(at);
        for k in 0..6 {
            let both = [shared[k][0].max(next[k][0]), shared[k][1].min(next[k][1])];
            open[k] &= both[0] <= both[1];
            if open[k] {
                shared[k] = both;
            }
        }
    }
    shared
}

/// The median of two neighbours and of the plane through them and the one that both have (after the predictor of LOCO-I).
fn plane(west: &Look, south: &Look, corner: &Look) -> Look {
    std::array::from_fn(|k| {
        let (low, high) = (west[k].min(south[k]), west[k].max(south[k]));
        let plane = i16::from(west[k]) + i16::from(south[k]) - i16::from(corner[k]);
        plane.clamp(low.into(), high.into()) as u8
    })
}

fn middle(a: &Look, b: &Look) -> Look {
    std::array::from_fn(|k| a[k].midpoint(b[k]))
}

fn surface_guess(grid: &Grid, at: usize) -> Guess {
    let [dx, dy, dz] = grid.step;
    let is_partial = |n: &usize| grid.class[*n] == PARTIAL;
    if is_partial(&(at - dz)) {
        // The sheet goes on as it does beside.
        let above = grid.look[at - dz];
        let beside = [at - dx, at - dy]
            .into_iter()
            .filter(|n| is_partial(n) && is_partial(&(n - dz)));
        let (mut change, mut count) = ([0i16; 6], 0);
        for n in beside {
            count += 1;
            (0..6).for_each(|k| change[k] += i16::from(grid.look[n][k]) - i16::from(grid.look[n - dz][k]));
        }
        let near =
            std::array::from_fn(|k| (i16::from(above[k]) + change[k] / count.max(1)).clamp(0, 255) as u8);
        return Guess {
            same: above,
            near,
            source: 5,
        };
    }
    // The sheet in another column, at the nearest height.
    let near = |column: usize| {
        let n = at - column;
        let heights = [n, n - 1, n + 1, n - 2, n + 2];
        heights.into_iter().find(is_partial).map(|n| grid.look[n])
    };
    match (near(dx), near(dy), near(dx + dy)) {
        (Some(west), Some(south), Some(corner)) => Guess::new(plane(&west, &south, &corner), 0),
        (Some(west), Some(south), None) => Guess::new(middle(&west, &south), 1),
        (Some(west), None, _) => Guess::new(west, 2),
        (None, Some(south), _) => Guess::new(south, 3),
        (None, None, Some(corner)) => Guess::new(corner, 3),
        (None, None, None) => Guess::new([128; 6], 4),
    }
}

/// The mean look of the surfaces around a sample, if there are any: deep solid has it beside them.
fn beside(grid: &Grid, at: usize) -> Option<Look> {
    let [dx, dy, _] = grid.step;
    let first = at - dx - dy;
    let columns: [usize; 9] = std::array::from_fn(|k| first + k % 3 * dx + k / 3 * dy);
    let partial = |n: usize| {
        let classes = grid.class[n - 1..n + 3].try_into().map_or(0, u32::from_le_bytes);
        classes & 0x01_0101
    };
    if columns.iter().fold(0, |any, n| any | partial(*n)) == 0 {
        return None;
    }
    let (mut sum, mut count) = ([0u32; 6], 0);
    for n in columns
        .into_iter()
        .flat_map(|n| n - 1..n + 2)
        .filter(|n| grid.class[*n] == PARTIAL)
    {
        count += 1;
        (0..6).for_each(|k| sum[k] += u32::from(grid.look[n][k]));
    }
    Some(sum.map(|s| ((s + count / 2) / count) as u8))
}

/// What is known of the look of solid; and whether from surfaces beside it. `above` is what the column has had.
#[inline]
fn solid_guess(grid: &Grid, at: usize, above: Option<Look>) -> (Guess, bool) {
    let [dx, dy, dz] = grid.step;
    let covered = grid.class[at - dz] == SOLID;
    if let Some(look) = if covered { beside(grid, at) } else { None } {
        return (Guess::new(look, 6), true);
    }
    let known = |n: usize| (grid.class[n] == SOLID).then(|| grid.look[n]);
    let guess = match (above, known(at - dz), known(at - dx), known(at - dy)) {
        (Some(look), ..) => Guess::new(look, if covered { 7 } else { 8 }),
        (_, Some(look), ..) => Guess::new(look, 9),
        (_, _, Some(west), Some(south)) => {
            let corner = known(at - dx - dy).unwrap_or(west);
            Guess::new(plane(&west, &south, &corner), 10)
        }
        (_, _, Some(one), None) | (_, _, None, Some(one)) => Guess::new(one, 11),
        (None, None, None, None) => Guess::new([128; 6], 4),
    };
    (guess, false)
}

/// Gives the solid samples of a column the looks that are expected, as long as the call agrees; whether it did to the end.
fn expected_solid(
    grid: &mut Grid,
    column: Range<usize>,
    mut agrees: impl FnMut(&mut Grid, usize, &Look) -> bool,
) -> bool {
    let mut above = None;
    for at in column {
        if grid.class[at] != SOLID {
            above = (grid.class[at] == PARTIAL).then(|| grid.look[at]);
            continue;
        }
        let (Guess { same, .. }, beside) = solid_guess(grid, at, above);
        if !agrees(grid, at, &same) {
            return false;
        }
        grid.look[at] = same;
        if !beside {
            above = Some(same);
        }
    }
    true
}
