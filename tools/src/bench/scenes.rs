//! Built-in scenes of the bench: generated as a user's input would be, and built by the builder.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use glam::DVec2;
use image::{ImageBuffer, Luma, Rgb};

use crate::build::{BuildArgs, HeightInput, Silent, build};
use crate::commands::CommandError;
use crate::input::demo::{DEFAULT_SIZE, DemoInput, write_demo};
use crate::noise::fractal;

/// Side of the hill terrain, metres: one tree of 1024 voxels of 0.1 m.
pub(super) const HILLS_SIZE: f64 = 102.4;
/// Lowest to highest point of the hill terrain, metres.
const RELIEF: f64 = 30.0;
const SEED: u64 = 7;
const DEMO_SEED: u64 = 1;

/// Height of the hill terrain above its lowest point, metres.
pub(super) fn hill_height(p: DVec2) -> f64 {
    // Fractal noise lies within -1..1; a smooth wave below it makes use of the whole relief.
    let wave = 0.5 + 0.5 * (p.x * 0.061 + 0.4).sin() * (p.y * 0.049 + 1.1).cos();
    let rough = 0.5 + 0.5 * fractal(SEED, p / 19.0, 6);
    RELIEF * (0.72 * wave + 0.28 * rough).clamp(0.0, 1.0)
}

pub(super) fn hill_color(p: DVec2) -> [u8; 3] {
    let patch = 0.5 + 0.5 * fractal(SEED + 1, p / 6.0, 4);
    let grain = 0.5 + 0.5 * fractal(SEED + 2, p / 0.9, 4);
    let mix = |a: f64, b: f64| ((a + (b - a) * patch) * (0.75 + 0.5 * grain)).clamp(0.0, 255.0) as u8;
    [mix(70.0, 150.0), mix(100.0, 130.0), mix(50.0, 90.0)]
}

/// Writes the hill terrain's height map and picture, `pixels` on a side.
fn write_hills(folder: &Path, pixels: u32) -> Result<HeightInput, CommandError> {
    let input = HeightInput {
        path: folder.join("heights.png"),
        imagery: Some(folder.join("imagery.png")),
    };
    // Written last: what it lies beside is whole, and older than what was built from it.
    let side_path = folder.join("heights.png.aux.xml");
    if side_path.exists() {
        return Ok(input);
    }
    fs::create_dir_all(folder)?;
    let step = HILLS_SIZE / f64::from(pixels);
    let at = |x: u32, y: u32| {
        DVec2::new(
            (f64::from(x) + 0.5) * step,
            HILLS_SIZE - (f64::from(y) + 0.5) * step,
        )
    };
    let scale = RELIEF / 65_535.0;
    let heights: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_fn(pixels, pixels, |x, y| {
        Luma([(hill_height(at(x, y)) / scale).round() as u16])
    });
    let colors: ImageBuffer<Rgb<u8>, _> =
        ImageBuffer::from_fn(pixels, pixels, |x, y| Rgb(hill_color(at(x, y))));
    let world = format!(
        "{step}\n0\n0\n-{step}\n{}\n{}\n",
        0.5 * step,
        HILLS_SIZE - 0.5 * step
    );
    heights.save(&input.path).map_err(io::Error::other)?;
    colors
        .save(folder.join("imagery.png"))
        .map_err(io::Error::other)?;
    fs::write(folder.join("heights.pgw"), &world)?;
    fs::write(folder.join("imagery.pgw"), &world)?;
    let side_file = format!(
        "<PAMDataset><PAMRasterBand band=\"1\"><Offset>0</Offset><Scale>{scale}</Scale></PAMRasterBand></PAMDataset>\n"
    );
    fs::write(side_path, side_file)?;
    Ok(input)
}

/// The files of the demo terrain, as `make fly` has them.
pub(super) fn demo_input(folder: &Path) -> Result<DemoInput, CommandError> {
    Ok(write_demo(&folder.join("demo-input"), DEMO_SEED, DEFAULT_SIZE)?)
}

/// Builds a database of the demo's files as `make fly` does, but for a change, or finds it built.
pub(super) fn build_demo(
    input: &DemoInput,
    out: &Path,
    change: impl Fn(&mut BuildArgs),
) -> Result<(), CommandError> {
    let mut args = BuildArgs::new(out);
    args.heights = vec![input.layer()];
    args.inputs = input.meshes.clone();
    args.up = input.up;
    args.voxel = Some(0.25);
    args.tree_voxels = 256;
    args.force = true;
    change(&mut args);
    build(&args, &Silent)?;
    Ok(())
}

/// The hill terrain's height map and picture, written if they are not there.
pub(super) fn hills_input(folder: &Path) -> Result<HeightInput, CommandError> {
    write_hills(&folder.join("hills-input"), 1024)
}

/// Builds the hill terrain of `voxels` per axis, in trees of `tree_voxels`, or finds it built.
pub(super) fn hills(folder: &Path, voxels: u32, tree_voxels: u32) -> Result<PathBuf, CommandError> {
    let heights = hills_input(folder)?;
    let out = folder.join(format!("hills-{voxels}-{tree_voxels}"));
    let mut args = BuildArgs::new(&out);
    args.heights = vec![heights];
    args.voxel = Some(HILLS_SIZE / f64::from(voxels));
    args.tree_voxels = tree_voxels;
    // A scene of an earlier version of this program is built anew.
    args.force = true;
    build(&args, &Silent)?;
    Ok(out)
}
