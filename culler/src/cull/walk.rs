//! The way down through the scene: what of a group is in view, and whether it is drawn by its coarse trees or opened.

use glam::DVec3;

use super::{Cut, Readiness, VisibleTree};
use crate::bounds::Aabb;
use crate::frustum::{Containment, Frustum, PlaneMask};
use crate::scene::{Node, NodeKind, SceneGraph, TreeId};
use crate::sort::Item;

/// Sine of the height of a sun below which shadows are no longer.
const LOWEST_SUN: f64 = 0.02;

/// What the way down through the scene needs to know.
pub(super) struct Walk<'a> {
    pub(super) scene: &'a SceneGraph,
    pub(super) frustum: Frustum,
    pub(super) eye: DVec3,
    pub(super) forward: DVec3,
    pub(super) cut: &'a Cut<'a>,
    pub(super) margin: f64,
    /// Unit vector towards the sun whose shadows count, and the height down to which they fall.
    pub(super) shadows: Option<(DVec3, f64)>,
    /// Width of the smallest thing to be seen, metres per metre of depth.
    pub(super) smallest: f64,
    pub(super) nearby: &'a mut Vec<u32>,
    pub(super) wanted: &'a mut Vec<VisibleTree>,
    pub(super) groups_visited: usize,
    pub(super) groups_culled: usize,
    pub(super) trees_culled: usize,
    pub(super) features_culled: usize,
}

impl Walk<'_> {
    /// Appends what a group is drawn by, as far as it is in view, and returns true; returns false for a tree.
    pub(super) fn expand(&mut self, item: &Item, out: &mut Vec<Item>) -> bool {
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

    /// The box that a node's shadow may reach from, the node's own if shadows do not count. That of a node inside of another one is
    /// inside of the other's.
    fn reach(&self, bounds: &Aabb) -> Aabb {
        let Some((sun, floor)) = self.shadows else {
            return *bounds;
        };
        let fall = -sun * ((bounds.max.z - floor).max(0.0) / sun.z.max(LOWEST_SUN));
        Aabb {
            min: bounds.min.min(bounds.min + fall),
            max: bounds.max.max(bounds.max + fall),
        }
    }

    /// Appends the node if it is in view.
    pub(super) fn look_at(&mut self, index: u32, mask: PlaneMask, beyond: Option<f64>, out: &mut Vec<Item>) {
        let node = &self.scene.nodes()[index as usize];
        if node.empty {
            return;
        }
        let mask = if mask.is_empty() {
            mask
        } else {
            match self.frustum.classify(&self.reach(&node.bounds), mask) {
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
    pub(super) fn collect_nearby(&mut self, soon: &mut Vec<VisibleTree>) {
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
