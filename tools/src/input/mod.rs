//! The input side of the builder: what users bring, decoded, checked and placed in the world.
//!
//! - [`heights`] and [`imagery`]: height maps and the pictures laid over them, placed by [`georef`], of any size, read
//!   through a [`RasterCache`];
//! - [`mesh`]: OBJ models with materials and [`texture`]s, these in the same cache, and [`placements`] of them;
//! - [`Inputs`]: all of them together; [`Layer`] and [`Look`] say what they show at a place;
//! - [`demo`]: a terrain made from a seed, written as the files a user would bring.
//!
//! World space is metres, f64, X east, Y north, Z up. Colours that leave this module are in linear light.
//! Readers check every declared size before they allocate and every number before they keep it; a fault is one
//! [`InputError`] naming file and place. Everything loaded is immutable and can be read from many threads.

mod ascii_grid;
mod block_cache;
mod cells;
mod crs;
pub mod demo;
mod error;
mod files;
mod geodesy;
mod geokeys;
pub mod georef;
mod height_samples;
pub mod heights;
mod hgt;
pub mod image_file;
pub mod imagery;
mod layer;
mod linear;
mod look;
mod mapping;
mod materials;
pub mod mesh;
mod obj;
mod pam;
mod pixels;
mod place;
pub mod placements;
mod png_rows;
mod ranges;
#[cfg(test)]
mod raster_tests;
mod scratch;
mod surfaces;
mod survey;
#[cfg(test)]
mod test_data;
pub mod texture;
mod texture_set;
mod tiff_file;
mod usgs_dem;
mod whole_file;
mod wkt;
mod world_file;

pub use block_cache::RasterCache;
pub use error::InputError;
pub use files::{HeightInput, Inputs};
pub use georef::{GeoTransform, Georef};
pub use heights::{HeightMap, HeightOptions, HeightUnit, TerrainRgb};
pub use image_file::Raster;
pub use imagery::{Imagery, ramp_color};
pub use layer::{Layer, load_layers};
pub(crate) use layer::{LayerView, highest_ground};
pub use look::{Corners, Look};
pub(crate) use mapping::Columns;
pub use mesh::{Face, Material, Mesh, Placing, Streamed, Triangle, UpAxis};
pub use texture::{Sampler, Texture};
pub use texture_set::TextureSet;
