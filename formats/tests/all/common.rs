//! Random but valid trees, scenes and chunks, for the tests of this folder.

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES};
use brickfell_formats::chunk::{Chunk, Encoding, Layers, brick_positions};
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader};
use glam::{DVec3, UVec3};
use proptest::prelude::*;

/// A node with its children, as one would draw it.
#[derive(Clone, Debug)]
pub(crate) struct Branch {
    pub(crate) color: Option<[u8; 4]>,
    pub(crate) children: Vec<Branch>,
}

/// The levels of a drawn tree, breadth-first.
pub(crate) fn flatten(root: &Branch, depth: u8) -> Vec<Vec<Node>> {
    let mut levels = Vec::new();
    let mut siblings = vec![root];
    for _ in 0..=depth {
        let (mut tiles, mut bricks) = (0, 0);
        let nodes = siblings.iter().map(|branch| {
            let data = branch.color.map_or_else(
                || {
                    bricks += 1;
                    NodeData::Brick(bricks - 1)
                },
                NodeData::Constant,
            );
            let children = (!branch.children.is_empty()).then(|| {
                tiles += 1;
                tiles - 1
            });
            Node::new(children, data)
        });
        levels.push(nodes.collect());
        siblings = siblings.iter().flat_map(|b| &b.children).collect();
    }
    levels
}

fn height(branch: &Branch) -> u8 {
    branch.children.iter().map(|c| height(c) + 1).max().unwrap_or(0)
}

fn layout() -> impl Strategy<Value = SampleLayout> {
    prop_oneof![Just(SampleLayout::Corner), Just(SampleLayout::Centre)]
}

pub(crate) fn encoding() -> impl Strategy<Value = Encoding> {
    prop_oneof![Just(Encoding::Plain), Just(Encoding::Packed)]
}

/// A coordinate as an author or a survey would have it, or any double within the limits.
pub(crate) fn metres() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(-0.0),
        (-1000i32..1000).prop_map(f64::from),
        (-1e7..1e7f64),
        any::<f64>().prop_filter("in the world", |v| v.abs() <= 1e14)
    ]
}

pub(crate) fn point() -> impl Strategy<Value = DVec3> {
    [metres(), metres(), metres()].prop_map(DVec3::from)
}

prop_compose! {
    /// A tree's properties; the depth is at least `least`.
    pub(crate) fn header(least: u8)(
        origin in point(),
        voxel_size in prop_oneof![Just(0.1), 1e-6..1e6f64],
        depth in least..=least.max(20),
        layout in layout(),
        gain in 1u8..=2,
        surface_voxels in any::<u64>(),
        corners in any::<[[u32; 3]; 2]>(),
    ) -> TreeHeader {
        let [a, b] = corners.map(|c| UVec3::from(c) % ((BRICK_VOXELS << depth) + 1));
        let surface_bounds = [a.min(b), a.max(b)];
        TreeHeader { origin, voxel_size, depth, layout, gain, surface_voxels, surface_bounds }
    }
}

/// A valid tree of at most five levels with nodes.
pub(crate) fn octree() -> impl Strategy<Value = Octree> {
    let color = || prop::option::of(any::<[u8; 4]>());
    let branch = color().prop_map(|color| Branch {
        color,
        children: Vec::new(),
    });
    let branch = branch.prop_recursive(4, 256, 8, move |inner| {
        (color(), prop::collection::vec(inner, 8)).prop_map(|(color, children)| Branch { color, children })
    });
    branch
        .prop_flat_map(|root| (header(height(&root)), Just(root)))
        .prop_map(|(header, root)| {
            let levels = flatten(&root, header.depth);
            Octree { header, levels }
        })
}

/// A hash of a lattice sample, the same for every brick that stores it: noise, or a ground like terrain where `flat`.
fn sample(p: UVec3, seed: u64, flat: bool) -> ([u8; 4], [i8; 4]) {
    if flat && p.z > 11 + p.x % 3 {
        return Default::default();
    }
    let key = if flat { p.with_z(0) } else { p };
    let mut h = seed;
    for v in key.to_array() {
        h = (h ^ u64::from(v)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    let [r, g, b, a, x, y, z, _] = h.to_le_bytes();
    ([r, g, b, a], [x as i8, y as i8, z as i8, 0])
}

/// The chunk of a field of samples; shared samples agree.
pub(crate) fn chunk_of(mask: u64, layout: SampleLayout, seed: u64, flat: bool) -> Chunk {
    let mut chunk = Chunk {
        mask,
        layout,
        color: Vec::new(),
        normal: Vec::new(),
        opacity: Vec::new(),
    };
    for p in brick_positions(mask) {
        for i in 0..layout.samples() as u32 {
            let side = layout.side();
            let inside = UVec3::new(i % side, i / side % side, i / (side * side));
            let (color, normal) = sample(p * BRICK_VOXELS + inside, seed, flat);
            chunk.color.push(color);
            chunk.normal.push(normal);
        }
    }
    chunk
}

/// Gives a chunk opacities against the axes; shared samples agree.
pub(crate) fn add_opacity(chunk: &mut Chunk) {
    chunk.opacity = chunk
        .color
        .iter()
        .map(|[r, g, b, a]| [*a, *r, g ^ b, 0])
        .collect();
}

/// A mask of 1, 2³ or 4³ places with at least one brick.
pub(crate) fn mask(chunk_log2: u8) -> impl Strategy<Value = u64> {
    let places = u64::MAX >> (64 - (1u32 << (3 * chunk_log2)));
    let sparse = (any::<u64>(), any::<u64>(), any::<u64>()).prop_map(|(a, b, c)| a & b & c);
    prop_oneof![sparse, any::<u64>(), Just(u64::MAX)]
        .prop_map(move |m| m & places)
        .prop_filter("not empty", |m| *m != 0)
}

prop_compose! {
    pub(crate) fn chunk(chunk_log2: u8)(
        mask in mask(chunk_log2), layout in layout(), seed in any::<u64>(), flat in any::<bool>(),
    ) -> Chunk {
        chunk_of(mask, layout, seed, flat)
    }
}

/// A brick file of chunks at given places.
pub(crate) fn brick_file(
    level: u8,
    chunk_log2: u8,
    encoding: Encoding,
    chunks: &[(UVec3, Chunk)],
) -> Vec<u8> {
    let layout = chunks.first().map_or(SampleLayout::Centre, |(_, c)| c.layout);
    let layers = chunks.first().map_or(Layers::Plain, |(_, c)| c.layers());
    let mut writer = BrickFileWriter::new(level, layout, chunk_log2, encoding).with_layers(layers);
    let mut file = vec![0; HEADER_BYTES];
    for (position, chunk) in chunks {
        let payload = chunk.encode(encoding).expect("a valid chunk");
        writer
            .push(*position, chunk.mask, &payload)
            .expect("a chunk in order");
        file.extend(payload);
    }
    let (directory, header) = writer.finish();
    file.extend(directory);
    file[..HEADER_BYTES].copy_from_slice(&header);
    file
}
