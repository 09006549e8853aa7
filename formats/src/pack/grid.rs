//! The samples of a chunk in the box that covers its bricks, with room around it so that neighbours need no checks.
//!
//! Columns run along z from the top down. What a column has where is bits of words ([`Column`]), so that runs and neighbours are
//! found without looking at samples; samples themselves are only touched where something is.

use std::ops::Range;

use glam::UVec3;

use super::tables::{self, Look, flip};
use crate::steps::Steps;
use crate::value::{SOLID_ALPHA, opacity_level, opacity_of_level};

/// Samples of air on each side of the box: west and east, south and north; above and below.
const PAD: [usize; 3] = [1, 1, 4];

/// Which samples of a column are what: bit k is the sample at k of the column's samples, air above the box included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Column {
    /// Those that bricks have. All others are none of the following.
    pub(super) covered: u64,
    /// Those that are not empty.
    pub(super) some: u64,
    /// Those that are as opaque as solid ground, against all axes.
    pub(super) solid: u64,
}

impl Column {
    /// Neither empty nor solid.
    #[inline]
    pub(super) fn partial(self) -> u64 {
        self.some & !self.solid
    }
}

/// Runs of set bits, from the lowest on.
pub(super) fn runs(mut bits: u64) -> impl Iterator<Item = Range<usize>> {
    std::iter::from_fn(move || {
        if bits == 0 {
            return None;
        }
        let start = bits.trailing_zeros();
        let end = start + (bits >> start).trailing_ones();
        bits &= u64::MAX.checked_shl(end).unwrap_or(0);
        Some(start as usize..end as usize)
    })
}

/// Set bits, from the lowest on.
pub(super) fn bits(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        if bits == 0 {
            return None;
        }
        let first = bits.trailing_zeros();
        bits &= bits - 1;
        Some(first as usize)
    })
}

/// Colour, normal and opacities.
type Sample = ([u8; 4], [i8; 4], [u8; 4]);

/// Columns in rows along x, rows along y.
pub(crate) struct Grid {
    size: [usize; 3],
    /// Samples of a column.
    pub(super) height: usize,
    /// Columns of a row.
    pub(super) row: usize,
    /// Whether there are opacities against the axes.
    pub(super) axes: bool,
    /// Looks are to be in steps by which none is off by more.
    error: u8,
    /// Whether a sample was set that is stored of no look in these steps, of no look at all, with an opacity that is none of
    /// the levels that builders keep to.
    off_steps: bool,
    pub(super) odd_looks: bool,
    pub(super) odd_opacities: bool,
    /// The sample that was looked at last.
    judged: (u8, Look, [u8; 3]),
    pub(super) columns: Vec<Column>,
    pub(super) alpha: Vec<u8>,
    pub(super) opacity: Vec<[u8; 3]>,
    /// What is stored of colour and normal.
    pub(super) stored: Vec<Look>,
    /// What that is of.
    pub(super) look: Vec<Look>,
    /// Of partial samples, where the surface of their run is: samples from the column's top, in 1/256.
    pub(super) depth: Vec<i16>,
}

impl Grid {
    /// A box of so many samples per axis, at most 56 along z; no brick has any of them. Looks that will be set are in steps by which
    /// none is off by more than `error` ([`Steps`]); if one is not, none counts as such.
    pub(crate) fn new(size: UVec3, axes: bool, error: u8) -> Self {
        let size = size.to_array().map(|s| s as usize);
        let [row, rows, height]: [usize; 3] = std::array::from_fn(|k| size[k] + 2 * PAD[k]);
        let n = row * rows * height;
        Self {
            size,
            height,
            row,
            axes,
            error: error.min(Steps::MOST),
            off_steps: false,
            odd_looks: false,
            odd_opacities: false,
            judged: Default::default(),
            columns: vec![Column::default(); row * rows],
            alpha: vec![0; n],
            opacity: if axes { vec![[0; 3]; n] } else { Vec::new() },
            stored: vec![[0; 6]; n],
            look: vec![[0; 6]; n],
            depth: vec![0; n],
        }
    }

    /// Index of the sample at x, y and so many samples below the top.
    #[inline]
    pub(crate) fn index(&self, [x, y, down]: [usize; 3]) -> usize {
        ((y + PAD[1]) * self.row + x + PAD[0]) * self.height + down + PAD[2]
    }

    /// The numbers of the box's columns.
    pub(super) fn inside(&self) -> impl Iterator<Item = usize> + use<> {
        let ([sx, sy, _], row) = (self.size, self.row);
        (0..sy).flat_map(move |y| (y + PAD[1]) * row + PAD[0]..(y + PAD[1]) * row + PAD[0] + sx)
    }

    /// Distances of neighbours along x, along y, and one below the other.
    #[inline]
    pub(super) fn steps(&self) -> [usize; 3] {
        [self.height, self.height * self.row, 1]
    }

    /// Whether a column is the second along x and y of the 2×2 cells that make one of the coarser level.
    pub(super) fn in_pair(&self, column: usize) -> [bool; 2] {
        // Bricks of centres begin a sample before their cells.
        let before = self.size[0] % 8 / 2;
        [column % self.row, column / self.row].map(|k| (k + before + PAD[0]) % 2 == 1)
    }

    /// Says that a brick has so many samples from one down.
    #[inline]
    pub(crate) fn announce(&mut self, top: usize, count: usize) {
        self.columns[top / self.height].covered |= ((1 << count) - 1) << (top % self.height);
    }

    /// Sets a sample of a brick; false if another brick has it otherwise.
    #[inline]
    pub(crate) fn set(&mut self, at: usize, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) -> bool {
        let covered = self.columns[at / self.height].covered >> (at % self.height) & 1 == 1;
        if covered {
            let (own_color, [x, y, z, _], [ox, oy, oz, _]) = self.get(at);
            let opacities = !self.axes || [ox, oy, oz] == opacity[..3];
            return opacities && own_color == color && [x, y, z] == normal[..3];
        }
        self.announce(at, 1);
        self.put(at, color, normal, opacity);
        true
    }

    /// Sets a sample that has been announced and is nothing yet; nothing happens to one that has not.
    #[inline]
    pub(crate) fn put(&mut self, at: usize, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) {
        self.put_run(at..at + 1, color, normal, opacity);
    }

    /// The same for samples below each other.
    #[inline]
    pub(crate) fn put_run(&mut self, run: Range<usize>, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) {
        let ([r, g, b, a], [x, y, z]) = (color, [0, 1, 2].map(|k| flip(normal[k] as u8)));
        let [ox, oy, oz, _] = opacity;
        if run.is_empty() || (a, opacity, color, normal) == (0, [0; 4], [0; 4], [0; 4]) {
            return;
        }
        let column = &mut self.columns[run.start / self.height];
        let bits = ((1 << run.len()) - 1) << (run.start % self.height) & column.covered;
        if bits == 0 {
            return;
        }
        column.some |= bits;
        let stored = [r, g, b, x, y, z];
        self.judge((a, stored, [ox, oy, oz]));
        let column = &mut self.columns[run.start / self.height];
        if a == SOLID_ALPHA && (!self.axes || [ox, oy, oz] == [SOLID_ALPHA; 3]) {
            column.solid |= bits;
        }
        let first = run.start - run.start % self.height;
        for part in runs(bits).map(|part| first + part.start..first + part.end) {
            self.alpha[part.clone()].fill(a);
            self.stored[part.clone()].fill(stored);
            if self.axes {
                self.opacity[part].fill([ox, oy, oz]);
            }
        }
    }

    /// Takes note of what is unusual about a sample.
    #[inline]
    fn judge(&mut self, sample: (u8, Look, [u8; 3])) {
        // Solid mostly is like what is beside it.
        if self.judged == sample {
            return;
        }
        self.judged = sample;
        let (alpha, stored, opacities) = sample;
        let looks = tables::looks(alpha, &stored);
        self.odd_looks |= tables::stored(alpha, &looks.map(|[first, _]| first)) != stored;
        if self.error > 0 {
            let steps = Steps::within(self.error);
            self.off_steps |= (0..6).any(|k| !tables::has_step(steps, k, looks[k]));
        }
        let level = |v: u8| opacity_of_level(opacity_level(v)) == v;
        self.odd_opacities |= !level(alpha) || self.axes && !opacities.iter().all(|v| level(*v));
    }

    /// By how much looks may be off so that they are in steps; 0 if they are in none.
    pub(super) fn error(&self) -> u8 {
        if self.off_steps { 0 } else { self.error }
    }

    /// Whether there are opacities against the axes.
    pub(crate) fn axes(&self) -> bool {
        self.axes
    }

    /// Calls with each sample that is not empty of so many from one down: how far below it, and what it is.
    #[inline]
    pub(crate) fn each(&self, top: usize, count: usize, mut call: impl FnMut(usize, Sample)) {
        let some = self.columns[top / self.height].some >> (top % self.height) & ((1 << count) - 1);
        bits(some).for_each(|down| call(down, self.get_some(top + down)));
    }

    /// Colour, normal and opacities of a sample.
    #[inline]
    pub(crate) fn get(&self, at: usize) -> Sample {
        if self.some(at) == 0 {
            return Default::default();
        }
        self.get_some(at)
    }

    #[inline]
    fn get_some(&self, at: usize) -> Sample {
        let [r, g, b, x, y, z] = self.stored[at];
        let [ox, oy, oz] = if self.axes { self.opacity[at] } else { [0; 3] };
        let [x, y, z] = [x, y, z].map(|n| flip(n) as i8);
        ([r, g, b, self.alpha[at]], [x, y, z, 0], [ox, oy, oz, 0])
    }

    /// Sets opacities of a sample that are the same against all axes.
    #[inline]
    pub(super) fn set_alpha(&mut self, at: usize, alpha: u8) {
        self.alpha[at] = alpha;
        if self.axes {
            self.opacity[at] = [alpha; 3];
        }
    }

    /// 1 if a sample is there, else 0.
    #[inline]
    pub(super) fn some(&self, at: usize) -> usize {
        (self.columns[at / self.height].some >> (at % self.height) & 1) as usize
    }

    /// The partial sample of a column nearest to a place in it, the upper of two, as far as six away.
    #[inline]
    pub(super) fn nearest(&self, column: usize, place: usize) -> Option<usize> {
        let partial = self.columns[column].partial();
        let below = (partial >> place).trailing_zeros() as usize;
        let above = (partial << (63 - place)).leading_zeros() as usize;
        let (step, at) = if above <= below {
            (above, place.wrapping_sub(above))
        } else {
            (below, place + below)
        };
        (step <= REACH).then(|| column * self.height + at)
    }
}

/// How far off a sheet may be in the next column.
const REACH: usize = 6;
