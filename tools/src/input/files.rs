//! The files of a terrain, read together.

use std::path::PathBuf;

use super::error::InputError;
use super::heights::{HeightOptions, HeightUnit};
use super::layer::Layer;
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
    /// Reads meshes (OBJ) and height maps. A `height_unit` overrides the files'.
    ///
    /// # Errors
    /// The first file that cannot be used.
    pub fn load(
        meshes: &[PathBuf],
        heights: &[HeightInput],
        up: UpAxis,
        height_unit: Option<HeightUnit>,
    ) -> Result<Self, InputError> {
        let options = HeightOptions {
            height_unit,
            ..HeightOptions::default()
        };
        let layers = heights
            .iter()
            .map(|h| Layer::load(&h.path, h.imagery.as_deref(), options));
        Ok(Self {
            layers: layers.collect::<Result<_, _>>()?,
            meshes: meshes
                .iter()
                .map(|path| Mesh::load(path, up))
                .collect::<Result<_, _>>()?,
        })
    }

    /// What was missing in the files but did not keep them from loading, one line each.
    pub fn warnings(&self) -> Vec<String> {
        self.meshes.iter().flat_map(|m| m.warnings.clone()).collect()
    }
}
