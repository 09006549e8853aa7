//! The builder: height maps and meshes in, a terrain database out.
//!
//! World is lattice index × voxel, everywhere (`lattice`). A sample's value is a pure function of its place on the
//! lattice, its level and the inputs, never of the tree that stores it; so borders are right across bricks, tiles and
//! trees at every level, and what one tile makes of its own cells serves all trees whose aprons they reach.
//!
//! ```text
//! meshes, as streams → bins (faces by column of tiles) ─┐
//! height maps ──────────────────────────→ plan (which trees) → for each tile of each tree:
//!   finest (ground, surface, overlap) → blocks of samples ─┬→ texels → nodes → chunks ┐
//!                                        ↑  filter: ×½  ←──┘                          ├→ file in the scratch folder
//!                                        └── for three levels, then samples ──────────┘
//! → for each tree: samples of its tiles and those around it → the same up to the root; bricks and octree on disk
//! → groups (coarse trees over trees, of the samples that roots leave) → scene
//! ```
//! Called from one thread, which waits; the work is spread over a pool of threads of its own. Bytes do not depend on the
//! number of threads, nor on whether a build was interrupted and resumed.

mod bins;
mod blocks;
mod cells;
mod crop;
mod error;
mod faces;
mod facets;
mod filter;
mod finest;
mod ground;
mod groups;
mod inside;
mod lattice;
mod manifest;
mod nodes;
mod overlap;
mod plan;
mod progress;
mod sample;
mod scene;
mod schedule;
mod spill;
mod surface;
#[cfg(test)]
mod tests;
mod texels;
mod tile;
mod tree;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use brickfell_formats::chunk::Encoding;
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::steps::Steps;
use glam::DVec3;

pub use error::BuildError;
pub use filter::Filter;
pub use overlap::Voxelise;
pub use progress::{IndicatifProgress, Progress, Silent};

pub use crate::input::HeightInput;
use crate::input::placements::{self, Placement, Pose};
use crate::input::{
    Face, HeightOptions, HeightUnit, Layer, RasterCache, Streamed, TerrainRgb, TextureSet, UpAxis,
    highest_ground, load_layers, mesh,
};
use bins::Bins;
use groups::GroupPlan;
use lattice::Lattice;
use manifest::{Arguments, EMPTY_TREES, Manifest, SCENE, TREES};
use scene::{SceneGroup, SceneTree};
use schedule::{Schedule, Workers, read_header};
use tree::{TREE_FILE, Terrain};

/// Where samples lie unless told.
pub const DEFAULT_LAYOUT: SampleLayout = SampleLayout::Centre;
/// Finest voxels per axis of a tree unless told.
pub const DEFAULT_TREE_VOXELS: u32 = 512;
/// Memory to work with unless told, bytes.
pub const DEFAULT_MEMORY: u64 = 2 << 30;
/// The part of the memory that height maps, imagery and textures may take: one of so many. What is more of them stays on disk.
const RASTERS_SHARE: u64 = 4;
/// The part of the memory that faces may take: one of so many.
const FACES_SHARE: u64 = 4;
/// Voxels across the longest side of a terrain without height maps, unless told.
const DEFAULT_RESOLUTION: f64 = 1024.0;

/// What to build.
#[derive(Clone, Debug)]
pub struct BuildArgs {
    /// Meshes (OBJ).
    pub inputs: Vec<PathBuf>,
    /// Lists of placed models ([`crate::input::placements`]).
    pub placements: Vec<PathBuf>,
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
    /// How heights are coded in height maps with colours.
    pub terrain_rgb: Option<TerrainRgb>,
    /// Where samples lie.
    pub layout: SampleLayout,
    /// How chunks are coded.
    pub encoding: Encoding,
    /// Bricks per axis of a chunk are 2 to this power, at most 2.
    pub chunk_log2: u8,
    /// How coarser levels are made of finer ones.
    pub filter: Filter,
    /// Which voxels a triangle of a mesh leaves something in.
    pub voxelise: Voxelise,
    /// Whether the inside of closed meshes is solid.
    pub solid: bool,
    /// By how many of 255 steps colours and normals of surfaces may be off, at most [`Steps::MOST`].
    pub error: u8,
    /// Whether a database built from something else may be replaced.
    pub force: bool,
    /// Threads to work with; 0 is one per core.
    pub threads: usize,
    /// Memory to work with, bytes.
    pub memory: u64,
}

impl BuildArgs {
    /// Defaults for everything but the output folder; there is no input yet.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            inputs: Vec::new(),
            placements: Vec::new(),
            heights: Vec::new(),
            out: out.into(),
            voxel: None,
            tree_voxels: DEFAULT_TREE_VOXELS,
            up: UpAxis::Z,
            height_unit: None,
            terrain_rgb: None,
            layout: DEFAULT_LAYOUT,
            encoding: Encoding::Packed,
            chunk_log2: 2,
            filter: Filter::default(),
            voxelise: Voxelise::default(),
            solid: false,
            error: 0,
            force: false,
            threads: 0,
            memory: DEFAULT_MEMORY,
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
    pool.install(|| Ground::load(args)?.build(args, depth, progress))
}

/// Checks the arguments and gives the depth of trees.
fn check(args: &BuildArgs) -> Result<u8, BuildError> {
    if args.inputs.is_empty() && args.placements.is_empty() && args.heights.is_empty() {
        return Err(BuildError::NoInput);
    }
    if let Some(voxel) = args.voxel.filter(|v| !(1e-9..=1e9).contains(v)) {
        return Err(BuildError::Voxel(voxel));
    }
    let n = args.tree_voxels;
    if !(n.is_power_of_two() && (16..=8192).contains(&n)) {
        return Err(BuildError::TreeSize(n));
    }
    if args.error > Steps::MOST {
        return Err(BuildError::Bound(args.error));
    }
    if args.chunk_log2 > 2 {
        return Err(BuildError::ChunkSize(args.chunk_log2));
    }
    Ok((n / BRICK_VOXELS).ilog2() as u8)
}

/// What is in memory of the input before the lattice is known.
struct Ground {
    layers: Vec<Layer>,
    textures: TextureSet,
    /// Placed models, and where they stand.
    placed: Vec<(PathBuf, Vec<Pose>)>,
}

impl Ground {
    fn load(args: &BuildArgs) -> Result<Self, BuildError> {
        let options = HeightOptions {
            height_unit: args.height_unit,
            terrain_rgb: args.terrain_rgb,
            ..HeightOptions::default()
        };
        let textures = TextureSet::new(&RasterCache::near(args.memory / RASTERS_SHARE, &args.out));
        let layers = load_layers(&args.heights, options, textures.cache())?;
        let mut placed = Vec::new();
        for list in &args.placements {
            for model in placements::read(list)? {
                let pose = |p: &Placement| p.pose(list, |x, y| highest_ground(&layers, x, y));
                let poses = model.placements.iter().map(pose).collect::<Result<_, _>>()?;
                placed.push((model.path, poses));
            }
        }
        Ok(Self {
            layers,
            textures,
            placed,
        })
    }

    fn build(
        &mut self,
        args: &BuildArgs,
        depth: u8,
        progress: &dyn Progress,
    ) -> Result<BuildReport, BuildError> {
        let voxel = match args.voxel {
            Some(voxel) => voxel,
            None => self.default_voxel(args)?,
        };
        if !(1e-9..=1e9).contains(&voxel) {
            return Err(BuildError::Voxel(voxel));
        }
        let lattice = Lattice {
            voxel,
            depth,
            layout: args.layout,
        };
        let mut faces = Bins::new(lattice, &args.out, (args.memory / FACES_SHARE) as usize);
        let mut warnings: Vec<String> = self.layers.iter().flat_map(|l| l.map.notes.clone()).collect();
        let mut files = Vec::new();
        let mut read = |path: &Path, poses: &[Pose]| {
            let first = faces.materials.len() as u32;
            let mesh = stream_posed(path, args.up, poses, &mut self.textures, |new| {
                faces.add(new, first)
            })?;
            faces.materials.extend(mesh.materials);
            warnings.extend(mesh.warnings);
            files.extend(mesh.files);
            Ok::<_, BuildError>(())
        };
        for path in &args.inputs {
            read(path, &[])?;
        }
        for (path, poses) in &self.placed {
            read(path, poses)?;
        }
        files.extend(self.placed.iter().map(|(path, _)| path.clone()));
        build_from(args, lattice, &self.layers, &faces, (warnings, files), progress)
    }

    /// The smallest pixel of height maps, else a part of the longest side of the meshes.
    fn default_voxel(&mut self, args: &BuildArgs) -> Result<f64, BuildError> {
        let pixels = self.layers.iter().map(|l| l.map.pixel_size().min_element());
        if let Some(pixel) = pixels.reduce(f64::min) {
            return Ok(pixel);
        }
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let meshes = args.inputs.iter().map(|path| (path, &[] as &[Pose]));
        for (path, poses) in meshes.chain(self.placed.iter().map(|(path, poses)| (path, &poses[..]))) {
            stream_posed(path, args.up, poses, &mut self.textures, |faces| {
                for p in faces.iter().flat_map(|f| f.corners) {
                    (min, max) = (min.min(p), max.max(p));
                }
                Ok::<_, BuildError>(())
            })?;
        }
        Ok((max - min).max_element() / DEFAULT_RESOLUTION)
    }
}

/// Faces of a placed model that are kept to be placed again; larger models are read once for each place.
const KEPT_FACES: usize = 1 << 18;

/// Reads a mesh face by face as [`mesh::stream`] does, once for each pose, or as it is if there is none.
fn stream_posed(
    path: &Path,
    up: UpAxis,
    poses: &[Pose],
    textures: &mut TextureSet,
    mut each: impl FnMut(&[Face]) -> Result<(), BuildError>,
) -> Result<Streamed, BuildError> {
    let Some((first, others)) = poses.split_first() else {
        return mesh::stream(path, up, textures, each);
    };
    let mut kept = Some(Vec::new()).filter(|_| !others.is_empty());
    let mut place =
        |faces: &[Face], pose: &Pose| each(&faces.iter().map(|f| pose.face(f)).collect::<Vec<_>>());
    let streamed = mesh::stream(path, up, textures, |faces| {
        if let Some(all) = &mut kept {
            all.extend_from_slice(faces);
        }
        kept.take_if(|all| all.len() > KEPT_FACES);
        place(faces, first)
    })?;
    for pose in others {
        match &kept {
            Some(faces) => place(faces, pose)?,
            None => {
                mesh::stream(path, up, textures, |faces| place(faces, pose))?;
            }
        }
    }
    Ok(streamed)
}

/// Builds from height maps and binned faces; what was missing in the meshes and which further files were read comes with them.
fn build_from(
    args: &BuildArgs,
    lattice: Lattice,
    layers: &[Layer],
    faces: &Bins,
    (warnings, files): (Vec<String>, Vec<PathBuf>),
    progress: &dyn Progress,
) -> Result<BuildReport, BuildError> {
    let plan = plan::Plan::new(&lattice, layers, faces)?;
    manifest::claim(&args.out, &manifest(args, &lattice, &files)?, args.force)?;
    let terrain = Terrain {
        lattice,
        layers,
        faces,
        plan: &plan,
        encoding: args.encoding,
        chunk_log2: args.chunk_log2,
        // Without triangles there are no outlines, and no layer is to be stored of them.
        filter: if faces.len() == 0 {
            Filter::Double
        } else {
            args.filter
        },
        voxelise: args.voxelise,
        solid: args.solid,
        error: args.error,
    };
    let mut report = BuildReport {
        voxel: lattice.voxel,
        ..BuildReport::default()
    };
    report.warnings = warnings;
    let mut empty = EmptyTrees::load(&args.out);
    let mut trees = Vec::new();
    let groups = GroupPlan::new(&lattice, &plan.trees, |column| plan.bottom(column).is_some());
    let open = groups.open(&args.out, &empty);
    let mut schedule = Schedule {
        terrain: &terrain,
        out: &args.out,
        open: &open,
        workers: Workers::new(args),
        progress,
    };
    schedule.run(&mut empty, |place, header, resumed| {
        report.resumed += usize::from(resumed);
        report.surface_voxels += header.surface_voxels;
        let file = format!("{TREES}/{}/{TREE_FILE}", lattice.tree_name(place));
        trees.push(SceneTree {
            column: lattice.column_of(place.origin[0], place.origin[1]),
            bounds: crop::content(&args.out.join(&file))?,
            file,
        });
        Ok(())
    })?;
    report.trees = trees.len();
    groups.build(&terrain, &open, &args.out, &mut empty)?;
    let mut coarse = Vec::new();
    for group in groups
        .coarse()
        .filter(|group| !empty.names.contains(&group.name()))
    {
        let file = format!("{TREES}/{}/{TREE_FILE}", group.name());
        coarse.push(SceneGroup {
            height: group.height,
            column: group.column,
            header: read_header(&args.out.join(&file))?,
            bounds: crop::content(&args.out.join(&file))?,
            file,
        });
    }
    empty.write()?;
    let crs = layers
        .iter()
        .find_map(|l| l.map.world_system().map(str::to_string));
    manifest::write_whole(
        &args.out.join(SCENE),
        scene::scene(trees, coarse, crs, args.encoding == Encoding::Blocks)
            .to_xml()
            .as_bytes(),
    )?;
    manifest::remove_scratch(&args.out)?;
    progress.finish();
    Ok(report)
}

fn manifest(args: &BuildArgs, lattice: &Lattice, materials: &[PathBuf]) -> Result<Manifest, BuildError> {
    let arguments = Arguments {
        voxel: lattice.voxel,
        tree_voxels: args.tree_voxels,
        up: format!("{:?}", args.up),
        height_unit: args
            .height_unit
            .map_or("as in the file".into(), |u| format!("{u:?}")),
        terrain_rgb: args.terrain_rgb.map(|rgb| format!("{rgb:?}")),
        layout: format!("{:?}", args.layout),
        encoding: format!("{:?}", args.encoding),
        chunk_log2: args.chunk_log2,
        filter: args.filter.name(),
        voxelise: (args.voxelise != Voxelise::default()).then(|| format!("{:?}", args.voxelise)),
        solid: args.solid,
        error: args.error,
    };
    let mut files: Vec<(&'static str, &Path)> = args.inputs.iter().map(|p| ("mesh", p.as_path())).collect();
    files.extend(args.placements.iter().map(|p| ("placements", p.as_path())));
    files.extend(materials.iter().map(|p| ("material", p.as_path())));
    for height in &args.heights {
        files.push(("heights", &height.path));
        files.extend(height.imagery.as_deref().map(|p| ("imagery", p)));
    }
    Manifest::new(arguments, &files)
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
