//! `brickfell view`: a window.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args as ClapArgs;

use super::CommandError;
use super::fly::parse_ms;
use super::view_args::{parse_bytes, parse_size, parse_sun};

/// Arguments of `brickfell view`. What is not given is as the user left it.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Folder of the terrain, or `procedural:SEED?extent=METRES&voxel=METRES` for one that is made as it is flown over
    pub dir: PathBuf,
    /// Camera path to begin at, and to fly with P
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Folder for screenshots and recorded camera paths
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub shots: PathBuf,
    /// Size of the window in pixels
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "DEG", default_value_t = 60.0)]
    pub fov: f64,
    /// Milliseconds that a frame may take while the camera moves
    #[arg(long, value_name = "MS", value_parser = parse_ms)]
    pub target_ms: Option<f64>,
    /// RAM that the pager may hold (bytes, or with K, M, G, KiB, MiB, GiB)
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes)]
    pub budget_ram: Option<u64>,
    /// Device memory for the pools, RAM if the CPU draws
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes)]
    pub budget_gpu: Option<u64>,
    /// log2 offset on the pixel's footprint before a level is chosen; negative is finer
    #[arg(long, allow_negative_numbers = true)]
    pub bias: Option<f64>,
    /// Sun as azimuth (clockwise from north) and elevation, degrees
    #[arg(long, value_name = "AZ,EL", value_parser = parse_sun, allow_hyphen_values = true)]
    pub sun: Option<(f64, f64)>,
    /// Surfaces hide the sun from each other
    #[arg(long)]
    pub shadows: bool,
    /// Surfaces hide the sky, where the ambient light comes from, from each other
    #[arg(long)]
    pub occlusion: bool,
    /// Draw with the CPU's cores, as happens by itself where there is no GPU
    #[arg(long)]
    pub cpu: bool,
    /// Draw with the GPU, or with what stands in for one, though that be slower than the CPU's cores
    #[arg(long, conflicts_with = "cpu")]
    pub gpu: bool,
}

/// Runs the command.
///
/// # Errors
/// If there is no display, no device or no terrain.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    crate::view::run(args)?;
    Ok(ExitCode::SUCCESS)
}
