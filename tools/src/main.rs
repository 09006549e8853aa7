//! The `brickfell` program: picks the command, prints errors, gives the exit code.

use std::process::ExitCode;

use brickfell::commands::{self, CommandError};
use clap::{Parser, Subcommand};

const EXAMPLES: &str = "\
Examples:
  A generated terrain, built and flown
    brickfell demo --out demo
    brickfell build demo/*.obj --heights demo/heights.png --imagery demo/imagery.png --voxel 0.25 --out db
    brickfell fly db --settle --frames 24 --size 640x360 --out flight

  Your own: a height map in feet with an aerial picture, and models on it
    brickfell build house.obj --heights ground.tif --imagery ortho.tif --height-unit ft --voxel 0.5 --out db

  What the input looks like, and how far the database's picture is from it
    brickfell render db --truth house.obj --heights ground.tif --eye 0,-200,150 --target 100,100,0 --out truth.png
    brickfell compare picture.png truth.png --out difference.png

  One picture, the figures of a database, a search for damage
    brickfell render db --eye 0,-200,150 --target 100,100,0 --out picture.png
    brickfell info db --json
    brickfell check db

  A hundred kilometres that nobody built, and what paging did on the way
    brickfell fly 'procedural:1?extent=100km' --path path.json --out flight --trace trace.json
    brickfell stats trace.json

  The octrees to be read and edited, and a level for other programs
    brickfell convert db --octrees xml --out readable
    brickfell convert db --level 4 --out surface.obj

Exit codes: 0 done; 1 an error, or faults that check found; 2 wrong usage, or a flight over a damaged database.";

/// Builds terrain databases of sparse voxel octrees and flies through them.
#[derive(Debug, Parser)]
#[command(name = "brickfell", version, after_help = EXAMPLES, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a database from meshes and height maps
    Build(commands::build::Args),
    /// Fly along a camera path: pictures and a report
    Fly(commands::fly::Args),
    /// Fly through a window
    View(commands::view::Args),
    /// Draw one picture
    Render(commands::render::Args),
    /// Say how far two pictures are from each other
    Compare(commands::compare::Args),
    /// Write a database otherwise: octrees as XML or binary, other chunks; or a level as OBJ or PLY
    Convert(commands::convert::Args),
    /// Say what a database holds and what it takes
    Info(commands::info::Args),
    /// Read everything and list what is damaged
    Check(commands::check::Args),
    /// Say what a trace of a flight holds
    Stats(commands::stats::Args),
    /// Measure speed and error on built-in scenes
    Bench(commands::bench::Args),
    /// Write the input files of a generated terrain
    Demo(commands::demo::Args),
    /// Say which adapter is drawn with, or fail if there is none
    #[command(hide = true)]
    Adapter,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Command::Build(args) => commands::build::run(args),
        Command::Fly(args) => commands::fly::run(args),
        Command::View(args) => commands::view::run(args),
        Command::Render(args) => commands::render::run(args),
        Command::Compare(args) => commands::compare::run(args),
        Command::Convert(args) => commands::convert::run(args),
        Command::Info(args) => commands::info::run(args),
        Command::Check(args) => commands::check::run(args),
        Command::Stats(args) => commands::stats::run(args),
        Command::Bench(args) => commands::bench::run(args),
        Command::Demo(args) => commands::demo::run(args),
        Command::Adapter => adapter(),
    };
    result.unwrap_or_else(|error| {
        eprintln!("brickfell: {error}");
        if let Some(hint) = error.hint {
            eprintln!("  hint: {hint}");
        }
        ExitCode::FAILURE
    })
}

fn adapter() -> Result<ExitCode, CommandError> {
    let gpu = commands::open_gpu()?;
    println!("{}", gpu.describe());
    Ok(ExitCode::SUCCESS)
}
