//! `brickfell bench`: runs suites and writes `bench.json` and `bench.csv`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args as ClapArgs;

use super::database::print;
use super::input_args::{InputArgs, Layers, Unit, Up};
use super::say::spinner;
use super::{CommandError, open_gpu};
use crate::bench::{OwnScene, SUITES, Settings, to_csv, to_json, to_table};

/// Arguments of `brickfell bench`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Suites to run; all without a name
    #[arg(value_name = "SUITE", value_parser = SUITES.iter().map(|s| s.name).collect::<Vec<_>>())]
    pub suites: Vec<String>,
    /// Fewer repetitions and smaller sweeps
    #[arg(long)]
    pub quick: bool,
    /// Draw with the CPU's cores, too: suites caster and agreement
    #[arg(long)]
    pub cpu: bool,
    /// Folder for the results; built scenes are kept in it
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print JSON, as in bench.json, in place of tables
    #[arg(long)]
    pub json: bool,
    /// Suite truth: a database of your own instead of the built-in scenes
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
    /// Meshes that the --scene was built from
    #[arg(long, value_name = "OBJ", num_args = 1.., requires = "scene")]
    pub input: Vec<PathBuf>,
    /// Lists of models and where they stand that it was built from
    #[arg(long = "place", value_name = "FILE")]
    pub placements: Vec<PathBuf>,
    /// Height maps that it was built from, with their imagery.
    #[command(flatten)]
    pub layers: Layers,
    /// Which axis of --input points up
    #[arg(long, value_enum, default_value_t = Up::Z)]
    pub up: Up,
    /// Unit of heights [default: the file's own, else its horizontal unit]
    #[arg(long, value_enum)]
    pub height_unit: Option<Unit>,
}

impl Args {
    /// The user's own scene.
    fn own(&self) -> Result<Option<OwnScene>, CommandError> {
        let input = InputArgs {
            meshes: self.input.clone(),
            placements: self.placements.clone(),
            layers: self.layers.clone(),
            up: self.up,
            height_unit: self.height_unit,
            terrain_rgb: None,
        };
        match &self.scene {
            Some(folder) if !input.is_empty() => Ok(Some(OwnScene {
                folder: folder.clone(),
                input,
            })),
            None if input.is_empty() => Ok(None),
            _ => Err(CommandError::new(
                "a scene of your own is a database and what it was built from",
                "bench truth --scene DIR --input house.obj --heights ground.tif --out RESULTS",
            )),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// If a suite cannot run or the results cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let scenes = args.out.join("scenes");
    std::fs::create_dir_all(&scenes)
        .map_err(|e| CommandError::new(format!("{}: {e}", scenes.display()), "may you write there?"))?;
    let own = args.own()?;
    let settings = Settings {
        out: &args.out,
        folder: &scenes,
        own: own.as_ref(),
        quick: args.quick,
        cpu: args.cpu,
    };
    let chosen = SUITES
        .iter()
        .filter(|s| args.suites.is_empty() || args.suites.iter().any(|n| n == s.name));
    // Asked for first: what it takes to find out that there is none is not to be minutes of work.
    let adapter = match chosen.clone().any(|s| s.draws) {
        true => Some(open_gpu()?.describe()),
        false => None,
    };
    let (mut results, mut json) = (Vec::new(), String::new());
    for suite in chosen {
        if !args.json {
            print(&format!("{}: {}\n", suite.name, suite.about))?;
        }
        let measuring = spinner(suite.name);
        let rows = (suite.run)(&settings)?;
        measuring.finish_and_clear();
        if !args.json {
            print(&(to_table(&rows) + "\n"))?;
        }
        results.push((suite.name.to_string(), rows));
        // After each suite: what is measured stays if a later one fails.
        json = serde_json::to_string_pretty(&to_json(adapter.as_deref(), &results))? + "\n";
        for (name, text) in [("bench.json", &json), ("bench.csv", &to_csv(&results))] {
            let file = args.out.join(name);
            std::fs::write(&file, text)
                .map_err(|e| CommandError::new(format!("{}: {e}", file.display()), "is there room?"))?;
        }
    }
    match args.json {
        true => print(&json)?,
        false => print(&format!("written to {}\n", args.out.join("bench.json").display()))?,
    }
    Ok(ExitCode::SUCCESS)
}
