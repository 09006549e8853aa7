//! One tree of the terrain: which of its nodes are bricks, and its octree file.
//!
//! A node is a brick where its samples, apron included, are not all air and not all deep ground, or those of a node below
//! are not; then it has children down to the deepest level. So what is constant is constant on all levels below.

use brickfell_formats::error::FormatError;
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::octree_binary;
use brickfell_formats::value::BUILD_GAIN;
use glam::{DVec3, UVec3};

use super::field::{Field, Patch, deep};

/// Voxels of a brick.
const BRICK: i64 = BRICK_VOXELS as i64;
/// Levels of a coarse tree, less one.
const COARSE_DEPTH: u8 = 1;

/// A tree (height 0), or the coarse tree of a group that many levels of nesting above trees; its column in its own sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Place {
    pub(super) height: u8,
    pub(super) column: [u32; 2],
}

impl Place {
    /// Its deepest level.
    pub(super) fn depth(&self, field: &Field) -> u8 {
        match self.height {
            0 => field.depth,
            _ => COARSE_DEPTH,
        }
    }

    /// Width of a voxel of a level, log2 of finest voxels of the terrain.
    pub(super) fn mip(&self, field: &Field, level: u8) -> u32 {
        let side = u32::from(field.depth) + u32::from(self.height);
        side - u32::from(level)
    }

    /// Its low corner, in voxels of a level: the ground's zero is in the middle of its height.
    pub(super) fn low(&self, level: u8) -> [i64; 3] {
        let [x, y] = self.column.map(|v| i64::from(v) * (BRICK << level));
        [x, y, -((BRICK / 2) << level)]
    }

    /// A patch of columns of a level, from a corner in voxels of the tree.
    pub(super) fn patch(&self, field: &Field, level: u8, corner: [i64; 2], side: usize) -> Patch {
        let low = self.low(level);
        Patch {
            mip: self.mip(field, level),
            low: [low[0] + corner[0], low[1] + corner[1]],
            side,
        }
    }
}

/// Where a tree has bricks: by level and column of nodes (x fastest) the first one, and one more than the last, from below.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    levels: Vec<Vec<[u16; 2]>>,
}

impl Shape {
    pub(super) fn new(field: &Field, place: Place) -> Self {
        let depth = place.depth(field);
        let mut levels: Vec<Vec<[u16; 2]>> = (0..=depth).map(|level| own(field, place, level)).collect();
        for level in (0..depth).rev() {
            let n = 1usize << level;
            for at in 0..n * n {
                let (x, y) = (2 * (at % n), 2 * (at / n));
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let [low, high] = levels[usize::from(level) + 1][(y + dy) * 2 * n + x + dx];
                    levels[usize::from(level)][at] =
                        joined(levels[usize::from(level)][at], [low / 2, high.div_ceil(2)]);
                }
            }
        }
        Self { levels }
    }

    /// The bricks of a column of nodes, from below.
    pub(super) fn bricks(&self, level: u8, x: u32, y: u32) -> std::ops::Range<u32> {
        let [low, high] = self.levels[usize::from(level)][((y << level) + x) as usize];
        u32::from(low)..u32::from(high)
    }

    /// Bytes it takes.
    pub(super) fn bytes(&self) -> usize {
        self.levels
            .iter()
            .map(|columns| columns.len() * size_of::<[u16; 2]>())
            .sum()
    }

    /// The octree file.
    ///
    /// # Errors
    /// None for a terrain within the limits of the store.
    pub(super) fn octree(
        &self,
        field: &Field,
        place: Place,
        header: TreeHeader,
    ) -> Result<Vec<u8>, FormatError> {
        let (air, solid) = ([0; 4], deep().color);
        let mut positions = vec![UVec3::ZERO];
        let mut levels = Vec::new();
        for level in 0..=place.depth(field) {
            let mut bricks = 0;
            let nodes: Vec<Node> = positions
                .iter()
                .map(|p| {
                    let range = self.bricks(level, p.x, p.y);
                    if !range.contains(&p.z) {
                        return Node::constant(if p.z < range.start { solid } else { air });
                    }
                    bricks += 1;
                    let children = (level < header.depth).then_some(bricks - 1);
                    Node::new(children, NodeData::Brick(bricks - 1))
                })
                .collect();
            positions = child_positions(&nodes, &positions);
            levels.push(nodes);
        }
        octree_binary::encode(&Octree { header, levels })
    }

    /// The properties of the tree, its finest voxels of the terrain being this wide, metres.
    pub(super) fn header(&self, field: &Field, place: Place, voxel: f64) -> TreeHeader {
        let depth = place.depth(field);
        let voxel_size = voxel * (1u64 << place.mip(field, depth)) as f64;
        let side = BRICK_VOXELS << depth;
        let columns = &self.levels[usize::from(depth)];
        let occupied = columns.iter().filter(|c| c[0] < c[1]);
        let [low, high] = occupied
            .copied()
            .reduce(joined)
            .unwrap_or_default()
            .map(u32::from);
        TreeHeader {
            origin: DVec3::from(place.low(depth).map(|v| v as f64)) * voxel_size,
            voxel_size,
            depth,
            layout: SampleLayout::Centre,
            gain: BUILD_GAIN,
            surface_voxels: u64::from(side) * u64::from(side),
            surface_bounds: [
                UVec3::new(0, 0, low * BRICK_VOXELS),
                UVec3::new(side, side, high * BRICK_VOXELS),
            ],
        }
    }
}

/// The range over both; one that is empty adds nothing.
fn joined(a: [u16; 2], b: [u16; 2]) -> [u16; 2] {
    match (a[0] < a[1], b[0] < b[1]) {
        (true, true) => [a[0].min(b[0]), a[1].max(b[1])],
        (false, true) => b,
        _ => a,
    }
}

/// The bricks that a level's own samples need. The highest ground is below a tree's top, so what has none is air.
fn own(field: &Field, place: Place, level: u8) -> Vec<[u16; 2]> {
    let n = 1usize << level;
    let side = n * BRICK as usize + 2;
    let heights = field.heights(&place.patch(field, level, [-1, -1], side));
    let bottom = place.low(level)[2];
    let mut columns = Vec::with_capacity(n * n);
    for y in 0..n {
        for x in 0..n {
            let mut surfaces = [f32::INFINITY, f32::NEG_INFINITY];
            for row in heights
                .chunks_exact(side)
                .skip(y * BRICK as usize)
                .take(BRICK as usize + 2)
            {
                for h in &row[x * BRICK as usize..][..BRICK as usize + 2] {
                    surfaces = [surfaces[0].min(*h), surfaces[1].max(*h)];
                }
            }
            let mut range = [0u16; 2];
            for z in 0..n as u16 {
                let low = bottom + i64::from(z) * BRICK - 1;
                let (air, deep) = Field::uniform(surfaces, low, low + BRICK + 1);
                if !(air || deep) {
                    range = joined(range, [z, z + 1]);
                }
            }
            columns.push(range);
        }
    }
    columns
}
