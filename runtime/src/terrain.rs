//! A terrain as opened: the scene read through a store, its scene graph for the culler, and the names of its trees.

use std::sync::Arc;

use brickfell_culler::{Aabb, GroupId, SceneBuilder, SceneGraph, TreeId};
use brickfell_formats::bricks;
use brickfell_formats::chunk::Layers;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::scene::{Group, PagedOctTree, Scene};
use brickfell_formats::{FormatError, octree_binary};
use brickfell_pager::Store;
pub use brickfell_pager::store::SCENE_FILE;

/// A scene that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum TerrainError {
    /// The scene file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// Which file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A file cannot be used.
    #[error("{path}: {source}")]
    Format {
        /// Which file.
        path: String,
        /// What is wrong and where.
        source: FormatError,
    },
    /// Bounds that no culler can use.
    #[error("{path}: {message}")]
    Bounds {
        /// Which file.
        path: String,
        /// What is wrong.
        message: String,
    },
}

/// An opened terrain. Tree `TreeId(k)` is the k-th `PagedOctTree` of the scene, depth first; coarse trees have the ids after
/// those, in the same order.
#[derive(Debug)]
pub struct Terrain {
    /// The scene as written.
    pub scene: Scene,
    /// Tree files, by [`TreeId`].
    pub trees: Vec<String>,
    /// Files of coarse trees, by [`TreeId`] less the number of trees.
    pub coarse_trees: Vec<String>,
    /// For the culler.
    pub graph: SceneGraph,
    /// Where samples lie in the bricks of the first readable tree; a scene has one layout.
    pub layout: SampleLayout,
    /// What the pools must hold of a sample: what the first root brick that can be read has. A scene's trees agree, else
    /// opacities against the axes are left out and the largest of them counts.
    pub layers: Layers,
    /// Whether the scene says of all its trees that their bricks are block-compressed.
    pub compressed: bool,
    /// Trees that could not be placed, one line each; they are left out of the graph.
    pub faults: Vec<String>,
}

/// Reads a tree's header, from a binary or an XML file.
///
/// # Errors
/// If the file cannot be read or is not an octree file.
pub fn read_header(store: &dyn Store, name: &str) -> Result<TreeHeader, TerrainError> {
    let read = |source| TerrainError::Read {
        path: store.describe(name),
        source,
    };
    let format = |source| TerrainError::Format {
        path: store.describe(name),
        source,
    };
    let len = store.len(name).map_err(read)?;
    let prefix = store
        .read(name, 0, len.min(octree_binary::prefix_len() as u64) as usize)
        .map_err(read)?;
    if octree_binary::is_binary(&prefix) {
        return Ok(octree_binary::decode_header(&prefix, len).map_err(format)?.header);
    }
    let bytes = store.read(name, 0, len as usize).map_err(read)?;
    Ok(brickfell_formats::octree::decode_any(&bytes)
        .map_err(format)?
        .header)
}

/// What is stored of the samples of a tree's root brick, if there is a readable one.
fn root_layers(store: &dyn Store, tree: &str) -> Option<Layers> {
    let name = bricks::brick_file_name(tree, 0);
    let len = store.len(&name).ok()?;
    let head = store
        .read(&name, 0, len.min(bricks::HEADER_BYTES as u64) as usize)
        .ok()?;
    Some(bricks::decode_header(&head, len).ok()?.layers)
}

impl Terrain {
    /// The file of a tree of any kind, empty if there is none with this id.
    pub fn file(&self, tree: TreeId) -> &str {
        let files = self.trees.iter().chain(&self.coarse_trees);
        files.map(String::as_str).nth(tree.0 as usize).unwrap_or_default()
    }

    /// Reads `scene.xml` and, where it gives no bounds, the trees' headers.
    ///
    /// # Errors
    /// If the scene file itself cannot be used. Single trees that cannot be placed are [`Terrain::faults`].
    pub fn open(store: &Arc<dyn Store>) -> Result<Self, TerrainError> {
        let path = store.describe(SCENE_FILE);
        let read = |source| TerrainError::Read {
            path: path.clone(),
            source,
        };
        let len = store.len(SCENE_FILE).map_err(read)?;
        let bytes = store.read(SCENE_FILE, 0, len as usize).map_err(read)?;
        let (scene, faults) = Scene::parse_usable(&bytes).map_err(|source| TerrainError::Format {
            path: path.clone(),
            source,
        })?;
        let faults = faults.iter().map(|fault| format!("{path}: {fault}")).collect();
        let trees: Vec<String> = scene.trees().map(|t| t.tree_file.clone()).collect();
        let layout = trees
            .iter()
            .find_map(|name| read_header(store.as_ref(), name).ok())
            .map_or(SampleLayout::Centre, |h| h.layout);
        let layers = trees
            .iter()
            .find_map(|name| root_layers(store.as_ref(), name))
            .unwrap_or_default();
        let coarse_trees = scene.coarse_trees().map(|c| c.tree.tree_file.clone()).collect();
        let compressed = all_compressed(&scene.root);
        let mut opening = Opening {
            store: store.as_ref(),
            builder: SceneGraph::builder(),
            next: 0,
            next_coarse: trees.len() as u32,
            faults,
        };
        opening
            .add_group(None, &scene.root)
            .map_err(|message| TerrainError::Bounds {
                path: path.clone(),
                message,
            })?;
        let (graph, faults) = (opening.builder.finish(), opening.faults);
        Ok(Self {
            scene,
            trees,
            coarse_trees,
            graph,
            layout,
            layers,
            compressed,
            faults,
        })
    }
}

/// Whether every group that has trees is compressed, and there is one.
fn all_compressed(root: &Group) -> bool {
    let (mut groups, mut any) = (vec![root], false);
    while let Some(group) = groups.pop() {
        if !(group.trees.is_empty() && group.coarse.is_empty()) {
            any = true;
            if !group.compressed {
                return false;
            }
        }
        groups.extend(&group.groups);
    }
    any
}

struct Opening<'a> {
    store: &'a dyn Store,
    builder: SceneBuilder,
    next: u32,
    next_coarse: u32,
    faults: Vec<String>,
}

impl Opening<'_> {
    fn add_group(&mut self, parent: Option<GroupId>, group: &Group) -> Result<(), String> {
        let id = self.builder.add_group(parent).map_err(|e| e.to_string())?;
        // Numbers the trees as `Scene::trees` lists them: a group's own, then those of its groups.
        for tree in &group.trees {
            let tree_id = TreeId(self.next);
            self.next += 1;
            if let Some(bounds) = self.place(tree) {
                let added = self.builder.add_tree(Some(id), tree_id, bounds);
                added.map_err(|e| e.to_string())?;
            }
        }
        for coarse in &group.coarse {
            let tree_id = TreeId(self.next_coarse);
            self.next_coarse += 1;
            if let Some(bounds) = self.place(&coarse.tree) {
                let added = self.builder.add_coarse(id, tree_id, bounds, coarse.voxel);
                added.map_err(|e| e.to_string())?;
            }
        }
        group
            .groups
            .iter()
            .try_for_each(|inner| self.add_group(Some(id), inner))
    }

    /// The box of a tree of any kind, or a fault.
    fn place(&mut self, tree: &PagedOctTree) -> Option<Aabb> {
        self.bounds(tree).map_err(|fault| self.faults.push(fault)).ok()
    }

    fn bounds(&self, tree: &PagedOctTree) -> Result<Aabb, String> {
        let [min, max] = match tree.bounds {
            Some(b) => [b.min, b.max],
            None => read_header(self.store, &tree.tree_file)
                .map_err(|e| e.to_string())?
                .bounds(),
        };
        Aabb::new(min, max).map_err(|e| format!("{}: {e}", tree.tree_file))
    }
}
