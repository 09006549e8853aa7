//! The samples of a chunk in the box that covers its bricks, with room around it so that neighbours need no checks.

use std::ops::Range;

use glam::UVec3;

use super::tables::{self, Look, flip};
use crate::value::{SOLID_ALPHA, opacity_level, opacity_of_level};

/// Samples of air on each side of the box: west, east, south, north; above and below.
const PAD: [usize; 3] = [1, 1, 4];

/// Nothing is there.
pub(super) const EMPTY: u8 = 0;
/// Anything else.
pub(super) const PARTIAL: u8 = 1;
/// As opaque as solid ground, against all axes.
pub(super) const SOLID: u8 = 2;

/// Columns along z from the top down, in rows along x, rows along y.
pub(crate) struct Grid {
    size: [usize; 3],
    /// Distances of neighbours along x, along y, and one below the other.
    pub(super) step: [usize; 3],
    /// Whether there are opacities against the axes.
    pub(super) axes: bool,
    /// Whether a brick has the sample.
    pub(super) present: Vec<bool>,
    /// [`EMPTY`], [`PARTIAL`] or [`SOLID`]. While decoding known before the rest.
    pub(super) class: Vec<u8>,
    pub(super) alpha: Vec<u8>,
    pub(super) opacity: Vec<[u8; 3]>,
    /// What is stored of colour and normal.
    pub(super) stored: Vec<Look>,
    /// What that is of.
    pub(super) look: Vec<Look>,
}

impl Grid {
    /// A box of so many samples per axis; no brick has any of them.
    pub(crate) fn new(size: UVec3, axes: bool) -> Self {
        let size = size.to_array().map(|s| s as usize);
        let padded: [usize; 3] = std::array::from_fn(|k| size[k] + 2 * PAD[k]);
        let n = padded.iter().product();
        Self {
            size,
            step: [padded[2], padded[2] * padded[0], 1],
            axes,
            present: vec![false; n],
            class: vec![EMPTY; n],
            alpha: vec![0; n],
            opacity: vec![[0; 3]; n],
            stored: vec![[0; 6]; n],
            look: vec![[0; 6]; n],
        }
    }

    /// Index of the sample at x, y and so many samples below the top.
    #[inline]
    pub(crate) fn index(&self, [x, y, down]: [usize; 3]) -> usize {
        (x + PAD[0]) * self.step[0] + (y + PAD[1]) * self.step[1] + down + PAD[2]
    }

    /// The indices of each column, from the top down.
    pub(super) fn columns(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let first = self.index([0; 3]);
        let ([sx, sy, sz], [dx, dy, _]) = (self.size, self.step);
        (0..sy)
            .flat_map(move |y| (0..sx).map(move |x| first + y * dy + x * dx))
            .map(move |top| top..top + sz)
    }

    /// Says that a brick has a sample.
    pub(crate) fn announce(&mut self, at: usize) {
        self.present[at] = true;
    }

    /// Sets a sample of a brick; false if another brick has it otherwise.
    pub(crate) fn set(&mut self, at: usize, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) -> bool {
        if self.present[at] {
            let (own_color, [x, y, z, _], [ox, oy, oz, _]) = self.get(at);
            return own_color == color && [x, y, z] == normal[..3] && [ox, oy, oz] == opacity[..3];
        }
        self.present[at] = true;
        self.put(at, color, normal, opacity);
        true
    }

    /// Sets a sample that has been announced; nothing happens to one that has not.
    #[inline]
    pub(crate) fn put(&mut self, at: usize, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) {
        if !self.present[at] {
            return;
        }
        let ([r, g, b, a], [x, y, z]) = (color, [0, 1, 2].map(|k| flip(normal[k] as u8)));
        let [ox, oy, oz, _] = opacity;
        self.alpha[at] = a;
        self.opacity[at] = [ox, oy, oz];
        self.stored[at] = [r, g, b, x, y, z];
        self.class[at] = match a {
            0 if opacity == [0; 4] && color == [0; 4] && normal == [0; 4] => EMPTY,
            SOLID_ALPHA if !self.axes || self.opacity[at] == [SOLID_ALPHA; 3] => SOLID,
            _ => PARTIAL,
        };
    }

    /// The same for samples below each other.
    #[inline]
    pub(crate) fn put_run(&mut self, run: Range<usize>, color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) {
        if run.is_empty() {
            return;
        }
        let first = run.start;
        if !self.present[run.clone()].iter().all(|present| *present) {
            run.for_each(|at| self.put(at, color, normal, opacity));
            return;
        }
        self.put(first, color, normal, opacity);
        let rest = first + 1..run.end;
        let (alpha, opacity) = (self.alpha[first], self.opacity[first]);
        let (stored, class) = (self.stored[first], self.class[first]);
        self.alpha[rest.clone()].fill(alpha);
        self.opacity[rest.clone()].fill(opacity);
        self.stored[rest.clone()].fill(stored);
        self.class[rest].fill(class);
    }

    /// Whether there are opacities against the axes.
    pub(crate) fn axes(&self) -> bool {
        self.axes
    }

    /// Colour, normal and opacities of a sample.
    pub(crate) fn get(&self, at: usize) -> ([u8; 4], [i8; 4], [u8; 4]) {
        if self.class[at] == EMPTY {
            return Default::default();
        }
        let ([r, g, b, x, y, z], [ox, oy, oz]) = (self.stored[at], self.opacity[at]);
        let [x, y, z] = [x, y, z].map(|n| flip(n) as i8);
        ([r, g, b, self.alpha[at]], [x, y, z, 0], [ox, oy, oz, 0])
    }

    /// Sets opacities of a sample that are the same against all axes.
    pub(super) fn set_alpha(&mut self, at: usize, alpha: u8) {
        self.alpha[at] = alpha;
        if self.axes {
            self.opacity[at] = [alpha; 3];
        }
    }

    /// 1 if a sample is there, else 0.
    #[inline]
    pub(super) fn some(&self, at: usize) -> usize {
        usize::from(self.class[at] != EMPTY)
    }

    /// Four classes below each other, as bits from the top one on: which are something, which solid.
    #[inline]
    pub(super) fn group(&self, at: usize) -> (usize, usize) {
        let bits = |classes: u32| ((classes & 0x0101_0101).wrapping_mul(0x0102_0408) >> 24 & 15) as usize;
        let four = self.class[at..at + 4].try_into().map_or(0, u32::from_le_bytes);
        (bits(four | four >> 1), bits(four >> 1))
    }

    /// Sets classes by such bits, and the opacities of solid.
    pub(super) fn set_group(&mut self, at: usize, some: usize, solid: usize) {
        for k in 0..4 {
            if solid >> k & 1 == 1 {
                self.class[at + k] = SOLID;
                self.set_alpha(at + k, SOLID_ALPHA);
            } else if some >> k & 1 == 1 {
                self.class[at + k] = PARTIAL;
            }
        }
    }

    /// Which of four samples bricks have.
    pub(super) fn covered(&self, at: usize, end: usize) -> usize {
        (0..end.min(at + 4) - at).fold(0, |bits, k| bits | usize::from(self.present[at + k]) << k)
    }

    /// Whether an opacity is none of the levels that builders keep to.
    pub(super) fn has_odd_opacities(&self) -> bool {
        let level = |v: u8| opacity_of_level(opacity_level(v)) == v;
        let partial = (0..self.class.len()).filter(|n| self.class[*n] == PARTIAL);
        partial
            .into_iter()
            .any(|n| !level(self.alpha[n]) || !self.opacity[n].iter().all(|v| level(*v)))
    }

    /// Whether there is a sample of which no look is stored so.
    pub(super) fn has_odd_looks(&self) -> bool {
        let some = (0..self.class.len()).filter(|n| self.class[*n] != EMPTY);
        some.into_iter().any(|n| {
            let bounds = tables::looks(self.alpha[n], &self.stored[n]);
            let first = bounds.map(|[first, _]| first);
            tables::stored(self.alpha[n], &first) != self.stored[n]
        })
    }
}
