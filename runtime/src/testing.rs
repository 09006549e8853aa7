//! Small trees made in memory from closures, for tests of this crate and, with the feature `testing`, of others.
//!
//! What a closure cannot mean ends the test that called: these functions panic. Plain values: any thread.
#![allow(
    clippy::unwrap_used,
    reason = "a helper that fails ends the test that called it"
)]

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::value::Stored;
use brickfell_formats::{morton, octree_binary};
use brickfell_pager::store::MemoryStore;
use glam::{DVec3, IVec3, UVec3};

/// Trees in memory.
#[derive(Default)]
pub struct Store(pub MemoryStore);

/// What a node of a test tree is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A constant node without children.
    Leaf([u8; 4]),
    /// A constant node with children.
    Inner([u8; 4]),
    /// A brick node; it has children unless it is on the deepest level.
    Brick,
    /// A brick node without children.
    BrickLeaf,
}

/// A header with its low corner at `origin` and finest voxels of `voxel_size` metres.
pub fn header(origin: DVec3, voxel_size: f64, depth: u8, layout: SampleLayout, gain: u8) -> TreeHeader {
    let surface_bounds = [UVec3::ZERO; 2];
    TreeHeader {
        origin,
        voxel_size,
        depth,
        layout,
        gain,
        surface_voxels: 0,
        surface_bounds,
    }
}

impl Store {
    /// Writes a tree: `kind` says what the node at a position (in nodes of its level) is, `value` gives the sample at a
    /// lattice index (in voxels of its level, from the tree's corner).
    ///
    /// # Panics
    /// If the tree cannot be written.
    pub fn add(
        &mut self,
        name: &str,
        header: TreeHeader,
        kind: impl Fn(u8, UVec3) -> Kind,
        value: impl Fn(u8, IVec3) -> Stored,
    ) {
        let mut positions = vec![UVec3::ZERO];
        let mut levels = Vec::new();
        for level in 0..=header.depth {
            let (mut tiles, mut bricks) = (0, Vec::new());
            let nodes: Vec<Node> = positions
                .iter()
                .map(|p| {
                    let kind = kind(level, *p);
                    let data = match kind {
                        Kind::Leaf(color) | Kind::Inner(color) => NodeData::Constant(color),
                        Kind::Brick | Kind::BrickLeaf => {
                            bricks.push(*p);
                            NodeData::Brick(bricks.len() as u32 - 1)
                        }
                    };
                    let has_children = matches!(kind, Kind::Inner(_) | Kind::Brick) && level < header.depth;
                    tiles += u32::from(has_children);
                    Node::new(has_children.then(|| tiles - 1), data)
                })
                .collect();
            positions = child_positions(&nodes, &positions);
            levels.push(nodes);
            if !bricks.is_empty() {
                let file = brick_file(level, header.layout, &bricks, &value);
                self.0.put(&brick_file_name(name, level), file);
            }
        }
        let file = octree_binary::encode(&Octree { header, levels }).unwrap();
        self.0.put(name, file);
    }
}

fn brick_file(
    level: u8,
    layout: SampleLayout,
    bricks: &[UVec3],
    value: &impl Fn(u8, IVec3) -> Stored,
) -> Vec<u8> {
    let mut writer = BrickFileWriter::new(level, layout, 2, Encoding::Packed);
    let mut out = vec![0; HEADER_BYTES];
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
            let side = layout.side() as i32;
            for k in 0..side.pow(3) {
                let stored = value(
                    level,
                    low + IVec3::new(k % side, k / side % side, k / side / side),
                );
                chunk.color.push(stored.color);
                chunk.normal.push(stored.normal);
            }
        }
        let payload = chunk.encode(Encoding::Packed).unwrap();
        writer.push(bricks[0] / 4, chunk.mask, &payload).unwrap();
        out.extend_from_slice(&payload);
    }
    let (directory, header) = writer.finish();
    out.extend_from_slice(&directory);
    out[..HEADER_BYTES].copy_from_slice(&header);
    out
}

/// A sample of this colour, without a normal.
pub fn sample(color: [u8; 4]) -> Stored {
    Stored {
        color,
        normal: [0; 4],
    }
}

/// A grey sample without a normal.
pub fn grey(code: u8, alpha: u8) -> Stored {
    sample([code, code, code, alpha])
}

/// All directions with components -1, 0 and 1, the zeros once as 0 and once as -0.
pub fn sign_patterns() -> Vec<DVec3> {
    let values = [-1.0, -0.0, 0.0, 1.0];
    (0..64)
        .map(|k| DVec3::new(values[k & 3], values[k >> 2 & 3], values[k >> 4]))
        .filter(|d| *d != DVec3::ZERO)
        .collect()
}

/// Metres of a ray from `eye` along `direction` (not normalised) inside the half-open box; 0 if it misses.
pub fn path_in_box(eye: DVec3, direction: DVec3, lo: DVec3, hi: DVec3) -> f64 {
    let (mut near, mut far) = (0f64, f64::INFINITY);
    for axis in 0..3 {
        let (p, d) = (eye[axis], direction[axis]);
        if d.abs() < f64::MIN_POSITIVE {
            if p < lo[axis] || p >= hi[axis] {
                return 0.0;
            }
        } else {
            let planes = if d > 0.0 {
                (lo[axis], hi[axis])
            } else {
                (hi[axis], lo[axis])
            };
            near = near.max((planes.0 - p) / d);
            far = far.min((planes.1 - p) / d);
        }
    }
    (far - near).max(0.0) * direction.length()
}
