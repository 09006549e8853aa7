//! One level as it is stored: texels in blocks, and the cube of them that a brick holds.
//!
//! A texel is made once, where it is stored. Masks of a block's cells tell what is empty, deep or met by a surface, so that most
//! nodes are compared without looking at texels.

use rayon::prelude::*;

use brickfell_formats::value::{SOLID_ALPHA, Stored};

use super::blocks::{BLOCK, Block, BlockColumn, Blocks, Dense, Slot, block_columns, in_block, new_dense};
use super::filter::Skins;
use super::ground::{Hint, Hints};
use super::lattice::{CellBox, SIDE};
use super::sample::Sample;

/// A bit for each cell of a block: a word for each z, in it a byte for each y.
type Mask = [u64; SIDE as usize];

/// Linear light and normal of a surface, in floats to be added up, and two zeros.
pub(crate) type SurfaceLook = [f32; 8];

/// The texels of a block. Cells outside the area hold nothing.
#[derive(Debug)]
pub(crate) struct TexelBlock {
    color: [[u8; 4]; BLOCK],
    normal: [[i8; 4]; BLOCK],
    /// Opacities against the axes, where they are told apart.
    opacity: Option<Dense<[u8; 4]>>,
    /// Cells with anything in them.
    occupied: Mask,
    /// Cells that are solid all through and met by no surface.
    deep: Mask,
    /// Looks of the cells that a surface meets, as long as neighbours ask for them.
    surfaces: Surfaces,
}

/// The looks of a block's surfaces.
#[derive(Debug, Default)]
struct Surfaces {
    met: Mask,
    /// Number of the first look of each row of x.
    first: Vec<u16>,
    looks: Vec<SurfaceLook>,
}

/// The texels that a tree stores of one level.
pub(crate) struct TexelLevel {
    /// What is stored.
    area: CellBox,
    blocks: Blocks<Box<TexelBlock>>,
    /// Deep solid by column of cells of the area.
    solid: Vec<Stored>,
    axes: bool,
}

/// Samples of bricks, one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Cubes {
    pub(crate) color: Vec<[u8; 4]>,
    pub(crate) normal: Vec<[i8; 4]>,
    /// Empty where opacities are not told apart.
    pub(crate) opacity: Vec<[u8; 4]>,
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

/// The part of a box of cells that lies in a block.
fn part(cells: &CellBox, block: [i64; 3]) -> CellBox {
    cells.intersection(&CellBox {
        lo: block.map(|b| b * SIDE),
        hi: block.map(|b| (b + 1) * SIDE),
    })
}

/// Bits of a range of cells along an axis of their block.
fn bits(lo: i64, hi: i64) -> u64 {
    let first = lo.rem_euclid(SIDE);
    ((1 << (hi - lo)) - 1) << first
}

/// Calls with each z of a box in one block and the bits of its cells.
fn layers(part: &CellBox) -> impl Iterator<Item = (usize, u64)> {
    let row = bits(part.lo[0], part.hi[0]);
    let plane = (part.lo[1]..part.hi[1]).fold(0, |plane, y| plane | row << (8 * y.rem_euclid(SIDE)));
    (part.lo[2]..part.hi[2]).map(move |z| (z.rem_euclid(SIDE) as usize, plane))
}

impl TexelLevel {
    /// Stores the samples of an area (cells of the level), with their skins where those are not their own. `support` is what
    /// the samples are known for.
    pub(crate) fn new(
        samples: &Blocks<Dense<Sample>>,
        skins: Option<Skins>,
        hints: &Hints,
        area: CellBox,
        support: &CellBox,
    ) -> Self {
        // With a cell more on each side, neighbours of all that is stored can be looked at.
        let ring = area.grown(1);
        let ringed = ring.intersection(support) == ring;
        let looks = ringed && !hints.is_empty();
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
                Sample::DEEP.stored(hint)
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
                    Slot::Dense(samples) => {
                        let block = level.block(samples, skins, hints, &known, [x, y, *z], looks);
                        (*z, Slot::Dense(block))
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
        samples: &[Sample; BLOCK],
        skins: Option<Skins>,
        hints: &Hints,
        known: &CellBox,
        at: [i64; 3],
        looks: bool,
    ) -> Box<TexelBlock> {
        let mut block = TexelBlock::new(self.axes);
        let known = part(known, at);
        if looks {
            block.surfaces.first.resize((SIDE * SIDE) as usize, 0);
            let count = samples.iter().filter(|s| s.is_open()).count();
            block.surfaces.looks.reserve_exact(count);
        }
        for z in known.lo[2]..known.hi[2] {
            for y in known.lo[1]..known.hi[1] {
                if looks {
                    let row = in_block(0, y, z) / SIDE as usize;
                    block.surfaces.first[row] = block.surfaces.looks.len() as u16;
                }
                for x in known.lo[0]..known.hi[0] {
                    let place = in_block(x, y, z);
                    let sample = &samples[place];
                    if sample.is_empty() {
                        continue;
                    }
                    let (layer, bit) = (place / 64, 1 << (place % 64));
                    let deep = sample.is_deep();
                    if deep {
                        block.deep[layer] |= bit;
                    } else if looks && sample.is_open() {
                        block.surfaces.met[layer] |= bit;
                        block.surfaces.looks.push(sample.surface_look());
                    }
                    if !self.area.contains([x, y, z]) {
                        continue;
                    }
                    if deep {
                        block.put(place, self.deep(x, y), SOLID_OPACITY);
                        continue;
                    }
                    let hint = || {
                        if sample.is_surface() {
                            Hint::default()
                        } else {
                            hints.hint(x, y)
                        }
                    };
                    if let Some(skins) = skins {
                        let skins = skins.at([x, y, z]);
                        let [a, b, c] = skins;
                        let stored = sample.with_skin(a.max(b).max(c)).stored(hint());
                        let [x, y, z] = if self.axes {
                            sample.opacities(skins)
                        } else {
                            [0; 3]
                        };
                        block.put(place, stored, [x, y, z, 0]);
                    } else {
                        block.put(place, sample.stored(hint()), [0; 4]);
                    }
                }
            }
        }
        block
    }

    /// Gives deep solid beside surfaces their look: it is interpolated with them, and at the foot of a cliff the ground above
    /// its column is the cliff's top. What lies right below a surface has its look. Opacities do not count:
    /// those of the support's last cells are not final.
    fn look_beside(&mut self) {
        let extent = self.area.blocks();
        let places = block_columns(&extent);
        let changed: Vec<Vec<(i64, Changes)>> = places.par_iter().map(|at| self.beside_in(*at)).collect();
        for ((x, y), changes) in places.into_iter().zip(changed) {
            for (z, changes) in changes {
                let solid = match self.blocks.column(x, y).get(z) {
                    Block::Solid => Some(self.solid_block([x, y, z])),
                    _ => None,
                };
                let Some(column) = self.blocks.column_mut(x, y) else {
                    continue;
                };
                let k = match (column.slots.binary_search_by_key(&z, |s| s.0), solid) {
                    (Ok(k), None) => k,
                    (Ok(k), Some(solid)) => {
                        column.slots[k].1 = Slot::Dense(solid);
                        k
                    }
                    (Err(k), Some(solid)) => {
                        column.slots.insert(k, (z, Slot::Dense(solid)));
                        k
                    }
                    (Err(_), None) => continue,
                };
                if let Slot::Dense(block) = &mut column.slots[k].1 {
                    for (place, stored) in changes {
                        let place = usize::from(place);
                        (block.color[place], block.normal[place]) = (stored.color, stored.normal);
                    }
                }
            }
        }
        for column in self.blocks.columns_mut() {
            for (_, slot) in &mut column.slots {
                if let Slot::Dense(block) = slot {
                    block.surfaces = Surfaces::default();
                }
            }
        }
    }

    /// A block of deep solid with its texels.
    fn solid_block(&self, at: [i64; 3]) -> Box<TexelBlock> {
        let mut block = TexelBlock::new(self.axes);
        let part = part(&self.area, at);
        for z in part.lo[2]..part.hi[2] {
            for y in part.lo[1]..part.hi[1] {
                for x in part.lo[0]..part.hi[0] {
                    block.put(in_block(x, y, z), self.deep(x, y), SOLID_OPACITY);
                }
            }
        }
        block.deep = [u64::MAX; SIDE as usize];
        block
    }

    /// What changes in the blocks of a column by surfaces beside deep solid.
    fn beside_in(&self, (x, y): (i64, i64)) -> Vec<(i64, Changes)> {
        let mut heights = Vec::new();
        for (i, j) in (-1..2).flat_map(|j| (-1..2).map(move |i| (x + i, y + j))) {
            for (z, slot) in &self.blocks.column(i, j).slots {
                if let Slot::Dense(block) = slot
                    && !block.surfaces.looks.is_empty()
                {
                    heights.extend(z - 1..z + 2);
                }
            }
        }
        heights.sort_unstable();
        heights.dedup();
        let changes = heights.into_iter().map(|z| (z, self.beside([x, y, z])));
        changes.filter(|(_, changes)| !changes.is_empty()).collect()
    }

    /// What changes in a block.
    fn beside(&self, at: [i64; 3]) -> Changes {
        let part = part(&self.area, at);
        let [x, y, z] = at;
        let own = self.blocks.column(x, y).get(z);
        let nothing_deep = match &own {
            Block::Empty => true,
            Block::Solid => false,
            Block::Dense(block) => block.deep == [0; SIDE as usize],
        };
        if nothing_deep || part.is_empty() {
            return Vec::new();
        }
        let around: [Option<&Surfaces>; 27] = std::array::from_fn(|k| {
            let [i, j, k] = [k % 3, k / 3 % 3, k / 9].map(|d| d as i64 - 1);
            match self.blocks.column(x + i, y + j).get(z + k) {
                Block::Dense(block) if !block.surfaces.looks.is_empty() => Some(&block.surfaces),
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
                let byte = |i: usize| around[first + i].map_or(0, |s| (s.met[k % 8] >> (8 * (j % 8))) as u8);
                let [a, b, c] = [0, 1, 2].map(|i| u16::from(byte(i)));
                *row = a >> 7 | b << 1 | (c & 1) << 9;
            }
        }
        let deep = |block: &Block<Box<TexelBlock>>, z: usize, y: usize| match block {
            Block::Empty => 0,
            Block::Solid => u8::MAX,
            Block::Dense(block) => (block.deep[z] >> (8 * y)) as u8,
        };
        let mut changes = Vec::new();
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
                    changes.push((((z * 8 + y) * 8 + x) as u16, Sample::DEEP.stored(hint)));
                }
            }
        }
        changes
    }

    /// Appends the cube of `side`³ texels from `base` on, x fastest.
    pub(crate) fn gather(&self, base: [i64; 3], side: i64, out: &mut Cubes) {
        let first = out.color.len();
        let end = first + (side * side * side) as usize;
        out.color.resize(end, [0; 4]);
        out.normal.resize(end, [0; 4]);
        if self.axes {
            out.opacity.resize(end, [0; 4]);
        }
        let cube = CellBox {
            lo: base,
            hi: base.map(|b| b + side),
        };
        self.for_each_block(&cube, |at, block| {
            let part = part(&cube, at);
            let len = (part.hi[0] - part.lo[0]) as usize;
            for z in part.lo[2]..part.hi[2] {
                for y in part.lo[1]..part.hi[1] {
                    let to =
                        first + (((z - base[2]) * side + y - base[1]) * side + part.lo[0] - base[0]) as usize;
                    let to = to..to + len;
                    if let Block::Dense(block) = block {
                        let from = in_block(part.lo[0], y, z);
                        let from = from..from + len;
                        copy(&mut out.color[to.clone()], &block.color[from.clone()]);
                        copy(&mut out.normal[to.clone()], &block.normal[from.clone()]);
                        if let Some(opacity) = &block.opacity {
                            copy(&mut out.opacity[to], &opacity[from]);
                        }
                    } else {
                        for (to, x) in to.zip(part.lo[0]..) {
                            let deep = self.deep(x, y);
                            (out.color[to], out.normal[to]) = (deep.color, deep.normal);
                            if self.axes {
                                out.opacity[to] = SOLID_OPACITY;
                            }
                        }
                    }
                }
            }
        });
    }

    /// Calls with the blocks of a box of cells in which anything is.
    fn for_each_block(&self, cells: &CellBox, mut call: impl FnMut([i64; 3], &Block<Box<TexelBlock>>)) {
        let CellBox { lo, hi } = cells.blocks();
        for y in lo[1]..hi[1] {
            for x in lo[0]..hi[0] {
                let column = self.blocks.column(x, y);
                for z in lo[2]..hi[2] {
                    let block = column.get(z);
                    if !matches!(block, Block::Empty) {
                        call([x, y, z], &block);
                    }
                }
            }
        }
    }

    /// What the texels of such a cube have in common.
    pub(crate) fn likeness(&self, base: [i64; 3], side: i64) -> Likeness {
        let cube = CellBox {
            lo: base,
            hi: base.map(|b| b + side),
        };
        let (mut occupied, mut deep) = (0, 0);
        self.for_each_block(&cube, |at, block| {
            for (z, plane) in layers(&part(&cube, at)) {
                let of = |mask: &Mask| (mask[z] & plane).count_ones();
                let counts = match block {
                    Block::Dense(block) => [of(&block.occupied), of(&block.deep)],
                    _ => [plane.count_ones(); 2],
                };
                (occupied, deep) = (occupied + counts[0], deep + counts[1]);
            }
        });
        let all = (side * side * side) as u32;
        match () {
            () if occupied == 0 => return Likeness::Equal([0; 4]),
            () if deep == all => return Likeness::Deep,
            () if occupied < all => return Likeness::Mixed,
            () => {}
        }
        let mut cubes = Cubes::default();
        self.gather(base, side, &mut cubes);
        let Some(&color) = cubes.color.first() else {
            return Likeness::Mixed;
        };
        let [_, _, _, a] = color;
        let alike = cubes.color.iter().all(|c| *c == color)
            && cubes.normal.iter().all(|n| *n == [0; 4])
            && cubes.opacity.iter().all(|o| *o == [a, a, a, 0]);
        if alike {
            Likeness::Equal(color)
        } else {
            Likeness::Mixed
        }
    }
}

/// Copies a part of a row: nearly all are a block's width or one cell, and a call would cost more than they do.
#[inline]
fn copy<T: Copy>(to: &mut [T], from: &[T]) {
    const WHOLE: usize = SIDE as usize;
    if let (Some(to), Some(from)) = (to.first_chunk_mut::<WHOLE>(), from.first_chunk::<WHOLE>()) {
        *to = *from;
        return;
    }
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}

/// Texels that change in a block, by place.
type Changes = Vec<(u16, Stored)>;

impl TexelBlock {
    fn new(axes: bool) -> Box<Self> {
        Box::new(Self {
            color: [[0; 4]; BLOCK],
            normal: [[0; 4]; BLOCK],
            opacity: axes.then(new_dense),
            occupied: [0; SIDE as usize],
            deep: [0; SIDE as usize],
            surfaces: Surfaces::default(),
        })
    }

    #[inline]
    fn put(&mut self, place: usize, stored: Stored, opacity: [u8; 4]) {
        (self.color[place], self.normal[place]) = (stored.color, stored.normal);
        if let Some(opacities) = &mut self.opacity {
            opacities[place] = opacity;
        }
        if stored != Stored::default() || opacity != [0; 4] {
            self.occupied[place / 64] |= 1 << (place % 64);
        }
    }
}

impl Surfaces {
    /// The look of the cell at a bit of a row, which is set.
    fn look(&self, row: usize, x: usize) -> &SurfaceLook {
        let byte = (self.met[row / 8] >> (8 * (row % 8))) as u8;
        let before = byte & ((1 << x) - 1);
        &self.looks[usize::from(self.first[row]) + before.count_ones() as usize]
    }
}

/// The mean look of the surfaces around a cell of a block, of which there is at least one.
fn mean_look(around: &[Option<&Surfaces>; 27], met: &[[u16; 10]; 10], [x, y, z]: [usize; 3]) -> Hint {
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
fn surface_at(around: &[Option<&Surfaces>; 27], at: [usize; 3]) -> SurfaceLook {
    let at = at.map(|c| c + 7);
    let block = at[2] / 8 * 9 + at[1] / 8 * 3 + at[0] / 8;
    around[block].map_or([0.0; 8], |s| *s.look(at[2] % 8 * 8 + at[1] % 8, at[0] % 8))
}

fn look_of([r, g, b, x, y, z, _, _]: SurfaceLook) -> Hint {
    Hint {
        rgb: [r, g, b],
        normal: [x, y, z],
    }
}
