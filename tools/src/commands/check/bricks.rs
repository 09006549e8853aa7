//! The brick file of one level: header, directory, every chunk, against the nodes that refer to it.
//!
//! Chunks are read in parallel; of each only the fingerprints of its seams are kept.

use brickfell_formats::FormatError;
use brickfell_formats::bricks::{BrickIndex, ChunkEntry, HEADER_BYTES, decode_header};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::morton;
use brickfell_pager::Store;
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::seams::{Seam, disagreements, seams};
use crate::commands::fault::Fault;

/// A level of a tree and the file that has its bricks.
pub(crate) struct Level<'a> {
    /// Where to read.
    pub(crate) store: &'a dyn Store,
    /// Name of the brick file.
    pub(crate) file: String,
    /// Level, 0 is the root.
    pub(crate) level: u8,
    /// The tree's sample layout.
    pub(crate) layout: SampleLayout,
    /// Morton codes of the nodes with bricks, ascending.
    pub(crate) bricks: Vec<u64>,
}

/// What was found out about a level.
#[derive(Debug, Default)]
pub(super) struct LevelReport {
    /// Chunks that decode.
    pub(super) chunks: u64,
    /// Whether the file is in blocks, if it can be read.
    pub(super) blocks: Option<bool>,
    /// What is wrong.
    pub(super) faults: Vec<Fault>,
}

/// Checks a level.
pub(super) fn check_level(level: &Level, bar: &ProgressBar) -> LevelReport {
    let mut report = LevelReport::default();
    let index = match level.index() {
        Ok(index) => index,
        Err(fault) => {
            report.faults.push(fault);
            return report;
        }
    };
    let blocks = index.header.encoding == Encoding::Blocks;
    report.blocks = Some(blocks);
    bar.inc(HEADER_BYTES as u64 + (index.header.directory().end - index.header.directory().start));
    if let Err(fault) = level.check_masks(&index) {
        report.faults.push(fault);
        return report;
    }
    let numbers: Vec<u32> = (0..index.header.chunks).collect();
    let chunks: Vec<Result<Vec<Seam>, Fault>> = numbers
        .par_iter()
        .map(|chunk| level.chunk(&index, *chunk, bar))
        .collect();
    let mut all = Vec::new();
    for chunk in chunks {
        match chunk {
            Ok(seams) => {
                report.chunks += 1;
                all.extend(seams);
            }
            Err(fault) => report.faults.push(fault),
        }
    }
    // In blocks each brick has samples of its own, a little different at every seam.
    let (pairs, first) = if blocks { (0, None) } else { disagreements(all) };
    if let Some((a, b)) = first {
        report.faults.push(level.fault(file(format!(
            "{pairs} pairs of neighbouring bricks in different chunks disagree about samples that they share, \
             first {a} and {b}"
        ))));
    }
    report
}

fn file(message: String) -> FormatError {
    FormatError::file(message)
}

impl Level<'_> {
    fn fault(&self, error: FormatError) -> Fault {
        Fault::new(self.store, &self.file, error)
    }

    fn read(&self, offset: u64, len: u64) -> Result<Vec<u8>, Fault> {
        let size = usize::try_from(len)
            .map_err(|_| self.fault(FormatError::at(offset, "a part is too long for this machine")))?;
        self.store
            .read(&self.file, offset, size)
            .map_err(|e| self.fault(FormatError::at(offset, format!("cannot be read: {e}"))))
    }

    /// Header and directory, and that they belong to this level of this tree.
    ///
    /// # Errors
    /// What cannot be read, or is wrong.
    pub(crate) fn index(&self) -> Result<BrickIndex, Fault> {
        let len = self
            .store
            .len(&self.file)
            .map_err(|e| Fault::unreadable(self.store, &self.file, "opened", &e))?;
        let head = self.read(0, len.min(HEADER_BYTES as u64))?;
        let header = decode_header(&head, len).map_err(|e| self.fault(e))?;
        if header.level != self.level {
            return Err(self.fault(FormatError::at(
                12,
                format!("it is of level {}, its name says {}", header.level, self.level),
            )));
        }
        if header.layout != self.layout {
            return Err(self.fault(FormatError::at(
                13,
                format!(
                    "its sample layout is {:?}, the tree's is {:?}",
                    header.layout, self.layout
                ),
            )));
        }
        if header.bricks as usize != self.bricks.len() {
            return Err(self.fault(FormatError::at(
                24,
                format!(
                    "it has {} bricks, the octree refers to {}",
                    header.bricks,
                    self.bricks.len()
                ),
            )));
        }
        let directory = header.directory();
        let bytes = self.read(directory.start, directory.end - directory.start)?;
        header.decode_directory(&bytes).map_err(|e| self.fault(e))
    }

    /// That the directory lists exactly the bricks that nodes refer to.
    fn check_masks(&self, index: &BrickIndex) -> Result<(), Fault> {
        let mut expected = self.bricks.iter();
        for (k, chunk) in index.chunks.iter().enumerate() {
            for code in codes(chunk, index.header.chunk_log2) {
                let wanted = expected.next();
                if wanted != Some(&code) {
                    return Err(self.fault(FormatError::at(chunk.offset, format!(
                        "chunk {k} lists a brick for node {} of level {}, the octree's next brick node is {}",
                        morton::decode(code),
                        self.level,
                        wanted.map_or("none".into(), |c| morton::decode(*c).to_string()),
                    ))));
                }
            }
        }
        Ok(())
    }

    /// A chunk of the file and its entry.
    ///
    /// # Errors
    /// What cannot be read, or is wrong.
    pub(crate) fn decode(&self, index: &BrickIndex, chunk: u32) -> Result<(ChunkEntry, Chunk), Fault> {
        let Some(entry) = index.chunks.get(chunk as usize) else {
            return Err(self.fault(file(format!("there is no chunk {chunk}"))));
        };
        let bytes = self.read(entry.offset, u64::from(entry.length))?;
        let decoded = index.decode_chunk(chunk, &bytes).map_err(|e| self.fault(e))?;
        Ok((*entry, decoded))
    }

    fn chunk(&self, index: &BrickIndex, chunk: u32, bar: &ProgressBar) -> Result<Vec<Seam>, Fault> {
        let (entry, decoded) = self.decode(index, chunk)?;
        bar.inc(u64::from(entry.length));
        let corner = index.chunk_corner(&entry);
        Ok(seams(&decoded, corner, index.header.chunk_log2, &self.bricks))
    }
}

/// Morton codes, in the level, of the bricks of a chunk.
pub(crate) fn codes(chunk: &ChunkEntry, chunk_log2: u8) -> impl Iterator<Item = u64> {
    let (mask, first) = (chunk.mask, chunk.morton << (3 * u32::from(chunk_log2)));
    (0..64u64)
        .filter(move |m| mask >> m & 1 == 1)
        .map(move |m| first | m)
}
