//! Database pager of a brickfell terrain: brings pages of trees from a store into memory while they are being seen, keeps
//! them within a byte budget, and never lets the render thread wait.
//!
//! # A frame
//!
//! The render thread owns the [`Pager`] and, once a frame, in this order:
//!
//! 1. [`Pager::merge`] publishes what was loaded, parents before children;
//! 2. [`Pager::request`] and [`Pager::touch`] say what the frame lacks and what it uses;
//! 3. [`Pager::submit`] hands the requests to the loader threads, most urgent first. What was asked for earlier and not
//!    again leaves the queue; what the budget needs is evicted.
//!
//! Here over a terrain that is made as it is read, with a loop that has nothing to draw and waits:
//!
//! ```
//! use std::{sync::Arc, time::Duration};
//!
//! use brickfell_culler::TreeId;
//! use brickfell_formats::scene::Scene;
//! use brickfell_pager::{PageKey, Pager, PagerConfig, ProceduralConfig, ProceduralStore, Store};
//!
//! let store = Arc::new(ProceduralStore::new(ProceduralConfig { extent: 256.0, ..Default::default() })?);
//! let scene = store.read("scene.xml", 0, store.len("scene.xml")? as usize)?;
//! let trees = Scene::parse(&scene)?.trees().map(|tree| tree.tree_file.clone()).collect();
//!
//! let mut pager = Pager::new(store, trees, PagerConfig::default());
//! let wanted = PageKey::Level { tree: TreeId(0), level: 2 };
//! for frame in 1.. {
//!     pager.merge(frame);
//!     if pager.tree(TreeId(0)).is_some_and(|tree| tree.level(2).is_some()) {
//!         break;
//!     }
//!     pager.request(wanted, 0.0);
//!     pager.submit();
//!     pager.wait_for_progress(Duration::from_secs(1));
//! }
//! let tree = pager.tree(TreeId(0)).ok_or("not there")?;
//! assert_eq!(tree.level(2).map(|page| page.nodes.len() % 8), Some(0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The example `own_store` (`examples/pager`) has a [`Store`] of its own, reads samples, and runs out of budget.
//!
//! # Pages
//!
//! See [`PageKey`]: the root of a tree, the nodes of a level, a chunk of bricks. A coarse tree of a group is a tree like any other
//! here; who draws it in place of what is inside asks for and touches the one and not the others.
//!
//! ```text
//!            request            a loader takes it        read, checked        parent resident
//!  absent ----------> requested ---------------> loading ------------> ready ----------------> resident
//!    ^                  |    ^                      |                    |                        |
//!    |  not renewed     |    | asked again          | error              | parent gone            | evicted
//!    +------------------+    | after the delay      v                    |                        |
//!    |                       +------------------- failed                 |                        |
//!    |                                              | too many attempts  |                        |
//!    |                                              v                    |                        |
//!    |                                          given up, one fault      |                        |
//!    +-------------------------------------------------------------------+------------------------+
//! ```
//!
//! A result is matched to its request by slot and generation; one that comes in for a page that was given up meanwhile is
//! dropped. Resident pages are closed under parents: a chunk's level and all coarser levels and the root are resident.
//!
//! # Threads
//!
//! - The render thread calls everything on the [`Pager`]. No call but [`Pager::wait_for_progress`] waits for a loader; the
//!   one lock shared with them is held for moments, never across a read, a decode or the drop of a page.
//! - Loader threads read, verify, decode, and drop evicted pages. At most all but one of them read the same file at a time.
//! - [`TreeState`], [`RootPage`], [`LevelPage`] and chunks are immutable and may be held by any thread for any time; what is
//!   held after its eviction is no longer counted.
//! - Dropping the pager ends the loaders. One that hangs in a read is left behind and ends when its read returns.
//!
//! # Budget
//!
//! [`PagerConfig::budget_bytes`] bounds resident pages, finished ones, loads under way by their estimate (compressed and
//! decoded), evicted pages that are not dropped yet, and the queue, together; a load that would exceed it is not begun, and one
//! that turns out larger is thrown away. A sixteenth is kept for roots of trees in use, without which nothing could be shown.
//! Not counted are the snapshots' own pointers, the page table, and up to 1.3 MiB per loader while it decodes. When
//! requests and pages in use do not fit, the most urgent are served, the others are deferred, and [`Pager::over_budget`] says
//! by how much the level of detail has to fall; at rest nothing is loaded or evicted then.
//!
//! # Errors
//!
//! A [`Store`] may fail, be slow or give damaged bytes. A page that cannot be had is tried again after [`PagerConfig::retry`], and given up
//! after [`PagerConfig::max_attempts`] with one [`PageFault`], which names the object; the rest of the terrain stays. Nothing here
//! panics on what a store gives.
//!
//! [docs/paging.md](https://github.com/brickfell/brickfell/blob/main/docs/paging.md) has what is asked for when, and by whom.

mod exchange;
mod load;
mod loader;
mod lookahead;
mod lru;
pub mod page;
mod pager;
pub mod queue;
#[cfg(test)]
mod shuttle_tests;
pub mod store;
mod sync;
mod table;
#[cfg(test)]
mod testing;
pub mod tree;

pub use lookahead::Lookahead;
pub use page::{Bricks, ChunkPage, LevelPage, PageKey, RootPage};
pub use pager::{LoadedBytes, PageFault, Pager, PagerConfig, PagerStats};
pub use store::{Fault, FolderStore, MemoryStore, ProceduralConfig, ProceduralError, ProceduralStore, Store};
pub use tree::{Found, Stop, TreeState};
