//! From one level to the next coarser one.
//!
//! Centre layout: a sample is the mean of its 2³ children. Corner layout: of the 3³ samples around it, weighted ¼ ½ ¼ on
//! each axis. A block of the coarser level reads a cube of finer samples around twice its place.

use rayon::prelude::*;

use brickfell_formats::layout::SampleLayout;

use super::blocks::{Block, BlockColumn, Blocks, Slot, block_columns, in_block, new_dense};
use super::lattice::{CellBox, SIDE};
use super::sample::{Mean, Sample};

/// First finer sample read, relative to twice the coarse one, and the weights from there on.
fn taps(layout: SampleLayout) -> (i64, &'static [f32]) {
    match layout {
        SampleLayout::Centre => (0, &[0.5, 0.5]),
        SampleLayout::Corner => (-1, &[0.25, 0.5, 0.25]),
    }
}

/// The coarser level over an extent given in its cells. Cells of which `fine` lacks a part are meaningless.
pub(crate) fn coarser(fine: &Blocks<Sample>, layout: SampleLayout, cells: &CellBox) -> Blocks<Sample> {
    let extent = cells.blocks();
    let columns = block_columns(&extent)
        .into_par_iter()
        .map_init(Vec::new, |buffer, (x, y)| {
            column(fine, layout, x, y, &extent, buffer)
        })
        .collect();
    Blocks::new(&extent, columns)
}

fn column(
    fine: &Blocks<Sample>,
    layout: SampleLayout,
    x: i64,
    y: i64,
    extent: &CellBox,
    buffer: &mut Vec<Sample>,
) -> BlockColumn<Sample> {
    let first = taps(layout).0;
    let mut solid: Option<(i64, i64)> = None;
    let mut touched = Vec::new();
    let under = || (2 * y + first..2 * y + 2).flat_map(|j| (2 * x + first..2 * x + 2).map(move |i| (i, j)));
    for (i, j) in under() {
        let child = fine.column(i, j);
        let range = if child.solid.is_empty() {
            (0, 0)
        } else {
            (child.solid.start, child.solid.end)
        };
        solid = Some(solid.map_or(range, |s| (s.0.max(range.0), s.1.min(range.1))));
        touched.extend(child.slots.iter().map(|s| s.0));
    }
    // Coarse blocks that read nothing but the solid range.
    let (lo, hi) = solid.unwrap_or((0, 0));
    let solid = (lo - first + 1).div_euclid(2)..hi.div_euclid(2);
    let solid = if solid.is_empty() { 0..0 } else { solid };
    for (i, j) in under() {
        let child = &fine.column(i, j).solid;
        touched.extend(
            child
                .clone()
                .filter(|z| z.div_euclid(2) < solid.start || *z >= 2 * solid.end),
        );
        touched.extend(child.start..(child.start + 1).min(child.end));
    }
    let mut heights: Vec<i64> = touched
        .iter()
        .flat_map(|z| [z.div_euclid(2), (z - first).div_euclid(2)])
        .collect();
    heights.sort_unstable();
    heights.dedup();
    let mut slots = Vec::with_capacity(heights.len());
    for z in heights
        .into_iter()
        .filter(|z| (extent.lo[2]..extent.hi[2]).contains(z))
    {
        let untouched = |z: i64| {
            let read = 2 * z + first..2 * z + 2;
            under().all(|(i, j)| {
                let c = fine.column(i, j);
                let k = c.slots.partition_point(|s| s.0 < read.start);
                c.slots.get(k).is_none_or(|s| s.0 >= read.end)
            })
        };
        if solid.contains(&z) && untouched(z) {
            continue;
        }
        slots.extend(block(fine, layout, [x, y, z], buffer).map(|slot| (z, slot)));
    }
    // A block that came out empty inside the range cannot be: all it reads is solid or has a slot of its own.
    let solid = solid.start.max(extent.lo[2])..solid.end.min(extent.hi[2]);
    BlockColumn {
        solid: if solid.is_empty() { 0..0 } else { solid },
        slots,
    }
}

/// One coarse block, `None` if it is empty.
fn block(
    fine: &Blocks<Sample>,
    layout: SampleLayout,
    at: [i64; 3],
    buffer: &mut Vec<Sample>,
) -> Option<Slot<Sample>> {
    let (first, weights) = taps(layout);
    let base = at.map(|b| 2 * SIDE * b + first);
    let n = 2 * SIDE - first;
    read(fine, base, n, buffer);
    let mut dense = new_dense::<Sample>();
    let (mut empty, mut deep) = (true, true);
    for z in 0..SIDE {
        for y in 0..SIDE {
            for x in 0..SIDE {
                let mut mean = Mean::default();
                for (dz, wz) in weights.iter().enumerate() {
                    for (dy, wy) in weights.iter().enumerate() {
                        let row = (((2 * z + dz as i64) * n + 2 * y + dy as i64) * n + 2 * x) as usize;
                        for (s, wx) in buffer[row..].iter().zip(weights) {
                            mean.add(s, wx * wy * wz);
                        }
                    }
                }
                let sample = mean.sample();
                empty &= sample.is_empty();
                deep &= sample.is_deep();
                dense[in_block(x, y, z)] = sample;
            }
        }
    }
    match (empty, deep) {
        (true, _) => None,
        (_, true) => Some(Slot::Solid),
        _ => Some(Slot::Dense(dense)),
    }
}

/// Copies a cube of `n`³ samples from `base` on.
fn read(fine: &Blocks<Sample>, base: [i64; 3], n: i64, buffer: &mut Vec<Sample>) {
    buffer.clear();
    buffer.resize((n * n * n) as usize, Sample::default());
    let blocks = CellBox {
        lo: base,
        hi: base.map(|b| b + n),
    }
    .blocks();
    for (bx, by) in block_columns(&blocks) {
        let column = fine.column(bx, by);
        for bz in blocks.lo[2]..blocks.hi[2] {
            let block = column.get(bz);
            if matches!(block, Block::Empty) {
                continue;
            }
            let lo: [i64; 3] = std::array::from_fn(|k| ([bx, by, bz][k] * SIDE).max(base[k]));
            let hi: [i64; 3] = std::array::from_fn(|k| (([bx, by, bz][k] + 1) * SIDE).min(base[k] + n));
            let len = (hi[0] - lo[0]) as usize;
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    let to = (((z - base[2]) * n + y - base[1]) * n + lo[0] - base[0]) as usize;
                    let from = in_block(lo[0], y, z);
                    match &block {
                        Block::Dense(dense) => buffer[to..to + len].copy_from_slice(&dense[from..from + len]),
                        _ => buffer[to..to + len].fill(Sample::DEEP),
                    }
                }
            }
        }
    }
}
