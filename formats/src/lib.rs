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
//! `docs/formats.md` gives the byte diagrams.

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
