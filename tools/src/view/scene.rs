//! The terrain that is flown over, as it is open: its renderer, the probe, and whether its file has changed.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use brickfell_culler::Aabb;
use brickfell_pager::Store;
use brickfell_runtime::Device;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::terrain::SCENE_FILE;
use winit::event_loop::EventLoopProxy;

use super::Woken;
use super::keep::Kept;
use super::probe::Probe;
use crate::commands::fly::data_bounds;
use crate::commands::view::Args;
use crate::commands::{CommandError, open_terrain};

/// How often a scene is looked at for changes.
const WATCH: Duration = Duration::from_millis(500);

/// A terrain that is flown over.
pub(super) struct Scene {
    store: Arc<dyn Store>,
    pub(super) renderer: Renderer,
    pub(super) probe: Probe,
    /// When the scene file was written, and when that was looked at.
    written: Option<SystemTime>,
    looked: Instant,
}

fn written(args: &Args) -> Option<SystemTime> {
    std::fs::metadata(args.dir.join(SCENE_FILE)).ok()?.modified().ok()
}

impl Scene {
    /// Opens the terrain, its pools and its probe, which wakes the window.
    ///
    /// # Errors
    /// If the scene is not sound, or the pools do not fit.
    pub(super) fn open(
        args: &Args,
        kept: &Kept,
        device: &Device,
        wake: &EventLoopProxy<Woken>,
    ) -> Result<Self, CommandError> {
        let written = written(args);
        let (store, terrain) = open_terrain(&args.dir)?;
        let scene = terrain.scene.clone();
        let top = terrain.graph.bounds().map_or(0.0, |b| b.max.z);
        let config = RendererConfig {
            ram_budget: kept.ram_bytes(),
            gpu_budget: kept.gpu_bytes(),
            ..RendererConfig::default()
        };
        let renderer = Renderer::new(device.clone(), Arc::clone(&store), terrain, config)?;
        let wake = wake.clone();
        let probe = Probe::new(Arc::clone(&store), scene, top, move || {
            // A window that is gone needs no answer.
            let _ = wake.send_event(Woken);
        });
        Ok(Self {
            store,
            renderer,
            probe,
            written,
            looked: Instant::now(),
        })
    }

    /// Whether the scene's file has been written since it was opened, or since this was true; looked at now and then.
    pub(super) fn has_changed(&mut self, args: &Args) -> bool {
        if self.looked.elapsed() < WATCH {
            return false;
        }
        self.looked = Instant::now();
        let written = written(args);
        let changed = written.is_some() && written != self.written;
        self.written = written.or(self.written);
        changed
    }

    /// What is to be looked at: the box of the surfaces in the trees, or of the trees.
    pub(super) fn bounds(&self) -> Option<Aabb> {
        let terrain = self.renderer.terrain();
        data_bounds(self.store.as_ref(), &terrain.trees).or(terrain.graph.bounds())
    }
}
