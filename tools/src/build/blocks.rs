//! Sparse storage of one level: blocks of 8³ samples on the global lattice, in columns.
//!
//! A block is empty (absent), deep solid (nothing kept) or mixed: whatever a level keeps of one, most of them [`Cells`]. Columns keep
//! the long run of solid under the ground as one range; a slot, where there is one, comes before the range.

use std::ops::Range;

use super::cells::{Cell, Cells, NONE, in_block};
use super::lattice::{CellBox, SIDE};

/// A stored block.
#[derive(Debug)]
pub(crate) enum Slot<B> {
    Solid,
    Mixed(B),
}

impl<T: Copy> Slot<Cells<T>> {
    /// Its cells.
    pub(crate) fn into_cells(self) -> Cells<T> {
        match self {
            Slot::Solid => Cells::new(NONE, [u64::MAX; SIDE as usize], Vec::new()),
            Slot::Mixed(cells) => cells,
        }
    }
}

/// A block as it is found.
#[derive(Debug)]
pub(crate) enum Block<'a, B> {
    Empty,
    Solid,
    Mixed(&'a B),
}

/// Blocks above one another.
#[derive(Debug)]
pub(crate) struct BlockColumn<B> {
    /// Blocks of deep solid, where there is no slot.
    pub(crate) solid: Range<i64>,
    /// Further blocks by height, lowest first.
    pub(crate) slots: Vec<(i64, Slot<B>)>,
}

impl<B> Default for BlockColumn<B> {
    fn default() -> Self {
        Self {
            solid: 0..0,
            slots: Vec::new(),
        }
    }
}

impl<B> BlockColumn<B> {
    /// The block at a height.
    #[inline]
    pub(crate) fn get(&self, z: i64) -> Block<'_, B> {
        match self.slots.binary_search_by_key(&z, |s| s.0) {
            Ok(k) => match &self.slots[k].1 {
                Slot::Solid => Block::Solid,
                Slot::Mixed(cells) => Block::Mixed(cells),
            },
            Err(_) if self.solid.contains(&z) => Block::Solid,
            Err(_) => Block::Empty,
        }
    }
}

/// The blocks of one level in a box.
#[derive(Debug)]
pub(crate) struct Blocks<B> {
    lo: [i64; 2],
    size: [i64; 2],
    columns: Vec<BlockColumn<B>>,
    outside: BlockColumn<B>,
}

impl<B> Blocks<B> {
    /// From columns in rows of x, over the x and y extent of a box given in blocks.
    pub(crate) fn new(extent: &CellBox, columns: Vec<BlockColumn<B>>) -> Self {
        let [x, y, _] = extent.lo;
        let size = [extent.hi[0] - x, extent.hi[1] - y];
        debug_assert_eq!(columns.len() as i64, size[0] * size[1]);
        Self {
            lo: [x, y],
            size,
            columns,
            outside: BlockColumn::default(),
        }
    }

    /// The column at a block position; outside the box there is nothing.
    #[inline]
    pub(crate) fn column(&self, x: i64, y: i64) -> &BlockColumn<B> {
        let (i, j) = (x - self.lo[0], y - self.lo[1]);
        if i < 0 || j < 0 || i >= self.size[0] || j >= self.size[1] {
            return &self.outside;
        }
        self.columns
            .get((j * self.size[0] + i) as usize)
            .unwrap_or(&self.outside)
    }

    /// The same to be changed, `None` outside the box.
    pub(crate) fn column_mut(&mut self, x: i64, y: i64) -> Option<&mut BlockColumn<B>> {
        let (i, j) = (x - self.lo[0], y - self.lo[1]);
        let inside = (0..self.size[0]).contains(&i) && (0..self.size[1]).contains(&j);
        inside
            .then(|| self.columns.get_mut((j * self.size[0] + i) as usize))
            .flatten()
    }

    /// All columns.
    pub(crate) fn columns_mut(&mut self) -> &mut [BlockColumn<B>] {
        &mut self.columns
    }

    /// Whether there is nothing in a box of blocks.
    pub(crate) fn is_empty_in(&self, extent: &CellBox) -> bool {
        let heights = extent.lo[2]..extent.hi[2];
        block_columns(extent).into_iter().all(|(x, y)| {
            let column = self.column(x, y);
            let solid = column.solid.start.max(heights.start)..column.solid.end.min(heights.end);
            solid.is_empty() && !column.slots.iter().any(|s| heights.contains(&s.0))
        })
    }
}

impl<T: Copy> Blocks<Cells<T>> {
    /// Whether any cell is deep solid.
    pub(crate) fn has_solid(&self) -> bool {
        let solid = |slot: &Slot<Cells<T>>| match slot {
            Slot::Solid => true,
            Slot::Mixed(cells) => *cells.solid() != NONE,
        };
        self.columns
            .iter()
            .any(|column| !column.solid.is_empty() || column.slots.iter().any(|(_, slot)| solid(slot)))
    }

    /// What a cell is.
    pub(crate) fn at(&self, [x, y, z]: [i64; 3]) -> Cell<T> {
        let column = self.column(x.div_euclid(SIDE), y.div_euclid(SIDE));
        match column.get(z.div_euclid(SIDE)) {
            Block::Empty => Cell::Empty,
            Block::Solid => Cell::Solid,
            Block::Mixed(cells) => cells.get(in_block(x, y, z)),
        }
    }

    /// Heights of all cells with something in a column of cells, and of some without.
    pub(crate) fn heights(&self, x: i64, y: i64) -> Range<i64> {
        let column = self.column(x.div_euclid(SIDE), y.div_euclid(SIDE));
        let ends = column.slots.first().zip(column.slots.last());
        let slots = ends.map_or(0..0, |(first, last)| first.0..last.0 + 1);
        let blocks = match (slots.is_empty(), column.solid.is_empty()) {
            (true, _) => column.solid.clone(),
            (_, true) => slots,
            _ => slots.start.min(column.solid.start)..slots.end.max(column.solid.end),
        };
        SIDE * blocks.start..SIDE * blocks.end
    }

    /// Makes a cell in the box solid.
    pub(crate) fn make_solid(&mut self, [x, y, z]: [i64; 3]) {
        let (i, j) = (x.div_euclid(SIDE) - self.lo[0], y.div_euclid(SIDE) - self.lo[1]);
        let column = &mut self.columns[(j * self.size[0] + i) as usize];
        let block = z.div_euclid(SIDE);
        let at = match column.slots.binary_search_by_key(&block, |s| s.0) {
            Ok(at) => at,
            Err(_) if column.solid.contains(&block) => return,
            Err(at) => {
                column.slots.insert(at, (block, Slot::Mixed(Cells::nothing())));
                at
            }
        };
        if let Slot::Mixed(cells) = &mut column.slots[at].1 {
            cells.make_solid(in_block(x, y, z));
        }
    }
}

/// Block positions of an extent in rows of x.
pub(crate) fn block_columns(extent: &CellBox) -> Vec<(i64, i64)> {
    let [x0, y0, _] = extent.lo;
    let [x1, y1, _] = extent.hi;
    (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_come_before_the_solid_range() {
        let column = BlockColumn {
            solid: -4..3,
            slots: vec![(-1, Slot::Mixed(())), (5, Slot::Solid)],
        };
        let kinds: String = (-5..7)
            .map(|z| match column.get(z) {
                Block::Empty => '.',
                Block::Solid => 's',
                Block::Mixed(()) => 'm',
            })
            .collect();
        assert_eq!(kinds, ".sssmsss..s.");
    }
}
