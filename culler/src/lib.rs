//! Scene graph, frustum culling and visibility order for paged terrain.
//!
//! Answers one question per frame: which trees does this camera see, and in which order does a ray meet them? It knows
//! neither files nor a GPU; it takes values and gives values, in f64 and world metres, Z up.
//!
//! # Quick reference
//!
//! | item | what it is |
//! |---|---|
//! | [`Camera`] | the one camera value for culling and drawing; pixels to rays and back |
//! | [`Aabb`] | box in world metres, half-open where a tree owns it |
//! | [`SceneGraph`], [`SceneBuilder`] | groups nested over trees, one flat array, bounds computed bottom-up |
//! | [`Visitor`] | a walk over all of it; [`Statistics`] is one |
//! | [`Expiry`] | which trees were not used for a while, at the cost of those in use |
//! | [`Frustum`], [`PlaneMask`] | box against the view pyramid; children test only what their group straddles |
//! | [`Culler`], [`CullResult`] | visible trees front to back, trees to prefetch, last-access frames |
//! | [`Cut`] | where groups are drawn by coarse trees of their own instead of by what is in them |
//! | [`precedence`] | which of two boxes must come first |
//! | [`overlapping_pairs`] | trees that have no order, for checking a scene |
//!
//! ```
//! use brickfell_culler::{Aabb, Camera, Culler, SceneGraph, TreeId};
//! use glam::dvec3;
//!
//! let mut builder = SceneGraph::builder();
//! let group = builder.add_group(None)?;
//! for x in 0..4 {
//!     let min = dvec3(f64::from(x) * 100.0, 0.0, 0.0);
//!     builder.add_tree(Some(group), TreeId(x), Aabb::new(min, min + 100.0)?)?;
//! }
//! let scene = builder.finish();
//! let camera = Camera::look_at(dvec3(250.0, -500.0, 50.0), dvec3(250.0, 0.0, 50.0), 20.0, 640, 480)?;
//! let mut culler = Culler::new();
//! let seen = culler.cull(&scene, &camera, 1);
//! let order: Vec<u32> = seen.visible.iter().map(|tree| tree.tree.0).collect();
//! assert_eq!(order, [2, 1, 3]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The example `cull` (`examples/culler`) goes on from there, with shadows and prefetching.
//!
//! # Invariants, threads, errors
//!
//! - A graph is made once and only read: any thread may share it. A [`Culler`] belongs to one thread, which calls it once a frame with
//!   the camera that draws the frame; after some frames it allocates nothing. The same arguments give the same result.
//! - Boxes are half-open, `min <= p < max`: a point in a face that two trees share is in one of them.
//! - Work follows what is in view, not the size of the scene.
//! - Boxes, cameras and ids that are no use are refused when they are made, by [`BoundsError`], [`CameraError`] and [`SceneError`], which
//!   say what and where; after that nothing fails.
//!
//! [docs/paging.md](https://github.com/brickfell/brickfell/blob/main/docs/paging.md) tells what the result is used for.
//!
//! # Why not sort by distance
//!
//! Compositing front to back needs the order in which rays meet the trees, and distance is something else: a near
//! corner of a long box can lie closer than a small box in front of it, and depth along the view axis is wrong even on a
//! regular grid. Here order is derived from planes that part the boxes (see [`precedence`]), which is exact, and a test proves it with rays.
//! Two things have no exact order: trees that overlap, and trees that hide each other in a cycle as three crossed
//! beams do. [`CullResult::order_exact`] then is false, and a caster that must be right lets each ray sort its trees.
//!
//! # Alternatives not taken
//!
//! - **Column order by cells** (`|dx| + |dy|` from the eye's cell) is exact and cheaper, but only on a regular grid;
//!   hand-written scenes and columns of mixed sizes are none. Planes that part boxes contain it as a special case.
//! - **A BSP tree built ahead** orders in linear time but cuts trees that no plane parts, and has to be rebuilt when
//!   the scene changes. Nested groups already are most of one.
//! - **Radix or merge sort by a key**: no key exists, since the relation is not a total preorder.
//! - **Bounding spheres** are cheaper per test, but a wide flat tree fills little of its sphere.
//! - **A near and a far plane**: nothing in the caster needs them, and their values were a source of errors.
//! - **f32 relative to a floating origin**: a cull is microseconds; it is not worth a second coordinate system.

mod bounds;
mod builder;
mod camera;
mod cull;
mod expiry;
mod frustum;
mod order;
mod scene;
mod sort;
#[cfg(test)]
mod testing;
mod visitors;

pub use bounds::{Aabb, BoundsError};
pub use builder::{SceneBuilder, SceneError};
pub use camera::{Camera, CameraError};
pub use cull::{CullResult, Culler, Cut, Readiness, VisibleTree};
pub use expiry::Expiry;
pub use frustum::{Containment, Frustum, PlaneMask};
pub use order::{Precedence, exact_precedence, never_aligned, overlapping_pairs, precedence};
pub use scene::{Descend, GroupId, GroupInfo, SceneGraph, TreeId, Visitor};
pub use visitors::Statistics;
