//! What one step of a build leaves for the next: blocks of samples as bytes.
//!
//! Blocks are written as they are kept, masks and values. Written and read by the same machine; what is
//! read is checked nevertheless, since a machine may have lost its power while it wrote.

use std::collections::BTreeMap;

use bytemuck::{AnyBitPattern, NoUninit, Pod};

use super::blocks::{BlockColumn, Blocks, Slot, block_columns};
use super::cells::{Cells, Draft, Mask, NONE, both, count};
use super::lattice::{CellBox, SIDE};

/// Bytes under construction.
#[derive(Debug, Default)]
pub(crate) struct Writer(pub(crate) Vec<u8>);

impl Writer {
    /// A value.
    pub(crate) fn put<T: NoUninit>(&mut self, value: &T) {
        self.0.extend_from_slice(bytemuck::bytes_of(value));
    }

    /// Values and their number.
    pub(crate) fn list<T: NoUninit>(&mut self, values: &[T]) {
        self.put(&(values.len() as u64));
        self.0.extend_from_slice(bytemuck::cast_slice(values));
    }
}

/// Bytes being read; `None` where they end too early.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(taken)
    }

    /// A value.
    pub(crate) fn get<T: AnyBitPattern>(&mut self) -> Option<T> {
        self.take(size_of::<T>()).map(bytemuck::pod_read_unaligned)
    }

    /// Values, as many as were written.
    pub(crate) fn list<T: AnyBitPattern>(&mut self) -> Option<Vec<T>> {
        let count = usize::try_from(self.get::<u64>()?).ok()?;
        self.values(count)
    }

    /// So many values.
    fn values<T: AnyBitPattern>(&mut self, count: usize) -> Option<Vec<T>> {
        let bytes = self.take(count.checked_mul(size_of::<T>())?)?;
        Some(
            bytes
                .chunks_exact(size_of::<T>())
                .map(bytemuck::pod_read_unaligned)
                .collect(),
        )
    }
}

const SOLID: u8 = 1;
const MIXED: u8 = 2;

/// Writes the blocks that meet a box of cells.
pub(crate) fn write_blocks<T: Pod>(blocks: &Blocks<Cells<T>>, cells: &CellBox, out: &mut Writer) {
    let extent = cells.blocks();
    let heights = extent.lo[2]..extent.hi[2];
    for (x, y) in block_columns(&extent) {
        let column = blocks.column(x, y);
        let solid = column.solid.start.max(heights.start)..column.solid.end.min(heights.end);
        let solid = if solid.is_empty() { 0..0 } else { solid };
        out.put(&[solid.start, solid.end]);
        let slots = || column.slots.iter().filter(|s| heights.contains(&s.0));
        out.put(&(slots().count() as u32));
        for (z, slot) in slots() {
            out.put(z);
            match slot {
                Slot::Solid => out.put(&SOLID),
                Slot::Mixed(cells) => {
                    out.put(&MIXED);
                    out.put(cells.held());
                    out.put(cells.solid());
                    out.0.extend_from_slice(bytemuck::cast_slice(cells.values()));
                }
            }
        }
    }
}

/// A column of blocks that is put together.
struct Joined<T> {
    solid: std::ops::Range<i64>,
    slots: BTreeMap<i64, Slot<Cells<T>>>,
}

/// Blocks over an extent (cells), of what was written of boxes of cells that do not meet. Each counts for its own cells only.
pub(crate) fn read_blocks<T: Pod + Default>(
    extent: &CellBox,
    parts: &mut [(CellBox, Reader)],
) -> Option<Blocks<Cells<T>>> {
    let extent = extent.blocks();
    let width = extent.hi[0] - extent.lo[0];
    let count = width * (extent.hi[1] - extent.lo[1]);
    let mut columns: Vec<Joined<T>> = Vec::new();
    columns.resize_with(count as usize, || Joined {
        solid: 0..0,
        slots: BTreeMap::new(),
    });
    for (cells, part) in parts.iter_mut() {
        for (x, y) in block_columns(&cells.blocks()) {
            let inside =
                (extent.lo[0]..extent.hi[0]).contains(&x) && (extent.lo[1]..extent.hi[1]).contains(&y);
            let place = inside.then(|| ((y - extent.lo[1]) * width + x - extent.lo[0]) as usize);
            let mut column = place.map(|k| &mut columns[k]);
            let [start, end] = part.get::<[i64; 2]>()?;
            if let Some(column) = &mut column {
                column.add_solid(start..end, cells);
            }
            for _ in 0..part.get::<u32>()? {
                let z = part.get::<i64>()?;
                let slot = match part.get::<u8>()? {
                    SOLID => Slot::Solid,
                    _ => Slot::Mixed(read_cells(part)?),
                };
                if let Some(column) = &mut column {
                    column.add(z, slot, cells);
                }
            }
        }
    }
    let columns = columns.into_iter().map(|c| BlockColumn {
        solid: c.solid,
        slots: c.slots.into_iter().collect(),
    });
    Some(Blocks::new(&extent, columns.collect()))
}

fn read_cells<T: Pod>(part: &mut Reader) -> Option<Cells<T>> {
    let [held, solid] = part.get::<[Mask; 2]>()?;
    let values = part.values(count(&held) as usize)?;
    (both(&held, &solid) == NONE).then(|| Cells::new(held, solid, values))
}

impl<T: Copy + Default> Joined<T> {
    /// Adds a run of deep solid, as far as its blocks are the box's own; the rest are slots.
    fn add_solid(&mut self, run: std::ops::Range<i64>, own: &CellBox) {
        let whole = run
            .start
            .max(own.lo[2].div_euclid(SIDE) + i64::from(own.lo[2] % SIDE != 0))
            ..run.end.min(own.hi[2].div_euclid(SIDE));
        for z in run.clone().filter(|z| !whole.contains(z)) {
            self.add(z, Slot::Solid, own);
        }
        if whole.is_empty() {
            return;
        }
        if self.solid.is_empty() {
            self.solid = whole;
        } else if self.solid.end == whole.start {
            self.solid.end = whole.end;
        } else if whole.end == self.solid.start {
            self.solid.start = whole.start;
        } else {
            self.slots.extend(whole.map(|z| (z, Slot::Solid)));
        }
    }

    /// Adds a block, as far as its cells lie in the box.
    fn add(&mut self, z: i64, slot: Slot<Cells<T>>, own: &CellBox) {
        let cells = (SIDE * z).max(own.lo[2])..(SIDE * (z + 1)).min(own.hi[2]);
        if cells.end - cells.start == SIDE {
            self.slots.insert(z, slot);
            return;
        }
        let mut draft = Draft::default();
        if let Some(before) = self.slots.remove(&z) {
            draft.put_layers(0..SIDE as usize, &before.into_cells());
        }
        if !cells.is_empty() {
            let first = cells.start.rem_euclid(SIDE) as usize;
            let layers = first..first + (cells.end - cells.start) as usize;
            draft.put_layers(layers, &slot.into_cells());
        }
        if let Some(cells) = draft.take() {
            self.slots.insert(z, Slot::Mixed(cells));
        }
    }
}
