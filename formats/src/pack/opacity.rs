//! How opaque partial samples are.

use super::coder::{Coder, Model, Prob, residual};
use super::grid::{Grid, runs};
use super::meter::Part;
use super::slope::{self, UNIT};
use crate::value::{SOLID_ALPHA, opacity_level, opacity_of_level};

/// Steps of the opacities of a chunk: those that builders keep to, or all.
#[derive(Clone, Copy)]
enum Steps {
    Levels,
    Bytes,
}

/// Opacities of what is neither empty nor solid.
pub(super) struct Opacities {
    steps: Steps,
    /// How far off a sample of a run is, by how much is expected and by where in the run it is; both by how far off the one above was.
    sheet: [Vec<Model>; 2],
    equal: [Prob; 8],
    one: Bytes<3>,
    each: [Bytes<4>; 3],
    largest: Vec<Model>,
}

/// An opacity in few steps; nothing is one of its own.
fn coarse(v: u8) -> usize {
    usize::from(v).div_ceil(16)
}

/// Values of [`coarse`].
const COARSE: usize = 17;

/// Bytes in two symbols, the first by N contexts.
struct Bytes<const N: usize> {
    high: [Vec<Model>; N],
    low: Vec<Model>,
}

impl<const N: usize> Bytes<N> {
    fn new(contexts: [usize; N]) -> Self {
        Self {
            high: contexts.map(|n| vec![Model::default(); n]),
            low: vec![Model::default(); 16],
        }
    }

    fn code(&mut self, coder: &mut impl Coder, steps: Steps, contexts: [usize; N], value: u8) -> u8 {
        let bits = match steps {
            Steps::Levels => 2,
            Steps::Bytes => 4,
        };
        let rank = match steps {
            Steps::Levels => usize::from(opacity_level(value)),
            Steps::Bytes => usize::from(value),
        };
        let mut each = self.high.iter_mut().zip(contexts);
        // There are as many models as contexts.
        let models: [&mut Model; N] = std::array::from_fn(|_| {
            let (models, context) = each.next().expect("N of each");
            &mut models[context]
        });
        let high = coder.by(models, rank >> bits);
        let low = coder.by([&mut self.low[high]], rank & ((1 << bits) - 1));
        let rank = high << bits | low & ((1 << bits) - 1);
        match steps {
            Steps::Levels => opacity_of_level(rank as u8),
            Steps::Bytes => rank as u8,
        }
    }
}

impl Opacities {
    /// Values of [`Self::ground`].
    const GROUND: usize = 16;

    /// For samples with opacities against the axes, or without.
    pub(super) fn new(coder: &mut impl Coder, grid: &Grid) -> Self {
        let all = coder.bits(1, u32::from(grid.odd_opacities)) == 1;
        let each = [COARSE << 2, COARSE * 9, COARSE * COARSE, 1 << 6].map(|n| if grid.axes { n } else { 0 });
        Self {
            steps: if all { Steps::Bytes } else { Steps::Levels },
            sheet: [17 * 16, 4 * 4 * 2 * 4].map(|n| vec![Model::default(); n]),
            equal: Default::default(),
            one: Bytes::new([Self::GROUND * 4, COARSE * COARSE, Self::GROUND * 9]),
            each: std::array::from_fn(|_| Bytes::new(each)),
            largest: vec![Model::default(); 1],
        }
    }

    /// Codes the opacities of a column's runs.
    pub(super) fn column<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid, column: usize) {
        for run in runs(grid.columns[column].partial()) {
            coder.part(Part::Opacity);
            let (top, end) = (run.start, run.end);
            let mut surface = slope::expected(grid, column, top, end - top);
            let solid = (grid.columns[column].solid >> end & 1) as usize;
            let mut last = 0;
            for place in run {
                let at = column * grid.height + place;
                let full = surface.full(place);
                let (alpha, off) = self.sheet(
                    coder,
                    grid.alpha[at],
                    full,
                    [place - top, end - 1 - place, solid, last],
                );
                last = off;
                grid.set_alpha(at, alpha);
                let found = i32::from(alpha.min(SOLID_ALPHA)) * (8 * UNIT) / i32::from(SOLID_ALPHA);
                surface = surface.corrected(place, found);
            }
            slope::settle(grid, column, top, end);
        }
    }

    /// Codes the opacity of a sample of which so much is expected to be full; and how far off that was.
    fn sheet(
        &mut self,
        coder: &mut impl Coder,
        alpha: u8,
        full: i32,
        [above, below, solid, last]: [usize; 4],
    ) -> (u8, usize) {
        // Samples of the run above and below it, whether solid follows, and how far off the last was.
        let guess = (full * i32::from(SOLID_ALPHA) + 4 * UNIT) / (8 * UNIT);
        let (guess, value) = match self.steps {
            Steps::Levels => (opacity_level(guess as u8).max(1), opacity_level(alpha)),
            Steps::Bytes => (guess as u8, alpha),
        };
        let near = match self.steps {
            Steps::Levels => guess / 2,
            Steps::Bytes => guess / 8,
        };
        let near = usize::from(near).min(16);
        let contexts = [
            (near * 4 + above.min(3)) * 4 + last.min(3),
            ((above.min(3) * 4 + below.min(3)) * 2 + solid) * 4 + last.min(3),
        ];
        let [a, b] = &mut self.sheet;
        let off = residual(
            coder,
            [&mut a[contexts[0]], &mut b[contexts[1]]],
            value.wrapping_sub(guess).cast_signed(),
        );
        let value = guess.wrapping_add(off.cast_unsigned());
        let alpha = match self.steps {
            Steps::Levels => opacity_of_level(value),
            Steps::Bytes => value,
        };
        let size = match off.unsigned_abs() {
            0 => 0,
            1 | 2 => 1,
            3..6 => 2,
            _ => 3,
        };
        (alpha, size)
    }

    /// Codes alpha and opacities of a sample whose look is known, in files that tell axes apart.
    pub(super) fn code(&mut self, coder: &mut impl Coder, grid: &mut Grid, at: usize) {
        let [dx, dy, dz] = grid.steps();
        coder.part(Part::Equal);
        let equal = |n: usize| usize::from(grid.opacity[n] == [grid.alpha[n]; 3]);
        let context = equal(at - dz) | equal(at - dx) << 1 | equal(at - dy) << 2;
        let alike = grid.opacity[at] == [grid.alpha[at]; 3];
        if !coder.bit(&mut self.equal[context], alike) {
            return self.against_axes(coder, grid, at);
        }
        let ground = Self::ground(grid, at);
        let above = match grid.alpha[at - dz] {
            0 => 0,
            1..40 => 1,
            40..90 => 2,
            _ => 3,
        };
        let (west, south) = (at - dx, at - dy);
        let around = grid.some(at + dz) * 3 + grid.some(at + dx);
        let contexts = [
            ground * 4 + above,
            coarse(grid.alpha[west]) * COARSE + coarse(grid.alpha[south]),
            ground * 9 + around,
        ];
        coder.part(Part::Opacity);
        let alpha = self.one.code(coder, self.steps, contexts, grid.alpha[at]);
        grid.set_alpha(at, alpha);
    }

    /// How full a sample would be if the ground went on as in the columns before: their heights around the sample, added up
    /// from the opacities, give the height here.
    fn ground(grid: &Grid, at: usize) -> usize {
        const FULL: i32 = SOLID_ALPHA as i32;
        let [dx, dy, _] = grid.steps();
        let height = |n: usize| -> i32 {
            let samples = n - 2..n + 3;
            samples.map(|k| i32::from(grid.alpha[k].min(SOLID_ALPHA))).sum()
        };
        let here = height(at - dx) + height(at - dy) - height(at - dx - dy) - 2 * FULL;
        ((here + FULL / 2).clamp(0, 2 * FULL - 1) * Self::GROUND as i32 / (2 * FULL)) as usize
    }

    /// Opacities that differ. A plane that leaves a voxel through a face goes on in the neighbour there, so the two have
    /// to do with each other; and how opaque it is against one axis depends on its tilt and on the opacity against another.
    fn against_axes(&mut self, coder: &mut impl Coder, grid: &mut Grid, at: usize) {
        let steps = grid.steps();
        let [dx, dy, dz] = steps;
        let goal = grid.opacity[at];
        let mut found = [0; 3];
        for axis in [2, 0, 1] {
            let (before, after) = (at - steps[axis], at + steps[axis]);
            let near = |n: usize| coarse(grid.opacity[n][axis]);
            let tilt = usize::from((grid.look[at][3 + axis] ^ 0x80).cast_signed().unsigned_abs() >> 4);
            let ends = grid.some(before) | grid.some(after) << 1;
            let beside = [dz, dx, dy]
                .iter()
                .fold(grid.some(at - dz), |c, step| c << 1 | grid.some(at + step));
            let (first, other) = match axis {
                2 => (near(at - dz), near(at - dx) * COARSE + near(at - dy)),
                0 => (coarse(found[2]), near(at - dx) * COARSE + near(at - dy)),
                _ => (coarse(found[2]), coarse(found[0]) * COARSE + near(at - dx)),
            };
            let contexts = [
                near(before) << 2 | ends,
                first * 9 + tilt,
                other,
                ends << 4 | beside,
            ];
            coder.part([Part::OpacityX, Part::OpacityY, Part::OpacityZ][axis]);
            found[axis] = self.each[axis].code(coder, self.steps, contexts, goal[axis]);
        }
        grid.opacity[at] = found;
        // Nearly always the largest of them.
        let [x, y, z] = found;
        let largest = x.max(y).max(z);
        let more = grid.alpha[at].wrapping_sub(largest).cast_signed();
        coder.part(Part::Largest);
        let more = residual(coder, [&mut self.largest[0]], more);
        grid.alpha[at] = largest.wrapping_add(more.cast_unsigned());
    }
}
