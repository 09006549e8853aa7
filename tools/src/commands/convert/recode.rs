//! A database written anew: the same octrees and samples, in other encodings and chunks.
//!
//! Levels are streamed: bricks stand in Morton order whatever the size of chunks, so a chunk is complete when the next brick belongs
//! to another one.

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::octree::{BRICK, Octree, child_positions};
use brickfell_formats::{morton, octree_binary, octree_xml};
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::terrain::SCENE_FILE;
use glam::UVec3;
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::{Args, Octrees};
use crate::commands::check::bricks::{Level, codes};
use crate::commands::database::read_octree;
use crate::commands::fault::Fault;

/// Chunks that are read, decoded and encoded together.
const BATCH: u32 = 64;

/// Writes the database.
///
/// # Errors
/// One line: path, place, reason.
pub(super) fn recode(
    store: &FolderStore,
    names: &[&str],
    args: &Args,
    bar: &ProgressBar,
) -> Result<(), String> {
    create_folder(&args.out)?;
    for name in names {
        tree(store, name, args)?;
        bar.inc(1);
    }
    // Last: a folder without it is no database.
    copy(store, SCENE_FILE, &args.out)
}

fn tree(store: &FolderStore, name: &str, args: &Args) -> Result<(), String> {
    let octree = read_octree(store, name)?;
    let path = args.out.join(name);
    if let Some(folder) = path.parent() {
        create_folder(folder)?;
    }
    let fail = |e: brickfell_formats::FormatError| Fault::new(store, name, e);
    match args.octrees {
        None => copy(store, name, &args.out)?,
        Some(Octrees::Xml) => write(&path, octree_xml::encode(&octree).map_err(fail)?.as_bytes())?,
        Some(Octrees::Binary) => write(&path, &octree_binary::encode(&octree).map_err(fail)?)?,
    }
    for level in levels(store, name, &octree) {
        level_bricks(&level, args)?;
    }
    Ok(())
}

/// The levels of a tree that have bricks.
pub(crate) fn levels<'a>(store: &'a FolderStore, name: &str, octree: &Octree) -> Vec<Level<'a>> {
    let mut positions = vec![UVec3::ZERO];
    let mut levels = Vec::new();
    for (level, nodes) in (0..).zip(&octree.levels) {
        let with_brick = nodes
            .iter()
            .zip(&positions)
            .filter(|(n, _)| n.structure & BRICK != 0);
        let bricks: Vec<u64> = with_brick.map(|(_, p)| morton::encode(*p)).collect();
        if !bricks.is_empty() {
            levels.push(Level {
                store,
                file: brick_file_name(name, level),
                level,
                layout: octree.header.layout,
                bricks,
            });
        }
        positions = child_positions(nodes, &positions);
    }
    levels
}

/// Bricks that belong to a chunk, as far as they have been read.
struct Open {
    chunk: Chunk,
    code: u64,
}

fn level_bricks(level: &Level, args: &Args) -> Result<(), String> {
    let index = level.index()?;
    let chunk_log2 = match args.chunk.as_deref().map(str::parse) {
        Some(Ok(side)) => u32::ilog2(side) as u8,
        _ => index.header.chunk_log2,
    };
    let encoding = Encoding::from(args.encoding);
    let path = args.out.join(&level.file);
    let io = |e: std::io::Error| format!("{}: {e}", path.display());
    let fail = |e: brickfell_formats::FormatError| Fault::new(level.store, &level.file, e);
    let mut file = File::create(&path).map_err(io)?;
    file.write_all(&[0; HEADER_BYTES]).map_err(io)?;
    let mut writer = BrickFileWriter::new(level.level, level.layout, chunk_log2, encoding)
        .with_layers(index.header.layers);
    let mut write = |mut done: Vec<Open>| -> Result<(), String> {
        let payloads: Vec<Vec<u8>> = done
            .par_iter_mut()
            .map(|open| {
                if args.error > 0 {
                    open.chunk.in_steps(args.error);
                }
                open.chunk.encode_in_steps(encoding, args.error)
            })
            .collect::<Result<_, _>>()
            .map_err(fail)?;
        for (open, payload) in done.iter().zip(payloads) {
            let position = morton::decode(open.code);
            writer.push(position, open.chunk.mask, &payload).map_err(fail)?;
            file.write_all(&payload).map_err(io)?;
        }
        Ok(())
    };
    let mut open: Vec<Open> = Vec::new();
    for first in (0..index.header.chunks).step_by(BATCH as usize) {
        let batch = first..index.header.chunks.min(first + BATCH);
        let chunks: Vec<_> = batch
            .into_par_iter()
            .map(|k| level.decode(&index, k))
            .collect::<Result<_, _>>()?;
        for (entry, chunk) in chunks {
            for (k, brick) in codes(&entry, index.header.chunk_log2).enumerate() {
                add(&mut open, brick, chunk_log2, &chunk, k);
            }
        }
        let last = open.pop();
        write(std::mem::take(&mut open))?;
        open.extend(last);
    }
    write(open)?;
    let (directory, header) = writer.finish();
    file.write_all(&directory)
        .and_then(|()| file.seek(SeekFrom::Start(0)))
        .and_then(|_| file.write_all(&header))
        .map_err(io)
}

/// Adds a brick of another chunk to the one it belongs to.
fn add(open: &mut Vec<Open>, brick: u64, chunk_log2: u8, from: &Chunk, k: usize) {
    let bits = 3 * u32::from(chunk_log2);
    let (code, within) = (brick >> bits, brick & ((1 << bits) - 1));
    if open.last().is_none_or(|o| o.code != code) {
        let chunk = Chunk {
            mask: 0,
            layout: from.layout,
            color: Vec::new(),
            normal: Vec::new(),
            opacity: Vec::new(),
        };
        open.push(Open { chunk, code });
    }
    if let Some(Open { chunk, .. }) = open.last_mut() {
        chunk.mask |= 1 << within;
        chunk.color.extend(from.brick_color(k));
        chunk.normal.extend(from.brick_normal(k));
        chunk.opacity.extend(from.brick_opacity(k).unwrap_or_default());
    }
}

fn copy(store: &dyn Store, name: &str, out: &Path) -> Result<(), String> {
    let fail = |e: std::io::Error| Fault::unreadable(store, name, "read", &e);
    let len = store.len(name).map_err(fail)?;
    let bytes = store.read(name, 0, len as usize).map_err(fail)?;
    write(&out.join(name), &bytes)
}

fn write(path: &PathBuf, bytes: &[u8]) -> Result<(), String> {
    fs::write(path, bytes).map_err(|e| format!("{}: {e}", path.display()))
}

fn create_folder(path: &Path) -> Result<(), String> {
    fs::create_dir_all(path).map_err(|e| format!("{}: {e}", path.display()))
}
