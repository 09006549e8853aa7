//! GPU runtime of brickfell: pools, uploads, ray caster, feedback and frame loop, and the CPU reference.
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
//! | [`effort`] | what of a picture is drawn so that a frame keeps its time | render |
//! | [`present`], [`window`] | the last picture onto a window; its surface | render |
//! | `raster` | which pixels of a picture are drawn | render |
//! | `march` | the rules of a ray on the CPU, in f64 and f32 | any |
//! | [`mod@reference`] | the CPU reference: those rules in f64 over everything in the files | any, parallel inside |
//! | [`gpu`], [`picture`], [`settings`], [`error`] | device, pictures, settings, errors | any |
//! | `testing` | trees in memory for tests; only with the feature of that name | any |

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
