//! The scene graph: nested groups over paged trees, as one flat array.
//!
//! Built once from what the scene file says, then only read: the render thread culls while other threads may look at
//! it through a shared reference. Nodes lie breadth-first, so the children of a group are neighbours in memory and
//! every child has a larger index than its parent. There is always a root group, [`GroupId::ROOT`].
//!
//! Invariants: bounds are finite; a group's bounds are the union of its non-empty children; a tree with a box of zero
//! volume owns no point (boxes are half-open) and counts for no bounds and is never visible, but is still visited.

use crate::bounds::{Aabb, BoundsError};
use crate::order::sweep_overlaps;
use glam::DVec3;
use std::collections::HashSet;
use thiserror::Error;

/// Names a tree; chosen by the caller, who keeps tables by it. Best dense from 0, and below [`TreeId::LIMIT`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TreeId(pub u32);

impl TreeId {
    /// Ids from here on are refused, because tables are as long as the largest id.
    pub const LIMIT: u32 = 1 << 24;
}

/// Names a group, in order of addition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GroupId(pub u32);

impl GroupId {
    /// The group that holds whatever was added without a parent.
    pub const ROOT: GroupId = GroupId(0);
}

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
    /// There is no such group yet.
    #[error("there is no group {}", .0.0)]
    UnknownGroup(GroupId),
    /// More nodes than 32-bit indices can tell apart.
    #[error("the scene has too many nodes")]
    TooManyNodes,
}

/// One node of the flat array.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    /// Box of the tree, or union over the group; meaningless if `empty`.
    pub(crate) bounds: Aabb,
    /// The caller's id, of the tree or of the group.
    pub(crate) id: u32,
    /// Holds no point: never to be visited by the culler.
    pub(crate) empty: bool,
    pub(crate) kind: NodeKind,
}

/// What a node is.
#[derive(Clone, Copy, Debug)]
pub(crate) enum NodeKind {
    Tree,
    Group { first: u32, count: u32, disjoint: bool },
}

/// Gathers groups and trees; parents before children.
#[derive(Debug)]
pub struct SceneBuilder {
    /// Parent of each group; the root is its own.
    parents: Vec<GroupId>,
    /// Children of each group in order of addition.
    children: Vec<Vec<Child>>,
    trees: HashSet<TreeId>,
}

#[derive(Clone, Copy, Debug)]
enum Child {
    Group(GroupId),
    Tree(TreeId, Aabb),
}

impl SceneBuilder {
    /// Adds a group under `parent`, or under the root.
    ///
    /// # Errors
    /// [`SceneError::UnknownGroup`] or [`SceneError::TooManyNodes`].
    pub fn add_group(&mut self, parent: Option<GroupId>) -> Result<GroupId, SceneError> {
        let parent = self.parent(parent)?;
        let id = GroupId(self.parents.len() as u32);
        self.parents.push(parent);
        self.children.push(Vec::new());
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
        self.children[parent.0 as usize].push(Child::Tree(tree, bounds));
        Ok(())
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
            },
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
                    Child::Tree(id, bounds) => Node {
                        bounds,
                        id: id.0,
                        empty: bounds.is_empty(),
                        kind: NodeKind::Tree,
                    },
                }));
                let count = children.len() as u32;
                nodes[at].kind = NodeKind::Group {
                    first,
                    count,
                    disjoint: true,
                };
            }
            at += 1;
        }
        // Children have larger indices than their parents: backwards is bottom-up, however deep the nesting.
        for at in (0..nodes.len()).rev() {
            if let NodeKind::Group { first, count, .. } = nodes[at].kind {
                let children = &nodes[first as usize..(first + count) as usize];
                let boxes: Vec<Aabb> = children.iter().filter(|n| !n.empty).map(|n| n.bounds).collect();
                let mut disjoint = true;
                sweep_overlaps(&boxes, |_, _| {
                    disjoint = false;
                    false
                });
                nodes[at].kind = NodeKind::Group {
                    first,
                    count,
                    disjoint,
                };
                if let Some(bounds) = boxes.into_iter().reduce(|a, b| a.union(&b)) {
                    nodes[at].bounds = bounds;
                    nodes[at].empty = false;
                }
            }
        }
        let tree_id_limit = self.trees.iter().map(|tree| tree.0 + 1).max().unwrap_or(0);
        SceneGraph {
            nodes,
            tree_count: self.trees.len(),
            tree_id_limit,
        }
    }

    fn parent(&self, parent: Option<GroupId>) -> Result<GroupId, SceneError> {
        let parent = parent.unwrap_or(GroupId::ROOT);
        if parent.0 as usize >= self.parents.len() {
            return Err(SceneError::UnknownGroup(parent));
        }
        if self.parents.len() + self.trees.len() >= u32::MAX as usize {
            return Err(SceneError::TooManyNodes);
        }
        Ok(parent)
    }
}

/// Groups and trees with their bounds, read-only.
#[derive(Clone, Debug)]
pub struct SceneGraph {
    nodes: Vec<Node>,
    tree_count: usize,
    tree_id_limit: u32,
}

/// What a visitor is told about a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupInfo {
    /// The group.
    pub id: GroupId,
    /// Union of the boxes below it; `None` if they hold no point.
    pub bounds: Option<Aabb>,
    /// Groups above it; 0 for the root.
    pub depth: u32,
    /// Number of direct children.
    pub children: u32,
    /// Whether no two children's boxes share a point.
    pub children_disjoint: bool,
}

/// Whether a traversal goes below a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descend {
    /// Visit the children.
    Yes,
    /// Leave this group out.
    No,
}

/// Something carried through the whole graph, depth first and in order of addition.
///
/// For walks that see every node (printing, statistics, expiry). Culling depends on the eye's place for its order and
/// walks on its own: [`Culler`](crate::Culler).
pub trait Visitor {
    /// Called on each group before its children.
    fn enter_group(&mut self, group: &GroupInfo) -> Descend;
    /// Called on each tree.
    fn visit_tree(&mut self, tree: TreeId, bounds: &Aabb);
}

impl SceneGraph {
    /// An empty builder.
    pub fn builder() -> SceneBuilder {
        SceneBuilder {
            parents: vec![GroupId::ROOT],
            children: vec![Vec::new()],
            trees: HashSet::new(),
        }
    }

    /// Number of trees, those with empty boxes included.
    pub fn len(&self) -> usize {
        self.tree_count
    }

    /// Whether there is no tree.
    pub fn is_empty(&self) -> bool {
        self.tree_count == 0
    }

    /// Number of groups, the root included.
    pub fn group_count(&self) -> usize {
        self.nodes.len() - self.tree_count
    }

    /// One more than the largest tree id, 0 for an empty scene: the length of a table by tree id.
    pub fn tree_id_limit(&self) -> u32 {
        self.tree_id_limit
    }

    /// The box around all trees; `None` if no tree holds a point.
    pub fn bounds(&self) -> Option<Aabb> {
        self.nodes
            .first()
            .filter(|root| !root.empty)
            .map(|root| root.bounds)
    }

    /// All trees with their boxes, level by level of the nesting.
    pub fn trees(&self) -> impl Iterator<Item = (TreeId, Aabb)> + '_ {
        self.nodes
            .iter()
            .filter(|node| matches!(node.kind, NodeKind::Tree))
            .map(|node| (TreeId(node.id), node.bounds))
    }

    /// Carries `visitor` through the graph, depth first, children in order of addition.
    pub fn accept(&self, visitor: &mut impl Visitor) {
        let mut stack = vec![(0usize, 0u32)];
        while let Some((at, depth)) = stack.pop() {
            let node = &self.nodes[at];
            match node.kind {
                NodeKind::Tree => visitor.visit_tree(TreeId(node.id), &node.bounds),
                NodeKind::Group {
                    first,
                    count,
                    disjoint,
                } => {
                    let info = GroupInfo {
                        id: GroupId(node.id),
                        bounds: (!node.empty).then_some(node.bounds),
                        depth,
                        children: count,
                        children_disjoint: disjoint,
                    };
                    if visitor.enter_group(&info) == Descend::Yes {
                        stack.extend(
                            (first..first + count)
                                .rev()
                                .map(|child| (child as usize, depth + 1)),
                        );
                    }
                }
            }
        }
    }

    /// The flat array; the root is first.
    pub(crate) fn nodes(&self) -> &[Node] {
        &self.nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn cube(x: f64, y: f64, z: f64) -> Aabb {
        Aabb::new(dvec3(x, y, z), dvec3(x + 1.0, y + 1.0, z + 1.0)).unwrap()
    }

    #[derive(Default)]
    struct Log {
        lines: Vec<String>,
        skip: Option<GroupId>,
    }

    impl Visitor for Log {
        fn enter_group(&mut self, group: &GroupInfo) -> Descend {
            let (id, depth, disjoint) = (group.id.0, group.depth, group.children_disjoint);
            self.lines
                .push(format!("g{id} d{depth} n{} {disjoint}", group.children));
            if self.skip == Some(group.id) {
                Descend::No
            } else {
                Descend::Yes
            }
        }
        fn visit_tree(&mut self, tree: TreeId, _: &Aabb) {
            self.lines.push(format!("t{}", tree.0));
        }
    }

    fn sample() -> SceneGraph {
        let mut builder = SceneGraph::builder();
        let a = builder.add_group(None).unwrap();
        let b = builder.add_group(Some(a)).unwrap();
        builder.add_tree(Some(b), TreeId(7), cube(0.0, 0.0, 0.0)).unwrap();
        builder.add_tree(Some(b), TreeId(3), cube(0.5, 0.0, 0.0)).unwrap();
        builder.add_tree(None, TreeId(1), cube(5.0, 5.0, -2.0)).unwrap();
        builder.add_tree(Some(a), TreeId(2), cube(9.0, 0.0, 0.0)).unwrap();
        builder.finish()
    }

    #[test]
    fn visits_depth_first_in_order_of_addition() {
        let scene = sample();
        let mut log = Log::default();
        scene.accept(&mut log);
        assert_eq!(
            log.lines,
            [
                "g0 d0 n2 true",
                "g1 d1 n2 true",
                "g2 d2 n2 false",
                "t7",
                "t3",
                "t2",
                "t1"
            ]
        );
        let mut log = Log {
            skip: Some(GroupId(2)),
            ..Log::default()
        };
        scene.accept(&mut log);
        assert_eq!(log.lines[3..], ["t2", "t1"]);
        assert_eq!(
            (scene.len(), scene.group_count(), scene.tree_id_limit()),
            (4, 3, 8)
        );
        assert_eq!(scene.trees().count(), 4);
        let bounds = scene.bounds().unwrap();
        assert_eq!(
            (bounds.min, bounds.max),
            (dvec3(0.0, 0.0, -2.0), dvec3(10.0, 6.0, 1.0))
        );
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

    #[test]
    fn nesting_a_hundred_thousand_deep_needs_no_stack() {
        let mut builder = SceneGraph::builder();
        let mut group = None;
        for _ in 0..100_000 {
            group = Some(builder.add_group(group).unwrap());
        }
        builder.add_tree(group, TreeId(0), cube(0.0, 0.0, 0.0)).unwrap();
        let scene = builder.finish();
        assert_eq!(scene.bounds(), Some(cube(0.0, 0.0, 0.0)));
        let mut log = Log::default();
        scene.accept(&mut log);
        assert_eq!(log.lines.len(), 100_002);
    }
}
