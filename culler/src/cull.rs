//! The culler: from a scene graph and a camera to the list of trees in view, in visibility order.
//!
//! Runs once per frame on the render thread. It goes down from the root, tests each group's children against the
//! planes their group straddles, orders what is left and goes on with the nearest; so work and memory follow what is
//! in view, not the size of the terrain. Where a group is far enough, or what is in it is not loaded yet, it ends at the
//! group's coarse trees ([`Cut`]). All scratch and the result are kept between frames: after the first frames
//! nothing is allocated. Culling twice with the same arguments gives the same result.

use crate::bounds::Aabb;
use crate::camera::Camera;
use crate::frustum::{Containment, Frustum, PlaneMask};
use crate::scene::{Node, NodeKind, SceneGraph, TreeId};
use crate::sort::{Item, Sorter};
use glam::DVec3;

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

/// What the way down through the scene needs to know.
struct Walk<'a> {
    scene: &'a SceneGraph,
    frustum: Frustum,
    eye: DVec3,
    forward: DVec3,
    cut: &'a Cut<'a>,
    margin: f64,
    /// Width of the smallest thing to be seen, metres per metre of depth.
    smallest: f64,
    nearby: &'a mut Vec<u32>,
    wanted: &'a mut Vec<VisibleTree>,
    groups_visited: usize,
    groups_culled: usize,
    trees_culled: usize,
    features_culled: usize,
}

impl Walk<'_> {
    /// Appends what a group is drawn by, as far as it is in view, and returns true; returns false for a tree.
    fn expand(&mut self, item: &Item, out: &mut Vec<Item>) -> bool {
        let group = &self.scene.nodes()[item.node as usize];
        let NodeKind::Group {
            first, count, coarse, ..
        } = group.kind
        else {
            return false;
        };
        self.groups_visited += 1;
        let (children, trees) = (first..first + count, first + count..first + count + coarse.count);
        let readiness = self.coarse_readiness(item.node);
        let beyond = self.beyond(group, coarse.voxel);
        if readiness == Readiness::Ready && beyond >= 0.0 {
            trees.for_each(|tree| self.look_at(tree, item.mask, Some(beyond), out));
            return true;
        }
        let before = (
            out.len(),
            self.nearby.len(),
            self.groups_culled,
            self.trees_culled,
            self.features_culled,
        );
        children.for_each(|child| self.look_at(child, item.mask, None, out));
        let complete = (out[before.0..].iter()).all(|child| self.is_available(child.node));
        let opened = match readiness {
            Readiness::Failed => return true,
            Readiness::Ready => complete,
            Readiness::Awaited => complete || beyond < 0.0,
        };
        if opened {
            trees.for_each(|tree| self.want(tree));
            return true;
        }
        if readiness == Readiness::Ready {
            for child in &out[before.0..] {
                self.want_first(child.node);
            }
        }
        out.truncate(before.0);
        self.nearby.truncate(before.1);
        (self.groups_culled, self.trees_culled, self.features_culled) = (before.2, before.3, before.4);
        trees.for_each(|tree| self.look_at(tree, item.mask, Some(beyond.max(0.0)), out));
        true
    }

    /// log2 of the footprint at a group's nearest depth over a voxel.
    fn beyond(&self, group: &Node, voxel: f64) -> f64 {
        let (nearest, _) = group.bounds.depth_range(self.eye, self.forward);
        (nearest.max(0.0) * self.cut.footprint / voxel).log2()
    }

    /// Of the coarse trees of a group together; without any they count as failed.
    fn coarse_readiness(&self, group: u32) -> Readiness {
        let mut all = Readiness::Failed;
        for tree in self.scene.coarse(group) {
            match (self.cut.readiness)(TreeId(self.scene.nodes()[tree as usize].id)) {
                Readiness::Failed => return Readiness::Failed,
                Readiness::Ready if all != Readiness::Awaited => all = Readiness::Ready,
                _ => all = Readiness::Awaited,
            }
        }
        all
    }

    /// Whether nothing of a group or tree has to be waited for before something can be drawn of it.
    fn is_available(&self, index: u32) -> bool {
        let node = &self.scene.nodes()[index as usize];
        let readiness = match node.kind {
            NodeKind::Group { .. } => self.coarse_readiness(index),
            _ => (self.cut.readiness)(TreeId(node.id)),
        };
        readiness != Readiness::Awaited
    }

    /// Wants what a group or tree can be drawn by first.
    fn want_first(&mut self, index: u32) {
        match self.scene.nodes()[index as usize].kind {
            NodeKind::Group { .. } => self.scene.coarse(index).for_each(|tree| self.want(tree)),
            _ => self.want(index),
        }
    }

    fn want(&mut self, index: u32) {
        let node = &self.scene.nodes()[index as usize];
        self.wanted.push(VisibleTree {
            tree: TreeId(node.id),
            bounds: node.bounds,
            distance: node.bounds.distance_to_point(self.eye),
            beyond: matches!(node.kind, NodeKind::Coarse).then_some(0.0),
        });
    }

    /// Appends the node if it is in view.
    fn look_at(&mut self, index: u32, mask: PlaneMask, beyond: Option<f64>, out: &mut Vec<Item>) {
        let node = &self.scene.nodes()[index as usize];
        if node.empty {
            return;
        }
        let mask = if mask.is_empty() {
            mask
        } else {
            match self.frustum.classify(&node.bounds, mask) {
                Containment::Inside => PlaneMask::NONE,
                Containment::Intersects(mask) => mask,
                Containment::Outside => {
                    match node.kind {
                        NodeKind::Tree | NodeKind::Coarse => self.trees_culled += 1,
                        NodeKind::Group { .. } => self.groups_culled += 1,
                    }
                    if self.margin > 0.0 && node.bounds.distance_to_point(self.eye) < self.margin {
                        self.nearby.push(index);
                    }
                    return;
                }
            }
        };
        if self.smallest > 0.0 && self.is_too_small(&node.bounds) {
            self.features_culled += 1;
            return;
        }
        let distance = node.bounds.distance_to_point(self.eye);
        out.push(Item {
            bounds: node.bounds,
            distance,
            node: index,
            mask,
            beyond,
        });
    }

    /// Whether a box is narrower than the smallest thing to be seen, whatever side it shows.
    fn is_too_small(&self, bounds: &Aabb) -> bool {
        let (nearest, _) = bounds.depth_range(self.eye, self.forward);
        nearest > 0.0 && bounds.size().length() < self.smallest * nearest
    }

    /// Goes down from the culled nodes within the margin to their trees within the margin, as far as groups are not far.
    fn collect_nearby(&mut self, soon: &mut Vec<VisibleTree>) {
        while let Some(index) = self.nearby.pop() {
            let node = &self.scene.nodes()[index as usize];
            let distance = node.bounds.distance_to_point(self.eye);
            if node.empty || distance >= self.margin {
                continue;
            }
            match node.kind {
                NodeKind::Tree | NodeKind::Coarse => {
                    soon.push(VisibleTree {
                        tree: TreeId(node.id),
                        bounds: node.bounds,
                        distance,
                        beyond: matches!(node.kind, NodeKind::Coarse).then_some(0.0),
                    });
                }
                NodeKind::Group {
                    first, count, coarse, ..
                } => {
                    let far = self.beyond(node, coarse.voxel) >= 0.0;
                    if far && self.coarse_readiness(index) != Readiness::Failed {
                        self.nearby.extend(self.scene.coarse(index));
                    } else {
                        self.nearby.extend(first..first + count);
                    }
                }
            }
        }
        soon.sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance).then(a.tree.cmp(&b.tree)));
    }
}

#[cfg(test)]
mod cut_tests;
#[cfg(test)]
mod order_tests;
#[cfg(test)]
mod tests;
