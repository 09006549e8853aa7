//! Fills a picture with a tree: the nodes that it meets, from above down, and of their bricks the voxels.
//!
//! Nodes come in such an order that those of a chunk come together; some chunks at a time are decoded in parallel and forgotten once
//! they are painted, so memory does not grow with the tree.

use std::collections::HashMap;

use brickfell_formats::bricks::BrickIndex;
use brickfell_formats::chunk::Chunk;
use brickfell_formats::layout::BRICK_VOXELS;
use brickfell_formats::octree::{NodeData, Octree, octant_offset};
use brickfell_formats::value::decode_color;
use brickfell_pager::FolderStore;
use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::Placed;
use super::canvas::Canvas;
use crate::commands::check::bricks::Level;
use crate::commands::convert::recode::levels;
use crate::commands::database::read_octree;

/// Chunks that are decoded together.
const BATCH: usize = 64;

/// A node that is painted.
struct Item {
    level: u8,
    /// Its box, world metres.
    low: DVec3,
    side: f64,
    shows: Shows,
}

enum Shows {
    Constant([u8; 4]),
    /// A place in a chunk.
    Brick {
        chunk: u32,
        place: usize,
    },
}

/// The levels of a tree that have bricks.
type Levels<'a> = HashMap<u8, (Level<'a>, BrickIndex)>;

/// Paints a tree.
///
/// # Errors
/// One line: path, place, reason.
pub(super) fn paint(store: &FolderStore, tree: &Placed, canvas: &mut Canvas) -> Result<(), String> {
    let octree = read_octree(store, &tree.file)?;
    let mut with_bricks = Levels::new();
    for level in levels(store, &tree.file, &octree) {
        if level.level <= tree.level {
            let index = level.index()?;
            with_bricks.insert(level.level, (level, index));
        }
    }
    let mut items = Vec::new();
    collect(
        &octree,
        tree,
        &with_bricks,
        canvas,
        (0, 0, UVec3::ZERO),
        &mut items,
    );
    let mut rest = items.as_slice();
    while !rest.is_empty() {
        let (mut batch, mut wanted): (usize, Vec<(u8, u32)>) = (0, Vec::new());
        for item in rest {
            if let Shows::Brick { chunk, .. } = item.shows
                && wanted.last() != Some(&(item.level, chunk))
                && !wanted.contains(&(item.level, chunk))
                && is_open(item, canvas)
            {
                if wanted.len() == BATCH {
                    break;
                }
                wanted.push((item.level, chunk));
            }
            batch += 1;
        }
        let chunks = wanted
            .into_par_iter()
            .filter_map(|key| Some((key, with_bricks.get(&key.0)?)))
            .map(|(key, (level, index))| Ok((key, level.decode(index, key.1)?.1)))
            .collect::<Result<HashMap<_, _>, String>>()?;
        let (now, later) = rest.split_at(batch);
        for item in now {
            match item.shows {
                Shows::Constant(color) => constant(item, color, tree, canvas),
                Shows::Brick { chunk, place } => {
                    // Chunks are missing of which nothing would be seen.
                    if let Some(chunk) = chunks.get(&(item.level, chunk)) {
                        brick(item, (chunk, place), tree, canvas);
                    }
                }
            }
        }
        rest = later;
    }
    Ok(())
}

/// The part of an interval of an item along an axis that is drawn.
fn drawn(item: &Item, tree: &Placed, axis: usize) -> [f64; 2] {
    let [min, max] = tree.bounds;
    [
        item.low[axis].max(min[axis]),
        (item.low[axis] + item.side).min(max[axis]),
    ]
}

/// Lists what of a node and those below it is painted.
fn collect(
    octree: &Octree,
    tree: &Placed,
    levels: &Levels,
    canvas: &Canvas,
    (level, index, position): (u8, usize, UVec3),
    items: &mut Vec<Item>,
) {
    let Some(node) = octree.levels.get(usize::from(level)).and_then(|l| l.get(index)) else {
        return;
    };
    let header = &octree.header;
    let side = header.level_voxel_size(level) * f64::from(BRICK_VOXELS);
    let mut item = Item {
        level,
        low: header.origin + position.as_dvec3() * side,
        side,
        shows: Shows::Constant([0; 4]),
    };
    let within = |k: usize| {
        let [a, b] = drawn(&item, tree, canvas.axes[k]);
        match (k, canvas.at) {
            (2, Some(at)) => a <= at && at < b,
            (2, None) => a < b,
            _ => !canvas.pixels(k, [a, b]).is_empty(),
        }
    };
    if !(0..3).all(within) {
        return;
    }
    if let (Some(tile), true) = (node.children(), level < tree.level) {
        // The upper four first: what is above hides what is below.
        for octant in [4, 5, 6, 7, 0, 1, 2, 3] {
            let child = position * 2 + octant_offset(octant);
            let below = (level + 1, tile as usize * 8 + octant as usize, child);
            collect(octree, tree, levels, canvas, below, items);
        }
        return;
    }
    item.shows = match node.data() {
        NodeData::Constant([.., 0]) => return,
        NodeData::Constant(color) => Shows::Constant(color),
        NodeData::Brick(number) => {
            let place = levels.get(&level).and_then(|(_, index)| index.locate(number));
            let Some((chunk, place)) = place else { return };
            Shows::Brick {
                chunk,
                place: place as usize,
            }
        }
    };
    items.push(item);
}

/// Whether a pixel of an item's lets anything of it be seen.
fn is_open(item: &Item, canvas: &Canvas) -> bool {
    let range = |k: usize| {
        let low = item.low[canvas.axes[k]];
        canvas.pixels(k, [low, low + item.side])
    };
    range(1).any(|y| range(0).any(|x| canvas.is_open(x, y)))
}

/// Straight linear colour and opacity across a voxel of what is stored; `against` is the opacity against a map's rays, if it is known.
fn decoded(color: [u8; 4], against: Option<u8>, gain: u8) -> ([f64; 3], f64) {
    let [r, g, b, a] = decode_color(color);
    let stored = against.map_or(a, |z| f64::from(z) / 255.0);
    let opacity = (stored * f64::from(gain)).min(1.0);
    (
        [r, g, b].map(|c| if a > 0.0 { (c / a).min(1.0) } else { 0.0 }),
        opacity,
    )
}

fn constant(item: &Item, color: [u8; 4], tree: &Placed, canvas: &mut Canvas) {
    let (rgb, across) = decoded(color, None, tree.header.gain);
    let opacity = match canvas.at {
        Some(_) => across,
        None => {
            let [a, b] = drawn(item, tree, 2);
            let voxels = (b - a) / item.side * f64::from(BRICK_VOXELS);
            1.0 - (1.0 - across).powf(voxels)
        }
    };
    let [xs, ys] = [0, 1].map(|k| canvas.pixels(k, drawn(item, tree, canvas.axes[k])));
    for y in ys {
        for x in xs.clone() {
            canvas.add(x, y, rgb, opacity);
        }
    }
}

fn brick(item: &Item, (chunk, place): (&Chunk, usize), tree: &Placed, canvas: &mut Canvas) {
    let layout = tree.header.layout;
    let (colors, opacities) = (chunk.brick_color(place), chunk.brick_opacity(place));
    let (side, apron) = (layout.side(), layout.low_apron());
    let voxel = item.side / f64::from(BRICK_VOXELS);
    let axes = canvas.axes;
    // The voxel of the brick that a place along an axis lies in.
    let inside = |axis: usize, at: f64| {
        let place = ((at - item.low[axis]) / voxel).floor();
        place.clamp(0.0, f64::from(BRICK_VOXELS - 1)) as u32
    };
    let depths: Vec<u32> = match canvas.at {
        Some(at) => vec![inside(axes[2], at)],
        None => {
            let [a, b] = drawn(item, tree, 2);
            let middle = |k: &u32| item.low.z + (f64::from(*k) + 0.5) * voxel;
            let all = (0..BRICK_VOXELS).rev();
            all.filter(|k| (a..b).contains(&middle(k))).collect()
        }
    };
    let [xs, ys] = [0, 1].map(|k| canvas.pixels(k, drawn(item, tree, axes[k])));
    for y in ys {
        for x in xs.clone() {
            for depth in &depths {
                if !canvas.is_open(x, y) {
                    break;
                }
                let mut at = UVec3::ZERO;
                at[axes[0]] = inside(axes[0], canvas.middle(0, x));
                at[axes[1]] = inside(axes[1], canvas.middle(1, y));
                at[axes[2]] = *depth;
                let at = at + apron;
                let k = ((at.z * side + at.y) * side + at.x) as usize;
                let against = match canvas.at {
                    None => opacities.map(|o| o[k][2]),
                    Some(_) => None,
                };
                let (rgb, opacity) = decoded(colors[k], against, tree.header.gain);
                canvas.add(x, y, rgb, opacity);
            }
        }
    }
}
