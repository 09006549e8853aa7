//! Suite `layout`: which sample layout, 9³ samples on corners or 10³ in centres, draws better and what it takes.
//!
//! Both layouts are built from the same input. A picture by the CPU reference at its default setting is compared with the
//! supersampled reference over a database of half the voxel, which stands for the input; as that has a layout, too, each
//! layout is judged by both.

use std::path::Path;
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree_binary;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;
use serde_json::json;

use super::scenes::{HILLS_SIZE, hills};
use super::{Row, Settings, row};
use crate::commands::CommandError;
use crate::metrics;

/// Voxels per axis of the judged tree; the truth has twice as many.
const VOXELS: u32 = 512;
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

struct Database {
    layout: SampleLayout,
    reference: Reference,
    bytes: u64,
    bricks: u64,
}

fn open(folder: &Path, voxels: u32, layout: SampleLayout) -> Result<Database, CommandError> {
    let path = hills(folder, voxels, layout)?;
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(&path)?);
    let trees = Terrain::open(&store)?.trees;
    let (mut bytes, mut bricks) = (0, 0);
    for name in &trees {
        let len = store.len(name)?;
        let tree = octree_binary::decode(&store.read(name, 0, len as usize)?)?;
        bytes += len;
        for level in (0..=tree.header.depth).filter(|l| tree.brick_count(*l) > 0) {
            bricks += u64::from(tree.brick_count(level));
            bytes += store.len(&brickfell_formats::bricks::brick_file_name(name, level))?;
        }
    }
    Ok(Database {
        layout,
        reference: Reference::new(store, &trees)?,
        bytes,
        bricks,
    })
}

/// Mean of `side`² rays per pixel: one ray per pixel of a picture that many times as large, averaged.
fn supersampled(
    database: &Database,
    view: (DVec3, DVec3),
    settings: &RenderSettings,
    side: u32,
) -> Result<Picture, CommandError> {
    let camera = Camera::look_at(view.0, view.1, 60.0, WIDTH * side, HEIGHT * side)?;
    let fine = database.reference.render(&camera, settings)?.0;
    let share = 1.0 / (side * side) as f32;
    let mut pixels = vec![[0f32; 4]; (WIDTH * HEIGHT) as usize];
    for (k, pixel) in fine.pixels.iter().enumerate() {
        let (x, y) = (k as u32 % fine.width / side, k as u32 / fine.width / side);
        let sum = &mut pixels[(y * WIDTH + x) as usize];
        for c in 0..4 {
            sum[c] += pixel[c] * share;
        }
    }
    Ok(Picture {
        width: WIDTH,
        height: HEIGHT,
        pixels,
    })
}

/// Peak signal-to-noise ratio over premultiplied linear RGBA, dB, at most 99.
fn picture_psnr(a: &Picture, b: &Picture) -> f64 {
    let squares: f64 = a
        .pixels
        .iter()
        .flatten()
        .zip(b.pixels.iter().flatten())
        .map(|(x, y)| f64::from(x - y).powi(2))
        .sum();
    metrics::psnr(squares / (a.pixels.len() * 4) as f64)
}

/// Suite `layout`.
///
/// # Errors
/// If a scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let layouts = [SampleLayout::Corner, SampleLayout::Centre];
    let open_all = |voxels| {
        layouts
            .iter()
            .map(|l| open(settings.folder, voxels, *l))
            .collect::<Result<Vec<_>, _>>()
    };
    let (judged, truths) = (open_all(VOXELS)?, open_all(VOXELS * 2)?);
    let s = HILLS_SIZE;
    let views = [
        (
            "down",
            DVec3::new(0.5 * s, 0.2 * s, 45.0),
            DVec3::new(0.5 * s, 0.55 * s, 10.0),
        ),
        (
            "across",
            DVec3::new(0.1 * s, 0.05 * s, 36.0),
            DVec3::new(0.7 * s, 0.9 * s, 8.0),
        ),
        (
            "distant",
            DVec3::new(-1.5 * s, -2.0 * s, 140.0),
            DVec3::new(0.5 * s, 0.5 * s, 15.0),
        ),
    ];
    let side = if settings.quick { 2 } else { 4 };
    let mut rows = Vec::new();
    for (view, eye, target) in views {
        // The truth's rays take the finest samples that their own, smaller pixels ask for.
        let sharp = RenderSettings {
            bias: -1.0,
            ..RenderSettings::default()
        };
        let truth: Vec<Picture> = truths
            .iter()
            .map(|t| supersampled(t, (eye, target), &sharp, side))
            .collect::<Result<_, _>>()?;
        for database in &judged {
            let picture = supersampled(database, (eye, target), &RenderSettings::default(), 1)?;
            rows.push(row(json!({
                "scene": format!("hills-{VOXELS}"),
                "view": view,
                "layout": format!("{:?}", database.layout).to_lowercase(),
                "samples_per_axis": database.layout.side(),
                "psnr_db_corner_truth": picture_psnr(&picture, &truth[0]),
                "psnr_db_centre_truth": picture_psnr(&picture, &truth[1]),
                "bricks": database.bricks,
                "bytes": database.bytes,
                "brick_bytes_gpu": database.layout.samples() * 8,
                "gpu_bytes_all": database.bricks * database.layout.samples() as u64 * 8,
            }))?);
        }
    }
    Ok(rows)
}
