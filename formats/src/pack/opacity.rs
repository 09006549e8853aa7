//! Where samples are, and how opaque.

use super::coder::{Coder, Prob, Residual};
use super::grid::{EMPTY, Grid, PARTIAL, SOLID};
use super::mix::Bytes;
use crate::value::SOLID_ALPHA;

/// Which samples there are, by the neighbours above and in the columns before.
pub(super) struct Classes {
    some: Vec<Prob>,
    solid: Vec<Prob>,
}

impl Classes {
    /// Values of the context: three classes of four neighbours, and whether there is something in six.
    const CONTEXTS: usize = (3 * 3 * 3 * 3) << 6;

    pub(super) fn new() -> Self {
        Self {
            some: vec![Prob::default(); Self::CONTEXTS],
            solid: vec![Prob::default(); Self::CONTEXTS],
        }
    }

    /// Codes all classes, and the opacities of solid.
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, grid: &mut Grid) {
        let [dx, dy, dz] = grid.step;
        for column in grid.columns() {
            for at in column {
                if !grid.present[at] {
                    continue;
                }
                let (above, west, south) = (at - dz, at - dx, at - dy);
                let four = [above, west, south, south - dx];
                let six = [
                    west + dz,
                    south + dz,
                    west - dz,
                    south - dz,
                    above - dz,
                    south + dx,
                ];
                let classes = four.iter().fold(0, |c, n| c * 3 + usize::from(grid.class[*n]));
                let context = six.iter().fold(classes, |c, n| c << 1 | grid.some(*n));
                let class = grid.class[at];
                grid.class[at] = if !coder.bit(&mut self.some[context], class != EMPTY) {
                    EMPTY
                } else if !coder.bit(&mut self.solid[context], class == SOLID) {
                    PARTIAL
                } else {
                    grid.set_alpha(at, SOLID_ALPHA);
                    SOLID
                };
            }
        }
    }
}

/// Opacities of what is neither empty nor solid.
pub(super) struct Opacities {
    equal: Vec<Prob>,
    one: Bytes<3>,
    each: [Bytes<4>; 3],
    largest: Residual,
}

/// Values of [`coarse`].
const COARSE: usize = 17;

/// An opacity in fewer steps; nothing is a step of its own.
fn coarse(v: u8) -> usize {
    usize::from(v).div_ceil(16)
}

impl Opacities {
    /// Values of [`Self::ground`].
    const GROUND: usize = 16;

    /// For samples with opacities against the axes, or without.
    pub(super) fn new(axes: bool) -> Self {
        let each = [COARSE << 2, COARSE * 9, COARSE * COARSE, 1 << 6].map(|n| if axes { n } else { 0 });
        Self {
            equal: vec![Prob::default(); 8],
            one: Bytes::new([Self::GROUND * 4, COARSE * COARSE, Self::GROUND * 9]),
            each: std::array::from_fn(|_| Bytes::new(each)),
            largest: Residual::default(),
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
        let alpha = self.one.code(coder, contexts, grid.alpha[at]);
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
            found[axis] = self.each[axis].code(coder, contexts, goal[axis]);
        }
        grid.opacity[at] = found;
        // Nearly always the largest of them.
        let [x, y, z] = found;
        let largest = x.max(y).max(z);
        let more = self
            .largest
            .code(coder, grid.alpha[at].wrapping_sub(largest).cast_signed());
        grid.alpha[at] = largest.wrapping_add(more.cast_unsigned());
    }
}
