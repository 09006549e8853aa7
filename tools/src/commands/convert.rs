//! `brickfell convert`: a database in other clothes: octrees as XML or binary, bricks in other chunks or encoded otherwise, or one
//! level as a file for other programs.
//!
//! Nothing is lost between databases, unless an error is allowed: octrees and samples are the same, bit for bit. Of block-compressed
//! ones none can be made, only files for other programs.

mod export;
pub(super) mod recode;

use std::path::PathBuf;
use std::process::ExitCode;

use brickfell_formats::chunk::Encoding;
use brickfell_formats::scene::Group;
use brickfell_formats::steps::Steps;
use clap::ValueEnum;
use indicatif::HumanCount;

use super::CommandError;
use super::database::{folder_bytes, open_scene, print};
use super::say::bar;
use export::Shape;

/// Arguments of `convert`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the database: the one that holds scene.xml
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// Folder of the new database, which must not exist; or a file ending in .obj (surface) or .ply (points)
    #[arg(long, value_name = "DIR|FILE")]
    pub out: PathBuf,
    /// How octrees are written [default: each as it is]
    #[arg(long, value_enum)]
    pub octrees: Option<Octrees>,
    /// Bricks per chunk and axis [default: as it is]
    #[arg(long, value_name = "BRICKS", value_parser = ["1", "2", "4"])]
    pub chunk: Option<String>,
    /// How chunks are encoded
    #[arg(long, value_enum, default_value_t)]
    pub encoding: Coding,
    /// By how many of 255 steps colours and normals may be off from what they are, for a smaller database
    #[arg(long, value_name = "STEPS", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=i64::from(Steps::MOST)))]
    pub error: u8,
    /// Level to export, 0 is the root [default: the finest of each tree]
    #[arg(long, value_name = "LEVEL", conflicts_with_all = ["octrees", "chunk", "encoding", "error"])]
    pub level: Option<u8>,
}

/// How octrees are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Octrees {
    /// To be read and edited
    Xml,
    /// Small, and loaded level by level
    Binary,
}

/// How chunks are encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Coding {
    /// Small
    #[default]
    Packed,
    /// Differences down the columns: large, and simple to read for other programs
    Plain,
}

impl From<Coding> for Encoding {
    fn from(coding: Coding) -> Self {
        match coding {
            Coding::Packed => Self::Packed,
            Coding::Plain => Self::Plain,
        }
    }
}

const BAR: &str = "{bar:32} {pos}/{len} trees, {eta} left";

/// Whether any group says that its bricks are in blocks.
pub(super) fn is_compressed(group: &Group) -> bool {
    group.compressed || group.groups.iter().any(is_compressed)
}

/// Runs the command.
///
/// # Errors
/// A database that cannot be read or is block-compressed, a place that cannot be written to.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let (store, scene) = open_scene(&args.dir)?;
    let names: Vec<&str> = scene.trees().map(|t| t.tree_file.as_str()).collect();
    let damaged = |e: String| CommandError::new(e, "`brickfell check` lists everything that is wrong");
    let extension = args.out.extension().and_then(|e| e.to_str());
    let shape = match extension {
        Some("obj") => Shape::Surface,
        Some("ply") => Shape::Points,
        _ if args.level.is_some() => {
            return Err(CommandError::new(
                format!("{}: a level goes into a file", args.out.display()),
                "give --out a name that ends in .obj or .ply",
            ));
        }
        _ => {
            if args.out.exists() {
                return Err(CommandError::new(
                    format!("{}: exists", args.out.display()),
                    "give a folder that does not",
                ));
            }
            if is_compressed(&scene.root) {
                return Err(CommandError::new(
                    format!(
                        "{}: bricks are block-compressed: what that lost does not come back",
                        args.dir.display()
                    ),
                    "`brickfell build` without --compress writes a database that can be converted",
                ));
            }
            let coarse = scene.coarse_trees().map(|c| c.tree.tree_file.as_str());
            let all: Vec<&str> = names.iter().copied().chain(coarse).collect();
            let bar = bar(all.len() as u64, BAR);
            recode::recode(&store, &all, args, &bar).map_err(damaged)?;
            bar.finish_and_clear();
            print(&format!(
                "{} bytes, {} before: {}\n",
                HumanCount(folder_bytes(&args.out)?),
                HumanCount(folder_bytes(&args.dir)?),
                args.out.display()
            ))?;
            return Ok(ExitCode::SUCCESS);
        }
    };
    let bar = bar(names.len() as u64, BAR);
    let count = export::export(&store, &names, (args.level, shape), &args.out, &bar).map_err(damaged)?;
    bar.finish_and_clear();
    let what = match shape {
        Shape::Surface => "faces",
        Shape::Points => "points",
    };
    print(&format!("{} {what}: {}\n", HumanCount(count), args.out.display()))?;
    Ok(ExitCode::SUCCESS)
}
