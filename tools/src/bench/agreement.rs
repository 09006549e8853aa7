//! Suite `agreement`: the GPU's pictures of the demo terrain and of hills against the CPU reference's, pixel by pixel.
//!
//! lavapipe filters exactly only with `GALLIVM_PERF=no_aos_sampling` in the environment; `machine.exact_filtering` says
//! whether it was set.

use std::path::Path;
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

use super::scenes::{build_demo, demo_input};
use super::{Row, Settings, caster, row, truth};
use crate::commands::CommandError;
use crate::holes::count_holes;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

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
    let demo = settings.folder.join("demo");
    build_demo(&demo_input(settings.folder)?, &demo, |_| {})?;
    let look = |view: &str, [eye, target]: [DVec3; 2]| {
        Camera::look_at(eye, target, 60.0, WIDTH, HEIGHT).map(|camera| (view.to_string(), camera))
    };
    let overview = [DVec3::new(-40.0, -60.0, 120.0), DVec3::new(128.0, 128.0, 20.0)];
    let village = [DVec3::new(60.0, 40.0, 40.0), DVec3::new(128.0, 140.0, 20.0)];
    let crag = [DVec3::new(200.0, 290.0, 60.0), DVec3::new(190.0, 200.0, 40.0)];
    let views = vec![
        look("overview", overview)?,
        look("village", village)?,
        look("crag", crag)?,
    ];
    let mut rows = of_scene(settings, "demo", &demo, views)?;
    let hills = caster::scene(settings)?;
    let views = caster::views()?.map(|(view, camera)| (view.to_string(), camera));
    rows.extend(of_scene(settings, caster::SCENE, &hills, views.into())?);
    for truth::Views {
        scene,
        folder,
        cameras,
    } in truth::views(settings)?
    {
        rows.extend(of_scene(settings, &scene, &folder, cameras)?);
    }
    Ok(rows)
}

fn of_scene(
    settings: &Settings<'_>,
    scene: &str,
    folder: &Path,
    views: Vec<(String, Camera)>,
) -> Result<Vec<Row>, CommandError> {
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(folder)?);
    let reference = Reference::open(Arc::clone(&store), &Terrain::open(&store)?.scene)?;
    let config = RendererConfig {
        gpu_budget: 1 << 30,
        ..RendererConfig::default()
    };
    let render = RenderSettings::default();
    let mut rows = Vec::new();
    for device in caster::devices(settings)? {
        let mut renderer = Renderer::new(device, Arc::clone(&store), Terrain::open(&store)?, config)?;
        for (view, camera) in &views {
            let (report, frames) = renderer.settle(camera, &render)?;
            let picture = renderer.read_picture()?;
            let bias = RenderSettings {
                bias: report.bias,
                ..render
            };
            let (truth, _) = reference.render(camera, &bias)?;
            let differences = differences(&picture, &truth);
            let within = |limit: u8| {
                let count = differences.iter().filter(|d| **d <= limit).count();
                100.0 * count as f64 / differences.len() as f64
            };
            rows.push(row(json!({
                "scene": scene,
                "view": view,
                "backend": renderer.backend(),
                "width": camera.width,
                "height": camera.height,
                "percent_within_1": within(1),
                "percent_within_3": within(3),
                "worst": differences.iter().max(),
                "holes": count_holes(&picture, &truth),
                "requests": renderer.feedback().request_count,
                "settle_frames": frames,
            }))?);
        }
    }
    Ok(rows)
}
