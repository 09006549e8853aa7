//! `brickfell build`: arguments of the builder, progress, and what came out.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use brickfell_formats::chunk::Encoding;
use brickfell_formats::layout::SampleLayout;
use clap::ValueEnum;
use indicatif::HumanCount;
use serde_json::json;

use super::CommandError;
use super::database::{folder_bytes, print};
use super::input_args::InputArgs;
use super::say::is_quiet;
use crate::build::{
    BuildArgs, BuildError, DEFAULT_TREE_VOXELS, Filter, IndicatifProgress, Progress, Silent, Voxelise, build,
};

/// Arguments of `build`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to build from.
    #[command(flatten)]
    pub input: InputArgs,
    /// Folder of the database. One made by the same command is resumed, another one is refused
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Side of the finest voxel, metres [default: the smallest pixel of the height maps, else 1/1024 of the longest side]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub voxel: Option<f64>,
    /// Finest voxels per axis of a tree: 16, 32, … 8192
    #[arg(long, value_name = "VOXELS", default_value_t = DEFAULT_TREE_VOXELS)]
    pub tree: u32,
    /// Replace a database that was built from other arguments or inputs
    #[arg(long)]
    pub force: bool,
    /// Memory to work with, in bytes or with a unit: 512MiB, 2GiB, 1.5GB
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = parse_bytes)]
    pub memory: u64,
    /// Threads to work with, 0 for one per core
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Where samples lie: in the centres of voxels or on their corners [default: the builder's, see docs/decisions.md]
    #[arg(long, value_enum)]
    pub layout: Option<Layout>,
    /// How coarser levels are made of finer ones, as far as the opacity of open surfaces goes
    #[arg(long, value_enum, default_value_t)]
    pub filter: Filter,
    /// Which voxels a triangle of a mesh leaves something in
    #[arg(long, value_enum, default_value_t)]
    pub voxelise: Voxelise,
    /// Fill closed meshes: their inside is solid
    #[arg(long)]
    pub solid: bool,
    /// By how many of 255 steps colours and normals may be off, 0 to 15, for a smaller database
    #[arg(long, value_name = "STEPS", default_value_t = 0)]
    pub error: u8,
    /// Store bricks in the blocks that graphics hardware reads: a quarter of the device's memory, more of the disk, and a loss
    #[arg(long)]
    pub compress: bool,
    /// Print JSON: out, trees, resumed, surface_voxels, voxel, bytes, seconds, warnings
    #[arg(long)]
    pub json: bool,
}

/// Where samples lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Layout {
    /// In the centres of voxels, 10 per axis of a brick
    Centre,
    /// On the corners of voxels, 9 per axis of a brick
    Corner,
}

/// A number of bytes: `1000`, `64KiB`, `1.5GB`.
fn parse_bytes(text: &str) -> Result<u64, String> {
    let number_end = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(number_end);
    let unit = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "kib" => 1024.0,
        "mib" => 1_048_576.0,
        "gib" => 1_073_741_824.0,
        other => return Err(format!("'{other}' is not one of B, KB, KiB, MB, MiB, GB and GiB")),
    };
    match number.parse::<f64>() {
        Ok(value) if value * unit >= 1.0 => Ok((value * unit) as u64),
        _ => Err(format!("'{number}' is not a number above 0")),
    }
}

impl Args {
    fn build_args(&self) -> BuildArgs {
        let defaults = BuildArgs::new(&self.out);
        BuildArgs {
            inputs: self.input.meshes.clone(),
            placements: self.input.placements.clone(),
            heights: self.input.layers.0.clone(),
            voxel: self.voxel,
            tree_voxels: self.tree,
            up: self.input.up(),
            height_unit: self.input.height_unit(),
            terrain_rgb: self.input.terrain_rgb(),
            layout: self.layout.map_or(defaults.layout, |layout| match layout {
                Layout::Centre => SampleLayout::Centre,
                Layout::Corner => SampleLayout::Corner,
            }),
            filter: self.filter,
            voxelise: self.voxelise,
            solid: self.solid,
            error: self.error,
            encoding: if self.compress {
                Encoding::Blocks
            } else {
                defaults.encoding
            },
            force: self.force,
            threads: self.threads,
            memory: self.memory,
            ..defaults
        }
    }
}

/// Runs the command.
///
/// # Errors
/// As [`build`].
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let start = Instant::now();
    let (bar, silent) = (IndicatifProgress::default(), Silent);
    let progress: &dyn Progress = if is_quiet() { &silent } else { &bar };
    let report = build(&args.build_args(), progress).map_err(explain)?;
    let seconds = start.elapsed().as_secs_f64();
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    let bytes = folder_bytes(&args.out)?;
    if args.json {
        let json = json!({
            "out": args.out, "trees": report.trees, "resumed": report.resumed, "surface_voxels": report.surface_voxels,
            "voxel": report.voxel, "bytes": bytes, "seconds": seconds, "warnings": report.warnings,
        });
        print(&(serde_json::to_string_pretty(&json)? + "\n"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let per_voxel = match report.surface_voxels {
        0 => String::new(),
        voxels => format!(" ({:.2} per voxel)", bytes as f64 / voxels as f64),
    };
    let resumed = match report.resumed {
        0 => String::new(),
        n => format!(" ({n} of them from an earlier run)"),
    };
    print(&format!(
        "{} trees{resumed}, {} voxels of {} m, {} bytes{per_voxel}, {seconds:.1} s: {}\n",
        HumanCount(report.trees as u64),
        HumanCount(report.surface_voxels),
        report.voxel,
        HumanCount(bytes),
        args.out.display(),
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// Adds what to do about it, where that is not in the message.
fn explain(error: BuildError) -> CommandError {
    match error {
        BuildError::NoInput => CommandError::new(error, "`brickfell build --help` shows how"),
        BuildError::Voxel(_) => CommandError::new(error, "--voxel is the side of the finest voxel in metres"),
        BuildError::TreeSize(_) => CommandError::new(error, "--tree 256, 512 and 1024 are usual"),
        BuildError::Foreign(_) => CommandError::new(error, "nothing was changed in it, --force or not"),
        BuildError::Exists(_) => {
            CommandError::new(error, "give the arguments it was built with to resume it")
        }
        _ => error.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::{HeightUnit, UpAxis};
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn parse(line: &str) -> Result<Args, clap::Error> {
        Cli::try_parse_from(["build"].into_iter().chain(line.split(' '))).map(|cli| cli.args)
    }

    #[test]
    fn arguments_reach_the_builder() {
        let args = parse(
            "a.obj --out db --voxel -1 --tree 64 --up y --height-unit ft --force --threads 3 --layout corner --filter pow --compress",
        );
        let args = args.unwrap().build_args();
        assert_eq!(
            (args.voxel, args.tree_voxels, args.up),
            (Some(-1.0), 64, UpAxis::Y)
        );
        assert_eq!(args.height_unit, Some(HeightUnit::Feet));
        assert_eq!(
            (args.layout, args.force, args.threads, args.filter),
            (SampleLayout::Corner, true, 3, Filter::Pow)
        );
        assert_eq!(args.encoding, Encoding::Blocks);
        let default = parse("a.obj --out db").unwrap().build_args();
        assert_eq!(default.layout, BuildArgs::new("db").layout);
        assert_eq!(default.memory, BuildArgs::new("db").memory);
        assert_eq!(default.encoding, Encoding::Packed);
    }

    #[test]
    fn sizes_of_memory() {
        for (text, bytes) in [
            ("12", 12),
            ("64KiB", 65_536),
            ("1.5 GB", 1_500_000_000),
            ("2gib", 2 << 30),
        ] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "GiB", "-1", "1 XB", "0", "1e3", "nan"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }
}
