//! The scene file of a built terrain: trees in groups, nested as a quadtree over the columns of trees, each with its coarse
//! trees. A tree's box is that of what is in it ([`super::crop`]).

use std::collections::BTreeMap;

use brickfell_formats::octree::TreeHeader;
use brickfell_formats::scene::{Bounds, CoarseOctTree, Group, PagedOctTree, Scene};

/// A tree of the scene: its column, its file and its box.
#[derive(Clone, Debug)]
pub(crate) struct SceneTree {
    pub(crate) column: (i64, i64),
    pub(crate) file: String,
    pub(crate) bounds: Bounds,
}

/// A coarse tree of a group: how many levels of groups end with it, the group's column, its file, its header and its box.
#[derive(Clone, Debug)]
pub(crate) struct SceneGroup {
    pub(crate) height: u8,
    pub(crate) column: (i64, i64),
    pub(crate) file: String,
    pub(crate) header: TreeHeader,
    pub(crate) bounds: Bounds,
}

/// The scene of all trees; coarse trees come lowest groups first. `compressed`: bricks are in blocks.
pub(crate) fn scene(
    mut trees: Vec<SceneTree>,
    coarse: Vec<SceneGroup>,
    crs: Option<String>,
    compressed: bool,
) -> Scene {
    let finished = |group| finished(group, compressed);
    trees.sort_by_key(|t| t.column);
    // Groups of one height by column; at height 0 those of a single column of trees.
    let mut groups: BTreeMap<(i64, i64), Group> = BTreeMap::new();
    for tree in trees {
        let group = groups.entry(tree.column).or_default();
        group.trees.push(paged(tree.file, tree.bounds));
    }
    for level in coarse.chunk_by(|a, b| a.height == b.height) {
        let mut above: BTreeMap<(i64, i64), Group> = BTreeMap::new();
        for ((x, y), mut inner) in std::mem::take(&mut groups) {
            let outer = above.entry((x.div_euclid(2), y.div_euclid(2))).or_default();
            if inner.groups.is_empty() && inner.coarse.is_empty() {
                outer.trees.append(&mut inner.trees);
            } else {
                outer.groups.push(finished(inner));
            }
        }
        for tree in level {
            let group = above.entry(tree.column).or_default();
            group.coarse.push(CoarseOctTree {
                tree: paged(tree.file.clone(), tree.bounds),
                voxel: tree.header.voxel_size,
            });
        }
        groups = above;
    }
    let mut all: Vec<Group> = groups.into_values().map(finished).collect();
    let root = match all.len() {
        1 => all.remove(0),
        _ => finished(Group {
            groups: all,
            ..Group::default()
        }),
    };
    Scene { crs, root }
}

/// A group with what is to be said of all that is in it.
fn finished(group: Group, compressed: bool) -> Group {
    let trees = group.trees.iter().chain(group.coarse.iter().map(|c| &c.tree));
    let inside = trees
        .filter_map(|t| t.bounds)
        .chain(group.groups.iter().filter_map(|g| g.bounds));
    let bounds = inside.reduce(|a, b| Bounds {
        min: a.min.min(b.min),
        max: a.max.max(b.max),
    });
    Group {
        compressed,
        brick_size: Some([8; 3]),
        bounds,
        ..group
    }
}

fn paged(file: String, bounds: Bounds) -> PagedOctTree {
    let Bounds { min, max } = bounds;
    PagedOctTree {
        center: (min + max) * 0.5,
        radius: (max - min).length() * 0.5,
        bounds: Some(bounds),
        tree_file: file,
    }
}
