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

use glam::DVec3;

use crate::error::FormatError;
use crate::layout::BRICK_VOXELS;
use crate::xml::{Document, Element, Token, write_f64, write_text};

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

const MIN: [&str; 3] = ["MinX", "MinY", "MinZ"];
const MAX: [&str; 3] = ["MaxX", "MaxY", "MaxZ"];
const CENTER: [&str; 3] = ["CenterX", "CenterY", "CenterZ"];
const BRICK_SIZE: [&str; 3] = ["BrickXSize", "BrickYSize", "BrickZSize"];

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

    /// Reads what can be used of a scene: trees with a fault in their attributes are left out, groups with one count as if
    /// they had none, and the faults come beside the scene. For those who show what can be shown.
    ///
    /// # Errors
    /// Text that is not XML, unknown elements, groups that nest too deep, too many trees.
    pub fn parse_usable(bytes: &[u8]) -> Result<(Scene, Vec<FormatError>), FormatError> {
        let mut faults = Vec::new();
        let mut document = Document::new(bytes)?;
        let (mut trees, mut coarse, mut groups) = (0, 0, 0);
        let (mut crs, mut root) = (None, None);
        // The groups that are open; a tree element, which has no content, is not among them.
        let mut open: Vec<Group> = Vec::new();
        let mut in_tree = false;
        loop {
            match document.next()? {
                Token::Open(element) if in_tree => {
                    return Err(element.error("a tree has no elements inside"));
                }
                Token::Open(element) if element.name == "OctTreeGroup" => {
                    if open.len() == MAX_NESTING {
                        return Err(element.error(format!("groups nest deeper than {MAX_NESTING}")));
                    }
                    groups = count(&element, groups)?;
                    let group = parse_group(&element, open.is_empty()).unwrap_or_else(|fault| {
                        faults.push(fault);
                        Group::default()
                    });
                    if open.is_empty() {
                        crs = element.optional("Crs").map(|a| a.value().to_string());
                    }
                    open.push(group);
                }
                Token::Open(element) => match open.last_mut() {
                    Some(group) if element.name == "PagedOctTree" => {
                        trees = count(&element, trees)?;
                        match parse_tree(&element, &[]) {
                            Ok(tree) => group.trees.push(tree),
                            Err(fault) => faults.push(fault),
                        }
                        in_tree = true;
                    }
                    Some(group) if element.name == "CoarseOctTree" => {
                        coarse = count(&element, coarse)?;
                        match parse_coarse(&element) {
                            Ok(tree) => group.coarse.push(tree),
                            Err(fault) => faults.push(fault),
                        }
                        in_tree = true;
                    }
                    Some(_) => return Err(element.error("unknown element in OctTreeGroup")),
                    None => return Err(element.error("unknown root element (OctTreeGroup expected)")),
                },
                Token::Close if in_tree => in_tree = false,
                Token::Close => {
                    let group = open.pop();
                    match open.last_mut() {
                        Some(parent) => parent.groups.extend(group),
                        None => root = group,
                    }
                }
                Token::End => break,
            }
        }
        root.map(|root| (Scene { crs, root }, faults))
            .ok_or_else(|| FormatError::file("the scene has no root group"))
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

fn count(element: &Element, so_far: usize) -> Result<usize, FormatError> {
    if so_far == MAX_ITEMS {
        return Err(element.error(format!("a scene has at most {MAX_ITEMS} of these")));
    }
    Ok(so_far + 1)
}

fn parse_group(element: &Element, is_root: bool) -> Result<Group, FormatError> {
    let mut known = vec!["Compressed"];
    known.extend(BRICK_SIZE.iter().chain(&MIN).chain(&MAX));
    if is_root {
        known.extend(["Version", "Crs"]);
    }
    element.allow(&known)?;
    if let Some(version) = element.optional("Version")
        && version.integer::<u32>()? != VERSION
    {
        return Err(version.error(format!("is an unknown version (this reads {VERSION})")));
    }
    let brick_size = if element.has_any(&BRICK_SIZE) {
        Some(parse_brick_size(element)?)
    } else {
        None
    };
    let compressed = element.optional("Compressed").map_or(Ok(false), |a| a.yes_no())?;
    Ok(Group {
        compressed,
        brick_size,
        bounds: parse_bounds(element)?,
        ..Group::default()
    })
}

fn parse_coarse(element: &Element) -> Result<CoarseOctTree, FormatError> {
    let tree = parse_tree(element, &["Voxel"])?;
    let voxel = element.required("Voxel")?;
    let metres = voxel.metres()?;
    if metres <= 0.0 {
        return Err(voxel.error("is not above zero"));
    }
    Ok(CoarseOctTree { tree, voxel: metres })
}

/// Reads what all elements of trees have; `own` are the attributes that this one has besides.
fn parse_tree(element: &Element, own: &[&'static str]) -> Result<PagedOctTree, FormatError> {
    let mut known = vec!["Radius", "TreeFile"];
    known.extend(own);
    known.extend(CENTER.iter().chain(&MIN).chain(&MAX));
    element.allow(&known)?;
    let radius = element.required("Radius")?;
    let metres = radius.metres()?;
    if metres <= 0.0 {
        return Err(radius.error("is not above zero"));
    }
    let file = element.required("TreeFile")?;
    if let Some(why) = path_fault(file.value()) {
        return Err(file.error(format!(
            "leaves the terrain's folder or is not a file name: {why}"
        )));
    }
    Ok(PagedOctTree {
        center: element.metres3(CENTER)?.into(),
        radius: metres,
        bounds: parse_bounds(element)?,
        tree_file: file.value().to_string(),
    })
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

fn parse_bounds(element: &Element) -> Result<Option<Bounds>, FormatError> {
    if !element.has_any(&MIN) && !element.has_any(&MAX) {
        return Ok(None);
    }
    let bounds = Bounds {
        min: element.metres3(MIN)?.into(),
        max: element.metres3(MAX)?.into(),
    };
    for axis in 0..3 {
        if bounds.min[axis] > bounds.max[axis] {
            return Err(element
                .required(MIN[axis])?
                .error(format!("is above {}", MAX[axis])));
        }
    }
    Ok(Some(bounds))
}

/// Why a path is not a file below the folder it is relative to, on any platform.
fn path_fault(path: &str) -> Option<&'static str> {
    if path.is_empty() {
        return Some("it is empty");
    }
    if path.starts_with('/') {
        return Some("it is absolute");
    }
    if path.contains('\\') {
        return Some("it has a backslash (separate by /)");
    }
    if path.contains(':') {
        return Some("it has a colon (a drive or an address)");
    }
    if path.chars().any(char::is_control) {
        return Some("it has a control character");
    }
    path.split('/').find_map(|part| match part {
        ".." => Some("it has a component .."),
        "." | "" => Some("it has an empty component or ."),
        _ => None,
    })
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
