//! `brickfell render`: one settled picture.

use std::path::PathBuf;
use std::process::ExitCode;

use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::terrain::read_header;
use clap::Args as ClapArgs;
use glam::DVec3;

use super::input_args::InputArgs;
use super::say::spinner;
use super::view_args::{ViewArgs, parse_point};
use super::{CommandError, open_device, open_terrain, tell_of_blocks};
use crate::picture_file::over_sky;
use crate::truth::{Bottom, Truth};

/// Most rays per pixel.
const MAX_RAYS: i64 = 1 << 16;

/// Arguments of `brickfell render`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Folder of the terrain, or `procedural:SEED?extent=METRES&voxel=METRES` for one that is made as it is looked at
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
    /// Draw with the CPU reference, in double precision
    #[arg(long, conflicts_with_all = ["cpu", "gpu"])]
    pub reference: bool,
    /// Draw the input that the database was built from, which is named as for `build`: many rays a pixel, no voxels
    #[arg(long, conflicts_with_all = ["reference", "cpu", "gpu"])]
    pub truth: bool,
    /// Rays per pixel of --truth, rounded up to a square number
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=MAX_RAYS))]
    pub rays: u32,
    /// The input for --truth.
    #[command(flatten)]
    pub input: InputArgs,
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
    if args.truth == args.input.is_empty() {
        let message = if args.truth {
            "--truth draws the input, and none is named"
        } else {
            "inputs are drawn with --truth only"
        };
        return Err(CommandError::new(
            message,
            "render DIR --truth house.obj --heights ground.tif … names them as `build` does",
        ));
    }
    let (store, terrain) = open_terrain(&args.dir)?;
    let drawing = spinner("drawing");
    let (picture, faults): (Picture, Vec<String>) = if args.truth {
        let (mut boxes, mut faults) = (Vec::new(), terrain.faults);
        for name in &terrain.trees {
            match read_header(store.as_ref(), name) {
                Ok(header) => boxes.push(header.bounds()),
                Err(fault) => faults.push(fault.to_string()),
            }
        }
        let input = args.input.load()?;
        for warning in input.warnings() {
            eprintln!("warning: {warning}");
        }
        let truth = Truth::new(&input.meshes, &input.layers, &Bottom::Boxes(boxes))?;
        let rays_per_axis = f64::from(args.rays).sqrt().ceil() as u32;
        (truth.render(&camera, &settings, rays_per_axis, 0)?, faults)
    } else if args.reference {
        (
            Reference::open(store, &terrain.scene)?
                .render(&camera, &settings)?
                .0,
            terrain.faults,
        )
    } else {
        let mut renderer = Renderer::new(open_device(&args.view)?, store, terrain, args.view.config())?;
        tell_of_blocks(&renderer);
        renderer.settle(&camera, &settings)?;
        (renderer.read_picture()?, renderer.faults().to_vec())
    };
    drawing.finish_and_clear();
    over_sky(&picture, &camera)
        .save(&args.out)
        .map_err(|e| CommandError::new(format!("{}: {e}", args.out.display()), "is the folder there?"))?;
    for fault in &faults {
        eprintln!("brickfell: {fault}");
    }
    Ok(ExitCode::from(if faults.is_empty() { 0 } else { 2 }))
}
