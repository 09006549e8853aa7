//! From one level to the next coarser one, whatever the filter's rule.
//!
//! Centre layout: a sample is the mean of its 2³ children. Corner layout: of the 3³ samples around it, weighted ¼ ½ ¼ on
//! each axis. A block of the coarser level reads a cube of finer samples around twice its place.

use rayon::prelude::*;

use brickfell_formats::layout::SampleLayout;

use super::Target;
use crate::build::blocks::{Block, BlockColumn, Blocks, Slot, block_columns};
use crate::build::cells::{BLOCK, Cells, Draft, Mask, dense, either, in_block};
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

/// What a thread needs for blocks.
struct Buffers<K> {
    /// A finer block, and what is kept of it.
    block: Box<[Sample; BLOCK]>,
    block_kept: Box<[K; BLOCK]>,
    /// Cubes of finer samples around a block.
    samples: Vec<Sample>,
    kept: Vec<K>,
    made: Draft<Sample>,
    made_kept: Draft<K>,
}

impl<K: Copy + Default> Default for Buffers<K> {
    fn default() -> Self {
        Self {
            block: dense(),
            block_kept: dense(),
            samples: Vec::new(),
            kept: Vec::new(),
            made: Draft::default(),
            made_kept: Draft::default(),
        }
    }
}

/// A block and what is kept of it, if anything.
type SlotPair<K> = (Slot<Cells<Sample>>, Option<Slot<Cells<K>>>);

/// The finer level: its samples, and what is kept of them unless it is the finest.
struct Fine<'a, R: Rule> {
    rule: &'a R,
    samples: &'a Blocks<Cells<Sample>>,
    kept: Option<&'a Blocks<Cells<R::Kept>>>,
}

/// The coarser level.
pub(super) fn coarser<R: Rule>(
    rule: &R,
    samples: &Blocks<Cells<Sample>>,
    kept: Option<&Blocks<Cells<R::Kept>>>,
    target: &Target,
) -> (Blocks<Cells<Sample>>, Blocks<Cells<R::Kept>>) {
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
    ) -> (BlockColumn<Cells<Sample>>, BlockColumn<Cells<R::Kept>>) {
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
        buffers: &mut Buffers<R::Kept>,
    ) -> Option<SlotPair<R::Kept>> {
        let (first, weights) = taps(target.layout);
        let Buffers {
            block,
            block_kept,
            samples,
            kept,
            made,
            made_kept,
        } = buffers;
        let mut made = Made {
            target,
            at,
            weights,
            samples: made,
            kept: made_kept,
        };
        if first == 0 {
            // What a sample is made of lies in one finer block: no need to put cubes together.
            for octant in 0..8 {
                self.octant(
                    &mut made,
                    [octant & 1, octant >> 1 & 1, octant >> 2],
                    block,
                    block_kept,
                );
            }
        } else {
            let base = at.map(|b| 2 * SIDE * b + first);
            let n = 2 * SIDE - first;
            read(self.samples, base, n, Sample::DEEP, block, samples);
            match self.kept {
                Some(blocks) => read(blocks, base, n, R::Kept::default(), block_kept, kept),
                None => {
                    kept.clear();
                    kept.extend(samples.iter().map(|sample| self.rule.finest(sample)));
                }
            }
            let cells = (0..SIDE * SIDE * SIDE).map(|k| [k % SIDE, k / SIDE % SIDE, k / SIDE / SIDE]);
            for cell in cells {
                made.add::<R, 3>(self.rule, samples, kept, n as usize, cell, cell);
            }
        }
        let kept = made.kept.take().map(Slot::Mixed);
        if made.samples.is_solid() {
            made.samples.take();
            return Some((Slot::Solid, None));
        }
        made.samples.take().map(|samples| (Slot::Mixed(samples), kept))
    }

    /// The eighth of a block that lies over one finer block.
    fn octant(
        &self,
        made: &mut Made<R::Kept>,
        octant: [i64; 3],
        samples: &mut [Sample; BLOCK],
        kept: &mut [R::Kept; BLOCK],
    ) {
        const HALF: i64 = SIDE / 2;
        let [x, y, z]: [i64; 3] = std::array::from_fn(|k| 2 * made.at[k] + octant[k]);
        let first = octant.map(|o| HALF * o);
        let place = |k: i64| {
            let [i, j, k] = [k % HALF, k / HALF % HALF, k / HALF / HALF];
            [first[0] + i, first[1] + j, first[2] + k]
        };
        let cells = match self.samples.column(x, y).get(z) {
            Block::Empty => return,
            Block::Solid => {
                for [x, y, z] in (0..HALF * HALF * HALF).map(place) {
                    made.samples.make_solid(in_block(x, y, z));
                }
                return;
            }
            Block::Mixed(cells) => cells,
        };
        cells.spread(Sample::DEEP, samples);
        match self.kept.map(|kept| kept.column(x, y).get(z)) {
            Some(Block::Mixed(cells)) => cells.spread(R::Kept::default(), kept),
            Some(_) => kept.fill(R::Kept::default()),
            None => {
                kept.fill(R::Kept::default());
                cells.each(|place, sample| kept[place] = self.rule.finest(sample));
            }
        }
        let some = coarser_cells(&either(cells.held(), cells.solid()));
        let mixed = coarser_cells(cells.held());
        let not_solid = coarser_cells(&cells.solid().map(|layer| !layer));
        for k in (0..HALF * HALF * HALF).filter(|k| some >> k & 1 == 1) {
            let cell = place(k);
            if mixed >> k & 1 == 0 && not_solid >> k & 1 == 0 {
                made.samples.make_solid(in_block(cell[0], cell[1], cell[2]));
                continue;
            }
            let fine = std::array::from_fn(|axis| cell[axis] - first[axis]);
            made.add::<R, 2>(self.rule, &samples[..], &kept[..], SIDE as usize, fine, cell);
        }
    }
}

/// Which of the 4³ coarser cells over a block have any of some cells, x fastest.
fn coarser_cells(mask: &Mask) -> u64 {
    let mut cells = 0;
    for z in 0..4 {
        let plane = mask[2 * z] | mask[2 * z + 1];
        // Two rows, then two cells of a row, in the first of them.
        let rows = plane | plane >> 8;
        let pairs = (rows | rows >> 1) & 0x0055_0055_0055_0055;
        for y in 0..4 {
            let row = pairs >> (16 * y) & 0x55;
            let row = (row | row >> 1) & 0x33;
            let row = (row | row >> 2) & 0x0f;
            cells |= row << (16 * z + 4 * y);
        }
    }
    cells
}

/// A coarse block under construction.
struct Made<'a, K> {
    target: &'a Target,
    at: [i64; 3],
    weights: &'static [f32],
    samples: &'a mut Draft<Sample>,
    kept: &'a mut Draft<K>,
}

impl<K: Copy + Default + PartialEq> Made<'_, K> {
    /// Makes a sample, at a cell of the block, out of `N`³ finer ones that begin at twice a place in rows of `side`.
    #[inline]
    fn add<R: Rule<Kept = K>, const N: usize>(
        &mut self,
        rule: &R,
        samples: &[Sample],
        kept: &[K],
        side: usize,
        fine: [i64; 3],
        cell: [i64; 3],
    ) {
        let share: [f32; N] = std::array::from_fn(|k| self.weights[k]);
        let [x, y, z] = fine.map(|v| 2 * v as usize);
        let corner = (z * side + y) * side + x;
        let row = |k: usize| &samples[corner + (k / N * side + k % N) * side..][..N];
        if (0..N * N).all(|k| row(k).iter().all(Sample::is_empty)) {
            return;
        }
        let mut mean = Mean::default();
        for k in 0..N * N {
            for (s, wx) in row(k).iter().zip(share) {
                mean.add(s, wx * share[k % N] * share[k / N]);
            }
        }
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
        let place = in_block(cell[0], cell[1], cell[2]);
        if sample.is_deep() {
            self.samples.make_solid(place);
        } else if !sample.is_empty() {
            self.samples.put(place, sample);
        }
        if keep != K::default() {
            self.kept.put(place, keep);
        }
    }
}

/// Copies a cube of `n`³ samples from `base` on; `solid` is what solid blocks hold.
fn read<T: Copy + Default>(
    fine: &Blocks<Cells<T>>,
    base: [i64; 3],
    n: i64,
    solid: T,
    spread: &mut [T; BLOCK],
    buffer: &mut Vec<T>,
) {
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
            match column.get(bz) {
                Block::Empty => continue,
                Block::Solid => spread.fill(solid),
                Block::Mixed(cells) => cells.spread(solid, spread),
            }
            let lo: [i64; 3] = std::array::from_fn(|k| ([bx, by, bz][k] * SIDE).max(base[k]));
            let hi: [i64; 3] = std::array::from_fn(|k| (([bx, by, bz][k] + 1) * SIDE).min(base[k] + n));
            let len = (hi[0] - lo[0]) as usize;
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    let to = (((z - base[2]) * n + y - base[1]) * n + lo[0] - base[0]) as usize;
                    let from = in_block(lo[0], y, z);
                    buffer[to..to + len].copy_from_slice(&spread[from..from + len]);
                }
            }
        }
    }
}
