//! `brickfell fly`: a headless flight along a camera path, its pictures and its report.

mod video;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_culler::{Aabb, Camera};
use brickfell_pager::Store;
use brickfell_runtime::picture::{Picture, RayCounters};
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{FrameReport, Renderer};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::read_header;
use clap::Args as ClapArgs;
use glam::DVec3;
use indicatif::ProgressBar;

use super::database::print;
use super::say;
use super::view_args::ViewArgs;
use super::{CommandError, open_device, open_terrain, tell_of_blocks};
use crate::flight::Flight;
use crate::holes::count_holes;
use crate::picture_file::{Image, over_sky, save_overview};
use crate::report::{FrameEntry, Percentiles, Report, Summary, peak_rss, per_ray};
use crate::trace::Trace;

/// Seconds of the orbit that is flown without a path.
const ORBIT_SECONDS: f64 = 12.0;
/// Frames where neither a number nor a rate is given.
const DEFAULT_FRAMES: usize = 24;
/// Trees whose headers are read at most to find out what is in them; of larger scenes the boxes must do.
const HEADERS: usize = 4096;
/// Frames that the overview shows at most.
const OVERVIEW_FRAMES: usize = 240;

/// Arguments of `brickfell fly`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// Folder of the terrain, or `procedural:SEED?extent=METRES&voxel=METRES` for one that is made as it is flown over
    pub dir: PathBuf,
    /// Camera path, JSON: `{"keys":[{"t":0,"eye":[x,y,z],"target":[x,y,z]},…]}`; without it an orbit
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Frames to draw; without `--fps` spread over the path
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,
    /// Frames per second of the path; in real time, the rate not to exceed
    #[arg(long, value_name = "F", value_parser = parse_rate)]
    pub fps: Option<f64>,
    /// Wait until each frame is settled instead of following the clock, and count its holes against the reference
    #[arg(long)]
    pub settle: bool,
    /// Milliseconds that a frame may take: while the camera moves, levels and the picture's scale are as fine as that allows
    #[arg(long, value_name = "MS", value_parser = parse_ms, conflicts_with = "settle")]
    pub target_ms: Option<f64>,
    /// Folder for frames, overview and report
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Make a video of the frames too, `flight.mp4`, if there is an `ffmpeg`
    #[arg(long)]
    pub video: bool,
    /// Write what culler and pager did in each frame: a trace for Perfetto, chrome://tracing and `brickfell stats`
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Print JSON: the summary of the report
    #[arg(long)]
    pub json: bool,
    /// Picture, budgets, light
    #[command(flatten)]
    pub view: ViewArgs,
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.001..=1000.0).contains(&rate) {
        Ok(rate)
    } else {
        Err("a rate is 0.001 to 1000 per second".into())
    }
}

/// Milliseconds of a frame.
pub(crate) fn parse_ms(text: &str) -> Result<f64, String> {
    let ms: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.001..=1e6).contains(&ms) {
        Ok(ms)
    } else {
        Err("a frame takes 0.001 to 1000000 milliseconds".into())
    }
}

/// A flight under way.
struct Flying<'a> {
    args: &'a Args,
    path: Flight,
    settings: RenderSettings,
    renderer: Renderer,
    entries: Vec<FrameEntry>,
    cameras: Vec<Camera>,
    images: Vec<Image>,
    /// Alphas of settled pictures, for the count of holes.
    pictures: Vec<Picture>,
    counters: RayCounters,
    trace: Option<Trace>,
    bar: ProgressBar,
}

/// Runs the command; exit code 2 if something could not be read.
///
/// # Errors
/// If nothing can be drawn or written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let (store, terrain) = open_terrain(&args.dir)?;
    let path = match &args.path {
        Some(file) => Flight::load(file)?,
        None => {
            let bounds = data_bounds(store.as_ref(), &terrain.trees).or(terrain.graph.bounds());
            Flight::orbit(&bounds.ok_or_else(|| no_tree(&args.dir))?, ORBIT_SECONDS)
        }
    };
    let trees_total = terrain.trees.len();
    prepare_folder(&args.out)?;
    let trace = match &args.trace {
        Some(file) => Some(Trace::create(file).map_err(|e| file_error(file, e))?),
        None => None,
    };
    let renderer = Renderer::new(
        open_device(&args.view)?,
        Arc::clone(&store),
        terrain,
        args.view.config(),
    )?;
    tell_of_blocks(&renderer);
    let bar = say::bar(0, "{msg} {wide_bar} {pos}/{len} frames, {eta} left");
    let mut flying = Flying {
        args,
        path,
        settings: RenderSettings {
            target_ms: args.target_ms,
            ..args.view.settings()
        },
        renderer,
        entries: Vec::new(),
        cameras: Vec::new(),
        images: Vec::new(),
        pictures: Vec::new(),
        counters: RayCounters::default(),
        trace,
        bar,
    };
    let start = Instant::now();
    if args.settle {
        flying.fly_settled()?
    } else {
        flying.fly_real_time()?
    }
    if let (Some(trace), Some(file)) = (flying.trace.take(), &args.trace) {
        trace.finish().map_err(|e| file_error(file, e))?;
    }
    let mut report = flying.report(start.elapsed().as_secs_f64(), trees_total);
    if args.settle {
        report.summary.holes = flying.count_holes(&store, &mut report)?;
    }
    let rate = flying.entries.len() as f64 / flying.path.duration().max(0.1);
    let overview = args.out.join("overview.png");
    save_overview(&overview, &flying.images, rate).map_err(|e| file_error(&overview, e))?;
    if args.video {
        video::make(&args.out, rate)?;
    }
    let file = args.out.join("report.json");
    let json = serde_json::to_string_pretty(&report)?;
    std::fs::write(&file, json + "\n").map_err(|e| file_error(&file, e))?;
    flying.bar.finish_and_clear();
    let s = &report.summary;
    if args.json {
        print(&(serde_json::to_string_pretty(s)? + "\n"))?;
    } else {
        print(&describe(args, s))?;
    }
    for fault in &s.faults {
        eprintln!("brickfell: {fault}");
    }
    Ok(ExitCode::from(if s.faults.is_empty() { 0 } else { 2 }))
}

/// The flight in a few lines.
fn describe(args: &Args, s: &Summary) -> String {
    let mut text = format!(
        "{} frames in {:.1} s, median {:.1} ms, {:.2} M rays/s on {}\n",
        s.frames,
        s.seconds,
        s.frame_ms.p50,
        s.rays_per_second * 1e-6,
        s.adapter
    );
    if let (Some(target_ms), Some(within)) = (s.target_ms, s.within_target) {
        text += &format!(
            "{:.1} % of the frames within {target_ms} ms; mean bias {:.2}, mean scale {:.2}\n",
            within * 100.0,
            s.bias_mean,
            s.scale_mean
        );
    }
    let see = ["overview.png", "report.json"].map(|name| args.out.join(name).display().to_string());
    text + &format!("see {} and {}\n", see[0], see[1])
}

/// What is said where nothing can be looked at.
pub(crate) fn no_tree(dir: &Path) -> CommandError {
    CommandError::new(
        format!("{}: the scene has no tree that can be read", dir.display()),
        "`brickfell check` says what is wrong with it",
    )
}

fn file_error(path: &Path, error: std::io::Error) -> CommandError {
    CommandError::new(
        format!("{}: {error}", path.display()),
        "is there room, and may you write there?",
    )
}

/// Makes the folder, or takes the files of an earlier flight out of it.
fn prepare_folder(folder: &Path) -> Result<(), CommandError> {
    std::fs::create_dir_all(folder).map_err(|e| file_error(folder, e))?;
    for entry in std::fs::read_dir(folder)
        .map_err(|e| file_error(folder, e))?
        .flatten()
    {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let frame = name.strip_prefix("frame_").and_then(|n| n.strip_suffix(".png"));
        if frame.is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit()))
            || ["report.json", "overview.png", video::NAME].contains(&&*name)
        {
            std::fs::remove_file(entry.path()).map_err(|e| file_error(&entry.path(), e))?;
        }
    }
    Ok(())
}

/// The box of what the trees' headers say is in them (their surface voxels), where they say it.
pub(crate) fn data_bounds(store: &dyn Store, trees: &[String]) -> Option<Aabb> {
    if trees.len() > HEADERS {
        return None;
    }
    trees
        .iter()
        .filter_map(|name| read_header(store, name).ok())
        .filter(|h| h.surface_bounds[0].cmplt(h.surface_bounds[1]).all())
        .filter_map(|h| {
            let [lo, hi] = h.surface_bounds.map(|p| h.origin + p.as_dvec3() * h.voxel_size);
            Aabb::new(lo, hi).ok()
        })
        .reduce(|a, b| a.union(&b))
}

impl Flying<'_> {
    fn camera(&self, t: f64) -> Result<Camera, CommandError> {
        let (eye, target): (DVec3, DVec3) = self.path.at(t);
        Ok(self.args.view.camera(eye, target)?)
    }

    /// Number of frames, and the time of frame k.
    fn schedule(&self) -> (usize, impl Fn(usize) -> f64 + use<>) {
        let duration = self.path.duration();
        let frames = match (self.args.frames, self.args.fps) {
            (Some(n), _) => n as usize,
            (None, Some(fps)) => (duration * fps).floor() as usize + 1,
            (None, None) => DEFAULT_FRAMES,
        };
        let step = match self.args.fps {
            Some(fps) => 1.0 / fps,
            None => duration / frames.max(2) as f64,
        };
        (frames, move |k| k as f64 * step)
    }

    fn fly_settled(&mut self) -> Result<(), CommandError> {
        let (frames, time) = self.schedule();
        self.bar.set_length(frames as u64);
        self.bar.set_message("flying");
        for index in 0..frames {
            let t = time(index);
            let camera = self.camera(t)?;
            let start = Instant::now();
            let (report, settle_frames) = self.renderer.settle(&camera, &self.settings)?;
            let settle_ms = start.elapsed().as_secs_f64() * 1e3;
            let picture = self.renderer.read_picture()?;
            self.keep(
                t,
                camera,
                &report,
                report.frame_ms,
                Some((settle_ms, settle_frames)),
                &picture,
            )?;
            self.pictures.push(picture);
        }
        Ok(())
    }

    fn fly_real_time(&mut self) -> Result<(), CommandError> {
        let duration = self.path.duration();
        let most = self.args.frames.map_or(usize::MAX, |n| n as usize);
        let pace = self.args.fps.map(|fps| Duration::from_secs_f64(1.0 / fps));
        self.bar.set_message("flying in real time");
        let start = Instant::now();
        let mut index = 0;
        while index < most {
            let t = start.elapsed().as_secs_f64();
            if t > duration && index > 0 {
                break;
            }
            let begin = Instant::now();
            let camera = self.camera(t)?;
            let report = self.renderer.frame(&camera, &self.settings)?;
            self.renderer.wait()?;
            let frame_ms = begin.elapsed().as_secs_f64() * 1e3;
            let picture = self.renderer.read_picture()?;
            self.keep(t, camera, &report, frame_ms, None, &picture)?;
            index += 1;
            if let Some(pace) = pace {
                std::thread::sleep((begin + pace).saturating_duration_since(Instant::now()));
            }
        }
        Ok(())
    }

    /// Writes a frame's picture and notes its figures.
    fn keep(
        &mut self,
        t: f64,
        camera: Camera,
        report: &FrameReport,
        frame_ms: f64,
        settled: Option<(f64, u32)>,
        picture: &Picture,
    ) -> Result<(), CommandError> {
        let index = self.entries.len();
        let image = over_sky(picture, &camera);
        let file = self.args.out.join(format!("frame_{index:04}.png"));
        image.save(&file).map_err(|e| file_error(&file, e))?;
        if self.images.len() < OVERVIEW_FRAMES {
            self.images.push(image);
        }
        if let (Some(trace), Some(file)) = (&mut self.trace, &self.args.trace) {
            let (stats, faults) = (self.renderer.pager_stats(), self.renderer.faults());
            // In real time only who waited knows how long the device took.
            let report = FrameReport { frame_ms, ..*report };
            (trace.frame(&report, &stats, faults)).map_err(|e| file_error(file, e))?;
        }
        let feedback = self.renderer.feedback();
        let c = &feedback.counters;
        for (sum, v) in [
            (&mut self.counters.rays_hit, c.rays_hit),
            (&mut self.counters.nodes, c.nodes),
            (&mut self.counters.samples, c.samples),
            (&mut self.counters.texture_reads, c.texture_reads),
            (&mut self.counters.capped, c.capped),
            (&mut self.counters.not_finite, c.not_finite),
        ] {
            *sum += v;
        }
        let read_before: u64 = self.entries.iter().map(|e| e.bytes_read).sum();
        self.entries.push(FrameEntry {
            index,
            t,
            frame_ms,
            settle_ms: settled.map(|s| s.0),
            settle_frames: settled.map_or(1, |s| s.1),
            merge_ms: report.merge_ms,
            cull_ms: report.cull_ms,
            upload_ms: report.upload_ms,
            readback_ms: report.readback_ms,
            submit_ms: report.submit_ms,
            gpu_upload_ms: feedback.gpu_ms[0],
            gpu_cast_ms: feedback.gpu_ms[1],
            gpu_compact_ms: feedback.gpu_ms[2],
            trees_visible: report.trees_visible,
            trees_active: report.trees_active,
            bricks_resident: report.bricks_resident,
            uploads: report.uploads,
            bytes_uploaded: report.bytes_uploaded,
            bytes_read: self.renderer.pager_stats().bytes_read.saturating_sub(read_before),
            requests: feedback.request_count,
            pending: report.pending,
            bias: report.bias,
            scale: report.scale,
            holes: None,
            nodes_per_ray: per_ray(c.nodes, c),
            samples_per_ray: per_ray(c.samples, c),
        });
        self.cameras.push(camera);
        self.bar.inc(1);
        Ok(())
    }

    fn report(&self, seconds: f64, trees_total: usize) -> Report {
        let pager = self.renderer.pager_stats();
        let frame_ms = Percentiles::of(self.entries.iter().map(|e| e.frame_ms));
        let cast_ms = Percentiles::of(self.entries.iter().map(|e| e.gpu_cast_ms)).p50;
        let (width, height) = self.args.view.size;
        let drawn = Percentiles::of(self.entries.iter().map(|e| e.scale * e.scale)).p50;
        let rays = f64::from(width) * f64::from(height) * drawn;
        let mean = |value: fn(&FrameEntry) -> f64| {
            self.entries.iter().map(value).sum::<f64>() / self.entries.len().max(1) as f64
        };
        let per_second = |ms: f64, count: f64| if ms > 0.0 { count * 1e3 / ms } else { 0.0 };
        let summary = Summary {
            frames: self.entries.len(),
            seconds,
            fps_median: per_second(frame_ms.p50, 1.0),
            frame_ms,
            target_ms: self.args.target_ms,
            within_target: self.args.target_ms.map(|target| {
                let within = self.entries.iter().filter(|e| e.frame_ms <= target).count();
                within as f64 / self.entries.len().max(1) as f64
            }),
            bias_mean: mean(|e| e.bias),
            scale_mean: mean(|e| e.scale),
            rays_per_second: per_second(if cast_ms > 0.0 { cast_ms } else { frame_ms.p50 }, rays),
            trees_total,
            trees_active_max: self.entries.iter().map(|e| e.trees_active).max().unwrap_or(0),
            bricks_resident_max: self.entries.iter().map(|e| e.bricks_resident).max().unwrap_or(0),
            brick_slots: self.renderer.brick_slots(),
            ram_bytes_peak: peak_rss(),
            cache_bytes_peak: pager.peak_bytes,
            gpu_bytes: self.renderer.gpu_bytes(),
            bytes_read: pager.bytes_read,
            bytes_uploaded: self.entries.iter().map(|e| e.bytes_uploaded).sum(),
            uploads: self.entries.iter().map(|e| e.uploads).sum(),
            requests_last_frame: self.entries.last().map_or(0, |e| e.requests),
            holes: None,
            nodes_per_ray: per_ray(self.counters.nodes, &self.counters),
            samples_per_ray: per_ray(self.counters.samples, &self.counters),
            texture_reads_per_ray: per_ray(self.counters.texture_reads, &self.counters),
            rays_capped: self.counters.capped,
            pixels_not_finite: self.counters.not_finite,
            adapter: self.renderer.device(),
            faults: self.renderer.faults().to_vec(),
        };
        Report {
            summary,
            frames: self.entries.clone(),
        }
    }

    /// Counts each settled picture's holes; `None` if the reference cannot read what it needs (a fault is noted then).
    fn count_holes(
        &self,
        store: &Arc<dyn Store>,
        report: &mut Report,
    ) -> Result<Option<usize>, CommandError> {
        if !report.summary.faults.is_empty() {
            // What is missing is known and named; the reference would fail on the same files.
            return Ok(None);
        }
        let reference = Reference::open(Arc::clone(store), &self.renderer.terrain().scene)?;
        self.bar.set_message("counting holes");
        self.bar.set_position(0);
        let mut total = 0;
        for (k, (picture, camera)) in self.pictures.iter().zip(&self.cameras).enumerate() {
            let settings = RenderSettings {
                bias: self.entries[k].bias,
                ..self.settings
            };
            let holes = count_holes(picture, &reference.render(camera, &settings)?.0);
            report.frames[k].holes = Some(holes);
            total += holes;
            self.bar.inc(1);
        }
        Ok(Some(total))
    }
}
