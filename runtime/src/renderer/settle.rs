//! Settling: frames until a picture has all that it asks for. Here, and only here, the render thread waits.

use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_culler::Camera;

use super::{FrameReport, Prepared, Renderer, ms};
use crate::error::RuntimeError;
use crate::memory::MAX_UPLOAD_BRICKS;
use crate::node_lists::ActiveTree;
use crate::raster::Raster;
use crate::settings::RenderSettings;

/// Most frames that a picture may take to settle.
const SETTLE_LIMIT: u32 = 600;
/// Pixels per axis of which one is drawn while a picture settles: a brick's voxels are about a pixel wide, so bricks are
/// seldom missed.
const PROBE_STRIDE: u32 = 4;
/// Requests below which whole pictures find what is missing sooner than probes do.
const PROBE_REQUESTS: usize = 256;
/// Most probes: in pools that are too small they do not see all that is in use, and take turns to throw it out.
const MAX_PROBES: u32 = 16;
/// Most rounds of loading between two pictures while settling.
const MAX_ROUNDS: usize = 64;
/// Longest wait for a load at a time, while settling.
const LOAD_WAIT: Duration = Duration::from_millis(200);

/// What was sent to the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Uploads {
    bricks: usize,
    nodes: usize,
    bytes: u64,
}

impl std::ops::AddAssign for Uploads {
    fn add_assign(&mut self, other: Self) {
        self.bricks += other.bricks;
        self.nodes += other.nodes;
        self.bytes += other.bytes;
    }
}

impl Renderer {
    /// Draws frames until one is settled: two in a row that were read back without a request, load or upload and with an
    /// unchanged bias. Returns the last one's report and the number of frames. What is loaded, and into which slots, follows
    /// from the pictures settled so far alone, so a flight that is flown again gives the same bits.
    ///
    /// # Errors
    /// If the picture does not settle, or as [`Self::frame`].
    pub fn settle(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(FrameReport, u32), RuntimeError> {
        settings.check(camera).map_err(RuntimeError::Argument)?;
        // A still picture is drawn in full.
        let settings = &RenderSettings {
            target_ms: None,
            ..*settings
        };
        let mut quiet = 0;
        let mut total = Uploads::default();
        // What is missing is found by a fraction of the rays; whole pictures confirm it.
        let mut stride = PROBE_STRIDE;
        for frames in 1..=SETTLE_LIMIT {
            let (mut prepared, uploads) = self.prepare_all(camera, settings)?;
            total += uploads;
            let start = prepared.start;
            let all_asked = self.request_share == 1;
            prepared.raster = Raster::probe(camera, self.frame, stride);
            let mut report = self.draw(camera, settings, prepared)?;
            self.backend.wait()?;
            report.frame_ms = ms(start);
            self.absorb_frame();
            self.processors.wait_idle();
            // The next frame's list is made of this frame's requests: that it is calm, too, says that they were none, or
            // only of pages that were given up.
            let calm = uploads == Uploads::default()
                && all_asked
                && !self.feedback.is_truncated()
                && report.pending == 0
                && report.trees_waiting == 0
                && settings.bias + self.bias.extra() == report.bias
                && !self.bias.is_waiting();
            quiet = if calm { quiet + 1 } else { 0 };
            let asked = if self.feedback.is_truncated() {
                usize::MAX
            } else {
                self.feedback.requests.len()
            };
            if stride > 1 && (calm || frames == MAX_PROBES || asked < PROBE_REQUESTS) {
                (stride, quiet) = (1, 0);
            }
            if quiet >= 2 {
                (report.uploads, report.node_updates, report.bytes_uploaded) =
                    (total.bricks, total.nodes, total.bytes);
                return Ok((report, frames));
            }
        }
        Err(RuntimeError::NotSettled {
            frames: SETTLE_LIMIT,
            pending: self.pending,
        })
    }

    /// Prepares a frame and waits for what it asked for, as often as that makes more ready: what is known to be missing
    /// comes before another picture is drawn. For settling only.
    fn prepare_all(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Prepared, Uploads), RuntimeError> {
        let mut uploads = Uploads::default();
        for _ in 0..MAX_ROUNDS {
            let prepared = self.prepare(camera, settings, MAX_UPLOAD_BRICKS)?;
            let report = &prepared.report;
            uploads += Uploads {
                bricks: report.uploads,
                nodes: report.node_updates,
                bytes: report.bytes_uploaded,
            };
            if self.pager.is_idle() && !self.pool.upload_is_full() {
                return Ok((prepared, uploads));
            }
            self.backend.flush();
            // Until nothing is under way; what failed is asked for again in the next round.
            let mut stats = self.pager.stats();
            while stats.queued + stats.loading + stats.ready > 0 {
                self.pager.wait_for_progress(LOAD_WAIT);
                self.merge();
                stats = self.pager.stats();
            }
            self.pager.wait_for_progress(LOAD_WAIT);
            self.resolve_again();
        }
        Ok((self.prepare(camera, settings, MAX_UPLOAD_BRICKS)?, uploads))
    }

    /// Takes the read-back of the frame that the device has just finished. It is there, unless another thread that polls the same
    /// device is about to say so.
    fn absorb_frame(&mut self) {
        let start = Instant::now();
        self.absorb(true);
        while self.in_flight.iter().any(|f| f.frame == self.frame) && start.elapsed() < LOAD_WAIT {
            std::thread::yield_now();
            self.absorb(true);
        }
    }

    /// Resolves the last requests once more with the levels that are in RAM by now.
    fn resolve_again(&mut self) {
        self.feedback_trees = self
            .feedback_trees
            .iter()
            .map(|active| {
                let state = self.pager.tree(active.tree).unwrap_or(&active.state);
                ActiveTree {
                    tree: active.tree,
                    state: Arc::clone(state),
                }
            })
            .collect();
        self.submit_requests();
        self.processors.wait_idle();
    }
}
