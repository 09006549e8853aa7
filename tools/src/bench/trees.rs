//! Suite `caster-trees`: what trees cost a frame that are many, in view or out of it.
//!
//! The ground of suite `caster` as one tree, as 4×4 and as 16×16; one view on procedural terrains of 1, 4 and 16 times the area; and
//! procedural terrains all of whose trees are in view, few and many.

use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_pager::{FolderStore, ProceduralConfig, ProceduralStore, Store};
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;
use serde_json::json;

use super::caster::{self, devices, renderer, repetitions};
use super::pager::Ground;
use super::scenes::hills;
use super::{Row, Settings, row};
use crate::commands::CommandError;
use crate::report::{Percentiles, per_ray};

/// Trees per axis that the hills are cut into.
const CUTS: [u32; 3] = [1, 4, 16];
/// Areas of the procedural terrain, as parts of the least.
const AREAS: [u32; 3] = [1, 4, 16];
/// Side of the least, metres.
const SIDE: f64 = 500.0;
/// Trees per axis of the terrains that are in view as a whole.
const WHOLE: [u32; 2] = [7, 37];
/// Depth of their trees, and so the side of one in metres, voxels being one wide.
const DEPTH: u8 = 3;
const TREE: f64 = (8 << DEPTH) as f64;
/// Picture of them: so large that no group is far enough for its coarse trees.
const WHOLE_SIZE: [u32; 2] = [480, 360];
/// Frames of which the CPU's times are taken.
const FRAMES: usize = 15;

/// A settled view's row.
fn measured(
    scene: &str,
    renderer: &mut Renderer,
    total: usize,
    camera: &Camera,
    repetitions: usize,
) -> Result<Row, CommandError> {
    let settings = RenderSettings::default();
    let (ms, counters) = caster::measure(renderer, camera, &settings, repetitions)?;
    let (mut reports, mut compactions) = (Vec::new(), Vec::new());
    for _ in 0..FRAMES {
        reports.push(renderer.frame(camera, &settings)?);
        renderer.wait()?;
        compactions.push(renderer.feedback().gpu_ms[2]);
    }
    let median = |times: Vec<f64>| Percentiles::of(times).p50;
    row(json!({
        "scene": scene,
        "backend": renderer.backend(),
        "trees_total": total,
        "trees_drawn": reports.last().map_or(0, |r| r.trees_active),
        "ms_median": ms,
        "mpx_per_second": f64::from(camera.width * camera.height) * 1e-3 / ms,
        "nodes_per_ray": per_ray(counters.nodes, &counters),
        "samples_per_ray": per_ray(counters.samples, &counters),
        "compact_ms": median(compactions),
        "submit_ms": median(reports.iter().map(|r| r.submit_ms).collect()),
        "cpu_ms": median(reports.iter().map(|r| r.cpu_ms).collect()),
    }))
}

/// Suite `caster-trees`.
///
/// # Errors
/// If a scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let mut rows = Vec::new();
    let [(_, far), _] = caster::views()?;
    for device in devices(settings)? {
        for cut in CUTS {
            let folder = hills(settings.folder, caster::VOXELS, caster::VOXELS / cut)?;
            let store: Arc<dyn Store> = Arc::new(FolderStore::open(folder)?);
            let terrain = Terrain::open(&store)?;
            let total = terrain.trees.len();
            let mut renderer = renderer(device.clone(), store, terrain)?;
            let scene = format!("hills in {cut} x {cut} trees");
            rows.push(measured(
                &scene,
                &mut renderer,
                total,
                &far,
                repetitions(settings),
            )?);
        }
        for area in AREAS {
            let ground = Ground::new(SIDE * f64::from(area).sqrt())?;
            let eye = DVec3::new(0.3 * SIDE, 0.3 * SIDE, 0.0);
            let eye = eye.with_z(ground.height(eye.x, eye.y) + 25.0);
            // Out of all terrains, so that the same is in view.
            let camera = Camera::look_at(
                eye,
                eye + DVec3::new(-1.0, -1.0, -0.6),
                60.0,
                far.width,
                far.height,
            )?;
            let terrain = Terrain::open(&ground.store)?;
            let total = terrain.trees.len();
            let mut renderer = renderer(device.clone(), Arc::clone(&ground.store), terrain)?;
            let scene = format!("procedural, area x {area}");
            rows.push(measured(
                &scene,
                &mut renderer,
                total,
                &camera,
                repetitions(settings),
            )?);
        }
        for trees in WHOLE {
            let side = f64::from(trees) * TREE;
            let store: Arc<dyn Store> = Arc::new(ProceduralStore::new(ProceduralConfig {
                extent: side,
                voxel: 1.0,
                depth: Some(DEPTH),
                ..ProceduralConfig::default()
            })?);
            let terrain = Terrain::open(&store)?;
            let total = terrain.trees.len();
            let [width, height] = WHOLE_SIZE;
            let eye = DVec3::new(-0.3, -0.3, 0.9) * side;
            let middle = DVec3::new(0.5, 0.5, 0.0) * side;
            let camera = Camera::look_at(eye, middle, 60.0, width, height)?;
            let mut renderer = renderer(device.clone(), store, terrain)?;
            rows.push(measured(
                "procedural, all in view",
                &mut renderer,
                total,
                &camera,
                repetitions(settings),
            )?);
        }
    }
    Ok(rows)
}
