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

use brickfell_formats::steps::Steps;
use rayon::prelude::*;

use super::EmptyTrees;
use super::blocks::Blocks;
use super::cells::{Cell, Cells};
use super::error::BuildError;
use super::filter::{Level, Target};
use super::finest::Met;
use super::ground::Hints;
use super::lattice::{CellBox, Lattice, SIDE, TreePlace};
use super::manifest::{SCRATCH, TREES, write_whole};
use super::sample::Sample;
use super::spill::{Reader, Writer};
use super::texels::TexelLevel;
use super::tree::{FolderWriter, Terrain, add_level, damaged, finish, read_samples};

/// Voxels of a level by which solid ground reaches below its surface at least.
const SOLID_VOXELS: i64 = 2;

/// A coarse tree, or a tree as what coarse ones are made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct GroupPlace {
    /// Levels of groups below, itself included: 1 is over trees, 0 is a tree.
    pub(crate) height: u8,
    /// Its column, in sides of groups of this height.
    pub(crate) column: (i64, i64),
    /// Low end, in voxels of its root.
    pub(crate) z: i64,
}

impl GroupPlace {
    /// That of a tree.
    pub(crate) fn tree(lattice: &Lattice, tree: TreePlace) -> Self {
        let [x, y, z] = tree.origin;
        Self {
            height: 0,
            column: lattice.column_of(x, y),
            z: z.div_euclid(lattice.root_voxel()),
        }
    }

    /// Name of its folder.
    pub(crate) fn name(&self) -> String {
        let (x, y) = self.column;
        let group = match self.height {
            0 => String::new(),
            height => format!("g{height}_"),
        };
        format!("{group}x{x}_y{y}_z{}", self.z)
    }

    /// The file of the samples of its root.
    fn samples(&self, out: &Path) -> PathBuf {
        out.join(SCRATCH).join(format!("root_{}", self.name()))
    }

    /// The own cells of its root.
    fn cells(&self) -> CellBox {
        let lo = [SIDE * self.column.0, SIDE * self.column.1, self.z];
        CellBox {
            lo,
            hi: lo.map(|v| v + SIDE),
        }
    }

    /// The lattice of a coarse tree's finest voxels, for trees of two levels.
    fn lattice(&self, trees: &Lattice) -> Lattice {
        Lattice {
            voxel: trees.voxel * 2f64.powi(i32::from(trees.depth + self.height) - 1),
            depth: 1,
            layout: trees.layout,
        }
    }

    /// Leaves the samples of its root for the groups above.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn leave(&self, level: &Level, hints: &Hints, out: &Path) -> Result<(), BuildError> {
        let mut bytes = Writer::default();
        hints.write(&self.cells(), &mut bytes);
        level.write(&self.cells(), &mut bytes);
        bytes.put(&crc32fast::hash(&bytes.0));
        write_whole(&self.samples(out), &bytes.0)
    }

    /// What it has left, if that is whole.
    fn left(&self, out: &Path) -> Option<Vec<u8>> {
        let mut bytes = fs::read(self.samples(out)).ok()?;
        let crc = bytes.split_off(bytes.len().checked_sub(4)?);
        (crc == crc32fast::hash(&bytes).to_ne_bytes()).then_some(bytes)
    }
}

/// All trees and coarse trees that there may be, lowest groups first.
#[derive(Debug)]
pub(crate) struct GroupPlan {
    places: BTreeSet<GroupPlace>,
}

impl GroupPlan {
    /// Trees and groups over them, up to where one, or one on each side of the origin, has everything.
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
        let mut places: BTreeSet<GroupPlace> = trees.iter().map(|t| GroupPlace::tree(lattice, *t)).collect();
        let mut columns = Columns::new();
        for place in &places {
            let range = (place.z, place.z + SIDE, has_ground(place.column));
            cover(&mut columns, place.column, range);
        }
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
                let beside = (x - 1..x + 2).flat_map(|x| (y - 1..y + 2).map(move |y| (x, y)));
                let beside = beside
                    .filter_map(|at| columns.get(&at))
                    .filter(|b| b.2 && *ground);
                let lo = beside.map(|b| b.0).fold(*lo, i64::min);
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

    /// The coarse trees.
    pub(crate) fn coarse(&self) -> impl Iterator<Item = &GroupPlace> {
        self.places.iter().filter(|place| place.height > 0)
    }

    /// What a coarse tree is made from: what is in its columns and beside them.
    fn parts(&self, group: &GroupPlace) -> impl Iterator<Item = &GroupPlace> {
        let (height, (x, y)) = (group.height - 1, (2 * group.column.0, 2 * group.column.1));
        let columns = (x - 1..x + 3).flat_map(move |x| (y - 1..y + 3).map(move |y| (x, y)));
        columns.flat_map(move |column| {
            let end = |z| GroupPlace { height, column, z };
            self.places.range(end(i64::MIN)..=end(i64::MAX))
        })
    }

    /// What is to be built: what is not there, and what has not left its samples although something that is to be built is
    /// made from them.
    pub(crate) fn open(&self, out: &Path, empty: &EmptyTrees) -> BTreeSet<GroupPlace> {
        let (mut open, mut needed) = (BTreeSet::new(), BTreeSet::<&GroupPlace>::new());
        for place in self.places.iter().rev() {
            let name = place.name();
            let there = empty.names.contains(&name)
                || out.join(TREES).join(&name).is_dir()
                    && (!needed.contains(place) || place.left(out).is_some());
            if !there {
                open.insert(*place);
                if place.height > 0 {
                    needed.extend(self.parts(place));
                }
            }
        }
        open
    }

    /// Builds those coarse trees that are among the open places, once all trees are there, and notes which turn out empty.
    ///
    /// # Errors
    /// If a file cannot be read or written.
    pub(crate) fn build(
        &self,
        terrain: &Terrain,
        open: &BTreeSet<GroupPlace>,
        out: &Path,
        empty: &mut EmptyTrees,
    ) -> Result<(), BuildError> {
        let open: Vec<&GroupPlace> = open.iter().filter(|place| place.height > 0).collect();
        for groups in open.chunk_by(|a, b| a.height == b.height) {
            let names = &empty.names;
            let parts = |group| self.parts(group).filter(|part| !names.contains(&part.name()));
            let built: Vec<bool> = groups
                .par_iter()
                .map(|group| group.build(terrain, parts(group).collect(), out))
                .collect::<Result<_, BuildError>>()?;
            for (group, _) in groups.iter().zip(built).filter(|(_, built)| !built) {
                empty.add(&group.name())?;
            }
        }
        Ok(())
    }
}

impl GroupPlace {
    /// Builds a coarse tree from what is not empty around it, and leaves the samples of its root; false if nothing is in it.
    fn build(&self, terrain: &Terrain, parts: Vec<&GroupPlace>, out: &Path) -> Result<bool, BuildError> {
        let terrain = &Terrain {
            lattice: self.lattice(&terrain.lattice),
            ..*terrain
        };
        let (lattice, filter) = (&terrain.lattice, terrain.filter);
        let own = self.cells();
        let place = TreePlace {
            origin: own.lo.map(|v| 2 * v),
        };
        let region = lattice.tree(place);
        let files: Vec<Vec<u8>> = (parts.iter())
            .map(|part| part.left(out).ok_or_else(|| damaged(&part.samples(out))))
            .collect::<Result<_, _>>()?;
        let readers = parts
            .iter()
            .zip(&files)
            .map(|(part, bytes)| (part.cells(), Reader(bytes)));
        let (mut level, mut hints) = read_samples(&region.support(0).grown(2), readers.collect(), filter)
            .ok_or_else(|| damaged(&out.join(SCRATCH)))?;
        let folder = out.join(TREES).join(self.name());
        let mut writer = FolderWriter::new(&folder)?;
        let mut levels = Vec::new();
        for mip in 0..=lattice.depth {
            if mip > 0 {
                let cells = region.support(mip);
                thicken(&mut level.samples, &hints, &cells);
                hints = hints.coarser(lattice.layout, &cells);
                let target = Target {
                    layout: lattice.layout,
                    mip,
                    cells,
                };
                level = level.coarser(filter, &target);
            }
            let area = region.stored(lattice.layout, mip);
            // As roots of trees are stored: what lies beside the area is not looked at.
            let steps = Steps::within(terrain.error);
            let skins = level.skins(filter, false);
            let texels = TexelLevel::new(&level.samples, skins, steps, &hints, area, &area);
            add_level(terrain, place, &texels, &hints, &mut levels, &mut writer)?;
        }
        // Before the folder: what is finished has both.
        self.leave(&level, &hints, out)?;
        Ok(finish(terrain, place, &Met::default(), levels, writer, &folder)?.is_some())
    }
}

/// Fills ground in an area, given in cells of the next coarser level, down to some of its voxels below the surface there and in
/// the cells beside, which a cliff fills in part only.
fn thicken(samples: &mut Blocks<Cells<Sample>>, hints: &Hints, area: &CellBox) {
    // Lowest and highest cell with solid, where there is ground.
    let ground = |samples: &Blocks<Cells<Sample>>, x, y| {
        let heights = samples.heights(x, y);
        let is_solid = |z: &i64| match samples.at([x, y, *z]) {
            Cell::Empty => false,
            Cell::Solid => true,
            Cell::Held(sample) => sample.is_partly_solid(),
        };
        let is_ground = hints.at(x, y)[6] > 0.0;
        let lowest = heights.clone().find(is_solid).filter(|_| is_ground)?;
        Some((lowest, { heights }.rfind(is_solid)?))
    };
    let square = |lo: [i64; 2], side| {
        (lo[1]..lo[1] + side).flat_map(move |y| (lo[0]..lo[0] + side).map(move |x| (x, y)))
    };
    let cells = (area.lo[1]..area.hi[1]).flat_map(|y| (area.lo[0]..area.hi[0]).map(move |x| (2 * x, 2 * y)));
    for (x, y) in cells {
        let around = square([x - 2, y - 2], 6).filter_map(|(x, y)| ground(samples, x, y));
        let Some(top) = around.map(|g| g.1).min() else {
            continue;
        };
        let bottom = 2 * (top.div_euclid(2) - SOLID_VOXELS);
        for (x, y) in square([x, y], 2) {
            let Some((lowest, _)) = ground(samples, x, y) else {
                continue;
            };
            for z in bottom.min(2 * lowest.div_euclid(2))..lowest {
                samples.make_solid([x, y, z]);
            }
        }
    }
}
