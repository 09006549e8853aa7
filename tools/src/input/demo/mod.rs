//! A demo terrain out of a seed, written as the files a user would bring: a 16-bit height map and an aerial picture
//! with world files, OBJ models of trees and houses with their materials and textures.
//!
//! The same seed and size give the same files. Local metres, the lower-left corner of the ground at (0, 0), Z up.

mod buildings;
mod model;
mod paint;
mod terrain;
mod textures;
mod trees;

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec2;
use image::{ImageBuffer, Luma};
use rayon::prelude::*;

use super::error::InputError;
use super::files::HeightInput;
use super::mesh::UpAxis;
use terrain::Terrain;

/// Side of the demo terrain as flown by default, metres.
pub const DEFAULT_SIZE: f64 = 256.0;
/// Distance of height samples, metres.
const HEIGHT_STEP: f64 = 0.5;
/// Pixel size of the picture, metres.
const IMAGE_STEP: f64 = 0.25;
/// Height of one code of the height map, metres, and of code 0.
const SCALE: f64 = 0.002;
const OFFSET: f64 = -20.0;
/// Sides that are made: smaller has no room for the landmarks, larger no memory for the picture.
const SIZES: std::ops::RangeInclusive<f64> = 32.0..=4096.0;

/// The files of a demo terrain.
#[derive(Debug, Clone, PartialEq)]
pub struct DemoInput {
    /// Height map, 16-bit PNG with world file and GDAL side file.
    pub heights: PathBuf,
    /// Aerial picture, PNG with world file.
    pub imagery: PathBuf,
    /// OBJ models that stand on the ground.
    pub meshes: Vec<PathBuf>,
    /// Which axis points up in the models.
    pub up: UpAxis,
    /// How many trees were planted.
    pub trees: usize,
}

impl DemoInput {
    /// The ground as an input of the builder.
    pub fn layer(&self) -> HeightInput {
        HeightInput {
            path: self.heights.clone(),
            imagery: Some(self.imagery.clone()),
        }
    }
}

/// Writes a demo terrain of `size_m × size_m` metres into `dir`, which is made if it is not there. Files of an earlier
/// demo are replaced.
///
/// # Errors
/// A folder or file that cannot be written, a size outside 32 to 4096 m.
pub fn write_demo(dir: &Path, seed: u64, size_m: f64) -> Result<DemoInput, InputError> {
    if !SIZES.contains(&size_m) {
        return Err(InputError::unsupported(
            dir,
            format!("a demo terrain is 32 to 4096 m wide, not {size_m}"),
        ));
    }
    fs::create_dir_all(dir).map_err(|e| InputError::io(dir, e))?;
    let terrain = Terrain::new(seed, size_m);
    let heights = write_heights(dir, &terrain)?;
    let imagery = dir.join("imagery.png");
    let pixels = (size_m / IMAGE_STEP).round() as u32;
    save(&imagery, |path| paint::imagery(&terrain, pixels).save(path))?;
    write_world_file(&dir.join("imagery.pgw"), size_m, pixels)?;

    let (forest, trees) = trees::plant(&terrain);
    write(&dir.join("trees.obj"), &forest.text("trees.mtl"))?;
    write(&dir.join("trees.mtl"), trees::LIBRARY)?;
    save(&dir.join("leaf.png"), |path| textures::leaves(seed).save(path))?;
    save(&dir.join("bark.png"), |path| textures::bark(seed).save(path))?;
    let mut meshes = vec![dir.join("trees.obj")];
    if !terrain.sites.is_empty() {
        write(
            &dir.join("buildings.obj"),
            &buildings::build(&terrain).text("buildings.mtl"),
        )?;
        write(&dir.join("buildings.mtl"), buildings::LIBRARY)?;
        save(&dir.join("wall.png"), |path| textures::wall(seed).save(path))?;
        save(&dir.join("roof.png"), |path| textures::roof(seed).save(path))?;
        meshes.push(dir.join("buildings.obj"));
    }
    Ok(DemoInput {
        heights,
        imagery,
        meshes,
        up: UpAxis::Z,
        trees,
    })
}

/// Height of the ground of a demo terrain, metres.
pub(crate) fn demo_height(seed: u64, size_m: f64, at: DVec2) -> f64 {
    Terrain::new(seed, size_m).height(at)
}

fn write_heights(dir: &Path, terrain: &Terrain) -> Result<PathBuf, InputError> {
    let path = dir.join("heights.png");
    let n = (terrain.size / HEIGHT_STEP).round() as u32;
    let step = terrain.size / f64::from(n);
    let code = |i: u32| {
        let (column, row) = (f64::from(i % n), f64::from(i / n));
        let at = DVec2::new((column + 0.5) * step, terrain.size - (row + 0.5) * step);
        ((terrain.height(at) - OFFSET) / SCALE)
            .round()
            .clamp(0.0, 65535.0) as u16
    };
    let codes: Vec<u16> = (0..n * n).into_par_iter().map(code).collect();
    let image: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_raw(n, n, codes)
        .ok_or_else(|| InputError::unsupported(&path, "the height map does not fit its size"))?;
    save(&path, |path| image.save(path))?;
    write_world_file(&dir.join("heights.pgw"), terrain.size, n)?;
    let side_file = format!(
        "<PAMDataset>\n  <PAMRasterBand band=\"1\">\n    <Offset>{OFFSET}</Offset>\n    <Scale>{SCALE}</Scale>\n    \
         <UnitType>m</UnitType>\n  </PAMRasterBand>\n</PAMDataset>\n"
    );
    write(&dir.join("heights.png.aux.xml"), &side_file)?;
    Ok(path)
}

/// World file of a square picture with its lower-left corner at (0, 0).
fn write_world_file(path: &Path, size: f64, pixels: u32) -> Result<(), InputError> {
    let step = size / f64::from(pixels);
    write(
        path,
        &format!("{step}\n0\n0\n{}\n{}\n{}\n", -step, 0.5 * step, size - 0.5 * step),
    )
}

fn write(path: &Path, text: &str) -> Result<(), InputError> {
    fs::write(path, text).map_err(|e| InputError::io(path, e))
}

fn save(path: &Path, save: impl Fn(&Path) -> image::ImageResult<()>) -> Result<(), InputError> {
    save(path).map_err(|e| InputError::io(path, std::io::Error::other(e)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::layer::load_layer;
    use crate::input::test_data::textures;
    use crate::input::{HeightOptions, Mesh};

    #[test]
    fn the_demo_loads_as_a_users_files_would() {
        let dir = tempfile::tempdir().unwrap();
        let demo = write_demo(dir.path(), 1, DEFAULT_SIZE).unwrap();
        let layer = load_layer(&demo.heights, Some(&demo.imagery), HeightOptions::default()).unwrap();
        let map = &layer.map;
        assert_eq!(map.bounds(), (DVec2::ZERO, DVec2::splat(DEFAULT_SIZE)));
        assert!(layer.imagery.is_some());
        let (low, high) = map.min_max();
        assert!((55.0..90.0).contains(&(high - low)), "relief {low} to {high}");

        // With 0.25 m voxels and trees of 64 m one column has to be stacked, wherever the lattice begins in height.
        let relief = (0..16).map(|cell| {
            let corner = DVec2::new(f64::from(cell % 4), f64::from(cell / 4)) * 64.0;
            let heights = (0..128 * 128).filter_map(|i| {
                let height = map.height_at(
                    corner.x + f64::from(i % 128) * 0.5 + 0.25,
                    corner.y + f64::from(i / 128) * 0.5 + 0.25,
                );
                height.unwrap()
            });
            let (lo, hi) = heights.fold((f64::MAX, f64::MIN), |(lo, hi), h| (lo.min(h), hi.max(h)));
            hi - lo
        });
        assert!(relief.fold(0.0, f64::max) > 50.0);

        assert!(demo.trees >= 300, "{} trees", demo.trees);
        for path in &demo.meshes {
            let mesh = Mesh::load(path, demo.up, &mut textures()).unwrap();
            assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
            let (min, max) = mesh.bounds();
            assert!(min.min_element() > 0.0 && max.x < DEFAULT_SIZE && max.y < DEFAULT_SIZE);
            let leaves = mesh.materials.iter().any(|m| m.cutout);
            assert_eq!(leaves, path.ends_with("trees.obj"));
            let repeats = mesh
                .triangles
                .iter()
                .any(|t| t.uv.iter().any(|uv| uv.max_element() > 1.5));
            assert!(repeats, "{}", path.display());
        }
    }

    #[test]
    fn houses_stand_in_the_ground() {
        let terrain = Terrain::new(1, DEFAULT_SIZE);
        assert!(terrain.sites.len() >= 12, "{} sites", terrain.sites.len());
        assert!(terrain.sites.iter().any(|s| s.church));
        for site in &terrain.sites {
            let ground = terrain.ground(site.at);
            assert!((ground.height - site.level).abs() < 0.3 && ground.depth < 0.0 && ground.road > 6.0);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_files() {
        let dir = tempfile::tempdir().unwrap();
        let mut files = [Vec::new(), Vec::new(), Vec::new()];
        for (bytes, seed) in files.iter_mut().zip([7, 7, 8]) {
            let demo = write_demo(&dir.path().join("demo"), seed, 64.0).unwrap();
            for path in [&demo.heights, &demo.imagery, &demo.meshes[0]] {
                bytes.extend(fs::read(path).unwrap());
            }
        }
        assert!(files[0] == files[1] && files[0] != files[2]);
    }

    #[test]
    fn sizes_that_cannot_be_made_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        for size in [0.0, -1.0, f64::NAN, 1e9] {
            assert!(write_demo(&dir.path().join("none"), 1, size).is_err());
        }
        assert!(!dir.path().join("none").exists());
    }
}
