//! File formats of a brickfell terrain: scene XML, octree files (XML and binary) and brick files.
//!
//! The crate takes and gives bytes and values, never paths: who opens files puts the path in front of an error.
//! Nothing here starts threads; every function may be called from any thread.
//!
//! | module | what |
//! |---|---|
//! | [`scene`] | the scene graph as authored or built: `OctTreeGroup`, `PagedOctTree` |
//! | [`octree`] | one tree in memory: header, levels of node tiles, look-up |
//! | [`octree_binary`], [`octree_xml`] | its two files, convertible without loss |
//! | [`bricks`] | the brick file of one level: header, chunk directory, checksums |
//! | [`chunk`] | a chunk's payload: the samples of neighbouring bricks, encoded |
//! | [`blocks`] | the same as blocks that graphics hardware reads |
//! | [`layout`] | where samples lie in a brick (9³ corners or 10³ centres) |
//! | [`value`] | what a stored sample means: colour, opacity, normal |
//! | [`occupancy`] | where a brick shows anything |
//! | [`morton`] | the order of nodes, bricks and chunks |
//!
//! # A tree, written and read
//!
//! ```
//! use brickfell_formats::octree::{self, Node, NodeData, Octree, TreeHeader};
//! use brickfell_formats::{layout::SampleLayout, octree_binary, octree_xml};
//! use glam::{DVec3, UVec3};
//!
//! // A cube of 16 m whose lower half is grey and opaque: a root, and the eight nodes below it.
//! let (clear, grey) = (Node::constant([0; 4]), Node::constant([128, 128, 128, 255]));
//! let root = Node::new(Some(0), NodeData::Constant([64, 64, 64, 128]));
//! let tree = Octree {
//!     header: TreeHeader {
//!         origin: DVec3::new(600_000.0, 4_800_000.0, 0.0),
//!         voxel_size: 1.0,
//!         depth: 1,
//!         layout: SampleLayout::Centre,
//!         gain: 1,
//!         surface_voxels: 16 * 16,
//!         surface_bounds: [UVec3::ZERO, UVec3::new(16, 16, 8)],
//!     },
//!     levels: vec![vec![root], vec![grey, grey, grey, grey, clear, clear, clear, clear]],
//! };
//! let (binary, xml) = (octree_binary::encode(&tree)?, octree_xml::encode(&tree)?);
//! assert_eq!(octree::decode_any(&binary)?, tree);
//! assert_eq!(octree::decode_any(xml.as_bytes())?, tree);
//!
//! // What is damaged is told by its place.
//! let error = octree::decode_any(&binary[..100]).unwrap_err();
//! assert!(!error.to_string().is_empty());
//! # Ok::<(), brickfell_formats::FormatError>(())
//! ```
//!
//! # Invariants
//!
//! - What is read was checked: nodes and bricks are numbered as the files' order says, checksums match, sizes fit the file. Nothing is
//!   allocated before the size that a file claims was held against the file itself and against limits.
//! - What is encoded and decoded again is equal, but for blocks, the one encoding with a loss. The same values give the same bytes.
//! - All numbers are little-endian; a reader refuses versions, layouts, layers and encodings that it does not know.
//!
//! # Errors
//!
//! One type, [`FormatError`]: what is wrong, and the byte or the line and column where. Bytes from anywhere make errors, never
//! panics; the decoders are fuzzed (`formats/fuzz`).
//!
//! [docs/formats.md](https://github.com/brickfell/brickfell/blob/main/docs/formats.md) has every file to the byte.

pub mod blocks;
pub mod bricks;
pub mod chunk;
pub mod error;
pub mod layout;
pub mod morton;
pub mod occupancy;
pub mod octree;
pub mod octree_binary;
pub mod octree_xml;
mod pack;
pub mod scene;
pub mod steps;
pub mod value;
mod words;
mod xml;

pub use error::{FormatError, Place};
pub use pack::{Costs, Part};
pub use words::nearest;
