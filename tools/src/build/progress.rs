//! What a build tells while it runs.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use indicatif::{HumanBytes, HumanCount, ProgressBar, ProgressStyle};

use crate::report::peak_rss;

/// Told how far a build is, from any of its threads.
pub trait Progress: Sync {
    /// Work begins: so many tiles of trees, of which some belong to trees that were finished by an earlier run.
    fn start(&self, tiles: u64, finished: u64);
    /// So many more tiles are made, with so many surface voxels; none in those that an earlier run had made.
    fn tiles(&self, tiles: u64, voxels: u64);
    /// Everything is written.
    fn finish(&self);
}

/// Says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _: u64, _: u64) {}
    fn tiles(&self, _: u64, _: u64) {}
    fn finish(&self) {}
}

/// A bar on standard error with tiles, surface voxels, their rate, the memory in use and the time left.
#[derive(Debug, Default)]
pub struct IndicatifProgress {
    bar: Mutex<Option<ProgressBar>>,
    voxels: AtomicU64,
}

impl IndicatifProgress {
    fn with(&self, act: impl FnOnce(&ProgressBar)) {
        if let Ok(bar) = self.bar.lock()
            && let Some(bar) = bar.as_ref()
        {
            act(bar);
        }
    }
}

impl Progress for IndicatifProgress {
    fn start(&self, tiles: u64, finished: u64) {
        let template = "{bar:32} {pos}/{len} tiles  {msg}  {elapsed} gone, {eta} left";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(tiles).with_style(style).with_position(finished);
        bar.reset_eta();
        if let Ok(mut slot) = self.bar.lock() {
            *slot = Some(bar);
        }
    }

    fn tiles(&self, tiles: u64, voxels: u64) {
        let voxels = self.voxels.fetch_add(voxels, Ordering::Relaxed) + voxels;
        self.with(|bar| {
            let per_second = voxels as f64 / bar.elapsed().as_secs_f64().max(1e-3);
            bar.set_message(format!(
                "{} voxels ({:.2} M/s), {} at most",
                HumanCount(voxels),
                per_second / 1e6,
                HumanBytes(peak_rss()),
            ));
            bar.inc(tiles);
        });
    }

    fn finish(&self) {
        self.with(ProgressBar::finish);
    }
}
