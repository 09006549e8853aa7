//! Pixels of a raster one after the other, near each other rather than in order: texels of a surface.
//!
//! A raster that is kept whole is looked into directly. Of one that is read in blocks the last block stays at hand, so that the
//! cache that all threads share is asked only where the next pixel lies in another one. One thread.

use std::ops::Range;
use std::sync::Arc;

use super::block_cache::Cell;
use super::cells::{Cells, Parts, Store};
use super::error::InputError;

/// Looks into a raster.
#[derive(Clone, Debug)]
pub(crate) struct Pixels<'a> {
    cells: &'a Cells,
    last: Option<Block>,
}

#[derive(Clone, Debug)]
struct Block {
    columns: Range<u32>,
    rows: Range<u32>,
    cells: Arc<[Cell]>,
}

impl<'a> Pixels<'a> {
    pub(crate) fn new(cells: &'a Cells) -> Self {
        Self { cells, last: None }
    }

    /// `N` pixels of a row from a column on, all of which are in the raster and, if it is read in blocks, in one of them.
    ///
    /// # Errors
    /// If a block cannot be read.
    #[inline]
    pub(crate) fn get<const N: usize>(&mut self, column: u32, row: u32) -> Result<[Cell; N], InputError> {
        match &self.cells.store {
            Store::Whole { cells, .. } => {
                let at = row as usize * self.cells.width as usize + column as usize;
                Ok(some(cells, at))
            }
            Store::Parts(parts) => self.in_block(parts, column, row),
        }
    }

    #[inline(never)]
    fn in_block<const N: usize>(
        &mut self,
        parts: &Parts,
        column: u32,
        row: u32,
    ) -> Result<[Cell; N], InputError> {
        let at_hand = |b: &Block| b.columns.contains(&column) && b.rows.contains(&row);
        let block = match self.last.take().filter(at_hand) {
            Some(block) => block,
            None => {
                let (x, y) = (column / parts.grid.block.0, row / parts.grid.block.1);
                let (columns, rows) = parts.grid.area(x, y);
                let cells = parts.block(x, y)?;
                Block { columns, rows, cells }
            }
        };
        let block = self.last.insert(block);
        let at = (row - block.rows.start) as usize * block.columns.len();
        Ok(some(&block.cells, at + (column - block.columns.start) as usize))
    }
}

/// Some pixels that follow each other; empty ones where there are not as many.
#[inline]
pub(crate) fn some<const N: usize>(cells: &[Cell], at: usize) -> [Cell; N] {
    let cells = cells.get(at..).and_then(|cells| cells.first_chunk());
    cells.copied().unwrap_or([Cell::default(); N])
}
