//! From material names to materials: libraries looked up, textures found and loaded in parallel, opacity maps combined.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::error::InputError;
use super::image_file::Raster;
use super::linear::linear_of;
use super::materials::{self, MtlMaterial};
use super::mesh::Material;
use super::texture::Texture;

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

/// The files of a material's colour and of its opacity.
type Maps = (Option<PathBuf>, Option<PathBuf>);

/// Loads the textures, each once, and makes one material of each name, in their order. Their files are added to `files`.
pub(crate) fn load_materials(
    used: &[Used],
    library: &Library,
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
    let textures: HashMap<Maps, Arc<Texture>> = wanted
        .into_par_iter()
        .map(|maps| Ok((maps.clone(), Arc::new(load_texture(&maps)?))))
        .collect::<Result<_, InputError>>()?;

    let material = |(used, maps): (&Used, Maps)| {
        let texture = textures.get(&maps).cloned();
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
    Ok(used.iter().zip(maps).map(material).collect())
}

/// One texture out of a colour picture and an opacity picture, either of which may be missing.
fn load_texture((color, alpha): &Maps) -> Result<Texture, InputError> {
    let mask = alpha.as_deref().map(Raster::load).transpose()?;
    let mut raster = match (color, &mask) {
        (Some(path), _) => Raster::load(path)?,
        (None, Some(mask)) => Raster {
            pixels: vec![[255; 4]; mask.pixels.len()],
            ..*mask
        },
        (None, None) => Raster {
            width: 1,
            height: 1,
            pixels: vec![[255; 4]],
        },
    };
    if let Some(mask) = mask {
        // A mask with an alpha channel keeps the opacity there, otherwise in its brightness.
        let own_alpha = mask.pixels.iter().any(|p| p[3] < 255);
        let width = raster.width;
        for (i, pixel) in raster.pixels.iter_mut().enumerate() {
            let (x, y) = (i as u64 % u64::from(width), i as u64 / u64::from(width));
            let column = x * u64::from(mask.width) / u64::from(width);
            let row = y * u64::from(mask.height) / u64::from(raster.height);
            let [r, g, b, a] = mask.pixel(column as u32, row as u32);
            let opacity = if own_alpha {
                u32::from(a)
            } else {
                (u32::from(r) + u32::from(g) + u32::from(b)) / 3
            };
            pixel[3] = ((u32::from(pixel[3]) * opacity + 127) / 255) as u8;
        }
    }
    Ok(Texture::new(raster))
}
