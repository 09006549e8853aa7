//! The files of a terrain, read together.

use std::path::PathBuf;
use std::sync::Arc;

use super::block_cache::RasterCache;
use super::error::InputError;
use super::heights::HeightOptions;
use super::layer::{Layer, highest_ground, load_layers};
use super::mesh::{Mesh, UpAxis};
use super::placements;
use super::texture_set::TextureSet;

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
    /// Reads meshes (OBJ), lists of placements and height maps; pictures, these and textures, as far as `cache` has room for them and else
    /// in parts when they are asked for.
    ///
    /// # Errors
    /// The first file that cannot be used.
    pub fn load(
        meshes: &[PathBuf],
        placements: &[PathBuf],
        heights: &[HeightInput],
        up: UpAxis,
        options: HeightOptions,
        cache: &Arc<RasterCache>,
    ) -> Result<Self, InputError> {
        let layers = load_layers(heights, options, cache)?;
        let mut textures = TextureSet::new(cache);
        let mut loaded = Vec::new();
        for path in meshes {
            loaded.push(Mesh::load(path, up, &mut textures)?);
        }
        for list in placements {
            for model in placements::read(list)? {
                let mesh = Mesh::load(&model.path, up, &mut textures)?;
                let first = loaded.len();
                for placement in &model.placements {
                    let pose = placement.pose(list, |x, y| highest_ground(&layers, x, y))?;
                    loaded.push(mesh.posed(&pose));
                }
                if let Some(first) = loaded.get_mut(first) {
                    first.warnings = mesh.warnings;
                }
            }
        }
        Ok(Self {
            layers,
            meshes: loaded,
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
