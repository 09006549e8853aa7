//! The scene graph: nested groups over paged trees, as one flat array.
//!
//! Built once from what the scene file says, then only read: the render thread culls while other threads may look at
//! it through a shared reference. Nodes lie breadth-first, so the children of a group are neighbours in memory and
//! every child has a larger index than its parent. There is always a root group, [`GroupId::ROOT`].
//!
//! A group may have coarse trees, which stand for everything in it from afar; they lie behind its children.
//!
//! Invariants: bounds are finite; a group's bounds are the union of its non-empty children and coarse trees; a tree with a box of zero
//! volume owns no point (boxes are half-open) and counts for no bounds and is never visible, but is still visited.

use crate::bounds::Aabb;
use crate::builder::SceneBuilder;

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
    Coarse,
    Group {
        first: u32,
        count: u32,
        disjoint: bool,
        coarse: Coarse,
    },
}

/// The coarse trees of a group: the nodes right after its children.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Coarse {
    pub(crate) count: u32,
    /// Side of their finest voxels, metres; the largest of them.
    pub(crate) voxel: f64,
}

/// Groups and trees with their bounds, read-only.
#[derive(Clone, Debug)]
pub struct SceneGraph {
    nodes: Vec<Node>,
    tree_count: usize,
    coarse_count: usize,
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
    /// Number of direct children, coarse trees not counted.
    pub children: u32,
    /// Number of coarse trees, and the side of their finest voxels, metres; 0 and 0 without.
    pub coarse: (u32, f64),
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
    /// Called on each tree, with the number of groups above it.
    fn visit_tree(&mut self, tree: TreeId, bounds: &Aabb, depth: u32);
}

impl SceneGraph {
    /// An empty builder.
    pub fn builder() -> SceneBuilder {
        SceneBuilder::new()
    }

    /// Number of trees, those with empty boxes included and coarse ones not.
    pub fn len(&self) -> usize {
        self.tree_count
    }

    /// Whether there is no tree.
    pub fn is_empty(&self) -> bool {
        self.tree_count == 0
    }

    /// Number of groups, the root included.
    pub fn group_count(&self) -> usize {
        self.nodes.len() - self.tree_count - self.coarse_count
    }

    /// Number of coarse trees of groups.
    pub fn coarse_count(&self) -> usize {
        self.coarse_count
    }

    /// One more than the largest id of a tree or coarse tree, 0 for an empty scene: the length of a table by tree id.
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

    /// All trees with their boxes, level by level of the nesting; coarse ones are not among them.
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
                NodeKind::Tree => visitor.visit_tree(TreeId(node.id), &node.bounds, depth),
                NodeKind::Coarse => {}
                NodeKind::Group {
                    first,
                    count,
                    disjoint,
                    coarse,
                } => {
                    let info = GroupInfo {
                        id: GroupId(node.id),
                        bounds: (!node.empty).then_some(node.bounds),
                        depth,
                        children: count,
                        coarse: (coarse.count, coarse.voxel),
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

    /// Takes over what the builder laid out.
    pub(crate) fn from_parts(nodes: Vec<Node>, tree_id_limit: u32) -> SceneGraph {
        let count = |kind: fn(&NodeKind) -> bool| nodes.iter().filter(|node| kind(&node.kind)).count();
        SceneGraph {
            tree_count: count(|kind| matches!(kind, NodeKind::Tree)),
            coarse_count: count(|kind| matches!(kind, NodeKind::Coarse)),
            nodes,
            tree_id_limit,
        }
    }

    /// Indices of the coarse trees of a group.
    pub(crate) fn coarse(&self, group: u32) -> std::ops::Range<u32> {
        match self.nodes[group as usize].kind {
            NodeKind::Group {
                first, count, coarse, ..
            } => first + count..first + count + coarse.count,
            _ => 0..0,
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
        fn visit_tree(&mut self, tree: TreeId, _: &Aabb, _: u32) {
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
