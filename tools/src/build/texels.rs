//! One level as it is stored: texels in blocks, and the box of them that a chunk holds.
//!
//! A texel is made once, where it is stored. Masks of a block's cells tell what is empty, deep or met by a surface, so that most
//! nodes are compared without looking at texels, and deep solid costs nothing but where it lies beside a surface.

use std::ops::ControlFlow;

use rayon::prelude::*;

use brickfell_formats::chunk::ChunkBox;
use brickfell_formats::steps::Steps;
use brickfell_formats::value::{SOLID_ALPHA, Stored};

use super::blocks::{Block, BlockColumn, Blocks, Slot, block_columns};
use super::cells::{
    Cell, Cells, NONE, bits, both, count, each_column, either, has, in_block, mask_of, part, put, without,
};
use super::filter::Skins;
use super::ground::{Hint, Hints};
use super::lattice::{CellBox, SIDE};
use super::sample::{Sample, stored_solid};

/// Linear light and normal of a surface in steps of a byte, as floats to be added up, and two zeros.
type SurfaceLook = [f32; 8];

/// What is stored of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Texel {
    pub(crate) stored: Stored,
    /// Opacities against the axes, where they are told apart.
    pub(crate) opacity: [u8; 4],
}

/// The texels of a block.
#[derive(Debug)]
pub(crate) struct TexelBlock {
    /// Those of the area that are neither empty nor deep. Solid are the deep ones, of the ring around the area, too.
    cells: Cells<Texel>,
    /// Deep ones that have the look of surfaces beside them.
    beside: Cells<Stored>,
    /// Looks of the cells that a surface meets, as long as neighbours ask for them.
    surfaces: Cells<SurfaceLook>,
}

/// The texels that a tree stores of one level.
pub(crate) struct TexelLevel {
    /// What is stored.
    area: CellBox,
    blocks: Blocks<Box<TexelBlock>>,
    /// Deep solid by column of cells of the area.
    solid: Vec<Stored>,
    axes: bool,
    /// What looks are told in.
    steps: Steps,
}

/// What a node's texels, apron included, have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Likeness {
    /// Nothing.
    Mixed,
    /// All are stored as this colour, without normal.
    Equal([u8; 4]),
    /// All are deep solid; colours may differ.
    Deep,
}

/// What deep solid has against each axis.
const SOLID_OPACITY: [u8; 4] = [SOLID_ALPHA, SOLID_ALPHA, SOLID_ALPHA, 0];

impl TexelLevel {
    /// Stores the samples of an area (cells of the level), with their skins where those are not their own. `support` is what
    /// the samples are known for.
    pub(crate) fn new(
        samples: &Blocks<Cells<Sample>>,
        skins: Option<Skins>,
        steps: Steps,
        hints: &Hints,
        area: CellBox,
        support: &CellBox,
    ) -> Self {
        // With a cell more on each side, neighbours of all that is stored can be looked at.
        let ring = area.grown(1);
        let ringed = ring.intersection(support) == ring;
        let looks = ringed && samples.has_solid();
        let width = area.hi[0] - area.lo[0];
        let columns = width * (area.hi[1] - area.lo[1]);
        let solid = (0..columns)
            .into_par_iter()
            .map(|k| {
                let (x, y) = (area.lo[0] + k % width, area.lo[1] + k / width);
                let hint = if looks {
                    hints.deep_hint(x, y)
                } else {
                    hints.hint(x, y)
                };
                stored_solid(&hint, steps)
            })
            .collect();
        let mut level = Self {
            area,
            blocks: Blocks::new(
                &CellBox {
                    lo: [0; 3],
                    hi: [0; 3],
                },
                Vec::new(),
            ),
            solid,
            steps,
            axes: skins.is_some_and(|s| s.axes),
        };
        let known = if ringed { ring } else { area };
        let extent = known.blocks();
        let heights = extent.lo[2]..extent.hi[2];
        let columns = block_columns(&extent)
            .into_par_iter()
            .map(|(x, y)| {
                let column = samples.column(x, y);
                let near = column.slots.iter().filter(|s| heights.contains(&s.0));
                let slots = near.map(|(z, slot)| match slot {
                    Slot::Mixed(samples) => {
                        let block = level.block(samples, skins, hints, &known, [x, y, *z], looks);
                        (*z, Slot::Mixed(block))
                    }
                    Slot::Solid => (*z, Slot::Solid),
                });
                BlockColumn {
                    solid: column.solid.clone(),
                    slots: slots.collect(),
                }
            })
            .collect();
        level.blocks = Blocks::new(&extent, columns);
        if looks {
            level.look_beside();
        }
        level
    }

    /// The blocks.
    pub(crate) fn blocks(&self) -> &Blocks<Box<TexelBlock>> {
        &self.blocks
    }

    fn deep(&self, x: i64, y: i64) -> Stored {
        let width = self.area.hi[0] - self.area.lo[0];
        self.solid[((y - self.area.lo[1]) * width + x - self.area.lo[0]) as usize]
    }

    /// The texels of a block's samples, as far as they are known; with the looks of its surfaces if they are asked for.
    fn block(
        &self,
        samples: &Cells<Sample>,
        skins: Option<Skins>,
        hints: &Hints,
        known: &CellBox,
        at: [i64; 3],
        looks: bool,
    ) -> Box<TexelBlock> {
        let [known, area] = [known, &self.area].map(|cells| mask_of(cells, at));
        let (mut held, mut met) = (NONE, NONE);
        let most = count(&both(samples.held(), &known)) as usize;
        let mut texels = Vec::with_capacity(most);
        let mut surfaces = Vec::with_capacity(if looks { most } else { 0 });
        samples.each(|place, sample| {
            if !has(&known, place) {
                return;
            }
            let look = sample.is_surface().then(|| sample.codes().in_steps(self.steps));
            if let Some(look) = look.filter(|_| looks && sample.is_open()) {
                put(&mut met, place);
                let ([r, g, b], [x, y, z]) = (look.linear(), look.direction());
                surfaces.push([r, g, b, x, y, z, 0.0, 0.0]);
            }
            if !has(&area, place) {
                return;
            }
            let [x, y, z] = cell_of(at, place);
            let look = look.unwrap_or_else(|| hints.hint(x, y).codes().in_steps(self.steps));
            let texel = match skins.map(|skins| skins.at([x, y, z])) {
                Some([a, b, c]) => {
                    let [x, y, z] = if self.axes {
                        sample.opacities([a, b, c])
                    } else {
                        [0; 3]
                    };
                    Texel {
                        stored: sample.with_skin(a.max(b).max(c)).stored(&look),
                        opacity: [x, y, z, 0],
                    }
                }
                None => Texel {
                    stored: sample.stored(&look),
                    opacity: [0; 4],
                },
            };
            if texel != Texel::default() {
                put(&mut held, place);
                texels.push(texel);
            }
        });
        Box::new(TexelBlock {
            cells: Cells::new(held, both(samples.solid(), &known), texels),
            beside: Cells::nothing(),
            surfaces: Cells::new(met, NONE, surfaces),
        })
    }

    /// Gives deep solid beside surfaces their look: it is interpolated with them, and at the foot of a cliff the ground above
    /// its column is the cliff's top. What lies right below a surface has its look. Opacities do not count:
    /// those of the support's last cells are not final.
    fn look_beside(&mut self) {
        let extent = self.area.blocks();
        let places = block_columns(&extent);
        let changed: Vec<Vec<(i64, Cells<Stored>)>> =
            places.par_iter().map(|at| self.beside_in(*at)).collect();
        for ((x, y), changes) in places.into_iter().zip(changed) {
            for (z, changes) in changes {
                let Some(column) = self.blocks.column_mut(x, y) else {
                    continue;
                };
                let found = column.slots.binary_search_by_key(&z, |s| s.0);
                let k = found.unwrap_or_else(|k| {
                    column.slots.insert(k, (z, Slot::Solid));
                    k
                });
                let slot = &mut column.slots[k].1;
                if matches!(slot, Slot::Solid) {
                    *slot = Slot::Mixed(Box::new(TexelBlock::solid()));
                }
                if let Slot::Mixed(block) = slot {
                    block.beside = changes;
                }
            }
        }
        for column in self.blocks.columns_mut() {
            for (_, slot) in &mut column.slots {
                if let Slot::Mixed(block) = slot {
                    block.surfaces = Cells::nothing();
                }
            }
        }
    }

    /// What changes in the blocks of a column by surfaces beside deep solid.
    fn beside_in(&self, (x, y): (i64, i64)) -> Vec<(i64, Cells<Stored>)> {
        let mut heights = Vec::new();
        for (i, j) in (-1..2).flat_map(|j| (-1..2).map(move |i| (x + i, y + j))) {
            for (z, slot) in &self.blocks.column(i, j).slots {
                if let Slot::Mixed(block) = slot
                    && !block.surfaces.values().is_empty()
                {
                    heights.extend(z - 1..z + 2);
                }
            }
        }
        heights.sort_unstable();
        heights.dedup();
        let changes = heights.into_iter().map(|z| (z, self.beside([x, y, z])));
        changes.filter_map(|(z, changes)| Some((z, changes?))).collect()
    }

    /// What changes in a block, if anything.
    fn beside(&self, at: [i64; 3]) -> Option<Cells<Stored>> {
        let part = part(&self.area, at);
        let [x, y, z] = at;
        let own = self.blocks.column(x, y).get(z);
        let nothing_deep = match &own {
            Block::Empty => true,
            Block::Solid => false,
            Block::Mixed(block) => *block.cells.solid() == NONE,
        };
        if nothing_deep || part.is_empty() {
            return None;
        }
        let around: [Option<&Cells<SurfaceLook>>; 27] = std::array::from_fn(|k| {
            let [i, j, k] = [k % 3, k / 3 % 3, k / 9].map(|d| d as i64 - 1);
            match self.blocks.column(x + i, y + j).get(z + k) {
                Block::Mixed(block) if !block.surfaces.values().is_empty() => Some(&block.surfaces),
                _ => None,
            }
        });
        // Rows of x with a cell more on each side, which is at bit 0; by y + 1 and z + 1.
        let mut met = [[0u16; 10]; 10];
        for (z, plane) in met.iter_mut().enumerate() {
            for (y, row) in plane.iter_mut().enumerate() {
                // Counted from the cell before the block.
                let [j, k] = [y, z].map(|c| c + 7);
                let first = k / 8 * 9 + j / 8 * 3;
                let byte =
                    |i: usize| around[first + i].map_or(0, |s| (s.held()[k % 8] >> (8 * (j % 8))) as u8);
                let [a, b, c] = [0, 1, 2].map(|i| u16::from(byte(i)));
                *row = a >> 7 | b << 1 | (c & 1) << 9;
            }
        }
        let deep = |block: &Block<Box<TexelBlock>>, z: usize, y: usize| match block {
            Block::Empty => 0,
            Block::Solid => u8::MAX,
            Block::Mixed(block) => (block.cells.solid()[z] >> (8 * y)) as u8,
        };
        let (mut changed, mut changes) = (NONE, Vec::new());
        let inside = bits(part.lo[0], part.hi[0]) as u16;
        for z in (part.lo[2]..part.hi[2]).map(|z| z.rem_euclid(SIDE) as usize) {
            for y in (part.lo[1]..part.hi[1]).map(|y| y.rem_euclid(SIDE) as usize) {
                let near = met[z..z + 3]
                    .iter()
                    .flat_map(|plane| &plane[y..y + 3])
                    .fold(0, |near, row| near | row);
                let below = met[z + 2][y + 1] >> 1;
                let solid = u16::from(deep(&own, z, y)) & inside;
                let mut left = solid & (near | near >> 1 | near >> 2);
                while left != 0 {
                    let x = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let hint = if below >> x & 1 == 1 {
                        look_of(surface_at(&around, [x + 1, y + 1, z + 2]))
                    } else {
                        mean_look(&around, &met, [x, y, z])
                    };
                    put(&mut changed, (z * 8 + y) * 8 + x);
                    changes.push(stored_solid(&hint, self.steps));
                }
            }
        }
        (changed != NONE).then(|| Cells::new(changed, NONE, changes))
    }

    /// Sets all samples of a chunk; `base` is the cell of its box's first one.
    pub(crate) fn fill(&self, base: [i64; 3], out: &mut ChunkBox) {
        let size = out.size().to_array();
        let cells = CellBox {
            lo: base,
            hi: std::array::from_fn(|k| base[k] + i64::from(size[k])),
        };
        let _ = self.for_each_block(&cells, |at, block| {
            if matches!(block, Block::Empty) {
                return ControlFlow::Continue(());
            }
            let inside = mask_of(&cells, at);
            let mut set = |place: usize, stored: &Stored, opacity: [u8; 4]| {
                let cell = cell_of(at, place);
                let place = std::array::from_fn(|k| (cell[k] - base[k]) as usize);
                out.set(place, stored.color, stored.normal, opacity);
            };
            let opacity = if self.axes { SOLID_OPACITY } else { [0; 4] };
            let mut deep = inside;
            if let Block::Mixed(block) = block {
                block.cells.each(|place, texel| {
                    if has(&inside, place) {
                        set(place, &texel.stored, texel.opacity);
                    }
                });
                block.beside.each(|place, stored| {
                    if has(&inside, place) {
                        set(place, stored, opacity);
                    }
                });
                deep = without(&both(block.cells.solid(), &inside), block.beside.held());
            }
            each_column(&deep, |x, y, mut left| {
                let [x, y, z] = cell_of(at, SIDE as usize * y + x);
                let stored = self.deep(x, y);
                let place = [(x - base[0]) as usize, (y - base[1]) as usize];
                while left != 0 {
                    let first = left.trailing_zeros();
                    let end = first + (left >> first).trailing_ones();
                    left &= (0xff_u16 << end) as u8;
                    let [first, end] = [first, end].map(|k| (z + i64::from(k) - base[2]) as usize);
                    out.set_run(place, first..end, stored.color, stored.normal, opacity);
                }
            });
            ControlFlow::Continue(())
        });
    }

    /// The texel of a cell of the area.
    pub(crate) fn at(&self, cell: [i64; 3]) -> Texel {
        let [x, y, z] = cell;
        let place = in_block(x, y, z);
        let [i, j, k] = cell.map(|v| v.div_euclid(SIDE));
        let beside = match self.blocks.column(i, j).get(k) {
            Block::Empty => return Texel::default(),
            Block::Solid => None,
            Block::Mixed(block) => match block.cells.get(place) {
                Cell::Empty => return Texel::default(),
                Cell::Held(texel) => return texel,
                Cell::Solid => block.beside.value(place).copied(),
            },
        };
        Texel {
            stored: beside.unwrap_or_else(|| self.deep(x, y)),
            opacity: if self.axes { SOLID_OPACITY } else { [0; 4] },
        }
    }

    /// Calls with the blocks of a box of cells in which anything is, until that breaks it off.
    fn for_each_block(
        &self,
        cells: &CellBox,
        mut call: impl FnMut([i64; 3], &Block<Box<TexelBlock>>) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let CellBox { lo, hi } = cells.blocks();
        for y in lo[1]..hi[1] {
            for x in lo[0]..hi[0] {
                let column = self.blocks.column(x, y);
                for z in lo[2]..hi[2] {
                    call([x, y, z], &column.get(z))?;
                }
            }
        }
        ControlFlow::Continue(())
    }

    /// What the texels of a cube from `base` on have in common.
    pub(crate) fn likeness(&self, base: [i64; 3], side: i64) -> Likeness {
        let cube = CellBox {
            lo: base,
            hi: base.map(|b| b + side),
        };
        // Most nodes have a surface through them, as the block in their middle tells.
        let middle = base.map(|b| (b + side / 2).div_euclid(SIDE));
        if let Block::Mixed(block) = self.blocks.column(middle[0], middle[1]).get(middle[2]) {
            let inside = mask_of(&cube, middle);
            let some = both(&either(block.cells.held(), block.cells.solid()), &inside);
            if some != NONE && some != inside {
                return Likeness::Mixed;
            }
        }
        let (mut seen, mut occupied, mut deep) = (0, 0, 0);
        let mixed = self.for_each_block(&cube, |at, block| {
            let inside = mask_of(&cube, at);
            let all = count(&inside);
            let (some, solid) = match block {
                Block::Empty => (0, 0),
                Block::Solid => (all, all),
                Block::Mixed(block) => {
                    let solid = both(block.cells.solid(), &inside);
                    let some = either(&both(block.cells.held(), &inside), &solid);
                    (count(&some), count(&solid))
                }
            };
            (seen, occupied, deep) = (seen + all, occupied + some, deep + solid);
            // Something, and nothing beside it: no more has to be seen.
            match occupied > 0 && occupied < seen {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        });
        match () {
            () if mixed.is_break() => return Likeness::Mixed,
            () if occupied == 0 => return Likeness::Equal([0; 4]),
            () if deep == seen => return Likeness::Deep,
            () => {}
        }
        let color = self.at(base).stored.color;
        let alike = Texel {
            stored: Stored {
                color,
                normal: [0; 4],
            },
            opacity: if self.axes {
                [color[3], color[3], color[3], 0]
            } else {
                [0; 4]
            },
        };
        let cells = (0..side * side * side).map(|k| [k % side, k / side % side, k / side / side]);
        let mut cells = cells.map(|cell| std::array::from_fn(|k| base[k] + cell[k]));
        if cells.all(|cell| self.at(cell) == alike) {
            Likeness::Equal(color)
        } else {
            Likeness::Mixed
        }
    }
}

/// The cell at a place in a block.
#[inline]
fn cell_of(block: [i64; 3], place: usize) -> [i64; 3] {
    let place = place as i64;
    [
        block[0] * SIDE + place % SIDE,
        block[1] * SIDE + place / SIDE % SIDE,
        block[2] * SIDE + place / SIDE / SIDE,
    ]
}

impl TexelBlock {
    /// All deep.
    fn solid() -> Self {
        Self {
            cells: Cells::new(NONE, [u64::MAX; SIDE as usize], Vec::new()),
            beside: Cells::nothing(),
            surfaces: Cells::nothing(),
        }
    }
}

/// The mean look of the surfaces around a cell of a block, of which there is at least one.
fn mean_look(
    around: &[Option<&Cells<SurfaceLook>>; 27],
    met: &[[u16; 10]; 10],
    [x, y, z]: [usize; 3],
) -> Hint {
    let (mut sum, mut count) = ([0.0f32; 8], 0.0f32);
    for (k, plane) in met[z..z + 3].iter().enumerate() {
        for (j, row) in plane[y..y + 3].iter().enumerate() {
            let mut left = *row >> x & 7;
            while left != 0 {
                let look = surface_at(around, [x + left.trailing_zeros() as usize, y + j, z + k]);
                left &= left - 1;
                (0..8).for_each(|c| sum[c] += look[c]);
                count += 1.0;
            }
        }
    }
    look_of(sum.map(|c| c / count))
}

/// The look of a surface by its place, counted from the cell before the block.
fn surface_at(around: &[Option<&Cells<SurfaceLook>>; 27], at: [usize; 3]) -> SurfaceLook {
    let at = at.map(|c| c + 7);
    let block = at[2] / 8 * 9 + at[1] / 8 * 3 + at[0] / 8;
    let place = (at[2] % 8 * 8 + at[1] % 8) * 8 + at[0] % 8;
    around[block]
        .and_then(|s| s.value(place))
        .copied()
        .unwrap_or_default()
}

fn look_of([r, g, b, x, y, z, _, _]: SurfaceLook) -> Hint {
    Hint {
        rgb: [r, g, b],
        normal: [x, y, z],
    }
}
