//! From one level to the next coarser one, whatever the filter's rule.
//!
//! Centre layout: a sample is the mean of its 2³ children. Corner layout: of the 3³ samples around it, weighted ¼ ½ ¼ on
//! each axis. A block of the coarser level reads a cube of finer samples around twice its place.

use rayon::prelude::*;

use brickfell_formats::layout::SampleLayout;

use super::Target;
use crate::build::blocks::{
    BLOCK, Block, BlockColumn, Blocks, Dense, Slot, block_columns, in_block, new_dense,
};
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
        let mut made = Made {
            target,
            at,
            weights,
            samples: new_dense(),
            kept: new_dense(),
            filled: 0,
            deep: 0,
            keeps: false,
        };
        if first == 0 {
            // What a sample is made of lies in one finer block: no need to put cubes together.
            for octant in 0..8 {
                self.octant(&mut made, [octant & 1, octant >> 1 & 1, octant >> 2], kept);
            }
        } else {
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
            made.add::<R, 3>(self.rule, samples, kept, n as usize, [0; 3], SIDE);
        }
        match (made.filled, made.deep) {
            (0, _) => None,
            (_, BLOCK) => Some((Slot::Solid, None)),
            _ => Some((
                Slot::Dense(made.samples),
                made.keeps.then_some(Slot::Dense(made.kept)),
            )),
        }
    }

    /// The eighth of a block that lies over one finer block.
    fn octant(&self, made: &mut Made<R::Kept>, octant: [i64; 3], buffer: &mut Vec<R::Kept>) {
        const HALF: i64 = SIDE / 2;
        let [x, y, z]: [i64; 3] = std::array::from_fn(|k| 2 * made.at[k] + octant[k]);
        let first = octant.map(|o| HALF * o);
        let samples = match self.samples.column(x, y).get(z) {
            Block::Empty => return,
            Block::Solid => {
                for place in (0..HALF * HALF * HALF).map(|k| [k % HALF, k / HALF % HALF, k / HALF / HALF]) {
                    let [x, y, z]: [i64; 3] = std::array::from_fn(|k| first[k] + place[k]);
                    made.samples[in_block(x, y, z)] = Sample::DEEP;
                }
                made.filled += (HALF * HALF * HALF) as usize;
                made.deep += (HALF * HALF * HALF) as usize;
                return;
            }
            Block::Dense(samples) => samples,
        };
        let kept = match self.kept.map(|kept| kept.column(x, y).get(z)) {
            Some(Block::Dense(kept)) => &kept[..],
            Some(_) => {
                buffer.clear();
                buffer.resize(BLOCK, R::Kept::default());
                buffer
            }
            None => {
                buffer.clear();
                buffer.extend(samples.iter().map(|sample| self.rule.finest(sample)));
                buffer
            }
        };
        made.add::<R, 2>(self.rule, &samples[..], kept, SIDE as usize, first, HALF);
    }
}

/// A coarse block under construction.
struct Made<'a, K> {
    target: &'a Target,
    at: [i64; 3],
    weights: &'static [f32],
    samples: Dense<Sample>,
    kept: Dense<K>,
    /// Cells that are not empty, and those that are deep solid.
    filled: usize,
    deep: usize,
    keeps: bool,
}

impl<K: Copy + Default + PartialEq> Made<'_, K> {
    /// Makes a cube of samples from `first` on out of `N`³ finer ones each, which are in rows of `side` and begin where it does.
    fn add<R: Rule<Kept = K>, const N: usize>(
        &mut self,
        rule: &R,
        samples: &[Sample],
        kept: &[K],
        side: usize,
        first: [i64; 3],
        count: i64,
    ) {
        let share: [f32; N] = std::array::from_fn(|k| self.weights[k]);
        for [x, y, z] in (0..count * count * count).map(|k| [k % count, k / count % count, k / count / count])
        {
            let corner = ((2 * z) as usize * side + (2 * y) as usize) * side + (2 * x) as usize;
            let row = |k: usize| &samples[corner + (k / N * side + k % N) * side..][..N];
            if (0..N * N).all(|k| row(k).iter().all(Sample::is_empty)) {
                continue;
            }
            let mut mean = Mean::default();
            for k in 0..N * N {
                for (s, wx) in row(k).iter().zip(share) {
                    mean.add(s, wx * share[k % N] * share[k / N]);
                }
            }
            let cell = [first[0] + x, first[1] + y, first[2] + z];
            let (skin, keep) = if mean.weight() > 0.0 {
                let parts = Parts {
                    kept: &kept[corner..],
                    side,
                    weights: self.weights,
                    cell: std::array::from_fn(|k| SIDE * self.at[k] + cell[k]),
                    mip: self.target.mip,
                };
                rule.up(mean.skin(), &parts)
            } else {
                Default::default()
            };
            let sample = mean.sample(skin);
            self.filled += usize::from(!sample.is_empty());
            self.deep += usize::from(sample.is_deep());
            self.keeps |= keep != K::default();
            let place = in_block(cell[0], cell[1], cell[2]);
            (self.samples[place], self.kept[place]) = (sample, keep);
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
