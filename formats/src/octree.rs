//! One tree in memory: a header and, per level, its node tiles in Morton order.
//!
//! Level 0 is the root alone. Level L > 0 holds tiles of eight siblings; the tiles stand in the order of their parents, so
//! a level is sorted by Morton code and a prefix of the levels is the coarse tree. Invariants, checked when read: the k-th
//! node with children points to tile k of the next level, the k-th brick node of a level has brick k.

use glam::{DVec3, UVec3};

use crate::error::FormatError;
use crate::layout::{BRICK_VOXELS, SampleLayout};
use crate::{octree_binary, octree_xml};

/// The deepest level a tree may have: 8·2²⁰ voxels per axis.
pub const MAX_DEPTH: u8 = 20;

/// Most tiles a level may have: their nodes are counted in 32 bits.
pub const MAX_TILES: u32 = (1 << 29) - 1;

/// Largest magnitude of a coordinate or length, metres: beyond it a double resolves no more than an eighth of a metre.
pub const MAX_METRES: f64 = 1e15;

/// A tree's properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeHeader {
    /// Low corner in the world, metres. In built trees a whole multiple of the root brick's voxel.
    pub origin: DVec3,
    /// Side of a finest voxel, metres.
    pub voxel_size: f64,
    /// The deepest level; the tree spans `8 << depth` finest voxels per axis.
    pub depth: u8,
    /// Where samples lie in bricks.
    pub layout: SampleLayout,
    /// Opacity gain, 1 or 2 (see [`crate::value`]).
    pub gain: u8,
    /// Finest voxels that an input surface meets, before anything is collapsed; solid fill is not counted.
    pub surface_voxels: u64,
    /// The box of those voxels, in finest voxels from the origin: low corner, and high corner exclusive.
    pub surface_bounds: [UVec3; 2],
}

impl TreeHeader {
    /// Finest voxels per axis.
    pub fn side_voxels(&self) -> u64 {
        u64::from(BRICK_VOXELS) << self.depth
    }

    /// Side of the tree, metres.
    pub fn side(&self) -> f64 {
        self.side_voxels() as f64 * self.voxel_size
    }

    /// Side of a voxel of a level, metres.
    pub fn level_voxel_size(&self, level: u8) -> f64 {
        self.voxel_size * (1u64 << (self.depth - level.min(self.depth))) as f64
    }

    /// The tree's half-open box in the world, metres.
    pub fn bounds(&self) -> [DVec3; 2] {
        [self.origin, self.origin + DVec3::splat(self.side())]
    }

    /// The finest voxels of which a box in the world has a part, from the origin: low corner, and high corner exclusive; none
    /// outside of the tree. A corner that is a voxel's but for rounding is that voxel's.
    pub fn voxels_within(&self, bounds: [DVec3; 2]) -> [UVec3; 2] {
        let last = DVec3::splat(self.side_voxels() as f64);
        let origin = (self.origin / self.voxel_size).map(whole);
        let local = bounds.map(|p| (p / self.voxel_size).map(whole) - origin);
        [local[0].floor(), local[1].ceil()].map(|p| p.clamp(DVec3::ZERO, last).as_uvec3())
    }

    /// Checks the ranges that everything else relies on.
    ///
    /// # Errors
    /// Naming the first property out of range.
    pub fn validate(&self) -> Result<(), FormatError> {
        if !self.origin.is_finite() || self.origin.abs().max_element() > MAX_METRES {
            return Err(FormatError::file(format!(
                "origin {} is not a usable position",
                self.origin
            )));
        }
        if !(self.voxel_size.is_finite() && (1e-9..=1e9).contains(&self.voxel_size)) {
            return Err(FormatError::file(format!(
                "voxel size {} is not usable",
                self.voxel_size
            )));
        }
        if self.depth > MAX_DEPTH {
            return Err(FormatError::file(format!(
                "depth {} is above {MAX_DEPTH}",
                self.depth
            )));
        }
        if self.side() > MAX_METRES {
            return Err(FormatError::file(format!("side {} m is not usable", self.side())));
        }
        if !(1..=2).contains(&self.gain) {
            return Err(FormatError::file(format!(
                "opacity gain {} is unknown (1 or 2)",
                self.gain
            )));
        }
        let [lo, hi] = self.surface_bounds.map(|p| p.as_u64vec3());
        if lo.cmpgt(hi).any() || hi.max_element() > self.side_voxels() {
            return Err(FormatError::file("surface bounds do not lie in the tree"));
        }
        Ok(())
    }
}

/// Makes an integer of what is one but for f64's rounding: a metre that is not a power of two has no exact number of voxels.
fn whole(voxels: f64) -> f64 {
    let nearest = voxels.round();
    if (voxels - nearest).abs() <= nearest.abs() * (4.0 * f64::EPSILON) {
        nearest
    } else {
        voxels
    }
}

/// What a node shows at its own level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeData {
    /// One stored colour everywhere in the node (see [`crate::value`]).
    Constant([u8; 4]),
    /// The brick with this index among the bricks of the level.
    Brick(u32),
}

/// A node in 64 bits: bit 31 of the first word says terminal, bit 30 brick, the rest is the child tile's index in the next
/// level; the second word is the constant colour (r in the low byte) or the brick index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Node {
    /// Terminal bit, kind bit, child tile.
    pub structure: u32,
    /// Colour or brick index.
    pub data: u32,
}

/// Bit of [`Node::structure`]: the data ends here, there are no children.
pub const TERMINAL: u32 = 1 << 31;
/// Bit of [`Node::structure`]: the node has a brick.
pub const BRICK: u32 = 1 << 30;

impl Node {
    /// A node from its parts; `children` is a tile index of the next level, `None` for a terminal node.
    pub fn new(children: Option<u32>, data: NodeData) -> Self {
        let (kind, data) = match data {
            NodeData::Constant(color) => (0, u32::from_le_bytes(color)),
            NodeData::Brick(index) => (BRICK, index),
        };
        Self {
            structure: kind | children.map_or(TERMINAL, |tile| tile & (BRICK - 1)),
            data,
        }
    }

    /// A terminal node of one colour.
    pub fn constant(color: [u8; 4]) -> Self {
        Self::new(None, NodeData::Constant(color))
    }

    /// Index of the child tile in the next level, `None` for a terminal node.
    pub fn children(self) -> Option<u32> {
        (self.structure & TERMINAL == 0).then_some(self.structure & (BRICK - 1))
    }

    /// What the node shows at its level.
    pub fn data(self) -> NodeData {
        if self.structure & BRICK == 0 {
            NodeData::Constant(self.data.to_le_bytes())
        } else {
            NodeData::Brick(self.data)
        }
    }
}

/// A whole tree.
#[derive(Clone, Debug, PartialEq)]
pub struct Octree {
    /// Its properties.
    pub header: TreeHeader,
    /// Nodes of each level, `depth + 1` entries, trailing ones may be empty.
    pub levels: Vec<Vec<Node>>,
}

impl Octree {
    /// Number of bricks of a level.
    pub fn brick_count(&self, level: u8) -> u32 {
        self.levels
            .get(usize::from(level))
            .map_or(0, |nodes| count_bricks(nodes))
    }

    /// Checks every invariant of the module.
    ///
    /// # Errors
    /// Naming the first level and node that break one.
    pub fn validate(&self) -> Result<(), FormatError> {
        self.header.validate()?;
        if self.levels.len() != usize::from(self.header.depth) + 1 {
            return Err(FormatError::file("a level is missing"));
        }
        let mut tiles = 0;
        for (level, nodes) in self.levels.iter().enumerate() {
            let expected = if level == 0 { 1 } else { tiles as usize * 8 };
            if nodes.len() != expected {
                return Err(FormatError::file(format!(
                    "level {level} has {} nodes, {expected} are referred to",
                    nodes.len()
                )));
            }
            tiles = check_level(nodes, level as u8, self.header.depth)?.tiles;
        }
        Ok(())
    }

    /// Coordinates of every node of a level, in nodes of that level, in file order.
    pub fn positions(&self, level: u8) -> Vec<UVec3> {
        let mut positions = vec![UVec3::ZERO];
        for nodes in self.levels.iter().take(usize::from(level)) {
            positions = child_positions(nodes, &positions);
        }
        positions
    }
}

/// Reads an octree file, binary or XML.
///
/// # Errors
/// As [`crate::octree_binary::decode`] and [`crate::octree_xml::decode`].
pub fn decode_any(bytes: &[u8]) -> Result<Octree, FormatError> {
    if bytes.is_empty() {
        Err(FormatError::file("the file is empty"))
    } else if octree_binary::is_binary(bytes) {
        octree_binary::decode(bytes)
    } else {
        octree_xml::decode(bytes)
    }
}

/// Coordinates of the nodes of the next level, given a level's nodes and their coordinates.
pub fn child_positions(nodes: &[Node], positions: &[UVec3]) -> Vec<UVec3> {
    nodes
        .iter()
        .zip(positions)
        .filter(|(node, _)| node.children().is_some())
        .flat_map(|(_, p)| (0..8u32).map(move |o| *p * 2 + octant_offset(o)))
        .collect()
}

/// Offset (0 or 1 per axis) of an octant `x + 2y + 4z`.
pub fn octant_offset(octant: u32) -> UVec3 {
    UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2 & 1)
}

/// Octant `x + 2y + 4z` of a node among its siblings, from its coordinates.
pub fn octant(p: UVec3) -> u32 {
    p.x & 1 | (p.y & 1) << 1 | (p.z & 1) << 2
}

/// Number of brick nodes.
pub fn count_bricks(nodes: &[Node]) -> u32 {
    nodes.iter().filter(|n| n.structure & BRICK != 0).count() as u32
}

/// What a level refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelCounts {
    /// Tiles of the next level.
    pub tiles: u32,
    /// Bricks of this level.
    pub bricks: u32,
}

/// Checks the running indices of one level and counts what it refers to.
///
/// # Errors
/// Naming the first node whose index is out of order, or that has children where no level follows.
pub fn check_level(nodes: &[Node], level: u8, depth: u8) -> Result<LevelCounts, FormatError> {
    let mut counts = LevelCounts { tiles: 0, bricks: 0 };
    for (index, node) in nodes.iter().enumerate() {
        let fault = |what: &str| FormatError::file(format!("level {level}, node {index}: {what}"));
        if let Some(tile) = node.children() {
            if level >= depth {
                return Err(fault("has children below the deepest level"));
            }
            if tile != counts.tiles || tile >= MAX_TILES {
                return Err(fault("child tile out of order"));
            }
            counts.tiles += 1;
        } else if node.structure & (BRICK - 1) != 0 {
            return Err(fault("a terminal node has a child tile"));
        }
        if let NodeData::Brick(brick) = node.data() {
            if brick != counts.bricks {
                return Err(fault("brick index out of order"));
            }
            counts.bricks += 1;
        }
    }
    Ok(counts)
}
