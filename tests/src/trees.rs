//! A scene of small trees made in memory from closures.

use std::sync::Arc;

use brickfell_formats::octree::TreeHeader;
use brickfell_formats::scene::{Bounds, PagedOctTree, Scene};
use brickfell_formats::value::Stored;
use brickfell_runtime::terrain::SCENE_FILE;
pub use brickfell_runtime::testing::*;
use glam::{IVec3, UVec3};

use crate::world::World;

/// A scene in the making.
#[derive(Default)]
pub struct Maker {
    store: Store,
    scene: Scene,
}

impl Maker {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a tree, as [`Store::add`] does.
    ///
    /// # Panics
    /// If the tree cannot be written.
    #[must_use]
    pub fn tree(
        mut self,
        header: TreeHeader,
        kind: impl Fn(u8, UVec3) -> Kind,
        value: impl Fn(u8, IVec3) -> Stored,
    ) -> Self {
        let name = format!("tree{}.oct", self.scene.root.trees.len());
        self.store.add(&name, header, kind, value);
        let [min, max] = header.bounds();
        self.scene.root.trees.push(PagedOctTree {
            center: (min + max) * 0.5,
            radius: header.side(),
            bounds: Some(Bounds { min, max }),
            tree_file: name,
        });
        self
    }

    /// The finished scene.
    pub fn finish(self) -> World {
        let store = self.store.0;
        store.put(SCENE_FILE, self.scene.to_xml().into_bytes());
        World::new(Arc::new(store))
    }
}
