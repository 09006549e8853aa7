//! What is said beside results, on standard error: notes and progress. `--quiet` and an output that is no terminal have no progress,
//! `--quiet` has no notes either.
//!
//! Any thread; set once, before a command runs.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};

static QUIET: AtomicBool = AtomicBool::new(false);

/// From now on nothing is said but results, warnings and errors.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether it is so.
pub(crate) fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Says something that is good to know.
pub(crate) fn note(text: impl Display) {
    if !is_quiet() {
        eprintln!("note: {text}");
    }
}

/// A bar of a length, gone when it is dropped.
pub(crate) fn bar(length: u64, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = match is_quiet() {
        true => ProgressBar::hidden(),
        false => ProgressBar::new(length),
    };
    bar.with_style(style).with_finish(ProgressFinish::AndClear)
}

/// A sign of life for work whose length is not known, gone when it is dropped.
pub(crate) fn spinner(doing: &'static str) -> ProgressBar {
    let bar = bar(0, "{spinner} {msg}, {elapsed}").with_message(doing);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
