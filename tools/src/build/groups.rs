//! Coarse trees of groups: levels above trees.
//!
//! ```text
//!   trees (mip depth is their root)   2×2 columns → group 1   2×2 of those → group 2   …
//!   root samples, voxel r ───────────→ level 1: r            ┌→ level 1: 2r
//!                                      level 0: 2r ──────────┘   level 0: 4r
//! ```
//! Groups are aligned to the lattice, as trees are, and cover all heights by a stack of cubes. The deepest level of a coarse tree
//! stores what the coarsest level of everything in its group does, so one can take over from the other unseen; the level
//! above is made by the same filter. Each tree leaves the samples of its root in the scratch folder, and so does each coarse
//! tree: groups are built from these, level by level, without the inputs.
//!
//! Solid ground is two root voxels thick below the lowest height of a tree's column. Coarser voxels would see through that, so it
//! grows with them: each step to a coarser level fills ground down to two of its voxels below the surface.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::blocks::{BlockColumn, Blocks, Dense, Slot, block_columns, in_block, new_dense};
use super::error::BuildError;
use super::filter::{Cover, Kept, Level, Target};
use super::finest::Met;
use super::ground::Hints;
use super::lattice::{CellBox, Lattice, SIDE, TreePlace};
use super::manifest::{remove_tree, write_whole};
use super::nodes::level_nodes;
use super::sample::Sample;
use super::texels::TexelLevel;
use super::tree::{FolderWriter, Terrain, build_tree, finish, write_bricks};

/// Voxels of a level by which solid ground reaches below its surface at least.
const SOLID_VOXELS: i64 = 2;
/// Samples of a brick's own cells.
const CELLS: usize = (SIDE * SIDE * SIDE) as usize;

/// A coarse tree to be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct GroupPlace {
    /// Levels of groups below, itself included: 1 is over trees.
    pub(crate) height: u8,
    /// Its column, in sides of groups of this height.
    pub(crate) column: (i64, i64),
    /// Low end, in voxels of its root.
    pub(crate) z: i64,
}

/// All coarse trees, lowest groups first.
#[derive(Debug, Default)]
pub(crate) struct GroupPlan {
    pub(crate) places: Vec<GroupPlace>,
}

impl GroupPlan {
    /// Groups over trees, up to where one, or one on each side of the origin, has everything.
    pub(crate) fn new(
        lattice: &Lattice,
        trees: &[TreePlace],
        has_ground: impl Fn((i64, i64)) -> bool,
    ) -> Self {
        // By column the range of heights in root voxels, and whether there is ground.
        type Columns = BTreeMap<(i64, i64), (i64, i64, bool)>;
        let cover = |columns: &mut Columns, at, (lo, hi, ground): (i64, i64, bool)| {
            let range = columns.entry(at).or_insert((lo, hi, ground));
            *range = (range.0.min(lo), range.1.max(hi), range.2 || ground);
        };
        let mut columns = Columns::new();
        for tree in trees {
            let at = lattice.column_of(tree.origin[0], tree.origin[1]);
            let z = tree.origin[2].div_euclid(lattice.root_voxel());
            cover(&mut columns, at, (z, z + SIDE, has_ground(at)));
        }
        let mut places = Vec::new();
        // Columns on two sides of the origin never meet.
        let sides = |columns: &Columns| {
            let sides = columns.keys().map(|(x, y)| (*x < 0, *y < 0));
            sides.collect::<BTreeSet<_>>().len()
        };
        for height in 1.. {
            if columns.len() == sides(&columns) {
                break;
            }
            let mut above = Columns::new();
            for ((x, y), (lo, hi, ground)) in &columns {
                let deeper = if *ground { SOLID_VOXELS } else { 0 };
                let range = (lo.div_euclid(2) - deeper, (hi + 1).div_euclid(2), *ground);
                cover(&mut above, (x.div_euclid(2), y.div_euclid(2)), range);
            }
            for (column, (lo, hi, _)) in &above {
                places.extend((*lo..*hi).step_by(SIDE as usize).map(|z| GroupPlace {
                    height,
                    column: *column,
                    z,
                }));
            }
            columns = above;
        }
        Self { places }
    }
}

impl GroupPlace {
    /// Name of its folder.
    pub(crate) fn name(&self) -> String {
        let (x, y) = self.column;
        format!("g{}_x{x}_y{y}_z{}", self.height, self.z)
    }

    /// The lattice of its finest voxels, for trees of two levels.
    fn lattice(&self, trees: &Lattice) -> Lattice {
        Lattice {
            voxel: trees.voxel * 2f64.powi(i32::from(trees.depth + self.height) - 1),
            depth: 1,
            layout: trees.layout,
        }
    }

    /// Its place on that lattice.
    fn place(&self) -> TreePlace {
        let (x, y) = self.column;
        TreePlace {
            origin: [2 * SIDE * x, 2 * SIDE * y, 2 * self.z],
        }
    }
}

/// The samples of the own cells of a root brick, and the hints of their columns.
struct Saved {
    /// The first cell.
    lo: [i64; 3],
    cells: Vec<Cell>,
    looks: Vec<[f32; 7]>,
}

/// A sample and what filters keep of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cell {
    sample: Sample,
    cover: Cover,
    mean: f32,
}

/// Bytes of a cell and of a look in a scratch file.
const CELL_BYTES: usize = 20 + 24 + 4;
const LOOK_BYTES: usize = 28;

impl Saved {
    /// Takes the samples of 8³ cells from `lo` on.
    fn of(level: &Level, hints: &Hints, lo: [i64; 3]) -> Self {
        let place = |k: usize| {
            let k = k as i64;
            [
                lo[0] + k % SIDE,
                lo[1] + k / SIDE % SIDE,
                lo[2] + k / (SIDE * SIDE),
            ]
        };
        let cell = |at| {
            let (cover, mean) = match &level.kept {
                Kept::Nothing => Default::default(),
                Kept::Means(means) => (Cover::default(), means.at(at, 0.0)),
                Kept::Covers(covers) => (covers.at(at, Cover::default()), 0.0),
            };
            Cell {
                sample: level.samples.at(at, Sample::DEEP),
                cover,
                mean,
            }
        };
        Self {
            lo,
            cells: (0..CELLS).map(|k| cell(place(k))).collect(),
            looks: (0..CELLS / SIDE as usize)
                .map(|k| hints.at(place(k)[0], place(k)[1]))
                .collect(),
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.lo.iter().flat_map(|v| v.to_le_bytes()).collect();
        for cell in &self.cells {
            bytes.extend(cell.sample.to_bytes());
            bytes.extend(cell.cover.0.iter().flat_map(|mask| mask.to_le_bytes()));
            bytes.extend(cell.mean.to_le_bytes());
        }
        bytes.extend(self.looks.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// `None` if it was cut short.
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (lo, rest) = bytes.split_at_checked(24)?;
        let (cells, looks) = rest.split_at_checked(CELLS * CELL_BYTES)?;
        let long = |b: &[u8]| b.try_into().ok().map(u64::from_le_bytes);
        let float = |b: &[u8]| b.try_into().ok().map(f32::from_le_bytes);
        let longs = |b: &[u8]| Some([long(b.get(..8)?)?, long(b.get(8..16)?)?, long(b.get(16..24)?)?]);
        let cell = |b: &[u8]| {
            Some(Cell {
                sample: Sample::from_bytes(b.get(..20)?.try_into().ok()?),
                cover: Cover(longs(b.get(20..44)?)?),
                mean: float(b.get(44..)?)?,
            })
        };
        let look = |b: &[u8]| {
            let mut look = [0.0; 7];
            for (value, b) in look.iter_mut().zip(b.chunks_exact(4)) {
                *value = float(b)?;
            }
            Some(look)
        };
        let saved = Self {
            lo: longs(lo)?.map(|v| v as i64),
            cells: cells.chunks_exact(CELL_BYTES).map(cell).collect::<Option<_>>()?,
            looks: looks.chunks_exact(LOOK_BYTES).map(look).collect::<Option<_>>()?,
        };
        (saved.looks.len() == (SIDE * SIDE) as usize).then_some(saved)
    }

    fn load(path: &Path) -> Option<Self> {
        Self::from_bytes(&fs::read(path).ok()?)
    }
}

/// Leaves the samples of a tree's root for the groups above; `level` and `hints` are those of its coarsest mip.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn leave_root(
    lattice: &Lattice,
    place: TreePlace,
    level: &Level,
    hints: &Hints,
    file: &Path,
) -> Result<(), BuildError> {
    let lo = place.origin.map(|o| o.div_euclid(lattice.root_voxel()));
    write_whole(file, &Saved::of(level, hints, lo).to_bytes())
}

/// Where groups find what they are made from and leave what they are.
pub(crate) struct Folders<'a> {
    pub(crate) trees: &'a Path,
    pub(crate) scratch: &'a Path,
}

impl Folders<'_> {
    /// The file of the samples that a tree leaves, by its name.
    pub(crate) fn samples(&self, name: &str) -> PathBuf {
        self.scratch.join(format!("{name}.samples"))
    }
}

/// Builds the coarse trees that are not there yet, and says which turned out empty.
///
/// # Errors
/// If a file cannot be read or written.
pub(crate) fn build_groups(
    terrain: &Terrain,
    plan: &GroupPlan,
    trees: &[TreePlace],
    folders: &Folders,
) -> Result<BTreeSet<String>, BuildError> {
    for place in trees {
        // What a finished build has swept away is made again.
        let name = terrain.lattice.tree_name(*place);
        if Saved::load(&folders.samples(&name)).is_none() {
            let again = folders.scratch.join(&name);
            build_tree(terrain, *place, &again, &folders.samples(&name))?;
            remove_tree(&again)?;
        }
    }
    // Of the height below: the names in each column, in sides of that height.
    let mut below: BTreeMap<(i64, i64), Vec<String>> = BTreeMap::new();
    for place in trees {
        let column = terrain.lattice.column_of(place.origin[0], place.origin[1]);
        below
            .entry(column)
            .or_default()
            .push(terrain.lattice.tree_name(*place));
    }
    let mut empty = BTreeSet::new();
    for places in plan.places.chunk_by(|a, b| a.height == b.height) {
        let built: Vec<bool> = places
            .par_iter()
            .map(|place| build_group(terrain, place, &below, folders))
            .collect::<Result<_, BuildError>>()?;
        below.clear();
        for (place, built) in places.iter().zip(built) {
            below.entry(place.column).or_default().push(place.name());
            if !built {
                empty.insert(place.name());
            }
        }
    }
    Ok(empty)
}

/// Builds one coarse tree unless its folder is there, and leaves the samples of its root; false if nothing is in it.
fn build_group(
    terrain: &Terrain,
    group: &GroupPlace,
    below: &BTreeMap<(i64, i64), Vec<String>>,
    folders: &Folders,
) -> Result<bool, BuildError> {
    let lattice = group.lattice(&terrain.lattice);
    let (place, filter) = (group.place(), terrain.filter);
    let (x, y) = (2 * group.column.0, 2 * group.column.1);
    let near = (y - 1..y + 3).flat_map(|y| (x - 1..x + 3).filter_map(move |x| below.get(&(x, y))));
    let mut saved = Vec::new();
    for name in near.flatten() {
        let path = folders.samples(name);
        let damaged = || {
            std::io::Error::new(
                std::io::ErrorKind::InvalidData,
                "is damaged; remove it and build again",
            )
        };
        saved.push(Saved::load(&path).ok_or_else(|| BuildError::io(&path)(damaged()))?);
    }
    let support = lattice.support(place, 0);
    let mut cells = Cells::new(&support, &saved);
    let hints = cells.hints(&support);
    let finest = cells.level(filter);
    // As far as the coarser level reads.
    cells.thicken(&hints);
    let mip = terrain.lattice.depth + group.height;
    let target = Target {
        layout: lattice.layout,
        mip,
        cells: lattice.support(place, 1),
    };
    let coarser_hints = hints.coarser(lattice.layout, &target.cells);
    let coarser = cells.level(filter).coarser(filter, &target);
    let lo = place.origin.map(|o| o / 2);
    write_whole(
        &folders.samples(&group.name()),
        &Saved::of(&coarser, &coarser_hints, lo).to_bytes(),
    )?;
    let folder = folders.trees.join(group.name());
    if folder.is_dir() {
        return Ok(true);
    }
    let terrain = Terrain { lattice, ..*terrain };
    let mut writer = FolderWriter::new(&folder)?;
    let mut levels = Vec::new();
    for (mip, (samples, hints)) in (0..).zip([(&finest, &hints), (&coarser, &coarser_hints)]) {
        let level = lattice.depth - mip;
        let area = lattice.stored(place, mip);
        // As roots of trees are stored: what lies beside the area is not looked at.
        let texels = TexelLevel::new(&samples.samples, samples.skins(filter, false), hints, area, &area);
        let nodes = level_nodes(&lattice, place, level, &texels, hints, levels.last());
        write_bricks(&terrain, place, level, &texels, &nodes.bricks(), &mut writer)?;
        levels.push(nodes);
    }
    Ok(finish(&terrain, place, &Met::default(), levels, writer, &folder)?.is_some())
}

/// Samples over a box, by block.
struct Cells {
    extent: CellBox,
    blocks: BTreeMap<[i64; 3], Dense<Cell>>,
    looks: BTreeMap<(i64, i64), [f32; 7]>,
}

impl Cells {
    /// Of what was saved, in the blocks over and under a box.
    fn new(area: &CellBox, saved: &[Saved]) -> Self {
        // All heights, whatever the box has of them: how deep ground goes depends on its surface.
        let mut extent = area.blocks();
        let lowest = saved.iter().map(|part| part.lo[2]).min().unwrap_or(0);
        let highest = saved.iter().map(|part| part.lo[2] + SIDE).max().unwrap_or(0);
        extent.lo[2] = extent.lo[2].min(lowest.div_euclid(SIDE) - 1);
        extent.hi[2] = extent.hi[2].max((highest + SIDE - 1).div_euclid(SIDE));
        let mut cells = Self {
            extent,
            blocks: BTreeMap::new(),
            looks: BTreeMap::new(),
        };
        for part in saved {
            for (k, cell) in part.cells.iter().enumerate() {
                let k = k as i64;
                let offset = [k % SIDE, k / SIDE % SIDE, k / (SIDE * SIDE)];
                let at: [i64; 3] = std::array::from_fn(|axis| part.lo[axis] + offset[axis]);
                if *cell != Cell::default() {
                    cells.set(at, *cell);
                }
            }
            for (k, look) in part.looks.iter().enumerate() {
                let at = (part.lo[0] + k as i64 % SIDE, part.lo[1] + k as i64 / SIDE);
                cells.looks.insert(at, *look);
            }
        }
        cells
    }

    fn set(&mut self, at: [i64; 3], cell: Cell) {
        let block = at.map(|c| c.div_euclid(SIDE));
        if self.extent.contains(block) {
            let dense = self.blocks.entry(block).or_insert_with(new_dense);
            dense[in_block(at[0], at[1], at[2])] = cell;
        }
    }

    fn sample(&self, at: [i64; 3]) -> Sample {
        let block = self.blocks.get(&at.map(|c| c.div_euclid(SIDE)));
        block.map_or(Sample::default(), |cells| {
            cells[in_block(at[0], at[1], at[2])].sample
        })
    }

    fn hints(&self, area: &CellBox) -> Hints {
        Hints::of(area, |x, y| self.looks.get(&(x, y)).copied().unwrap_or_default())
    }

    /// As a level for the filters.
    fn level(&self, filter: super::Filter) -> Level {
        let part = |pick: &dyn Fn(&Cell) -> Sample| self.blocks_of(pick, Sample::is_empty, Sample::is_deep);
        Level {
            samples: part(&|cell| cell.sample),
            kept: match filter {
                super::Filter::Mean | super::Filter::Double => Kept::Nothing,
                super::Filter::Pow => {
                    Kept::Means(self.blocks_of(&|cell| cell.mean, |m| *m == 0.0, |_| false))
                }
                super::Filter::Coverage | super::Filter::Axes => {
                    Kept::Covers(self.blocks_of(&|cell| cell.cover, |c| *c == Cover::default(), |_| false))
                }
            },
        }
    }

    fn blocks_of<T: Copy + Default>(
        &self,
        pick: &dyn Fn(&Cell) -> T,
        is_empty: fn(&T) -> bool,
        is_solid: fn(&T) -> bool,
    ) -> Blocks<T> {
        let heights = self.extent.lo[2]..self.extent.hi[2];
        let column = |(x, y): (i64, i64)| {
            let slots = heights.clone().filter_map(|z| {
                let mut dense = new_dense::<T>();
                for (value, cell) in dense.iter_mut().zip(self.blocks.get(&[x, y, z])?.iter()) {
                    *value = pick(cell);
                }
                if dense.iter().all(is_empty) {
                    None
                } else if dense.iter().all(is_solid) {
                    Some((z, Slot::Solid))
                } else {
                    Some((z, Slot::Dense(dense)))
                }
            });
            BlockColumn {
                solid: 0..0,
                slots: slots.collect(),
            }
        };
        let columns = block_columns(&self.extent).into_iter().map(column).collect();
        Blocks::new(&self.extent, columns)
    }

    /// Fills ground down to some voxels of the next coarser level below its surface.
    fn thicken(&mut self, hints: &Hints) {
        let [lo, hi] = [self.extent.lo, self.extent.hi].map(|c| c.map(|b| b * SIDE));
        for (y, x) in (lo[1] / 2..hi[1] / 2).flat_map(|y| (lo[0] / 2..hi[0] / 2).map(move |x| (y, x))) {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * x + dx, 2 * y + dy));
            // Lowest and highest cells with solid of the columns that have ground.
            let ground: Vec<_> = (four.into_iter())
                .filter(|(x, y)| hints.at(*x, *y)[6] > 0.0)
                .filter_map(|(x, y)| {
                    let is_solid = |z: &i64| self.sample([x, y, *z]).is_partly_solid();
                    Some((
                        x,
                        y,
                        (lo[2]..hi[2]).find(is_solid)?,
                        (lo[2]..hi[2]).rfind(is_solid)?,
                    ))
                })
                .collect();
            let Some(top) = ground.iter().map(|g| g.3).min() else {
                continue;
            };
            let bottom = 2 * (top.div_euclid(2) - SOLID_VOXELS);
            for (x, y, lowest, _) in ground {
                for z in bottom.min(2 * lowest.div_euclid(2))..lowest {
                    let deep = Cell {
                        sample: Sample::DEEP,
                        ..Cell::default()
                    };
                    self.set([x, y, z], deep);
                }
            }
        }
    }
}
