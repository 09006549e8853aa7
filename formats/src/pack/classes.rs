//! Where samples are: runs of empty, partial and solid down each column, by those of the columns before.

use super::coder::{Coder, Model, residual};
use super::grid::{Column, Grid, bits, runs};
use super::meter::Part;
use crate::value::SOLID_ALPHA;

/// Lengths of runs.
pub(super) struct Classes {
    /// Of empty, by how the columns before differ, and by how far off the guesses there were.
    empty: [Vec<Model>; 2],
    /// Of partial, by what is expected, and by what the columns before have.
    partial: [Vec<Model>; 2],
    solid: Vec<Model>,
    more: Vec<Model>,
    /// By column of the row before, and this row's: how far off the first guess was.
    off: Vec<u8>,
}

/// Steps of a difference.
fn step(v: usize) -> usize {
    match v {
        0 => 0,
        1 => 1,
        2 => 2,
        3..6 => 3,
        6..12 => 4,
        _ => 5,
    }
}
const STEPS: usize = 6;
/// Lengths of partial runs that are told apart.
const LENGTHS: usize = 16;
/// What solid is expected to do.
const SOLIDS: usize = 16;
/// Symbols of solid that goes on to the end, and so far or further.
const TO_END: usize = 15;
const LONG: usize = 14;

/// A layer of a column: empty, partial and solid, each perhaps of no length.
struct Layer {
    /// The columns to the west, the south, and between these.
    before: [Column; 3],
    /// How far off guesses were in the first two.
    known: [usize; 2],
    /// The column, if it is known.
    goal: Column,
    /// Where the layer begins, and the samples end that bricks have.
    start: usize,
    end: usize,
}

impl Layer {
    /// Where something is first in the columns before.
    fn tops(&self) -> [usize; 3] {
        self.before.map(|c| first(c.some, self.start).min(self.end))
    }
}

/// The bits of some places.
fn mask(places: std::ops::Range<usize>) -> u64 {
    (1 << places.end) - (1 << places.start)
}

/// The end of the first run of set bits from a place on, or 64.
fn end_of_run(bits: u64, place: usize) -> usize {
    let first = (bits >> place).trailing_zeros() as usize;
    let first = if first == 64 { return 64 } else { place + first };
    first + (bits >> first).trailing_ones() as usize
}

/// The first set bit from a place on, or 64.
fn first(bits: u64, place: usize) -> usize {
    match (bits >> place).trailing_zeros() as usize {
        64 => 64,
        n => place + n,
    }
}

impl Classes {
    pub(super) fn new(grid: &Grid) -> Self {
        let models = |n: usize| vec![Model::default(); n];
        Self {
            empty: [models(STEPS * STEPS), models(STEPS * STEPS * 4)],
            partial: [models(LENGTHS * 3 * 3), models(LENGTHS * LENGTHS)],
            solid: models(SOLIDS),
            more: models(2),
            off: vec![0; grid.columns.len()],
        }
    }

    /// Codes all classes, and the opacities of solid.
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid) {
        coder.part(Part::Classes);
        for column in grid.inside() {
            if coder.failed() {
                return;
            }
            let goal = grid.columns[column];
            let before = [column - 1, column - grid.row, column - grid.row - 1].map(|n| grid.columns[n]);
            let known = [column - 1, column - grid.row].map(|n| usize::from(self.off[n]));
            let mut found = Column {
                covered: goal.covered,
                ..Column::default()
            };
            for segment in runs(goal.covered) {
                let mut layer = Layer {
                    before,
                    known,
                    goal,
                    start: segment.start,
                    end: segment.end,
                };
                while layer.start < layer.end {
                    let (top, off) = self.empty(coder, &layer);
                    self.off[column] = off;
                    let under = self.partial(coder, &layer, top, off);
                    let bottom = self.solid(coder, &layer, top, under);
                    found.some |= mask(top..bottom);
                    found.solid |= mask(under..bottom);
                    layer.start = bottom;
                }
            }
            if !C::ENCODES {
                grid.columns[column] = found;
                for solid in bits(found.solid) {
                    grid.set_alpha(column * grid.height + solid, SOLID_ALPHA);
                }
            }
        }
    }

    /// Codes how far down it is empty, and how far off the guess was.
    fn empty<C: Coder>(&mut self, coder: &mut C, layer: &Layer) -> (usize, u8) {
        let Layer {
            start, end, known, ..
        } = *layer;
        let [west, south, corner] = layer.tops();
        let expected = (west + south).saturating_sub(corner).clamp(start, end);
        let edge = usize::from(expected == start) + 2 * usize::from(expected == end);
        let contexts = [
            step(west.abs_diff(corner)) * STEPS + step(south.abs_diff(corner)),
            (step(known[0]) * STEPS + step(known[1])) * 4 + edge,
        ];
        let top = if C::ENCODES {
            first(layer.goal.some, start).min(end)
        } else {
            0
        };
        let off = (top as i8).wrapping_sub(expected as i8);
        let [a, b] = &mut self.empty;
        let off = residual(coder, [&mut a[contexts[0]], &mut b[contexts[1]]], off);
        // What leaves the column either way ends with it.
        let top = expected.wrapping_add_signed(off.into()).clamp(start, end);
        (top, off.unsigned_abs())
    }

    /// Codes how far down from there it is partial.
    fn partial<C: Coder>(&mut self, coder: &mut C, layer: &Layer, top: usize, off: u8) -> usize {
        let Layer { start, end, .. } = *layer;
        if top == end {
            return end;
        }
        let near = start.max(top.saturating_sub(3));
        let ends = layer.before.map(|c| {
            let partial = c.partial();
            let end_there = end_of_run(partial, near).min(end);
            (end_there < end || partial >> start != 0).then_some(end_there)
        });
        let guess = match ends {
            [Some(w), Some(s), Some(c)] => (w + s).saturating_sub(c),
            [Some(w), Some(s), None] => w.midpoint(s),
            [Some(one), None, _] | [None, Some(one), _] => one,
            _ => top + 1,
        };
        let guess = guess.saturating_sub(top).min(LENGTHS - 1);
        let [west, south, _] = layer.tops();
        let lengths = [(west, ends[0]), (south, ends[1])]
            .map(|(top, end)| end.map_or(0, |end| end.saturating_sub(top)).min(LENGTHS - 1));
        let kind = usize::from(ends[0].is_some()) + usize::from(ends[1].is_some());
        let contexts = [
            (guess * 3 + kind) * 3 + usize::from(off).min(2),
            lengths[0] * LENGTHS + lengths[1],
        ];
        let length = if C::ENCODES {
            (layer.goal.partial() >> top).trailing_ones() as usize
        } else {
            0
        };
        let [a, b] = &mut self.partial;
        let models = [&mut a[contexts[0]], &mut b[contexts[1]]];
        let mut found = coder.by(models, length.min(LENGTHS - 1));
        if found == LENGTHS - 1 {
            found += self.rest(coder, 0, length.saturating_sub(found));
        }
        (top + found).min(end)
    }

    /// Codes how far down from there it is solid; at least one sample where nothing is above.
    fn solid<C: Coder>(&mut self, coder: &mut C, layer: &Layer, top: usize, under: usize) -> usize {
        let Layer { start, end, .. } = *layer;
        if under == end {
            return end;
        }
        let [west, south, _] = layer.before;
        let bit = |bits: u64, k: usize| ((bits >> under & 1) as usize) << k;
        let context = bit(west.solid, 0)
            | bit(south.solid, 1)
            | usize::from(under == top) << 2
            | bit(west.some | south.some, 3);
        let goal = if C::ENCODES {
            (layer.goal.solid >> under).trailing_ones() as usize
        } else {
            0
        };
        let symbol = if goal >= end - under {
            TO_END
        } else {
            goal.min(LONG)
        };
        let mut length = coder.by([&mut self.solid[context]], symbol);
        if length == TO_END {
            return end;
        }
        if length == LONG {
            length += self.rest(coder, 1, goal.saturating_sub(LONG));
        }
        (under + length.max(usize::from(under == start))).min(end)
    }

    /// What a length has above those that are symbols.
    fn rest(&mut self, coder: &mut impl Coder, model: usize, length: usize) -> usize {
        let mut all = 0;
        // No column is longer.
        while all < 64 {
            let part = coder.by([&mut self.more[model]], length.saturating_sub(all).min(15));
            all += part;
            if part < 15 {
                break;
            }
        }
        all
    }
}
