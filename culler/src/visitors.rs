//! Walks over the whole scene graph, for its figures. Run where a scene is looked at, not in frames.

use crate::bounds::Aabb;
use crate::scene::{Descend, GroupInfo, TreeId, Visitor};

/// Counts of a scene graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Groups, the root included.
    pub groups: usize,
    /// Trees, coarse ones not counted.
    pub trees: usize,
    /// Coarse trees.
    pub coarse: usize,
    /// Groups in each other at most; 1 for a root alone.
    pub nesting: usize,
    /// Most children of a group.
    pub widest: usize,
    /// Groups of which two children share a point.
    pub overlapping: usize,
    /// Trees whose box has no volume.
    pub empty: usize,
}

impl Visitor for Statistics {
    fn enter_group(&mut self, group: &GroupInfo) -> Descend {
        self.groups += 1;
        self.coarse += group.coarse.0 as usize;
        self.nesting = self.nesting.max(group.depth as usize + 1);
        self.widest = self.widest.max(group.children as usize);
        self.overlapping += usize::from(!group.children_disjoint);
        Descend::Yes
    }

    fn visit_tree(&mut self, _: TreeId, bounds: &Aabb, _: u32) {
        self.trees += 1;
        self.empty += usize::from(bounds.is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneGraph;
    use glam::{DVec3, dvec3};

    fn scene() -> SceneGraph {
        let cube = |x: f64| Aabb::new(dvec3(x, 0.0, 0.0), dvec3(x + 2.0, 2.0, 2.0)).unwrap();
        let mut builder = SceneGraph::builder();
        let inner = builder.add_group(None).unwrap();
        for id in 0..4 {
            builder
                .add_tree(Some(inner), TreeId(id), cube(f64::from(id)))
                .unwrap();
        }
        builder.add_coarse(inner, TreeId(9), cube(0.0), 0.5).unwrap();
        let flat = Aabb::new(DVec3::ZERO, dvec3(1.0, 1.0, 0.0)).unwrap();
        builder.add_tree(None, TreeId(4), flat).unwrap();
        builder.finish()
    }

    #[test]
    fn counts_everything_once() {
        let mut statistics = Statistics::default();
        scene().accept(&mut statistics);
        let expected = Statistics {
            groups: 2,
            trees: 5,
            coarse: 1,
            nesting: 2,
            widest: 4,
            overlapping: 1,
            empty: 1,
        };
        assert_eq!(statistics, expected);
    }
}
