//! From material names to materials: libraries looked up, textures found.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::InputError;
use super::linear::linear_of;
use super::materials::{self, MtlMaterial};
use super::mesh::Material;
use super::texture::Texture;
use super::texture_set::{Maps, TextureSet};

/// A material name of the mesh and what the libraries say about it.
pub(crate) struct Used {
    name: String,
    pub(crate) found: Option<MtlMaterial>,
}

/// All material libraries of a mesh.
pub(crate) struct Library {
    /// Materials by name and the folder of the library that has them.
    materials: HashMap<String, (MtlMaterial, PathBuf)>,
    /// The libraries' own files.
    pub(crate) files: Vec<PathBuf>,
}

/// Reads the libraries that a mesh in `folder` names; a missing one is a warning.
pub(crate) fn read_libraries(
    path: &Path,
    folder: &Path,
    names: &[String],
    warnings: &mut Vec<String>,
) -> Result<Library, InputError> {
    let mut library = Library {
        materials: HashMap::new(),
        files: Vec::new(),
    };
    for written in names {
        let whole = folder.join(written.replace('\\', "/"));
        // One statement may name several libraries, and one name may hold spaces.
        let files = if whole.is_file() {
            vec![whole]
        } else {
            written
                .split_whitespace()
                .map(|name| folder.join(name.replace('\\', "/")))
                .collect()
        };
        for file in files {
            if !file.is_file() {
                warnings.push(format!(
                    "{}: material library {} is missing",
                    path.display(),
                    file.display()
                ));
                continue;
            }
            library.files.push(file.clone());
            let home = file.parent().unwrap_or(folder).to_path_buf();
            for material in materials::read(&file)? {
                library
                    .materials
                    .entry(material.name.clone())
                    .or_insert((material, home.clone()));
            }
        }
    }
    Ok(library)
}

/// Looks up the names that triangles use, in their order.
pub(crate) fn resolve(
    path: &Path,
    names: &[String],
    in_use: &[bool],
    library: &Library,
    warnings: &mut Vec<String>,
) -> Vec<Used> {
    let resolve = |(name, in_use): (&String, bool)| {
        let found = if in_use {
            library.materials.get(name).map(|(material, _)| material.clone())
        } else {
            None
        };
        if in_use && found.is_none() && !name.is_empty() {
            warnings.push(format!(
                "{}: material '{name}' is not defined; it is drawn grey",
                path.display()
            ));
        }
        Used {
            name: name.clone(),
            found,
        }
    };
    names.iter().zip(in_use.iter().copied()).map(resolve).collect()
}

/// Loads the textures and makes one material of each name, in their order. Their files are added to `files`.
pub(crate) fn load_materials(
    used: &[Used],
    library: &Library,
    textures: &mut TextureSet,
    warnings: &mut Vec<String>,
    files: &mut Vec<PathBuf>,
) -> Result<Vec<Material>, InputError> {
    let mut maps: Vec<Maps> = Vec::with_capacity(used.len());
    for material in used {
        let Some((mtl, folder)) = library
            .materials
            .get(&material.name)
            .filter(|_| material.found.is_some())
        else {
            maps.push((None, None));
            continue;
        };
        let mut find = |map: &Option<materials::MapRef>| {
            let map = map.as_ref()?;
            let found = map.find(folder);
            if found.is_none() {
                let missing = folder.join(map.file.replace('\\', "/"));
                warnings.push(format!(
                    "material '{}': texture {} is missing",
                    mtl.name,
                    missing.display()
                ));
            }
            found
        };
        let color = find(&mtl.color_map);
        // Many files name the same picture for colour and opacity: then its alpha is already there.
        let alpha = find(&mtl.alpha_map).filter(|path| Some(path) != color.as_ref());
        maps.push((color, alpha));
    }
    let mut wanted: Vec<Maps> = maps
        .iter()
        .filter(|m| m.0.is_some() || m.1.is_some())
        .cloned()
        .collect();
    wanted.sort();
    wanted.dedup();
    files.extend(
        wanted
            .iter()
            .flat_map(|(color, alpha)| [color, alpha])
            .flatten()
            .cloned(),
    );
    let material = |(used, texture): (&Used, Option<Arc<Texture>>)| {
        let color = used
            .found
            .as_ref()
            .map_or([linear_of(0.8), linear_of(0.8), linear_of(0.8), 1.0], |m| {
                m.color()
            });
        let cutout = color[3] < 1.0 || texture.as_ref().is_some_and(|t| t.has_alpha());
        Material {
            name: used.name.clone(),
            color,
            texture,
            cutout,
        }
    };
    Ok(used.iter().zip(textures.load(&maps)?).map(material).collect())
}
