//! From one level to the next coarser one, whatever the filter's rule.
//!
//! Centre layout: a sample is the mean of its 2³ children. Corner layout: of the 3³ samples around it, weighted ¼ ½ ¼ on
//! each axis. A block of the coarser level reads a cube of finer samples around twice its place.

use rayon::prelude::*;

use brickfell_formats::layout::SampleLayout;

use super::Target;
use crate::build::blocks::{Block, BlockColumn, Blocks, Dense, Slot, block_columns, in_block, new_dense};
use crate::build::lattice::{CellBox, SIDE};
use crate::build::sample::{Mean, Sample};

/// What a filter does with skins.
pub(super) trait Rule: Sync {
    /// What it keeps of a sample beside what is stored; the default where nothing is.
    type Kept: Copy + Default + PartialEq + Send + Sync;

    /// What is kept of a finest sample if nothing was when it was made.
    fn finest(&self, sample: &Sample) -> Self::Kept;

    /// The skin of a coarser sample (0..2) and what is kept of it, given the mean of its parts' skins and what was kept of
    /// them. Called where a part has anything on its surface.
    fn up(&self, mean: f32, parts: &Parts<Self::Kept>) -> (f32, Self::Kept);
}

/// What is kept of the finer samples that a coarser one is made of.
pub(super) struct Parts<'a, K> {
    kept: &'a [K],
    /// Finer samples of a row.
    side: usize,
    weights: &'static [f32],
    /// Place of the coarser sample.
    pub(super) cell: [i64; 3],
    /// Its level.
    pub(super) mip: u8,
}

impl<K: Copy> Parts<'_, K> {
    /// Parts per axis.
    pub(super) fn taps(&self) -> usize {
        self.weights.len()
    }

    /// What is kept of a part.
    pub(super) fn at(&self, [x, y, z]: [usize; 3]) -> K {
        self.kept[(z * self.side + y) * self.side + x]
    }
}

impl Parts<'_, f32> {
    /// The mean of what is kept.
    pub(super) fn mean(&self) -> f32 {
        let mut mean = 0.0;
        for (z, wz) in self.weights.iter().enumerate() {
            for (y, wy) in self.weights.iter().enumerate() {
                for (x, wx) in self.weights.iter().enumerate() {
                    mean += self.at([x, y, z]) * wx * wy * wz;
                }
            }
        }
        mean
    }
}

/// First finer sample read, relative to twice the coarse one, and the weights from there on.
fn taps(layout: SampleLayout) -> (i64, &'static [f32]) {
    match layout {
        SampleLayout::Centre => (0, &[0.5, 0.5]),
        SampleLayout::Corner => (-1, &[0.25, 0.5, 0.25]),
    }
}

/// Samples and what is kept of them, as they are read for a block.
type Buffers<K> = (Vec<Sample>, Vec<K>);

/// A block and what is kept of it, if anything.
type SlotPair<K> = (Slot<Dense<Sample>>, Option<Slot<Dense<K>>>);

/// The finer level: its samples, and what is kept of them unless it is the finest.
struct Fine<'a, R: Rule> {
    rule: &'a R,
    samples: &'a Blocks<Dense<Sample>>,
    kept: Option<&'a Blocks<Dense<R::Kept>>>,
}

/// The coarser level.
pub(super) fn coarser<R: Rule>(
    rule: &R,
    samples: &Blocks<Dense<Sample>>,
    kept: Option<&Blocks<Dense<R::Kept>>>,
    target: &Target,
) -> (Blocks<Dense<Sample>>, Blocks<Dense<R::Kept>>) {
    let fine = Fine { rule, samples, kept };
    let extent = target.cells.blocks();
    let (samples, kept) = block_columns(&extent)
        .into_par_iter()
        .map_init(Default::default, |buffers, (x, y)| {
            fine.column(target, x, y, &extent, buffers)
        })
        .unzip();
    (Blocks::new(&extent, samples), Blocks::new(&extent, kept))
}

impl<R: Rule> Fine<'_, R> {
    fn column(
        &self,
        target: &Target,
        x: i64,
        y: i64,
        extent: &CellBox,
        buffers: &mut Buffers<R::Kept>,
    ) -> (BlockColumn<Dense<Sample>>, BlockColumn<Dense<R::Kept>>) {
        let fine = self.samples;
        let first = taps(target.layout).0;
        let mut solid: Option<(i64, i64)> = None;
        let mut touched = Vec::new();
        let under =
            || (2 * y + first..2 * y + 2).flat_map(|j| (2 * x + first..2 * x + 2).map(move |i| (i, j)));
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
        let mut kept = BlockColumn::default();
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
            if let Some((slot, beside)) = self.block(target, [x, y, z], buffers) {
                slots.push((z, slot));
                kept.slots.extend(beside.map(|b| (z, b)));
            }
        }
        // A block that came out empty inside the range cannot be: all it reads is solid or has a slot of its own.
        let solid = solid.start.max(extent.lo[2])..solid.end.min(extent.hi[2]);
        let samples = BlockColumn {
            solid: if solid.is_empty() { 0..0 } else { solid },
            slots,
        };
        (samples, kept)
    }

    /// One coarse block and what is kept of it, if anything; `None` if it is empty.
    fn block(
        &self,
        target: &Target,
        at: [i64; 3],
        (samples, kept): &mut Buffers<R::Kept>,
    ) -> Option<SlotPair<R::Kept>> {
        let (first, weights) = taps(target.layout);
        let base = at.map(|b| 2 * SIDE * b + first);
        let n = 2 * SIDE - first;
        read(self.samples, base, n, Sample::DEEP, samples);
        match self.kept {
            Some(blocks) => read(blocks, base, n, R::Kept::default(), kept),
            None => {
                kept.clear();
                kept.extend(samples.iter().map(|sample| self.rule.finest(sample)));
            }
        }
        let mut dense = new_dense::<Sample>();
        let mut beside = new_dense::<R::Kept>();
        let (mut empty, mut deep, mut keeps) = (true, true, false);
        for z in 0..SIDE {
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let corner = ((2 * z * n + 2 * y) * n + 2 * x) as usize;
                    let mut mean = Mean::default();
                    for (dz, wz) in weights.iter().enumerate() {
                        for (dy, wy) in weights.iter().enumerate() {
                            let row = corner + (dz * n as usize + dy) * n as usize;
                            for (s, wx) in samples[row..].iter().zip(weights) {
                                mean.add(s, wx * wy * wz);
                            }
                        }
                    }
                    let place = in_block(x, y, z);
                    let (skin, keep) = if mean.weight() > 0.0 {
                        let parts = Parts {
                            kept: &kept[corner..],
                            side: n as usize,
                            weights,
                            cell: [SIDE * at[0] + x, SIDE * at[1] + y, SIDE * at[2] + z],
                            mip: target.mip,
                        };
                        self.rule.up(mean.skin(), &parts)
                    } else {
                        Default::default()
                    };
                    let sample = mean.sample(skin);
                    empty &= sample.is_empty();
                    deep &= sample.is_deep();
                    keeps |= keep != R::Kept::default();
                    dense[place] = sample;
                    beside[place] = keep;
                }
            }
        }
        match (empty, deep) {
            (true, _) => None,
            (_, true) => Some((Slot::Solid, None)),
            _ => Some((Slot::Dense(dense), keeps.then_some(Slot::Dense(beside)))),
        }
    }
}

/// Copies a cube of `n`³ samples from `base` on; `solid` is what solid blocks hold.
fn read<T: Copy + Default>(fine: &Blocks<Dense<T>>, base: [i64; 3], n: i64, solid: T, buffer: &mut Vec<T>) {
    buffer.clear();
    buffer.resize((n * n * n) as usize, T::default());
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
                        _ => buffer[to..to + len].fill(solid),
                    }
                }
            }
        }
    }
}
