//! What is built when, by how many workers, and what an earlier run has done already.
//!
//! Columns of trees are gone through in rows. When the tiles of a row and of the next one are made, the trees of the row are put
//! together, and files of tiles that nothing will read any more are removed. So the scratch folder holds three rows at most. Workers are
//! threads with a small pool each: a tile is not put aside for another one, and memory holds as many as there are workers.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{TreeHeader, octant_offset};
use brickfell_formats::octree_binary;

use super::error::BuildError;
use super::groups::GroupPlace;
use super::lattice::{SIDE, TreePlace};
use super::manifest::{SCRATCH, TREES};
use super::progress::Progress;
use super::tile::{Tile, TileFile, tile_side, tile_top, tiles};
use super::tree::{TREE_FILE, Terrain, finish_tree};
use super::{BuildArgs, EmptyTrees};

/// What a tile takes while it is made: the largest of the bench, with vegetation of a few layers.
const TILE_MEMORY: u64 = 192 << 20;

/// Threads that do one job each: as many as threads and half of the memory allow; the other half is for faces, rasters and what
/// is put together.
pub(crate) struct Workers {
    threads: usize,
    jobs: usize,
}

impl Workers {
    pub(crate) fn new(args: &BuildArgs) -> Self {
        let threads = match args.threads {
            0 => std::thread::available_parallelism().map_or(1, |n| n.get()),
            n => n,
        };
        let tiles = (args.memory / 2 / TILE_MEMORY).clamp(1, threads as u64);
        Self {
            threads,
            jobs: tiles as usize,
        }
    }

    /// Does all jobs; the first error ends it when the jobs under way are done.
    fn run<T: Sync, R: Send>(
        &self,
        jobs: &[T],
        work: impl Fn(&T) -> Result<R, BuildError> + Sync,
    ) -> Result<Vec<R>, BuildError> {
        let workers = self.jobs.min(jobs.len()).max(1);
        let next = AtomicUsize::new(0);
        let done = Mutex::new(BTreeMap::new());
        let failed: Mutex<Option<BuildError>> = Mutex::new(None);
        let worker = || {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads((self.threads / workers).max(1))
                .build();
            let fail = |error| {
                next.store(jobs.len(), Ordering::Relaxed);
                if let Ok(mut failed) = failed.lock() {
                    failed.get_or_insert(error);
                }
            };
            let pool = match pool {
                Ok(pool) => pool,
                Err(e) => return fail(BuildError::Threads(e.to_string())),
            };
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(job) = jobs.get(number) else { return };
                match pool.install(|| work(job)) {
                    Ok(result) => {
                        if let Ok(mut done) = done.lock() {
                            done.insert(number, result);
                        }
                    }
                    Err(error) => return fail(error),
                }
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..workers {
                scope.spawn(worker);
            }
        });
        if let Ok(Some(error)) = failed.into_inner() {
            return Err(error);
        }
        Ok(done
            .into_inner()
            .map(|d| d.into_values().collect())
            .unwrap_or_default())
    }
}

/// The work of a build.
pub(crate) struct Schedule<'a> {
    pub(crate) terrain: &'a Terrain<'a>,
    pub(crate) out: &'a Path,
    /// What is to be built; trees among it may have their folders, but have to leave their samples once more.
    pub(crate) open: &'a BTreeSet<GroupPlace>,
    pub(crate) workers: Workers,
    pub(crate) progress: &'a dyn Progress,
}

/// A row of columns of trees.
#[derive(Default)]
struct Row {
    x: i64,
    trees: Vec<TreePlace>,
    /// Places without data of their own where coarse samples still have some: in the corner layout those on a tree's upper
    /// faces are made of cells on both sides.
    beside: Vec<TreePlace>,
}

impl Schedule<'_> {
    fn folder(&self, place: TreePlace) -> PathBuf {
        self.out.join(TREES).join(self.terrain.lattice.tree_name(place))
    }

    fn tile_path(&self, tile: &Tile) -> PathBuf {
        self.out.join(SCRATCH).join(tile.name())
    }

    /// All rows in their order.
    fn rows(&self) -> Vec<Row> {
        let lattice = &self.terrain.lattice;
        let places = &self.terrain.plan.trees;
        let mut rows: BTreeMap<i64, Row> = BTreeMap::new();
        for place in places {
            rows.entry(place.origin[0]).or_default().trees.push(*place);
        }
        if lattice.layout == SampleLayout::Corner {
            let planned: BTreeSet<&TreePlace> = places.iter().collect();
            let mut beside = BTreeSet::new();
            for offset in (1..8).map(|k| octant_offset(k).to_array()) {
                beside.extend(places.iter().map(|place| TreePlace {
                    origin: std::array::from_fn(|k| place.origin[k] + i64::from(offset[k]) * lattice.side()),
                }));
            }
            for place in beside.into_iter().filter(|p| !planned.contains(p)) {
                rows.entry(place.origin[0]).or_default().beside.push(place);
            }
        }
        rows.into_iter().map(|(x, row)| Row { x, ..row }).collect()
    }

    /// Does what is left to do and calls with every tree that is not empty, in the plan's order, and whether it was there already.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub(crate) fn run(
        &mut self,
        empty: &mut EmptyTrees,
        mut each: impl FnMut(TreePlace, TreeHeader, bool) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let lattice = self.terrain.lattice;
        let places = &self.terrain.plan.trees;
        let open = |place: &TreePlace| self.open.contains(&GroupPlace::tree(&lattice, *place));
        let todo: BTreeSet<TreePlace> = places.iter().copied().filter(open).collect();
        let per_tree = (lattice.side() / tile_side(&lattice)).pow(2) as u64;
        let finished = (places.len() - todo.len()) as u64;
        self.progress
            .start(places.len() as u64 * per_tree, finished * per_tree);
        let rows = self.rows();
        let scratch = self.out.join(SCRATCH);
        fs::create_dir_all(&scratch).map_err(BuildError::io(&scratch))?;
        let side = lattice.side();
        let top = tile_top(&lattice);
        let reads = |tree: &TreePlace, tile: &Tile| {
            // Blocks of samples are read whole.
            let support = lattice.tree(*tree).support(top).grown(SIDE);
            !support.intersection(&tile.region.cells(top)).is_empty()
        };
        let all_tiles = |row: &Row| -> Vec<Tile> {
            let trees = row.trees.iter().chain(&row.beside);
            trees.flat_map(|t| tiles(&lattice, *t)).collect()
        };
        let mut made: Vec<Tile> = Vec::new();
        let mut next = 0;
        for row in &rows {
            // Tiles of this row and the next one that a tree to be made reads.
            while next < rows.len() && rows[next].x <= row.x + side {
                let needed = |tile: &Tile| {
                    let [x, y, _] = tile.tree.origin;
                    (-1..2)
                        .flat_map(|i| (-1..2).map(move |j| (x + i * side, y + j * side)))
                        .any(|(x, y)| {
                            let column = |z| TreePlace { origin: [x, y, z] };
                            todo.range(column(i64::MIN)..=column(i64::MAX))
                                .any(|p| reads(p, tile))
                        })
                };
                let new: Vec<Tile> = all_tiles(&rows[next]).into_iter().filter(needed).collect();
                let missing: Vec<Tile> = new
                    .iter()
                    .copied()
                    .filter(|t| !TileFile::is_whole(&self.tile_path(t)))
                    .collect();
                let whole = (new.len() - missing.len()) as u64;
                self.progress.tiles(whole, 0);
                self.workers.run(&missing, |tile| {
                    let voxels = tile.build(self.terrain, &self.tile_path(tile))?;
                    self.progress.tiles(1, voxels);
                    Ok(())
                })?;
                made.extend(new);
                next += 1;
            }
            let now: Vec<TreePlace> = row.trees.iter().copied().filter(open).collect();
            let resumed: Vec<bool> = row.trees.iter().map(|p| self.folder(*p).is_dir()).collect();
            let headers = self.workers.run(&now, |place| {
                let own: Vec<PathBuf> = tiles(&lattice, *place)
                    .iter()
                    .map(|t| self.tile_path(t))
                    .collect();
                let around: Vec<(Tile, PathBuf)> = made
                    .iter()
                    .filter(|t| reads(place, t))
                    .map(|t| (*t, self.tile_path(t)))
                    .collect();
                finish_tree(self.terrain, *place, &own, &around, self.out)
            })?;
            let mut new = now.into_iter().zip(headers);
            for (place, resumed) in row.trees.iter().zip(resumed) {
                let header = if open(place) {
                    let header = new.next().and_then(|(_, header)| header);
                    if header.is_none() {
                        empty.add(&lattice.tree_name(*place))?;
                    }
                    header
                } else if resumed {
                    Some(read_header(&self.folder(*place).join(TREE_FILE))?)
                } else {
                    None
                };
                if let Some(header) = header {
                    each(*place, header, resumed)?;
                }
            }
            let (old, kept): (Vec<Tile>, _) = made.into_iter().partition(|t| t.tree.origin[0] < row.x);
            made = kept;
            for tile in old {
                let path = self.tile_path(&tile);
                fs::remove_file(&path).map_err(BuildError::io(&path))?;
            }
        }
        Ok(())
    }
}

/// Reads the header of an octree file.
///
/// # Errors
/// If it cannot be read or is damaged.
pub(crate) fn read_header(path: &Path) -> Result<TreeHeader, BuildError> {
    let bytes = fs::read(path).map_err(BuildError::io(path))?;
    let index = octree_binary::decode_header(&bytes, bytes.len() as u64).map_err(BuildError::format(path))?;
    Ok(index.header)
}
