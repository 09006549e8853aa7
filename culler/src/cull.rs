//! The culler: from a scene graph and a camera to the list of trees in view, in visibility order.
//!
//! Runs once per frame on the render thread. It goes down from the root, tests each group's children against the
//! planes their group straddles, orders what is left and goes on with the nearest; so work and memory follow what is
//! in view, not the size of the terrain. Where a group is far enough, or what is in it is not loaded yet, it ends at the
//! group's coarse trees ([`Cut`]). All scratch and the result are kept between frames: after the first frames
//! nothing is allocated. Culling twice with the same arguments gives the same result.

use crate::bounds::Aabb;
use crate::camera::Camera;
use crate::frustum::Frustum;
use crate::scene::{SceneGraph, TreeId};
use crate::sort::{Item, Sorter};
use glam::DVec3;
use walk::Walk;

/// A tree that is in view or soon may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleTree {
    /// The tree.
    pub tree: TreeId,
    /// Its half-open box, world metres.
    pub bounds: Aabb,
    /// Metres from the eye to the nearest point of the box; 0 inside.
    pub distance: f64,
    /// Of a coarse tree, how far its group lies beyond where it takes over: log2 of the footprint at the group's nearest
    /// depth over the tree's finest voxel; 0 where it only stands in for what is not loaded. `None` for other trees.
    pub beyond: Option<f64>,
}

/// Whether a tree can be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// At once.
    Ready,
    /// Once it is loaded.
    Awaited,
    /// Never: nothing has to wait for it.
    Failed,
}

/// Where groups are drawn by their coarse trees.
///
/// A group is far if the footprint is at least as wide as the finest voxels of its coarse trees, all through its box.
/// A far group is drawn by its coarse trees as soon as those are ready, another by what is inside as soon as all of that
/// that is in view is ready (a group, by its coarse trees); until then by whichever is there.
#[derive(Clone, Copy)]
pub struct Cut<'a> {
    /// Width of a pixel, metres per metre of depth along the view axis.
    pub footprint: f64,
    /// What can be drawn.
    pub readiness: &'a dyn Fn(TreeId) -> Readiness,
}

/// What one frame sees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CullResult {
    /// Trees whose box meets the frustum, front to back: no ray from the eye meets a tree later in the list before one
    /// that is earlier, if `order_exact`.
    pub visible: Vec<VisibleTree>,
    /// Trees outside of the frustum but nearer than the prefetch margin, nearest first.
    pub soon_visible: Vec<VisibleTree>,
    /// Trees that are not in `visible` but should be there for one of the next frames: coarse trees of groups in view
    /// that are drawn by what is inside, and what has to be there before groups that only wait for it are.
    pub wanted: Vec<VisibleTree>,
    /// Groups that were drawn by their coarse trees or whose children were looked at for `visible`.
    pub groups_visited: usize,
    /// Groups found outside of the frustum.
    pub groups_culled: usize,
    /// Trees found outside of the frustum; not those of culled groups, which are not counted.
    pub trees_culled: usize,
    /// Trees and groups in view that were left out because they are too small to be seen.
    pub features_culled: usize,
    /// Whether `visible` is right for every ray. False if trees overlap or hide each other in a cycle, or if more than
    /// two thousand siblings cannot be parted by planes; those are then in order of distance.
    pub order_exact: bool,
}

impl CullResult {
    fn clear(&mut self) {
        self.visible.clear();
        self.soon_visible.clear();
        self.wanted.clear();
        self.groups_visited = 0;
        self.groups_culled = 0;
        self.trees_culled = 0;
        self.features_culled = 0;
        self.order_exact = true;
    }
}

/// Finds and orders the trees in view, and remembers when each was last seen.
#[derive(Debug, Default)]
pub struct Culler {
    prefetch_margin: f64,
    smallest_feature: f64,
    /// Unit vector towards the sun whose shadows count.
    shadows: Option<DVec3>,
    /// By tree id, the last frame it was visible, or `NEVER`.
    last_access: Vec<u64>,
    /// Nodes still to be visited, nearest last.
    stack: Vec<Item>,
    children: Vec<Item>,
    ordered: Vec<Item>,
    /// Nodes outside of the frustum but within the margin, still to be visited.
    nearby: Vec<u32>,
    sorter: Sorter,
    result: CullResult,
}

const NEVER: u64 = u64::MAX;

impl Culler {
    /// A culler without a prefetch margin.
    pub fn new() -> Culler {
        Culler::default()
    }

    /// From now on trees outside of the frustum and nearer to the eye than `metres` are listed in
    /// [`CullResult::soon_visible`]. 0 turns that off.
    pub fn set_prefetch_margin(&mut self, metres: f64) {
        self.prefetch_margin = metres;
    }

    /// From now on trees and groups in view that look narrower than so many pixels, wherever in their box one looks from,
    /// are left out. Off at first, and with 0: many small trees side by side may be ground, and leaving them out a hole. For
    /// scenes of things that stand apart.
    pub fn set_smallest_feature(&mut self, pixels: f64) {
        self.smallest_feature = pixels;
    }

    /// From now on what throws a shadow into the frustum counts as in view: `sun` is the unit vector towards the sun. Shadows are taken to
    /// fall as far as the scene's lowest point. `None` turns that off.
    pub fn set_shadows(&mut self, sun: Option<DVec3>) {
        self.shadows = sun;
    }

    /// The last frame in which the tree was in [`CullResult::visible`].
    pub fn last_access(&self, tree: TreeId) -> Option<u64> {
        self.last_access
            .get(tree.0 as usize)
            .copied()
            .filter(|&frame| frame != NEVER)
    }

    /// The result of the last [`Culler::cull`].
    pub fn result(&self) -> &CullResult {
        &self.result
    }

    /// Culls and orders the trees of a scene, coarse ones left out, as [`Culler::cull_cut`] does.
    pub fn cull(&mut self, scene: &SceneGraph, camera: &Camera, frame: u64) -> &CullResult {
        let cut = Cut {
            footprint: 0.0,
            readiness: &|_| Readiness::Failed,
        };
        self.cull_cut(scene, camera, &cut, frame)
    }

    /// Culls and orders the scene for this camera, which must be the one the frame is drawn with, and stamps the
    /// visible trees with `frame`.
    pub fn cull_cut(
        &mut self,
        scene: &SceneGraph,
        camera: &Camera,
        cut: &Cut<'_>,
        frame: u64,
    ) -> &CullResult {
        let limit = scene.tree_id_limit() as usize;
        if self.last_access.len() < limit {
            self.last_access.resize(limit, NEVER);
        }
        let Culler {
            last_access,
            stack,
            children,
            ordered,
            nearby,
            sorter,
            result,
            ..
        } = self;
        result.clear();
        stack.clear();
        children.clear();
        ordered.clear();
        nearby.clear();
        let mut walk = Walk {
            scene,
            frustum: Frustum::new(camera),
            eye: camera.eye,
            forward: camera.forward,
            cut,
            margin: self.prefetch_margin,
            shadows: (self.shadows).zip(scene.bounds().map(|b| b.min.z)),
            smallest: self.smallest_feature * camera.pixel_size(),
            nearby,
            wanted: &mut result.wanted,
            groups_visited: 0,
            groups_culled: 0,
            trees_culled: 0,
            features_culled: 0,
        };
        walk.look_at(0, walk.frustum.full_mask(), None, stack);
        while let Some(item) = stack.pop() {
            if walk.expand(&item, children) {
                result.order_exact &=
                    sorter.sort(children, camera.eye, ordered, |item, out| walk.expand(item, out));
                stack.extend(ordered.drain(..).rev());
            } else {
                let tree = TreeId(scene.nodes()[item.node as usize].id);
                result.visible.push(VisibleTree {
                    tree,
                    bounds: item.bounds,
                    distance: item.distance,
                    beyond: item.beyond,
                });
                if let Some(stamp) = last_access.get_mut(tree.0 as usize) {
                    *stamp = frame;
                }
            }
        }
        walk.collect_nearby(&mut result.soon_visible);
        result.groups_visited = walk.groups_visited;
        result.groups_culled = walk.groups_culled;
        result.trees_culled = walk.trees_culled;
        result.features_culled = walk.features_culled;
        result
    }

    /// Elements that fit without another allocation, over all scratch and the result: a frame after which it is what it was
    /// before has allocated nothing (`tests/allocations.rs` counts).
    pub fn capacity(&self) -> usize {
        self.last_access.capacity()
            + self.stack.capacity()
            + self.children.capacity()
            + self.ordered.capacity()
            + self.nearby.capacity()
            + self.sorter.capacity()
            + self.result.visible.capacity()
            + self.result.soon_visible.capacity()
            + self.result.wanted.capacity()
    }
}

#[cfg(test)]
mod cut_tests;
#[cfg(test)]
mod order_tests;
#[cfg(test)]
mod tests;
mod walk;
