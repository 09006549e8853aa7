//! Suites `caster` and `caster-variants`: the ray caster alone, settled, on one 1024³ tree of hills.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::Camera;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::Device;
use brickfell_runtime::picture::RayCounters;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::{DVec2, DVec3};
use serde_json::json;

use super::scenes::{HILLS_SIZE, hill_height, hills};
use super::{Row, Settings, row};
use crate::commands::{CommandError, open_gpu};
use crate::report::{Percentiles, per_ray};

const WIDTH: u32 = 800;
const HEIGHT: u32 = 600;
const FOV: f64 = 60.0;
pub(super) const SCENE: &str = "hills-1024";
pub(super) const VOXELS: u32 = 1024;

/// `far` looks 60° down with the tree overfilling the picture; `near` stands 2 m above the ground and looks 10° down.
pub(super) fn views() -> Result<[(&'static str, Camera); 2], CommandError> {
    let look = |eye: DVec3, down: f64| {
        let down = down.to_radians();
        Camera::look_at(
            eye,
            eye + DVec3::new(0.0, down.cos(), -down.sin()),
            FOV,
            WIDTH,
            HEIGHT,
        )
    };
    let stand = DVec2::new(0.5, 0.1) * HILLS_SIZE;
    let far = DVec3::new(0.5 * HILLS_SIZE, 0.16 * HILLS_SIZE, 38.0);
    Ok([
        ("far", look(far, 60.0)?),
        ("near", look(stand.extend(hill_height(stand) + 2.0), 10.0)?),
    ])
}

/// The folder of the hills.
pub(super) fn scene(settings: &Settings<'_>) -> Result<PathBuf, CommandError> {
    hills(settings.folder, VOXELS, VOXELS)
}

pub(super) fn open(settings: &Settings<'_>) -> Result<(Arc<dyn Store>, Terrain), CommandError> {
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(scene(settings)?)?);
    let terrain = Terrain::open(&store)?;
    Ok((store, terrain))
}

/// What is measured: the device, and the CPU if that is wanted.
pub(super) fn devices(settings: &Settings<'_>) -> Result<Vec<Device>, CommandError> {
    let mut devices = vec![open_gpu()?.into()];
    devices.extend(settings.cpu.then_some(Device::Cpu));
    Ok(devices)
}

pub(super) fn renderer(
    device: Device,
    store: Arc<dyn Store>,
    terrain: Terrain,
) -> Result<Renderer, CommandError> {
    let config = RendererConfig {
        ram_budget: 2 << 30,
        gpu_budget: 1 << 30,
        ..Default::default()
    };
    Ok(Renderer::new(device, store, terrain, config)?)
}

fn figures(
    view: &str,
    backend: &str,
    setting: &str,
    ms: f64,
    counters: &RayCounters,
) -> Result<Row, CommandError> {
    row(json!({
        "scene": SCENE,
        "view": view,
        "setting": setting,
        "backend": backend,
        "width": WIDTH,
        "height": HEIGHT,
        "ms_median": ms,
        "mpx_per_second": f64::from(WIDTH * HEIGHT) * 1e-3 / ms,
        "nodes_per_ray": per_ray(counters.nodes, counters),
        "samples_per_ray": per_ray(counters.samples, counters),
        "texture_reads_per_ray": per_ray(counters.texture_reads, counters),
    }))
}

/// Settles the view, then draws it again and again.
pub(super) fn measure(
    renderer: &mut Renderer,
    camera: &Camera,
    render: &RenderSettings,
    repetitions: usize,
) -> Result<(f64, RayCounters), CommandError> {
    renderer.settle(camera, render)?;
    let mut times = Vec::new();
    for _ in 0..repetitions {
        let start = Instant::now();
        renderer.frame(camera, render)?;
        renderer.wait()?;
        let wall = start.elapsed().as_secs_f64() * 1e3;
        // The read-back that the next frame takes is this one's; its device time is free of what the frame did besides.
        let device = renderer.feedback().gpu_ms[1];
        times.push(if device > 0.0 { device } else { wall });
    }
    Ok((Percentiles::of(times).p50, renderer.feedback().counters))
}

pub(super) fn repetitions(settings: &Settings<'_>) -> usize {
    if settings.quick { 3 } else { 9 }
}

/// Suite `caster`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn default_rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let mut rows = Vec::new();
    for device in devices(settings)? {
        let (store, terrain) = open(settings)?;
        let mut renderer = renderer(device, store, terrain)?;
        for (view, camera) in views()? {
            let (ms, counters) = measure(
                &mut renderer,
                &camera,
                &RenderSettings::default(),
                repetitions(settings),
            )?;
            let mut row = figures(view, &renderer.backend(), "default", ms, &counters)?;
            row.remove("setting");
            rows.push(row);
        }
    }
    Ok(rows)
}

/// Suite `caster-variants`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn variants(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let (store, terrain) = open(settings)?;
    let scene = terrain.scene.clone();
    let mut renderer = renderer(open_gpu()?.into(), Arc::clone(&store), terrain)?;
    let default = RenderSettings::default();
    let variants = [
        ("default", default),
        ("nearest level", RenderSettings { fade: 0.0, ..default }),
        ("mixed everywhere", RenderSettings { fade: 1.0, ..default }),
        ("bias 0", RenderSettings { bias: 0.0, ..default }),
        ("bias +1", RenderSettings { bias: 1.0, ..default }),
    ];
    let mut rows = Vec::new();
    for (view, camera) in views()? {
        for (name, render) in variants {
            let (ms, counters) = measure(&mut renderer, &camera, &render, repetitions(settings))?;
            rows.push(figures(view, &renderer.backend(), name, ms, &counters)?);
        }
        let reference = Reference::open(Arc::clone(&store), &scene)?;
        // The first picture reads and decodes; the second is the time of the rays.
        reference.render(&camera, &default)?;
        let start = Instant::now();
        let (_, counters) = reference.render(&camera, &default)?;
        rows.push(figures(
            view,
            "reference",
            "default",
            start.elapsed().as_secs_f64() * 1e3,
            &counters,
        )?);
    }
    Ok(rows)
}
