//! `brickfell bench`: runs suites and writes `bench.json` and `bench.csv`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args as ClapArgs;

use super::{CommandError, open_gpu};
use crate::bench::{SUITES, Settings, to_csv, to_json, to_table};

/// Arguments of `brickfell bench`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Suites to run; all without a name
    #[arg(value_name = "SUITE", value_parser = SUITES.iter().map(|s| s.name).collect::<Vec<_>>())]
    pub suites: Vec<String>,
    /// Fewer repetitions and smaller sweeps
    #[arg(long)]
    pub quick: bool,
    /// Folder for the results; built scenes are kept in it
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// If a suite cannot run or the results cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let scenes = args.out.join("scenes");
    std::fs::create_dir_all(&scenes)
        .map_err(|e| CommandError::new(format!("{}: {e}", scenes.display()), "may you write there?"))?;
    let settings = Settings {
        folder: &scenes,
        quick: args.quick,
    };
    let adapter = open_gpu()?.describe();
    let mut results = Vec::new();
    for suite in SUITES
        .iter()
        .filter(|s| args.suites.is_empty() || args.suites.iter().any(|n| n == s.name))
    {
        println!("{}: {}", suite.name, suite.about);
        let rows = (suite.run)(&settings)?;
        println!("{}", to_table(&rows));
        results.push((suite.name.to_string(), rows));
        // After each suite: what is measured stays if a later one fails.
        let json = serde_json::to_string_pretty(&to_json(&adapter, &results))? + "\n";
        for (name, text) in [("bench.json", json), ("bench.csv", to_csv(&results))] {
            let file = args.out.join(name);
            std::fs::write(&file, text)
                .map_err(|e| CommandError::new(format!("{}: {e}", file.display()), "is there room?"))?;
        }
    }
    println!("written to {}", args.out.join("bench.json").display());
    Ok(ExitCode::SUCCESS)
}
