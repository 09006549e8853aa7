//! Suite `effort`: a flight over the hills at full effort, and once more with half the time for a frame.
//!
//! Cameras follow from the number of the frame, not from the clock, so that both flights see the same and what
//! differs from one picture to the next can be compared. All bricks are there before.

use std::time::Instant;

use brickfell_culler::Camera;
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::settings::RenderSettings;
use glam::DVec3;
use serde_json::json;

use super::caster::{SCENE, open, renderer};
use super::scenes::HILLS_SIZE;
use super::{Row, Settings, row};
use crate::commands::{CommandError, open_gpu};
use crate::metrics::{LinearImage, PIXELS_PER_DEGREE, flip};
use crate::picture_file::linear_over_sky;
use crate::report::Percentiles;

const SIZE: (u32, u32) = (400, 300);
/// Part of the time at full effort that a frame may take.
const PART: f64 = 0.5;
/// Metres from frame to frame.
const STEP: f64 = 0.05;

/// Above the hills, 35° down, in a slow bend.
fn camera(frame: usize) -> Result<Camera, CommandError> {
    let way = STEP * frame as f64;
    let bend = (way * 0.08).sin();
    let eye = DVec3::new(0.5 * HILLS_SIZE + 6.0 * bend, 0.12 * HILLS_SIZE + way, 38.0);
    let (sin, cos) = 35f64.to_radians().sin_cos();
    let ahead = DVec3::new(0.2 * bend, cos, -sin);
    Ok(Camera::look_at(eye, eye + ahead, 60.0, SIZE.0, SIZE.1)?)
}

/// What was seen of a flight.
#[derive(Default)]
struct Flown {
    ms: Vec<f64>,
    bias: Vec<f64>,
    scale: Vec<f64>,
    /// Mean FLIP from each picture to the next.
    steps: Vec<f64>,
}

impl Flown {
    fn fly(renderer: &mut Renderer, render: &RenderSettings, frames: usize) -> Result<Self, CommandError> {
        let mut flown = Self::default();
        let mut before: Option<LinearImage> = None;
        for frame in 0..frames {
            let camera = camera(frame)?;
            let start = Instant::now();
            let report = renderer.frame(&camera, render)?;
            renderer.wait()?;
            flown.ms.push(start.elapsed().as_secs_f64() * 1e3);
            flown.bias.push(report.bias);
            flown.scale.push(report.scale);
            let picture = linear_over_sky(&renderer.read_picture()?, &camera);
            if let Some(before) = before.replace(picture.clone()) {
                let map = flip(&before, &picture, PIXELS_PER_DEGREE)?;
                let sum: f64 = map.iter().map(|f| f64::from(*f)).sum();
                flown.steps.push(sum / map.len() as f64);
            }
        }
        Ok(flown)
    }

    fn row(&self, setting: &str, backend: &str, target_ms: f64) -> Result<Row, CommandError> {
        let frames = self.ms.len();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / frames as f64;
        let changes = |values: &[f64]| values.windows(2).filter(|w| w[0] != w[1]).count();
        let seconds = self.ms.iter().sum::<f64>() * 1e-3;
        let ms = Percentiles::of(self.ms.iter().copied());
        let steps = Percentiles::of(self.steps.iter().copied());
        let within = self.ms.iter().filter(|ms| **ms <= target_ms).count();
        row(json!({
            "scene": SCENE,
            "setting": setting,
            "backend": backend,
            "width": SIZE.0,
            "height": SIZE.1,
            "frames": frames,
            "target_ms": target_ms,
            "percent_within": 100.0 * within as f64 / frames as f64,
            "ms_median": ms.p50,
            "ms_p95": ms.p95,
            "bias_mean": mean(&self.bias),
            "scale_mean": mean(&self.scale),
            "changes_per_second": changes(&self.bias) as f64 / seconds,
            "scale_changes": changes(&self.scale),
            "flip_median": steps.p50,
            "flip_max": steps.max,
            "flip_spike": spike(&self.steps),
        }))
    }
}

/// The largest change in terms of the median of those within two frames of it.
fn spike(steps: &[f64]) -> f64 {
    let ratio = |k: usize| {
        let around = &steps[k.saturating_sub(2)..(k + 3).min(steps.len())];
        steps[k] / Percentiles::of(around.iter().copied()).p50
    };
    (0..steps.len()).map(ratio).fold(0.0, f64::max)
}

/// Suite `effort`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let frames = if settings.quick { 60 } else { 240 };
    let (store, terrain) = open(settings)?;
    let mut renderer = renderer(open_gpu()?.into(), store, terrain)?;
    let full = RenderSettings::default();
    for frame in (0..frames).step_by(20).chain([0]) {
        renderer.settle(&camera(frame)?, &full)?;
    }
    let fixed = Flown::fly(&mut renderer, &full, frames)?;
    let target_ms = PART * Percentiles::of(fixed.ms.iter().copied()).p50;
    renderer.settle(&camera(0)?, &full)?;
    let render = RenderSettings {
        target_ms: Some(target_ms),
        ..full
    };
    let adaptive = Flown::fly(&mut renderer, &render, frames)?;
    let backend = renderer.backend();
    Ok(vec![
        fixed.row("full effort", &backend, target_ms)?,
        adaptive.row("half the time", &backend, target_ms)?,
    ])
}
