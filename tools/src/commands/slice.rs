//! `brickfell slice`: a cut through a database along an axis, or a map of it from above, as a PNG of what is stored: colours without
//! light, opacity as transparency.
//!
//! A pixel is the voxel that its middle lies in; nothing is filtered. In a cut its alpha is the opacity across that voxel, in a map
//! that of everything below it.

mod canvas;
mod paint;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use brickfell_formats::nearest;
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::scene::{PagedOctTree, Scene};
use brickfell_runtime::terrain::read_header;
use clap::ValueEnum;
use glam::DVec3;

use super::CommandError;
use super::database::{open_scene, print};
use super::say::bar;
use canvas::Canvas;

/// Pixels per side that a picture has at most where neither level nor voxel is given.
const USUAL_SIDE: f64 = 2048.0;

/// Arguments of `slice`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the database: the one that holds scene.xml
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// The axis that is cut across
    #[arg(long, value_enum, requires = "at", required_unless_present = "top")]
    pub axis: Option<Axis>,
    /// Where on it, world metres
    #[arg(long, value_name = "METRES", requires = "axis", allow_negative_numbers = true)]
    pub at: Option<f64>,
    /// A map seen from above
    #[arg(long, conflicts_with_all = ["axis", "at"])]
    pub top: bool,
    /// Only this tree, or coarse tree: its TreeFile
    #[arg(long, value_name = "TREEFILE")]
    pub tree: Option<String>,
    /// Level of each tree, 0 is the root [default: the finest of which the picture has at most 2048 pixels a side]
    #[arg(long, value_name = "LEVEL")]
    pub level: Option<u8>,
    /// Side of a pixel, metres; of each tree the coarsest level is read whose voxels are no larger
    #[arg(
        long,
        value_name = "METRES",
        conflicts_with = "level",
        allow_negative_numbers = true
    )]
    pub voxel: Option<f64>,
    /// Draw over a checkerboard instead of leaving the picture transparent
    #[arg(long)]
    pub checker: bool,
    /// The PNG to write
    #[arg(long, value_name = "FILE.png")]
    pub out: PathBuf,
}

/// An axis of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Axis {
    /// East: y is to the right, z up
    X,
    /// North: x is to the right, z up
    Y,
    /// Up: x is to the right, y up
    Z,
}

/// A tree that may be in the picture.
struct Placed {
    file: String,
    header: TreeHeader,
    /// What of it is drawn, world metres.
    bounds: [DVec3; 2],
    /// The level that is looked at.
    level: u8,
}

/// Runs the command.
///
/// # Errors
/// A database that cannot be read, a cut that meets no tree, a picture that is too large or cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let (store, scene) = open_scene(&args.dir)?;
    let damaged = |e: String| CommandError::new(e, "`brickfell check` lists everything that is wrong");
    if args.voxel.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
        return Err(CommandError::new(
            "a pixel has a side above 0",
            "--voxel is in metres",
        ));
    }
    let mut trees: Vec<Placed> = Vec::new();
    for tree in chosen(&scene, args.tree.as_deref(), &args.dir)? {
        let header = read_header(&store, &tree.tree_file).map_err(|e| damaged(e.to_string()))?;
        let all = header.bounds();
        trees.push(Placed {
            file: tree.tree_file.clone(),
            header,
            bounds: tree
                .bounds
                .map_or(all, |b| [b.min.max(all[0]), b.max.min(all[1])]),
            level: 0,
        });
    }
    let axis = args.axis.unwrap_or(Axis::Z);
    let axes = match axis {
        Axis::X => [1, 2, 0],
        Axis::Y => [0, 2, 1],
        Axis::Z => [0, 1, 2],
    };
    let whole = trees.iter().map(|t| t.bounds);
    let Some(whole) = whole.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]) else {
        return Err(CommandError::new(
            format!("{}: the scene has no trees", args.dir.display()),
            "`brickfell inspect` shows what is in it",
        ));
    };
    if let Some(at) = args.at {
        trees.retain(|t| (t.bounds[0][axes[2]]..t.bounds[1][axes[2]]).contains(&at));
        if trees.is_empty() {
            let name = ["x", "y", "z"][axes[2]];
            return Err(CommandError::new(
                format!(
                    "{}: no tree is at {name} = {at} m; the scene is from {} to {}",
                    args.dir.display(),
                    whole[0][axes[2]],
                    whole[1][axes[2]]
                ),
                "give an --at between these",
            ));
        }
    }
    let pixel = choose_levels(&mut trees, args, axes);
    let mut canvas = Canvas::new(axes, whole, pixel, args.at)?;
    // A map is painted from the top down.
    trees.sort_by(|a, b| b.bounds[1].z.total_cmp(&a.bounds[1].z));
    let bar = bar(trees.len() as u64, "{bar:32} {pos}/{len} trees, {eta} left");
    for tree in &trees {
        paint::paint(&store, tree, &mut canvas).map_err(damaged)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    canvas.save(&args.out, args.checker).map_err(|e| {
        CommandError::new(
            format!("{}: {e}", args.out.display()),
            "is the folder there, and room?",
        )
    })?;
    print(&legend(args, &canvas, &trees))?;
    Ok(ExitCode::SUCCESS)
}

/// The trees of the scene, or the one that is asked for.
fn chosen<'s>(
    scene: &'s Scene,
    name: Option<&str>,
    dir: &Path,
) -> Result<Vec<&'s PagedOctTree>, CommandError> {
    let Some(name) = name else {
        return Ok(scene.trees().collect());
    };
    let all = || scene.trees().chain(scene.coarse_trees().map(|c| &c.tree));
    if let Some(tree) = all().find(|t| t.tree_file == name) {
        return Ok(vec![tree]);
    }
    let meant = nearest(name, all().map(|t| t.tree_file.as_str()));
    let meant = meant.map_or(String::new(), |m| format!("; did you mean {m}?"));
    Err(CommandError::new(
        format!("{}: the scene names no tree file {name}{meant}", dir.display()),
        "`brickfell inspect` shows which there are",
    ))
}

/// Chooses a level of each tree; gives the side of a pixel.
fn choose_levels(trees: &mut [Placed], args: &Args, axes: [usize; 3]) -> f64 {
    let least = |a: f64, b: f64| a.min(b);
    if let Some(level) = args.level {
        for tree in trees.iter_mut() {
            tree.level = level.min(tree.header.depth);
        }
        let sides = trees.iter().map(|t| t.header.level_voxel_size(t.level));
        return sides.fold(f64::INFINITY, least);
    }
    let pixel = args.voxel.unwrap_or_else(|| {
        let finest = trees
            .iter()
            .map(|t| t.header.voxel_size)
            .fold(f64::INFINITY, least);
        let corners = trees.iter().map(|t| t.bounds);
        let size = corners.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let size = size.map_or(DVec3::ONE, |[lo, hi]| hi - lo);
        let side = size[axes[0]].max(size[axes[1]]);
        finest * (side / finest / USUAL_SIDE).log2().ceil().max(0.0).exp2()
    });
    for tree in trees.iter_mut() {
        let fits = |level: &u8| tree.header.level_voxel_size(*level) <= pixel * (1.0 + 1e-9);
        tree.level = (0..=tree.header.depth).find(fits).unwrap_or(tree.header.depth);
    }
    pixel
}

/// What a pixel is, and where.
fn legend(args: &Args, canvas: &Canvas, trees: &[Placed]) -> String {
    let name = |k: usize| ["x", "y", "z"][canvas.axes[k]];
    let [w, h] = canvas.size;
    let (low, pixel) = (canvas.low, canvas.pixel);
    let levels = trees.iter().map(|t| t.level);
    let levels = match (levels.clone().min(), levels.max()) {
        (Some(a), Some(b)) if a != b => format!("levels {a} to {b}"),
        (a, _) => format!("level {}", a.unwrap_or(0)),
    };
    let (what, see_through) = match args.at {
        Some(at) => (format!("cut at {} = {at} m", name(2)), "opacity of a voxel"),
        None => ("map from above".into(), "opacity of all below"),
    };
    format!(
        "{}: {w} × {h} pixels of {pixel} m, {what}, {levels} of {}; {} from {} to {} m to the right, {} from {} to {} m up; \
         colours as stored, without light; alpha is the {see_through}\n",
        args.out.display(),
        match trees.len() {
            1 => "1 tree".to_string(),
            n => format!("{n} trees"),
        },
        name(0),
        low[0],
        low[0] + f64::from(w) * pixel,
        name(1),
        low[1],
        low[1] + f64::from(h) * pixel,
    )
}
