//! `brickfell build`: arguments of the builder, progress, and what came out.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use brickfell_formats::layout::SampleLayout;
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Command, FromArgMatches, ValueEnum, value_parser};
use indicatif::HumanCount;

use super::CommandError;
use super::database::{folder_bytes, print};
use crate::build::{
    BuildArgs, BuildError, DEFAULT_TREE_VOXELS, Filter, HeightInput, IndicatifProgress, build,
};
use crate::input::{HeightUnit, UpAxis};

/// Arguments of `build`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Meshes: OBJ files, with their MTL files and textures beside them
    #[arg(value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    /// Height maps with their imagery.
    #[command(flatten)]
    pub layers: Layers,
    /// Folder of the database. One made by the same command is resumed, another one is refused
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Side of the finest voxel, metres [default: the smallest pixel of the height maps, else 1/1024 of the longest side]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub voxel: Option<f64>,
    /// Finest voxels per axis of a tree: 16, 32, … 8192
    #[arg(long, value_name = "VOXELS", default_value_t = DEFAULT_TREE_VOXELS)]
    pub tree: u32,
    /// Which axis of meshes points up
    #[arg(long, value_enum, default_value_t = Up::Z)]
    pub up: Up,
    /// Unit of heights [default: the file's own, else its horizontal unit]
    #[arg(long, value_enum)]
    pub height_unit: Option<Unit>,
    /// Replace a database that was built from other arguments or inputs
    #[arg(long)]
    pub force: bool,
    /// Threads to work with, 0 for one per core
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Where samples lie: in the centres of voxels or on their corners [default: the builder's, see docs/decisions.md]
    #[arg(long, value_enum)]
    pub layout: Option<Layout>,
    /// How coarser levels are made of finer ones, as far as the opacity of open surfaces goes
    #[arg(long, value_enum, default_value_t)]
    pub filter: Filter,
}

/// An axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Up {
    /// Y, as most modelling programs write
    Y,
    /// Z, as the world has it
    Z,
}

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Unit {
    /// Metres
    M,
    /// International feet, 0.3048 m
    Ft,
}

/// Where samples lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Layout {
    /// In the centres of voxels, 10 per axis of a brick
    Centre,
    /// On the corners of voxels, 9 per axis of a brick
    Corner,
}

/// Height maps in the order they were given, each with the `--imagery` that follows it.
#[derive(Clone, Debug, Default)]
pub struct Layers(pub Vec<HeightInput>);

const HEIGHTS: &str = "heights";
const IMAGERY: &str = "imagery";

impl clap::Args for Layers {
    fn augment_args(command: Command) -> Command {
        let file = |id: &'static str, help: &'static str| {
            Arg::new(id)
                .long(id)
                .value_name("FILE")
                .help(help)
                .action(ArgAction::Append)
                .value_parser(value_parser!(PathBuf))
        };
        command
            .arg(file(
                HEIGHTS,
                "Height map: PNG (16-bit), TIFF or GeoTIFF; may be given several times",
            ))
            .arg(file(
                IMAGERY,
                "Picture over the --heights before it: PNG, JPEG or TIFF",
            ))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Layers {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |id: &str| -> Vec<(usize, PathBuf)> {
            let values = matches.get_many::<PathBuf>(id).into_iter().flatten().cloned();
            matches.indices_of(id).into_iter().flatten().zip(values).collect()
        };
        let heights = given(HEIGHTS);
        let places: Vec<usize> = heights.iter().map(|(place, _)| *place).collect();
        let mut layers: Vec<HeightInput> = heights
            .into_iter()
            .map(|(_, path)| HeightInput { path, imagery: None })
            .collect();
        for (place, path) in given(IMAGERY) {
            let before = places.partition_point(|heights| *heights < place);
            let Some(layer) = before.checked_sub(1).and_then(|k| layers.get_mut(k)) else {
                return Err(misplaced(
                    &path,
                    "belongs to the --heights before it, and there is none",
                ));
            };
            if layer.imagery.replace(path.clone()).is_some() {
                return Err(misplaced(&path, "is a second one for the same --heights"));
            }
        }
        Ok(Self(layers))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn misplaced(path: &std::path::Path, what: &str) -> clap::Error {
    clap::Error::raw(
        ErrorKind::ArgumentConflict,
        format!("--imagery {} {what}\n", path.display()),
    )
}

impl Args {
    fn build_args(&self) -> BuildArgs {
        let defaults = BuildArgs::new(&self.out);
        BuildArgs {
            inputs: self.inputs.clone(),
            heights: self.layers.0.clone(),
            voxel: self.voxel,
            tree_voxels: self.tree,
            up: match self.up {
                Up::Y => UpAxis::Y,
                Up::Z => UpAxis::Z,
            },
            height_unit: self.height_unit.map(|unit| match unit {
                Unit::M => HeightUnit::Metres,
                Unit::Ft => HeightUnit::Feet,
            }),
            layout: self.layout.map_or(defaults.layout, |layout| match layout {
                Layout::Centre => SampleLayout::Centre,
                Layout::Corner => SampleLayout::Corner,
            }),
            filter: self.filter,
            force: self.force,
            threads: self.threads,
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
    let report = build(&args.build_args(), &IndicatifProgress::default()).map_err(explain)?;
    let seconds = start.elapsed().as_secs_f64();
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    let bytes = folder_bytes(&args.out)?;
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
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn parse(line: &str) -> Result<Args, clap::Error> {
        Cli::try_parse_from(["build"].into_iter().chain(line.split(' '))).map(|cli| cli.args)
    }

    fn layers(line: &str) -> Vec<(String, Option<String>)> {
        let text = |p: PathBuf| p.display().to_string();
        let args = parse(line).unwrap();
        args.layers
            .0
            .into_iter()
            .map(|l| (text(l.path), l.imagery.map(text)))
            .collect()
    }

    #[test]
    fn imagery_belongs_to_the_heights_before_it() {
        let pair = |h: &str, i: Option<&str>| (h.to_string(), i.map(str::to_string));
        assert_eq!(
            layers(
                "a.obj --heights 1.tif --imagery 1.jpg --heights 2.tif b.obj --heights=3.tif --imagery=3.png --out db"
            ),
            [
                pair("1.tif", Some("1.jpg")),
                pair("2.tif", None),
                pair("3.tif", Some("3.png"))
            ]
        );
        assert_eq!(layers("a.obj --out db"), []);
    }

    #[test]
    fn imagery_without_heights_of_its_own_is_refused() {
        for line in [
            "--imagery 1.jpg --heights 1.tif --out db",
            "--heights 1.tif --imagery 1.jpg --imagery 2.jpg --out db",
            "a.obj --imagery 1.jpg --out db",
        ] {
            let error = parse(line).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::ArgumentConflict, "{line}");
        }
    }

    #[test]
    fn arguments_reach_the_builder() {
        let args = parse(
            "a.obj --out db --voxel -1 --tree 64 --up y --height-unit ft --force --threads 3 --layout corner --filter pow",
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
        let default = parse("a.obj --out db").unwrap().build_args();
        assert_eq!(default.layout, BuildArgs::new("db").layout);
    }
}
