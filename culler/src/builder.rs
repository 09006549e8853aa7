//! Gathers a scene graph and lays it out.
//!
//! Used by whoever reads a scene file, on any thread, once per scene. What is refused is named and leaves the builder
//! as it was. Laying out needs no call stack, however deep the groups nest.

use crate::bounds::{Aabb, BoundsError};
use crate::order::sweep_overlaps;
use crate::scene::{Coarse, GroupId, Node, NodeKind, SceneGraph, TreeId};
use glam::DVec3;
use std::collections::HashSet;
use thiserror::Error;

/// Why a node was not added. The builder stays as it was, so the caller may skip the node and go on.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SceneError {
    /// The tree's box is not finite or is inverted.
    #[error("tree {} in group {}: {source}", .tree.0, .parent.0)]
    Bounds {
        /// The tree refused.
        tree: TreeId,
        /// The group it was to be added to.
        parent: GroupId,
        /// What is wrong with the box.
        source: BoundsError,
    },
    /// A tree with this id is already there.
    #[error("tree {} is in the scene twice", .0.0)]
    DuplicateTree(TreeId),
    /// The id is not below [`TreeId::LIMIT`].
    #[error("tree id {} is not below {}", .0.0, TreeId::LIMIT)]
    TreeIdTooLarge(TreeId),
    /// The finest voxel of a coarse tree is not finite and above zero.
    #[error("coarse tree {} has voxels of {voxel} m", .tree.0)]
    Voxel {
        /// The tree refused.
        tree: TreeId,
        /// Its voxel.
        voxel: f64,
    },
    /// There is no such group yet.
    #[error("there is no group {}", .0.0)]
    UnknownGroup(GroupId),
    /// More nodes than 32-bit indices can tell apart.
    #[error("the scene has too many nodes")]
    TooManyNodes,
}

/// Gathers groups and trees; parents before children.
#[derive(Debug)]
pub struct SceneBuilder {
    /// Children of each group in order of addition.
    children: Vec<Vec<Child>>,
    /// Coarse trees of each group in order of addition, with their finest voxels.
    coarse: Vec<Vec<(TreeId, Aabb, f64)>>,
    trees: HashSet<TreeId>,
}

#[derive(Clone, Copy, Debug)]
enum Child {
    Group(GroupId),
    Tree(TreeId, Aabb),
}

impl SceneBuilder {
    pub(crate) fn new() -> SceneBuilder {
        SceneBuilder {
            children: vec![Vec::new()],
            coarse: vec![Vec::new()],
            trees: HashSet::new(),
        }
    }

    /// Adds a group under `parent`, or under the root.
    ///
    /// # Errors
    /// [`SceneError::UnknownGroup`] or [`SceneError::TooManyNodes`].
    pub fn add_group(&mut self, parent: Option<GroupId>) -> Result<GroupId, SceneError> {
        let parent = self.parent(parent)?;
        let id = GroupId(self.children.len() as u32);
        self.children.push(Vec::new());
        self.coarse.push(Vec::new());
        self.children[parent.0 as usize].push(Child::Group(id));
        Ok(id)
    }

    /// Adds a tree under `parent`, or under the root, with its half-open box in world metres.
    ///
    /// # Errors
    /// [`SceneError`] naming the tree if its box or id is bad, or if the group is unknown.
    pub fn add_tree(
        &mut self,
        parent: Option<GroupId>,
        tree: TreeId,
        bounds: Aabb,
    ) -> Result<(), SceneError> {
        let parent = self.claim(parent, tree, &bounds)?;
        self.children[parent.0 as usize].push(Child::Tree(tree, bounds));
        Ok(())
    }

    /// Adds a coarse tree to a group, with its half-open box and the side of its finest voxels in world metres. All of a
    /// group's together stand for what is in it.
    ///
    /// # Errors
    /// [`SceneError`] naming the tree if its box, voxel or id is bad, or if the group is unknown.
    pub fn add_coarse(
        &mut self,
        group: GroupId,
        tree: TreeId,
        bounds: Aabb,
        voxel: f64,
    ) -> Result<(), SceneError> {
        if !(voxel.is_finite() && voxel > 0.0) {
            return Err(SceneError::Voxel { tree, voxel });
        }
        let group = self.claim(Some(group), tree, &bounds)?;
        self.coarse[group.0 as usize].push((tree, bounds, voxel));
        Ok(())
    }

    /// Checks a tree of any kind and takes its id.
    fn claim(&mut self, parent: Option<GroupId>, tree: TreeId, bounds: &Aabb) -> Result<GroupId, SceneError> {
        let parent = self.parent(parent)?;
        bounds
            .validate()
            .map_err(|source| SceneError::Bounds { tree, parent, source })?;
        if tree.0 >= TreeId::LIMIT {
            return Err(SceneError::TreeIdTooLarge(tree));
        }
        if !self.trees.insert(tree) {
            return Err(SceneError::DuplicateTree(tree));
        }
        Ok(parent)
    }

    /// Lays the nodes out and computes each group's bounds and whether its children are pairwise disjoint.
    pub fn finish(self) -> SceneGraph {
        let group = |id: GroupId| Node {
            bounds: Aabb {
                min: DVec3::ZERO,
                max: DVec3::ZERO,
            },
            id: id.0,
            empty: true,
            kind: NodeKind::Group {
                first: 0,
                count: 0,
                disjoint: true,
                coarse: Coarse::default(),
            },
        };
        let leaf = |id: TreeId, bounds: Aabb, kind: NodeKind| Node {
            bounds,
            id: id.0,
            empty: bounds.is_empty(),
            kind,
        };
        let mut nodes = vec![group(GroupId::ROOT)];
        let mut at = 0;
        while at < nodes.len() {
            let node = nodes[at];
            if let NodeKind::Group { .. } = node.kind {
                let first = nodes.len() as u32;
                let children = &self.children[node.id as usize];
                nodes.extend(children.iter().map(|child| match *child {
                    Child::Group(id) => group(id),
                    Child::Tree(id, bounds) => leaf(id, bounds, NodeKind::Tree),
                }));
                let coarse = &self.coarse[node.id as usize];
                nodes.extend((coarse.iter()).map(|(id, bounds, _)| leaf(*id, *bounds, NodeKind::Coarse)));
                nodes[at].kind = NodeKind::Group {
                    first,
                    count: children.len() as u32,
                    disjoint: true,
                    coarse: Coarse {
                        count: coarse.len() as u32,
                        voxel: coarse.iter().map(|c| c.2).fold(0.0, f64::max),
                    },
                };
            }
            at += 1;
        }
        // Children have larger indices than their parents: backwards is bottom-up, however deep the nesting.
        for at in (0..nodes.len()).rev() {
            if let NodeKind::Group {
                first, count, coarse, ..
            } = nodes[at].kind
            {
                let boxes = |first: u32, count: u32| {
                    let nodes = &nodes[first as usize..(first + count) as usize];
                    let full = nodes.iter().filter(|node| !node.empty);
                    full.map(|node| node.bounds).collect::<Vec<Aabb>>()
                };
                let (mut children, coarse_boxes) = (boxes(first, count), boxes(first + count, coarse.count));
                let mut disjoint = true;
                sweep_overlaps(&children, |_, _| {
                    disjoint = false;
                    false
                });
                nodes[at].kind = NodeKind::Group {
                    first,
                    count,
                    disjoint,
                    coarse,
                };
                children.extend(coarse_boxes);
                if let Some(bounds) = children.into_iter().reduce(|a, b| a.union(&b)) {
                    nodes[at].bounds = bounds;
                    nodes[at].empty = false;
                }
            }
        }
        let tree_id_limit = self.trees.iter().map(|tree| tree.0 + 1).max().unwrap_or(0);
        SceneGraph::from_parts(nodes, tree_id_limit)
    }

    fn parent(&self, parent: Option<GroupId>) -> Result<GroupId, SceneError> {
        let parent = parent.unwrap_or(GroupId::ROOT);
        if parent.0 as usize >= self.children.len() {
            return Err(SceneError::UnknownGroup(parent));
        }
        if self.children.len() + self.trees.len() >= u32::MAX as usize {
            return Err(SceneError::TooManyNodes);
        }
        Ok(parent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn cube(x: f64, y: f64, z: f64) -> Aabb {
        Aabb::new(dvec3(x, y, z), dvec3(x + 1.0, y + 1.0, z + 1.0)).unwrap()
    }

    #[test]
    fn bad_nodes_are_named_and_leave_the_builder_usable() {
        let mut builder = SceneGraph::builder();
        let group = builder.add_group(None).unwrap();
        let nan = Aabb {
            min: dvec3(0.0, f64::NAN, 0.0),
            max: DVec3::ONE,
        };
        let error = builder.add_tree(Some(group), TreeId(42), nan).unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("tree 42 in group 1: bounds are not finite"),
            "{error}"
        );
        let inverted = Aabb {
            min: DVec3::ONE,
            max: DVec3::ZERO,
        };
        assert!(matches!(
            builder.add_tree(None, TreeId(42), inverted),
            Err(SceneError::Bounds { .. })
        ));
        builder.add_tree(None, TreeId(42), cube(0.0, 0.0, 0.0)).unwrap();
        let twice = builder.add_tree(None, TreeId(42), cube(3.0, 0.0, 0.0));
        assert_eq!(twice, Err(SceneError::DuplicateTree(TreeId(42))));
        let far = TreeId(TreeId::LIMIT);
        assert_eq!(
            builder.add_tree(None, far, cube(3.0, 0.0, 0.0)),
            Err(SceneError::TreeIdTooLarge(far))
        );
        assert_eq!(
            builder.add_group(Some(GroupId(9))),
            Err(SceneError::UnknownGroup(GroupId(9)))
        );
        assert_eq!(builder.finish().len(), 1);
    }

    #[test]
    fn empty_boxes_and_groups_have_no_bounds() {
        assert!(SceneGraph::builder().finish().bounds().is_none());
        let mut builder = SceneGraph::builder();
        let group = builder.add_group(None).unwrap();
        let flat = Aabb::new(dvec3(100.0, 0.0, 0.0), dvec3(101.0, 1.0, 0.0)).unwrap();
        builder.add_tree(Some(group), TreeId(0), flat).unwrap();
        builder.add_tree(None, TreeId(1), cube(0.0, 0.0, 0.0)).unwrap();
        let scene = builder.finish();
        assert_eq!(scene.bounds(), Some(cube(0.0, 0.0, 0.0)));
        assert_eq!(scene.len(), 2);
    }
}
