//! The octree file as XML, for authoring and tests; converts to and from the binary file without loss.
//!
//! `GigaVoxelsOctTree` carries the header, one `Node` inside it is the root, and a node holds no or eight `Node` children
//! in octant order `x + 2y + 4z`. The document is depth-first and the levels in memory are breadth-first; because siblings
//! are in octant order, the nodes of each level come in Morton order either way, so tiles and bricks are numbered while
//! reading. `docs/formats.md` lists every attribute.

use glam::{DVec3, UVec3};

use crate::error::FormatError;
use crate::layout::{BRICK_VOXELS, SampleLayout};
use crate::octree::{MAX_DEPTH, Node, NodeData, Octree, TreeHeader, count_bricks};
use crate::scene::parse_brick_size;
use crate::value::{decode_color, linear_to_srgb};
use crate::words::{self, BRICK_SIZE, DELTA, ORIGIN, SURFACE, VOLUME};
use crate::xml::{Attribute, Document, Element, Token, write_f64, write_text};

/// Version written and read.
pub const VERSION: u32 = 1;

const LAYOUTS: [(&str, SampleLayout); 2] =
    [("CENTRE", SampleLayout::Centre), ("CORNER", SampleLayout::Corner)];

/// How far VolumeXSize may be from a power of two bricks, relatively: room for decimals cut short by hand.
const VOLUME_TOLERANCE: f64 = 1e-6;

#[derive(Clone, Copy, PartialEq)]
enum NodeType {
    Const,
    NonConst,
    LeafConst,
}

const TYPES: [(&str, NodeType); 3] = [
    ("CONST", NodeType::Const),
    ("NON-CONST", NodeType::NonConst),
    ("LEAF-CONST", NodeType::LeafConst),
];

/// A node whose element is open.
struct Open<'a> {
    element: Element<'a>,
    node_type: NodeType,
    color: Option<[u8; 4]>,
    /// Its place in its level.
    index: usize,
    children: u32,
}

/// Reads a tree.
///
/// # Errors
/// Everything unknown, missing, out of range or inconsistent, naming element and attribute, with line and column.
pub fn decode(bytes: &[u8]) -> Result<Octree, FormatError> {
    let mut document = Document::new(bytes)?;
    let Token::Open(root) = document.next()? else {
        return Err(FormatError::file("the file has no root element"));
    };
    let (header, has_bricks) = parse_header(&root)?;
    let levels = usize::from(header.depth) + 1;
    let mut levels = Levels {
        nodes: vec![Vec::new(); levels],
        bricks: vec![0; levels],
        has_bricks,
    };
    let mut open: Vec<Open> = Vec::new();
    loop {
        match document.next()? {
            Token::Open(element) => {
                let node = levels.open(element, &mut open)?;
                open.push(node);
            }
            Token::Close => {
                if let Some(node) = open.pop() {
                    levels.close(&node, open.len())?;
                } else if levels.nodes.first().is_none_or(Vec::is_empty) {
                    return Err(root.error("has no Node"));
                }
            }
            Token::End => break,
        }
    }
    let tree = Octree {
        header,
        levels: levels.nodes,
    };
    tree.validate()?;
    Ok(tree)
}

/// The levels as they fill.
struct Levels {
    nodes: Vec<Vec<Node>>,
    bricks: Vec<u32>,
    has_bricks: bool,
}

impl Levels {
    fn open<'a>(&mut self, element: Element<'a>, open: &mut [Open<'a>]) -> Result<Open<'a>, FormatError> {
        if element.name != "Node" {
            let about = words::NODE.about_inside(element.name);
            return Err(element.error("unknown element (Node expected)").suggest(about));
        }
        element.allow(&words::NODE)?;
        let level = open.len();
        let deepest = self.nodes.len() - 1;
        let Some(nodes) = self.nodes.get_mut(level) else {
            return Err(element.error(format!(
                "is below the deepest level, {deepest}, that VolumeXSize and DeltaX give"
            )));
        };
        let index = nodes.len();
        match open.last_mut() {
            None if index > 0 => return Err(element.error("a second root node")),
            None => {}
            Some(parent) if parent.node_type == NodeType::LeafConst => {
                return Err(element.error("the node around it is LEAF-CONST, which has no children"));
            }
            Some(parent) if parent.children == 8 => {
                return Err(element.error("a ninth child (nodes have none or eight)"));
            }
            Some(parent) => {
                parent.children += 1;
            }
        }
        let node_type = element.required("Type")?.choice(&TYPES)?;
        let color = element.optional("Color").map(parse_color).transpose()?;
        let data = if node_type == NodeType::NonConst {
            NodeData::Brick(self.brick(&element, level)?)
        } else if let Some(brick) = element.optional("Brick") {
            return Err(brick.error("stands on a constant node"));
        } else {
            NodeData::Constant(color.unwrap_or_default())
        };
        self.nodes[level].push(Node::new(None, data));
        Ok(Open {
            element,
            node_type,
            color,
            index,
            children: 0,
        })
    }

    fn brick(&mut self, element: &Element, level: usize) -> Result<u32, FormatError> {
        if !self.has_bricks {
            return Err(element.error("is NON-CONST in a tree with Binary=\"NO\", which has no brick files"));
        }
        if let Some(color) = element.optional("Color") {
            return Err(color.error("stands on a NON-CONST node"));
        }
        let attribute = element.required("Brick")?;
        let expected = self.bricks[level];
        if attribute.integer::<u32>()? != expected {
            return Err(attribute.error(format!(
                "is out of order, the next brick of level {level} is {expected}"
            )));
        }
        self.bricks[level] += 1;
        Ok(expected)
    }

    /// Completes a node of a level, whose children, if any, are the last ones of the next level.
    fn close(&mut self, open: &Open, level: usize) -> Result<(), FormatError> {
        let data = self.nodes[level][open.index].data();
        match open.children {
            0 if open.node_type == NodeType::NonConst => return Ok(()),
            0 => return open.element.required("Color").map(|_| ()),
            8 => {}
            n => {
                return Err(open
                    .element
                    .error(format!("has {n} children (nodes have none or eight)")));
            }
        }
        let first = self.nodes[level + 1].len() - 8;
        let data = match data {
            NodeData::Constant(_) if open.color.is_none() => {
                let mean = mean_color(&self.nodes[level + 1][first..]);
                NodeData::Constant(mean.ok_or_else(|| {
                    open.element
                        .error("attribute Color is missing and cannot be the mean of NON-CONST children")
                })?)
            }
            data => data,
        };
        self.nodes[level][open.index] = Node::new(Some((first / 8) as u32), data);
        Ok(())
    }
}

/// The mean of what constant nodes store, taken in linear light; `None` if one has a brick.
fn mean_color(nodes: &[Node]) -> Option<[u8; 4]> {
    let mut sum = [0.0; 4];
    for node in nodes {
        let NodeData::Constant(color) = node.data() else {
            return None;
        };
        for (sum, v) in sum.iter_mut().zip(decode_color(color)) {
            *sum += v / nodes.len() as f64;
        }
    }
    let [r, g, b] = [sum[0], sum[1], sum[2]].map(|v| linear_to_srgb(v as f32));
    Some([r, g, b, (sum[3] * 255.0).round() as u8])
}

fn parse_header(root: &Element) -> Result<(TreeHeader, bool), FormatError> {
    if root.name != "GigaVoxelsOctTree" {
        return Err(root.error("unknown root element (GigaVoxelsOctTree expected)"));
    }
    root.allow(&words::OCTREE)?;
    if let Some(version) = root.optional("Version")
        && version.integer::<u32>()? != VERSION
    {
        return Err(version.error(format!("is an unknown version (this reads {VERSION})")));
    }
    parse_brick_size(root)?;
    let voxel_size = equal_metres(root, DELTA)?;
    let volume = equal_metres(root, VOLUME)?;
    let bricks = volume / voxel_size / f64::from(BRICK_VOXELS);
    let depth = bricks.log2().round();
    if !(0.0..=f64::from(MAX_DEPTH)).contains(&depth)
        || (bricks / depth.exp2() - 1.0).abs() > VOLUME_TOLERANCE
    {
        return Err(root.required(VOLUME[0])?.error(format!(
            "is not {BRICK_VOXELS}·2^depth times {}=\"{voxel_size}\" with a depth of 0 to {MAX_DEPTH}",
            DELTA[0]
        )));
    }
    let surface = |names: [&str; 3]| -> Result<UVec3, FormatError> {
        let [x, y, z] = names.map(|n| root.optional(n).map_or(Ok(0), Attribute::integer));
        Ok(UVec3::new(x?, y?, z?))
    };
    let header = TreeHeader {
        origin: DVec3::from(root.metres3(ORIGIN)?),
        voxel_size,
        depth: depth as u8,
        layout: root
            .optional("Layout")
            .map_or(Ok(SampleLayout::Centre), |a| a.choice(&LAYOUTS))?,
        gain: root
            .optional("Gain")
            .map_or(Ok(1), |a| a.choice(&[("1", 1), ("2", 2)]))?,
        surface_voxels: root.optional("SurfaceVoxels").map_or(Ok(0), Attribute::integer)?,
        surface_bounds: [surface(SURFACE[0])?, surface(SURFACE[1])?],
    };
    header.validate().map_err(|e| root.error(e.message))?;
    Ok((header, root.required("Binary")?.yes_no()?))
}

/// Three lengths that must be the same and above zero.
fn equal_metres(root: &Element, names: [&str; 3]) -> Result<f64, FormatError> {
    let values = root.metres3(names)?;
    for (name, v) in names.into_iter().zip(values) {
        if v <= 0.0 {
            return Err(root.required(name)?.error("is not above zero"));
        }
        if v != values[0] {
            return Err(root.required(name)?.error(format!("differs from {}", names[0])));
        }
    }
    Ok(values[0])
}

fn parse_color(attribute: &Attribute) -> Result<[u8; 4], FormatError> {
    let digits = attribute.value().strip_prefix('#').unwrap_or_default();
    if digits.len() == 8
        && digits.bytes().all(|b| b.is_ascii_hexdigit())
        && let Ok(rgba) = u32::from_str_radix(digits, 16)
    {
        return Ok(rgba.to_be_bytes());
    }
    Err(attribute
        .error("is not a colour (#rrggbbaa)")
        .suggest(words::example("Color")))
}

/// Writes a tree. Colours of all constant nodes are explicit, so that [`decode`] gives the same tree, bit for bit.
///
/// # Errors
/// If the tree breaks an invariant of [`crate::octree`].
pub fn encode(tree: &Octree) -> Result<String, FormatError> {
    tree.validate()?;
    let h = &tree.header;
    let has_bricks = tree.levels.iter().any(|nodes| count_bricks(nodes) > 0);
    let mut out = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<GigaVoxelsOctTree".to_string();
    write_text(&mut out, "Version", &VERSION.to_string());
    let lengths = [
        (ORIGIN, h.origin),
        (DELTA, DVec3::splat(h.voxel_size)),
        (VOLUME, DVec3::splat(h.side())),
    ];
    for (names, v) in lengths {
        for (name, v) in names.into_iter().zip(v.to_array()) {
            write_f64(&mut out, name, v);
        }
    }
    for name in BRICK_SIZE {
        write_text(&mut out, name, &BRICK_VOXELS.to_string());
    }
    write_text(&mut out, "Binary", if has_bricks { "YES" } else { "NO" });
    for (name, layout) in LAYOUTS {
        if layout == h.layout {
            write_text(&mut out, "Layout", name);
        }
    }
    write_text(&mut out, "Gain", &h.gain.to_string());
    write_text(&mut out, "SurfaceVoxels", &h.surface_voxels.to_string());
    for (names, corner) in SURFACE.into_iter().zip(h.surface_bounds) {
        for (name, v) in names.into_iter().zip(corner.to_array()) {
            write_text(&mut out, name, &v.to_string());
        }
    }
    out.push_str(">\n");
    write_nodes(&mut out, tree, 0, 0..1);
    out.push_str("</GigaVoxelsOctTree>\n");
    Ok(out)
}

/// Writes some siblings of a valid tree and what is below them.
fn write_nodes(out: &mut String, tree: &Octree, level: usize, siblings: std::ops::Range<usize>) {
    let indent = "  ".repeat(level + 1);
    for node in tree
        .levels
        .get(level)
        .and_then(|nodes| nodes.get(siblings))
        .unwrap_or_default()
    {
        out.push_str(&indent);
        out.push_str("<Node");
        match node.data() {
            NodeData::Brick(brick) => {
                write_text(out, "Type", "NON-CONST");
                write_text(out, "Brick", &brick.to_string());
            }
            NodeData::Constant(color) => {
                write_text(
                    out,
                    "Type",
                    if node.children().is_some() {
                        "CONST"
                    } else {
                        "LEAF-CONST"
                    },
                );
                write_text(out, "Color", &format!("#{:08x}", u32::from_be_bytes(color)));
            }
        }
        if let Some(tile) = node.children() {
            out.push_str(">\n");
            write_nodes(out, tree, level + 1, tile as usize * 8..tile as usize * 8 + 8);
            out.push_str(&indent);
            out.push_str("</Node>\n");
        } else {
            out.push_str("/>\n");
        }
    }
}
