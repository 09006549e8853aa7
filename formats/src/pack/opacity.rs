//! Where samples are, and how opaque.

use super::coder::{Coder, Model, Prob, residual};
use super::grid::Grid;
use crate::value::{SOLID_ALPHA, opacity_level, opacity_of_level};

/// Samples of a column whose classes are one symbol.
const GROUP: usize = 4;

/// Which samples there are, four of a column at once, by the columns before and the sample above.
pub(super) struct Classes {
    some: [Vec<Model>; 2],
    solid: [Vec<Model>; 2],
}

impl Classes {
    pub(super) fn new() -> Self {
        let models = |n: usize| vec![Model::default(); n];
        Self {
            some: [models(1 << 9), models(3 << 10)],
            solid: [models(1 << 9), models(1 << 9)],
        }
    }

    /// Codes all classes, and the opacities of solid.
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid) {
        let [dx, dy, _] = grid.step;
        for column in grid.columns() {
            for at in column.clone().step_by(GROUP) {
                let covered = grid.covered(at, column.end);
                if covered == 0 {
                    continue;
                }
                let (west, south) = (at - dx, at - dy);
                let (some, solid) = if C::ENCODES { grid.group(at) } else { (0, 0) };
                let (above_some, above_solid) = grid.group(at - GROUP);
                let (west_some, west_solid) = grid.group(west);
                let (south_some, south_solid) = grid.group(south);
                let (corner_some, _) = grid.group(south - dx);
                let above = above_some >> 3;
                let near = west_some << 5 | south_some << 1 | above;
                let class = usize::from(grid.class[at - 1]);
                let beyond = [west + GROUP, south + GROUP, west - 1, south - 1];
                let far = beyond.iter().fold(class, |c, n| c << 1 | grid.some(*n));
                let (south_east, _) = grid.group(south + dx);
                let far = far << 6 | corner_some << 2 | south_east >> 2 & 2 | south_east & 1;
                let [a, b] = &mut self.some;
                let some = coder.by([&mut a[near], &mut b[far]], some) & covered;
                let mut full = 0;
                if some != 0 {
                    let above = above_solid >> 3;
                    let [a, b] = &mut self.solid;
                    let models = [
                        &mut a[some << 5 | west_solid << 1 | above],
                        &mut b[some << 5 | south_solid << 1 | above],
                    ];
                    full = coder.by(models, solid) & some;
                }
                if !C::ENCODES {
                    grid.set_group(at, some, full);
                }
            }
        }
    }
}

/// Steps of the opacities of a chunk: those that builders keep to, or all.
#[derive(Clone, Copy)]
enum Steps {
    Levels,
    Bytes,
}

/// Opacities of what is neither empty nor solid.
pub(super) struct Opacities {
    steps: Steps,
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
        let all = coder.bits(1, u32::from(grid.has_odd_opacities())) == 1;
        let each = [COARSE << 2, COARSE * 9, COARSE * COARSE, 1 << 6].map(|n| if grid.axes { n } else { 0 });
        Self {
            steps: if all { Steps::Bytes } else { Steps::Levels },
            equal: Default::default(),
            one: Bytes::new([Self::GROUND * 4, COARSE * COARSE, Self::GROUND * 9]),
            each: std::array::from_fn(|_| Bytes::new(each)),
            largest: vec![Model::default(); 1],
        }
    }

    /// Codes alpha and opacities of a sample whose look is known.
    pub(super) fn code(&mut self, coder: &mut impl Coder, grid: &mut Grid, at: usize) {
        let [dx, dy, dz] = grid.step;
        if grid.axes {
            let equal = |n: usize| usize::from(grid.opacity[n] == [grid.alpha[n]; 3]);
            let context = equal(at - dz) | equal(at - dx) << 1 | equal(at - dy) << 2;
            let alike = grid.opacity[at] == [grid.alpha[at]; 3];
            if !coder.bit(&mut self.equal[context], alike) {
                return self.against_axes(coder, grid, at);
            }
        }
        let ground = Self::ground(grid, at);
        let above = match grid.alpha[at - dz] {
            0 => 0,
            1..40 => 1,
            40..90 => 2,
            _ => 3,
        };
        let (west, south) = (at - dx, at - dy);
        let around = usize::from(grid.class[at + dz]) * 3 + usize::from(grid.class[at + dx]);
        let contexts = [
            ground * 4 + above,
            coarse(grid.alpha[west]) * COARSE + coarse(grid.alpha[south]),
            ground * 9 + around,
        ];
        let alpha = self.one.code(coder, self.steps, contexts, grid.alpha[at]);
        grid.set_alpha(at, alpha);
    }

    /// How full a sample would be if the ground went on as in the columns before: their heights around the sample, added up
    /// from the opacities, give the height here.
    fn ground(grid: &Grid, at: usize) -> usize {
        const FULL: i32 = SOLID_ALPHA as i32;
        let [dx, dy, _] = grid.step;
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
        let [dx, dy, dz] = grid.step;
        let goal = grid.opacity[at];
        let mut found = [0; 3];
        for axis in [2, 0, 1] {
            let (before, after) = (at - grid.step[axis], at + grid.step[axis]);
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
            found[axis] = self.each[axis].code(coder, self.steps, contexts, goal[axis]);
        }
        grid.opacity[at] = found;
        // Nearly always the largest of them.
        let [x, y, z] = found;
        let largest = x.max(y).max(z);
        let more = grid.alpha[at].wrapping_sub(largest).cast_signed();
        let more = residual(coder, [&mut self.largest[0]], more);
        grid.alpha[at] = largest.wrapping_add(more.cast_unsigned());
    }
}
