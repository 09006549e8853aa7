//! Nodes of a level: what each is, by its siblings and by the tile before.
//!
//! Tiles of children and bricks are numbered in order, so only whether a node has them is told, and the colour of a
//! constant that is neither nothing nor the colour told last.

use super::coder::{Coder, Decoder, Encoder, Model, STATES, residual};
use crate::error::FormatError;
use crate::octree::{BRICK, Node, NodeData};

/// So many nodes take a byte at least, so that what a reader allocates is bounded by the file's length; zeros are appended
/// where less would do.
const NODES_PER_BYTE: u64 = 64;

/// Least and most bytes that so many nodes take: a node has five symbols at most, and eight bits after four of them.
pub(crate) fn packed_nodes_bytes(nodes: u32) -> [u64; 2] {
    let nodes = u64::from(nodes);
    [nodes.div_ceil(NODES_PER_BYTE), STATES as u64 + 16 * nodes]
}

/// Kinds of data: a brick, nothing, the colour told last, another one.
const NOTHING: usize = 1;
const LAST: usize = 2;
const OTHER: usize = 3;
/// Bit of a kind: the node has children.
const CHILDREN: usize = 4;
const KINDS: usize = 8;

/// What nodes of a level are expected to be.
struct Nodes {
    /// By which of the siblings before are nothing, behind a leading one.
    siblings: Vec<Model>,
    /// By octant, and the kinds of the sibling before and of the node in the tile before.
    kinds: Vec<Model>,
    colors: [Model; 4],
    /// The tile before.
    tile: [usize; 8],
    last: [u8; 4],
    /// Of tiles of children and bricks so far.
    counts: [u32; 2],
}

impl Nodes {
    fn new() -> Self {
        Self {
            siblings: vec![Model::default(); 256],
            kinds: vec![Model::default(); 8 * KINDS * KINDS],
            colors: [Model::default(); 4],
            tile: [0; 8],
            last: [0; 4],
            counts: [0; 2],
        }
    }

    /// Codes a tile, or the root.
    fn tile<C: Coder>(&mut self, coder: &mut C, nodes: &mut [Node]) {
        let (mut empty, mut before) = (1, 0);
        for (octant, node) in nodes.iter_mut().enumerate() {
            let context = (octant * KINDS + before) * KINDS + self.tile[octant];
            let goal = if C::ENCODES { self.kind(*node) } else { 0 };
            let models = [&mut self.siblings[empty], &mut self.kinds[context]];
            let kind = coder.by(models, goal) % KINDS;
            *node = self.node(coder, kind, *node);
            empty = empty << 1 | usize::from(kind == NOTHING);
            (before, self.tile[octant]) = (kind, kind);
        }
    }

    fn kind(&self, node: Node) -> usize {
        let data = match node.data() {
            NodeData::Brick(_) => 0,
            NodeData::Constant([0, 0, 0, 0]) => NOTHING,
            NodeData::Constant(color) if color == self.last => LAST,
            NodeData::Constant(_) => OTHER,
        };
        data + node.children().map_or(0, |_| CHILDREN)
    }

    fn node<C: Coder>(&mut self, coder: &mut C, kind: usize, goal: Node) -> Node {
        let data = match kind % CHILDREN {
            NOTHING => NodeData::Constant([0; 4]),
            LAST => NodeData::Constant(self.last),
            OTHER => {
                let goal = goal.data.to_le_bytes();
                for (k, model) in self.colors.iter_mut().enumerate() {
                    let off = goal[k].wrapping_sub(self.last[k]).cast_signed();
                    let off = residual(coder, [model], off).cast_unsigned();
                    self.last[k] = self.last[k].wrapping_add(off);
                }
                NodeData::Constant(self.last)
            }
            _ => NodeData::Brick(next(&mut self.counts[1])),
        };
        let children = (kind >= CHILDREN).then(|| next(&mut self.counts[0]) & (BRICK - 1));
        Node::new(children, data)
    }
}

fn next(count: &mut u32) -> u32 {
    let number = *count;
    *count = number.wrapping_add(1);
    number
}

/// Nodes of a level whose tiles and bricks are numbered in order, as bytes.
pub(crate) fn encode_nodes(nodes: &[Node]) -> Vec<u8> {
    let mut coder = Encoder::new();
    let mut model = Nodes::new();
    for tile in nodes.to_vec().chunks_mut(8) {
        model.tile(&mut coder, tile);
    }
    let mut bytes = coder.finish();
    let least = nodes.len().div_ceil(NODES_PER_BYTE as usize);
    if bytes.len() < least {
        bytes.resize(least.next_multiple_of(2), 0);
    }
    bytes
}

/// Reads so many nodes.
///
/// # Errors
/// If there are more than the bytes may stand for, or the nodes do not end with the bytes.
pub(crate) fn decode_nodes(bytes: &[u8], count: u32) -> Result<Vec<Node>, FormatError> {
    if packed_nodes_bytes(count)[0] > bytes.len() as u64 {
        return Err(FormatError::file(format!(
            "{count} nodes in {} bytes are too many",
            bytes.len()
        )));
    }
    let mut coder = Decoder::new(bytes);
    let mut model = Nodes::new();
    let mut nodes = vec![Node::constant([0; 4]); count as usize];
    for tile in nodes.chunks_mut(8) {
        model.tile(&mut coder, tile);
    }
    if coder.is_done_but_for_zeros() {
        return Ok(nodes);
    }
    Err(FormatError::file("packed nodes do not end where their bytes do"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_are_all_alike_take_no_less_than_a_reader_accepts() {
        let nodes = vec![Node::constant([0; 4]); 1 << 16];
        let bytes = encode_nodes(&nodes);
        assert_eq!(bytes.len() as u64, (1 << 16) / NODES_PER_BYTE);
        assert_eq!(decode_nodes(&bytes, 1 << 16).unwrap(), nodes);
        assert!(decode_nodes(&bytes, 1 + (1 << 16)).is_err());
        assert!(decode_nodes(&[&bytes[..], &[0, 1]].concat(), 1 << 16).is_err());
        assert!(decode_nodes(&bytes[..4], 8).is_err());
    }
}
