//! Small trees made in memory from closures, and the scene that holds them.

use std::sync::Arc;

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::scene::{Bounds, PagedOctTree, Scene};
use brickfell_formats::value::Stored;
use brickfell_formats::{morton, octree_binary};
use brickfell_pager::MemoryStore;
use brickfell_runtime::terrain::SCENE_FILE;
use glam::{DVec3, IVec3, UVec3};

use crate::world::World;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One colour, no children.
    Leaf([u8; 4]),
    /// A brick, with children unless it lies on the deepest level.
    Brick,
}

/// A header with its low corner at `origin` and finest voxels of `voxel_size` metres.
pub fn header(origin: DVec3, voxel_size: f64, depth: u8, layout: SampleLayout, gain: u8) -> TreeHeader {
    TreeHeader {
        origin,
        voxel_size,
        depth,
        layout,
        gain,
        surface_voxels: 0,
        surface_bounds: [UVec3::ZERO; 2],
    }
}

/// A sample of this colour, without a normal.
pub fn sample(color: [u8; 4]) -> Stored {
    Stored {
        color,
        normal: [0; 4],
    }
}

/// A scene in the making.
#[derive(Default)]
pub struct Maker {
    store: MemoryStore,
    scene: Scene,
}

impl Maker {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a tree: `kind` says what the node at a position is (in nodes of its level), `value` gives the sample at a
    /// lattice index (in voxels of its level, from the tree's corner).
    ///
    /// # Panics
    /// If the tree cannot be written.
    #[must_use]
    pub fn tree(
        mut self,
        header: TreeHeader,
        kind: impl Fn(u8, UVec3) -> Kind,
        value: impl Fn(u8, IVec3) -> Stored,
    ) -> Self {
        let name = format!("tree{}.oct", self.scene.root.trees.len());
        let mut positions = vec![UVec3::ZERO];
        let mut levels = Vec::new();
        for level in 0..=header.depth {
            let (mut tiles, mut bricks) = (0, Vec::new());
            let nodes: Vec<Node> = positions
                .iter()
                .map(|p| match kind(level, *p) {
                    Kind::Leaf(color) => Node::constant(color),
                    Kind::Brick => {
                        bricks.push(*p);
                        let children = (level < header.depth).then_some(tiles);
                        tiles += u32::from(children.is_some());
                        Node::new(children, NodeData::Brick(bricks.len() as u32 - 1))
                    }
                })
                .collect();
            positions = child_positions(&nodes, &positions);
            levels.push(nodes);
            if !bricks.is_empty() {
                let file = brick_file(level, header.layout, &bricks, &value);
                self.store.put(&brick_file_name(&name, level), file);
            }
        }
        let file = octree_binary::encode(&Octree { header, levels }).unwrap();
        self.store.put(&name, file);
        let [min, max] = header.bounds();
        self.scene.root.trees.push(PagedOctTree {
            center: (min + max) * 0.5,
            radius: header.side(),
            bounds: Some(Bounds { min, max }),
            tree_file: name,
        });
        self
    }

    /// The finished scene.
    pub fn finish(self) -> World {
        self.store.put(SCENE_FILE, self.scene.to_xml().into_bytes());
        World::new(Arc::new(self.store))
    }
}

fn brick_file(
    level: u8,
    layout: SampleLayout,
    bricks: &[UVec3],
    value: &impl Fn(u8, IVec3) -> Stored,
) -> Vec<u8> {
    let mut writer = BrickFileWriter::new(level, layout, 2, Encoding::Zstd);
    let mut file = vec![0; HEADER_BYTES];
    let side = layout.side() as i32;
    for bricks in bricks.chunk_by(|a, b| *a / 4 == *b / 4) {
        let mut chunk = Chunk {
            mask: 0,
            layout,
            color: Vec::new(),
            normal: Vec::new(),
            opacity: Vec::new(),
        };
        for brick in bricks {
            chunk.mask |= 1 << morton::encode(*brick % 4);
            let low = brick.as_ivec3() * 8 - layout.low_apron() as i32;
            for k in 0..side.pow(3) {
                let stored = value(
                    level,
                    low + IVec3::new(k % side, k / side % side, k / side / side),
                );
                chunk.color.push(stored.color);
                chunk.normal.push(stored.normal);
            }
        }
        let payload = chunk.encode(Encoding::Zstd).unwrap();
        writer.push(bricks[0] / 4, chunk.mask, &payload).unwrap();
        file.extend_from_slice(&payload);
    }
    let (directory, head) = writer.finish();
    file.extend_from_slice(&directory);
    file[..HEADER_BYTES].copy_from_slice(&head);
    file
}
