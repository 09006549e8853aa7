//! What a build tells while it runs.

use std::sync::Mutex;

use indicatif::{HumanCount, ProgressBar, ProgressState, ProgressStyle};

/// Told how far a build is, from the thread that called it.
pub trait Progress: Sync {
    /// Work begins: so many trees, of which some were finished by an earlier run.
    fn start(&self, trees: u64, finished: u64);
    /// A tree is finished; `voxels` surface voxels were made by this run so far.
    fn tree(&self, voxels: u64);
    /// Everything is written.
    fn finish(&self);
}

/// Says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _: u64, _: u64) {}
    fn tree(&self, _: u64) {}
    fn finish(&self) {}
}

/// A bar on standard error with trees, surface voxels, their rate and the time left.
#[derive(Debug, Default)]
pub struct IndicatifProgress {
    bar: Mutex<Option<ProgressBar>>,
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
    fn start(&self, trees: u64, finished: u64) {
        let rate = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = write!(out, "{:.1} trees/s", state.per_sec());
        };
        let template = "{bar:32} {pos}/{len} trees  {msg}  {rate}  {elapsed} gone, {eta} left";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(trees)
            .with_style(style.with_key("rate", rate))
            .with_position(finished);
        bar.reset_eta();
        if let Ok(mut slot) = self.bar.lock() {
            *slot = Some(bar);
        }
    }

    fn tree(&self, voxels: u64) {
        self.with(|bar| {
            let per_second = voxels as f64 / bar.elapsed().as_secs_f64().max(1e-3);
            bar.set_message(format!(
                "{} voxels ({:.2} M/s)",
                HumanCount(voxels),
                per_second / 1e6
            ));
            bar.inc(1);
        });
    }

    fn finish(&self) {
        self.with(ProgressBar::finish);
    }
}
