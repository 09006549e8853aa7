//! The culler: from a scene graph and a camera to the list of trees in view, in visibility order.
//!
//! Runs once per frame on the render thread. It goes down from the root, tests each group's children against the
//! planes their group straddles, orders what is left and goes on with the nearest; so work and memory follow what is
//! in view, not the size of the terrain. All scratch and the result are kept between frames: after the first frames
//! nothing is allocated. Culling twice with the same arguments gives the same result.

use crate::bounds::Aabb;
use crate::camera::Camera;
use crate::frustum::{Containment, Frustum, PlaneMask};
use crate::scene::{NodeKind, SceneGraph, TreeId};
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
}

/// What one frame sees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CullResult {
    /// Trees whose box meets the frustum, front to back: no ray from the eye meets a tree later in the list before one
    /// that is earlier, if `order_exact`.
    pub visible: Vec<VisibleTree>,
    /// Trees outside of the frustum but nearer than the prefetch margin, nearest first.
    pub soon_visible: Vec<VisibleTree>,
    /// Groups whose children were looked at for `visible`.
    pub groups_visited: usize,
    /// Groups found outside of the frustum.
    pub groups_culled: usize,
    /// Trees found outside of the frustum; not those of culled groups, which are not counted.
    pub trees_culled: usize,
    /// Whether `visible` is right for every ray. False if trees overlap or hide each other in a cycle, or if more than
    /// two thousand siblings cannot be parted by planes; those are then in order of distance.
    pub order_exact: bool,
}

impl CullResult {
    fn clear(&mut self) {
        self.visible.clear();
        self.soon_visible.clear();
        self.groups_visited = 0;
        self.groups_culled = 0;
        self.trees_culled = 0;
        self.order_exact = true;
    }
}

/// Finds and orders the trees in view, and remembers when each was last seen.
#[derive(Debug, Default)]
pub struct Culler {
    prefetch_margin: f64,
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

    /// Culls and orders the scene for this camera, which must be the one the frame is drawn with, and stamps the
    /// visible trees with `frame`.
    pub fn cull(&mut self, scene: &SceneGraph, camera: &Camera, frame: u64) -> &CullResult {
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
            margin: self.prefetch_margin,
            nearby,
            groups_visited: 0,
            groups_culled: 0,
            trees_culled: 0,
        };
        walk.look_at(0, walk.frustum.full_mask(), stack);
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
        result
    }

    /// Elements that fit without another allocation.
    #[cfg(test)]
    fn capacity(&self) -> usize {
        self.last_access.capacity()
            + self.stack.capacity()
            + self.children.capacity()
            + self.ordered.capacity()
            + self.nearby.capacity()
            + self.sorter.capacity()
            + self.result.visible.capacity()
            + self.result.soon_visible.capacity()
    }
}

/// What the way down through the scene needs to know.
struct Walk<'a> {
    scene: &'a SceneGraph,
    frustum: Frustum,
    eye: DVec3,
    margin: f64,
    nearby: &'a mut Vec<u32>,
    groups_visited: usize,
    groups_culled: usize,
    trees_culled: usize,
}

impl Walk<'_> {
    /// Appends the children of a group that are in view and returns true; returns false for a tree.
    fn expand(&mut self, item: &Item, out: &mut Vec<Item>) -> bool {
        let NodeKind::Group { first, count, .. } = self.scene.nodes()[item.node as usize].kind else {
            return false;
        };
        self.groups_visited += 1;
        for child in first..first + count {
            self.look_at(child, item.mask, out);
        }
        true
    }

    /// Appends the node if it is in view.
    fn look_at(&mut self, index: u32, mask: PlaneMask, out: &mut Vec<Item>) {
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
                        NodeKind::Tree => self.trees_culled += 1,
                        NodeKind::Group { .. } => self.groups_culled += 1,
                    }
                    if self.margin > 0.0 && node.bounds.distance_to_point(self.eye) < self.margin {
                        self.nearby.push(index);
                    }
                    return;
                }
            }
        };
        let distance = node.bounds.distance_to_point(self.eye);
        out.push(Item {
            bounds: node.bounds,
            distance,
            node: index,
            mask,
        });
    }

    /// Goes down from the culled nodes within the margin to their trees within the margin.
    fn collect_nearby(&mut self, soon: &mut Vec<VisibleTree>) {
        while let Some(index) = self.nearby.pop() {
            let node = &self.scene.nodes()[index as usize];
            let distance = node.bounds.distance_to_point(self.eye);
            if node.empty || distance >= self.margin {
                continue;
            }
            match node.kind {
                NodeKind::Tree => {
                    soon.push(VisibleTree {
                        tree: TreeId(node.id),
                        bounds: node.bounds,
                        distance,
                    });
                }
                NodeKind::Group { first, count, .. } => self.nearby.extend(first..first + count),
            }
        }
        soon.sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance).then(a.tree.cmp(&b.tree)));
    }
}

#[cfg(test)]
mod order_tests;
#[cfg(test)]
mod tests;
