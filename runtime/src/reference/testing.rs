//! Small trees made in memory from closures, and single rays through them.

use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::value::Stored;
use brickfell_formats::{morton, octree_binary};
use brickfell_pager::store::MemoryStore;
use glam::{DVec3, IVec3, UVec3};

use super::{Reference, ReferenceError, Scene};
use crate::picture::RayCounters;
use crate::settings::RenderSettings;

/// Trees in memory.
#[derive(Default)]
pub(crate) struct Store(pub(crate) MemoryStore);

/// What a node of a test tree is.
#[derive(Clone, Copy)]
pub(crate) enum Kind {
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
pub(crate) fn header(
    origin: DVec3,
    voxel_size: f64,
    depth: u8,
    layout: SampleLayout,
    gain: u8,
) -> TreeHeader {
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
    /// Writes a tree: `kind` says what the node at a position (in nodes of its level) is, `sample` gives the sample at a
    /// lattice index (in voxels of its level) of the tree.
    pub(crate) fn add(
        &mut self,
        name: &str,
        header: TreeHeader,
        kind: impl Fn(u8, UVec3) -> Kind,
        sample: impl Fn(u8, IVec3) -> Stored,
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
                let file = brick_file(level, header.layout, &bricks, &sample);
                self.0.put(&brick_file_name(name, level), file);
            }
        }
        let file = octree_binary::encode(&Octree { header, levels }).unwrap();
        self.0.put(name, file);
    }

    /// A reference of the named trees.
    pub(super) fn open(self, names: &[&str]) -> Reference {
        self.try_open(names).unwrap()
    }

    /// A reference of the named trees, or why not.
    pub(super) fn try_open(self, names: &[&str]) -> Result<Reference, ReferenceError> {
        Reference::new(
            Arc::new(self.0),
            &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>(),
        )
    }
}

fn brick_file(
    level: u8,
    layout: SampleLayout,
    bricks: &[UVec3],
    sample: &impl Fn(u8, IVec3) -> Stored,
) -> Vec<u8> {
    let mut writer = BrickFileWriter::new(level, layout, 2, Encoding::Zstd);
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
                let s = sample(
                    level,
                    low + IVec3::new(k % side, k / side % side, k / side / side),
                );
                chunk.color.push(s.color);
                chunk.normal.push(s.normal);
            }
        }
        let payload = chunk.encode(Encoding::Zstd).unwrap();
        writer.push(bricks[0] / 4, chunk.mask, &payload).unwrap();
        out.extend_from_slice(&payload);
    }
    let (directory, header) = writer.finish();
    out.extend_from_slice(&directory);
    out[..HEADER_BYTES].copy_from_slice(&header);
    out
}

/// A grey sample without normal.
pub(crate) fn grey(code: u8, alpha: u8) -> Stored {
    Stored {
        color: [code, code, code, alpha],
        normal: [0; 4],
    }
}

/// One ray: colour and counters. `footprint` is a pixel's size in metres per metre of depth, bias included.
pub(super) fn shoot(
    reference: &Reference,
    eye: DVec3,
    direction: DVec3,
    footprint: f64,
    mix_levels: bool,
) -> ([f64; 4], RayCounters) {
    let settings = RenderSettings::default();
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Y, 60.0, 1, 1).unwrap();
    let scene = Scene {
        footprint,
        mix_levels,
        ..Scene::new(&reference.trees, &camera, &settings).unwrap()
    };
    let mut counters = RayCounters::default();
    let rgba = scene
        .cast(&scene.ray_along(eye, direction), &mut Vec::new(), &mut counters)
        .unwrap();
    assert!(
        rgba.iter().all(|c| c.is_finite()) && (0.0..=1.0).contains(&rgba[3]),
        "{eye} {direction}: {rgba:?}"
    );
    assert_eq!(
        (counters.capped, counters.not_finite),
        (0, 0),
        "{eye} {direction}"
    );
    (rgba, counters)
}

/// All directions with components -1, 0 and 1, the zeros once as 0 and once as -0.
pub(super) fn sign_patterns() -> Vec<DVec3> {
    let values = [-1.0, -0.0, 0.0, 1.0];
    (0..64)
        .map(|k| DVec3::new(values[k & 3], values[k >> 2 & 3], values[k >> 4]))
        .filter(|d| *d != DVec3::ZERO)
        .collect()
}

/// Metres of a ray from `eye` along `direction` (not normalised) inside the half-open box; 0 if it misses.
pub(super) fn path_in_box(eye: DVec3, direction: DVec3, lo: DVec3, hi: DVec3) -> f64 {
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
