//! The texture pool manager: which node tiles and bricks are in the pools, which leave for new ones, what must be uploaded.
//!
//! Owned by the render thread. Invariants, between frames:
//! - the resident set is closed under parents: a tile's parent node is resident, a brick's node too, and a brick is
//!   uploaded only after its parent's, unless that was given up;
//! - the mirror of the node words is what the device will hold after the next upload; every changed word is in the upload;
//! - what was used in the last [`LATENCY`] frames is not evicted (the read-back is that late), nor are roots in use;
//! - use passes on to ancestors, so the oldest entry, deepest first, never has a resident descendant that is younger.

mod evict;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use brickfell_culler::TreeId;
use brickfell_formats::chunk::Layers;
use brickfell_formats::octree::NodeData;
use brickfell_pager::{ChunkPage, PageKey, Pager, TreeState};
use brickfell_shaders::layout::{AXES, BRICK, TERMINAL};

use crate::caster::Feedback;
use crate::memory::{BrickUpload, MAX_UPLOAD_BRICKS, MAX_UPLOAD_NODES, PoolSizes};
use crate::node_lists::NodeList;

/// Frames for which an entry is safe after its last use.
pub const LATENCY: u32 = 4;

const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Tile {
    tree: TreeId,
    level: u8,
    /// Index of the tile in its level of the tree.
    index: u32,
    /// Node in the pool that points here; `NONE` for a root.
    parent: u32,
    last_used: u32,
    /// Newest read-back whose use was passed on to everything above. Not the same as `last_used`: a tile that is wanted is
    /// marked, too, without what is above it.
    passed_on: u32,
    words: [[u32; 2]; 8],
    resident: bool,
}

impl Tile {
    fn is_old(&self, frame: u32) -> bool {
        self.resident && self.last_used + LATENCY < frame
    }
}

const EMPTY_TILE: Tile = Tile {
    tree: TreeId(0),
    level: 0,
    index: 0,
    parent: NONE,
    last_used: 0,
    passed_on: 0,
    words: [[TERMINAL, 0]; 8],
    resident: false,
};

#[derive(Clone, Copy, Debug)]
struct Slot {
    /// Node in the pool that shows this brick; `NONE` if free.
    node: u32,
    last_used: u32,
}

/// Names a brick: its tree, its level, its node there.
pub type BrickPlace = (TreeId, u8, u32);

/// What to send before the next cast.
#[derive(Debug, Default)]
pub struct UploadBatch {
    /// Node index, its two words, 0.
    pub nodes: Vec<[u32; 4]>,
    /// Bricks and their slots.
    pub bricks: Vec<BrickUpload>,
}

/// The pools' directory.
#[derive(Debug)]
pub struct TexturePoolManager {
    sizes: PoolSizes,
    tiles: Vec<Tile>,
    free_tiles: Vec<u32>,
    tile_of: HashMap<(TreeId, u8, u32), u32>,
    slots: Vec<Slot>,
    free_slots: Vec<u32>,
    /// Evictable slots, the next victim last; made when the free ones run out, valid for one frame.
    victims: Vec<u32>,
    victims_frame: u32,
    /// The same for tiles.
    tile_victims: Vec<u32>,
    tile_victims_frame: u32,
    /// Something waits for the next upload because this one is full.
    upload_full: bool,
    dirty: Vec<u32>,
    /// A bit for each node of a tile.
    is_dirty: Vec<u8>,
    bricks: Vec<BrickUpload>,
}

impl TexturePoolManager {
    /// Empty pools.
    pub fn new(sizes: PoolSizes) -> Self {
        Self {
            sizes,
            tiles: vec![EMPTY_TILE; sizes.tiles as usize],
            free_tiles: (1..sizes.tiles).rev().collect(),
            tile_of: HashMap::new(),
            slots: vec![
                Slot {
                    node: NONE,
                    last_used: 0
                };
                sizes.bricks() as usize
            ],
            free_slots: (0..sizes.bricks()).rev().collect(),
            victims: Vec::new(),
            victims_frame: 0,
            tile_victims: Vec::new(),
            tile_victims_frame: 0,
            upload_full: false,
            dirty: Vec::new(),
            is_dirty: vec![0; sizes.tiles as usize],
            bricks: Vec::new(),
        }
    }

    /// Bricks resident.
    pub fn bricks_resident(&self) -> u32 {
        self.sizes.bricks() - self.free_slots.len() as u32
    }

    /// The bricks that have a slot.
    pub fn residents(&self) -> impl Iterator<Item = BrickPlace> {
        let nodes = self.slots.iter().map(|s| s.node).filter(|node| *node != NONE);
        nodes.map(|node| {
            let tile = &self.tiles[(node >> 3) as usize];
            (tile.tree, tile.level, tile.index * 8 + (node & 7))
        })
    }

    /// Bytes of RAM that the directory takes. Where they stay the same nothing was allocated.
    pub fn memory(&self) -> u64 {
        let words = self.free_tiles.capacity()
            + self.free_slots.capacity()
            + self.victims.capacity()
            + self.tile_victims.capacity()
            + self.dirty.capacity();
        // An entry and a byte of control, in tables that are filled up to seven eighths.
        let entries = self.tile_of.capacity() * 8 / 7 * (size_of::<(BrickPlace, u32)>() + 1);
        let bytes = self.tiles.capacity() * size_of::<Tile>()
            + self.slots.capacity() * size_of::<Slot>()
            + self.is_dirty.capacity()
            + self.bricks.capacity() * size_of::<BrickUpload>();
        (words * 4 + entries + bytes) as u64
    }

    /// Bricks that rays of a frame, or of a later one, used or wanted, and those above them: a resident set closed under parents
    /// needs room for both.
    pub fn bricks_in_use(&self, frame: u32) -> u32 {
        let in_use = self
            .slots
            .iter()
            .filter(|s| s.node != NONE && s.last_used >= frame);
        in_use.count() as u32
    }

    /// True if another tile or brick can be sent in this frame.
    fn can_send(&mut self) -> bool {
        let fits = self.bricks.len() < MAX_UPLOAD_BRICKS && self.dirty.len() + 64 < MAX_UPLOAD_NODES;
        self.upload_full |= !fits;
        fits
    }

    /// True if the last upload left something that had a place.
    pub fn upload_is_full(&self) -> bool {
        self.upload_full
    }

    fn word(&mut self, node: u32) -> &mut [u32; 2] {
        let (of_tile, bit) = (&mut self.is_dirty[(node >> 3) as usize], 1 << (node & 7));
        if *of_tile & bit == 0 {
            *of_tile |= bit;
            self.dirty.push(node);
        }
        &mut self.tiles[(node >> 3) as usize].words[(node & 7) as usize]
    }

    fn peek(&self, node: u32) -> [u32; 2] {
        self.tiles[(node >> 3) as usize].words[(node & 7) as usize]
    }

    /// Puts a tree's root into the pools (or finds it there), marks it used, and returns the root node's index; `None`
    /// while there is no room.
    pub fn activate(&mut self, tree: TreeId, state: &TreeState, frame: u32) -> Option<u32> {
        let node = match self.tile_of.get(&(tree, 0, 0)) {
            Some(tile) => tile * 8,
            None => self.add_tile(tree, 0, 0, NONE, state, frame)? * 8,
        };
        self.tiles[(node >> 3) as usize].last_used = frame;
        let [structure, slot] = self.peek(node);
        if structure & BRICK != 0 {
            if slot == 0 {
                let chunk = state.root.chunk0.as_ref()?;
                self.add_brick(node, Arc::clone(chunk), 0, frame)?;
            } else {
                self.slots[slot as usize - 1].last_used = frame;
            }
        }
        Some(node)
    }

    /// Takes a read-back's usage: what was used stays, and its ancestors with it.
    pub fn touch(&mut self, feedback: &Feedback) {
        for tile in set_bits(&feedback.used_tiles) {
            self.touch_up(tile, feedback.frame);
        }
        for slot in set_bits(&feedback.used_bricks) {
            if let Some(entry) = self.slots.get_mut(slot as usize)
                && entry.node != NONE
            {
                entry.last_used = entry.last_used.max(feedback.frame);
            }
        }
    }

    /// Marks a tile and what is above it used. Stops at what is marked already: its ancestors are, too.
    fn touch_up(&mut self, mut tile: u32, frame: u32) {
        while let Some(entry) = self.tiles.get_mut(tile as usize)
            && entry.resident
        {
            let known = entry.passed_on >= frame;
            entry.passed_on = entry.passed_on.max(frame);
            entry.last_used = entry.last_used.max(frame);
            let parent = entry.parent;
            if known || parent == NONE {
                return;
            }
            let [structure, slot] = self.peek(parent);
            if structure & BRICK != 0 && slot != 0 {
                let brick = &mut self.slots[slot as usize - 1];
                brick.last_used = brick.last_used.max(frame);
            }
            tile = parent >> 3;
        }
    }

    /// Makes resident what a list wants and RAM has, at most `brick_limit` bricks (but one always moves); asks the pager for
    /// the rest. Returns how many pages and bricks were asked for, were not there, and are not given up.
    pub fn apply(&mut self, list: &NodeList, pager: &mut Pager, frame: u32, brick_limit: usize) -> usize {
        let mut pending = 0;
        // Nodes whose bricks were given up: what lies below them is shown without them.
        let mut given_up = HashSet::new();
        self.upload_full = false;
        for &(key, order) in &list.pages {
            if pager
                .tree(key.tree())
                .is_some_and(|t| t.level(key.level()).is_none())
                && !pager.is_failed(key)
            {
                pager.request(key, priority(key.level(), order));
                pending += 1;
            }
        }
        for want in &list.nodes {
            let Some(state) = pager.tree(want.tree).cloned() else {
                continue;
            };
            let Some(page) = state.level(want.level) else {
                continue;
            };
            let Some(node) = page.nodes.get(want.node as usize) else {
                continue;
            };
            let tile_index = if want.level == 0 { 0 } else { want.node / 8 };
            let tile = match self.tile_of.get(&(want.tree, want.level, tile_index)) {
                Some(tile) => *tile,
                None => {
                    let parent = self.pool_node(want.tree, want.level.wrapping_sub(1), want.parent);
                    let added = parent
                        .and_then(|p| self.add_tile(want.tree, want.level, tile_index, p, &state, frame));
                    let Some(tile) = added else {
                        pending += 1;
                        continue;
                    };
                    tile
                }
            };
            self.tiles[tile as usize].last_used = frame;
            let pool_node = tile * 8 + if want.level == 0 { 0 } else { want.node % 8 };
            if !want.brick {
                continue;
            }
            let slot = self.peek(pool_node)[1];
            let NodeData::Brick(brick) = node.data() else {
                continue;
            };
            if slot != 0 {
                self.slots[slot as usize - 1].last_used = frame;
                continue;
            }
            let Some((chunk, local)) = page.bricks.as_ref().and_then(|b| b.locate(brick)) else {
                continue;
            };
            let key = PageKey::Chunk {
                tree: want.tree,
                level: want.level,
                chunk,
            };
            match pager.chunk(want.tree, want.level, chunk).cloned() {
                Some(samples) => {
                    pager.touch(key);
                    pending += 1;
                    let parent = self.tiles[tile as usize].parent;
                    let ready = self.shows(parent) || given_up.contains(&parent);
                    if self.bricks.len() < brick_limit.max(1) && ready {
                        self.add_brick(pool_node, samples, local, frame);
                    }
                }
                None if pager.is_failed(key) => {
                    given_up.insert(pool_node);
                }
                None => {
                    pager.request(key, priority(want.level, want.order));
                    pending += 1;
                }
            }
        }
        pending
    }

    /// The node has its brick or needs none (`NONE`, above a root, needs none).
    fn shows(&self, node: u32) -> bool {
        node == NONE || {
            let [structure, slot] = self.peek(node);
            structure & BRICK == 0 || slot != 0
        }
    }

    /// Index in the pool of a node of a tree, if its tile is resident.
    fn pool_node(&self, tree: TreeId, level: u8, node: u32) -> Option<u32> {
        let (tile, octant) = if level == 0 { (0, 0) } else { (node / 8, node % 8) };
        self.tile_of.get(&(tree, level, tile)).map(|t| t * 8 + octant)
    }

    fn add_tile(
        &mut self,
        tree: TreeId,
        level: u8,
        index: u32,
        parent: u32,
        state: &TreeState,
        frame: u32,
    ) -> Option<u32> {
        let nodes = &state.level(level)?.nodes;
        let first = index as usize * 8;
        let members = nodes
            .get(first..(first + 8).min(nodes.len()))
            .filter(|m| !m.is_empty())?;
        if !self.can_send() {
            return None;
        }
        let tile = match self.free_tiles.pop() {
            Some(tile) => tile,
            None => self.evict_some_tile(frame)?,
        };
        let mut words = [[TERMINAL, 0]; 8];
        for (word, node) in words.iter_mut().zip(members) {
            let terminal = if node.children().is_none() { TERMINAL } else { 0 };
            *word = match node.data() {
                NodeData::Constant(color) => [terminal, u32::from_le_bytes(color)],
                NodeData::Brick(_) => [terminal | BRICK, 0],
            };
        }
        self.tiles[tile as usize] = Tile {
            tree,
            level,
            index,
            parent,
            last_used: frame,
            passed_on: 0,
            words,
            resident: true,
        };
        for octant in 0..8 {
            self.word(tile * 8 + octant);
        }
        if parent != NONE {
            self.word(parent)[0] |= tile;
        }
        self.tile_of.insert((tree, level, index), tile);
        Some(tile)
    }

    fn add_brick(&mut self, node: u32, chunk: Arc<ChunkPage>, brick: u32, frame: u32) -> Option<()> {
        let fits = chunk.layout() == self.sizes.layout && chunk.samples().is_none() == self.sizes.blocks;
        if !self.can_send() || !fits {
            return None;
        }
        let slot = match self.free_slots.pop() {
            Some(slot) => slot,
            None => self.evict_some_brick(frame)?,
        };
        self.slots[slot as usize] = Slot {
            node,
            last_used: frame,
        };
        let told_apart = (chunk.layers(), self.sizes.layers) == (Layers::Axes, Layers::Axes);
        let word = self.word(node);
        word[0] = word[0] & !AXES | if told_apart { AXES } else { 0 };
        word[1] = slot + 1;
        self.bricks.push(BrickUpload { slot, chunk, brick });
        Some(())
    }

    /// Takes what must be sent before the next cast, instead of what the batch holds; its memory is used again.
    pub fn take_uploads(&mut self, batch: &mut UploadBatch) {
        batch.bricks.clear();
        batch.bricks.append(&mut self.bricks);
        batch.nodes.clear();
        for k in 0..self.dirty.len() {
            let node = self.dirty[k];
            self.is_dirty[(node >> 3) as usize] = 0;
            let [structure, data] = self.peek(node);
            batch.nodes.push([node, structure, data, 0]);
        }
        self.dirty.clear();
        // A brick may have left its slot again in the same frame.
        batch.bricks.retain(|b| {
            let node = self.slots[b.slot as usize].node;
            node != NONE && self.tiles[(node >> 3) as usize].words[(node & 7) as usize][1] == b.slot + 1
        });
    }
}

/// One key for reading, decoding and uploading: coarse levels first, nearer trees first within a level.
pub fn priority(level: u8, order: u32) -> f64 {
    f64::from(level) + f64::from(order) / (f64::from(order) + 1000.0)
}

fn set_bits(words: &[u32]) -> impl Iterator<Item = u32> + '_ {
    words.iter().enumerate().flat_map(|(k, word)| {
        (0..32)
            .filter(move |bit| word >> bit & 1 == 1)
            .map(move |bit| k as u32 * 32 + bit)
    })
}

#[cfg(test)]
mod tests;
