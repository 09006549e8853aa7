//! Suite `cache`: a flight over the hills, out and back, with brick pools of parts of what it needs at once.
//!
//! Cameras follow from the number of the frame, and each frame waits for the device. The first lap fills memory and lets the bias find
//! its value, the second is measured; then the camera rests.

use std::collections::HashSet;

use brickfell_culler::Camera;
use brickfell_pager::PagerStats;
use brickfell_runtime::gpu::{Gpu, GpuCalls};
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::texture_pool::BrickPlace;
use glam::DVec3;
use serde_json::json;

use super::scenes::HILLS_SIZE;
use super::{Row, Settings, caster, row};
use crate::commands::{CommandError, open_gpu};
use crate::holes::count_holes;
use crate::report::Percentiles;

/// Pools, in parts of the most bricks that a frame of the flight needs.
const PARTS: [f64; 5] = [0.25, 0.5, 0.75, 1.0, 1.5];
/// Metres from frame to frame.
const STEP: f64 = 1.0;
/// Frames at rest.
const REST: u32 = 20;
const RAM: u64 = 2 << 30;
/// A pool for everything.
const PLENTY: u64 = 1 << 30;

/// A flight of so many frames out and as many back.
#[derive(Clone, Copy)]
struct Flight {
    frames: u32,
    size: [u32; 2],
}

impl Flight {
    fn camera(&self, frame: u32) -> Result<Camera, CommandError> {
        let way = STEP * f64::from(frame.min(2 * self.frames - frame));
        let eye = DVec3::new(0.5 * HILLS_SIZE, 0.12 * HILLS_SIZE + way, 38.0);
        let (sin, cos) = 35f64.to_radians().sin_cos();
        let [width, height] = self.size;
        let ahead = DVec3::new(0.0, cos, -sin);
        Ok(Camera::look_at(eye, eye + ahead, 60.0, width, height)?)
    }
}

/// What was seen of a lap.
#[derive(Default)]
struct Lap {
    frames: usize,
    /// Most bricks in use in a frame.
    in_use: u32,
    /// Bricks that rays used, and what they lacked.
    hits: u64,
    misses: u64,
    uploads: u64,
    evictions: u64,
    /// Of the uploads, bricks that had been there before.
    again: u64,
    bias: f64,
    /// Frames in which the pools' directory grew.
    grown: usize,
    /// What frames made on the device, and how often they waited for it.
    calls: GpuCalls,
    cast_ms: Vec<f64>,
    /// Parts of the device's time in which feedback was compacted.
    compaction: Vec<f64>,
}

/// A renderer, and which bricks it has and had.
struct Pilot<'a> {
    gpu: &'a Gpu,
    renderer: Renderer,
    flight: Flight,
    resident: HashSet<BrickPlace>,
    seen: HashSet<BrickPlace>,
}

impl Pilot<'_> {
    fn lap(&mut self) -> Result<Lap, CommandError> {
        let mut lap = Lap::default();
        for frame in 0..2 * self.flight.frames {
            let camera = self.flight.camera(frame)?;
            let (held, before) = (self.renderer.pool().memory(), self.gpu.calls());
            let report = self.renderer.frame(&camera, &RenderSettings::default())?;
            let after = self.gpu.calls();
            self.renderer.wait()?;
            let resident: HashSet<_> = self.renderer.pool().residents().collect();
            let new = resident.difference(&self.resident);
            lap.again += new.filter(|place| self.seen.contains(place)).count() as u64;
            lap.evictions += self.resident.difference(&resident).count() as u64;
            self.seen.extend(&resident);
            self.resident = resident;
            let feedback = self.renderer.feedback();
            let hits: u32 = feedback.used_bricks.iter().map(|w| w.count_ones()).sum();
            let [_, cast, compact] = feedback.gpu_ms;
            lap.frames += 1;
            lap.in_use = lap.in_use.max(report.bricks_in_use);
            lap.hits += u64::from(hits);
            lap.misses += report.pending as u64;
            lap.uploads += report.uploads as u64;
            lap.bias += report.bias;
            lap.grown += usize::from(self.renderer.pool().memory() != held);
            lap.calls.made += after.made - before.made;
            lap.calls.waits += after.waits - before.waits;
            lap.cast_ms.push(cast);
            lap.compaction.push(compact / feedback.gpu_ms.iter().sum::<f64>());
        }
        Ok(lap)
    }

    /// Settles where the flight ends and rests there: holes of the picture, and pages, bricks and node words that came or left.
    fn rest(&mut self, reference: &Reference) -> Result<(usize, u64), CommandError> {
        let (camera, render) = (self.flight.camera(0)?, RenderSettings::default());
        let (report, _) = self.renderer.settle(&camera, &render)?;
        let coarser = RenderSettings {
            bias: report.bias,
            ..render
        };
        let (truth, _) = reference.render(&camera, &coarser)?;
        let holes = count_holes(&self.renderer.read_picture()?, &truth);
        let pages = |stats: PagerStats| stats.loads + stats.evicted;
        let before = pages(self.renderer.pager_stats());
        let mut moved = 0;
        for _ in 0..REST {
            let report = self.renderer.frame(&camera, &render)?;
            self.renderer.wait()?;
            moved += (report.uploads + report.node_updates) as u64;
        }
        Ok((holes, moved + pages(self.renderer.pager_stats()) - before))
    }
}

/// Suite `cache`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let flight = match settings.quick {
        true => Flight {
            frames: 8,
            size: [160, 120],
        },
        false => Flight {
            frames: 24,
            size: [320, 240],
        },
    };
    let gpu = open_gpu()?;
    let (store, terrain) = caster::open(settings)?;
    let reference = Reference::open(store, &terrain.scene)?;
    let pilot = |gpu_budget: u64| -> Result<Pilot<'_>, CommandError> {
        let (store, terrain) = caster::open(settings)?;
        let config = RendererConfig {
            ram_budget: RAM,
            gpu_budget,
            ..RendererConfig::default()
        };
        let mut renderer = Renderer::new(gpu.clone(), store, terrain, config)?;
        renderer.settle(&flight.camera(0)?, &RenderSettings::default())?;
        Ok(Pilot {
            gpu: &gpu,
            renderer,
            flight,
            resident: HashSet::new(),
            seen: HashSet::new(),
        })
    };
    let mut plenty = pilot(PLENTY)?;
    plenty.lap()?;
    let needed = plenty.lap()?.in_use;
    let sizes = plenty.renderer.pool_sizes();
    // Bricks with all that a slot needs besides.
    let slot = sizes.bytes() / u64::from(sizes.bricks());
    drop(plenty);
    let mut rows = Vec::new();
    for part in PARTS {
        let mut pilot = pilot((part * f64::from(needed) * slot as f64) as u64)?;
        pilot.lap()?;
        let lap = pilot.lap()?;
        let (holes, moved) = pilot.rest(&reference)?;
        let sizes = pilot.renderer.pool_sizes();
        let (slots, tiles) = (u64::from(sizes.bricks()), u64::from(sizes.tiles));
        let pool = slots * sizes.brick_bytes();
        // Stamps, and their bits on the device and in the three buffers that bring them back.
        let stamps = (slots + tiles) * 4 + (slots + tiles) / 8 * 4;
        let percent = |bytes: u64| 100.0 * bytes as f64 / pool as f64;
        let per_frame = |count: u64| count as f64 / lap.frames as f64;
        rows.push(row(json!({
            "pool_percent": 100.0 * part,
            "needed_slots": needed,
            "slots": slots,
            "brick_bytes": sizes.brick_bytes(),
            "hits_per_frame": per_frame(lap.hits),
            "misses_per_frame": per_frame(lap.misses),
            "hit_percent": 100.0 * lap.hits as f64 / (lap.hits + lap.misses) as f64,
            "uploads_per_frame": per_frame(lap.uploads),
            "evictions_per_frame": per_frame(lap.evictions),
            "again_per_frame": per_frame(lap.again),
            "bias_mean": lap.bias / lap.frames as f64,
            "directory_percent": percent(pilot.renderer.pool().memory()),
            "stamps_percent": percent(stamps),
            "compaction_percent": 100.0 * Percentiles::of(lap.compaction).p50,
            "cast_ms": Percentiles::of(lap.cast_ms).p50,
            "directory_grew": lap.grown,
            "device_objects_made": lap.calls.made,
            "device_waits": lap.calls.waits,
            "holes_at_rest": holes,
            "moved_at_rest": moved,
        }))?);
    }
    Ok(rows)
}
