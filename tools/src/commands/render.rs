//! `brickfell render`: one settled picture.

use std::path::PathBuf;
use std::process::ExitCode;

use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::Renderer;
use clap::Args as ClapArgs;
use glam::DVec3;

use super::view_args::{ViewArgs, parse_point};
use super::{CommandError, open_gpu, open_terrain};
use crate::picture_file::over_sky;

/// Arguments of `brickfell render`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Folder of the terrain
    pub dir: PathBuf,
    /// Where the camera is, world metres
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub eye: DVec3,
    /// What it looks at, world metres
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub target: DVec3,
    /// The PNG to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Draw with the CPU reference instead of the GPU
    #[arg(long)]
    pub reference: bool,
    /// Picture, budgets, light
    #[command(flatten)]
    pub view: ViewArgs,
}

/// Runs the command; exit code 2 if something could not be read.
///
/// # Errors
/// If no picture can be drawn or written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let camera = args.view.camera(args.eye, args.target)?;
    let settings = args.view.settings();
    let (store, terrain) = open_terrain(&args.dir)?;
    let (picture, faults): (Picture, Vec<String>) = if args.reference {
        (
            Reference::new(store, &terrain.trees)?
                .render(&camera, &settings)?
                .0,
            terrain.faults,
        )
    } else {
        let mut renderer = Renderer::new(open_gpu()?, store, terrain, args.view.config())?;
        renderer.settle(&camera, &settings)?;
        (renderer.read_picture()?, renderer.faults().to_vec())
    };
    over_sky(&picture, &camera)
        .save(&args.out)
        .map_err(|e| CommandError::new(format!("{}: {e}", args.out.display()), "is the folder there?"))?;
    for fault in &faults {
        eprintln!("brickfell: {fault}");
    }
    Ok(ExitCode::from(if faults.is_empty() { 0 } else { 2 }))
}
