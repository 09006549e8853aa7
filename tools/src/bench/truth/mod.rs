//! Suite `truth`: time against error. The GPU's settled pictures, and the CPU reference's, against the truth from the input.
//!
//! Each scene is seen from above at 1, 2, 4, 16 and 64 times the distance at which a finest voxel fits a pixel, and along the
//! ground, at the default setting; one view sweeps everything that trades speed for error. The truth is the mean of two
//! renders of 64 rays a pixel, whose difference gives its own noise. Beside `bench.json` and `bench.csv` it leaves a plot and a
//! page with the pictures.

mod page;
mod plot;
mod scenes;

use std::path::PathBuf;
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use serde::Serialize;

use super::caster::{measure, repetitions};
use super::{Row, Settings, row};
use crate::commands::{CommandError, open_gpu};
use crate::holes::{count_holes, count_thick, inside, least_alpha_inside};
use crate::metrics::{LinearImage, compare, noise_floor, psnr};
use crate::picture_file::linear_over_sky;
use crate::report::per_ray;
use crate::truth::Truth;
use scenes::{Scene, Variant, View};

/// Rays per axis of a pixel in each of the two renders of the truth.
const RAYS: u32 = 8;
/// Bytes of a node tile in its pool.
const TILE_BYTES: u64 = 64;

/// A row of the table.
#[derive(Clone, Debug, Serialize)]
struct Entry {
    scene: String,
    view: String,
    setting: String,
    backend: String,
    width: u32,
    height: u32,
    ms_median: f64,
    mpx_per_second: f64,
    /// Bytes of the bricks and node tiles that the picture uses in the pools; 0 for the reference, which has none.
    bytes: u64,
    psnr_db: f64,
    psnr_srgb_db: f64,
    /// PSNR in linear light over the pixels whose 5×5 neighbourhood is opaque in the truth: without outlines before the sky.
    psnr_inside_db: Option<f64>,
    flip: f64,
    worst: u8,
    percent_over_2: f64,
    holes: usize,
    alpha_min_where_opaque: Option<f32>,
    /// Pixels that are covered more than a pixel beside what the truth covers.
    thick: usize,
    /// PSNR that the truth's own noise would give: an error near it cannot be told.
    truth_floor_db: f64,
    bias: f64,
    nodes_per_ray: f64,
    samples_per_ray: f64,
}

/// The pictures of a view at the default setting, for the page.
struct Shown {
    scene: String,
    view: String,
    picture: LinearImage,
    truth: LinearImage,
    flip: Vec<f32>,
}

/// A camera and the truth of it.
struct Judge {
    view: String,
    camera: Camera,
    truth: Picture,
    seen: LinearImage,
    floor_db: f64,
}

impl Judge {
    fn new(truth: &Truth<'_>, view: &View, render: &RenderSettings) -> Result<Self, CommandError> {
        let camera = view.camera;
        let draw = |seed| truth.render(&camera, render, RAYS, seed);
        let [mut picture, other] = [draw(1)?, draw(2)?];
        let seen = [&picture, &other].map(|p| linear_over_sky(p, &camera));
        // Of the mean of the two, half the variance of one.
        let floor = noise_floor(&seen[0], &seen[1])?.powi(2) * 0.5;
        for (p, q) in picture.pixels.iter_mut().zip(&other.pixels) {
            *p = std::array::from_fn(|c| 0.5 * (p[c] + q[c]));
        }
        Ok(Self {
            view: view.name.clone(),
            camera,
            seen: linear_over_sky(&picture, &camera),
            truth: picture,
            floor_db: psnr(floor),
        })
    }
}

fn psnr_inside(picture: &Picture, truth: &Picture) -> Option<f64> {
    let (mut squares, mut count) = (0.0, 0u32);
    for k in inside(truth) {
        let pair = picture.pixels[k].iter().zip(&truth.pixels[k]).take(3);
        squares += pair.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / 3.0;
        count += 1;
    }
    (count > 0).then(|| psnr(squares / f64::from(count)))
}

/// What a picture took.
struct Cost {
    backend: String,
    ms: f64,
    bytes: u64,
    bias: f64,
    counters: brickfell_runtime::picture::RayCounters,
}

fn entry(
    scene: &str,
    setting: &str,
    judge: &Judge,
    picture: &Picture,
    cost: &Cost,
) -> Result<(Entry, Shown), CommandError> {
    let seen = linear_over_sky(picture, &judge.camera);
    let (errors, flip) = compare(&seen, &judge.seen)?;
    let pixels = f64::from(picture.width) * f64::from(picture.height);
    let entry = Entry {
        scene: scene.into(),
        view: judge.view.clone(),
        setting: setting.into(),
        backend: cost.backend.clone(),
        width: picture.width,
        height: picture.height,
        ms_median: cost.ms,
        mpx_per_second: pixels * 1e-3 / cost.ms,
        bytes: cost.bytes,
        psnr_db: errors.psnr,
        psnr_srgb_db: errors.psnr_srgb,
        psnr_inside_db: psnr_inside(picture, &judge.truth),
        flip: errors.flip,
        worst: errors.worst.steps,
        percent_over_2: 100.0 * errors.share_over_2,
        holes: count_holes(picture, &judge.truth),
        alpha_min_where_opaque: least_alpha_inside(picture, &judge.truth),
        thick: count_thick(picture, &judge.truth),
        truth_floor_db: judge.floor_db,
        bias: cost.bias,
        nodes_per_ray: per_ray(cost.counters.nodes, &cost.counters),
        samples_per_ray: per_ray(cost.counters.samples, &cost.counters),
    };
    let shown = Shown {
        scene: scene.into(),
        view: judge.view.clone(),
        picture: seen,
        truth: judge.seen.clone(),
        flip,
    };
    Ok((entry, shown))
}

/// A database opened for the GPU.
struct Open {
    store: Arc<dyn Store>,
    renderer: Renderer,
}

impl Open {
    fn new(folder: &std::path::Path, gpu_budget: u64) -> Result<Self, CommandError> {
        let store: Arc<dyn Store> = Arc::new(FolderStore::open(folder)?);
        let terrain = Terrain::open(&store)?;
        let config = RendererConfig {
            ram_budget: 2 << 30,
            gpu_budget,
            ..RendererConfig::default()
        };
        Ok(Self {
            renderer: Renderer::new(open_gpu()?, Arc::clone(&store), terrain, config)?,
            store,
        })
    }

    /// Draws settled; picture and cost.
    fn draw(
        &mut self,
        camera: &Camera,
        render: &RenderSettings,
        repetitions: usize,
    ) -> Result<(Picture, Cost), CommandError> {
        let (ms, counters) = measure(&mut self.renderer, camera, render, repetitions)?;
        let (report, _) = self.renderer.settle(camera, render)?;
        let used = |words: &[u32]| words.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
        let feedback = self.renderer.feedback();
        let brick_bytes = self.renderer.brick_bytes();
        let bytes = used(&feedback.used_bricks) * brick_bytes + used(&feedback.used_tiles) * TILE_BYTES;
        let cost = Cost {
            backend: self.renderer.backend(),
            ms,
            bytes,
            bias: report.bias,
            counters,
        };
        Ok((self.renderer.read_picture()?, cost))
    }

    /// The reference's picture of the same database.
    fn reference(
        &self,
        camera: &Camera,
        render: &RenderSettings,
        repetitions: usize,
    ) -> Result<(Picture, Cost), CommandError> {
        let reference = Reference::open(Arc::clone(&self.store), &self.renderer.terrain().scene)?;
        // The first picture reads and decodes.
        let (picture, counters) = reference.render(camera, render)?;
        let mut times = Vec::new();
        for _ in 0..repetitions {
            let start = std::time::Instant::now();
            reference.render(camera, render)?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        let cost = Cost {
            backend: "reference".into(),
            ms: crate::report::Percentiles::of(times).p50,
            bytes: 0,
            bias: render.bias,
            counters,
        };
        Ok((picture, cost))
    }
}

/// Most device memory for what is measured at other settings than the size of the pools.
const GPU_BUDGET: u64 = 1 << 30;

/// Where the suite is.
fn say(row: &Entry) {
    println!(
        "  {} {}, {} ({}): {:.2} dB, FLIP {:.4}",
        row.scene, row.view, row.setting, row.backend, row.psnr_db, row.flip
    );
}

fn measure_scene(
    scene: &Scene,
    settings: &Settings<'_>,
    entries: &mut Vec<Entry>,
    shown: &mut Vec<Shown>,
) -> Result<(), CommandError> {
    let render = RenderSettings::default();
    let repetitions = repetitions(settings).min(5);
    let truth = scene.truth()?;
    let views = scene.views(&truth, settings.quick)?;
    let mut open = Open::new(&scene.folder, GPU_BUDGET)?;
    let mut swept = None;
    for view in &views {
        let judge = Judge::new(&truth, view, &render)?;
        let (picture, cost) = open.draw(&judge.camera, &render, repetitions)?;
        let (row, pictures) = entry(&scene.name, "default", &judge, &picture, &cost)?;
        say(&row);
        entries.push(row);
        shown.push(pictures);
        if view.swept {
            swept = Some((judge, cost.bytes));
        }
    }
    let Some((judge, bytes)) = swept.filter(|_| !settings.quick) else {
        return Ok(());
    };
    let mut add = |setting: &str, judge: &Judge, picture: &Picture, cost: &Cost| {
        let (row, _) = entry(&scene.name, setting, judge, picture, cost)?;
        say(&row);
        entries.push(row);
        Ok::<_, CommandError>(())
    };
    let (picture, cost) = open.reference(&judge.camera, &render, 1)?;
    add("default", &judge, &picture, &cost)?;
    for (name, render) in scenes::settings() {
        let (picture, cost) = open.draw(&judge.camera, &render, repetitions)?;
        add(&name, &judge, &picture, &cost)?;
    }
    for scale in [0.5, 2.0] {
        let view = judge.view.clone();
        let judge = Judge::new(&truth, &scenes::scaled(&judge.camera, view, scale)?, &render)?;
        let (picture, cost) = open.draw(&judge.camera, &render, repetitions)?;
        add(&format!("size ×{scale}"), &judge, &picture, &cost)?;
    }
    drop(open);
    for (name, share) in [("pool 1/2", 2), ("pool 1/4", 4)] {
        let mut small = Open::new(&scene.folder, bytes / share)?;
        let (picture, cost) = small.draw(&judge.camera, &render, repetitions)?;
        add(name, &judge, &picture, &cost)?;
    }
    for Variant { name, folder } in scene.variants(settings)? {
        let mut other = Open::new(&folder, GPU_BUDGET)?;
        let (picture, cost) = other.draw(&judge.camera, &render, repetitions)?;
        add(&name, &judge, &picture, &cost)?;
    }
    Ok(())
}

/// A scene of the suite: its database, and cameras by name.
pub(super) struct Views {
    pub(super) scene: String,
    pub(super) folder: PathBuf,
    pub(super) cameras: Vec<(String, Camera)>,
}

/// The scenes of the suite.
///
/// # Errors
/// If a scene cannot be built.
pub(super) fn views(settings: &Settings<'_>) -> Result<Vec<Views>, CommandError> {
    let mut all = Vec::new();
    for scene in scenes::scenes(settings)? {
        let truth = scene.truth()?;
        let views = scene.views(&truth, settings.quick)?;
        all.push(Views {
            scene: scene.name,
            folder: scene.folder,
            cameras: views.into_iter().map(|view| (view.name, view.camera)).collect(),
        });
    }
    Ok(all)
}

/// Suite `truth`.
///
/// # Errors
/// If a scene cannot be built or drawn, or the plot or the page cannot be written.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let (mut entries, mut shown) = (Vec::new(), Vec::new());
    for scene in scenes::scenes(settings)? {
        measure_scene(&scene, settings, &mut entries, &mut shown)?;
    }
    let front = plot::svg(&entries)?;
    let page = page::html(&entries, &shown, &front)?;
    for (name, text) in [("truth.svg", &front), ("truth.html", &page)] {
        let file = settings.out.join(name);
        std::fs::write(&file, text)
            .map_err(|e| CommandError::new(format!("{}: {e}", file.display()), "is there room?"))?;
    }
    entries.iter().map(row).collect()
}
