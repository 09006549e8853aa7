//! Suite `first-sight`: how long a view takes that is jumped to, from the first frame until nothing is asked for any more.
//!
//! As the renderer does it, where a request brings the whole chain of nodes and bricks down to the wanted level; and level by level: with a
//! bias so high that the coarsest level is enough, and one less each time that all is there.

use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::Camera;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;
use serde_json::json;

use super::scenes::{HILLS_SIZE, hills};
use super::{Row, Settings, caster, row};
use crate::commands::{CommandError, open_gpu};

/// So small that it is round trips that count, and not how many bricks a frame has time for.
const SIZE: [u32; 2] = [48, 36];
/// Frames in a row without a wish that say that there is none: more than a read-back is late.
const QUIET: u32 = 4;
/// Frames after which a view is given up.
const PATIENCE: u32 = 2000;

/// Frames until nothing is asked for, those that show it not counted, bricks uploaded in them, and when that was.
fn sharpen(
    renderer: &mut Renderer,
    camera: &Camera,
    settings: &RenderSettings,
) -> Result<(u32, usize, Instant), CommandError> {
    let (mut last, mut uploads, mut at) = (0, 0, Instant::now());
    for frame in 1..=PATIENCE {
        let report = renderer.frame(camera, settings)?;
        renderer.wait()?;
        uploads += report.uploads;
        let asked = renderer.feedback().request_count as usize;
        if asked + report.pending + report.uploads + report.trees_waiting > 0 {
            (last, at) = (frame, Instant::now());
        } else if frame >= last + QUIET {
            return Ok((last, uploads, at));
        }
    }
    Err(CommandError::new(
        "the view does not get sharp",
        "is the machine very busy?",
    ))
}

/// Suite `first-sight`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let gpu = open_gpu()?;
    let [width, height] = SIZE;
    // Before the jump: down on a corner, from so near that hardly anything else is in memory.
    let corner = DVec3::new(4.0, 4.0, 0.0);
    let before = Camera::look_at(
        corner + DVec3::Z * 36.0,
        corner + DVec3::Y * 0.1,
        15.0,
        width,
        height,
    )?;
    let eye = DVec3::new(0.5 * HILLS_SIZE, 0.3 * HILLS_SIZE, 38.0);
    let after = Camera::look_at(eye, eye + DVec3::new(0.0, 1.0, -0.7), 60.0, width, height)?;
    let render = RenderSettings::default();
    let mut rows = Vec::new();
    for cut in [1, 16] {
        let folder = hills(settings.folder, caster::VOXELS, caster::VOXELS / cut)?;
        let depth = (caster::VOXELS / cut / 8).ilog2();
        for (requests, steps) in [("whole chains", 0), ("level by level", depth)] {
            let store: Arc<dyn Store> = Arc::new(FolderStore::open(&folder)?);
            let terrain = Terrain::open(&store)?;
            let mut renderer = Renderer::new(gpu.clone(), store, terrain, RendererConfig::default())?;
            renderer.settle(&before, &render)?;
            let stats = renderer.pager_stats();
            let start = Instant::now();
            let (mut frames, mut uploads, mut end) = (0, 0, start);
            for finer in (0..=steps).rev() {
                let coarser = RenderSettings {
                    bias: render.bias + f64::from(finer),
                    ..render
                };
                let (more, bricks, at) = sharpen(&mut renderer, &after, &coarser)?;
                (frames, uploads, end) = (frames + more, uploads + bricks, at);
            }
            let loaded = renderer.pager_stats();
            rows.push(row(json!({
                "scene": format!("hills in {cut} x {cut} trees"),
                "requests": requests,
                "depth": depth,
                "frames": frames,
                "ms": (end - start).as_secs_f64() * 1e3,
                "pages": loaded.loads - stats.loads,
                "bytes_read": loaded.bytes_read - stats.bytes_read,
                "uploads": uploads,
                "bricks_used": renderer.feedback().used_bricks.iter().map(|w| w.count_ones()).sum::<u32>(),
            }))?);
        }
    }
    Ok(rows)
}
