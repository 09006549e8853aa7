//! Reading, checking and decoding one page. Called by loader threads, outside every lock.
//!
//! Whatever a file claims is checked before it is believed: sizes against the file and against limits before anything is
//! allocated, brick files against the tree they belong to.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use brickfell_formats::bricks::{self, BrickHeader, BrickIndex, ChunkEntry, brick_file_name};
use brickfell_formats::chunk::Encoding;
use brickfell_formats::occupancy::Occupancy;
use brickfell_formats::octree::{self, Node, TreeHeader, count_bricks};
use brickfell_formats::octree_binary::{self, LevelEntry, OctreeIndex};

use crate::page::{Bricks, ChunkPage, LevelPage, RootPage, level_memory};
use crate::store::Store;

/// Longest XML octree that is read: they are written by hand or for tests.
const MAX_XML_BYTES: u64 = 1 << 28;

/// Longest payload of a chunk. The samples of 4³ bricks take a quarter of it before compression.
const MAX_PAYLOAD_BYTES: u32 = 1 << 20;

/// What the budget is asked for before the length of an octree file is known.
pub(crate) const ROOT_ESTIMATE: u64 = 16 << 10;

/// Why a page was not loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LoadError {
    /// It needs this many bytes, more than were estimated, and the budget has no room for them now.
    Outgrown(u64),
    /// Path, place and reason on one line.
    Failed(String),
}

/// What loaders have done so far, all together.
#[derive(Debug, Default)]
pub(crate) struct Meters {
    /// Bytes read from the store.
    pub(crate) bytes_read: AtomicU64,
    /// Nanoseconds in which chunks were verified and decoded.
    pub(crate) decode_nanos: AtomicU64,
}

/// How a load speaks to the store and to the budget.
pub(crate) struct Reader<'a> {
    /// Where to read.
    pub(crate) store: &'a dyn Store,
    /// Counts what was done.
    pub(crate) meters: &'a Meters,
    /// Whether blocks stay blocks.
    pub(crate) keep_blocks: bool,
    /// Asks for this many bytes in all for the page; false if there is no room.
    pub(crate) reserve: &'a dyn Fn(u64) -> bool,
    /// To be called when the last read of the page has returned.
    pub(crate) read_done: &'a dyn Fn(),
}

impl Reader<'_> {
    pub(crate) fn fail(&self, name: &str, reason: impl std::fmt::Display) -> LoadError {
        let message = format!("{}: {reason}", self.store.describe(name));
        LoadError::Failed(message.replace(['\n', '\r'], " "))
    }

    fn len(&self, name: &str) -> Result<u64, LoadError> {
        self.store
            .len(name)
            .map_err(|e| self.fail(name, format!("cannot be opened: {e}")))
    }

    fn read(&self, name: &str, offset: u64, len: u64) -> Result<Vec<u8>, LoadError> {
        let size =
            usize::try_from(len).map_err(|_| self.fail(name, "a part is too long for this machine"))?;
        let bytes = self
            .store
            .read(name, offset, size)
            .map_err(|e| self.fail(name, format!("byte {offset}: cannot be read: {e}")))?;
        (self.meters.bytes_read).fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(bytes)
    }

    fn reserve(&self, bytes: u64) -> Result<(), LoadError> {
        if (self.reserve)(bytes) {
            Ok(())
        } else {
            Err(LoadError::Outgrown(bytes))
        }
    }

    /// Loads the root page of the tree in an octree file.
    pub(crate) fn root(&self, name: &str) -> Result<RootPage, LoadError> {
        let len = self.len(name)?;
        let prefix = self.read(name, 0, len.min(octree_binary::prefix_len() as u64))?;
        let (header, index, mut levels) = if octree_binary::is_binary(&prefix) {
            let index = octree_binary::decode_header(&prefix, len).map_err(|e| self.fail(name, e))?;
            let nodes = self.nodes(name, &index, 0)?;
            (index.header, Some(index), vec![nodes])
        } else {
            if len > MAX_XML_BYTES {
                return Err(self.fail(
                    name,
                    format!("an XML octree of {len} bytes is above {MAX_XML_BYTES}"),
                ));
            }
            self.reserve(2 * len)?;
            let bytes = self.read(name, 0, len)?;
            let tree = octree::decode_any(&bytes).map_err(|e| self.fail(name, e))?;
            (tree.header, None, tree.levels)
        };
        let mut pages = Vec::with_capacity(levels.len());
        for (level, nodes) in levels.drain(..).enumerate() {
            pages.push(Arc::new(self.level_page(name, &header, level as u8, nodes)?));
        }
        if pages.is_empty() {
            return Err(self.fail(name, "the octree has no level"));
        }
        let level0 = pages.remove(0);
        let chunk0 = match &level0.bricks {
            None => None,
            Some(bricks) => Some(Arc::new(self.chunk(&brick_file_name(name, 0), bricks, 0)?)),
        };
        (self.read_done)();
        Ok(RootPage {
            header,
            index,
            level0,
            chunk0,
            preloaded: pages,
        })
    }

    /// Loads a level of a binary octree.
    pub(crate) fn level(&self, name: &str, index: &OctreeIndex, level: u8) -> Result<LevelPage, LoadError> {
        let nodes = self.nodes(name, index, level)?;
        let page = self.level_page(name, &index.header, level, nodes)?;
        (self.read_done)();
        Ok(page)
    }

    /// Loads a chunk by its number in the directory.
    pub(crate) fn chunk(&self, name: &str, bricks: &BrickIndex, chunk: u32) -> Result<ChunkPage, LoadError> {
        let Some(entry) = bricks.chunks.get(chunk as usize) else {
            return Err(self.fail(name, format!("there is no chunk {chunk}")));
        };
        let bytes = self.read(name, entry.offset, u64::from(entry.length))?;
        (self.read_done)();
        let start = Instant::now();
        let page = if self.keep_blocks {
            bricks.block_chunk(chunk, bytes).map(Bricks::Blocks)
        } else {
            bricks.decode_chunk(chunk, &bytes).map(Bricks::Samples)
        };
        let page = page.map(ChunkPage::new);
        let nanos = start.elapsed().as_nanos() as u64;
        (self.meters.decode_nanos).fetch_add(nanos, Ordering::Relaxed);
        page.map_err(|e| self.fail(name, e))
    }

    fn nodes(&self, name: &str, index: &OctreeIndex, level: u8) -> Result<Vec<Node>, LoadError> {
        let Some(entry) = index.levels.get(usize::from(level)) else {
            return Err(self.fail(name, format!("there is no level {level}")));
        };
        let bytes = self.read(name, entry.offset, entry.bytes)?;
        index.decode_level(level, &bytes).map_err(|e| self.fail(name, e))
    }
    fn level_page(
        &self,
        name: &str,
        header: &TreeHeader,
        level: u8,
        nodes: Vec<Node>,
    ) -> Result<LevelPage, LoadError> {
        let expected = count_bricks(&nodes);
        let bricks = match expected {
            0 => None,
            _ => Some(self.directory(&brick_file_name(name, level), header, level, &nodes, expected)?),
        };
        Ok(LevelPage { nodes, bricks })
    }

    /// Reads the directory of a brick file and checks that the file belongs to this level of this tree.
    fn directory(
        &self,
        name: &str,
        tree: &TreeHeader,
        level: u8,
        nodes: &[Node],
        expected: u32,
    ) -> Result<BrickIndex, LoadError> {
        let len = self.len(name)?;
        let head = self.read(name, 0, len.min(bricks::HEADER_BYTES as u64))?;
        let header = bricks::decode_header(&head, len).map_err(|e| self.fail(name, e))?;
        if header.level != level {
            return Err(self.fail(
                name,
                format!("byte 12: it is of level {}, not of level {level}", header.level),
            ));
        }
        if header.layout != tree.layout {
            return Err(self.fail(
                name,
                format!(
                    "byte 13: its sample layout is {:?}, the tree's is {:?}",
                    header.layout, tree.layout
                ),
            ));
        }
        if self.keep_blocks && header.encoding != Encoding::Blocks {
            return Err(self.fail(
                name,
                "byte 16: its bricks are not block-compressed, which the scene says they are",
            ));
        }
        if header.bricks != expected {
            return Err(self.fail(
                name,
                format!(
                    "byte 24: it has {} bricks, the octree refers to {expected}",
                    header.bricks
                ),
            ));
        }
        let directory = header.directory();
        let bytes = directory.end - directory.start;
        self.reserve(level_memory(nodes.len() as u64, header.chunks.into()) + bytes)?;
        let index = header
            .decode_directory(&self.read(name, directory.start, bytes)?)
            .map_err(|e| self.fail(name, e))?;
        for (k, chunk) in index.chunks.iter().enumerate() {
            let at = directory.start + (k * bricks::ENTRY_BYTES) as u64;
            if index.chunk_corner(chunk).max_element() >> level != 0 {
                return Err(self.fail(name, format!("byte {at}: chunk {k} lies outside level {level}")));
            }
            if chunk.length > MAX_PAYLOAD_BYTES {
                return Err(self.fail(
                    name,
                    format!("byte {at}: chunk {k} of {} bytes is too long", chunk.length),
                ));
            }
        }
        Ok(index)
    }
}

/// Bytes that loading a level takes before its brick file is known: the nodes, packed and decoded.
pub(crate) fn level_estimate(level: &LevelEntry) -> u64 {
    level_memory(level.nodes.into(), 0) + level.bytes
}

/// Bytes that loading a chunk takes: the payload, where it is not kept as it is the decoded samples, and where bricks show anything. What a decoder works with
/// beside them, up to 1.3 MiB, is the loader's while it decodes, so it does not grow with the requests under way.
pub(crate) fn chunk_estimate(chunk: &ChunkEntry, header: &BrickHeader, keep_blocks: bool) -> u64 {
    let decoded = if keep_blocks {
        0
    } else {
        header.layout.samples() * header.layers.sample_bytes()
    };
    let bricks = chunk.mask.count_ones() as usize;
    u64::from(chunk.length) + (bricks * (decoded + size_of::<Occupancy>()) + size_of::<ChunkPage>()) as u64
}
