//! The builder: height maps and meshes in, a terrain database out.
//!
//! World is lattice index × voxel, everywhere (`lattice`). A sample's value is a pure function of its place on the
//! lattice, its level and the inputs, never of the tree that stores it; so borders are right across bricks and trees at
//! every level, and trees are built one by one, each over its box and a margin of one root voxel, which is all that the
//! aprons of its coarsest level are made from.
//!
//! ```text
//! inputs → plan (which trees) → for each tree:
//!   finest (ground, surface, overlap) → blocks of samples ─┬→ texels → nodes → bricks on disk
//!                                        ↑  filter: ×½  ←──┘           ↓
//!                                        └── until the root       octree on disk
//! → groups (coarse trees over trees) → scene
//! ```
//! Called from one thread, which waits; the work is spread over a pool of threads of its own. Bytes do not depend on the
//! number of threads, nor on whether a build was interrupted and resumed.

mod blocks;
mod error;
mod filter;
mod finest;
mod ground;
mod groups;
mod lattice;
mod manifest;
mod nodes;
mod overlap;
mod plan;
mod progress;
mod sample;
mod scene;
mod surface;
#[cfg(test)]
mod tests;
mod texels;
mod tree;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use brickfell_formats::chunk::Encoding;
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::octree_binary;

pub use error::BuildError;
pub use filter::Filter;
pub use progress::{IndicatifProgress, Progress, Silent};

pub use crate::input::HeightInput;
use crate::input::{HeightUnit, Inputs, Mesh, UpAxis};
use groups::{Folders, GroupPlan, build_groups};
use lattice::{Lattice, TreePlace};
use manifest::{Arguments, EMPTY_TREES, Manifest, ROOT_SAMPLES, SCENE, TREES};
use scene::{SceneGroup, SceneTree};
use surface::Surfaces;
use tree::{TREE_FILE, Terrain, build_tree};

/// Where samples lie unless told.
pub const DEFAULT_LAYOUT: SampleLayout = SampleLayout::Centre;
/// Finest voxels per axis of a tree unless told.
pub const DEFAULT_TREE_VOXELS: u32 = 512;
/// Voxels across the longest side of a terrain without height maps, unless told.
const DEFAULT_RESOLUTION: f64 = 1024.0;

/// What to build.
#[derive(Clone, Debug)]
pub struct BuildArgs {
    /// Meshes (OBJ).
    pub inputs: Vec<PathBuf>,
    /// Height maps.
    pub heights: Vec<HeightInput>,
    /// The folder to write.
    pub out: PathBuf,
    /// Finest voxel, metres; unless told the smallest pixel of the height maps, else a part of the longest side.
    pub voxel: Option<f64>,
    /// Finest voxels per axis of a tree: 8·2^D, 16 to 8192.
    pub tree_voxels: u32,
    /// Which axis of meshes points up.
    pub up: UpAxis,
    /// Unit of heights; unless told the file's, else its horizontal unit.
    pub height_unit: Option<HeightUnit>,
    /// Where samples lie.
    pub layout: SampleLayout,
    /// How chunks are coded.
    pub encoding: Encoding,
    /// Bricks per axis of a chunk are 2 to this power, at most 2.
    pub chunk_log2: u8,
    /// How coarser levels are made of finer ones.
    pub filter: Filter,
    /// Whether a database built from something else may be replaced.
    pub force: bool,
    /// Threads to work with; 0 is one per core.
    pub threads: usize,
}

impl BuildArgs {
    /// Defaults for everything but the output folder; there is no input yet.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            inputs: Vec::new(),
            heights: Vec::new(),
            out: out.into(),
            voxel: None,
            tree_voxels: DEFAULT_TREE_VOXELS,
            up: UpAxis::Z,
            height_unit: None,
            layout: DEFAULT_LAYOUT,
            encoding: Encoding::Zstd,
            chunk_log2: 2,
            filter: Filter::default(),
            force: false,
            threads: 0,
        }
    }
}

/// What was built.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BuildReport {
    /// Trees of the database.
    pub trees: usize,
    /// Trees that were there from an earlier run.
    pub resumed: usize,
    /// Finest voxels that an input surface meets, in all trees.
    pub surface_voxels: u64,
    /// Finest voxel, metres.
    pub voxel: f64,
    /// What was missing in the inputs but did not stop the build, one line each.
    pub warnings: Vec<String>,
}

/// Builds a database.
///
/// # Errors
/// Arguments out of range, inputs that cannot be used (nothing has been written then), an output folder that holds
/// something else, a file that cannot be written (what is finished stays and is resumed).
pub fn build(args: &BuildArgs, progress: &dyn Progress) -> Result<BuildReport, BuildError> {
    let depth = check(args)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads)
        .build()
        .map_err(|e| BuildError::Threads(e.to_string()))?;
    pool.install(|| {
        let inputs = Inputs::load(&args.inputs, &args.heights, args.up, args.height_unit)?;
        let voxel = args.voxel.unwrap_or_else(|| inputs.default_voxel());
        if !(1e-9..=1e9).contains(&voxel) {
            return Err(BuildError::Voxel(voxel));
        }
        inputs.build(
            args,
            Lattice {
                voxel,
                depth,
                layout: args.layout,
            },
            progress,
        )
    })
}

/// Checks the arguments and gives the depth of trees.
fn check(args: &BuildArgs) -> Result<u8, BuildError> {
    if args.inputs.is_empty() && args.heights.is_empty() {
        return Err(BuildError::NoInput);
    }
    if let Some(voxel) = args.voxel.filter(|v| !(1e-9..=1e9).contains(v)) {
        return Err(BuildError::Voxel(voxel));
    }
    let n = args.tree_voxels;
    if !(n.is_power_of_two() && (16..=8192).contains(&n)) {
        return Err(BuildError::TreeSize(n));
    }
    if args.chunk_log2 > 2 {
        return Err(BuildError::ChunkSize(args.chunk_log2));
    }
    Ok((n / BRICK_VOXELS).ilog2() as u8)
}

impl Inputs {
    fn default_voxel(&self) -> f64 {
        let pixels = self.layers.iter().map(|l| l.map.pixel_size().min_element());
        pixels.reduce(f64::min).unwrap_or_else(|| {
            let boxes = self.meshes.iter().map(Mesh::bounds);
            let all = boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
            all.map_or(0.0, |(min, max)| (max - min).max_element() / DEFAULT_RESOLUTION)
        })
    }

    fn build(
        &self,
        args: &BuildArgs,
        lattice: Lattice,
        progress: &dyn Progress,
    ) -> Result<BuildReport, BuildError> {
        let surfaces = Surfaces::new(&self.meshes, lattice);
        let plan = plan::Plan::new(&lattice, &self.layers, &surfaces)?;
        manifest::claim(&args.out, &manifest(args, &lattice)?, args.force)?;
        let terrain = Terrain {
            lattice,
            layers: &self.layers,
            surfaces: &surfaces,
            plan: &plan,
            encoding: args.encoding,
            chunk_log2: args.chunk_log2,
            // Without triangles there are no outlines, and no layer is to be stored of them.
            filter: if surfaces.len() == 0 {
                Filter::Double
            } else {
                args.filter
            },
        };
        let mut report = BuildReport {
            voxel: lattice.voxel,
            ..BuildReport::default()
        };
        report.warnings = self.warnings();
        let mut empty = EmptyTrees::load(&args.out);
        let folder = |place| args.out.join(TREES).join(lattice.tree_name(place));
        let finished = |name: &str, folder: &Path| empty.names.contains(name) || folder.is_dir();
        let done = plan
            .trees
            .iter()
            .filter(|p| finished(&lattice.tree_name(**p), &folder(**p)))
            .count();
        progress.start(plan.trees.len() as u64, done as u64);
        let (tree_folder, scratch) = (args.out.join(TREES), args.out.join(ROOT_SAMPLES));
        fs::create_dir_all(&scratch).map_err(BuildError::io(&scratch))?;
        let folders = Folders {
            trees: &tree_folder,
            scratch: &scratch,
        };
        let (mut trees, mut places) = (Vec::new(), Vec::new());
        let mut new_voxels = 0;
        for place in &plan.trees {
            let (name, folder) = (lattice.tree_name(*place), folder(*place));
            if empty.names.contains(&name) {
                continue;
            }
            let header = if folder.is_dir() {
                report.resumed += 1;
                Some(read_header(&folder.join(TREE_FILE))?)
            } else {
                let header = build_tree(&terrain, *place, &folder, &folders.samples(&name))?;
                new_voxels += header.map_or(0, |h| h.surface_voxels);
                if header.is_none() {
                    empty.add(&name)?;
                }
                progress.tree(new_voxels);
                header
            };
            if let Some(header) = header {
                report.surface_voxels += header.surface_voxels;
                let column = lattice.column_of(place.origin[0], place.origin[1]);
                places.push(*place);
                trees.push(SceneTree {
                    column,
                    file: format!("{TREES}/{name}/{TREE_FILE}"),
                    header,
                });
            }
        }
        report.trees = trees.len();
        let groups = self.build_groups(&terrain, &places, &folders, &mut empty)?;
        empty.write()?;
        let crs = self.layers.iter().find_map(|l| l.map.georef.crs.clone());
        manifest::write_whole(
            &args.out.join(SCENE),
            scene::scene(trees, groups, crs).to_xml().as_bytes(),
        )?;
        manifest::remove_root_samples(&args.out)?;
        progress.finish();
        Ok(report)
    }

    /// Builds the coarse trees over trees that are not there yet; gives all of them.
    fn build_groups(
        &self,
        terrain: &Terrain,
        trees: &[TreePlace],
        folders: &Folders,
        empty: &mut EmptyTrees,
    ) -> Result<Vec<SceneGroup>, BuildError> {
        let has_ground = |column| terrain.plan.bottom(column).is_some();
        let plan = GroupPlan::new(&terrain.lattice, trees, has_ground);
        let folder = |name: &str| folders.trees.join(name);
        let finished = |name: &str| empty.names.contains(name) || folder(name).is_dir();
        if !plan.places.iter().all(|place| finished(&place.name())) {
            for name in build_groups(terrain, &plan, trees, folders)? {
                empty.add(&name)?;
            }
        }
        let full = (plan.places.iter()).filter(|place| !empty.names.contains(&place.name()));
        full.map(|place| {
            let name = place.name();
            Ok(SceneGroup {
                height: place.height,
                column: place.column,
                header: read_header(&folder(&name).join(TREE_FILE))?,
                file: format!("{TREES}/{name}/{TREE_FILE}"),
            })
        })
        .collect()
    }
}

fn manifest(args: &BuildArgs, lattice: &Lattice) -> Result<Manifest, BuildError> {
    let arguments = Arguments {
        voxel: lattice.voxel,
        tree_voxels: args.tree_voxels,
        up: format!("{:?}", args.up),
        height_unit: args
            .height_unit
            .map_or("as in the file".into(), |u| format!("{u:?}")),
        layout: format!("{:?}", args.layout),
        encoding: format!("{:?}", args.encoding),
        chunk_log2: args.chunk_log2,
        filter: args.filter.name(),
    };
    let mut files: Vec<(&'static str, &Path)> = args.inputs.iter().map(|p| ("mesh", p.as_path())).collect();
    for height in &args.heights {
        files.push(("heights", &height.path));
        files.extend(height.imagery.as_deref().map(|p| ("imagery", p)));
    }
    Manifest::new(arguments, &files)
}

fn read_header(path: &Path) -> Result<TreeHeader, BuildError> {
    let bytes = fs::read(path).map_err(BuildError::io(path))?;
    let index = octree_binary::decode_header(&bytes, bytes.len() as u64).map_err(BuildError::format(path))?;
    Ok(index.header)
}

/// Trees that turned out empty, kept so that a resumed build does not look again.
struct EmptyTrees {
    path: PathBuf,
    names: BTreeSet<String>,
    file: Option<File>,
}

impl EmptyTrees {
    fn load(out: &Path) -> Self {
        let path = out.join(EMPTY_TREES);
        let text = fs::read_to_string(&path).unwrap_or_default();
        // A line without an end was cut off when it was written.
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
        Self {
            path,
            names: whole.lines().map(str::to_string).collect(),
            file: None,
        }
    }

    fn add(&mut self, name: &str) -> Result<(), BuildError> {
        if self.file.is_none() {
            self.write()?;
            let file = File::options().create(true).append(true).open(&self.path);
            self.file = Some(file.map_err(BuildError::io(&self.path))?);
        }
        self.names.insert(name.to_string());
        match &mut self.file {
            Some(file) => file
                .write_all(format!("{name}\n").as_bytes())
                .map_err(BuildError::io(&self.path)),
            None => Ok(()),
        }
    }

    /// Writes the names in their order, if there are any.
    fn write(&self) -> Result<(), BuildError> {
        if self.names.is_empty() {
            return Ok(());
        }
        let text: String = self.names.iter().map(|n| format!("{n}\n")).collect();
        manifest::write_whole(&self.path, text.as_bytes())
    }
}
