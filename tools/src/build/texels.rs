//! One level as it is stored: texels in blocks, and the cube of them that a brick holds.

use rayon::prelude::*;

use brickfell_formats::value::SOLID_ALPHA;

use super::blocks::{BLOCK, Block, BlockColumn, Blocks, Dense, Slot, block_columns, in_block, new_dense};
use super::filter::Skins;
use super::ground::Hints;
use super::lattice::{CellBox, SIDE};
use super::sample::{CodedLook, Matter, Sample, Texel};

/// The texels that a tree stores of one level.
pub(crate) struct TexelLevel {
    area: CellBox,
    /// Whether the area has a cell more on each side than is stored, so that neighbours of all that is can be looked at.
    ringed: bool,
    texels: Layer<Texel>,
    /// Opacities against the axes, where they are told apart.
    opacities: Option<Layer<[u8; 3]>>,
}

/// One kind of thing in all cells of a level.
struct Layer<T> {
    blocks: Blocks<T>,
    /// That of deep solid by column of cells of the area.
    solid: Vec<T>,
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
    /// Stores the samples of an area (cells of the level), with their skins where those are not their own. `support` is what
    /// the samples are known for.
    pub(crate) fn new(
        samples: &Blocks<Sample>,
        skins: Option<Skins>,
        hints: &Hints,
        area: CellBox,
        support: &CellBox,
    ) -> Self {
        let ring = area.grown(1);
        let ringed = ring.intersection(support) == ring;
        let area = if ringed { ring } else { area };
        let width = area.hi[0] - area.lo[0];
        let columns = width * (area.hi[1] - area.lo[1]);
        let solid = (0..columns)
            .into_par_iter()
            .map(|k| Sample::DEEP.texel(hints.hint(area.lo[0] + k % width, area.lo[1] + k / width)))
            .collect();
        let opacities = |skins: Skins| Layer {
            blocks: store(samples, &area, |samples, at| {
                let mut opacities = new_dense::<[u8; 3]>();
                for (place, (opacity, sample)) in opacities.iter_mut().zip(samples.iter()).enumerate() {
                    *opacity = sample.opacities(skins.at(cell_of(at, place)));
                }
                opacities
            }),
            solid: vec![[SOLID_ALPHA; 3]; columns as usize],
        };
        Self {
            area,
            ringed,
            texels: Layer {
                blocks: store(samples, &area, |samples, at| texels(samples, skins, hints, at)),
                solid,
            },
            opacities: skins.filter(|s| s.axes).map(opacities),
        }
    }

    /// The blocks.
    pub(crate) fn blocks(&self) -> &Blocks<Texel> {
        &self.texels.blocks
    }

    /// Whether the own cells of a node, given by its first, are one block whose opacities differ: then nothing more
    /// need be looked at to know that it is no constant.
    pub(crate) fn mixed(&self, cell: [i64; 3]) -> bool {
        let [x, y, z] = cell.map(|c| c.div_euclid(SIDE));
        let aligned = cell.iter().all(|c| c % SIDE == 0);
        match self.blocks().column(x, y).get(z) {
            Block::Dense(texels) if aligned => {
                let first = texels[0];
                texels.iter().any(|t| t.color[3] != first.color[3])
            }
            _ => false,
        }
    }

    /// Copies the cube of `side`³ texels from `base` on, x fastest. Deep solid beside surfaces gets their look: it is
    /// interpolated with them, and at the foot of a cliff the ground above its column is the cliff's top. Opacities do not
    /// count: those of the support's last cells are not final.
    pub(crate) fn gather(&self, base: [i64; 3], side: i64, out: &mut Vec<Texel>) {
        if !self.ringed {
            return self.texels.gather(&self.area, base, side, out);
        }
        let (mut ring, n) = (Vec::new(), side + 2);
        self.texels.gather(&self.area, base.map(|b| b - 1), n, &mut ring);
        out.clear();
        let surfaces = ring.iter().any(|t| t.matter == Matter::Surface);
        for z in 0..side {
            for y in 0..side {
                let row = (((z + 1) * n + y + 1) * n + 1) as usize;
                if !surfaces {
                    out.extend_from_slice(&ring[row..row + side as usize]);
                    continue;
                }
                for x in 0..side {
                    let at = row as i64 + x;
                    let texel = ring[at as usize];
                    let above = ring[(at + n * n) as usize];
                    let lone = [texel, above].iter().all(|t| t.matter == Matter::Deep);
                    out.push(if lone {
                        beside(&ring, at, n).unwrap_or(texel)
                    } else {
                        texel
                    });
                }
            }
        }
    }

    /// Copies the opacities of such a cube; false if they are not told apart.
    pub(crate) fn gather_opacities(&self, base: [i64; 3], side: i64, out: &mut Vec<[u8; 3]>) -> bool {
        let Some(opacities) = &self.opacities else {
            return false;
        };
        opacities.gather(&self.area, base, side, out);
        true
    }

    /// What the texels of such a cube have in common.
    pub(crate) fn likeness(&self, base: [i64; 3], side: i64, cube: &mut Vec<Texel>) -> Likeness {
        self.texels.gather(&self.area, base, side, cube);
        let Some(first) = cube.first() else {
            return Likeness::Mixed;
        };
        if cube.iter().all(|t| t.matter == Matter::Deep) {
            return Likeness::Deep;
        }
        let color = first.color;
        let mut opacities = Vec::new();
        let alike = cube.iter().all(|t| t.color == color && t.normal == [0; 3])
            && (!self.gather_opacities(base, side, &mut opacities)
                || opacities.iter().all(|o| *o == [color[3]; 3]));
        if alike {
            Likeness::Equal(color)
        } else {
            Likeness::Mixed
        }
    }
}

/// Deep solid with the mean look of the surfaces around it in a cube of `n`³ texels, if there are any.
fn beside(cube: &[Texel], at: i64, n: i64) -> Option<Texel> {
    let mut surfaces = [CodedLook::default(); 27];
    let mut count = 0;
    for z in -1..2 {
        for y in -1..2 {
            let row = (at + (z * n + y) * n - 1) as usize;
            for texel in &cube[row..row + 3] {
                if texel.matter == Matter::Surface {
                    surfaces[count] = texel.look;
                    count += 1;
                }
            }
        }
    }
    CodedLook::mean(surfaces[..count].iter().copied()).map(|look| Sample::DEEP.texel(look))
}

impl<T: Copy + Default> Layer<T> {
    fn gather(&self, area: &CellBox, base: [i64; 3], side: i64, out: &mut Vec<T>) {
        out.clear();
        out.resize((side * side * side) as usize, T::default());
        let blocks = CellBox {
            lo: base,
            hi: base.map(|b| b + side),
        }
        .blocks();
        let width = area.hi[0] - area.lo[0];
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
                    let column_of_cells = ((y - area.lo[1]) * width + lo[0] - area.lo[0]) as usize;
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

/// Makes something of all dense blocks of samples in an area, given their samples and places.
fn store<T: Send>(
    samples: &Blocks<Sample>,
    area: &CellBox,
    make: impl Fn(&Dense<Sample>, [i64; 3]) -> Dense<T> + Sync,
) -> Blocks<T> {
    let extent = area.blocks();
    let heights = extent.lo[2]..extent.hi[2];
    let columns = block_columns(&extent)
        .into_par_iter()
        .map(|(x, y)| {
            let column = samples.column(x, y);
            let near = column.slots.iter().filter(|s| heights.contains(&s.0));
            let slots = near.map(|(z, slot)| match slot {
                Slot::Dense(samples) => (*z, Slot::Dense(make(samples, [x, y, *z]))),
                Slot::Solid => (*z, Slot::Solid),
            });
            BlockColumn {
                solid: column.solid.clone(),
                slots: slots.collect(),
            }
        })
        .collect();
    Blocks::new(&extent, columns)
}

/// The cell at an index of a block.
fn cell_of(block: [i64; 3], place: usize) -> [i64; 3] {
    let k = place as i64;
    let [x, y, z] = block.map(|b| b * SIDE);
    [x + k % SIDE, y + k / SIDE % SIDE, z + k / (SIDE * SIDE)]
}

fn texels(samples: &Dense<Sample>, skins: Option<Skins>, hints: &Hints, block: [i64; 3]) -> Dense<Texel> {
    let mut texels = new_dense::<Texel>();
    for column in 0..(SIDE * SIDE) as usize {
        let [x, y, _] = cell_of(block, column);
        let hint = hints.hint(x, y);
        let deep = Sample::DEEP.texel(hint);
        for place in (column..BLOCK).step_by((SIDE * SIDE) as usize) {
            let sample = samples[place];
            texels[place] = if sample.is_empty() {
                Texel::default()
            } else if sample.is_deep() {
                deep
            } else if let Some(skins) = skins {
                let [a, b, c] = skins.at(cell_of(block, place));
                sample.with_skin(a.max(b).max(c)).texel(hint)
            } else {
                sample.texel(hint)
            };
        }
    }
    texels
}
