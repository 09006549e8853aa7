//! A tree as the kernel is told of it: small f32 numbers near the eye, worked out in f64 each frame. Called by the render
//! thread.

use brickfell_culler::{Aabb, Camera};
use brickfell_formats::octree::TreeHeader;
use brickfell_shaders::layout;
use glam::DVec3;

/// Largest cell that a tree's record may name, so that sums of cells fit 32 bits and most are exact as f32; the rest of what
/// lies farther out is in the base.
const FARTHEST_CELL: f64 = (1u32 << 24) as f64;

/// A tree as the kernel sees it: everything relative to the depth where it begins, worked out in f64. Of the tree, what lies in
/// `bounds` is drawn.
pub(crate) fn tree_record(
    camera: &Camera,
    header: &TreeHeader,
    bounds: &Aabb,
    root: u32,
    least_level: f64,
) -> layout::Tree {
    let [low, high] = header.voxels_within([bounds.min, bounds.max]);
    let [lo, hi] = [low, high].map(|p| header.origin + p.as_dvec3() * header.voxel_size);
    // Depth is linear, so its least value over the box is reached at a corner.
    let nearest = DVec3::select(camera.forward.cmpgt(DVec3::ZERO), lo, hi);
    let depth0 = (nearest - camera.eye).dot(camera.forward).max(0.0);
    let inv_voxel = 1.0 / header.voxel_size;
    let scale = depth0 * inv_voxel;
    let base = on_lattice((camera.eye + camera.forward * depth0) * inv_voxel)
        - on_lattice(header.origin * inv_voxel);
    let far = DVec3::splat(FARTHEST_CELL);
    let cell = base.floor().clamp(-far, far);
    layout::Tree {
        base: (base - cell).to_array().map(below_one),
        cell: cell.as_ivec3().to_array(),
        depth0: depth0 as f32,
        base_x: (camera.right * scale).as_vec3().to_array(),
        inv_voxel: inv_voxel as f32,
        base_y: (camera.up * scale).as_vec3().to_array(),
        log2_root_voxel: header.level_voxel_size(0).log2() as f32,
        root,
        depth: u32::from(header.depth),
        gain: f32::from(header.gain),
        texel_offset: header.layout.texel_offset() as f32,
        // The rim is given in voxels of the coarser level, twice the node's own.
        rim: (header.layout.rim() * 2.0) as u32,
        low: low.as_ivec3().to_array(),
        max_steps: 64 + 4 * header.side_voxels() as u32,
        high: high.as_ivec3().to_array(),
        least_level: least_level as f32,
    }
}

/// The least fractional level of a tree; `beyond` is [`VisibleTree::beyond`](brickfell_culler::VisibleTree::beyond). All of a coarse
/// tree has the level of its group's nearest depth: where it takes over its finest level alone is drawn, which holds the
/// samples of what is inside.
pub(crate) fn least_level(depth: u8, beyond: Option<f64>) -> f64 {
    beyond.map_or(0.0, |octaves| (f64::from(depth) - octaves).max(0.0))
}

/// Makes integers of what is one but for f64's rounding: a metre that is not a power of two has no exact number of voxels,
/// and where a tree ends its neighbour must begin.
fn on_lattice(voxels: DVec3) -> DVec3 {
    let nearest = voxels.round();
    let is_near = (voxels - nearest)
        .abs()
        .cmple(nearest.abs() * (4.0 * f64::EPSILON));
    DVec3::select(is_near, nearest, voxels)
}

/// Rounds to f32, but what is below 1 not to 1: trees that share a face must agree on which side of it a ray is.
fn below_one(x: f64) -> f32 {
    let rounded = x as f32;
    if x < 1.0 {
        rounded.min(1.0 - f32::EPSILON / 2.0)
    } else {
        rounded
    }
}
