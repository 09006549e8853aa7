//! The pages of a tree, the grains at which a terrain is loaded and evicted.
//!
//! | page | what | needs |
//! |---|---|---|
//! | root | header, level table, the root node and its brick; of an XML octree all nodes | nothing |
//! | level | the nodes of one level and the directory of its brick file | the root and all coarser levels |
//! | chunk | the samples or blocks of neighbouring bricks of one level | its level |
//!
//! Pages are immutable and shared by `Arc`; any thread may read them.

use std::sync::Arc;

use brickfell_culler::TreeId;
use brickfell_formats::blocks::BlockChunk;
use brickfell_formats::bricks::{BrickIndex, ChunkEntry};
use brickfell_formats::chunk::{Chunk, Layers};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::occupancy::Occupancy;
use brickfell_formats::octree::{Node, TreeHeader};
use brickfell_formats::octree_binary::{LevelEntry, OctreeIndex};

/// Names a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum PageKey {
    /// The root page of a tree. It brings level 0 and its chunk.
    Root(TreeId),
    /// The nodes of a level.
    Level {
        /// The tree.
        tree: TreeId,
        /// The level; 0 is part of the root page.
        level: u8,
    },
    /// A chunk of a level.
    Chunk {
        /// The tree.
        tree: TreeId,
        /// The level; its only chunk at level 0 is part of the root page.
        level: u8,
        /// Its number in the directory of the level's brick file.
        chunk: u32,
    },
}

impl PageKey {
    /// The tree that the page belongs to.
    pub fn tree(self) -> TreeId {
        match self {
            Self::Root(tree) | Self::Level { tree, .. } | Self::Chunk { tree, .. } => tree,
        }
    }

    /// The level that the page belongs to, 0 for a root.
    pub fn level(self) -> u8 {
        match self {
            Self::Root(_) => 0,
            Self::Level { level, .. } | Self::Chunk { level, .. } => level,
        }
    }

    /// The page of which this one is a part, if it is not a page of its own: what stands at level 0 belongs to the root.
    pub(crate) fn holder(self) -> Self {
        match self {
            Self::Level { tree, level: 0 } | Self::Chunk { tree, level: 0, .. } => Self::Root(tree),
            key => key,
        }
    }

    /// 0 root, 1 level, 2 chunk: the order in which pages of one priority load.
    pub(crate) fn rank(self) -> u8 {
        match self {
            Self::Root(_) => 0,
            Self::Level { .. } => 1,
            Self::Chunk { .. } => 2,
        }
    }
}

/// What must be there before anything else of a tree.
#[derive(Clone, Debug, PartialEq)]
pub struct RootPage {
    /// The tree's properties.
    pub header: TreeHeader,
    /// Where the levels are in a binary octree file; `None` for an XML octree, which is loaded as a whole.
    pub index: Option<OctreeIndex>,
    /// The root node and the directory of its brick file.
    pub level0: Arc<LevelPage>,
    /// The root's brick, `None` if the root is a constant node.
    pub chunk0: Option<Arc<ChunkPage>>,
    /// Levels 1 to `depth` of an XML octree, empty for a binary one.
    pub preloaded: Vec<Arc<LevelPage>>,
}

impl RootPage {
    /// Bytes the page takes in memory, with all that it owns.
    pub fn memory(&self) -> u64 {
        let table = self
            .index
            .as_ref()
            .map_or(0, |i| i.levels.len() * size_of::<LevelEntry>());
        let chunk = self.chunk0.as_ref().map_or(0, |c| c.memory());
        let levels: u64 = self.preloaded.iter().map(|l| l.memory()).sum();
        (size_of::<Self>() + table) as u64 + chunk + self.level0.memory() + levels
    }
}

/// The nodes of a level.
#[derive(Clone, Debug, PartialEq)]
pub struct LevelPage {
    /// Nodes in file order: tiles of eight, in the order of their parents (level 0: the root alone).
    pub nodes: Vec<Node>,
    /// The directory of the level's brick file, `None` if the level has no brick.
    pub bricks: Option<BrickIndex>,
}

impl LevelPage {
    /// Bytes the page takes in memory.
    pub fn memory(&self) -> u64 {
        let chunks = self.bricks.as_ref().map_or(0, |b| b.chunks.len());
        level_memory(self.nodes.len() as u64, chunks as u64)
    }
}

/// Bricks of a chunk, in the form in which they go to the GPU.
#[derive(Clone, Debug, PartialEq)]
pub enum Bricks {
    /// Their samples.
    Samples(Chunk),
    /// Their blocks, as they are stored.
    Blocks(BlockChunk),
}

/// The bricks of a chunk, and where each of them shows anything.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkPage {
    bricks: Bricks,
    occupancy: Box<[Occupancy]>,
}

impl ChunkPage {
    /// Looks where the bricks show anything, which takes some microseconds a brick: on a loader's thread.
    pub fn new(bricks: Bricks) -> Self {
        let occupancy = match &bricks {
            Bricks::Samples(chunk) => (0..chunk.bricks()).map(|k| chunk.occupancy(k)).collect(),
            Bricks::Blocks(chunk) => (0..chunk.bricks()).map(|k| chunk.occupancy(k)).collect(),
        };
        Self { bricks, occupancy }
    }

    /// The bricks.
    pub fn bricks(&self) -> &Bricks {
        &self.bricks
    }

    /// The samples, if it holds them.
    pub fn samples(&self) -> Option<&Chunk> {
        match &self.bricks {
            Bricks::Samples(chunk) => Some(chunk),
            Bricks::Blocks(_) => None,
        }
    }

    /// Where samples lie.
    pub fn layout(&self) -> SampleLayout {
        match &self.bricks {
            Bricks::Samples(chunk) => chunk.layout,
            Bricks::Blocks(chunk) => chunk.layout(),
        }
    }

    /// What is stored of each sample.
    pub fn layers(&self) -> Layers {
        match &self.bricks {
            Bricks::Samples(chunk) => chunk.layers(),
            Bricks::Blocks(chunk) => chunk.layers(),
        }
    }

    /// Where each brick shows anything.
    pub fn occupancy(&self) -> &[Occupancy] {
        &self.occupancy
    }

    /// Bytes the page takes in memory.
    pub fn memory(&self) -> u64 {
        let owned = match &self.bricks {
            Bricks::Samples(chunk) => chunk.memory() - size_of::<Chunk>(),
            Bricks::Blocks(chunk) => chunk.memory() - size_of::<BlockChunk>(),
        };
        (owned + size_of_val(&*self.occupancy) + size_of::<Self>()) as u64
    }
}

/// Bytes of a level page of so many nodes and chunks.
pub(crate) fn level_memory(nodes: u64, chunks: u64) -> u64 {
    size_of::<LevelPage>() as u64 + nodes * size_of::<Node>() as u64 + chunks * size_of::<ChunkEntry>() as u64
}

/// A page of any kind.
#[derive(Clone, Debug)]
pub(crate) enum Page {
    Root(Arc<RootPage>),
    Level(Arc<LevelPage>),
    Chunk(Arc<ChunkPage>),
}

impl Page {
    pub(crate) fn memory(&self) -> u64 {
        match self {
            Self::Root(page) => page.memory(),
            Self::Level(page) => page.memory(),
            Self::Chunk(page) => page.memory(),
        }
    }
}
