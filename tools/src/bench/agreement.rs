//! Suite `agreement`: the GPU's pictures of the demo terrain against the CPU reference's, pixel by pixel.
//!
//! lavapipe filters exactly only with `GALLIVM_PERF=no_aos_sampling` in the environment; `machine.exact_filtering` says
//! whether it was set.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::value::linear_to_srgb;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;
use serde_json::json;

use super::scenes::demo_input;
use super::{Row, Settings, row};
use crate::build::{BuildArgs, Silent, build};
use crate::commands::{CommandError, open_gpu};
use crate::holes::count_holes;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

/// Builds the demo terrain as `make fly` does, or finds it built.
fn demo(folder: &Path) -> Result<PathBuf, CommandError> {
    let out = folder.join("demo");
    if out.join("scene.xml").exists() {
        return Ok(out);
    }
    let demo = demo_input(folder)?;
    let mut args = BuildArgs::new(&out);
    args.heights = vec![demo.layer()];
    args.inputs = demo.meshes;
    args.up = demo.up;
    args.voxel = Some(0.25);
    args.tree_voxels = 256;
    args.force = true;
    build(&args, &Silent)?;
    Ok(out)
}

/// Differences of two pictures over black: pixels by their largest difference in 8-bit sRGB codes or alpha steps.
fn differences(a: &Picture, b: &Picture) -> Vec<u8> {
    let codes = |p: &[f32; 4]| {
        let [r, g, b] = [p[0], p[1], p[2]].map(linear_to_srgb);
        [r, g, b, (p[3].clamp(0.0, 1.0) * 255.0 + 0.5) as u8]
    };
    let difference = |(p, q): (&[f32; 4], &[f32; 4])| {
        codes(p)
            .into_iter()
            .zip(codes(q))
            .map(|(x, y)| x.abs_diff(y))
            .max()
            .unwrap_or(0)
    };
    a.pixels.iter().zip(&b.pixels).map(difference).collect()
}

/// Suite `agreement`.
///
/// # Errors
/// If the terrain cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(demo(settings.folder)?)?);
    let terrain = Terrain::open(&store)?;
    let reference = Reference::new(Arc::clone(&store), &terrain.trees)?;
    let mut renderer = Renderer::new(open_gpu()?, store, terrain, RendererConfig::default())?;
    let render = RenderSettings::default();
    let mut rows = Vec::new();
    for (view, eye, target) in [
        (
            "overview",
            DVec3::new(-40.0, -60.0, 120.0),
            DVec3::new(128.0, 128.0, 20.0),
        ),
        (
            "village",
            DVec3::new(60.0, 40.0, 40.0),
            DVec3::new(128.0, 140.0, 20.0),
        ),
        (
            "crag",
            DVec3::new(200.0, 290.0, 60.0),
            DVec3::new(190.0, 200.0, 40.0),
        ),
    ] {
        let camera = Camera::look_at(eye, target, 60.0, WIDTH, HEIGHT)?;
        let (report, frames) = renderer.settle(&camera, &render)?;
        let picture = renderer.read_picture()?;
        let bias = RenderSettings {
            bias: report.bias,
            ..render
        };
        let (truth, _) = reference.render(&camera, &bias)?;
        let differences = differences(&picture, &truth);
        let within = |limit: u8| {
            let count = differences.iter().filter(|d| **d <= limit).count();
            100.0 * count as f64 / differences.len() as f64
        };
        rows.push(row(json!({
            "scene": "demo",
            "view": view,
            "width": WIDTH,
            "height": HEIGHT,
            "percent_within_1": within(1),
            "percent_within_2": within(2),
            "worst": differences.iter().max(),
            "holes": count_holes(&picture, &truth),
            "requests": renderer.feedback().request_count,
            "settle_frames": frames,
        }))?);
    }
    Ok(rows)
}
