//! Colours and normals: looks, each predicted from looks that are known, and what is stored of them.
//!
//! The encoder is free to choose among the looks of which the same is stored, many where little is opaque; it takes the one that was
//! expected if it is among them, and one that samples further down may share. So ground, which has one look from its
//! surface down, is coded once per column.

use std::ops::Range;

use super::coder::{Coder, Prob, Residual};
use super::grid::{Grid, PARTIAL, SOLID};
use super::tables::{self, Look};

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
    same: Vec<Prob>,
    residuals: [Vec<Residual>; 6],
    activity: [Activity; SOURCES],
    /// Whether something else is stored than that of a look, and by how much it is off.
    odd: Prob,
    off: [Residual; 6],
}

impl Looks {
    pub(super) fn new() -> Self {
        Self {
            same: vec![Prob::default(); SOURCES * STEPS],
            residuals: std::array::from_fn(|_| vec![Residual::default(); SOURCES * STEPS]),
            activity: [Activity::default(); SOURCES],
            odd: Prob::default(),
            off: std::array::from_fn(|_| Residual::default()),
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
        let mut column_look = None;
        for at in column {
            if grid.class[at] != SOLID {
                column_look = (grid.class[at] == PARTIAL).then(|| grid.look[at]);
                continue;
            }
            let below_solid = grid.class[at - 1] == SOLID;
            let beside = if below_solid { beside(grid, at) } else { None };
            let guess = beside.map_or_else(|| solid_guess(grid, at, column_look), |look| Guess::new(look, 6));
            self.look(coder, grid, at..at + 1, &guess);
            self.stored(coder, grid, at);
            if beside.is_none() {
                column_look = Some(grid.look[at]);
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
        // Red and blue are off where green is.
        let mut green = 0i32;
        for k in [1, 0, 2, 3, 4, 5] {
            let expected = match k {
                0 | 2 => (i32::from(guess.near[k]) + green).clamp(0, 255) as u8,
                _ => guess.near[k],
            };
            let off = goal[k].wrapping_sub(expected).cast_signed();
            let off = self.residuals[k][contexts[k / 3]].code(coder, off);
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
        if coder.bit(&mut self.odd, goal != expected) {
            for (k, residual) in self.off.iter_mut().enumerate() {
                let off = residual.code(coder, goal[k].wrapping_sub(expected[k]).cast_signed());
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
    let (mut sum, mut count) = ([0u32; 6], 0);
    for column in [0, dx, 2 * dx].map(|x| at + x - dx) {
        for middle in [0, dy, 2 * dy].map(|y| column + y - dy) {
            for n in (middle - 1..middle + 2).filter(|n| grid.class[*n] == PARTIAL) {
                count += 1;
                (0..6).for_each(|k| sum[k] += u32::from(grid.look[n][k]));
            }
        }
    }
    (count > 0).then(|| sum.map(|s| ((s + count / 2) / count) as u8))
}

fn solid_guess(grid: &Grid, at: usize, column: Option<Look>) -> Guess {
    let [dx, dy, dz] = grid.step;
    let known = |n: usize| (grid.class[n] == SOLID).then(|| grid.look[n]);
    if let Some(look) = column {
        return Guess::new(look, if grid.class[at - dz] == SOLID { 7 } else { 8 });
    }
    match (known(at - dz), known(at - dx), known(at - dy)) {
        (Some(above), ..) => Guess::new(above, 9),
        (_, Some(west), Some(south)) => {
            let corner = known(at - dx - dy).unwrap_or(west);
            Guess::new(plane(&west, &south, &corner), 10)
        }
        (_, Some(one), None) | (_, None, Some(one)) => Guess::new(one, 11),
        (None, None, None) => Guess::new([128; 6], 4),
    }
}
