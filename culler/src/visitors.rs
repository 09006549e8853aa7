//! Walks over the whole scene graph: its picture in text and its figures. Run where a scene is looked at, not in frames.

use std::fmt::Write;

use crate::bounds::Aabb;
use crate::scene::{Descend, GroupInfo, TreeId, Visitor};

/// Writes a line per group and tree, indented by the nesting.
#[derive(Clone, Debug)]
pub struct Printer {
    text: String,
    trees_per_group: usize,
    /// By depth of the open groups, how many of their own trees came by.
    trees: Vec<usize>,
}

impl Printer {
    /// A printer that lists at most so many trees of each group, and counts the others.
    pub fn new(trees_per_group: usize) -> Self {
        Self {
            text: String::new(),
            trees_per_group,
            trees: Vec::new(),
        }
    }

    /// The lines.
    pub fn finish(mut self) -> String {
        self.close(0);
        self.text
    }

    fn line(&mut self, depth: usize, what: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{:1$}{what}", "", 2 * depth);
    }

    /// Leaves the groups from this depth on, saying what of them was not listed.
    fn close(&mut self, depth: usize) {
        while self.trees.len() > depth {
            let trees = self.trees.pop().unwrap_or(0);
            if trees > self.trees_per_group {
                let more = trees - self.trees_per_group;
                self.line(self.trees.len() + 1, format_args!("and {more} trees more"));
            }
        }
    }
}

fn extent(bounds: &Aabb) -> String {
    format!("{} to {}", bounds.min, bounds.max)
}

impl Visitor for Printer {
    fn enter_group(&mut self, group: &GroupInfo) -> Descend {
        let bounds = group.bounds.map_or("empty".to_owned(), |b| extent(&b));
        let coarse = match group.coarse {
            (0, _) => String::new(),
            (count, voxel) => format!(", {count} coarse with voxels of {voxel} m"),
        };
        let overlap = if group.children_disjoint {
            ""
        } else {
            ", children overlap"
        };
        let noun = if group.children == 1 { "child" } else { "children" };
        let (id, children, depth) = (group.id.0, group.children, group.depth as usize);
        self.close(depth);
        self.line(
            depth,
            format_args!("group {id}: {bounds}, {children} {noun}{coarse}{overlap}"),
        );
        self.trees.push(0);
        Descend::Yes
    }

    fn visit_tree(&mut self, tree: TreeId, bounds: &Aabb, depth: u32) {
        self.close(depth as usize);
        let listed = self.trees.last_mut().is_none_or(|count| {
            *count += 1;
            *count <= self.trees_per_group
        });
        if listed {
            self.line(
                depth as usize,
                format_args!("tree {}: {}", tree.0, extent(bounds)),
            );
        }
    }
}

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
    fn prints_the_nesting_and_says_what_it_leaves_out() {
        let mut printer = Printer::new(2);
        scene().accept(&mut printer);
        let expected = "\
group 0: [0, 0, 0] to [5, 2, 2], 2 children
  group 1: [0, 0, 0] to [5, 2, 2], 4 children, 1 coarse with voxels of 0.5 m, children overlap
    tree 0: [0, 0, 0] to [2, 2, 2]
    tree 1: [1, 0, 0] to [3, 2, 2]
    and 2 trees more
  tree 4: [0, 0, 0] to [1, 1, 0]
";
        assert_eq!(printer.finish(), expected);
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
