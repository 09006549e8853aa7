//! The files of a terrain, read together.

use std::path::PathBuf;
use std::sync::Arc;

use super::block_cache::RasterCache;
use super::error::InputError;
use super::heights::HeightOptions;
use super::layer::{Layer, load_layers};
use super::mesh::{Mesh, UpAxis};

/// A height map, with the picture that lies over it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeightInput {
    /// The height map.
    pub path: PathBuf,
    /// The picture; without one, ground is coloured by height and slope.
    pub imagery: Option<PathBuf>,
}

/// Everything that a terrain is made from.
#[derive(Debug)]
pub struct Inputs {
    /// Height maps with their pictures.
    pub layers: Vec<Layer>,
    /// Meshes.
    pub meshes: Vec<Mesh>,
}

impl Inputs {
    /// Reads meshes (OBJ) and height maps, these as far as `cache` has room for them and else in parts when they are
    /// asked for.
    ///
    /// # Errors
    /// The first file that cannot be used.
    pub fn load(
        meshes: &[PathBuf],
        heights: &[HeightInput],
        up: UpAxis,
        options: HeightOptions,
        cache: &Arc<RasterCache>,
    ) -> Result<Self, InputError> {
        Ok(Self {
            layers: load_layers(heights, options, cache)?,
            meshes: meshes
                .iter()
                .map(|path| Mesh::load(path, up))
                .collect::<Result<_, _>>()?,
        })
    }

    /// What was missing in the files but did not keep them from loading, one line each.
    pub fn warnings(&self) -> Vec<String> {
        let notes = self.layers.iter().flat_map(|l| l.map.notes.clone());
        notes
            .chain(self.meshes.iter().flat_map(|m| m.warnings.clone()))
            .collect()
    }
}
