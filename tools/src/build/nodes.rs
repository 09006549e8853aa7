//! Which nodes of a tree have bricks and which are constant, level by level from the finest up, and the octree of them.
//!
//! A node is constant if and only if all its stored samples, apron included, are equal and without normal (or all are
//! deep solid, whose colours nobody sees) at its level and at all levels below. Only nodes that are near something are
//! looked at one by one; the rest lies in nothing or in the solid range of its column.

use std::ops::Range;

use rayon::prelude::*;

use brickfell_formats::FormatError;
use brickfell_formats::morton;
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, octant_offset};
use brickfell_formats::steps::Steps;
use glam::UVec3;

use super::ground::Hints;
use super::lattice::{Lattice, Region, SIDE, TreePlace};
use super::sample::stored_solid;
use super::texels::{Likeness, TexelLevel};

/// What is known about a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Brick,
    Constant { color: [u8; 4], deep: bool },
}

const EMPTY: State = State::Constant {
    color: [0; 4],
    deep: false,
};

/// Nodes above one another.
#[derive(Clone, Debug)]
pub(crate) struct NodeColumn {
    /// Nodes that were looked at, lowest first.
    pub(crate) known: Vec<(u32, State)>,
    /// Further nodes that are deep solid.
    pub(crate) solid: Range<u32>,
    /// Colour of deep solid nodes.
    pub(crate) color: [u8; 4],
}

/// The nodes of one level over a rectangle of columns.
#[derive(Clone, Debug)]
pub(crate) struct LevelNodes {
    pub(crate) lo: [u32; 2],
    pub(crate) size: [u32; 2],
    pub(crate) columns: Vec<NodeColumn>,
}

impl LevelNodes {
    /// Rectangles of nodes put together to one from (0, 0) on, `side` nodes wide. They cover it.
    pub(crate) fn joined(side: u32, parts: Vec<LevelNodes>) -> Self {
        let nothing = NodeColumn {
            known: Vec::new(),
            solid: 0..0,
            color: [0; 4],
        };
        let mut columns = vec![nothing; (side * side) as usize];
        for part in parts {
            for (k, column) in part.columns.into_iter().enumerate() {
                let k = k as u32;
                let (x, y) = (part.lo[0] + k % part.size[0], part.lo[1] + k / part.size[0]);
                columns[(y * side + x) as usize] = column;
            }
        }
        Self {
            lo: [0; 2],
            size: [side; 2],
            columns,
        }
    }

    fn column(&self, at: [u32; 2]) -> Option<&NodeColumn> {
        let [x, y] = [0, 1].map(|k| at[k].wrapping_sub(self.lo[k]));
        if x >= self.size[0] || y >= self.size[1] {
            return None;
        }
        self.columns.get((y * self.size[0] + x) as usize)
    }

    /// The state of a node.
    pub(crate) fn state(&self, p: UVec3) -> State {
        let Some(column) = self.column([p.x, p.y]) else {
            return EMPTY;
        };
        match column.known.binary_search_by_key(&p.z, |k| k.0) {
            Ok(k) => column.known[k].1,
            Err(_) if column.solid.contains(&p.z) => State::Constant {
                color: column.color,
                deep: true,
            },
            Err(_) => EMPTY,
        }
    }

    /// Nodes with bricks in Morton order.
    pub(crate) fn bricks(&self) -> Vec<UVec3> {
        let mut codes: Vec<u64> = Vec::new();
        for (k, column) in self.columns.iter().enumerate() {
            let k = k as u32;
            let (x, y) = (self.lo[0] + k % self.size[0], self.lo[1] + k / self.size[0]);
            let bricks = column.known.iter().filter(|n| n.1 == State::Brick);
            codes.extend(bricks.map(|n| morton::encode(UVec3::new(x, y, n.0))));
        }
        codes.sort_unstable();
        codes.into_iter().map(morton::decode).collect()
    }
}

/// The stored cube of a node: its first cell and its side.
pub(crate) fn node_cube(lattice: &Lattice, place: TreePlace, level: u8, node: UVec3) -> ([i64; 3], i64) {
    let mip = lattice.depth - level;
    let low = i64::from(lattice.layout.low_apron());
    let node = node.to_array().map(i64::from);
    let base = std::array::from_fn(|k| (place.origin[k] >> mip) + SIDE * node[k] - low);
    (base, i64::from(lattice.layout.side()))
}

/// Looks at the nodes that a region has of a level, given those of the next finer one (`None` at the deepest level).
pub(crate) fn level_nodes(
    lattice: &Lattice,
    place: TreePlace,
    region: &Region,
    level: u8,
    texels: &TexelLevel,
    hints: &Hints,
    finer: Option<&LevelNodes>,
) -> LevelNodes {
    let side = 1u32 << level;
    let own = region.cells(lattice.depth - level);
    let first = lattice.tree(place).cells(lattice.depth - level).lo;
    let lo = [0, 1].map(|k| ((own.lo[k] - first[k]) / SIDE) as u32);
    let size = [0, 1].map(|k| ((own.hi[k] - own.lo[k]) / SIDE) as u32);
    let columns = (0..size[0] * size[1])
        .into_par_iter()
        .map(|k| {
            let at = UVec3::new(lo[0] + k % size[0], lo[1] + k / size[0], 0);
            let (base, n) = node_cube(lattice, place, level, at);
            let (mut known, solid) = near(texels, base, n, side);
            for o in [0, 1, 2, 3].map(octant_offset) {
                let child = finer.and_then(|f| f.column([at.x * 2 + o.x, at.y * 2 + o.y]));
                known.extend(child.iter().flat_map(|c| c.known.iter().map(|n| n.0 / 2)));
            }
            known.sort_unstable();
            known.dedup();
            let low = i64::from(lattice.layout.low_apron());
            let hint = hints.mean([base[0] + low, base[1] + low], SIDE);
            let color = stored_solid(&hint, Steps::within(0)).color;
            let states = known.into_iter().map(|z| {
                let base = [base[0], base[1], base[2] + SIDE * i64::from(z)];
                let own = match texels.likeness(base, n) {
                    Likeness::Mixed => return (z, State::Brick),
                    Likeness::Equal(color) => State::Constant { color, deep: false },
                    Likeness::Deep => State::Constant { color, deep: true },
                };
                let alike = finer.is_none_or(|f| {
                    (0..8).all(|o| agree(own, f.state(UVec3::new(at.x, at.y, z) * 2 + octant_offset(o))))
                });
                (z, if alike { own } else { State::Brick })
            });
            NodeColumn {
                known: states.collect(),
                solid,
                color,
            }
        })
        .collect();
    LevelNodes { lo, size, columns }
}

fn agree(own: State, child: State) -> bool {
    match (own, child) {
        (
            State::Constant { color: a, deep },
            State::Constant {
                color: b,
                deep: child_deep,
            },
        ) => deep == child_deep && (deep || a == b),
        _ => false,
    }
}

/// Heights of the nodes of a column that may not be uniform, and the run of nodes that are deep solid.
fn near(texels: &TexelLevel, base: [i64; 3], n: i64, side: u32) -> (Vec<u32>, Range<u32>) {
    let blocks = |k: usize| base[k].div_euclid(SIDE)..(base[k] + n - 1).div_euclid(SIDE) + 1;
    let columns = || blocks(1).flat_map(|y| blocks(0).map(move |x| texels.blocks().column(x, y)));
    let solid = columns().fold(i64::MIN..i64::MAX, |s, c| {
        s.start.max(c.solid.start)..s.end.min(c.solid.end)
    });
    let solid = if solid.is_empty() { 0..0 } else { solid };
    let mut marked: Vec<i64> = Vec::new();
    for column in columns() {
        marked.extend(column.slots.iter().map(|s| s.0));
        marked.extend(column.solid.clone().filter(|z| !solid.contains(z)));
    }
    if !solid.is_empty() {
        marked.extend([solid.start, solid.end - 1]);
    }
    marked.sort_unstable();
    marked.dedup();
    let mut near = Vec::new();
    for block in marked {
        let first = (SIDE * block - base[2] - n).div_euclid(SIDE) + 1;
        let last = (SIDE * block + SIDE - 1 - base[2]).div_euclid(SIDE);
        near.extend((first.max(0)..=last.min(i64::from(side) - 1)).map(|z| z as u32));
    }
    let first = (SIDE * solid.start - base[2] + SIDE - 1)
        .div_euclid(SIDE)
        .clamp(0, i64::from(side));
    let end = ((SIDE * solid.end - n - base[2]).div_euclid(SIDE) + 1).clamp(first, i64::from(side));
    let run = if solid.is_empty() {
        0..0
    } else {
        first as u32..end as u32
    };
    (near, run)
}

/// The octree of all levels, coarsest first. `header` gives its properties.
///
/// # Errors
/// If a level has more nodes than the format can count.
pub(crate) fn octree(header: TreeHeader, levels: &[LevelNodes]) -> Result<Octree, FormatError> {
    let mut tree = Octree {
        header,
        levels: Vec::with_capacity(levels.len()),
    };
    let mut positions = vec![UVec3::ZERO];
    for (level, states) in levels.iter().enumerate() {
        let (mut tiles, mut bricks) = (0, 0);
        let mut nodes = Vec::with_capacity(positions.len());
        let mut children = Vec::new();
        for p in &positions {
            nodes.push(match states.state(*p) {
                State::Constant { color, .. } => Node::constant(color),
                State::Brick => {
                    let inner = level + 1 < levels.len();
                    let node = Node::new(inner.then_some(tiles), NodeData::Brick(bricks));
                    bricks += 1;
                    if inner {
                        tiles += 1;
                        children.extend((0..8).map(|o| *p * 2 + octant_offset(o)));
                    }
                    node
                }
            });
        }
        tree.levels.push(nodes);
        positions = children;
    }
    tree.validate()?;
    Ok(tree)
}
