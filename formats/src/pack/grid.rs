//! The samples of a chunk in the box that covers its bricks, with room around it so that neighbours need no checks.

use glam::UVec3;

use super::tables::{Look, flip};
use crate::value::SOLID_ALPHA;

/// Samples of air on each side of the box.
const PAD: usize = 2;

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
        let padded = size.map(|s| s + 2 * PAD);
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
    pub(crate) fn index(&self, [x, y, down]: [usize; 3]) -> usize {
        (x + PAD) * self.step[0] + (y + PAD) * self.step[1] + down + PAD
    }

    /// The indices of each column, from the top down.
    pub(super) fn columns(&self) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
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
        let ([r, g, b, a], [x, y, z]) = (color, [0, 1, 2].map(|k| flip(normal[k] as u8)));
        let ([ox, oy, oz, _], stored) = (opacity, [r, g, b, x, y, z]);
        if self.present[at] {
            return (self.alpha[at], self.opacity[at], self.stored[at]) == (a, [ox, oy, oz], stored);
        }
        self.present[at] = true;
        self.alpha[at] = a;
        self.opacity[at] = [ox, oy, oz];
        self.stored[at] = stored;
        self.class[at] = match a {
            0 if opacity == [0; 4] && color == [0; 4] && normal == [0; 4] => EMPTY,
            SOLID_ALPHA if !self.axes || self.opacity[at] == [SOLID_ALPHA; 3] => SOLID,
            _ => PARTIAL,
        };
        true
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
}
