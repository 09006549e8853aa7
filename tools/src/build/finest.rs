//! The finest level of one tree and its margin: height maps column by column, triangles cell by cell.
//!
//! Work is cut into tiles of block columns, each done by one thread; what a cell gets does not depend on the cut.

use rayon::prelude::*;

use super::blocks::{BlockColumn, Blocks, Slot};
use super::cells::{BLOCK, Cells, Mask, NONE, both, count, each, either, mask_of, without};
use super::faces::Binned;
use super::facets::{FacetBlock, FacetBlocks, Facets};
use super::filter::{Cover, Level, thinned};
use super::ground::{Ground, GroundGrid};
use super::inside::Inside;
use super::lattice::{CellBox, Lattice, Region, SIDE};
use super::overlap::{Voxelise, for_each_cell};
use super::sample::{Look, Sample};
use super::spill::{Reader, Writer};
use super::surface::Shader;
use crate::input::{InputError, Material, Placing};

/// Block columns of a tile per axis.
const TILE: i64 = 8;

/// What the finest level of a region is made from.
pub(crate) struct Sources<'a> {
    pub(crate) lattice: Lattice,
    pub(crate) region: Region,
    /// Height maps over the region and its margin.
    pub(crate) grids: &'a [GroundGrid],
    /// Lowest solid cell of a column of trees; `None` where it has no ground.
    pub(crate) bottom: &'a (dyn Fn((i64, i64)) -> Option<i64> + Sync),
    pub(crate) materials: &'a [(Material, Placing)],
    /// The faces that may meet the region and its margin, in order.
    pub(crate) faces: &'a [Binned],
    /// What lies inside of closed meshes, if that is solid.
    pub(crate) inside: Option<&'a Inside>,
    /// Which cells triangles leave something in.
    pub(crate) by: Voxelise,
    /// Whether the filter asks for what samples cover.
    pub(crate) covers: bool,
}

/// A region's own cells that a surface meets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Met {
    pub(crate) count: u64,
    /// Their box; meaningless while the count is 0.
    pub(crate) bounds: Option<CellBox>,
}

impl Met {
    /// Writes it.
    pub(crate) fn write(&self, out: &mut Writer) {
        let bounds = self.bounds.unwrap_or(CellBox {
            lo: [0; 3],
            hi: [0; 3],
        });
        out.put(&self.count);
        out.put(&[bounds.lo, bounds.hi]);
    }

    /// What was written.
    pub(crate) fn read(reader: &mut Reader) -> Option<Self> {
        let count = reader.get()?;
        let [lo, hi] = reader.get()?;
        let bounds = CellBox { lo, hi };
        Some(Self {
            count,
            bounds: (!bounds.is_empty()).then_some(bounds),
        })
    }

    /// Adds cells of a block.
    fn add(&mut self, block: [i64; 3], cells: &Mask) {
        let Some(first) = cells.iter().position(|layer| *layer != 0) else {
            return;
        };
        let last = cells.iter().rposition(|layer| *layer != 0).unwrap_or(first);
        let plane = cells.iter().fold(0, |plane, layer| plane | layer);
        let rows = [plane.trailing_zeros() / 8, 7 - plane.leading_zeros() / 8];
        let row = plane.to_le_bytes().iter().fold(0, |row, byte| row | byte);
        let columns = [row.trailing_zeros(), 7 - row.leading_zeros()];
        let ends = [columns, rows, [first as u32, last as u32]];
        *self = self.with(&Met {
            count: u64::from(count(cells)),
            bounds: Some(CellBox {
                lo: std::array::from_fn(|k| SIDE * block[k] + i64::from(ends[k][0])),
                hi: std::array::from_fn(|k| SIDE * block[k] + i64::from(ends[k][1]) + 1),
            }),
        });
    }

    /// Those of both.
    pub(crate) fn with(&self, other: &Met) -> Met {
        let bounds = match (self.bounds, other.bounds) {
            (Some(a), Some(b)) => Some(CellBox {
                lo: std::array::from_fn(|k| a.lo[k].min(b.lo[k])),
                hi: std::array::from_fn(|k| a.hi[k].max(b.hi[k])),
            }),
            (a, b) => a.or(b),
        };
        Met {
            count: self.count + other.count,
            bounds,
        }
    }
}

/// A column of blocks, and what their samples cover.
type Column = (BlockColumn<Cells<Sample>>, BlockColumn<Cells<Cover>>);

/// Voxelises the finest level.
///
/// # Errors
/// If a part of a texture cannot be read.
pub(crate) fn voxelise(sources: &Sources) -> Result<(Level, Met), InputError> {
    let extent = sources.region.support(0).blocks();
    let tiles = tiles(&extent);
    let lists = faces_by_tile(sources, &tiles);
    let done: Vec<(Vec<Column>, Met)> = tiles
        .par_iter()
        .zip(&lists)
        .map(|(tile, list)| voxelise_tile(sources, tile, list))
        .collect::<Result<_, _>>()?;
    let width = extent.hi[0] - extent.lo[0];
    let count = width * (extent.hi[1] - extent.lo[1]);
    let mut columns: Vec<Column> = (0..count).map(|_| Default::default()).collect();
    let mut met = Met::default();
    for (tile, (tile_columns, tile_met)) in tiles.iter().zip(done) {
        met = met.with(&tile_met);
        for ((x, y), column) in super::blocks::block_columns(tile).into_iter().zip(tile_columns) {
            columns[((y - extent.lo[1]) * width + x - extent.lo[0]) as usize] = column;
        }
    }
    let (samples, covers): (Vec<_>, Vec<_>) = columns.into_iter().unzip();
    let covers = sources.covers.then(|| Blocks::new(&extent, covers));
    Ok((Level::finest(Blocks::new(&extent, samples), covers), met))
}

/// Cuts an extent (in blocks) into tiles.
fn tiles(extent: &CellBox) -> Vec<CellBox> {
    let steps = |k: usize| (extent.lo[k]..extent.hi[k]).step_by(TILE as usize);
    steps(1)
        .flat_map(|y| steps(0).map(move |x| (x, y)))
        .map(|(x, y)| CellBox {
            lo: [x, y, extent.lo[2]],
            hi: [
                (x + TILE).min(extent.hi[0]),
                (y + TILE).min(extent.hi[1]),
                extent.hi[2],
            ],
        })
        .collect()
}

fn cells(blocks: &CellBox) -> CellBox {
    CellBox {
        lo: blocks.lo.map(|b| b * SIDE),
        hi: blocks.hi.map(|b| b * SIDE),
    }
}

/// The box of cells around a triangle.
pub(crate) fn triangle_cells(corners: &[glam::DVec3; 3]) -> CellBox {
    let lo = corners[0].min(corners[1]).min(corners[2]).floor();
    let hi = corners[0].max(corners[1]).max(corners[2]).floor();
    CellBox {
        lo: lo.to_array().map(|v| v as i64),
        hi: hi.to_array().map(|v| v as i64 + 1),
    }
}

fn faces_by_tile(sources: &Sources, tiles: &[CellBox]) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); tiles.len()];
    let (Some(first), Some(last)) = (tiles.first(), tiles.last()) else {
        return lists;
    };
    let all = cells(&CellBox {
        lo: first.lo,
        hi: last.hi,
    });
    let across = (last.hi[0] - first.lo[0] + TILE - 1) / TILE;
    let tile_cells = TILE * SIDE;
    for (number, binned) in sources.faces.iter().enumerate() {
        let corners = binned.face.corners.map(|p| sources.lattice.cells_of(p));
        let met = triangle_cells(&corners).intersection(&all);
        if met.is_empty() {
            continue;
        }
        let range =
            |k: usize| (met.lo[k] - all.lo[k]) / tile_cells..(met.hi[k] - 1 - all.lo[k]) / tile_cells + 1;
        for j in range(1) {
            for i in range(0) {
                lists[(j * across + i) as usize].push(number as u32);
            }
        }
    }
    lists
}

fn voxelise_tile(sources: &Sources, tile: &CellBox, faces: &[u32]) -> Result<(Vec<Column>, Met), InputError> {
    let mut facets = FacetBlocks::new(tile);
    let clip = cells(tile);
    for number in faces {
        let binned = &sources.faces[*number as usize];
        let corners = binned.face.corners.map(|p| sources.lattice.cells_of(p));
        // What a thin surface meets it covers as a whole.
        let whole = (sources.covers && sources.by == Voxelise::Thin).then_some(Cover::WHOLE);
        let outlines = sources.covers && whole.is_none();
        let Some(mut shader) = Shader::new(binned, &corners, sources.materials, outlines) else {
            continue;
        };
        let mut failed = None;
        for_each_cell(&corners, &clip, sources.by, |cell| {
            let facet = match shader.facet(cell) {
                Ok(Some(facet)) => facet,
                Ok(None) => return,
                Err(e) => return failed = Some(e),
            };
            let facets = facets.at(cell);
            facets.add(&facet);
            if let Some(cover) = whole.or_else(|| shader.outline(cell)) {
                facets.cover = facets
                    .cover
                    .with(thinned(cover, facet.skin, cell, binned.number as i64));
            }
        });
        if let Some(e) = failed {
            return Err(e);
        }
    }
    let facets = facets.sorted();
    let own = sources.region.own;
    let mut met = Met::default();
    let columns = super::blocks::block_columns(tile)
        .into_iter()
        .map(|(x, y)| {
            let column = GroundColumn::new(sources, x, y, tile);
            let first = facets.partition_point(|b| [b.at[0], b.at[1]] < [x, y]);
            let count = facets[first..].partition_point(|b| [b.at[0], b.at[1]] == [x, y]);
            let with_facets = &facets[first..first + count];
            let mut heights: Vec<i64> = column.dense.clone().collect();
            heights.extend(with_facets.iter().map(|b| b.at[2]));
            let filled = sources
                .inside
                .map_or_else(Vec::new, |inside| inside.blocks([x, y], tile.lo[2]..tile.hi[2]));
            heights.extend(filled.iter().map(|f| f.0));
            heights.sort_unstable();
            heights.dedup();
            let mut slots = Vec::with_capacity(heights.len());
            let mut covers = BlockColumn::default();
            for z in heights {
                let facets = with_facets
                    .binary_search_by_key(&z, |b| b.at[2])
                    .ok()
                    .map(|k| &with_facets[k]);
                let inside = filled.binary_search_by_key(&z, |f| f.0).ok();
                if facets.is_none() && inside.is_some_and(|k| filled[k].1 as usize == BLOCK) {
                    slots.push((z, Slot::Solid));
                    continue;
                }
                let inside = sources.inside.map(|inside| (inside, [x, y]));
                if let Some((cells, surface)) = column.block(z, facets, inside, sources.covers) {
                    met.add([x, y, z], &both(&surface, &mask_of(&own, [x, y, z])));
                    slots.push((z, Slot::Mixed(cells)));
                }
                if let (true, Some(facets)) = (sources.covers, facets) {
                    covers.slots.extend(facets.covers().map(|c| (z, Slot::Mixed(c))));
                }
            }
            let samples = BlockColumn {
                solid: column.solid,
                slots,
            };
            (samples, covers)
        })
        .collect();
    Ok((columns, met))
}

/// The ground in one column of blocks.
struct GroundColumn {
    /// Per layer, the ground of the 64 columns of cells.
    layers: Vec<[Option<Ground>; (SIDE * SIDE) as usize]>,
    bottom: i64,
    /// Blocks that are solid all through.
    solid: std::ops::Range<i64>,
    /// Further blocks that have ground.
    dense: std::ops::Range<i64>,
}

impl GroundColumn {
    fn new(sources: &Sources, x: i64, y: i64, tile: &CellBox) -> Self {
        let nothing = Self {
            layers: Vec::new(),
            bottom: 0,
            solid: 0..0,
            dense: 0..0,
        };
        let Some(bottom) = (sources.bottom)(sources.lattice.column_of(x * SIDE, y * SIDE)) else {
            return nothing;
        };
        let layers: Vec<[Option<Ground>; 64]> = sources
            .grids
            .iter()
            .map(|grid| {
                std::array::from_fn(|k| grid.ground(x * SIDE + k as i64 % SIDE, y * SIDE + k as i64 / SIDE))
            })
            .filter(|layer: &[Option<Ground>; 64]| layer.iter().any(Option::is_some))
            .collect();
        if layers.is_empty() {
            return nothing;
        }
        let all = || layers.iter().flatten().flatten();
        let lowest = all().map(|g| g.lowest).min().unwrap_or(bottom);
        let highest = all().map(|g| g.highest).max().unwrap_or(bottom);
        let closed = (0..64).all(|k| layers.iter().any(|l| l[k].is_some()));
        let clamp = |z: i64| z.clamp(tile.lo[2], tile.hi[2]);
        let first = clamp(bottom.div_euclid(SIDE));
        let end = clamp(highest.div_euclid(SIDE) + 1);
        let whole = clamp((bottom + SIDE - 1).div_euclid(SIDE));
        // A column with holes, or one whose bottom cuts a block, is dense all the way down.
        let solid = if closed && whole == first {
            whole..clamp(lowest.div_euclid(SIDE)).max(whole)
        } else {
            0..0
        };
        let dense = if solid.is_empty() {
            first..end
        } else {
            solid.end..end
        };
        Self {
            layers,
            bottom,
            solid,
            dense,
        }
    }

    /// The samples of the block at a height, and which of them a surface meets; `None` if nothing is in it.
    fn block(
        &self,
        block: i64,
        facets: Option<&FacetBlock>,
        inside: Option<(&Inside, [i64; 2])>,
        covers: bool,
    ) -> Option<(Cells<Sample>, Mask)> {
        let (mut surface, mut deep) = (NONE, NONE);
        let low = SIDE * block;
        let place = |z: i64| (z.max(self.bottom) - low).clamp(0, SIDE) as usize;
        for (k, ground) in self.layers.iter().flat_map(|l| l.iter().enumerate()) {
            let Some(ground) = ground else { continue };
            let (first, end) = (place(ground.lowest), place(ground.highest + 1));
            deep[place(self.bottom)..first]
                .iter_mut()
                .for_each(|layer| *layer |= 1 << k);
            surface[first..end].iter_mut().for_each(|layer| *layer |= 1 << k);
        }
        if let Some(facets) = facets {
            surface = either(&surface, &facets.mask(|f| f.sum > 0.0));
        }
        if let Some((inside, [x, y])) = inside {
            deep = either(&deep, &inside.whole([x, y, block]));
        }
        let solid = without(&deep, &surface);
        if surface == NONE && solid == NONE {
            return None;
        }
        let mut samples = Vec::with_capacity(count(&surface) as usize);
        each(&surface, |at| {
            let facets = facets.and_then(|f| f.get(at)).filter(|f| f.sum > 0.0);
            let (k, z) = (at % 64, low + at as i64 / 64);
            let part = inside.map_or(0.0, |(inside, [x, y])| {
                let (i, j) = (k as i64 % SIDE, k as i64 / SIDE);
                inside.part([x * SIDE + i, y * SIDE + j, z])
            });
            samples.push(self.sample(k, z, facets, part, covers));
        });
        Some((Cells::new(surface, solid, samples), surface))
    }

    /// The sample of a cell that a surface meets: in column `k`, at a height; `inside` is the part of it inside of meshes.
    #[inline]
    fn sample(&self, k: usize, z: i64, facets: Option<&Facets>, inside: f32, covers: bool) -> Sample {
        let mut look = Look {
            solid: inside,
            ..Look::default()
        };
        let mut sum = 0.0;
        for ground in self.layers.iter().filter_map(|l| l[k].as_ref()) {
            if z > ground.highest || z < self.bottom {
                continue;
            }
            if z < ground.lowest {
                look.solid = 1.0;
                continue;
            }
            look.solid = look.solid.max(ground.filled(z));
            look.weight = 1.0;
            sum += 1.0;
            for c in 0..3 {
                look.rgb[c] += ground.rgb[c];
                look.normal[c] += ground.normal[c];
            }
        }
        if let Some(f) = facets {
            look.skin = if covers { 0.0 } else { f.skin };
            look.weight = look.weight.max(f.alpha);
            sum += f.sum;
            for c in 0..3 {
                look.rgb[c] += f.rgb[c];
                look.normal[c] += f.normal[c];
            }
        }
        look.rgb = look.rgb.map(|c| c / sum);
        look.normal = look.normal.map(|c| c / sum);
        Sample::new(&look)
    }
}
