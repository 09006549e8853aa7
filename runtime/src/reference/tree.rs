//! One tree as the reference reads it: header at once; nodes, directories and chunks when a ray first needs them.
//!
//! Everything decoded is kept until the reference is dropped, as the bytes that are stored (8 or 12 per sample), so memory
//! grows with what the rays have seen. A page that cannot be read stays an error: every ray that needs it gets the same
//! one. Any thread: two threads that need the same page wait for one of them to decode it.

use std::sync::{Arc, OnceLock};

use brickfell_formats::blocks::{Between, Texels};
use brickfell_formats::bricks::{self, BrickIndex, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::octree::{Node, NodeData, TreeHeader, octant};
use brickfell_formats::octree_binary::{self, OctreeIndex};
use brickfell_formats::{FormatError, octree_xml};
use brickfell_pager::store::Store;
use glam::{DVec3, IVec3};

use super::ReferenceError;
use super::sampling::{Brick, Samples};
use crate::march::{Cell, Place, Shown, Source};
use crate::picture::RayCounters;

type Once<T> = OnceLock<Result<T, ReferenceError>>;

/// The value of a cell, made on the first call.
fn once<T>(cell: &Once<T>, make: impl FnOnce() -> Result<T, ReferenceError>) -> Result<&T, ReferenceError> {
    cell.get_or_init(make).as_ref().map_err(Clone::clone)
}

/// A tree and its brick files.
pub(super) struct Tree {
    store: Arc<dyn Store>,
    name: String,
    /// The tree's properties.
    pub(super) header: TreeHeader,
    /// Where it is drawn, world metres.
    pub(super) bounds: [DVec3; 2],
    /// How blocks are read.
    pub(super) between: Between,
    /// Table of the binary file; an XML file has none and is read whole.
    index: Option<OctreeIndex>,
    levels: Vec<Once<Vec<Node>>>,
    files: Vec<Once<BrickFile>>,
}

/// The brick file of one level.
struct BrickFile {
    name: String,
    index: BrickIndex,
    chunks: Vec<Once<Bricks>>,
}

/// The bricks of a chunk.
enum Bricks {
    Samples(Chunk),
    /// Of each brick in blocks what they say.
    Blocks(Vec<Texels>),
}

impl Tree {
    /// Reads the header of a tree file, binary or XML. Where no bounds are given all of it is drawn.
    pub(super) fn open(
        store: Arc<dyn Store>,
        name: &str,
        bounds: Option<[DVec3; 2]>,
    ) -> Result<Self, ReferenceError> {
        let len = length(&*store, name)?;
        let head = read(&*store, name, 0, len.min(octree_binary::prefix_len() as u64))?;
        let format = |e| ReferenceError::format(&*store, name, e);
        let (header, index, levels) = if octree_binary::is_binary(&head) {
            let index = octree_binary::decode_header(&head, len).map_err(format)?;
            let levels = index.levels.iter().map(|_| OnceLock::new()).collect();
            (index.header, Some(index), levels)
        } else {
            let whole = read(&*store, name, 0, len)?;
            let tree = octree_xml::decode(&whole).map_err(format)?;
            tree.validate().map_err(format)?;
            (
                tree.header,
                None,
                tree.levels
                    .into_iter()
                    .map(|nodes| OnceLock::from(Ok(nodes)))
                    .collect(),
            )
        };
        header.validate().map_err(format)?;
        let files = (0..=header.depth).map(|_| OnceLock::new()).collect();
        Ok(Self {
            store,
            name: name.to_owned(),
            bounds: bounds.unwrap_or(header.bounds()),
            between: Between::default(),
            header,
            index,
            levels,
            files,
        })
    }

    /// The nodes of a level, in file order.
    pub(super) fn nodes(&self, level: u8) -> Result<&[Node], ReferenceError> {
        let fault = |e| self.fault(&self.name, e);
        let missing = || fault(FormatError::file(format!("there is no level {level}")));
        let cell = self.levels.get(usize::from(level)).ok_or_else(missing)?;
        let nodes = once(cell, || {
            let index = self.index.as_ref().ok_or_else(missing)?;
            let entry = index.levels.get(usize::from(level)).ok_or_else(missing)?;
            let bytes = read(&*self.store, &self.name, entry.offset, entry.bytes)?;
            index.decode_level(level, &bytes).map_err(fault)
        })?;
        Ok(nodes)
    }

    /// A node by its place in a level.
    pub(super) fn node(&self, level: u8, place: usize) -> Result<Node, ReferenceError> {
        self.nodes(level)?.get(place).copied().ok_or_else(|| {
            self.fault(
                &self.name,
                FormatError::file(format!("level {level} has no node {place}")),
            )
        })
    }

    /// A brick by its number in a level.
    pub(super) fn brick(&self, level: u8, number: u32) -> Result<Brick<'_>, ReferenceError> {
        let missing = || {
            let name = brick_file_name(&self.name, level);
            self.fault(&name, FormatError::file(format!("there is no brick {number}")))
        };
        let cell = self.files.get(usize::from(level)).ok_or_else(missing)?;
        let file = once(cell, || self.open_bricks(level))?;
        let (chunk, place) = file.index.locate(number).ok_or_else(missing)?;
        let (entry, cell) = file
            .index
            .chunks
            .get(chunk as usize)
            .zip(file.chunks.get(chunk as usize))
            .ok_or_else(missing)?;
        let chunk = once(cell, || {
            let bytes = read(&*self.store, &file.name, entry.offset, u64::from(entry.length))?;
            let bricks = match file.index.header.encoding {
                Encoding::Blocks => file.index.block_chunk(chunk, bytes).map(|chunk| {
                    let texels = (0..chunk.bricks()).map(|k| chunk.texels(k, self.between));
                    Bricks::Blocks(texels.collect())
                }),
                _ => file.index.decode_chunk(chunk, &bytes).map(Bricks::Samples),
            };
            bricks.map_err(|e| self.fault(&file.name, e))
        })?;
        let (place, layout) = (place as usize, self.header.layout);
        match chunk {
            Bricks::Samples(chunk) => Ok(Brick {
                samples: Samples::Stored {
                    color: chunk.brick_color(place),
                    normal: chunk.brick_normal(place),
                    opacity: chunk.brick_opacity(place),
                },
                layout,
            }),
            Bricks::Blocks(bricks) => Ok(Brick {
                samples: Samples::Looks(bricks.get(place).ok_or_else(missing)?),
                layout,
            }),
        }
    }

    fn fault(&self, name: &str, error: FormatError) -> ReferenceError {
        ReferenceError::format(&*self.store, name, error)
    }

    fn open_bricks(&self, level: u8) -> Result<BrickFile, ReferenceError> {
        let name = brick_file_name(&self.name, level);
        let format = |e| self.fault(&name, e);
        let len = length(&*self.store, &name)?;
        let head = read(&*self.store, &name, 0, len.min(HEADER_BYTES as u64))?;
        let header = bricks::decode_header(&head, len).map_err(format)?;
        if (header.level, header.layout) != (level, self.header.layout) {
            return Err(format(FormatError::file(format!(
                "holds level {} with {:?} samples, the tree has level {level} with {:?} samples here",
                header.level, header.layout, self.header.layout
            ))));
        }
        let range = header.directory();
        let directory = read(&*self.store, &name, range.start, range.end - range.start)?;
        let index = header.decode_directory(&directory).map_err(format)?;
        let chunks = index.chunks.iter().map(|_| OnceLock::new()).collect();
        Ok(BrickFile { name, index, chunks })
    }
}

/// The nodes of a tree, each found from the root.
pub(super) struct FromRoot<'t>(pub(super) &'t Tree);

impl<'t> FromRoot<'t> {
    fn shown(&self, level: u8, node: Node) -> Result<Shown<Brick<'t>>, ReferenceError> {
        Ok(match node.data() {
            NodeData::Constant(color) => Shown::Constant(color),
            NodeData::Brick(number) => Shown::Brick(self.0.brick(level, number)?),
        })
    }
}

impl<'t> Source<f64> for FromRoot<'t> {
    type Brick = Brick<'t>;
    type Error = ReferenceError;

    fn descend(
        &mut self,
        cell: Cell,
        wanted: u8,
        mixing: bool,
        counters: &mut RayCounters,
    ) -> Result<Option<Place<Self::Brick>>, ReferenceError> {
        // What to shift a cell by to count it in nodes of a level.
        let shift = |level: u8| u32::from(self.0.header.depth - level) + 3;
        let (mut level, mut parent) = (0u8, None);
        let mut node = self.0.node(0, 0)?;
        counters.nodes += 1;
        while level < wanted
            && let Some(tile) = node.children()
        {
            parent = Some(node);
            level += 1;
            let here = octant((IVec3::from(cell) >> shift(level)).as_uvec3());
            node = self.0.node(level, tile as usize * 8 + here as usize)?;
            counters.nodes += 1;
        }
        let parent = match parent {
            Some(parent) if mixing && level == wanted => Some(self.shown(level - 1, parent)?),
            _ => None,
        };
        Ok(Some(Place {
            level,
            wanted,
            mixing,
            terminal: node.children().is_none(),
            stands_in: false,
            low: cell.map(|c| c >> shift(level) << shift(level)),
            shown: self.shown(level, node)?,
            parent,
        }))
    }
}

fn length(store: &dyn Store, name: &str) -> Result<u64, ReferenceError> {
    store.len(name).map_err(|e| ReferenceError::read(store, name, e))
}

fn read(store: &dyn Store, name: &str, offset: u64, len: u64) -> Result<Vec<u8>, ReferenceError> {
    usize::try_from(len)
        .map_err(|_| std::io::Error::from(std::io::ErrorKind::OutOfMemory))
        .and_then(|len| store.read(name, offset, len))
        .map_err(|e| ReferenceError::read(store, name, e))
}
