//! The layout of the terrain: trees side by side, a quadtree of groups over them with a coarse tree each, their names, and
//! the scene file.

use brickfell_formats::scene::{Bounds, CoarseOctTree, Group, PagedOctTree, Scene};
use glam::DVec3;

use super::field::Field;
use super::tree::Place;

/// Folder of the trees.
const FOLDER: &str = "trees/";

/// What a name of the terrain stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Object {
    Scene,
    Octree(Place),
    Bricks(Place, u8),
}

/// Name of a tree's octree file.
pub(super) fn tree_file(place: Place) -> String {
    let [x, y] = place.column;
    match place.height {
        0 => format!("{FOLDER}x{x}_y{y}.oct"),
        height => format!("{FOLDER}g{height}_x{x}_y{y}.oct"),
    }
}

/// Levels of groups: as many as it takes until one group has everything.
pub(super) fn top(field: &Field) -> u8 {
    field.trees.next_power_of_two().ilog2() as u8
}

/// What a name stands for; `None` if there is no such object. Only the one way of writing a number is known.
pub(super) fn object(field: &Field, scene: &str, name: &str) -> Option<Object> {
    if name == scene {
        return Some(Object::Scene);
    }
    let (stem, level) = match name.strip_suffix(".oct") {
        Some(stem) => (stem, None),
        None => {
            let (stem, level) = name.strip_suffix(".brk")?.rsplit_once(".L")?;
            (stem, Some(level.parse::<u8>().ok()?))
        }
    };
    let rest = stem.strip_prefix(FOLDER)?;
    let (height, rest) = match rest.strip_prefix('g') {
        Some(rest) => {
            let (height, rest) = rest.split_once('_')?;
            (height.parse().ok()?, rest)
        }
        None => (0, rest),
    };
    let (x, y) = rest.strip_prefix('x')?.split_once("_y")?;
    let place = Place {
        height,
        column: [x.parse().ok()?, y.parse().ok()?],
    };
    let exists = height <= top(field) && place.column.iter().all(|v| *v <= (field.trees - 1) >> height);
    let object = match level {
        None => Object::Octree(place),
        Some(level) if exists && level <= place.depth(field) => Object::Bricks(place, level),
        Some(_) => return None,
    };
    let spelt = match object {
        Object::Bricks(place, level) => brickfell_formats::bricks::brick_file_name(&tree_file(place), level),
        _ => tree_file(place),
    };
    (exists && spelt == name).then_some(object)
}

/// The box of a tree, metres; `voxel` is the side of the terrain's finest ones.
fn bounds(field: &Field, place: Place, voxel: f64) -> Bounds {
    let side = voxel * (8u64 << (u32::from(field.depth) + u32::from(place.height))) as f64;
    let [x, y] = place.column.map(f64::from);
    let min = DVec3::new(x, y, -0.5) * side;
    Bounds { min, max: min + side }
}

fn reference(field: &Field, place: Place, voxel: f64) -> PagedOctTree {
    let Bounds { min, max } = bounds(field, place, voxel);
    PagedOctTree {
        center: (min + max) * 0.5,
        radius: (max - min).length() * 0.5,
        bounds: Some(Bounds { min, max }),
        tree_file: tree_file(place),
    }
}

/// The scene.
pub(super) fn scene(field: &Field, voxel: f64) -> Scene {
    let height = top(field);
    let whole = Place {
        height,
        column: [0, 0],
    };
    let root = match height {
        0 => Group {
            trees: vec![reference(field, whole, voxel)],
            ..Group::default()
        },
        _ => group(field, whole, voxel),
    };
    Scene { crs: None, root }
}

/// A group with all that is in it. Nests as deep as there are levels, 20 at most.
fn group(field: &Field, place: Place, voxel: f64) -> Group {
    let inner = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[dx, dy]| Place {
        height: place.height - 1,
        column: [2 * place.column[0] + dx, 2 * place.column[1] + dy],
    });
    let last = (field.trees - 1) >> (place.height - 1);
    let inside = inner.into_iter().filter(|p| p.column.iter().all(|v| *v <= last));
    let (trees, groups) = match place.height {
        1 => (inside.map(|p| reference(field, p, voxel)).collect(), Vec::new()),
        _ => (Vec::new(), inside.map(|p| group(field, p, voxel)).collect()),
    };
    let tree = reference(field, place, voxel);
    Group {
        bounds: tree.bounds,
        trees,
        groups,
        coarse: vec![CoarseOctTree {
            tree,
            voxel: voxel * (1u64 << place.mip(field, place.depth(field))) as f64,
        }],
        ..Group::default()
    }
}
