//! The inputs of a terrain on the command line, for commands that read them.

use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches, ValueEnum, value_parser};

use crate::input::{
    HeightInput, HeightOptions, HeightUnit, InputError, Inputs, RasterCache, TerrainRgb, UpAxis,
};

/// Meshes and height maps.
#[derive(Args, Clone, Debug)]
pub struct InputArgs {
    /// Meshes: OBJ files, with their MTL files and textures beside them
    #[arg(value_name = "INPUT")]
    pub meshes: Vec<PathBuf>,
    /// List of models and where they stand, one a line: `model.obj, x, y, z or ground, heading, scale`; may be given several times
    #[arg(long = "place", value_name = "FILE")]
    pub placements: Vec<PathBuf>,
    /// Height maps with their imagery.
    #[command(flatten)]
    pub layers: Layers,
    /// Which axis of meshes points up
    #[arg(long, value_enum, default_value_t = Up::Z)]
    pub up: Up,
    /// Unit of heights [default: the file's own, else its horizontal unit]
    #[arg(long, value_enum)]
    pub height_unit: Option<Unit>,
    /// How heights are coded in the colours of height maps that are RGB or RGBA pictures
    #[arg(long, value_enum)]
    pub terrain_rgb: Option<RgbCode>,
}

impl InputArgs {
    /// Which axis of meshes points up.
    pub fn up(&self) -> UpAxis {
        match self.up {
            Up::Y => UpAxis::Y,
            Up::Z => UpAxis::Z,
        }
    }

    /// Unit of heights, if not the file's.
    pub fn height_unit(&self) -> Option<HeightUnit> {
        self.height_unit.map(|unit| match unit {
            Unit::M => HeightUnit::Metres,
            Unit::Ft => HeightUnit::Feet,
        })
    }

    /// How heights are coded in colours.
    pub fn terrain_rgb(&self) -> Option<TerrainRgb> {
        self.terrain_rgb.map(|code| match code {
            RgbCode::Mapbox => TerrainRgb::Mapbox,
            RgbCode::Terrarium => TerrainRgb::Terrarium,
        })
    }

    /// Whether no input was named.
    pub fn is_empty(&self) -> bool {
        self.meshes.is_empty() && self.placements.is_empty() && self.layers.0.is_empty()
    }

    /// Reads the files.
    ///
    /// # Errors
    /// As [`Inputs::load`].
    pub fn load(&self) -> Result<Inputs, InputError> {
        let options = HeightOptions {
            height_unit: self.height_unit(),
            terrain_rgb: self.terrain_rgb(),
            ..HeightOptions::default()
        };
        let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
        Inputs::load(
            &self.meshes,
            &self.placements,
            &self.layers.0,
            self.up(),
            options,
            &cache,
        )
    }
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

/// A code of heights in colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RgbCode {
    /// (65536 R + 256 G + B) / 10 - 10000 metres
    Mapbox,
    /// 256 R + G + B / 256 - 32768 metres
    Terrarium,
}

/// Height maps in the order they were given, each with the `--imagery` that follows it.
#[derive(Clone, Debug, Default)]
pub struct Layers(pub Vec<HeightInput>);

const HEIGHTS: &str = "heights";
const IMAGERY: &str = "imagery";

impl Args for Layers {
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
                "Height map: PNG (16-bit, or see --terrain-rgb), TIFF or GeoTIFF, ESRI ASCII grid, SRTM tile (.hgt), USGS \
                 DEM (.dem); may be given several times",
            ))
            .arg(file(
                IMAGERY,
                "Picture over the --heights before it: PNG, JPEG or TIFF, of any extent, resolution and known projection",
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        args: InputArgs,
    }

    fn parse(line: &str) -> Result<InputArgs, clap::Error> {
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
                "a.obj --heights 1.tif --imagery 1.jpg --heights 2.tif b.obj --heights=3.tif --imagery=3.png"
            ),
            [
                pair("1.tif", Some("1.jpg")),
                pair("2.tif", None),
                pair("3.tif", Some("3.png"))
            ]
        );
        assert_eq!(layers("a.obj"), []);
    }

    #[test]
    fn imagery_without_heights_of_its_own_is_refused() {
        for line in [
            "--imagery 1.jpg --heights 1.tif",
            "--heights 1.tif --imagery 1.jpg --imagery 2.jpg",
            "a.obj --imagery 1.jpg",
        ] {
            let error = parse(line).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::ArgumentConflict, "{line}");
        }
    }
}
