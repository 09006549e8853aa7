//! The nodes of the pools as rays find them: from the common ancestor of the last cell and this one, with what is there in the place of
//! what is not, which is asked for. The same as the GPU does. One per thread of a cast.

use std::collections::HashSet;
use std::convert::Infallible;

use brickfell_formats::octree::MAX_DEPTH;
use brickfell_shaders::layout::{BRICK, POINTER, Request, TERMINAL};

use super::pool::{Packed, Pools};
use crate::march::{Cell, Place, Shown, Source};
use crate::picture::RayCounters;

/// Requests that one ray may make.
const MAX_REQUESTS: u32 = 16;

/// What the rays of a thread lacked.
#[derive(Debug, Default)]
pub(super) struct Lacking {
    /// Each once.
    pub(super) requests: HashSet<Request>,
    left: u32,
}

impl Lacking {
    /// Begins a ray that may ask, or may not.
    pub(super) fn begin(&mut self, may_ask: bool) {
        self.left = if may_ask { MAX_REQUESTS } else { 0 };
    }
}

/// The nodes of one tree in the pools.
pub(super) struct Nodes<'p> {
    pools: &'p Pools,
    frame: u32,
    /// Place of the tree in the frame's list.
    tree: u32,
    depth: u8,
    /// Nodes from the root to where the last descent ended.
    stack: [u32; MAX_DEPTH as usize + 1],
    reached: u8,
    cell: Cell,
    lacking: Lacking,
}

/// A node that shows something of its own: a constant, or a brick that is resident.
fn has_data([structure, data]: [u32; 2]) -> bool {
    structure & BRICK == 0 || data != 0
}

impl<'p> Nodes<'p> {
    /// Before the first ray.
    pub(super) fn new(pools: &'p Pools, frame: u32) -> Self {
        Self {
            pools,
            frame,
            tree: u32::MAX,
            depth: 0,
            stack: [0; MAX_DEPTH as usize + 1],
            reached: 0,
            cell: [0; 3],
            lacking: Lacking::default(),
        }
    }

    /// Begins a ray.
    pub(super) fn begin(&mut self, may_ask: bool) {
        self.lacking.begin(may_ask);
    }

    /// Turns to a tree of the frame's list. Where the last ray was in the same one, its way from the root is still good.
    pub(super) fn enter(&mut self, tree: u32, root: u32, depth: u8) {
        if self.tree != tree {
            (self.tree, self.depth, self.reached) = (tree, depth, 0);
            self.stack[0] = root;
        }
    }

    /// What rays lacked.
    pub(super) fn into_requests(self) -> HashSet<Request> {
        self.lacking.requests
    }

    #[inline(always)]
    fn read(&self, level: u8, counters: &mut RayCounters) -> [u32; 2] {
        counters.nodes += 1;
        self.pools.nodes[self.stack[usize::from(level)] as usize]
    }

    /// What a node with data shows; it is stamped.
    #[inline(always)]
    fn show(&self, level: u8, [structure, data]: [u32; 2]) -> Option<Shown<&'p Packed>> {
        self.pools.use_tile(self.stack[usize::from(level)], self.frame);
        if structure & BRICK == 0 {
            return Some(Shown::Constant(data.to_le_bytes()));
        }
        let brick = self.pools.brick([structure, data])?;
        self.pools.use_brick(data - 1, self.frame);
        Some(Shown::Brick(brick))
    }

    #[cold]
    fn ask(&mut self, cell: Cell, level: u8) {
        if self.lacking.left > 0 {
            self.lacking.left -= 1;
            let shift = u32::from(self.depth - level) + 3;
            self.lacking.requests.insert(Request {
                tree: self.tree,
                level,
                node: cell.map(|c| (c >> shift) as u32),
            });
        }
    }
}

impl<'p> Source<f32> for Nodes<'p> {
    type Brick = &'p Packed;
    type Error = Infallible;

    #[inline(always)]
    fn descend(
        &mut self,
        cell: Cell,
        wanted: u8,
        mixing: bool,
        counters: &mut RayCounters,
    ) -> Result<Option<Place<Self::Brick>>, Infallible> {
        let shift = |level: u8| u32::from(self.depth - level) + 3;
        let apart = (0..3).fold(0, |d, k| d | (cell[k] ^ self.cell[k])) as u32;
        self.cell = cell;
        let shared = (shift(0) as i32 - (u32::BITS - apart.leading_zeros()) as i32).max(0) as u8;
        let mut level = self.reached.min(shared).min(wanted);
        let mut node = self.read(level, counters);
        while level < wanted && node[0] & POINTER != 0 {
            level += 1;
            let at = shift(level);
            let octant = (cell[0] >> at & 1) | (cell[1] >> at & 1) << 1 | (cell[2] >> at & 1) << 2;
            self.stack[usize::from(level)] = (node[0] & POINTER) * 8 + octant as u32;
            node = self.read(level, counters);
        }
        self.reached = level;
        let terminal = node[0] & TERMINAL != 0;
        let mut alone = !mixing || level < wanted || level == 0;
        let stands_in = level < wanted && !terminal || !has_data(node);
        if stands_in {
            self.ask(cell, wanted);
            alone = true;
            while level > 0 && !has_data(node) {
                level -= 1;
                node = self.read(level, counters);
            }
        }
        let Some(shown) = self.show(level, node) else {
            return Ok(None);
        };
        let mut parent = None;
        if !alone {
            let above = self.read(level - 1, counters);
            parent = self.show(level - 1, above);
            if parent.is_none() {
                // Tiles come ahead of bricks: a constant node may be here before the brick it is mixed with.
                self.ask(cell, wanted);
            }
        }
        let at = u32::from(self.depth - level) + 3;
        Ok(Some(Place {
            level,
            wanted,
            mixing,
            terminal,
            stands_in,
            low: cell.map(|c| c >> at << at),
            shown,
            parent,
        }))
    }
}
