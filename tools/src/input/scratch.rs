//! The file without a name in which rasters lie in blocks that do not fit into memory and cannot be read from their own files in
//! parts.
//!
//! One for all rasters of a cache, however many they are: each takes a stretch of it, and none is given back before the cache
//! ends. Any thread; one reads or writes at a time.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::block_cache::{Cell, RasterCache};
use super::cells::{Blocks, CELL, Grid};
use super::error::InputError;

/// The file, made when it is first needed.
#[derive(Debug)]
pub(crate) struct ScratchFile {
    folder: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    file: Option<File>,
    /// Bytes that rasters have taken.
    end: u64,
}

impl ScratchFile {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            state: Mutex::default(),
        }
    }

    /// Takes a stretch of so many bytes; gives its start.
    fn take(&self, bytes: u64) -> u64 {
        let mut state = self.lock();
        let start = state.end;
        state.end += bytes;
        start
    }

    /// Does something to the file from a byte on.
    fn at(&self, offset: u64, act: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), InputError> {
        let mut state = self.lock();
        let done = (|| {
            let file = match &mut state.file {
                Some(file) => file,
                none => none.insert(tempfile::tempfile_in(&self.folder)?),
            };
            file.seek(SeekFrom::Start(offset))?;
            act(file)
        })();
        done.map_err(|e| InputError::io(&self.folder, e))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Places are set before each use of the file.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A raster in the scratch file.
#[derive(Debug)]
pub(crate) struct Scratch {
    cache: Arc<RasterCache>,
    start: u64,
    grid: Grid,
}

impl Scratch {
    /// Takes room for a raster.
    pub(crate) fn new(cache: &Arc<RasterCache>, grid: Grid) -> Self {
        let pixels = u64::from(grid.size.0) * u64::from(grid.size.1);
        Self {
            cache: Arc::clone(cache),
            start: cache.scratch().take(pixels * CELL),
            grid,
        }
    }

    /// Writes a row of blocks, of which all pixels are given row by row.
    pub(crate) fn write(&self, row: u32, band: &[Cell]) -> Result<(), InputError> {
        for column in 0..self.grid.across() {
            let (columns, rows) = self.grid.area(column, row);
            let mut bytes = Vec::with_capacity(columns.len() * rows.len() * CELL as usize);
            for line in band.chunks(self.grid.size.0 as usize) {
                bytes.extend_from_slice(line[columns.start as usize..columns.end as usize].as_flattened());
            }
            let offset = self.offset(column, row);
            self.cache.scratch().at(offset, |file| file.write_all(&bytes))?;
        }
        Ok(())
    }

    /// Where a block begins in the file.
    fn offset(&self, column: u32, row: u32) -> u64 {
        let (columns, rows) = self.grid.area(column, row);
        let before = u64::from(rows.start) * u64::from(self.grid.size.0)
            + u64::from(columns.start) * rows.len() as u64;
        self.start + before * CELL
    }
}

impl Blocks for Scratch {
    fn read(&self, column: u32, row: u32) -> Result<Vec<Cell>, InputError> {
        let (columns, rows) = self.grid.area(column, row);
        let mut cells = vec![Cell::default(); columns.len() * rows.len()];
        let offset = self.offset(column, row);
        self.cache
            .scratch()
            .at(offset, |file| file.read_exact(cells.as_flattened_mut()))?;
        Ok(cells)
    }
}
