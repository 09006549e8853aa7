//! `brickfell info`: what a database holds and what it takes on disk.
//!
//! Figures come from the octrees and from the lengths of files; bricks are counted but not read (that is `check`).

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use brickfell_formats::bricks::brick_file_name;
use brickfell_formats::octree::Octree;
use brickfell_formats::octree_binary;
use brickfell_pager::Store;
use glam::DVec3;
use indicatif::{HumanBytes, HumanCount};
use rayon::prelude::*;
use serde::Serialize;

use super::CommandError;
use super::convert::is_compressed;
use super::database::{folder_bytes, open_scene, print, read_octree};
use super::fault::Fault;
use super::say::bar;

/// Arguments of `info`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the database: the one that holds scene.xml
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// Print JSON: trees, coarse_trees, coarse_bytes, levels, bricks, voxels, bytes, bytes_per_level, bytes_per_voxel, voxel_size, bounds, compressed, crs
    #[arg(long)]
    pub json: bool,
}

/// A box in the world, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorldBox {
    /// Low corner.
    pub min: [f64; 3],
    /// High corner.
    pub max: [f64; 3],
}

impl WorldBox {
    /// From corner to corner.
    pub(crate) fn of(corners: [DVec3; 2]) -> Self {
        Self {
            min: corners[0].to_array(),
            max: corners[1].to_array(),
        }
    }
}

/// What a database holds; the names of the fields are those of the JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// Trees of the scene.
    pub trees: usize,
    /// Coarse trees that stand for groups of trees seen from afar.
    pub coarse_trees: usize,
    /// Bytes of those.
    pub coarse_bytes: u64,
    /// Levels of the deepest tree.
    pub levels: usize,
    /// Bricks of all levels of all trees.
    pub bricks: u64,
    /// Finest voxels that an input surface meets, as the octrees' headers count them.
    pub voxels: u64,
    /// Bytes of all files in the folder.
    pub bytes: u64,
    /// Bytes by level, from the root: nodes and brick file. A header counts at level 0, and so does an XML octree.
    pub bytes_per_level: Vec<u64>,
    /// `bytes / voxels`; none if there are no voxels.
    pub bytes_per_voxel: Option<f64>,
    /// Side of the finest voxel of any tree, metres; none without trees.
    pub voxel_size: Option<f64>,
    /// Box of the surface voxels, world metres; where no tree states any (hand-written ones), box of the trees.
    pub bounds: Option<WorldBox>,
    /// Whether the scene says that bricks are block-compressed.
    pub compressed: bool,
    /// Coordinate reference system, as the inputs named it.
    pub crs: Option<String>,
}

/// What one tree adds.
struct TreeInfo {
    bricks: u64,
    voxels: u64,
    voxel_size: f64,
    bytes_per_level: Vec<u64>,
    surface: Option<[DVec3; 2]>,
    bounds: [DVec3; 2],
}

/// Runs the command.
///
/// # Errors
/// A scene or an octree that cannot be read, or a brick file that is missing.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let info = sum_up(args)?;
    if args.json {
        print(&(serde_json::to_string_pretty(&info)? + "\n"))?;
    } else {
        print(&describe(&info))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn sum_up(args: &Args) -> Result<Info, CommandError> {
    let (store, scene) = open_scene(&args.dir)?;
    let names: Vec<&str> = scene.trees().map(|t| t.tree_file.as_str()).collect();
    let bar = bar(names.len() as u64, "{bar:32} {pos}/{len} trees, {eta} left");
    let trees: Vec<TreeInfo> = names
        .par_iter()
        .map(|name| {
            let info = tree_info(&store, name);
            bar.inc(1);
            info
        })
        .collect::<Result<_, _>>()
        .map_err(|e| CommandError::new(e, "`brickfell check` lists everything that is wrong"))?;
    let coarse: Vec<TreeInfo> = (scene.coarse_trees().collect::<Vec<_>>().par_iter())
        .map(|coarse| tree_info(&store, &coarse.tree.tree_file))
        .collect::<Result<_, _>>()
        .map_err(|e| CommandError::new(e, "`brickfell check` lists everything that is wrong"))?;
    bar.finish_and_clear();
    let bytes = folder_bytes(&args.dir)?;
    let voxels: u64 = trees.iter().map(|t| t.voxels).sum();
    let levels = trees.iter().map(|t| t.bytes_per_level.len()).max().unwrap_or(0);
    let at_level = |level: usize| trees.iter().filter_map(|t| t.bytes_per_level.get(level)).sum();
    let union = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let surface = trees.iter().filter_map(|t| t.surface).reduce(union);
    let bounds = surface.or_else(|| trees.iter().map(|t| t.bounds).reduce(union));
    Ok(Info {
        trees: trees.len(),
        coarse_trees: coarse.len(),
        coarse_bytes: coarse.iter().flat_map(|t| &t.bytes_per_level).sum(),
        levels,
        bricks: trees.iter().map(|t| t.bricks).sum(),
        voxels,
        bytes,
        bytes_per_level: (0..levels).map(at_level).collect(),
        bytes_per_voxel: (voxels > 0).then(|| bytes as f64 / voxels as f64),
        voxel_size: trees.iter().map(|t| t.voxel_size).reduce(f64::min),
        bounds: bounds.map(WorldBox::of),
        compressed: is_compressed(&scene.root),
        crs: scene.crs,
    })
}

fn tree_info(store: &dyn Store, name: &str) -> Result<TreeInfo, Fault> {
    let octree = read_octree(store, name)?;
    let header = octree.header;
    let file = file_len(store, name)?;
    let mut bytes_per_level = node_bytes(store, name, &octree)?;
    let nodes: u64 = bytes_per_level.iter().sum();
    if let Some(root) = bytes_per_level.first_mut() {
        *root += file.saturating_sub(nodes);
    }
    let mut bricks = 0;
    for (level, bytes) in (0..).zip(bytes_per_level.iter_mut()) {
        let count = octree.brick_count(level);
        if count > 0 {
            *bytes += file_len(store, &brick_file_name(name, level))?;
            bricks += u64::from(count);
        }
    }
    let world = |p: glam::UVec3| header.origin + p.as_dvec3() * header.voxel_size;
    Ok(TreeInfo {
        bricks,
        voxels: header.surface_voxels,
        voxel_size: header.voxel_size,
        bytes_per_level,
        surface: (header.surface_voxels > 0).then(|| header.surface_bounds.map(world)),
        bounds: header.bounds(),
    })
}

/// Bytes that the nodes of each level take in the octree file; none where it is XML, in which levels have no place.
fn node_bytes(store: &dyn Store, name: &str, octree: &Octree) -> Result<Vec<u64>, Fault> {
    let len = file_len(store, name)?;
    let prefix = len.min(octree_binary::prefix_len() as u64) as usize;
    let head = (store.read(name, 0, prefix)).map_err(|e| Fault::unreadable(store, name, "read", &e))?;
    if !octree_binary::is_binary(&head) {
        return Ok(vec![0; octree.levels.len()]);
    }
    let index = octree_binary::decode_header(&head, len).map_err(|e| Fault::new(store, name, e))?;
    Ok(index.levels.iter().map(|level| level.bytes).collect())
}

fn file_len(store: &dyn Store, name: &str) -> Result<u64, Fault> {
    store
        .len(name)
        .map_err(|e| Fault::unreadable(store, name, "opened", &e))
}

/// The figures as text for people.
fn describe(info: &Info) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<16}{value}");
    };
    line("trees", HumanCount(info.trees as u64).to_string());
    if info.coarse_trees > 0 {
        let bytes = HumanBytes(info.coarse_bytes);
        line(
            "coarse trees",
            format!("{} ({bytes})", HumanCount(info.coarse_trees as u64)),
        );
    }
    line("levels", info.levels.to_string());
    line("bricks", HumanCount(info.bricks).to_string());
    line("voxels", HumanCount(info.voxels).to_string());
    line(
        "bytes",
        format!("{} ({})", HumanCount(info.bytes), HumanBytes(info.bytes)),
    );
    for (level, bytes) in info.bytes_per_level.iter().enumerate() {
        line(&format!("  level {level}"), HumanCount(*bytes).to_string());
    }
    if let Some(bytes) = info.bytes_per_voxel {
        line("bytes per voxel", format!("{bytes:.2}"));
    }
    if let Some(metres) = info.voxel_size {
        line("voxel size", format!("{metres} m"));
    }
    if let Some(WorldBox { min, max }) = info.bounds {
        let point = |p: [f64; 3]| p.map(|v| v.to_string()).join(", ");
        line("bounds", format!("({}) to ({}) m", point(min), point(max)));
    }
    line("compressed", if info.compressed { "yes" } else { "no" }.into());
    line("crs", info.crs.clone().unwrap_or_else(|| "none stated".into()));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_scene_written_by_hand_has_its_trees_as_bounds() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/two_trees");
        let bytes = folder_bytes(&dir).unwrap();
        let info = sum_up(&Args { dir, json: true }).unwrap();
        assert_eq!((info.trees, info.levels, info.bricks, info.voxels), (2, 5, 0, 0));
        assert_eq!((info.bytes, info.bytes_per_voxel), (bytes, None));
        assert_eq!(info.bytes_per_level[1..], [0; 4]);
        assert!(info.bytes_per_level[0] > 0 && info.bytes_per_level[0] < bytes);
        assert_eq!(info.voxel_size, Some(0.125));
        let bounds = WorldBox {
            min: [0.0, 0.0, -8.0],
            max: [48.0, 32.0, 24.0],
        };
        assert_eq!(info.bounds, Some(bounds));
        assert!(describe(&info).contains("voxel size      0.125 m\n"));
    }
}
