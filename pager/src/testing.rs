//! A small terrain for tests: ground along the bottom of a tree, every brick of a chunk in the chunk's own colour.

use std::sync::Arc;
use std::time::Duration;

use brickfell_culler::TreeId;
use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::{morton, octree_binary, octree_xml};
use glam::{DVec3, UVec3};

use crate::{MemoryStore, PageKey, Pager, PagerConfig};

/// Bricks per chunk and axis, log2.
const CHUNK_LOG2: u8 = 1;

/// A tree of a depth whose nodes at z = 0 have bricks, the others being empty.
pub(crate) fn octree(depth: u8) -> Octree {
    let mut levels = Vec::new();
    let mut positions = vec![UVec3::ZERO];
    for level in 0..=depth {
        let (mut tiles, mut bricks) = (0, 0);
        let mut nodes = Vec::new();
        for p in &positions {
            if p.z > 0 {
                nodes.push(Node::constant([0; 4]));
                continue;
            }
            nodes.push(Node::new(
                (level < depth).then_some(tiles),
                NodeData::Brick(bricks),
            ));
            tiles += 1;
            bricks += 1;
        }
        positions = child_positions(&nodes, &positions);
        levels.push(nodes);
    }
    let side = 8u32 << depth;
    let header = TreeHeader {
        origin: DVec3::ZERO,
        voxel_size: 0.5,
        depth,
        layout: SampleLayout::Corner,
        gain: 2,
        surface_voxels: u64::from(side) * u64::from(side),
        surface_bounds: [UVec3::ZERO, UVec3::new(side, side, 8)],
    };
    Octree { header, levels }
}

/// The colour of a chunk.
pub(crate) fn color(tag: u8, level: u8, chunk: u32) -> [u8; 4] {
    [tag, level, chunk as u8, 255]
}

fn brick_file(tree: &Octree, level: u8, tag: u8, encoding: Encoding) -> Vec<u8> {
    let layout = tree.header.layout;
    let mut writer = BrickFileWriter::new(level, layout, CHUNK_LOG2, encoding);
    let mut file = vec![0; HEADER_BYTES];
    let mut chunks: Vec<(u64, u64)> = Vec::new();
    for (p, node) in tree
        .positions(level)
        .into_iter()
        .zip(&tree.levels[usize::from(level)])
    {
        if let NodeData::Constant(_) = node.data() {
            continue;
        }
        let code = morton::encode(p >> u32::from(CHUNK_LOG2));
        let bit = 1 << morton::encode(p & UVec3::splat((1 << CHUNK_LOG2) - 1));
        match chunks.last_mut() {
            Some((last, mask)) if *last == code => *mask |= bit,
            _ => chunks.push((code, bit)),
        }
    }
    for (k, (code, mask)) in chunks.into_iter().enumerate() {
        let samples = mask.count_ones() as usize * layout.samples();
        let color = vec![color(tag, level, k as u32); samples];
        let chunk = Chunk {
            mask,
            layout,
            color,
            normal: vec![[0, 0, 127, 0]; samples],
            opacity: Vec::new(),
        };
        let payload = chunk.encode(encoding).unwrap();
        writer.push(morton::decode(code), mask, &payload).unwrap();
        file.extend_from_slice(&payload);
    }
    let (directory, header) = writer.finish();
    file.extend_from_slice(&directory);
    file[..HEADER_BYTES].copy_from_slice(&header);
    file
}

/// The objects of a tree: its octree file and its brick files.
pub(crate) fn objects(file: &str, depth: u8, tag: u8) -> Vec<(String, Vec<u8>)> {
    objects_of(&octree(depth), file, tag)
}

/// The objects of any tree.
pub(crate) fn objects_of(tree: &Octree, file: &str, tag: u8) -> Vec<(String, Vec<u8>)> {
    coded_objects(tree, file, tag, Encoding::Packed)
}

/// The same with bricks in an encoding.
pub(crate) fn coded_objects(
    tree: &Octree,
    file: &str,
    tag: u8,
    encoding: Encoding,
) -> Vec<(String, Vec<u8>)> {
    let octree = match file.ends_with(".xml") {
        true => octree_xml::encode(tree).unwrap().into_bytes(),
        false => octree_binary::encode(tree).unwrap(),
    };
    let bricks = (0..=tree.header.depth).map(|level| {
        (
            brick_file_name(file, level),
            brick_file(tree, level, tag, encoding),
        )
    });
    std::iter::once((file.to_owned(), octree)).chain(bricks).collect()
}

/// A store with trees `0.oct`, `1.oct`, … of these depths.
pub(crate) fn store(depths: &[u8]) -> Arc<MemoryStore> {
    let store = MemoryStore::new();
    for (k, depth) in depths.iter().enumerate() {
        for (name, bytes) in objects(&format!("{k}.oct"), *depth, k as u8) {
            store.put(&name, bytes);
        }
    }
    Arc::new(store)
}

pub(crate) fn config(budget_bytes: u64, threads: usize) -> PagerConfig {
    PagerConfig {
        budget_bytes,
        threads,
        retry: Duration::from_millis(5),
        ..PagerConfig::default()
    }
}

/// A pager over the trees of [`store`].
pub(crate) fn pager(store: &Arc<MemoryStore>, trees: usize, config: PagerConfig) -> Pager {
    Pager::new(
        store.clone(),
        (0..trees).map(|k| format!("{k}.oct")).collect(),
        config,
    )
}

pub(crate) fn root(tree: u32) -> PageKey {
    PageKey::Root(TreeId(tree))
}

pub(crate) fn level(tree: u32, level: u8) -> PageKey {
    PageKey::Level {
        tree: TreeId(tree),
        level,
    }
}

pub(crate) fn chunk(tree: u32, level: u8, chunk: u32) -> PageKey {
    PageKey::Chunk {
        tree: TreeId(tree),
        level,
        chunk,
    }
}

/// A render loop.
pub(crate) struct Flight {
    pub(crate) pager: Pager,
    pub(crate) frame: u64,
}

impl Flight {
    pub(crate) fn new(pager: Pager) -> Self {
        Self { pager, frame: 0 }
    }

    /// One frame with these requests; gives what was published.
    pub(crate) fn frame(&mut self, wants: &[(PageKey, f64)]) -> Vec<PageKey> {
        self.frame += 1;
        let published = self.pager.merge(self.frame).to_vec();
        for (key, priority) in wants {
            self.pager.request(*key, *priority);
        }
        self.pager.submit();
        published
    }

    /// Frames with the same requests until the pager is idle; gives what was published.
    pub(crate) fn settle(&mut self, wants: &[(PageKey, f64)]) -> Vec<PageKey> {
        let mut published = Vec::new();
        for _ in 0..10_000 {
            published.extend(self.frame(wants));
            if self.pager.is_idle() {
                return published;
            }
            assert!(
                self.pager.wait_for_progress(Duration::from_secs(20)),
                "no progress: {:?}",
                self.pager.stats()
            );
        }
        panic!("never idle: {:?}", self.pager.stats());
    }

    /// Frames with the same requests until the condition holds.
    pub(crate) fn until(
        &mut self,
        wants: &[(PageKey, f64)],
        condition: impl Fn(&Pager) -> bool,
    ) -> Vec<PageKey> {
        let mut published = Vec::new();
        let end = std::time::Instant::now() + Duration::from_secs(20);
        while std::time::Instant::now() < end {
            published.extend(self.frame(wants));
            if condition(&self.pager) {
                return published;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("the condition never held: {:?}", self.pager.stats());
    }

    pub(crate) fn has(&self, key: PageKey) -> bool {
        let tree = self.pager.tree(key.tree());
        match key {
            PageKey::Root(_) => tree.is_some(),
            PageKey::Level { level, .. } => tree.is_some_and(|t| t.level(level).is_some()),
            PageKey::Chunk { tree, level, chunk } => self.pager.chunk(tree, level, chunk).is_some(),
        }
    }
}
