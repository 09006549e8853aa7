//! The `brickfell` program: picks the command, prints errors, gives the exit code.

use std::process::ExitCode;

use brickfell::commands::{self, CommandError, examples};
use clap::{CommandFactory, Parser, Subcommand};

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

  A scene to begin with, to be edited by hand
    brickfell new scene
    brickfell check scene

  One picture, a cut, the figures of a database, a search for damage
    brickfell render db --eye 0,-200,150 --target 100,100,0 --out picture.png
    brickfell slice db --top --out map.png
    brickfell info db --json
    brickfell inspect db
    brickfell check db

  A hundred kilometres that nobody built, and what paging did on the way
    brickfell fly 'procedural:1?extent=100km' --path path.json --out flight --trace trace.json
    brickfell stats trace.json

  The octrees to be read and edited, and a level for other programs
    brickfell convert db --octrees xml --out readable
    brickfell convert db --level 4 --out surface.obj

Exit codes:
  0  done
  1  an error, or faults that check found
  2  wrong usage; or fly, render or inspect did what they could, but not all of the database could be read";

/// Builds terrain databases of sparse voxel octrees and flies through them.
#[derive(Debug, Parser)]
#[command(name = "brickfell", version, after_help = EXAMPLES, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// No progress and no notes: results, warnings and errors alone
    #[arg(long, global = true)]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a database from meshes and height maps
    #[command(after_help = examples::BUILD)]
    Build(commands::build::Args),
    /// Fly along a camera path: pictures and a report
    #[command(after_help = examples::FLY)]
    Fly(commands::fly::Args),
    /// Fly through a window
    #[command(after_help = examples::VIEW)]
    View(commands::view::Args),
    /// Draw one picture
    #[command(after_help = examples::RENDER)]
    Render(commands::render::Args),
    /// Say how far two pictures are from each other
    #[command(after_help = examples::COMPARE)]
    Compare(commands::compare::Args),
    /// Write a database otherwise: octrees as XML or binary, other chunks; or a level as OBJ or PLY
    #[command(after_help = examples::CONVERT)]
    Convert(commands::convert::Args),
    /// Say what a database holds and what it takes
    #[command(after_help = examples::INFO)]
    Info(commands::info::Args),
    /// Show how groups and trees nest, with their boxes, levels and bytes
    #[command(after_help = examples::INSPECT)]
    Inspect(commands::inspect::Args),
    /// Draw a cut through a database, or a map of it from above
    #[command(after_help = examples::SLICE)]
    Slice(commands::slice::Args),
    /// Read everything and list what is damaged
    #[command(after_help = examples::CHECK)]
    Check(commands::check::Args),
    /// Say what a trace of a flight holds
    #[command(after_help = examples::STATS)]
    Stats(commands::stats::Args),
    /// Measure speed and error on built-in scenes
    #[command(after_help = examples::BENCH)]
    Bench(commands::bench::Args),
    /// Write the input files of a generated terrain
    #[command(after_help = examples::DEMO)]
    Demo(commands::demo::Args),
    /// Write a scene to begin with, commented, that flies as it is
    #[command(after_help = examples::NEW)]
    New(commands::new::Args),
    /// Print what a shell needs to complete commands and options
    #[command(after_help = examples::COMPLETIONS)]
    Completions(commands::completions::Args),
    /// Write manual pages
    #[command(after_help = examples::MAN)]
    Man(commands::man::Args),
    /// Say which adapter is drawn with, or fail if there is none
    #[command(hide = true)]
    Adapter,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    if cli.quiet {
        commands::say::be_quiet();
    }
    let result = match &cli.command {
        Command::Build(args) => commands::build::run(args),
        Command::Fly(args) => commands::fly::run(args),
        Command::View(args) => commands::view::run(args),
        Command::Render(args) => commands::render::run(args),
        Command::Compare(args) => commands::compare::run(args),
        Command::Convert(args) => commands::convert::run(args),
        Command::Info(args) => commands::info::run(args),
        Command::Inspect(args) => commands::inspect::run(args),
        Command::Slice(args) => commands::slice::run(args),
        Command::Check(args) => commands::check::run(args),
        Command::Stats(args) => commands::stats::run(args),
        Command::Bench(args) => commands::bench::run(args),
        Command::Demo(args) => commands::demo::run(args),
        Command::New(args) => commands::new::run(args),
        Command::Completions(args) => commands::completions::run(args, Cli::command()),
        Command::Man(args) => commands::man::run(args, Cli::command()),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A command line as a shell takes it apart: words, and quotes around some.
    fn words(line: &str) -> Vec<String> {
        let line = line.split('>').next().unwrap_or_default();
        line.split('\'')
            .enumerate()
            .flat_map(|(k, part)| match k % 2 {
                0 => part.split_whitespace().map(String::from).collect(),
                _ => vec![part.to_string()],
            })
            .collect()
    }

    #[test]
    fn every_command_has_examples_and_all_are_understood() {
        let mut program = Cli::command();
        program.build();
        let helps = program
            .get_subcommands()
            .filter(|c| !c.is_hide_set() && c.get_name() != "help");
        let helps: Vec<(String, String)> = helps
            .map(|c| {
                let help = c.get_after_help().map(ToString::to_string);
                (c.get_name().to_string(), help.unwrap_or_default())
            })
            .collect();
        assert!(helps.len() > 12);
        for (name, help) in helps.into_iter().chain([(String::new(), EXAMPLES.to_string())]) {
            let lines = help.lines().map(str::trim);
            let lines: Vec<&str> = lines.filter(|l| l.starts_with("brickfell ")).collect();
            let own = lines
                .iter()
                .filter(|l| l.starts_with(&format!("brickfell {name}")));
            assert!(help.starts_with("Examples:\n") && own.count() > 0, "{name}");
            for line in lines {
                if let Err(e) = Cli::try_parse_from(words(line)) {
                    panic!("{line}\n{e}");
                }
            }
        }
    }
}
