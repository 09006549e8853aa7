//! Rasters of any size: four bytes a pixel, kept whole or read in blocks, and windows of them.
//!
//! A raster comes from its file row by row ([`Rows`]) or, where the format allows it, block by block in any order
//! ([`Blocks`]). One that the cache has room for is kept whole. Of others, blocks are read when they are wanted, from the
//! file itself or, where that would read the same rows again and again, from a file without a name in the scratch folder,
//! in which the pixels lie in blocks as they are. Values do not depend on which it is. Immutable; any thread.

use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::block_cache::{Cell, Held, RasterCache};
use super::error::InputError;
use super::scratch::Scratch;

/// Bytes of a pixel.
pub(crate) const CELL: u64 = size_of::<Cell>() as u64;
/// Side of a block of a scratch file, pixels, unless rows are too long for it.
pub(crate) const BLOCK: u32 = 256;

/// A raster that is read from top to bottom.
pub(crate) trait Rows {
    /// Pixels per row, and rows.
    fn size(&self) -> (u32, u32);
    /// Fills in the next row.
    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError>;
}

/// A raster that is read in blocks of one size, those along the right and lower edges cut off.
pub(crate) trait Blocks: Debug + Send + Sync {
    /// All pixels of the block in a column and row of blocks, row by row.
    fn read(&self, column: u32, row: u32) -> Result<Vec<Cell>, InputError>;
}

/// How a raster is divided.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    /// Of the raster: pixels per row, and rows.
    pub(crate) size: (u32, u32),
    /// Of a block.
    pub(crate) block: (u32, u32),
}

impl Grid {
    pub(crate) fn across(&self) -> u32 {
        self.size.0.div_ceil(self.block.0)
    }

    fn down(&self) -> u32 {
        self.size.1.div_ceil(self.block.1)
    }

    /// Pixels of a block: columns and rows.
    pub(crate) fn area(&self, column: u32, row: u32) -> (Range<u32>, Range<u32>) {
        let range = |k: u32, block: u32, size: u32| {
            let start = k.saturating_mul(block).min(size);
            start..start.saturating_add(block).min(size)
        };
        (
            range(column, self.block.0, self.size.0),
            range(row, self.block.1, self.size.1),
        )
    }
}

/// A raster.
#[derive(Debug)]
pub(crate) struct Cells {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(super) store: Store,
}

/// How it is kept.
#[derive(Debug)]
pub(super) enum Store {
    Whole { cells: Vec<Cell>, _held: Option<Held> },
    Parts(Parts),
}

/// A raster that is read in blocks.
#[derive(Debug)]
pub(super) struct Parts {
    number: u32,
    pub(super) grid: Grid,
    blocks: Box<dyn Blocks>,
    cache: Arc<RasterCache>,
}

impl Parts {
    /// All pixels of the block in a column and row of blocks.
    pub(super) fn block(&self, column: u32, row: u32) -> Result<Arc<[Cell]>, InputError> {
        let (columns, rows) = self.grid.area(column, row);
        let number = u64::from(row) * u64::from(self.grid.across()) + u64::from(column);
        let bytes = (columns.len() * rows.len()) as u64 * CELL;
        self.cache
            .block((self.number, number), bytes, || self.blocks.read(column, row))
    }
}

/// A rectangle of a raster's pixels.
#[derive(Debug)]
pub(crate) struct Window<'a> {
    /// Of the raster.
    pub(crate) size: (u32, u32),
    /// Column and row of the first pixel.
    start: (usize, usize),
    stride: usize,
    cells: Cow<'a, [Cell]>,
}

impl Window<'static> {
    /// A whole raster.
    pub(crate) fn owned(width: u32, height: u32, cells: Vec<Cell>) -> Self {
        Self {
            size: (width, height),
            start: (0, 0),
            stride: width as usize,
            cells: Cow::Owned(cells),
        }
    }
}

impl Window<'_> {
    /// The pixel in a column and row of the raster; `None` outside the window.
    #[inline]
    pub(crate) fn get(&self, column: usize, row: usize) -> Option<Cell> {
        self.row(row, column..column + 1).first().copied()
    }

    /// Some columns of a row of the raster, as far as they are in the window.
    #[inline]
    pub(crate) fn row(&self, row: usize, columns: Range<usize>) -> &[Cell] {
        let (first, last) = (
            columns.start.wrapping_sub(self.start.0),
            columns.end.wrapping_sub(self.start.0),
        );
        if last > self.stride {
            return &[];
        }
        let at = row.wrapping_sub(self.start.1).wrapping_mul(self.stride);
        let range = at.wrapping_add(first)..at.wrapping_add(last);
        self.cells.get(range).unwrap_or_default()
    }
}

/// What sees every pixel while a raster is read: column and row of the first of some pixels of a row.
pub(crate) type See<'a> = &'a mut dyn FnMut(u32, u32, &[Cell]);

impl Cells {
    /// A raster in memory.
    pub(crate) fn whole(width: u32, height: u32, cells: Vec<Cell>) -> Self {
        Self::kept((width, height), cells, None)
    }

    fn kept((width, height): (u32, u32), cells: Vec<Cell>, _held: Option<Held>) -> Self {
        Self {
            width,
            height,
            store: Store::Whole { cells, _held },
        }
    }

    /// Reads a raster once, from top to bottom.
    ///
    /// # Errors
    /// Those of the rows, and of the scratch file.
    pub(crate) fn from_rows(
        rows: &mut dyn Rows,
        cache: &Arc<RasterCache>,
        see: See,
    ) -> Result<Self, InputError> {
        let size = rows.size();
        let (width, height) = size;
        let pixels = u64::from(width) * u64::from(height);
        if let Some(held) = cache.hold(pixels * CELL) {
            let mut cells = vec![Cell::default(); pixels as usize];
            for (y, row) in cells.chunks_mut(width as usize).enumerate() {
                rows.next(row)?;
                see(0, y as u32, row);
            }
            return Ok(Self::kept(size, cells, Some(held)));
        }
        let mut row = 0;
        Self::scratch(size, cache, &mut |band| {
            for cells in band.chunks_mut(width as usize) {
                rows.next(cells)?;
                see(0, row, cells);
                row += 1;
            }
            Ok(())
        })
    }

    /// Takes a raster whose blocks can be read in any order; `see` sees them all if it is given.
    ///
    /// # Errors
    /// Those of the blocks, and of the scratch file.
    pub(crate) fn from_blocks(
        path: &Path,
        grid: Grid,
        blocks: Box<dyn Blocks>,
        cache: &Arc<RasterCache>,
        see: Option<See>,
    ) -> Result<Self, InputError> {
        let (width, height) = grid.size;
        let pixels = u64::from(width) * u64::from(height);
        let block_bytes = u64::from(grid.block.0) * u64::from(grid.block.1) * CELL;
        let mut nothing = |_: u32, _: u32, _: &[Cell]| ();
        let seen = see.is_some();
        let see: See = see.unwrap_or(&mut nothing);
        if let Some(held) = cache.hold(pixels * CELL) {
            let mut cells = vec![Cell::default(); pixels as usize];
            for row in 0..grid.down() {
                let (_, rows) = grid.area(0, row);
                let start = rows.start as usize * width as usize;
                let band = &mut cells[start..start + rows.len() * width as usize];
                read_band(&*blocks, &grid, row, band, see)?;
            }
            return Ok(Self::kept(grid.size, cells, Some(held)));
        }
        if block_bytes > cache.budget() / 4 {
            return Err(InputError::Memory {
                path: path.to_path_buf(),
                bytes: block_bytes,
                budget: cache.budget() / 4,
            });
        }
        // Rows of blocks lower than what a tree needs are read again by all trees beside it.
        let around = u64::from(grid.block.1.max(BLOCK)) * u64::from(grid.block.0) * CELL;
        let band_bytes = u64::from(grid.block.1) * u64::from(width) * CELL;
        if around > cache.budget() / 8 && band_bytes <= cache.budget() / 4 {
            let _used = cache.borrow(band_bytes);
            let mut pending: Vec<Cell> = Vec::new();
            let mut next = 0;
            return Self::scratch(grid.size, cache, &mut |out| {
                while pending.len() < out.len() {
                    let (_, rows) = grid.area(0, next);
                    let start = pending.len();
                    pending.resize(start + rows.len() * width as usize, Cell::default());
                    read_band(&*blocks, &grid, next, &mut pending[start..], see)?;
                    next += 1;
                }
                out.copy_from_slice(&pending[..out.len()]);
                pending.drain(..out.len());
                Ok(())
            });
        }
        if seen {
            let all: Vec<(u32, u32)> = (0..grid.down())
                .flat_map(|row| (0..grid.across()).map(move |column| (column, row)))
                .collect();
            let together =
                (cache.budget() / 4 / block_bytes).clamp(1, 2 * rayon::current_num_threads() as u64);
            let _used = cache.borrow(together * block_bytes);
            for some in all.chunks(together as usize) {
                let read: Vec<_> = some.par_iter().map(|&(c, r)| (c, r, blocks.read(c, r))).collect();
                for (column, row, cells) in read {
                    let (columns, rows) = grid.area(column, row);
                    for (row, cells) in rows.zip(cells?.chunks(columns.len())) {
                        see(columns.start, row, cells);
                    }
                }
            }
        }
        Ok(Self::parts(grid, blocks, cache))
    }

    fn parts(grid: Grid, blocks: Box<dyn Blocks>, cache: &Arc<RasterCache>) -> Self {
        Self {
            width: grid.size.0,
            height: grid.size.1,
            store: Store::Parts(Parts {
                number: cache.raster(),
                grid,
                blocks,
                cache: Arc::clone(cache),
            }),
        }
    }

    /// Lays a raster out in a scratch file; `fill` is given one band after the other.
    fn scratch(
        size: (u32, u32),
        cache: &Arc<RasterCache>,
        fill: &mut dyn FnMut(&mut [Cell]) -> Result<(), InputError>,
    ) -> Result<Self, InputError> {
        let row_bytes = u64::from(size.0) * CELL;
        // A band, and the block of it that is written.
        let rows = (cache.bands() / 2 / row_bytes).clamp(1, u64::from(BLOCK)) as u32;
        let grid = Grid {
            size,
            block: (BLOCK.min(size.0), rows.min(size.1)),
        };
        let blocks = Scratch::new(cache, grid);
        let _used = cache.borrow(2 * row_bytes * u64::from(grid.block.1));
        let mut band = vec![Cell::default(); size.0 as usize * grid.block.1 as usize];
        for row in 0..grid.down() {
            let (_, rows) = grid.area(0, row);
            let band = &mut band[..rows.len() * size.0 as usize];
            fill(band)?;
            blocks.write(row, band)?;
        }
        Ok(Self::parts(grid, Box::new(blocks), cache))
    }

    /// A rectangle of pixels, cut to the raster.
    ///
    /// # Errors
    /// If a block cannot be read.
    pub(crate) fn window(&self, columns: Range<u32>, rows: Range<u32>) -> Result<Window<'_>, InputError> {
        let size = (self.width, self.height);
        match &self.store {
            Store::Whole { cells, .. } => Ok(Window {
                size,
                start: (0, 0),
                stride: self.width as usize,
                cells: Cow::Borrowed(cells),
            }),
            Store::Parts(parts) => {
                let grid = &parts.grid;
                let cut = |r: Range<u32>, size: u32| {
                    let end = r.end.min(size);
                    r.start.min(end)..end
                };
                let (columns, rows) = (cut(columns, self.width), cut(rows, self.height));
                let stride = columns.len();
                let mut cells = vec![Cell::default(); stride * rows.len()];
                let touched = |r: &Range<u32>, block: u32| match r.is_empty() {
                    true => 0..0,
                    false => r.start / block..(r.end - 1) / block + 1,
                };
                for y in touched(&rows, grid.block.1) {
                    for x in touched(&columns, grid.block.0) {
                        let (bc, br) = grid.area(x, y);
                        let block = parts.block(x, y)?;
                        let (left, right) = (bc.start.max(columns.start), bc.end.min(columns.end));
                        let n = (right - left) as usize;
                        for row in br.start.max(rows.start)..br.end.min(rows.end) {
                            let from = (row - br.start) as usize * bc.len() + (left - bc.start) as usize;
                            let to = (row - rows.start) as usize * stride + (left - columns.start) as usize;
                            if let Some(part) = block.get(from..from + n) {
                                cells[to..to + n].copy_from_slice(part);
                            }
                        }
                    }
                }
                Ok(Window {
                    size,
                    start: (columns.start as usize, rows.start as usize),
                    stride,
                    cells: Cow::Owned(cells),
                })
            }
        }
    }

    /// Copies a row of pixels.
    ///
    /// # Errors
    /// If a block cannot be read.
    pub(crate) fn copy_row(&self, row: u32, to: &mut [Cell]) -> Result<(), InputError> {
        let window = self.window(0..self.width, row..row.saturating_add(1))?;
        let from = window.row(row as usize, 0..self.width as usize);
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        Ok(())
    }

    /// All pixels.
    ///
    /// # Errors
    /// If a block cannot be read.
    pub(crate) fn all(&self) -> Result<Window<'_>, InputError> {
        self.window(0..self.width, 0..self.height)
    }
}

/// Reads a row of blocks into the rows of the raster that it fills.
fn read_band(
    blocks: &dyn Blocks,
    grid: &Grid,
    row: u32,
    band: &mut [Cell],
    see: &mut dyn FnMut(u32, u32, &[Cell]),
) -> Result<(), InputError> {
    let width = grid.size.0 as usize;
    let numbers: Vec<u32> = (0..grid.across()).collect();
    for some in numbers.chunks(2 * rayon::current_num_threads()) {
        let read: Vec<_> = some
            .par_iter()
            .map(|&column| (column, blocks.read(column, row)))
            .collect();
        for (column, cells) in read {
            let (columns, _) = grid.area(column, row);
            let columns = columns.start as usize..columns.end as usize;
            for (line, part) in band.chunks_mut(width).zip(cells?.chunks(columns.len())) {
                line[columns.clone()].copy_from_slice(part);
            }
        }
    }
    let (_, rows) = grid.area(0, row);
    for (row, cells) in rows.zip(band.chunks(width)) {
        see(0, row, cells);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cell(column: u32, row: u32) -> Cell {
        (row * 1000 + column).to_le_bytes()
    }

    struct Counting {
        size: (u32, u32),
        next: u32,
    }

    impl Rows for Counting {
        fn size(&self) -> (u32, u32) {
            self.size
        }

        fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
            row.iter_mut()
                .enumerate()
                .for_each(|(c, out)| *out = cell(c as u32, self.next));
            self.next += 1;
            Ok(())
        }
    }

    #[derive(Debug)]
    struct Made(Grid);

    impl Blocks for Made {
        fn read(&self, column: u32, row: u32) -> Result<Vec<Cell>, InputError> {
            let (columns, rows) = self.0.area(column, row);
            Ok(rows
                .flat_map(|r| columns.clone().map(move |c| cell(c, r)))
                .collect())
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn windows_do_not_depend_on_how_a_raster_is_kept(
            (w, h) in (1u32..700, 1u32..400), block in (1u32..700, 1u32..400), budget in 5_000u64..3_000_000,
            (x0, x1, y0, y1) in (0u32..700, 0u32..700, 0u32..400, 0u32..400), blocks in any::<bool>(),
        ) {
            let dir = tempfile::tempdir().unwrap();
            let cache = RasterCache::new(budget, dir.path());
            let grid = Grid { size: (w, h), block: (block.0.min(w), block.1.min(h)) };
            let mut seen = 0;
            let mut see = |column: u32, row: u32, cells: &[Cell]| {
                for (k, c) in cells.iter().enumerate() {
                    assert_eq!(*c, cell(column + k as u32, row));
                }
                seen += cells.len();
            };
            let raster = if blocks {
                match Cells::from_blocks(Path::new("a"), grid, Box::new(Made(grid)), &cache, Some(&mut see)) {
                    Ok(raster) => raster,
                    Err(InputError::Memory { bytes, .. }) => {
                        prop_assert!(bytes > budget / 4);
                        return Ok(());
                    }
                    Err(e) => panic!("{e}"),
                }
            } else {
                Cells::from_rows(&mut Counting { size: (w, h), next: 0 }, &cache, &mut see).unwrap()
            };
            prop_assert_eq!(seen, (w * h) as usize);
            let window = raster.window(x0..x1, y0..y1).unwrap();
            for r in y0..y1.min(h) {
                for c in x0..x1.min(w) {
                    prop_assert_eq!(window.get(c as usize, r as usize), Some(cell(c, r)));
                }
            }
            let largest = u64::from(grid.block.0) * u64::from(grid.block.1) * CELL;
            prop_assert!(cache.peak_bytes() <= budget.max(largest.max(u64::from(BLOCK.pow(2)) * CELL)), "{}", cache.peak_bytes());
        }
    }
}
