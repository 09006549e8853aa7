//! The program's commands: arguments, what they print, exit codes. The work itself is in the libraries.
//!
//! Each command is a module with its `Args` and a `run`. An error is one clear line and a hint; the exit code is 1 for
//! errors, 2 where something was drawn or shown but not all of it could be read.

pub mod bench;
pub mod build;
pub mod check;
pub mod compare;
pub mod completions;
pub mod convert;
pub(crate) mod database;
pub mod demo;
pub mod examples;
pub(crate) mod fault;
pub mod fly;
pub mod info;
pub mod input_args;
pub mod inspect;
pub mod man;
pub mod new;
pub mod render;
pub mod say;
pub mod slice;
pub mod stats;
pub mod view;
pub mod view_args;

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use brickfell_pager::{FolderStore, ProceduralConfig, ProceduralStore, Store};
use brickfell_runtime::Device;
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::terrain::Terrain;

use view_args::ViewArgs;

/// What the program prints when a command fails.
#[derive(Debug)]
pub struct CommandError {
    /// What is wrong and where, one line.
    pub message: String,
    /// What to do about it.
    pub hint: Option<&'static str>,
}

impl CommandError {
    /// An error with a hint.
    pub fn new(error: impl fmt::Display, hint: &'static str) -> Self {
        Self {
            message: error.to_string(),
            hint: Some(hint),
        }
    }
}

impl<E: std::error::Error> From<E> for CommandError {
    fn from(error: E) -> Self {
        Self {
            message: error.to_string(),
            hint: None,
        }
    }
}

impl fmt::Display for CommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// What a terrain begins with that is made from a seed instead of read from a folder.
const PROCEDURAL: &str = "procedural:";

/// Whether a terrain is made from a seed.
pub(crate) fn is_procedural(terrain: &Path) -> bool {
    terrain.to_str().is_some_and(|t| t.starts_with(PROCEDURAL))
}

/// Opens a terrain: a folder, or `procedural:SEED?extent=METRES&voxel=METRES`.
///
/// # Errors
/// If there is no readable `scene.xml` in the folder, or no such procedural terrain.
pub fn open_terrain(terrain: &Path) -> Result<(Arc<dyn Store>, Terrain), CommandError> {
    let hint = "give a folder that `brickfell build` made, or one with a hand-written scene.xml";
    let fail = |e: &dyn fmt::Display, hint| CommandError::new(format!("{}: {e}", terrain.display()), hint);
    let store: Arc<dyn Store> = match terrain.to_str().and_then(|t| t.strip_prefix(PROCEDURAL)) {
        Some(address) => {
            let hint = "for instance procedural:1?extent=10km&voxel=0.5";
            let config = ProceduralConfig::parse(address).map_err(|e| fail(&e, hint))?;
            Arc::new(ProceduralStore::new(config).map_err(|e| fail(&e, hint))?)
        }
        None => Arc::new(FolderStore::open(terrain).map_err(|e| fail(&e, hint))?),
    };
    let terrain = Terrain::open(&store).map_err(|e| CommandError::new(e, hint))?;
    Ok((store, terrain))
}

/// Opens the device.
///
/// # Errors
/// If there is no adapter.
pub fn open_gpu() -> Result<Arc<Gpu>, CommandError> {
    explained(Gpu::open())
}

fn explained(gpu: Result<Arc<Gpu>, RuntimeError>) -> Result<Arc<Gpu>, CommandError> {
    gpu.map_err(|e| match e {
        RuntimeError::NoAdapter => CommandError::new(
            e,
            "a software device is enough: `apt-get install mesa-vulkan-drivers` on Debian and Ubuntu",
        ),
        _ => e.into(),
    })
}

/// What to draw with: as asked for, else the GPU if there is one, else the CPU, which is faster than software that stands in for a GPU.
/// Says so in one line if that was not asked for.
///
/// # Errors
/// If there is no adapter and one is asked for, or it gives no device.
pub fn open_device(view: &ViewArgs) -> Result<Device, CommandError> {
    if view.cpu {
        return Ok(Device::Cpu);
    }
    let reason = match Gpu::open() {
        Ok(gpu) if gpu.is_software() && !view.gpu => format!("{} is software", gpu.info.name),
        Err(error @ RuntimeError::NoAdapter) if !view.gpu => error.to_string(),
        result => return Ok(explained(result)?.into()),
    };
    say::note(format_args!("{reason}; the CPU draws (--gpu: it does not)"));
    Ok(Device::Cpu)
}

/// Says so where block-compressed bricks are drawn as samples.
pub fn tell_of_blocks(renderer: &Renderer) {
    if renderer.decodes_blocks() {
        say::note(format_args!(
            "{} reads no block-compressed 3D textures; bricks are decoded to samples",
            renderer.device()
        ));
    }
}
