//! What rays see of the pages that are in RAM, and what they lack: the ray caster's descent without its light.
//!
//! A ray goes through the trees of the culler's list, front to back, voxel by voxel of the level that its footprint asks for.
//! Where that level is not there it goes on by the deepest one that is, as the kernel does, and names what it lacks: the
//! next level page of the tree, or the chunk. Chunks of coarser levels on the way to a wanted one are used, too: the pools
//! keep a brick only below its parent. Opacity is that of the nearest sample, not of eight. One thread.

use std::collections::HashMap;
use std::sync::Arc;

use brickfell_culler::{Camera, TreeId, VisibleTree};
use brickfell_formats::chunk::Chunk;
use brickfell_formats::layout::BRICK_VOXELS;
use brickfell_formats::octree::{Node, NodeData};
use brickfell_pager::{PageKey, Pager, Stop, TreeState};
use brickfell_runtime::texture_pool::priority;
use glam::{DVec3, IVec3, UVec3};

/// Transmittance below which a ray has ended.
const OPAQUE: f64 = 1.0 / 1024.0;

/// What a picture's rays found.
#[derive(Debug, Default)]
pub(super) struct Look {
    /// Rays that met something, or that could not be followed to their end.
    pub(super) hits: usize,
    /// Of those, rays that found every level they wanted.
    pub(super) sharp: usize,
    /// Rays that ended in a tree whose root is not there.
    pub(super) blind: usize,
    /// Pages used and pages lacked, with their priorities.
    pub(super) pages: HashMap<PageKey, f64>,
    /// Of those, pages lacked.
    pub(super) lacked: usize,
}

/// A tree in view.
struct Drawn {
    tree: TreeId,
    order: u32,
    state: Option<Arc<TreeState>>,
    bounds: [DVec3; 2],
    least_level: f64,
}

/// Where a ray is: the node it is in and what that shows.
struct Place<'a> {
    level: u8,
    /// In nodes of the level.
    node: UVec3,
    shown: Shown<'a>,
    is_sharp: bool,
}

enum Shown<'a> {
    Constant([u8; 4]),
    Brick(&'a Chunk, u32),
    Nothing,
}

/// Casts a ray through every pixel.
pub(super) fn look(pager: &Pager, visible: &[VisibleTree], camera: &Camera, footprint: f64) -> Look {
    let drawn: Vec<Drawn> = (0..)
        .zip(visible)
        .map(|(order, v)| {
            let state = pager.tree(v.tree).cloned();
            let depth = state.as_ref().map_or(0.0, |s| f64::from(s.root.header.depth));
            Drawn {
                tree: v.tree,
                order,
                state,
                bounds: [v.bounds.min, v.bounds.max],
                // A coarse tree has one level all over.
                least_level: v
                    .beyond
                    .map_or(f64::INFINITY, |octaves| (depth - octaves).max(0.0)),
            }
        })
        .collect();
    let mut look = Look::default();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let ray = Ray {
                pager,
                eye: camera.eye,
                direction: camera.ray(f64::from(x), f64::from(y)),
                footprint,
            };
            ray.cast(&drawn, &mut look);
        }
    }
    look.lacked = look.pages.keys().filter(|key| !is_there(pager, **key)).count();
    look
}

fn is_there(pager: &Pager, key: PageKey) -> bool {
    match key {
        PageKey::Root(tree) => pager.tree(tree).is_some(),
        PageKey::Level { tree, level } => pager.tree(tree).is_some_and(|t| t.level(level).is_some()),
        PageKey::Chunk { tree, level, chunk } => pager.chunk(tree, level, chunk).is_some(),
    }
}

struct Ray<'a> {
    pager: &'a Pager,
    eye: DVec3,
    /// Per metre of depth.
    direction: DVec3,
    footprint: f64,
}

impl Ray<'_> {
    fn cast(&self, drawn: &[Drawn], look: &mut Look) {
        let mut transmittance = 1.0;
        let (mut is_sharp, mut met) = (true, false);
        for tree in drawn {
            let Some((enter, leave)) = self.passage(&tree.bounds) else {
                continue;
            };
            let Some(state) = &tree.state else {
                // What is behind it must not be seen instead.
                look.blind += 1;
                (met, is_sharp) = (true, false);
                break;
            };
            let sharp = self.through(tree, state, enter, leave, &mut transmittance, look);
            met |= transmittance < 1.0 || !sharp;
            is_sharp &= sharp;
            if transmittance < OPAQUE {
                break;
            }
        }
        look.hits += usize::from(met);
        look.sharp += usize::from(met && is_sharp);
    }

    fn passage(&self, [low, high]: &[DVec3; 2]) -> Option<(f64, f64)> {
        let (mut enter, mut leave) = (0f64, f64::INFINITY);
        for axis in 0..3 {
            let (p, d) = (self.eye[axis], self.direction[axis]);
            if d == 0.0 {
                if p < low[axis] || p >= high[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low[axis] - p) / d, (high[axis] - p) / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter < leave).then_some((enter, leave))
    }

    /// Goes through one tree; false if it lacked something.
    fn through(
        &self,
        tree: &Drawn,
        state: &TreeState,
        enter: f64,
        leave: f64,
        transmittance: &mut f64,
        look: &mut Look,
    ) -> bool {
        let header = &state.root.header;
        let depth = header.depth;
        let (eye, direction) = (
            (self.eye - header.origin) / header.voxel_size,
            self.direction / header.voxel_size,
        );
        let last = header.side_voxels() as i32 - 1;
        let mut z = enter;
        let mut is_sharp = true;
        let mut place: Option<(u8, Place)> = None;
        // Every step crosses a plane of the lattice.
        for _ in 0..8 * header.side_voxels() {
            // A little beyond the plane, lest rounding put it before.
            let nudged = z + (leave - enter) * 1e-9;
            if nudged >= leave || *transmittance < OPAQUE {
                break;
            }
            let cell = (eye + direction * nudged)
                .floor()
                .as_ivec3()
                .clamp(IVec3::ZERO, IVec3::splat(last))
                .as_uvec3();
            let pixel = (z * self.footprint).max(f64::MIN_POSITIVE);
            let octaves = (header.level_voxel_size(0) / pixel)
                .log2()
                .clamp(0.0, f64::from(depth));
            let wanted = octaves.min(tree.least_level).ceil() as u8;
            let is_same = place.as_ref().is_some_and(|(for_level, p)| {
                *for_level == wanted && cell >> (u32::from(depth - p.level) + BRICK_VOXELS.ilog2()) == p.node
            });
            if !is_same {
                let found = self.descend(tree, state, wanted, cell, look);
                is_sharp &= found.is_sharp;
                place = Some((wanted, found));
            }
            let Some((_, place)) = &place else { break };
            let voxel_log2 = u32::from(depth - place.level);
            let (opacity, exit_log2) = match &place.shown {
                Shown::Nothing => return false,
                Shown::Constant(color) => (color[3], voxel_log2 + BRICK_VOXELS.ilog2()),
                Shown::Brick(chunk, local) => {
                    let side = chunk.layout.side();
                    let at = (cell >> voxel_log2) - place.node * BRICK_VOXELS + chunk.layout.low_apron();
                    let sample = (at.z * side + at.y) * side + at.x;
                    (chunk.brick_color(*local as usize)[sample as usize][3], voxel_log2)
                }
            };
            let box_low = (cell >> exit_log2 << exit_log2).as_dvec3();
            let exit = box_exit(eye, direction, box_low, f64::from(1u32 << exit_log2)).clamp(z, leave);
            if opacity > 0 {
                let opacity = (f64::from(opacity) / 255.0 * f64::from(header.gain)).min(1.0 - OPAQUE / 2.0);
                let voxels = (exit - z) * direction.length() / f64::from(1u32 << voxel_log2);
                *transmittance *= (1.0 - opacity).powf(voxels);
            }
            z = exit;
        }
        is_sharp
    }

    /// Finds what is shown where the ray is, and notes what is used and what is lacked.
    fn descend<'t>(
        &'t self,
        tree: &Drawn,
        state: &'t TreeState,
        wanted: u8,
        cell: UVec3,
        look: &mut Look,
    ) -> Place<'t> {
        let depth = state.root.header.depth;
        let nodes_log2 = |level: u8| u32::from(depth - level) + BRICK_VOXELS.ilog2();
        let found = state.find(wanted, cell >> nodes_log2(wanted));
        let mut shown = (0, Shown::Nothing);
        let mut is_sharp = true;
        for (level, index) in found.path() {
            let node: Option<Node> = state
                .level(level)
                .and_then(|page| page.nodes.get(index as usize).copied());
            let Some(node) = node else { break };
            match node.data() {
                NodeData::Constant(color) => (shown, is_sharp) = ((level, Shown::Constant(color)), true),
                NodeData::Brick(brick) => {
                    let bricks = state.level(level).and_then(|page| page.bricks.as_ref());
                    let Some((number, local)) = bricks.and_then(|b| b.locate(brick)) else {
                        break;
                    };
                    let key = PageKey::Chunk {
                        tree: tree.tree,
                        level,
                        chunk: number,
                    };
                    look.pages.entry(key).or_insert(priority(level, tree.order));
                    let chunk = self.pager.chunk(tree.tree, level, number);
                    match chunk.and_then(|page| page.samples()) {
                        Some(chunk) => (shown, is_sharp) = ((level, Shown::Brick(chunk, local)), true),
                        None => is_sharp = self.pager.is_failed(key),
                    }
                }
            }
        }
        if let (Stop::NotResident, Some((level, _))) = (found.stop, found.deepest()) {
            let key = PageKey::Level {
                tree: tree.tree,
                level: level + 1,
            };
            look.pages.entry(key).or_insert(priority(level + 1, tree.order));
            is_sharp = self.pager.is_failed(key);
        }
        let (level, shown) = shown;
        Place {
            level,
            node: cell >> nodes_log2(level),
            shown,
            is_sharp,
        }
    }
}

/// Depth at which a ray leaves a cube.
fn box_exit(eye: DVec3, direction: DVec3, low: DVec3, side: f64) -> f64 {
    (0..3)
        .filter(|axis| direction[*axis] != 0.0)
        .map(|axis| {
            let plane = low[axis] + if direction[axis] > 0.0 { side } else { 0.0 };
            (plane - eye[axis]) / direction[axis]
        })
        .fold(f64::INFINITY, f64::min)
}
