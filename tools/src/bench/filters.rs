//! Suite `filters`: what the builder's filters make of coarse levels, against the truth, and what they take.
//!
//! Every scene is built with every filter. The CPU reference draws it at its default setting from so far away that a pixel is
//! 1, 2, 4 and 16 finest voxels wide; the truth draws the input with 64 rays a pixel and more. Pictures end where the scene
//! does, so they have fewer pixels from farther away, and errors are over all views of a distance.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::Camera;
use brickfell_formats::bricks::{HEADER_BYTES, brick_file_name, decode_header};
use brickfell_formats::octree_binary;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use clap::ValueEnum;
use glam::DVec3;
use serde_json::json;

use super::filter_scenes::{FilterScene, scenes};
use super::{Row, Settings, row};
use crate::build::{BuildArgs, Filter, Silent, build};
use crate::commands::CommandError;
use crate::input::InputError;
use crate::metrics::{compare, psnr};
use crate::picture_file::linear_over_sky;
use crate::truth::{Bottom, Truth};

/// Widths of a pixel in finest voxels.
const FACTORS: [u32; 4] = [1, 2, 4, 16];
/// Most pixels of a picture per axis.
const MOST_PIXELS: f64 = 240.0;
/// Distance of the eye in extents of the scene: far enough that pixels are about as wide in front as behind.
const DISTANCE: f64 = 8.0;

/// A database and what it takes.
pub(super) struct Built {
    pub(super) folder: PathBuf,
    reference: Reference,
    pub(super) boxes: Vec<[DVec3; 2]>,
    seconds: f64,
    bytes: u64,
    bricks: u64,
    /// Bytes of all its bricks in slots of the brick pool.
    pool_bytes: u64,
}

/// Builds a scene with a filter, or finds it built.
pub(super) fn build_scene(folder: &Path, scene: &FilterScene, filter: Filter) -> Result<Built, CommandError> {
    let name = scene.name.replace(' ', "-");
    let mut args = BuildArgs::new(folder.join(format!("filters-{name}-{}", filter.name())));
    args.inputs = scene.meshes.clone();
    args.heights = scene.heights.clone();
    args.voxel = Some(scene.voxel);
    args.tree_voxels = scene.tree_voxels;
    args.filter = filter;
    args.force = true;
    let start = Instant::now();
    build(&args, &Silent)?;
    let seconds = start.elapsed().as_secs_f64();
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(&args.out)?);
    let terrain = Terrain::open(&store)?;
    let (mut bytes, mut bricks, mut boxes) = (0, 0, Vec::new());
    for name in &terrain.trees {
        let len = store.len(name)?;
        let tree = octree_binary::decode(&store.read(name, 0, len as usize)?)?;
        boxes.push(tree.header.bounds());
        bytes += len;
        for level in (0..=tree.header.depth).filter(|l| tree.brick_count(*l) > 0) {
            let file = brick_file_name(name, level);
            let len = store.len(&file)?;
            bricks += u64::from(decode_header(&store.read(&file, 0, HEADER_BYTES)?, len)?.bricks);
            bytes += len;
        }
    }
    let sample_bytes = terrain.layers.sample_bytes() as u64;
    Ok(Built {
        folder: args.out,
        reference: Reference::open(store, &terrain.scene)?,
        boxes,
        seconds,
        bytes,
        bricks,
        pool_bytes: bricks * terrain.layout.samples() as u64 * sample_bytes,
    })
}

/// Cameras of a scene whose pixels are `factor` finest voxels wide at its middle.
fn cameras(scene: &FilterScene, factor: u32) -> Result<Vec<Camera>, CommandError> {
    let pixel = scene.voxel * f64::from(factor);
    let pixels = (1.2 * scene.extent / pixel).ceil().min(MOST_PIXELS);
    let distance = DISTANCE * scene.extent;
    let fov = 2.0 * (0.5 * pixels * pixel / distance).atan().to_degrees();
    let camera = |(azimuth, elevation): &(f64, f64)| {
        let ((sin, cos), (up, out)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
        let eye = scene.middle + distance * DVec3::new(cos * out, sin * out, up);
        Ok(Camera::look_at(
            eye,
            scene.middle,
            fov,
            pixels as u32,
            pixels as u32,
        )?)
    };
    scene.views.iter().map(camera).collect()
}

/// Sums of errors over the pictures of a distance, all of one size.
#[derive(Default)]
struct Errors {
    pictures: f64,
    /// Mean squares over components, over the sky, linear light and sRGB.
    linear: f64,
    srgb: f64,
    flip: f64,
    /// Means of the difference of opacity and of its square.
    alpha: f64,
    alpha_square: f64,
}

impl Errors {
    fn add(&mut self, camera: &Camera, picture: &Picture, truth: &Picture) -> Result<(), CommandError> {
        let [a, b] = [picture, truth].map(|p| linear_over_sky(p, camera));
        let errors = compare(&a, &b)?.0;
        self.pictures += 1.0;
        self.linear += errors.rmse.powi(2);
        self.srgb += 10f64.powf(-0.1 * errors.psnr_srgb);
        self.flip += errors.flip;
        let count = picture.pixels.len() as f64;
        for (a, b) in picture.pixels.iter().zip(&truth.pixels) {
            let difference = f64::from(a[3] - b[3]);
            self.alpha += difference / count;
            self.alpha_square += difference.powi(2) / count;
        }
        Ok(())
    }
}

/// Suite `filters`.
///
/// # Errors
/// If a scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let render = RenderSettings::default();
    let mut rows = Vec::new();
    for scene in &scenes(settings.folder)? {
        let input = scene.load()?;
        let mut truths: Vec<Vec<(Camera, Picture)>> = Vec::new();
        for filter in Filter::value_variants() {
            let built = build_scene(settings.folder, scene, *filter)?;
            if truths.is_empty() {
                let truth = Truth::new(&input.meshes, &input.layers, &Bottom::Boxes(built.boxes.clone()))?;
                for factor in FACTORS {
                    // More rays where pixels are few.
                    let side = if factor > 2 && !settings.quick { 16 } else { 8 };
                    let pictures = cameras(scene, factor)?.into_iter().map(|camera| {
                        let picture = truth.render(&camera, &render, side, 0)?;
                        Ok((camera, picture))
                    });
                    truths.push(pictures.collect::<Result<_, InputError>>()?);
                }
            }
            for (factor, truths) in FACTORS.iter().zip(&truths) {
                let mut errors = Errors::default();
                for (camera, truth) in truths {
                    errors.add(camera, &built.reference.render(camera, &render)?.0, truth)?;
                }
                rows.push(row(json!({
                    "scene": scene.name,
                    "distance": factor,
                    "filter": filter.name(),
                    "psnr_db": psnr(errors.linear / errors.pictures),
                    "psnr_srgb_db": psnr(errors.srgb / errors.pictures),
                    "flip": errors.flip / errors.pictures,
                    "alpha_mean": errors.alpha / errors.pictures,
                    "alpha_rms": (errors.alpha_square / errors.pictures).sqrt(),
                    "bytes": built.bytes,
                    "pool_bytes": built.pool_bytes,
                    "bricks": built.bricks,
                    "build_s": built.seconds,
                }))?);
            }
        }
    }
    Ok(rows)
}
