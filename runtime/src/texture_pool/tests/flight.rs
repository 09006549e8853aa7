//! A flight over small trees: the pools' directory beside a model of the device and of what was used, checked each frame.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use brickfell_formats::layout::SampleLayout;
use brickfell_pager::{MemoryStore, PagerConfig};
use brickfell_shaders::layout::{POINTER, Request};
use glam::{DVec3, UVec3};

use super::super::*;
use crate::node_lists::{ActiveTree, NodeListProcessors};
use crate::testing::{Kind, Store, grey, header};

pub(super) const TREES: u32 = 3;
pub(super) const DEPTH: u8 = 3;
/// Frames from a cast to its read-back.
const READ_BACK: usize = 2;

pub(super) struct Random(u64);

impl Random {
    pub(super) fn below(&mut self, n: u32) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % u64::from(n)) as u32
    }
}

/// Trees of bricks with some constant nodes among them.
fn trees() -> (Arc<MemoryStore>, Vec<String>) {
    let mut store = Store::default();
    let mut names = Vec::new();
    for tree in 0..TREES {
        let kind = |level: u8, p: UVec3| match (p.x * 5 + p.y * 3 + p.z + tree) % 7 {
            0 if level > 0 => Kind::Leaf([50; 4]),
            1 if level > 0 => Kind::Inner([60; 4]),
            2 if level > 1 => Kind::BrickLeaf,
            _ => Kind::Brick,
        };
        let name = format!("tree{tree}");
        let header = header(DVec3::ZERO, 1.0, DEPTH, SampleLayout::Corner, 1);
        store.add(&name, header, kind, |level, _| grey(level, 90));
        names.push(name);
    }
    (Arc::new(store.0), names)
}

/// A node's place in its tree.
pub(super) type Place = (TreeId, u8, u32);

/// What the device would hold and what is known to have been used.
#[derive(Default)]
struct Model {
    words: HashMap<u32, [u32; 2]>,
    slots: HashMap<u32, (usize, u32)>,
    used: HashMap<(Place, bool), u32>,
}

/// A pool, its pager and the model, frame by frame.
pub(super) struct Flight {
    pub(super) pool: TexturePoolManager,
    pub(super) batch: UploadBatch,
    pub(super) pager: Pager,
    pub(super) store: Arc<MemoryStore>,
    pub(super) processors: NodeListProcessors,
    model: Model,
    pub(super) random: Random,
    pub(super) frame: u32,
    pub(super) list: NodeList,
    pub(super) trees: Arc<[ActiveTree]>,
    pub(super) roots: Vec<u32>,
    pub(super) casts: Vec<Feedback>,
    /// What rays use, instead of nodes at random.
    pub(super) rays: Option<Vec<Place>>,
    pub(super) pending: usize,
    pub(super) uploads: usize,
    pub(super) evictions: usize,
}

impl Flight {
    pub(super) fn new(seed: u64, sizes: PoolSizes) -> Self {
        let (store, names) = trees();
        Self {
            pool: TexturePoolManager::new(sizes),
            batch: UploadBatch::default(),
            pager: Pager::new(
                Arc::clone(&store) as Arc<dyn brickfell_pager::Store>,
                names,
                PagerConfig::default(),
            ),
            store,
            processors: NodeListProcessors::new(1).unwrap(),
            model: Model::default(),
            random: Random(seed),
            frame: 0,
            list: NodeList::default(),
            trees: Arc::from([]),
            roots: Vec::new(),
            casts: Vec::new(),
            rays: None,
            pending: 0,
            uploads: 0,
            evictions: 0,
        }
    }

    fn place(&self, node: u32) -> Place {
        let tile = &self.pool.tiles[(node >> 3) as usize];
        (tile.tree, tile.level, tile.index * 8 + (node & 7))
    }

    fn use_known(&mut self, place: Place, brick: bool, frame: u32) {
        let known = self.model.used.entry((place, brick)).or_default();
        *known = frame.max(*known);
    }

    /// One frame that wants the nodes given by `wants` (tree, level, node coordinates), at most `limit` bricks of them.
    pub(super) fn fly(&mut self, visible: u32, wants: &[(u32, u8, [u32; 3])], limit: usize) {
        self.frame += 1;
        let frame = self.frame;
        if self.casts.len() > READ_BACK {
            let feedback = self.casts.remove(0);
            for tile in set_bits(&feedback.used_tiles) {
                if self.pool.tiles[tile as usize].resident {
                    self.use_known(self.place(tile * 8), false, feedback.frame);
                }
            }
            for slot in set_bits(&feedback.used_bricks) {
                let node = self.pool.slots[slot as usize].node;
                if node != NONE {
                    self.use_known(self.place(node), true, feedback.frame);
                }
            }
            self.pool.touch(&feedback);
        }
        self.pager.merge(u64::from(frame));
        let before = self.residents();
        self.roots.clear();
        let mut active = Vec::new();
        for tree in (0..visible).map(TreeId) {
            let Some(state) = self.pager.tree(tree).cloned() else {
                self.pager.request(PageKey::Root(tree), 0.0);
                continue;
            };
            if let Some(root) = self.pool.activate(tree, &state, frame) {
                self.use_known((tree, 0, 0), false, frame);
                self.use_known((tree, 0, 0), true, frame);
                self.roots.push(root);
                active.push(ActiveTree { tree, state });
            }
        }
        self.trees = active.into();
        let requests = wants.iter().map(|(tree, level, node)| Request {
            tree: *tree,
            level: *level,
            node: *node,
        });
        self.processors
            .submit(frame, requests.collect(), Arc::clone(&self.trees));
        self.processors.wait_idle();
        self.list = self.processors.take().unwrap();
        self.pending = self.pool.apply(&self.list, &mut self.pager, frame, limit);
        self.pager.submit();
        self.pager.wait_for_progress(Duration::from_millis(200));
        let mut batch = std::mem::take(&mut self.batch);
        self.pool.take_uploads(&mut batch);
        self.uploads += batch.bricks.len();
        assert!(batch.bricks.len() <= limit.max(1).saturating_add(visible as usize));
        self.send(&batch);
        self.batch = batch;
        self.check(&before);
        self.cast();
    }

    /// Nodes with a tile, and with a brick.
    fn residents(&self) -> HashSet<(Place, bool)> {
        let tiles = (0..self.pool.tiles.len() as u32).filter(|t| self.pool.tiles[*t as usize].resident);
        tiles
            .map(|t| (self.place(t * 8), false))
            .chain(self.pool.residents().map(|place| (place, true)))
            .collect()
    }

    /// The device takes an upload.
    fn send(&mut self, batch: &UploadBatch) {
        let mut seen = HashSet::new();
        for [node, structure, data, _] in &batch.nodes {
            assert!(seen.insert(*node), "word {node} twice in one upload");
            self.model.words.insert(*node, [*structure, *data]);
        }
        let mut seen = HashSet::new();
        for brick in &batch.bricks {
            assert!(seen.insert(brick.slot), "slot {} twice in one upload", brick.slot);
            self.model
                .slots
                .insert(brick.slot, (Arc::as_ptr(&brick.chunk) as usize, brick.brick));
        }
    }

    /// The invariants of the module.
    fn check(&mut self, before: &HashSet<(Place, bool)>) {
        let frame = self.frame;
        let pool = &self.pool;
        let tiles = || (1..pool.tiles.len() as u32).filter(|t| pool.tiles[*t as usize].resident);
        assert_eq!(pool.tile_of.len(), tiles().count());
        let free: HashSet<u32> = pool.free_tiles.iter().copied().collect();
        assert_eq!(free.len(), pool.free_tiles.len(), "a tile is free twice");
        assert_eq!(free.len() + pool.tile_of.len(), pool.tiles.len() - 1);
        let mut shown = 0;
        for tile in tiles() {
            let entry = &pool.tiles[tile as usize];
            assert!(!free.contains(&tile));
            assert_eq!(
                pool.tile_of.get(&(entry.tree, entry.level, entry.index)),
                Some(&tile)
            );
            if entry.parent != NONE {
                let above = &pool.tiles[(entry.parent >> 3) as usize];
                assert!(above.resident && above.level + 1 == entry.level && above.tree == entry.tree);
                assert_eq!(
                    pool.peek(entry.parent)[0] & POINTER,
                    tile,
                    "the parent points elsewhere"
                );
                assert!(
                    above.last_used >= entry.last_used,
                    "a tile is younger than the one above it"
                );
            } else {
                assert_eq!(entry.level, 0);
            }
            for octant in 0..8 {
                let node = tile * 8 + octant;
                let [structure, data] = pool.peek(node);
                assert_eq!(
                    self.model.words[&node],
                    [structure, data],
                    "the device holds another word"
                );
                let child = structure & POINTER;
                assert!(child == 0 || pool.tiles[child as usize].parent == node);
                if structure & BRICK != 0 && data != 0 {
                    shown += 1;
                    assert_eq!(pool.slots[data as usize - 1].node, node);
                    let (tree, level, index) = self.place(node);
                    let page = self.pager.tree(tree).unwrap().level(level).unwrap();
                    let NodeData::Brick(brick) = page.nodes[index as usize].data() else {
                        panic!("a brick where there is none")
                    };
                    let (chunk, local) = page.bricks.as_ref().unwrap().locate(brick).unwrap();
                    let samples = self.pager.chunk(tree, level, chunk).unwrap();
                    let held = self.model.slots[&(data - 1)];
                    assert_eq!(
                        held,
                        (Arc::as_ptr(samples) as usize, local),
                        "the slot holds another brick"
                    );
                    if entry.parent != NONE {
                        let [above, slot] = pool.peek(entry.parent);
                        assert!(
                            above & BRICK == 0 || slot != 0,
                            "{:?} without its parent's brick",
                            self.place(node)
                        );
                    }
                }
            }
        }
        assert_eq!(shown, pool.bricks_resident() as usize);
        let free: HashSet<u32> = pool.free_slots.iter().copied().collect();
        assert_eq!(free.len(), pool.free_slots.len(), "a slot is free twice");
        assert!(free.iter().all(|s| pool.slots[*s as usize].node == NONE));
        // What left was not in use; roots in use are there.
        let after = self.residents();
        for gone in before.difference(&after) {
            self.evictions += 1;
            let used = self.model.used.get(gone).copied().unwrap_or(0);
            assert!(
                used + LATENCY < frame,
                "{gone:?} left in frame {frame}, used in {used}"
            );
        }
        for root in &self.roots {
            let [structure, slot] = self.pool.peek(*root);
            assert!(self.pool.tiles[(root >> 3) as usize].resident && (structure & BRICK == 0 || slot != 0));
        }
    }

    /// A ray: walks at random as far as the words lead, as the kernel would, and uses the last node, or its parent too.
    fn walk(&mut self, root: u32) -> Vec<u32> {
        let mut path = vec![root];
        let mut node = root;
        loop {
            let child = self.model.words[&node][0] & POINTER;
            if child == 0 || self.random.below(8) == 0 {
                break;
            }
            node = child * 8 + self.random.below(8);
            path.push(node);
        }
        path.into_iter()
            .rev()
            .take(1 + self.random.below(2) as usize)
            .collect()
    }

    /// Casts rays and puts what they used on its way back.
    fn cast(&mut self) {
        let words = |bits: usize| vec![0u32; bits.div_ceil(32)];
        let mut feedback = Feedback {
            frame: self.frame,
            used_bricks: words(self.pool.slots.len()),
            used_tiles: words(self.pool.tiles.len()),
            ..Feedback::default()
        };
        let mut used = Vec::new();
        match &self.rays {
            Some(places) => used.extend(
                places
                    .iter()
                    .filter_map(|(t, l, n)| self.pool.pool_node(*t, *l, *n)),
            ),
            None => {
                for root in self.roots.clone() {
                    for _ in 0..4 {
                        used.extend(self.walk(root));
                    }
                }
            }
        }
        for node in used {
            feedback.used_tiles[(node >> 8) as usize] |= 1 << (node >> 3 & 31);
            let [structure, slot] = self.model.words[&node];
            if structure & BRICK != 0 && slot != 0 {
                feedback.used_bricks[(slot - 1) as usize / 32] |= 1 << ((slot - 1) % 32);
            }
        }
        self.casts.push(feedback);
    }

    pub(super) fn random_wants(&mut self, count: u32, trees: u32) -> Vec<(u32, u8, [u32; 3])> {
        (0..count)
            .map(|_| {
                let level = self.random.below(u32::from(DEPTH) + 1) as u8;
                let tree = self.random.below(trees);
                (tree, level, [0; 3].map(|_: u32| self.random.below(1 << level)))
            })
            .collect()
    }
}
