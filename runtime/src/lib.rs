//! GPU runtime of brickfell: pools, uploads, ray caster, feedback and frame loop, and the CPU reference.
//!
//! A [`Terrain`](terrain::Terrain) is opened through a store; a [`Renderer`](renderer::Renderer) draws it, each frame with what has come by
//! then:
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use brickfell_culler::Camera;
//! use brickfell_pager::{FolderStore, Store};
//! use brickfell_runtime::gpu::Gpu;
//! use brickfell_runtime::renderer::{Renderer, RendererConfig};
//! use brickfell_runtime::settings::RenderSettings;
//! use brickfell_runtime::terrain::Terrain;
//! use glam::dvec3;
//!
//! let store: Arc<dyn Store> = Arc::new(FolderStore::open("db")?);
//! let terrain = Terrain::open(&store)?;
//! let mut renderer = Renderer::new(Gpu::open()?, store, terrain, RendererConfig::default())?;
//! let camera = Camera::look_at(dvec3(0.0, -200.0, 150.0), dvec3(100.0, 100.0, 0.0), 60.0, 1280, 720)?;
//!
//! // In real time: a frame waits for nothing, and `renderer.output()` is its texture.
//! let report = renderer.frame(&camera, &RenderSettings::default())?;
//! println!("{} trees in {:.1} ms", report.trees_active, report.cpu_ms);
//!
//! // For a still: all that the picture asks for.
//! renderer.settle(&camera, &RenderSettings::default())?;
//! let picture = renderer.read_picture()?;
//! assert_eq!(picture.pixels.len(), 1280 * 720);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # In an application of your own
//!
//! - [`Gpu::from_parts`](gpu::Gpu::from_parts) takes the application's device and queue, opened with [`Gpu::features`](gpu::Gpu::features) and
//!   [`Gpu::limits`](gpu::Gpu::limits). `Device::Cpu` in its place needs no device at all.
//! - [`Renderer::output`](renderer::Renderer::output) is the picture: premultiplied linear light, to be laid over whatever was drawn.
//! - [`Renderer::set_depths`](renderer::Renderer::set_depths) lets polygons hide voxels and be hidden by them (module [`depth`]).
//! - A frame is submitted to the queue within the call, so what is submitted before lies under it and what comes after over it.
//!
//! The example `embed` (`examples/runtime`) does all of that.
//!
//! # Modules
//!
//! | module | what | thread |
//! |---|---|---|
//! | [`terrain`] | a scene opened through a store | any |
//! | [`renderer`] | the frame loop | render |
//! | [`node_lists`] | node list processors: requests to chains of nodes | their own |
//! | [`texture_pool`] | texture pool manager: which tiles and bricks are in the pools | render |
//! | [`memory`] | the pools on the device, uploads | render |
//! | [`caster`] | ray caster, compaction, ring of read-backs | render |
//! | `backend` | what the renderer draws with: the four above, or the CPU | render |
//! | `cpu` | the CPU caster: pools in RAM, rays on all cores | render, parallel inside |
//! | [`bias`] | footprint bias that keeps the working set in the pool, or a frame in its time | render |
//! | [`depth`] | depths that rays and polygons exchange | any |
//! | [`effort`] | what of a picture is drawn so that a frame keeps its time | render |
//! | [`present`], [`window`] | the last picture onto a window; its surface | render |
//! | `raster` | which pixels of a picture are drawn | render |
//! | `march` | the rules of a ray on the CPU, in f64 and f32 | any |
//! | [`mod@reference`] | the CPU reference: those rules in f64 over everything in the files | any, parallel inside |
//! | [`gpu`], [`picture`], [`settings`], [`error`] | device, pictures, settings, errors | any |
//! | `testing` | trees in memory for tests; only with the feature of that name | any |
//!
//! # Invariants, threads, errors
//!
//! - One thread owns a renderer. [`Renderer::frame`](renderer::Renderer::frame) never waits for a disk or the device; loaders and node list
//!   processors have threads of their own. Renderers may share a device.
//! - What a slot of a pool holds and the words that point to it change in the submission that casts next: a picture never shows the one
//!   without the other. What is not there yet is shown by coarser levels, and left out only before a tree's root is there.
//! - A settled picture does not depend on the order in which things came.
//! - [`RuntimeError`](error::RuntimeError) is for what ends a frame or more: a device that fails, a size or settings that no picture can be
//!   made of. Files that cannot be read do not; they are lines in [`Renderer::faults`](renderer::Renderer::faults).
//!
//! [docs/architecture.md](https://github.com/brickfell/brickfell/blob/main/docs/architecture.md) has a frame from beginning to end,
//! [docs/raycasting.md](https://github.com/brickfell/brickfell/blob/main/docs/raycasting.md) the rules of a ray, and
//! [docs/library.md](https://github.com/brickfell/brickfell/blob/main/docs/library.md) walks through the examples.

mod backend;
pub mod bias;
pub mod caster;
mod cpu;
pub mod depth;
pub mod effort;
pub mod error;
pub mod gpu;
mod march;
pub mod memory;
pub mod node_lists;
pub mod picture;
pub mod present;
mod raster;
mod record;
pub mod reference;
pub mod renderer;
pub mod settings;
pub mod terrain;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod texture_pool;
pub mod window;

pub use backend::Device;
