//! The generated demo terrain, smaller than the one that is flown, built by the builder once for each set of arguments.

use std::collections::HashMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use brickfell::build::{BuildArgs, Filter, HeightInput, Silent, build};
use brickfell::input::demo::{DemoInput, write_demo};
use brickfell::input::{HeightOptions, Layer, RasterCache, load_layers};
use brickfell_formats::chunk::Encoding;
use brickfell_formats::layout::SampleLayout;
use glam::DVec3;

use crate::world::World;

/// Side of the terrain, metres.
pub const SIZE: f64 = 64.0;
/// Side of a finest voxel, metres.
pub const VOXEL: f64 = 0.25;
const SEED: u64 = 3;

/// Voxels per axis of trees, layout, filter, and whether bricks are block-compressed.
type Kind = (u32, SampleLayout, Filter, bool);

/// The demo terrain in a folder that this process has for itself.
pub struct Demo {
    folder: PathBuf,
    /// Held until the process ends: another one that tests at the same time waits.
    _lock: File,
    input: DemoInput,
    ground: Layer,
    built: HashMap<Kind, World>,
}

impl Demo {
    /// Writes the input anew into a sub-folder of `folder` (give `env!("CARGO_TARGET_TMPDIR")`), and waits for other
    /// processes that use it.
    ///
    /// # Panics
    /// If it cannot be written.
    pub fn new(folder: &Path) -> Self {
        fs::create_dir_all(folder).unwrap();
        let lock = File::create(folder.join("demo.lock")).unwrap();
        lock.lock().unwrap();
        let folder = folder.join("demo");
        if folder.exists() {
            // What an earlier builder built does not count.
            fs::remove_dir_all(&folder).unwrap();
        }
        let input = write_demo(&folder.join("input"), SEED, SIZE).unwrap();
        let heights = HeightInput {
            path: input.heights.clone(),
            imagery: None,
        };
        let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, &folder);
        let ground = load_layers(&[heights], HeightOptions::default(), &cache)
            .unwrap()
            .remove(0);
        Self {
            folder,
            _lock: lock,
            input,
            ground,
            built: HashMap::new(),
        }
    }

    /// The terrain built with trees of so many voxels per axis.
    ///
    /// # Panics
    /// If the build fails or says that something is missing.
    pub fn world(&mut self, tree_voxels: u32, layout: SampleLayout) -> World {
        self.filtered_world(tree_voxels, layout, Filter::default())
    }

    /// The same by a filter.
    ///
    /// # Panics
    /// As [`Self::world`].
    pub fn filtered_world(&mut self, tree_voxels: u32, layout: SampleLayout, filter: Filter) -> World {
        self.made((tree_voxels, layout, filter, false))
    }

    /// The same with block-compressed bricks.
    ///
    /// # Panics
    /// As [`Self::world`].
    pub fn compressed_world(&mut self, tree_voxels: u32, layout: SampleLayout, filter: Filter) -> World {
        self.made((tree_voxels, layout, filter, true))
    }

    fn made(&mut self, kind: Kind) -> World {
        if let Some(world) = self.built.get(&kind) {
            return world.clone();
        }
        let (tree_voxels, layout, filter, compressed) = kind;
        let name = format!("{tree_voxels}-{layout:?}-{}-{compressed}", filter.name());
        let out = self.folder.join(name);
        let mut args = BuildArgs::new(&out);
        args.inputs = self.input.meshes.clone();
        args.heights = vec![HeightInput {
            path: self.input.heights.clone(),
            imagery: Some(self.input.imagery.clone()),
        }];
        args.voxel = Some(VOXEL);
        args.tree_voxels = tree_voxels;
        args.layout = layout;
        args.filter = filter;
        if compressed {
            args.encoding = Encoding::Blocks;
        }
        let report = build(&args, &Silent).unwrap();
        assert!(report.warnings.is_empty(), "{:?}", report.warnings);
        let world = World::open(&out);
        self.built.insert(kind, world.clone());
        world
    }

    /// The ground at a place, metres.
    ///
    /// # Panics
    /// Outside the terrain.
    pub fn ground(&self, x: f64, y: f64) -> f64 {
        self.ground.map.height_at(x, y).unwrap().unwrap()
    }

    /// A point so many metres above the ground.
    pub fn above(&self, x: f64, y: f64, height: f64) -> DVec3 {
        DVec3::new(x, y, self.ground(x, y) + height)
    }
}
