//! One level as it is stored: texels in blocks, and the cube of them that a brick holds.

use rayon::prelude::*;

use super::blocks::{Block, BlockColumn, Blocks, Slot, block_columns, in_block, new_dense};
use super::ground::Hints;
use super::lattice::{CellBox, SIDE};
use super::sample::{Sample, Texel};

/// The texels that a tree stores of one level.
pub(crate) struct TexelLevel {
    blocks: Blocks<Texel>,
    area: CellBox,
    /// Texel of deep solid by column of cells of `area`.
    solid: Vec<Texel>,
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

impl TexelLevel {
    /// Stores the samples of an area (cells of the level).
    pub(crate) fn new(samples: &Blocks<Sample>, hints: &Hints, area: CellBox) -> Self {
        let extent = area.blocks();
        let columns = block_columns(&extent)
            .into_par_iter()
            .map(|(x, y)| {
                let column = samples.column(x, y);
                let near = column
                    .slots
                    .iter()
                    .filter(|s| (extent.lo[2]..extent.hi[2]).contains(&s.0));
                let slots = near.map(|(z, slot)| (*z, store(slot, hints, x, y))).collect();
                BlockColumn {
                    solid: column.solid.clone(),
                    slots,
                }
            })
            .collect();
        let width = area.hi[0] - area.lo[0];
        let solid = (0..width * (area.hi[1] - area.lo[1]))
            .into_par_iter()
            .map(|k| Sample::DEEP.texel(hints.hint(area.lo[0] + k % width, area.lo[1] + k / width)))
            .collect();
        Self {
            blocks: Blocks::new(&extent, columns),
            area,
            solid,
        }
    }

    /// The blocks.
    pub(crate) fn blocks(&self) -> &Blocks<Texel> {
        &self.blocks
    }

    /// Whether the own cells of a node, given by its first, are one block whose opacities differ: then nothing more
    /// need be looked at to know that it is no constant.
    pub(crate) fn mixed(&self, cell: [i64; 3]) -> bool {
        let [x, y, z] = cell.map(|c| c.div_euclid(SIDE));
        let aligned = cell.iter().all(|c| c % SIDE == 0);
        match self.blocks.column(x, y).get(z) {
            Block::Dense(texels) if aligned => {
                let first = texels[0];
                texels.iter().any(|t| t.color[3] != first.color[3])
            }
            _ => false,
        }
    }

    /// Copies the cube of `side`³ texels from `base` on, x fastest.
    pub(crate) fn gather(&self, base: [i64; 3], side: i64, out: &mut Vec<Texel>) {
        out.clear();
        out.resize((side * side * side) as usize, Texel::default());
        let blocks = CellBox {
            lo: base,
            hi: base.map(|b| b + side),
        }
        .blocks();
        let width = self.area.hi[0] - self.area.lo[0];
        for (bx, by) in block_columns(&blocks) {
            let column = self.blocks.column(bx, by);
            for bz in blocks.lo[2]..blocks.hi[2] {
                let block = column.get(bz);
                if matches!(block, Block::Empty) {
                    continue;
                }
                let b = [bx, by, bz];
                let lo: [i64; 3] = std::array::from_fn(|k| (b[k] * SIDE).max(base[k]));
                let hi: [i64; 3] = std::array::from_fn(|k| ((b[k] + 1) * SIDE).min(base[k] + side));
                let len = (hi[0] - lo[0]) as usize;
                for y in lo[1]..hi[1] {
                    let column_of_cells = ((y - self.area.lo[1]) * width + lo[0] - self.area.lo[0]) as usize;
                    for z in lo[2]..hi[2] {
                        let to = (((z - base[2]) * side + y - base[1]) * side + lo[0] - base[0]) as usize;
                        let from = match &block {
                            Block::Dense(dense) => &dense[in_block(lo[0], y, z)..][..len],
                            _ => &self.solid[column_of_cells..column_of_cells + len],
                        };
                        out[to..to + len].copy_from_slice(from);
                    }
                }
            }
        }
    }
}

fn store(slot: &Slot<Sample>, hints: &Hints, x: i64, y: i64) -> Slot<Texel> {
    let Slot::Dense(samples) = slot else {
        return Slot::Solid;
    };
    let mut texels = new_dense::<Texel>();
    for j in 0..SIDE {
        for i in 0..SIDE {
            let hint = hints.hint(x * SIDE + i, y * SIDE + j);
            let deep = Sample::DEEP.texel(hint);
            for k in 0..SIDE {
                let at = in_block(i, j, k);
                let sample = &samples[at];
                texels[at] = match sample {
                    s if s.is_empty() => Texel::default(),
                    s if s.is_deep() => deep,
                    s => s.texel(hint),
                };
            }
        }
    }
    Slot::Dense(texels)
}

/// What texels have in common.
pub(crate) fn likeness(texels: &[Texel]) -> Likeness {
    let Some(first) = texels.first() else {
        return Likeness::Mixed;
    };
    if texels.iter().all(|t| t.deep) {
        Likeness::Deep
    } else if texels
        .iter()
        .all(|t| t.color == first.color && t.normal == [0; 3])
    {
        Likeness::Equal(first.color)
    } else {
        Likeness::Mixed
    }
}
