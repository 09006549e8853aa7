//! The scene file of a built terrain: trees in groups, nested as a quadtree over the columns of trees.

use glam::DVec3;

use brickfell_formats::octree::TreeHeader;
use brickfell_formats::scene::{Bounds, Group, PagedOctTree, Scene};

/// Trees that a group holds without being divided further.
const GROUP_TREES: usize = 8;

/// A tree of the scene: its column, its file and its header.
#[derive(Clone, Debug)]
pub(crate) struct SceneTree {
    pub(crate) column: (i64, i64),
    pub(crate) file: String,
    pub(crate) header: TreeHeader,
}

/// The scene of all trees.
pub(crate) fn scene(trees: Vec<SceneTree>, crs: Option<String>) -> Scene {
    let lo = |f: fn(&SceneTree) -> i64| trees.iter().map(f).min().unwrap_or(0);
    let hi = |f: fn(&SceneTree) -> i64| trees.iter().map(f).max().unwrap_or(0);
    let (x0, y0) = (lo(|t| t.column.0), lo(|t| t.column.1));
    let width = (hi(|t| t.column.0) - x0).max(hi(|t| t.column.1) - y0) + 1;
    let size = (width as u64).next_power_of_two() as i64;
    Scene {
        crs,
        root: group(trees, x0, y0, size),
    }
}

fn group(mut trees: Vec<SceneTree>, x: i64, y: i64, size: i64) -> Group {
    let boxes = trees.iter().map(|t| t.header.bounds());
    let bounds = boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    let bounds = bounds.map(|[min, max]| Bounds { min, max });
    let mut result = Group {
        brick_size: Some([8; 3]),
        bounds,
        ..Group::default()
    };
    if size == 1 || trees.len() <= GROUP_TREES {
        trees.sort_by_key(|t| t.column);
        result.trees = trees.into_iter().map(tree).collect();
        return result;
    }
    let half = size / 2;
    for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
        let inside =
            |t: &SceneTree| (t.column.0 >= x + half) == (dx > 0) && (t.column.1 >= y + half) == (dy > 0);
        let (part, rest) = trees.into_iter().partition(inside);
        trees = rest;
        if !Vec::is_empty(&part) {
            result.groups.push(group(part, x + dx, y + dy, half));
        }
    }
    result
}

fn tree(tree: SceneTree) -> PagedOctTree {
    let [min, max] = tree.header.bounds();
    PagedOctTree {
        center: (min + max) * 0.5,
        radius: DVec3::length(max - min) * 0.5,
        bounds: Some(Bounds { min, max }),
        tree_file: tree.file,
    }
}
