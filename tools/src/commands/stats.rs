//! `brickfell stats`: a trace of `fly --trace` in a few lines.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use indicatif::{HumanBytes, HumanCount};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Map, Value};

use super::CommandError;
use super::database::print;
use crate::report::Percentiles;
use crate::trace::{FAULT, FRAME, counter};

/// Arguments of `stats`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The trace that `fly --trace` wrote
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Print JSON: frames, seconds, stages_ms, pages, loaded_bytes, held_bytes_most, queue_most, trees_most, longest, faults
    #[arg(long)]
    pub json: bool,
}

/// The file, as far as it is looked at.
#[derive(Deserialize)]
struct File {
    #[serde(rename = "traceEvents")]
    events: Vec<Event>,
}

#[derive(Deserialize)]
struct Event {
    name: String,
    ph: String,
    ts: f64,
    #[serde(default)]
    dur: f64,
    #[serde(default)]
    args: Map<String, Value>,
}

/// Runs the command.
///
/// # Errors
/// A file that cannot be read or is not such a trace.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let fail = |e: &dyn std::fmt::Display| {
        CommandError::new(
            format!("{}: {e}", args.file.display()),
            "`brickfell fly DIR --out OUT --trace FILE` writes one",
        )
    };
    let bytes = std::fs::read(&args.file).map_err(|e| fail(&e))?;
    let file: File = serde_json::from_slice(&bytes).map_err(|e| fail(&e))?;
    if !file.events.iter().any(|e| e.name == FRAME && e.ph == "X") {
        return Err(fail(&"it has no frame"));
    }
    let summary = summary(&file.events);
    print(&match args.json {
        true => serde_json::to_string_pretty(&summary)? + "\n",
        false => describe(&summary),
    })?;
    Ok(ExitCode::SUCCESS)
}

/// Sums, or largest values, of a counter's series over all frames.
fn series(events: &[Event], name: &str, join: fn(f64, f64) -> f64) -> BTreeMap<String, f64> {
    let mut all = BTreeMap::new();
    for event in events.iter().filter(|e| e.ph == "C" && e.name == name) {
        for (key, value) in &event.args {
            let so_far = all.entry(key.clone()).or_insert(0.0);
            *so_far = join(*so_far, value.as_f64().unwrap_or(0.0));
        }
    }
    all
}

fn listed(series: &BTreeMap<String, f64>, show: fn(f64) -> String) -> String {
    let parts: Vec<String> = series
        .iter()
        .map(|(key, value)| format!("{} {key}", show(*value)))
        .collect();
    parts.join(", ")
}

/// What a trace says in sum.
#[derive(Serialize)]
struct Summary<'e> {
    frames: usize,
    seconds: f64,
    /// Times of stages, milliseconds, by their names.
    #[serde(serialize_with = "as_map")]
    stages_ms: Vec<(&'static str, Percentiles)>,
    pages: BTreeMap<String, f64>,
    loaded_bytes: BTreeMap<String, f64>,
    held_bytes_most: BTreeMap<String, f64>,
    queue_most: BTreeMap<String, f64>,
    trees_most: BTreeMap<String, f64>,
    longest: Option<Longest>,
    faults: Vec<&'e str>,
}

fn as_map<S: Serializer>(stages: &[(&'static str, Percentiles)], to: S) -> Result<S::Ok, S::Error> {
    to.collect_map(stages.iter().map(|(name, times)| (name, times)))
}

/// The longest frame.
#[derive(Serialize)]
struct Longest {
    frame: u64,
    ms: f64,
    /// Seconds into the flight.
    at: f64,
}

fn summary(events: &[Event]) -> Summary<'_> {
    let frames: Vec<&Event> = events.iter().filter(|e| e.ph == "X" && e.name == FRAME).collect();
    let begin = frames.iter().map(|e| e.ts).fold(f64::INFINITY, f64::min);
    let end = frames.iter().map(|e| e.ts + e.dur).fold(0.0, f64::max);
    let stage = |stage: &'static str| {
        let times = events.iter().filter(|e| e.ph == "X" && e.name == stage);
        (stage, Percentiles::of(times.map(|e| e.dur * 1e-3)))
    };
    let sum = |name| series(events, name, |a, b| a + b);
    let most = |name| series(events, name, f64::max);
    let longest = frames.iter().max_by(|a, b| a.dur.total_cmp(&b.dur));
    let faults = events.iter().filter(|e| e.name == FAULT);
    Summary {
        frames: frames.len(),
        seconds: (end - begin).max(0.0) * 1e-6,
        stages_ms: [FRAME, "readback", "merge", "cull", "upload", "submit"]
            .map(stage)
            .into(),
        pages: sum(counter::PAGES),
        loaded_bytes: sum(counter::LOADED),
        held_bytes_most: most(counter::HELD),
        queue_most: most(counter::QUEUE),
        trees_most: most(counter::TREES),
        longest: longest.map(|longest| Longest {
            frame: longest.args.get("frame").and_then(Value::as_u64).unwrap_or(0),
            ms: longest.dur * 1e-3,
            at: (longest.ts - begin) * 1e-6,
        }),
        faults: faults
            .map(|fault| {
                fault
                    .args
                    .get("message")
                    .and_then(Value::as_str)
                    .unwrap_or_default()
            })
            .collect(),
    }
}

/// The summary for people.
fn describe(summary: &Summary) -> String {
    let bytes = |v: f64| HumanBytes(v as u64).to_string();
    let count = |v: f64| HumanCount(v as u64).to_string();
    let mut text = String::new();
    let _ = writeln!(text, "{} frames in {:.1} s", summary.frames, summary.seconds);
    for (stage, p) in &summary.stages_ms {
        let _ = writeln!(
            text,
            "  {stage:<9} ms: median {:.3}, 95 % {:.3}, 99 % {:.3}, most {:.3}",
            p.p50, p.p95, p.p99, p.max
        );
    }
    let _ = writeln!(text, "pages:        {}", listed(&summary.pages, count));
    let _ = writeln!(text, "loaded:       {}", listed(&summary.loaded_bytes, bytes));
    let _ = writeln!(text, "held at most: {}", listed(&summary.held_bytes_most, bytes));
    let _ = writeln!(text, "queue, most:  {}", listed(&summary.queue_most, count));
    let _ = writeln!(text, "trees, most:  {}", listed(&summary.trees_most, count));
    if let Some(Longest { frame, ms, at }) = &summary.longest {
        let _ = writeln!(
            text,
            "longest frame: {frame}, {ms:.3} ms, {at:.2} s into the flight"
        );
    }
    for fault in &summary.faults {
        let _ = writeln!(text, "fault: {fault}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_summed_or_their_most_is_taken() {
        let text = r#"[
            {"name":"frame","ph":"X","ts":0,"dur":10000,"args":{"frame":1}},
            {"name":"frame","ph":"X","ts":470000,"dur":30000,"args":{"frame":2}},
            {"name":"pages","ph":"C","ts":0,"args":{"loaded":3,"evicted":0}},
            {"name":"pages","ph":"C","ts":1,"args":{"loaded":4,"evicted":2}},
            {"name":"held bytes","ph":"C","ts":1,"args":{"used":2048}},
            {"name":"held bytes","ph":"C","ts":2,"args":{"used":1024}},
            {"name":"fault","ph":"i","ts":5,"args":{"message":"x: broken"}}]"#;
        let events: Vec<Event> = serde_json::from_str(text).unwrap();
        let summary = describe(&summary(&events));
        for line in [
            "2 frames in 0.5 s",
            "frame     ms: median 10.000, 95 % 30.000",
            "pages:        2 evicted, 7 loaded",
            "held at most: 2.00 KiB used",
            "longest frame: 2, 30.000 ms, 0.47 s into the flight",
            "fault: x: broken",
        ] {
            assert!(summary.contains(line), "{line} in\n{summary}");
        }
    }
}
