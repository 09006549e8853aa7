//! `report.json`: what a flight measured. `docs/architecture.md` says what each figure means.

use brickfell_runtime::picture::RayCounters;
use serde::Serialize;

/// A flight.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Over the whole flight.
    pub summary: Summary,
    /// One entry a frame.
    pub frames: Vec<FrameEntry>,
}

/// Percentiles of a time, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95 of 100 are below.
    pub p95: f64,
    /// 99 of 100 are below.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Of some values; nearest rank.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let rank = |q: f64| {
            let k = (q * sorted.len() as f64).ceil() as usize;
            sorted.get(k.saturating_sub(1)).copied().unwrap_or(0.0)
        };
        Self {
            p50: rank(0.5),
            p95: rank(0.95),
            p99: rank(0.99),
            max: rank(1.0),
        }
    }
}

/// Figures of the whole flight.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Frames written.
    pub frames: usize,
    /// Wall time of the flight, pictures being written included.
    pub seconds: f64,
    /// 1000 / the median of `frame_ms`.
    pub fps_median: f64,
    /// Wall time of a frame, from its begin to the device's end; settled: of the frame that was kept.
    pub frame_ms: Percentiles,
    /// What a frame was to take; `null` without `--target-ms`.
    pub target_ms: Option<f64>,
    /// Part of the frames whose `frame_ms` is not above that.
    pub within_target: Option<f64>,
    /// Mean of the frames' bias.
    pub bias_mean: f64,
    /// Mean of the frames' scale.
    pub scale_mean: f64,
    /// Rays of the median picture over the median time that the device cast.
    pub rays_per_second: f64,
    /// Trees of the scene.
    pub trees_total: usize,
    /// Most trees drawn in a frame.
    pub trees_active_max: usize,
    /// Most bricks in the pool.
    pub bricks_resident_max: u32,
    /// Brick slots of the pool.
    pub brick_slots: u32,
    /// Most RAM of the process while flying (the check for holes comes after).
    pub ram_bytes_peak: u64,
    /// Most RAM of the pager.
    pub cache_bytes_peak: u64,
    /// Bytes on the device.
    pub gpu_bytes: u64,
    /// Bytes read from the database.
    pub bytes_read: u64,
    /// Bytes sent to the device.
    pub bytes_uploaded: u64,
    /// Bricks sent to the device.
    pub uploads: usize,
    /// Requests that the rays of the last frame made.
    pub requests_last_frame: u32,
    /// Holes against the CPU reference, all frames; `null` where it was not asked for.
    pub holes: Option<usize>,
    /// Node reads per ray that hits.
    pub nodes_per_ray: f64,
    /// Sample positions per ray that hits.
    pub samples_per_ray: f64,
    /// Texture reads per ray that hits.
    pub texture_reads_per_ray: f64,
    /// Rays stopped by the step cap.
    pub rays_capped: u64,
    /// Pixels that were not finite.
    pub pixels_not_finite: u64,
    /// The device.
    pub adapter: String,
    /// What could not be read, one line each.
    pub faults: Vec<String>,
}

/// Figures of one frame. Times in milliseconds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FrameEntry {
    /// Number in the flight, from 0.
    pub index: usize,
    /// Seconds into the path.
    pub t: f64,
    /// Wall time of the frame.
    pub frame_ms: f64,
    /// Wall time until the picture was settled; `null` in real time.
    pub settle_ms: Option<f64>,
    /// Frames drawn until it was settled.
    pub settle_frames: u32,
    /// Publishing finished loads.
    pub merge_ms: f64,
    /// Culling and ordering.
    pub cull_ms: f64,
    /// Making resident and staging uploads.
    pub upload_ms: f64,
    /// Taking read-backs.
    pub readback_ms: f64,
    /// Encoding and submitting.
    pub submit_ms: f64,
    /// Uploads on the device.
    pub gpu_upload_ms: f64,
    /// Casting on the device.
    pub gpu_cast_ms: f64,
    /// Compacting on the device.
    pub gpu_compact_ms: f64,
    /// Trees in view.
    pub trees_visible: usize,
    /// Trees drawn.
    pub trees_active: usize,
    /// Bricks in the pool.
    pub bricks_resident: u32,
    /// Bricks sent.
    pub uploads: usize,
    /// Bytes sent.
    pub bytes_uploaded: u64,
    /// Bytes read from the database.
    pub bytes_read: u64,
    /// Requests of the frame's rays.
    pub requests: u32,
    /// Pages asked for and not there.
    pub pending: usize,
    /// Footprint bias in effect.
    pub bias: f64,
    /// Part of the pixels per axis that were drawn.
    pub scale: f64,
    /// Holes against the CPU reference.
    pub holes: Option<usize>,
    /// Node reads per ray that hits.
    pub nodes_per_ray: f64,
    /// Sample positions per ray that hits.
    pub samples_per_ray: f64,
}

/// A count per ray that hits; 0 where none does.
pub fn per_ray(count: u64, counters: &RayCounters) -> f64 {
    if counters.rays_hit == 0 {
        0.0
    } else {
        count as f64 / counters.rays_hit as f64
    }
}

/// Most RAM the process has had so far, bytes; 0 where the system does not say.
pub fn peak_rss() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kilobytes = line
        .and_then(|l| l.split_whitespace().next())
        .and_then(|v| v.parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let p = Percentiles::of((1..=100).rev().map(f64::from));
        assert_eq!(
            p,
            Percentiles {
                p50: 50.0,
                p95: 95.0,
                p99: 99.0,
                max: 100.0
            }
        );
        assert_eq!(Percentiles::of([7.0]).p50, 7.0);
        assert_eq!(Percentiles::of([]).max, 0.0);
    }
}
