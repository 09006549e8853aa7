//! What of a tree is resident, as an immutable snapshot.
//!
//! The pager makes a new snapshot when a page is published or evicted; whoever holds an old one keeps a consistent view
//! of the tree. Invariant: if level L is there, so are all coarser ones.

use std::sync::Arc;

use brickfell_formats::octree::{MAX_DEPTH, octant};
use glam::UVec3;

use crate::page::{LevelPage, RootPage};

/// The resident part of a tree. May be shared with any thread.
#[derive(Clone, Debug)]
pub struct TreeState {
    /// The root page.
    pub root: Arc<RootPage>,
    /// One entry per level, `depth + 1` of them; `None` where the level is not resident.
    pub levels: Vec<Option<Arc<LevelPage>>>,
}

/// Why a look-up ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The node asked for is the last of the path.
    Reached,
    /// The last node of the path is terminal: nothing finer exists there.
    Terminal,
    /// The last node of the path has children, but their level is not resident.
    NotResident,
    /// The position lies outside the tree, or the level is deeper than any tree; the path is empty.
    Outside,
}

/// The nodes on the way to a position, from the root down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    indices: [u32; MAX_DEPTH as usize + 1],
    len: u8,
    /// Why the path ends where it does.
    pub stop: Stop,
}

impl Found {
    /// Level and node index (into [`LevelPage::nodes`]) of every node on the way, the root first.
    pub fn path(&self) -> impl DoubleEndedIterator<Item = (u8, u32)> + '_ {
        self.indices
            .iter()
            .take(usize::from(self.len))
            .enumerate()
            .map(|(level, index)| (level as u8, *index))
    }

    /// The last node of the path, `None` if the position was outside.
    pub fn deepest(&self) -> Option<(u8, u32)> {
        self.path().next_back()
    }
}

impl TreeState {
    /// The state of a tree of which only the root page is there.
    pub(crate) fn new(root: Arc<RootPage>) -> Self {
        let mut levels = vec![None; usize::from(root.header.depth) + 1];
        let resident = std::iter::once(&root.level0).chain(&root.preloaded);
        for (slot, page) in levels.iter_mut().zip(resident) {
            *slot = Some(page.clone());
        }
        Self { root, levels }
    }

    /// A level, if it is resident.
    pub fn level(&self, level: u8) -> Option<&Arc<LevelPage>> {
        self.levels.get(usize::from(level))?.as_ref()
    }

    /// Walks towards the node of `level` at `p` (in nodes of that level, `0..2^level` per axis), as deep as the tree
    /// and its resident levels go.
    pub fn find(&self, level: u8, p: UVec3) -> Found {
        let mut found = Found {
            indices: [0; MAX_DEPTH as usize + 1],
            len: 0,
            stop: Stop::Outside,
        };
        if level > MAX_DEPTH || p.max_element() >> level != 0 {
            return found;
        }
        let mut index = 0u32;
        for l in 0..=level {
            let node = self.level(l).and_then(|page| page.nodes.get(index as usize));
            let Some(node) = node else {
                found.stop = Stop::NotResident;
                return found;
            };
            found.indices[usize::from(l)] = index;
            found.len = l + 1;
            if l == level {
                break;
            }
            let Some(tile) = node.children() else {
                found.stop = Stop::Terminal;
                return found;
            };
            index = tile.saturating_mul(8) + octant(p >> u32::from(level - l - 1));
        }
        found.stop = Stop::Reached;
        found
    }
}
