//! `brickfell completions`: what a shell needs to complete commands and options.

use std::process::ExitCode;

use clap_complete::Shell;

use super::CommandError;
use super::database::print;

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The shell to write for
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Runs the command; `program` is the whole command line.
///
/// # Errors
/// If standard output cannot be written.
pub fn run(args: &Args, mut program: clap::Command) -> Result<ExitCode, CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "brickfell", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(ExitCode::SUCCESS)
}
