//! Suites `pager` and `pager-growth`: flights over a terrain that is made as it is read, without a device.
//!
//! A flight stands still until its first picture is sharp, flies in real time, and rests until it is settled. Each frame's
//! requests are those of rays (`rays`); the loaders run beside. Times are of the machine, counters are not, but which pages a
//! flight in real time sees depends on how fast it goes.

mod flights;
pub mod rates;
mod rays;
mod world;

use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_formats::octree_binary;
use brickfell_pager::{PagerStats, ProceduralConfig, ProceduralStore, Store};
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::{Row, Settings, row};
use crate::commands::CommandError;
use crate::report::{Percentiles, peak_rss};
use flights::{Flight, Kind, flights};
use world::{Frame, World};

/// What the pager may hold on a flight.
const BUDGET: u64 = 96 << 20;
/// On the spot, so that all around fits.
const SPIN_BUDGET: u64 = 384 << 20;
/// Frames per second.
const RATE: f64 = 30.0;
/// Headings of a turn on the spot.
const HEADINGS: u32 = 24;
/// How long a camera at rest is waited for.
const PATIENCE: Duration = Duration::from_secs(120);
/// Frames at rest in which nothing may be loaded.
const REST: usize = 40;
/// Part of the pixels that makes a picture sharp.
const SHARP: f64 = 0.99;
/// Square around a place whose ground the camera stays above, metres.
const AROUND: f64 = 60.0;

/// A terrain and where it comes from.
pub(super) struct Ground {
    procedural: Arc<ProceduralStore>,
    pub(super) store: Arc<dyn Store>,
    terrain: Arc<Terrain>,
}

impl Ground {
    pub(super) fn new(extent: f64) -> Result<Self, CommandError> {
        let procedural = Arc::new(ProceduralStore::new(ProceduralConfig {
            seed: 7,
            extent,
            voxel: 0.25,
            depth: Some(4),
            ..ProceduralConfig::default()
        })?);
        let store: Arc<dyn Store> = Arc::clone(&procedural) as _;
        let terrain = Arc::new(Terrain::open(&store)?);
        Ok(Self {
            procedural,
            store,
            terrain,
        })
    }

    fn side(&self) -> f64 {
        f64::from(self.procedural.trees()) * self.procedural.tree_side()
    }

    /// The highest ground around a place.
    pub(super) fn height(&self, x: f64, y: f64) -> f64 {
        self.procedural.highest_ground(x, y, AROUND).unwrap_or(0.0)
    }

    fn camera(&self, flight: &Flight, t: f64) -> Result<brickfell_culler::Camera, CommandError> {
        Ok(flight.camera(t, self.side(), &|x, y| self.height(x, y))?)
    }

    /// Bytes that all chunks of all trees take in RAM, the unit of the budget: every brick is in one chunk.
    fn chunk_bytes(&self) -> Result<u64, CommandError> {
        let files: Vec<&String> = self
            .terrain
            .trees
            .iter()
            .chain(&self.terrain.coarse_trees)
            .collect();
        let bytes = files.par_iter().map(|name| -> Result<u64, String> {
            let fail = |e: &dyn std::fmt::Display| format!("{}: {e}", self.store.describe(name));
            let len = self.store.len(name).map_err(|e| fail(&e))?;
            let bytes = self.store.read(name, 0, len as usize).map_err(|e| fail(&e))?;
            let tree = octree_binary::decode(&bytes).map_err(|e| fail(&e))?;
            let bricks: u64 = (0..=tree.header.depth)
                .map(|l| u64::from(tree.brick_count(l)))
                .sum();
            let sample = self.terrain.layers.sample_bytes() as u64;
            Ok(bricks * tree.header.layout.samples() as u64 * sample)
        });
        bytes
            .try_reduce(|| 0, |a, b| Ok(a + b))
            .map_err(|message| CommandError { message, hint: None })
    }
}

/// Forgets the most RAM that the process has had, where the system can.
fn reset_peak_rss() {
    // Elsewhere the figure is that of the whole run so far.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// What was measured of a flight.
#[derive(Default)]
struct Measured {
    first_full_ms: f64,
    sharp_99_ms: f64,
    settled_ms: f64,
    merge_ms: Vec<f64>,
    loads_at_rest: u64,
    /// Bytes read in the second of two turns on the spot.
    second_turn_bytes: Option<u64>,
    /// Of the first ten pages that came after a jump, those of trees in the new view.
    first_in_view: Option<usize>,
    extra_bias: f64,
    stats: PagerStats,
}

/// Flies; each frame takes its time at [`RATE`], so that the loaders have theirs.
struct Pilot<'a> {
    ground: &'a Ground,
    flight: &'a Flight,
    world: World,
    measured: Measured,
}

impl Pilot<'_> {
    fn frame(&mut self, t: f64) -> Result<Frame, CommandError> {
        let start = Instant::now();
        let camera = self.ground.camera(self.flight, t)?;
        let frame = self.world.frame(&camera);
        self.measured.merge_ms.push(frame.merge_ms + frame.cull_ms);
        std::thread::sleep(Duration::from_secs_f64(1.0 / RATE).saturating_sub(start.elapsed()));
        Ok(frame)
    }

    /// Stands still until the picture is sharp: milliseconds until everything was seen at some level, and at the wanted one.
    fn stand(&mut self, t: f64) -> Result<(f64, f64), CommandError> {
        let start = Instant::now();
        let mut full = None;
        loop {
            let frame = self.frame(t)?;
            let passed = start.elapsed().as_secs_f64() * 1e3;
            if frame.waiting == 0 && frame.look.blind == 0 {
                full.get_or_insert(passed);
                if frame.look.sharp as f64 >= SHARP * frame.look.hits as f64 {
                    return Ok((full.unwrap_or(passed), passed));
                }
            }
            if start.elapsed() > PATIENCE {
                return Ok((full.unwrap_or(f64::NAN), f64::NAN));
            }
        }
    }

    fn fly(&mut self) -> Result<(), CommandError> {
        if self.flight.kind == Kind::Spin {
            return self.turn_twice();
        }
        let start = Instant::now();
        let mut jump = self.flight.jump();
        // Pages still to come of the old view, pages of the new one so far, and how many of them are in view.
        let mut after: Option<(usize, usize, usize)> = None;
        loop {
            let t = start.elapsed().as_secs_f64();
            let frame = self.frame(t)?;
            if jump.is_some_and(|at| t >= at) {
                jump = None;
                after = Some((frame.under_way, 0, 0));
            } else if let Some((old, new, seen)) = &mut after {
                for key in &frame.published {
                    match (*old, *new < 10) {
                        (0, true) => {
                            *new += 1;
                            *seen += usize::from(frame.trees.contains(&key.tree()));
                        }
                        (0, false) => {}
                        _ => *old -= 1,
                    }
                }
            }
            if t >= self.flight.seconds {
                break;
            }
        }
        self.measured.first_in_view = after.map(|(_, _, seen)| seen);
        Ok(())
    }

    /// Turns around twice, from heading to heading once all of the last one is there: what has been seen is to be kept.
    fn turn_twice(&mut self) -> Result<(), CommandError> {
        let mut first_turn = 0;
        for k in 0..=2 * HEADINGS {
            if k == HEADINGS {
                first_turn = self.world.pager.stats().bytes_read;
            }
            let start = Instant::now();
            loop {
                let frame = self.frame(self.flight.seconds * f64::from(k) / f64::from(2 * HEADINGS))?;
                let all_there = frame.published.is_empty() && frame.look.lacked == 0 && frame.waiting == 0;
                if all_there && self.world.pager.is_idle() || start.elapsed() > PATIENCE {
                    break;
                }
            }
        }
        self.measured.second_turn_bytes = Some(self.world.pager.stats().bytes_read - first_turn);
        Ok(())
    }

    /// Rests until nothing moves, and some frames more.
    fn rest(&mut self) -> Result<(), CommandError> {
        let start = Instant::now();
        let mut quiet = 0;
        while quiet < 2 && start.elapsed() < PATIENCE {
            let frame = self.frame(self.flight.seconds)?;
            let calm = frame.published.is_empty() && self.world.pager.is_idle() && !frame.bias_moved;
            quiet = if calm && frame.waiting == 0 { quiet + 1 } else { 0 };
        }
        self.measured.settled_ms = match quiet {
            2 => start.elapsed().as_secs_f64() * 1e3,
            _ => f64::NAN,
        };
        let before = self.world.pager.stats();
        for _ in 0..REST {
            self.frame(self.flight.seconds)?;
        }
        let after = self.world.pager.stats();
        self.measured.loads_at_rest = after.loads - before.loads + after.evicted - before.evicted;
        self.measured.extra_bias = self.world.extra_bias();
        self.measured.stats = after;
        Ok(())
    }
}

fn fly(ground: &Ground, flight: &Flight, budget: u64) -> Result<Measured, CommandError> {
    let mut pilot = Pilot {
        ground,
        flight,
        world: World::new(&ground.store, &ground.terrain, budget),
        measured: Measured::default(),
    };
    (pilot.measured.first_full_ms, pilot.measured.sharp_99_ms) = pilot.stand(0.0)?;
    pilot.fly()?;
    pilot.rest()?;
    Ok(pilot.measured)
}

/// Suite `pager`.
///
/// # Errors
/// If the terrain cannot be read.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let extent = if settings.quick { 1500.0 } else { 3000.0 };
    let terrain_bytes = Ground::new(extent)?.chunk_bytes()?;
    let mut rows = Vec::new();
    for flight in flights(settings.quick) {
        // A store that has made nothing yet, so each flight begins cold.
        let ground = Ground::new(extent)?;
        let budget = if flight.kind == Kind::Spin {
            SPIN_BUDGET
        } else {
            BUDGET
        };
        reset_peak_rss();
        let m = fly(&ground, &flight, budget)?;
        let rss = peak_rss();
        // The same beginning with a pager that is empty, over files that were made before.
        let mut again = Pilot {
            ground: &ground,
            flight: &flight,
            world: World::new(&ground.store, &ground.terrain, budget),
            measured: Measured::default(),
        };
        let (_, sharp_warm) = again.stand(0.0)?;
        rows.push(row(json!({
            "flight": flight.name,
            "terrain_bytes": terrain_bytes,
            "budget_bytes": budget,
            "peak_bytes": m.stats.peak_bytes,
            "rss_peak_bytes": rss,
            "bytes_read": m.stats.bytes_read,
            "loads": m.stats.loads,
            "cancelled": m.stats.cancelled,
            "first_full_ms": m.first_full_ms,
            "sharp_99_ms": m.sharp_99_ms,
            "sharp_99_warm_ms": sharp_warm,
            "settled_ms": m.settled_ms,
            "merge_cull_p99_ms": Percentiles::of(m.merge_ms.iter().copied()).p99,
            "loads_at_rest": m.loads_at_rest,
            "second_turn_bytes": m.second_turn_bytes.map_or(Value::Null, Value::from),
            "first_10_in_view": m.first_in_view.map_or(Value::Null, Value::from),
            "extra_bias": m.extra_bias,
        }))?);
    }
    Ok(rows)
}

/// Suite `pager-growth`: the same view on terrains of 1, 10 and 100 times the area.
///
/// # Errors
/// If a terrain cannot be read.
pub fn growth(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let base = if settings.quick { 400.0 } else { 1000.0 };
    let mut rows = Vec::new();
    for times in [1u32, 10, 100] {
        let ground = Ground::new(base * f64::from(times).sqrt())?;
        let mut world = World::new(&ground.store, &ground.terrain, BUDGET);
        // One place near the corner that all terrains have, looking out of them: the same trees are in view.
        let place = DVec3::new(0.3 * base, 0.3 * base, 0.0);
        let eye = place.with_z(ground.height(place.x, place.y) + 25.0);
        let target = eye + DVec3::new(-1.0, -1.0, -0.6);
        let (width, height) = flights::SIZE;
        let camera = brickfell_culler::Camera::look_at(eye, target, 60.0, width, height)?;
        let start = Instant::now();
        let mut quiet = 0;
        while quiet < 3 && start.elapsed() < PATIENCE {
            let frame = world.frame(&camera);
            let calm = frame.published.is_empty() && world.pager.is_idle() && frame.waiting == 0;
            quiet = if calm { quiet + 1 } else { 0 };
            world.pager.wait_for_progress(Duration::from_millis(50));
        }
        let settled: Vec<Frame> = (0..if settings.quick { 30 } else { 200 })
            .map(|_| world.frame(&camera))
            .collect();
        let micros = |pick: fn(&Frame) -> f64| Percentiles::of(settled.iter().map(pick)).p50 * 1e3;
        let stats = world.pager.stats();
        rows.push(row(json!({
            "area": times,
            "trees_total": ground.terrain.trees.len(),
            "trees_visible": settled.last().map_or(0, |f| f.visible),
            "resident_bytes": stats.resident_bytes,
            "peak_bytes": stats.peak_bytes,
            "loads": stats.loads,
            "merge_micros": micros(|f| f.merge_ms),
            "cull_micros": micros(|f| f.cull_ms),
            "submit_micros": micros(|f| f.submit_ms),
        }))?);
    }
    Ok(rows)
}
