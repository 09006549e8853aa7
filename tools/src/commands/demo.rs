//! `brickfell demo`: writes a generated terrain as the files a user would bring, for `build` to read.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use super::CommandError;
use super::database::print;
use super::say::spinner;
use crate::input::demo::{DEFAULT_SIZE, DemoInput, write_demo};

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write the height map, the picture and the models to; files of an earlier demo are replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Width and depth of the terrain, 32 to 4096 m
    #[arg(long, value_name = "METRES", default_value_t = DEFAULT_SIZE, allow_negative_numbers = true)]
    pub size: f64,
    /// Another number gives another terrain
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Runs the command.
///
/// # Errors
/// A size that cannot be made, a folder or file that cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let working = spinner("making a terrain");
    let demo = write_demo(&args.out, args.seed, args.size)?;
    working.finish_and_clear();
    print(&format!(
        "{} m × {} m of terrain with {} trees in {}\nnext: {}\n",
        args.size,
        args.size,
        demo.trees,
        args.out.display(),
        build_command(&demo),
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// The command that builds a database of the demo.
fn build_command(demo: &DemoInput) -> String {
    let path = |p: &Path| p.display().to_string();
    let meshes: Vec<String> = demo.meshes.iter().map(|p| path(p)).collect();
    format!(
        "brickfell build {} --heights {} --imagery {} --voxel 0.25 --out DIR",
        meshes.join(" "),
        path(&demo.heights),
        path(&demo.imagery)
    )
}
