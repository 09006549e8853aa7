//! A terrain behind a store, with the GPU renderer and the reference on it.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use brickfell::holes::count_holes;
use brickfell_culler::Camera;
use brickfell_formats::blocks::Between;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::Device;
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::picture::{Picture, RayCounters};
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{FrameReport, Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::DVec3;

use crate::pictures::{Bound, assert_alike, disagreements};

/// Pools that hold everything the tests draw, unless a test asks for less.
pub const GPU_BUDGET: u64 = 160 << 20;

/// The one device of the test process.
///
/// # Panics
/// If there is none: pictures cannot be tested without.
pub fn gpu() -> Arc<Gpu> {
    static GPU: OnceLock<Arc<Gpu>> = OnceLock::new();
    Arc::clone(GPU.get_or_init(|| Gpu::open().unwrap()))
}

/// A terrain.
#[derive(Clone)]
pub struct World {
    /// Where it is.
    pub store: Arc<dyn Store>,
    /// Its tree files.
    pub trees: Vec<String>,
    /// Keeps what it read.
    reference: Arc<Reference>,
}

/// One picture by both casters.
#[derive(Clone, Debug)]
pub struct Both {
    /// The GPU's, settled.
    pub gpu: Picture,
    /// The reference's.
    pub reference: Picture,
}

impl Both {
    /// Both with their names, for what must hold for each.
    pub fn each(&self) -> [(&'static str, &Picture); 2] {
        [("GPU", &self.gpu), ("reference", &self.reference)]
    }
}

impl World {
    /// The terrain of a store.
    ///
    /// # Panics
    /// If it cannot be opened without a fault.
    pub fn new(store: Arc<dyn Store>) -> Self {
        let terrain = Terrain::open(&store).unwrap();
        assert!(terrain.faults.is_empty(), "{:?}", terrain.faults);
        let mut reference = Reference::open(Arc::clone(&store), &terrain.scene).unwrap();
        if terrain.compressed && gpu().info.driver == "llvmpipe" {
            reference = reference.with_blocks(Between::Floored);
        }
        Self {
            reference: Arc::new(reference),
            store,
            trees: terrain.trees,
        }
    }

    /// The terrain in a folder.
    ///
    /// # Panics
    /// If it cannot be opened without a fault.
    pub fn open(folder: &Path) -> Self {
        Self::new(Arc::new(FolderStore::open(folder).unwrap()))
    }

    /// The same with a reference that reads blocks to the nearest code, as the CPU caster does, instead of as the device does.
    ///
    /// # Panics
    /// If it cannot be opened.
    pub fn read_to_nearest(self) -> Self {
        let terrain = Terrain::open(&self.store).unwrap();
        let reference = Reference::open(Arc::clone(&self.store), &terrain.scene).unwrap();
        Self {
            reference: Arc::new(reference),
            ..self
        }
    }

    /// A renderer with pools for everything.
    pub fn renderer(&self) -> Renderer {
        self.renderer_within(GPU_BUDGET)
    }

    /// A renderer with pools of so many bytes.
    ///
    /// # Panics
    /// If the device has no room.
    pub fn renderer_within(&self, gpu_budget: u64) -> Renderer {
        self.renderer_with(RendererConfig {
            gpu_budget,
            ..RendererConfig::default()
        })
    }

    /// A renderer with these budgets.
    ///
    /// # Panics
    /// If the device has no room.
    pub fn renderer_with(&self, config: RendererConfig) -> Renderer {
        let terrain = Terrain::open(&self.store).unwrap();
        Renderer::new(gpu(), Arc::clone(&self.store), terrain, config).unwrap()
    }

    /// A renderer that draws with the CPU, with pools that hold as many bricks as a GPU's of so many bytes.
    ///
    /// # Panics
    /// If there is no room.
    pub fn cpu_renderer_within(&self, gpu_budget: u64) -> Renderer {
        let config = RendererConfig {
            gpu_budget: gpu_budget * 5 / 2,
            ..RendererConfig::default()
        };
        let terrain = Terrain::open(&self.store).unwrap();
        Renderer::new(Device::Cpu, Arc::clone(&self.store), terrain, config).unwrap()
    }

    /// The reference's picture.
    ///
    /// # Panics
    /// If it cannot draw, a ray ran into the step cap or a pixel is not a number.
    pub fn reference(&self, camera: &Camera, settings: &RenderSettings) -> Picture {
        let (picture, counters) = self.reference.render(camera, settings).unwrap();
        assert_sound(&counters);
        picture
    }

    /// Draws a settled picture, compares it with the reference's and returns both.
    ///
    /// # Panics
    /// If the pictures are farther apart than the bound, or hits differ outside the silhouettes, or the settled frame is
    /// not what settled means.
    pub fn check(
        &self,
        what: &str,
        renderer: &mut Renderer,
        camera: &Camera,
        settings: &RenderSettings,
        bound: Bound,
    ) -> Both {
        let (gpu, report) = settled(renderer, camera, settings);
        assert_eq!(
            report.bias, settings.bias,
            "{what}: the pool is meant to be large enough"
        );
        let reference = self.reference(camera, settings);
        assert_eq!(count_holes(&gpu, &reference), 0, "{what}: holes");
        assert_eq!(disagreements(&gpu, &reference), 0, "{what}: hits and misses");
        assert_alike(what, &gpu, &reference, bound);
        Both { gpu, reference }
    }
}

/// A level camera.
///
/// # Panics
/// If the numbers make none.
pub fn camera(eye: DVec3, target: DVec3, fov_degrees: f64, [width, height]: [u32; 2]) -> Camera {
    Camera::look_at(eye, target, fov_degrees, width, height).unwrap()
}

fn assert_sound(counters: &RayCounters) {
    assert_eq!((counters.capped, counters.not_finite), (0, 0), "{counters:?}");
}

/// Settles, and checks that the frame is at rest: nothing asked for, nothing on its way, no ray lost.
///
/// # Panics
/// If it is not.
pub fn settled(
    renderer: &mut Renderer,
    camera: &Camera,
    settings: &RenderSettings,
) -> (Picture, FrameReport) {
    let (report, _) = renderer.settle(camera, settings).unwrap();
    let picture = renderer.read_picture().unwrap();
    let feedback = renderer.feedback();
    assert_eq!(feedback.frame, report.frame);
    assert_eq!(
        (feedback.request_count, report.pending, report.trees_waiting),
        (0, 0, 0),
        "{report:?}"
    );
    assert_eq!(report.trees_active, report.trees_visible);
    assert_sound(&feedback.counters);
    assert!(renderer.faults().is_empty(), "{:?}", renderer.faults());
    (picture, report)
}
