//! `brickfell man`: manual pages, one for the program and one for each command.

use std::path::PathBuf;
use std::process::ExitCode;

use super::CommandError;
use super::database::print;

/// Arguments of `man`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write the pages to, for instance ~/.local/share/man/man1; pages of before are replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the command; `program` is the whole command line.
///
/// # Errors
/// A folder that cannot be written to.
pub fn run(args: &Args, program: clap::Command) -> Result<ExitCode, CommandError> {
    std::fs::create_dir_all(&args.out)
        .and_then(|()| clap_mangen::generate_to(program, &args.out))
        .map_err(|e| CommandError::new(format!("{}: {e}", args.out.display()), "may you write there?"))?;
    let shown = args.out.display();
    print(&format!(
        "manual pages in {shown}\nnext: man {shown}/brickfell.1\n"
    ))?;
    Ok(ExitCode::SUCCESS)
}
