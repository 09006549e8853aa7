//! Suite `pager-rates`: what the pager's parts cost by themselves. Rows {measure, value, unit}.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_culler::TreeId;
use brickfell_formats::FormatError;
use brickfell_formats::bricks::{self, BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::Encoding;
use brickfell_formats::morton;
use brickfell_pager::queue::{Queue, Urgency, Verdict};
use brickfell_pager::{
    Fault, FolderStore, MemoryStore, PageKey, Pager, PagerConfig, ProceduralConfig, ProceduralStore, Store,
};
use brickfell_runtime::terrain::Terrain;
use serde_json::json;

use super::super::{Row, Settings, row};
use crate::commands::CommandError;

/// Jobs in the queue.
const JOBS: u32 = 10_000;
/// Depth of the trees, whose deepest level is read, and how many there are per axis.
const DEPTH: u8 = 5;
const TREES: u32 = 4;
/// What the render thread does between two frames: something else.
const FRAME: Duration = Duration::from_millis(8);
const PATIENCE: Duration = Duration::from_secs(60);

fn figure(measure: &str, value: f64, unit: &str) -> Result<Row, CommandError> {
    row(json!({ "measure": measure, "value": value, "unit": unit }))
}

/// Microseconds to take the next of many jobs, of a hundred files one of which is blocked.
fn take_next() -> f64 {
    let jobs = (0..JOBS).map(|k| {
        let urgency = Urgency {
            class: 1,
            priority: f64::from(k.wrapping_mul(2_654_435_761)),
            order: 0,
            slot: k,
        };
        (urgency, u64::from(k % 100), k)
    });
    let mut queue = Queue::new(jobs);
    let start = Instant::now();
    let mut taken = 0;
    while queue
        .take(|file, _| {
            if file == 7 {
                Verdict::SkipFile
            } else {
                Verdict::Take
            }
        })
        .is_some()
    {
        taken += 1;
    }
    start.elapsed().as_secs_f64() * 1e6 / f64::from(taken)
}

/// Frames until nothing of what is wanted is under way.
fn settle(pager: &mut Pager, frame: &mut u64, wants: &[PageKey]) -> Result<(), CommandError> {
    let start = Instant::now();
    loop {
        *frame += 1;
        pager.merge(*frame);
        (0..)
            .zip(wants)
            .for_each(|(k, key)| pager.request(*key, f64::from(k)));
        pager.submit();
        if pager.is_idle() {
            return Ok(());
        }
        if start.elapsed() > PATIENCE {
            return Err(CommandError::new(
                "the pager does not come to rest",
                "is the machine very busy?",
            ));
        }
        pager.wait_for_progress(PATIENCE);
        std::thread::sleep(FRAME);
    }
}

/// The deepest levels of all trees, and all chunks of them, whose levels have to be resident.
fn deepest(pager: &Pager, trees: u32) -> (Vec<PageKey>, Vec<PageKey>) {
    let ids = || (0..trees).map(TreeId);
    let levels = ids().map(|tree| PageKey::Level { tree, level: DEPTH }).collect();
    let chunks = ids().flat_map(|tree| {
        let bricks = pager
            .tree(tree)
            .and_then(|t| t.level(DEPTH)?.bricks.as_ref().map(|b| b.chunks.len()));
        (0..bricks.unwrap_or(0) as u32).map(move |chunk| PageKey::Chunk {
            tree,
            level: DEPTH,
            chunk,
        })
    });
    (levels, chunks.collect())
}

fn pager(store: Arc<dyn Store>, files: &[String], threads: usize) -> Pager {
    let config = PagerConfig {
        budget_bytes: 4 << 30,
        threads,
        ..PagerConfig::default()
    };
    Pager::new(store, files.to_vec(), config)
}

/// All files of some trees.
fn files(store: &dyn Store, trees: &[String]) -> Result<HashMap<String, Vec<u8>>, CommandError> {
    let mut files = HashMap::new();
    for tree in trees {
        let names =
            std::iter::once(tree.clone()).chain((0..=DEPTH).map(|level| brick_file_name(tree, level)));
        for name in names {
            let len = store.len(&name)?;
            let bytes = store.read(&name, 0, len as usize)?;
            files.insert(name, bytes);
        }
    }
    Ok(files)
}

/// A brick file with plain payloads.
fn plain(file: &[u8]) -> Result<Vec<u8>, FormatError> {
    let header = bricks::decode_header(file, file.len() as u64)?;
    let range = header.directory();
    let part = |from: u64, to: u64| file.get(from as usize..to as usize).unwrap_or_default();
    let index = header.decode_directory(part(range.start, range.end))?;
    let mut out = vec![0; HEADER_BYTES];
    let mut writer = BrickFileWriter::new(header.level, header.layout, header.chunk_log2, Encoding::Plain);
    for (k, entry) in (0..).zip(&index.chunks) {
        let payload = part(entry.offset, entry.offset + u64::from(entry.length));
        let payload = index.decode_chunk(k, payload)?.encode(Encoding::Plain)?;
        writer.push(morton::decode(entry.morton), entry.mask, &payload)?;
        out.extend_from_slice(&payload);
    }
    let (directory, header) = writer.finish();
    out.extend_from_slice(&directory);
    out[..HEADER_BYTES].copy_from_slice(&header);
    Ok(out)
}

/// Milliseconds of a frame that asks for all chunks while a loader hangs, and of the pager's end then.
fn hung(files: &HashMap<String, Vec<u8>>, trees: &[String]) -> Result<(usize, f64, f64), CommandError> {
    let memory = Arc::new(MemoryStore::new());
    for (name, bytes) in files {
        memory.put(name, bytes.clone());
    }
    let mut pager = pager(Arc::clone(&memory) as _, trees, 2);
    let mut frame = 0;
    let (levels, _) = deepest(&pager, trees.len() as u32);
    for _ in 0..2 {
        settle(&mut pager, &mut frame, &levels)?;
    }
    let (_, chunks) = deepest(&pager, trees.len() as u32);
    memory.inject_everywhere(Fault::Hang);
    let mut times: Vec<f64> = (0..20)
        .map(|_| {
            let start = Instant::now();
            frame += 1;
            pager.merge(frame);
            (0..)
                .zip(&chunks)
                .for_each(|(k, key)| pager.request(*key, f64::from(k)));
            pager.submit();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let queued = pager.stats().queued;
    let start = Instant::now();
    drop(pager);
    let end = start.elapsed().as_secs_f64() * 1e3;
    memory.clear_all_faults();
    Ok((queued, times[times.len() / 2], end))
}

/// Bytes per second of one loader without the time it decodes, and of reading the same files from end to end.
fn throughput(folder: &Path, trees: &[String]) -> Result<(f64, f64), CommandError> {
    let (mut best, mut plain) = (0f64, 0f64);
    // The first round brings the files into the page cache; of the others the best, as of anything that others disturb.
    for round in 0..9 {
        let start = Instant::now();
        let mut bytes = 0;
        for tree in trees {
            bytes += fs::read(folder.join(brick_file_name(tree, DEPTH)))?.len();
        }
        let sequential = bytes as f64 / start.elapsed().as_secs_f64();
        let store: Arc<dyn Store> = Arc::new(FolderStore::open(folder)?);
        let mut pager = pager(store, trees, 1);
        let mut frame = 0;
        let (levels, _) = deepest(&pager, trees.len() as u32);
        for _ in 0..2 {
            settle(&mut pager, &mut frame, &levels)?;
        }
        let (_, chunks) = deepest(&pager, trees.len() as u32);
        let before = pager.stats();
        let start = Instant::now();
        settle(&mut pager, &mut frame, &chunks)?;
        let after = pager.stats();
        let decoding = (after.decode_nanos - before.decode_nanos) as f64 * 1e-9;
        let seconds = start.elapsed().as_secs_f64() - decoding;
        let paged = (after.bytes_read - before.bytes_read) as f64 / seconds;
        if round > 0 {
            (best, plain) = (best.max(paged), plain.max(sequential));
        }
    }
    Ok((best, plain))
}

/// Suite `pager-rates`.
///
/// # Errors
/// If the terrain cannot be made or written.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let side = f64::from(TREES * (8 << DEPTH));
    let store: Arc<dyn Store> = Arc::new(ProceduralStore::new(ProceduralConfig {
        seed: 11,
        extent: side,
        voxel: 1.0,
        depth: Some(DEPTH),
        ..ProceduralConfig::default()
    })?);
    let trees = Terrain::open(&store)?.trees;
    let files = files(&*store, &trees)?;
    let folder = settings.folder.join("pager-rates");
    for (name, bytes) in &files {
        let path = folder.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        // Payloads that take no more than a copy to decode, so that reading them counts.
        let bytes = if name.ends_with(".brk") {
            plain(bytes)?
        } else {
            bytes.clone()
        };
        fs::write(path, bytes)?;
    }
    let (queued, frame_ms, end_ms) = hung(&files, &trees)?;
    let (paged, sequential) = throughput(&folder, &trees)?;
    Ok(vec![
        figure("take the next of 10 000 jobs", take_next(), "us")?,
        figure(&format!("a frame with {queued} requests queued"), frame_ms, "ms")?,
        figure(
            &format!("the end, {queued} jobs queued and all reads hung"),
            end_ms,
            "ms",
        )?,
        figure("plain reading of the same files", sequential * 1e-6, "MB/s")?,
        figure("one loader, decoding not counted", paged * 1e-6, "MB/s")?,
        figure("loader to plain reading", paged / sequential, "")?,
    ])
}
