//! What is in a tree, by its files: the box that a scene gives it, on the lattice of root voxels.
//!
//! Coarse levels show what lies in a neighbour, too, as far as they interpolate beyond the border, and finest levels what coarse
//! samples have lost. So levels whose nodes are larger than a root voxel are looked at sample by sample, the first one
//! that is not by its nodes. Called from the thread that writes the scene.

use std::fs;
use std::path::Path;

use brickfell_formats::bricks::{self, BrickIndex, brick_file_name};
use brickfell_formats::chunk::Chunk;
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::{NodeData, octant_offset};
use brickfell_formats::octree_binary;
use brickfell_formats::scene::Bounds;
use glam::{DVec3, UVec3};

use super::error::BuildError;

/// The level whose nodes are as large as a voxel of the root.
const NODE_LEVEL: u8 = BRICK_VOXELS.ilog2() as u8;

/// A box in root voxels, low corner and exclusive high corner; empty if they are not in order.
#[derive(Clone, Copy)]
struct Extent([UVec3; 2]);

impl Extent {
    const NOTHING: Self = Self([UVec3::MAX, UVec3::ZERO]);

    fn with(self, [low, high]: [UVec3; 2]) -> Self {
        Self([self.0[0].min(low), self.0[1].max(high)])
    }
}

/// The box of what is in a tree.
///
/// # Errors
/// If its files cannot be read or are damaged.
pub(crate) fn content(path: &Path) -> Result<Bounds, BuildError> {
    let format = BuildError::format(path);
    let bytes = fs::read(path).map_err(BuildError::io(path))?;
    let tree = octree_binary::decode(&bytes).map_err(format)?;
    let header = tree.header;
    let mut extent = Extent::NOTHING;
    let mut places = vec![UVec3::ZERO];
    for (level, nodes) in (0..=NODE_LEVEL).zip(&tree.levels) {
        let side = BRICK_VOXELS >> level;
        let mut below = Vec::new();
        let mut bricks = Vec::new();
        for (node, place) in nodes.iter().zip(places) {
            match node.data() {
                NodeData::Constant([_, _, _, 0]) => {}
                NodeData::Brick(_) if level < NODE_LEVEL => bricks.push(place),
                _ => extent = extent.with([place * side, (place + 1) * side]),
            }
            if node.children().is_some() {
                below.extend((0..8).map(|o| place * 2 + octant_offset(o)));
            }
        }
        if !bricks.is_empty() {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let file = path.with_file_name(brick_file_name(&name, level));
            extent = samples(&file, level, &bricks, extent)?;
        }
        places = below;
    }
    let Extent([low, high]) = extent;
    let low = low.min(high);
    let voxel = header.level_voxel_size(0);
    let [min, max] = [low, high].map(|p| header.origin + p.as_dvec3() * voxel);
    Ok(Bounds { min, max })
}

/// An extent, and all that interpolation shows of the bricks of a level in a file. `places` are its nodes, in Morton order.
fn samples(file: &Path, level: u8, places: &[UVec3], extent: Extent) -> Result<Extent, BuildError> {
    let bytes = fs::read(file).map_err(BuildError::io(file))?;
    let header = bricks::decode_header(&bytes, bytes.len() as u64).map_err(BuildError::format(file))?;
    let part = |from: u64, to: u64| bytes.get(from as usize..to as usize).unwrap_or_default();
    let directory = header.directory();
    let index = header
        .decode_directory(part(directory.start, directory.end))
        .map_err(BuildError::format(file))?;
    let decode = |k: usize, index: &BrickIndex| {
        let entry = &index.chunks[k];
        index.decode_chunk(
            k as u32,
            part(entry.offset, entry.offset + u64::from(entry.length)),
        )
    };
    let mut places = places.iter();
    let mut extent = extent;
    for k in 0..index.chunks.len() {
        let chunk = decode(k, &index).map_err(BuildError::format(file))?;
        for (brick, place) in (0..chunk.bricks()).zip(&mut places) {
            if let Some(shown) = shown(&chunk, brick, *place, level) {
                extent = extent.with(shown);
            }
        }
    }
    Ok(extent)
}

/// The root voxels in which a brick shows anything, if there are any.
fn shown(chunk: &Chunk, brick: usize, place: UVec3, level: u8) -> Option<[UVec3; 2]> {
    let layout: SampleLayout = chunk.layout;
    let side = layout.side();
    let at = |k: u32| UVec3::new(k % side, k / side % side, k / side / side);
    let filled = (0..).zip(chunk.brick_color(brick)).filter(|(_, c)| c[3] > 0);
    let (first, last) = filled
        .map(|(k, _)| (at(k), at(k)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    // From a sample to the next one on each side, in voxels of the level from the node's low corner.
    let offset = layout.sample_offset() - f64::from(layout.low_apron());
    let voxels = [first.as_dvec3() - 1.0, last.as_dvec3() + 1.0].map(|p| p + offset);
    let per_root = f64::from(1u32 << level);
    let node = place.as_dvec3() * f64::from(BRICK_VOXELS);
    let [low, high] = voxels.map(|p| (node + p.clamp(DVec3::ZERO, DVec3::splat(8.0))) / per_root);
    Some([low.floor().as_uvec3(), high.ceil().as_uvec3()])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A brick with a single sample that is not empty.
    fn lone(layout: SampleLayout, at: UVec3) -> Chunk {
        let side = layout.side();
        let mut color = vec![[0; 4]; layout.samples()];
        color[((at.z * side + at.y) * side + at.x) as usize] = [9, 9, 9, 9];
        Chunk {
            mask: 1,
            layout,
            normal: vec![[0; 4]; color.len()],
            opacity: Vec::new(),
            color,
        }
    }

    #[test]
    fn a_sample_shows_up_to_its_neighbours() {
        let shows = |layout, at: [u32; 3], place: [u32; 3], level| {
            let chunk = lone(layout, UVec3::from_array(at));
            shown(&chunk, 0, UVec3::from_array(place), level).map(|b| b.map(|p| p.to_array()))
        };
        // The apron of the root reaches half a voxel in.
        let centre = SampleLayout::Centre;
        assert_eq!(shows(centre, [0, 5, 9], [0; 3], 0), Some([[0, 3, 7], [1, 6, 8]]));
        assert_eq!(
            shows(SampleLayout::Corner, [0, 4, 8], [0; 3], 0),
            Some([[0, 3, 7], [1, 5, 8]])
        );
        // Voxels 1 to 4 of the second of four nodes are in its first and second root voxels.
        assert_eq!(shows(centre, [3, 3, 3], [1, 1, 1], 2), Some([[2; 3], [3; 3]]));
        let empty = Chunk {
            color: vec![[0; 4]; centre.samples()],
            ..lone(centre, UVec3::ZERO)
        };
        assert!(shown(&empty, 0, UVec3::ZERO, 0).is_none());
    }
}
