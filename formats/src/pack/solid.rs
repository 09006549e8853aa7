//! The looks of solid: mostly they follow from those of the surfaces around it, by the builder's rules.
//!
//! Solid right below a surface has the look of it. Other solid beside surfaces has their mean, in linear light. What is further in
//! has the mean of the ground above 2×2 columns, in steps of which few bits tell.

use super::coder::{Coder, Model, Prob};
use super::grid::{Grid, bits};
use super::looks::{Guess, Looks, plane};
use super::meter::Part;
use super::tables::{self, Look};
use crate::steps::Steps;
use crate::value::SOLID_ALPHA;

/// Looks of solid, and how often they are other than expected.
pub(super) struct Solids {
    /// Whether anything in a column is; by where the look further in is guessed from, and by whether the column has a surface.
    column: [Prob; 2 * SOURCES],
    /// Whether the look further in is not the guessed one, by where that is from.
    other: [Prob; SOURCES],
    /// Whether it is none of the steps.
    odd: Prob,
    /// How many steps it is off.
    steps: [Model; 6],
    /// Whether what is further in is not all the same.
    mixed: Prob,
    /// By column: the look further in, `None` where there is no solid yet.
    looks: Vec<Option<Look>>,
}

/// Kinds of guesses: see `looks`.
const BESIDE: usize = 6;
const BELOW: usize = 7;
const DEEP: usize = 8;

/// Where the look further in is guessed from: another of the four columns, surfaces, columns beside, nothing.
const SOURCES: usize = 4;

/// The nearest of the looks that solid further in may have.
fn rough(look: &Look) -> Look {
    std::array::from_fn(|k| {
        if k < 3 {
            look[k] & !15 | 8
        } else {
            of_step(k, step(k, look[k]))
        }
    })
}

/// The step of a part of a look that is nearest.
fn step(k: usize, v: u8) -> usize {
    usize::from(if k < 3 { v >> 4 } else { (v >> 4).div_ceil(2) })
}

/// What a step is.
fn of_step(k: usize, step: usize) -> u8 {
    (if k < 3 {
        step << 4 | 8
    } else {
        (step << 5).clamp(1, 255)
    }) as u8
}

impl Solids {
    pub(super) fn new(grid: &Grid) -> Self {
        Self {
            column: Default::default(),
            other: Default::default(),
            odd: Prob::default(),
            steps: Default::default(),
            mixed: Prob::default(),
            looks: vec![None; grid.columns.len()],
        }
    }

    /// Codes looks and colours of all solid samples of a column; partial ones are known, also in the columns around.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        looks: &mut Looks,
        grid: &mut Grid,
        column: usize,
    ) {
        let solid = grid.columns[column].solid;
        if solid == 0 {
            return;
        }
        let kinds = Kinds::new(grid, column);
        let (inner, source) = self.inner(grid, column);
        // Mostly it is all as expected.
        let differs = C::ENCODES
            && !expected(grid, column, &kinds, &inner, looks.steps, |grid, at, look| {
                tables::stored(SOLID_ALPHA, look) == grid.stored[at]
            });
        coder.part(Part::Solid);
        let context = source * 2 + usize::from(kinds.below != 0);
        self.looks[column] = Some(inner);
        if coder.bit(&mut self.column[context], differs) {
            self.each(coder, looks, grid, column, &kinds, source);
        } else if !C::ENCODES {
            expected(grid, column, &kinds, &inner, looks.steps, |grid, at, look| {
                grid.stored[at] = tables::stored(SOLID_ALPHA, look);
                true
            });
        }
    }

    /// What is expected further in, and where that is from.
    fn inner(&self, grid: &Grid, column: usize) -> (Look, usize) {
        let known = |n: usize| self.looks[n];
        let (west, south) = (column - 1, column - grid.row);
        let [right, upper] = grid.in_pair(column);
        if let (true, Some(look)) = (right, known(west)) {
            return (look, 0);
        }
        if let (true, Some(look)) = (upper, known(south)) {
            return (look, 0);
        }
        let first = column - usize::from(right) - usize::from(upper) * grid.row;
        let pair = [first, first + 1, first + grid.row, first + grid.row + 1];
        let (mut light, mut normal, mut count) = ([0u32; 3], [0u32; 3], 0);
        for n in pair {
            let partial = grid.columns[n].partial();
            if partial != 0 {
                let look = &grid.look[n * grid.height + partial.ilog2() as usize];
                for c in 0..3 {
                    light[c] += tables::light(look[c]);
                    normal[c] += u32::from(look[3 + c]);
                }
                count += 1;
            }
        }
        if count > 0 {
            return (rough(&mean(light, normal, count)), 1);
        }
        match (known(west), known(south), known(south - 1)) {
            (Some(w), Some(s), Some(c)) => (rough(&plane(&w, &s, &c)), 2),
            (Some(one), None, _) | (None, Some(one), _) | (Some(_), Some(one), None) => (one, 2),
            _ => (rough(&[128, 128, 128, 128, 128, 255]), 3),
        }
    }

    /// Codes the look further in.
    fn deep<C: Coder>(
        &mut self,
        coder: &mut C,
        looks: &mut Looks,
        grid: &mut Grid,
        column: usize,
        at: usize,
        source: usize,
    ) {
        let guess = self.looks[column].unwrap_or_default();
        let goal = if C::ENCODES {
            rough_of(&grid.stored[at], looks.steps)
        } else {
            None
        };
        coder.part(Part::Deep);
        let same = C::ENCODES
            && tables::stored(SOLID_ALPHA, &tables::in_steps(&guess, looks.steps)) == grid.stored[at];
        let mut look = guess;
        if coder.bit(&mut self.other[source], !same) {
            if coder.bit(&mut self.odd, goal.is_none()) {
                // Surfaces beside it are in another chunk.
                let near = [column - 1, column - grid.row]
                    .into_iter()
                    .find(|n| grid.columns[*n].some >> (at % grid.height) & 1 == 1);
                let guess = near.map_or(guess, |n| grid.look[n * grid.height + at % grid.height]);
                looks.look(coder, grid, at..at + 1, &Guess::new(guess, DEEP));
                looks.stored(coder, grid, at);
                self.looks[column] = Some(grid.look[at]);
                return;
            }
            let goal = goal.unwrap_or_default();
            for k in 0..6 {
                let off = step(k, goal[k]).wrapping_sub(step(k, guess[k])) & 15;
                let off = coder.by([&mut self.steps[k]], off);
                look[k] = of_step(k, (step(k, guess[k]) + off) & 15);
            }
        }
        self.looks[column] = Some(look);
        grid.look[at] = tables::in_steps(&look, looks.steps);
        grid.stored[at] = tables::stored(SOLID_ALPHA, &grid.look[at]);
    }

    fn each<C: Coder>(
        &mut self,
        coder: &mut C,
        looks: &mut Looks,
        grid: &mut Grid,
        column: usize,
        kinds: &Kinds,
        source: usize,
    ) {
        let first = column * grid.height;
        // Where surfaces are missing that the chunk does not have, they are missing in the next one as well.
        let (mut off, mut next) = ([0i16; 6], 0);
        for place in bits(kinds.beside | kinds.below) {
            let at = first + place;
            if kinds.beside >> place & 1 == 0 {
                let guess = Guess::new(grid.look[at - 1], BELOW);
                looks.look(coder, grid, at..at + 1, &guess);
            } else {
                let mean = beside(grid, column, place);
                if place != next {
                    off = [0; 6];
                }
                let guess = std::array::from_fn(|k| (i16::from(mean[k]) + off[k]).clamp(0, 255) as u8);
                looks.look(coder, grid, at..at + 1, &Guess::new(guess, BESIDE));
                off = std::array::from_fn(|k| i16::from(grid.look[at][k]) - i16::from(mean[k]));
                next = place + 1;
            }
            looks.stored(coder, grid, at);
        }
        // The first of those further in mostly tells the others.
        let mut rest = kinds.deep;
        while rest != 0 {
            let at = first + rest.trailing_zeros() as usize;
            rest &= rest - 1;
            self.deep(coder, looks, grid, column, at, source);
            if rest == 0 {
                break;
            }
            let (look, stored) = (grid.look[at], grid.stored[at]);
            coder.part(Part::Deep);
            let differs = C::ENCODES && !bits(rest).all(|n| grid.stored[first + n] == stored);
            if !coder.bit(&mut self.mixed, differs) {
                for n in bits(rest) {
                    grid.look[first + n] = look;
                    grid.stored[first + n] = stored;
                }
                break;
            }
        }
    }
}

/// The rough look that is stored so in steps, if there is one.
fn rough_of(stored: &Look, steps: Steps) -> Option<Look> {
    let bounds = tables::looks(SOLID_ALPHA, stored);
    let look: Look = std::array::from_fn(|k| of_step(k, step(k, bounds[k][0].midpoint(bounds[k][1]))));
    (tables::stored(SOLID_ALPHA, &tables::in_steps(&look, steps)) == *stored).then_some(look)
}

/// Gives the solid samples of a column the looks that are expected, as long as the call agrees; whether it did to the end.
fn expected(
    grid: &mut Grid,
    column: usize,
    kinds: &Kinds,
    inner: &Look,
    steps: Steps,
    mut agrees: impl FnMut(&mut Grid, usize, &Look) -> bool,
) -> bool {
    for place in bits(grid.columns[column].solid) {
        let at = column * grid.height + place;
        let look = if kinds.deep >> place & 1 == 1 {
            *inner
        } else if kinds.beside >> place & 1 == 1 {
            beside(grid, column, place)
        } else {
            grid.look[at - 1]
        };
        let look = tables::in_steps(&look, steps);
        if !agrees(grid, at, &look) {
            return false;
        }
        grid.look[at] = look;
    }
    true
}

/// The mean of so many looks, of which light and normals are added up.
fn mean(light: [u32; 3], normal: [u32; 3], count: u32) -> Look {
    let [r, g, b] = light.map(|sum| tables::code((sum + count / 2) / count));
    let [x, y, z] = normal.map(|sum| {
        // Halves go away from zero.
        let count = count as i32;
        let sum = sum as i32 - 128 * count;
        let mean = (2 * sum.abs() + count) / (2 * count);
        (128 + mean * sum.signum()) as u8
    });
    [r, g, b, x, y, z]
}

/// Why the solid samples of a column look as they do.
struct Kinds {
    /// Those right below a surface.
    below: u64,
    /// Others that have surfaces beside them.
    beside: u64,
    /// All others.
    deep: u64,
}

impl Kinds {
    fn new(grid: &Grid, column: usize) -> Self {
        let own = grid.columns[column];
        let near = around(grid, column).fold(0, |near, n| {
            let partial = grid.columns[n].partial();
            near | partial | partial << 1 | partial >> 1
        });
        let below = own.solid & own.partial() << 1;
        let beside = own.solid & own.solid << 1 & near;
        Self {
            below,
            beside,
            deep: own.solid & !below & !beside,
        }
    }
}

/// A column and those around it.
fn around(grid: &Grid, column: usize) -> impl Iterator<Item = usize> + use<> {
    let row = grid.row;
    [column - row, column, column + row]
        .into_iter()
        .flat_map(|n| n - 1..n + 2)
}

/// The mean look of the surfaces around a sample, of which there is one.
fn beside(grid: &Grid, column: usize, place: usize) -> Look {
    let (mut light, mut normal, mut count) = ([0u32; 3], [0u32; 3], 0);
    for n in around(grid, column) {
        for k in bits(grid.columns[n].partial() >> (place - 1) & 7) {
            let look = &grid.look[n * grid.height + place - 1 + k];
            for c in 0..3 {
                light[c] += tables::light(look[c]);
                normal[c] += u32::from(look[3 + c]);
            }
            count += 1;
        }
    }
    mean(light, normal, count)
}
