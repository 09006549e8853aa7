//! What culler and pager did in each frame of a flight, as a trace for Chrome's `about:tracing` and Perfetto.
//!
//! The file is the JSON of the Trace Event Format: a complete event (`X`) per frame with its stages inside, counters
//! (`C`) beside it, and an instant event (`i`) per fault. Written frame by frame, so that it may be larger than memory; one
//! that was cut off lacks its end, which the viewers forgive. `docs/paging.md` says what the counters mean. Render thread.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use brickfell_pager::PagerStats;
use brickfell_runtime::renderer::FrameReport;
use serde::Serialize;
use serde_json::json;

/// The names of the counters, shared with who reads them.
pub(crate) mod counter {
    /// Pages of the frame by what became of them.
    pub(crate) const PAGES: &str = "pages";
    /// Bytes of the pages published in the frame, by what they were wanted for.
    pub(crate) const LOADED: &str = "loaded bytes";
    /// Bytes held at the end of the frame, by what for.
    pub(crate) const HELD: &str = "held bytes";
    /// Pages at the end of the frame by where they are on their way.
    pub(crate) const QUEUE: &str = "queue";
    /// Trees of the frame.
    pub(crate) const TREES: &str = "trees";
    /// Bias on the footprint.
    pub(crate) const BIAS: &str = "bias";
}

/// Name of the events of frames, and of those of faults.
pub(crate) const FRAME: &str = "frame";
pub(crate) const FAULT: &str = "fault";

/// An event of the format.
#[derive(Serialize)]
struct Event<'a, A: Serialize> {
    name: &'a str,
    ph: &'static str,
    /// Microseconds.
    ts: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<f64>,
    pid: u32,
    tid: u32,
    args: A,
}

/// A trace that is being written.
#[derive(Debug)]
pub(crate) struct Trace {
    out: BufWriter<File>,
    start: Instant,
    any: bool,
    faults: usize,
    before: PagerStats,
}

impl Trace {
    /// Begins a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        let mut out = BufWriter::new(File::create(path)?);
        out.write_all(b"{\"displayTimeUnit\":\"ms\",\"traceEvents\":[")?;
        Ok(Self {
            out,
            start: Instant::now(),
            any: false,
            faults: 0,
            before: PagerStats::default(),
        })
    }

    fn event(
        &mut self,
        name: &str,
        ph: &'static str,
        ts: f64,
        dur: Option<f64>,
        args: impl Serialize,
    ) -> io::Result<()> {
        self.out.write_all(if self.any { b",\n" } else { b"\n" })?;
        self.any = true;
        let event = Event {
            name,
            ph,
            ts,
            dur,
            pid: 1,
            tid: 1,
            args,
        };
        serde_json::to_writer(&mut self.out, &event).map_err(io::Error::from)
    }

    /// Writes a frame that has just ended, with all faults so far.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn frame(
        &mut self,
        report: &FrameReport,
        stats: &PagerStats,
        faults: &[String],
    ) -> io::Result<()> {
        let end = self.start.elapsed().as_secs_f64() * 1e6;
        // A picture that took no device time to wait for has the time of the call.
        let duration = report.frame_ms.max(report.cpu_ms) * 1e3;
        let begin = (end - duration).max(0.0);
        let index = report.frame;
        let row =
            json!({ "frame": index, "bias": report.bias, "scale": report.scale, "ms": duration * 1e-3 });
        self.event(FRAME, "X", begin, Some(duration), row)?;
        let mut at = begin;
        for (name, ms) in [
            ("readback", report.readback_ms),
            ("merge", report.merge_ms),
            ("cull", report.cull_ms),
            ("upload", report.upload_ms),
            ("submit", report.submit_ms),
        ] {
            self.event(name, "X", at, Some(ms * 1e3), json!({ "frame": index }))?;
            at += ms * 1e3;
        }
        let before = std::mem::replace(&mut self.before, *stats);
        let (loaded, loaded_before) = (stats.loaded_bytes, before.loaded_bytes);
        let pages = json!({
            "requested": stats.requested - before.requested,
            "loaded": stats.loads - before.loads,
            "cancelled": stats.cancelled - before.cancelled,
            "evicted": stats.evicted - before.evicted,
            "failed": stats.failed - before.failed,
        });
        let bytes = json!({
            "roots": loaded.roots - loaded_before.roots,
            "levels": loaded.levels - loaded_before.levels,
            "chunks": loaded.chunks - loaded_before.chunks,
            "ahead": loaded.ahead - loaded_before.ahead,
            "read": stats.bytes_read - before.bytes_read,
        });
        let in_use = stats.pinned_bytes + stats.used_bytes;
        let held = json!({
            "pinned": stats.pinned_bytes,
            "used": stats.used_bytes,
            "ahead": stats.ahead_bytes,
            "kept": stats.resident_bytes.saturating_sub(in_use + stats.ahead_bytes),
            "arriving": stats.arriving_bytes,
            "leaving": stats.leaving_bytes,
        });
        let queue = json!({
            "queued": stats.queued,
            "deferred": stats.deferred,
            "loading": stats.loading,
            "ready": stats.ready + stats.held,
        });
        let trees = json!({
            "visible": report.trees_visible,
            "drawn": report.trees_active,
            "waiting": report.trees_waiting,
        });
        for (name, args) in [
            (counter::PAGES, pages),
            (counter::LOADED, bytes),
            (counter::HELD, held),
            (counter::QUEUE, queue),
            (counter::TREES, trees),
            (counter::BIAS, json!({ "bias": report.bias })),
        ] {
            self.event(name, "C", begin, None, args)?;
        }
        for fault in faults.iter().skip(self.faults) {
            self.event(FAULT, "i", end, None, json!({ "message": fault }))?;
        }
        self.faults = faults.len();
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.out.write_all(b"\n]}\n")?;
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn frames_have_what_happened_in_them_and_stages_inside() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut trace = Trace::create(file.path()).unwrap();
        let report = FrameReport {
            frame: 4,
            merge_ms: 1.0,
            cull_ms: 2.0,
            cpu_ms: 5.0,
            bias: -0.5,
            scale: 0.5,
            trees_visible: 7,
            ..FrameReport::default()
        };
        let mut stats = PagerStats {
            requested: 10,
            loads: 3,
            bytes_read: 900,
            resident_bytes: 100,
            pinned_bytes: 30,
            used_bytes: 20,
            ahead_bytes: 10,
            ..PagerStats::default()
        };
        trace.frame(&report, &stats, &[]).unwrap();
        (stats.requested, stats.evicted) = (12, 5);
        trace
            .frame(&report, &stats, &["a \"bad\" file".to_owned()])
            .unwrap();
        trace.finish().unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let value: Value = serde_json::from_str(&text).unwrap();
        let events = value["traceEvents"].as_array().unwrap();
        let named = |name: &str| events.iter().filter(|e| e["name"] == name).collect::<Vec<_>>();
        let pages = named(counter::PAGES);
        assert_eq!(
            (&pages[0]["args"]["requested"], &pages[1]["args"]["requested"]),
            (&json!(10), &json!(2))
        );
        assert_eq!(
            (&pages[1]["args"]["loaded"], &pages[1]["args"]["evicted"]),
            (&json!(0), &json!(5))
        );
        assert_eq!(named(counter::HELD)[0]["args"]["kept"], 40);
        let (frame, cull) = (named(FRAME)[0], named("cull")[0]);
        let at = |event: &Value, key: &str| event[key].as_f64().unwrap();
        let row = json!({ "frame": 4, "bias": -0.5, "scale": 0.5, "ms": 5.0 });
        assert_eq!(frame["args"], row);
        assert!(at(frame, "dur") == 5000.0 && at(cull, "dur") == 2000.0);
        assert_eq!(at(cull, "ts"), at(named("merge")[0], "ts") + 1000.0);
        assert_eq!(named(FAULT).len(), 1);
        assert_eq!(named(FAULT)[0]["args"]["message"], "a \"bad\" file");
    }
}
