//! The frame loop: the one code that flies, renders and benches.
//!
//! A frame, on the render thread: take what read-backs arrived, publish finished loads, cull, make resident what
//! rays asked for, upload, cast, compact, start the next read-back. Nothing in [`Renderer::frame`] waits for a disk or for
//! the device. [`Renderer::settle`] repeats frames, and does wait, until a picture has all it asks for.

mod access;
mod report;
mod settle;

pub use report::FrameReport;

use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::{Camera, Culler, Cut, Expiry, Readiness, VisibleTree};
use brickfell_pager::{Lookahead, PageFault, PageKey, Pager, PagerConfig, Store};

use crate::backend::{Backend, Cast, Device, Drawn};
use crate::bias::BiasController;
use crate::caster::{Feedback, MAX_TREES, REQUEST_CAPACITY};
use crate::depth::Depths;
use crate::effort::{Cost, Effort, EffortController, Wanted};
use crate::error::RuntimeError;
use crate::memory::MAX_UPLOAD_BRICKS;
use crate::node_lists::{ActiveTree, NodeList, NodeListProcessors};
use crate::raster::Raster;
use crate::record::least_level;
use crate::settings::RenderSettings;
use crate::terrain::Terrain;
use crate::texture_pool::{TexturePoolManager, UploadBatch, priority};

/// Frames after which an unseen tree is released.
const TREE_KEEP_FRAMES: u64 = 300;
/// Milliseconds of a real-time frame that uploads may take, or the part of a cast if that is more: where casts are slow it would else
/// take long until the picture is sharp.
const UPLOAD_BUDGET_MS: f64 = 4.0;
/// See [`UPLOAD_BUDGET_MS`].
const UPLOAD_SHARE: f64 = 0.2;

/// Budgets and threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RendererConfig {
    /// Bytes that the pager may hold in RAM.
    pub ram_budget: u64,
    /// Bytes for the pools on the device.
    pub gpu_budget: u64,
    /// Threads that load.
    pub loader_threads: usize,
    /// Whether block-compressed bricks stay so, where the device can read them. Else the pager decodes them.
    pub keep_blocks: bool,
}

impl Default for RendererConfig {
    fn default() -> Self {
        Self {
            ram_budget: 1 << 30,
            gpu_budget: 512 << 20,
            loader_threads: 2,
            keep_blocks: true,
        }
    }
}

/// Draws a terrain.
#[derive(Debug)]
pub struct Renderer {
    backend: Backend,
    terrain: Terrain,
    culler: Culler,
    /// Decides what is drawn, instead of the camera that draws.
    frozen: Option<Camera>,
    pager: Pager,
    processors: NodeListProcessors,
    pool: TexturePoolManager,
    /// Of the last frame, for its memory.
    uploads: UploadBatch,
    bias: BiasController,
    effort: EffortController,
    depths: Depths,
    /// The last frame's.
    camera: Option<Camera>,
    frame: u32,
    /// Merges so far; several in a frame while settling.
    merges: u64,
    list: NodeList,
    feedback: Feedback,
    pending: usize,
    /// Frames whose read-back is not here yet.
    in_flight: Vec<InFlight>,
    /// One of so many tiles of pixels may ask in the next frame.
    request_share: u32,
    /// Of the last feedback, to resolve again when more levels are in RAM.
    feedback_trees: Arc<[ActiveTree]>,
    /// Trees whose roots are pinned.
    in_use: Expiry,
    lookahead: Lookahead,
    ms_per_brick: f64,
    faults: Vec<String>,
}

/// A frame that was submitted.
#[derive(Debug)]
struct InFlight {
    frame: u32,
    /// The trees that its requests name.
    trees: Arc<[ActiveTree]>,
    request_share: u32,
    /// How it was drawn, and its time on the render thread, if there is a time to keep.
    cost: Option<Cost>,
    uploaded: bool,
}

struct Prepared {
    report: FrameReport,
    raster: Raster,
    drawn: Vec<Drawn>,
    active: Vec<ActiveTree>,
    start: Instant,
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Keeps a tree's root, or asks for it; false while it has to be waited for.
fn use_root(pager: &mut Pager, tree: &VisibleTree) -> bool {
    let key = PageKey::Root(tree.tree);
    if pager.tree(tree.tree).is_some() {
        pager.touch(key);
        return true;
    }
    pager.request(key, tree.distance / (tree.distance + 1000.0) - 1.0);
    pager.is_failed(key)
}

impl Renderer {
    /// Opens the pools and starts the threads for a terrain.
    ///
    /// # Errors
    /// If the pools do not fit the budget or the device, or no thread can be started.
    pub fn new(
        device: impl Into<Device>,
        store: Arc<dyn Store>,
        terrain: Terrain,
        config: RendererConfig,
    ) -> Result<Self, RuntimeError> {
        let backend = Backend::new(device.into(), config.gpu_budget, &terrain, config.keep_blocks)?;
        let sizes = backend.sizes();
        let pager = Pager::new(
            store,
            (terrain.trees.iter().chain(&terrain.coarse_trees))
                .cloned()
                .collect(),
            PagerConfig {
                budget_bytes: config.ram_budget,
                threads: config.loader_threads,
                keep_blocks: sizes.blocks,
                ..Default::default()
            },
        );
        let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
        let processors = NodeListProcessors::new(cores.saturating_sub(2))
            .map_err(|e| RuntimeError::Device(format!("no thread can be started: {e}")))?;
        let faults = terrain.faults.clone();
        Ok(Self {
            backend,
            culler: Culler::new(),
            frozen: None,
            pager,
            processors,
            pool: TexturePoolManager::new(sizes),
            uploads: UploadBatch::default(),
            bias: BiasController::default(),
            effort: EffortController::default(),
            depths: Depths::default(),
            camera: None,
            frame: 0,
            merges: 0,
            list: NodeList::default(),
            feedback: Feedback::default(),
            pending: 0,
            in_flight: Vec::new(),
            request_share: 1,
            feedback_trees: Arc::from([]),
            in_use: Expiry::default(),
            lookahead: Lookahead::default(),
            ms_per_brick: 0.01,
            faults,
            terrain,
        })
    }

    /// Draws one picture with what is there, without waiting for anything.
    ///
    /// # Errors
    /// If no picture can be made of the camera and the settings, or not of this size, or the device failed.
    pub fn frame(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<FrameReport, RuntimeError> {
        let budget = UPLOAD_BUDGET_MS.max(UPLOAD_SHARE * self.feedback.gpu_ms[1]);
        let limit = (budget / self.ms_per_brick).clamp(1.0, MAX_UPLOAD_BRICKS as f64) as usize;
        let prepared = self.prepare(camera, settings, limit)?;
        self.draw(camera, settings, prepared)
    }

    /// The effort of the frame to come.
    fn next_effort(&mut self, camera: &Camera, settings: &RenderSettings) -> Effort {
        let rests = self.camera.replace(*camera) == Some(*camera);
        let wanted = settings.target_ms.map(|target_ms| Wanted {
            target_ms,
            pixels: f64::from(camera.width) * f64::from(camera.height),
            bias: settings.bias,
            memory: self.bias.memory(),
            rests,
        });
        let effort = self.effort.next(wanted.as_ref());
        self.bias.set_time(effort.bias);
        effort
    }

    /// Publishes finished loads.
    fn merge(&mut self) {
        self.merges += 1;
        self.pager.merge(self.merges);
    }

    /// Takes the read-backs that arrived: usage, counters, requests. With `settling`, so that the requests do not depend on
    /// which ray was first: without repetitions, and not at all if the list had no room for all of them.
    fn absorb(&mut self, settling: bool) {
        for mut feedback in self.backend.collect() {
            self.pool.touch(&feedback);
            let mut asked = feedback.request_count;
            if settling && feedback.is_truncated() {
                feedback.requests.clear();
            } else if settling {
                feedback.requests.sort_unstable();
                feedback.requests.dedup();
                asked = feedback.requests.len() as u32;
            }
            if let Some(k) = self.in_flight.iter().position(|f| f.frame == feedback.frame) {
                let InFlight {
                    trees,
                    request_share,
                    cost,
                    uploaded,
                    ..
                } = self.in_flight.swap_remove(k);
                self.feedback_trees = trees;
                if let Some(cost) = cost {
                    self.effort.measured(cost.on_device(&feedback, uploaded));
                }
                // So that half of the list's room is taken.
                let wanted = u64::from(request_share) * u64::from(asked);
                self.request_share = wanted.div_ceil(u64::from(REQUEST_CAPACITY / 2)).max(1) as u32;
            }
            self.in_flight.retain(|f| f.frame > feedback.frame);
            self.feedback = feedback;
            self.submit_requests();
        }
    }

    fn submit_requests(&mut self) {
        if self.feedback.requests.is_empty() {
            self.list = NodeList {
                frame: self.feedback.frame,
                ..Default::default()
            };
        } else {
            let trees = Arc::clone(&self.feedback_trees);
            self.processors
                .submit(self.feedback.frame, self.feedback.requests.clone(), trees);
        }
    }

    /// Everything of a frame up to the uploads.
    fn prepare(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        brick_limit: usize,
    ) -> Result<Prepared, RuntimeError> {
        let start = Instant::now();
        settings.check(camera).map_err(RuntimeError::Argument)?;
        self.backend.begin(camera, settings, &self.depths)?;
        self.frame += 1;
        let frame = self.frame;
        let mut report = FrameReport {
            frame,
            ..Default::default()
        };

        self.absorb(false);
        if let Some(list) = self.processors.take()
            && list.frame >= self.list.frame
        {
            self.list = list;
        }
        let effort = self.next_effort(camera, settings);
        report.scale = effort.scale;
        report.readback_ms = ms(start);

        let merge = Instant::now();
        self.merge();
        report.merge_ms = ms(merge);

        let cull = Instant::now();
        let pager = &self.pager;
        let footprint = camera.pixel_size() * (settings.bias + self.bias.extra()).exp2();
        let cut = Cut {
            footprint,
            readiness: &|tree| match pager.tree(tree) {
                Some(_) => Readiness::Ready,
                None if pager.is_failed(PageKey::Root(tree)) => Readiness::Failed,
                None => Readiness::Awaited,
            },
        };
        (self.culler).set_shadows(settings.shadows.then_some(settings.sun));
        let culling = self.frozen.as_ref().unwrap_or(camera);
        let result = (self.culler).cull_cut(&self.terrain.graph, culling, &cut, u64::from(frame));
        report.cull_ms = ms(cull);
        report.trees_visible = result.visible.len();

        let upload = Instant::now();
        let (mut drawn, mut active) = (Vec::new(), Vec::new());
        for wanted in &result.wanted {
            self.in_use.touch(wanted.tree, u64::from(frame));
            report.trees_waiting += usize::from(!use_root(&mut self.pager, wanted));
        }
        let near = (result.visible.iter()).filter(|tree| tree.distance <= settings.range);
        for (order, visible) in (0u32..).zip(near.take(MAX_TREES)) {
            let tree = visible.tree;
            self.in_use.touch(tree, u64::from(frame));
            report.trees_waiting += usize::from(!use_root(&mut self.pager, visible));
            let Some(state) = self.pager.tree(tree).cloned() else {
                continue;
            };
            let header = state.root.header;
            if header.layout != self.terrain.layout {
                let name = self.terrain.file(tree);
                let fault = format!("{name}: its sample layout differs from the scene's other trees'");
                if !self.faults.contains(&fault) {
                    self.faults.push(fault);
                }
                continue;
            }
            if visible.beyond.is_none() {
                // Rays find out level by level what they lack; that they will come this far is known at once.
                let wanted = visible.distance * footprint;
                (self.pager).request_levels(tree, wanted, |level| priority(level, order));
            }
            match self.pool.activate(tree, &state, frame) {
                Some(root) => {
                    drawn.push(Drawn {
                        header,
                        bounds: visible.bounds,
                        root,
                        least_level: least_level(header.depth, visible.beyond),
                    });
                    active.push(ActiveTree { tree, state });
                }
                None => report.trees_waiting += 1,
            }
        }
        let pager = &mut self.pager;
        (self.in_use).expire(u64::from(frame), TREE_KEEP_FRAMES, |tree| {
            pager.release_tree(tree)
        });
        report.trees_active = drawn.len();
        self.pending = self.pool.apply(&self.list, &mut self.pager, frame, brick_limit);
        report.pending = self.pending;
        (self.lookahead).ask(&mut self.pager, &self.terrain.graph, camera, footprint);
        self.pager.submit();
        self.faults.extend(
            self.pager
                .drain_faults()
                .into_iter()
                .map(|fault: PageFault| fault.message),
        );

        let in_use = self.pool.bricks_in_use(self.feedback.frame.max(1));
        report.bricks_in_use = in_use;
        let slots = f64::from(self.backend.sizes().bricks());
        let demand = f64::from(in_use) + self.pending as f64;
        let ram = self.pager.over_budget();
        self.bias.update(frame, camera, &[(demand, slots), (ram, 1.0)]);
        report.bias = settings.bias + self.bias.extra();

        self.pool.take_uploads(&mut self.uploads);
        report.uploads = self.uploads.bricks.len();
        report.node_updates = self.uploads.nodes.len();
        report.bytes_uploaded = self.backend.upload(&self.uploads);
        // Loaders free pages, not this thread: none is held any longer than it must be.
        self.uploads.bricks.clear();
        report.bricks_resident = self.pool.bricks_resident();
        report.upload_ms = ms(upload);
        if report.uploads > 0 {
            let measured = (report.upload_ms + self.feedback.gpu_ms[0]) / report.uploads as f64;
            self.ms_per_brick += 0.2 * (measured.max(1e-4) - self.ms_per_brick);
        }
        Ok(Prepared {
            report,
            raster: Raster::scaled(camera, effort),
            drawn,
            active,
            start,
        })
    }

    /// Casts the rays and submits.
    fn draw(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        prepared: Prepared,
    ) -> Result<FrameReport, RuntimeError> {
        let Prepared {
            mut report,
            raster,
            drawn,
            active,
            start,
        } = prepared;
        let submit = Instant::now();
        let is_read_back = self.backend.cast(&Cast {
            camera,
            settings,
            frame: self.frame,
            bias: report.bias,
            raster,
            request_share: self.request_share,
            until: self.depths.until.as_ref().map(|d| d.scale),
            drawn: &drawn,
        });
        if is_read_back {
            self.in_flight.push(InFlight {
                frame: self.frame,
                trees: active.into(),
                request_share: self.request_share,
                cost: settings.target_ms.map(|_| Cost {
                    pixels: f64::from(raster.size[0]) * f64::from(raster.size[1]),
                    bias: report.bias,
                    cast_ms: 0.0,
                    other_ms: ms(start),
                }),
                uploaded: report.uploads + report.node_updates > 0,
            });
        }
        report.submit_ms = ms(submit);
        report.cpu_ms = ms(start);
        Ok(report)
    }
}
