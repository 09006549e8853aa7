//! The scene graph of a terrain as authored or built: `scene.xml`.
//!
//! ```xml
//! <OctTreeGroup Version="1" Compressed="NO" BrickXSize="8" BrickYSize="8" BrickZSize="8">
//!   <PagedOctTree CenterX="32" CenterY="32" CenterZ="32" Radius="55.5" TreeFile="trees/a.oct"
//!                 MinX="0" MinY="0" MinZ="0" MaxX="64" MaxY="64" MaxZ="64"/>
//! </OctTreeGroup>
//! ```
//! Groups nest, and may have coarse trees ([`CoarseOctTree`]) that stand for all that is in them from afar. What is read has finite numbers within ±1e15 m, boxes with Min ≤ Max and tree files inside the terrain's
//! folder; anything unknown is an error with its line and column. `docs/formats.md` lists every attribute.

mod read;

use std::collections::BTreeMap;

use glam::DVec3;

use crate::error::{FormatError, Place};
use crate::layout::BRICK_VOXELS;
use crate::words::{BRICK_SIZE, CENTER, MAX, MIN};
use crate::xml::{Element, write_f64, write_text};

/// Version written and read.
pub const VERSION: u32 = 1;

/// Deepest nesting of groups, the root counted.
pub const MAX_NESTING: usize = 64;

/// Most trees, and most groups, of a scene.
pub const MAX_ITEMS: usize = 1 << 20;

/// A terrain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Coordinate reference system of the world (a name or WKT), as found in the inputs; not interpreted here.
    pub crs: Option<String>,
    /// The outermost group.
    pub root: Group,
}

/// A group of trees and groups.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Whether bricks are block-compressed for the GPU. Who reads bricks decides whether it can.
    pub compressed: bool,
    /// Voxels of a brick per axis where stated; always 8.
    pub brick_size: Option<[u32; 3]>,
    /// Box of everything in the group, world metres.
    pub bounds: Option<Bounds>,
    /// Groups inside, in document order.
    pub groups: Vec<Group>,
    /// Trees directly inside, in document order.
    pub trees: Vec<PagedOctTree>,
    /// What stands for everything inside where it is far enough, in document order.
    pub coarse: Vec<CoarseOctTree>,
}

/// A reference to one tree.
#[derive(Clone, Debug, PartialEq)]
pub struct PagedOctTree {
    /// Centre of the bounding sphere, world metres.
    pub center: DVec3,
    /// Radius of the bounding sphere, metres, above zero.
    pub radius: f64,
    /// The tree's box, world metres; where missing, the tree file has it.
    pub bounds: Option<Bounds>,
    /// The octree file: a relative path with `/` that stays in the terrain's folder.
    pub tree_file: String,
}

/// A tree of coarse levels over everything in its group. All of a group's together are drawn instead of what is inside
/// wherever a pixel is at least [`CoarseOctTree::voxel`] wide in the whole group.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseOctTree {
    /// Its file and place.
    pub tree: PagedOctTree,
    /// Side of its finest voxels, metres, above zero: those of the coarsest level of what it stands for.
    pub voxel: f64,
}

/// A box in the world, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Low corner.
    pub min: DVec3,
    /// High corner, nowhere below the low one.
    pub max: DVec3,
}

impl Scene {
    /// Reads a scene.
    ///
    /// # Errors
    /// Everything that the module does not know or that is out of range, naming element and attribute, with line and
    /// column.
    pub fn parse(bytes: &[u8]) -> Result<Scene, FormatError> {
        let (scene, faults) = Self::parse_usable(bytes)?;
        faults.into_iter().next().map_or(Ok(scene), Err)
    }

    /// Reads what can be used of a scene: trees with a fault in their attributes and unknown elements are left out, groups with a
    /// fault count as if they had no attributes, and all faults come beside the scene, in the order of the file. For those who show what
    /// can be shown, and those who list what is wrong.
    ///
    /// # Errors
    /// Text that is not XML or no scene, groups that nest too deep, too many trees.
    pub fn parse_usable(bytes: &[u8]) -> Result<(Scene, Vec<FormatError>), FormatError> {
        read::read(bytes)
    }

    /// Where a scene names its tree files: the place of each `TreeFile`, of several that name the same file the first. Empty if the text
    /// is not XML.
    pub fn tree_file_places(bytes: &[u8]) -> BTreeMap<String, Place> {
        read::tree_file_places(bytes)
    }

    /// Writes the scene; [`Scene::parse`] gives it back exactly. In a group, coarse trees stand before trees, trees before
    /// groups.
    pub fn to_xml(&self) -> String {
        let mut out = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_string();
        write_group(&mut out, &self.root, 0, self);
        out
    }

    /// All trees, depth first: a group's own in document order, then those of its groups.
    pub fn trees(&self) -> impl Iterator<Item = &PagedOctTree> {
        self.groups().flat_map(|group| &group.trees)
    }

    /// All coarse trees, depth first: a group's own in document order, then those of its groups.
    pub fn coarse_trees(&self) -> impl Iterator<Item = &CoarseOctTree> {
        self.groups().flat_map(|group| &group.coarse)
    }

    /// All groups, depth first, outer ones before those inside.
    pub fn groups(&self) -> impl Iterator<Item = &Group> {
        let mut groups = vec![&self.root];
        std::iter::from_fn(move || {
            let group = groups.pop()?;
            groups.extend(group.groups.iter().rev());
            Some(group)
        })
    }
}

/// The brick size, which is the same in all files.
pub(crate) fn parse_brick_size(element: &Element) -> Result<[u32; 3], FormatError> {
    for name in BRICK_SIZE {
        let attribute = element.required(name)?;
        if attribute.integer::<u32>()? != BRICK_VOXELS {
            return Err(attribute.error(format!(
                "is not supported, bricks have {BRICK_VOXELS} voxels per axis"
            )));
        }
    }
    Ok([BRICK_VOXELS; 3])
}

fn write_bounds(out: &mut String, bounds: &Option<Bounds>) {
    if let Some(bounds) = bounds {
        for (names, corner) in [(MIN, bounds.min), (MAX, bounds.max)] {
            write_metres3(out, names, corner);
        }
    }
}

fn write_metres3(out: &mut String, names: [&str; 3], v: DVec3) {
    for (name, v) in names.into_iter().zip(v.to_array()) {
        write_f64(out, name, v);
    }
}

fn write_group(out: &mut String, group: &Group, depth: usize, scene: &Scene) {
    let indent = "  ".repeat(depth);
    out.push_str(&indent);
    out.push_str("<OctTreeGroup");
    if depth == 0 {
        write_text(out, "Version", &VERSION.to_string());
        if let Some(crs) = &scene.crs {
            write_text(out, "Crs", crs);
        }
    }
    write_text(out, "Compressed", if group.compressed { "YES" } else { "NO" });
    for (name, size) in BRICK_SIZE.into_iter().zip(group.brick_size.into_iter().flatten()) {
        write_text(out, name, &size.to_string());
    }
    write_bounds(out, &group.bounds);
    if group.trees.is_empty() && group.groups.is_empty() && group.coarse.is_empty() {
        out.push_str("/>\n");
        return;
    }
    out.push_str(">\n");
    let coarse = group
        .coarse
        .iter()
        .map(|c| ("CoarseOctTree", &c.tree, Some(c.voxel)));
    let trees = group.trees.iter().map(|tree| ("PagedOctTree", tree, None));
    for (name, tree, voxel) in coarse.chain(trees) {
        out.push_str(&indent);
        out.push_str("  <");
        out.push_str(name);
        write_metres3(out, CENTER, tree.center);
        write_f64(out, "Radius", tree.radius);
        write_text(out, "TreeFile", &tree.tree_file);
        if let Some(voxel) = voxel {
            write_f64(out, "Voxel", voxel);
        }
        write_bounds(out, &tree.bounds);
        out.push_str("/>\n");
    }
    for group in &group.groups {
        write_group(out, group, depth + 1, scene);
    }
    out.push_str(&indent);
    out.push_str("</OctTreeGroup>\n");
}
