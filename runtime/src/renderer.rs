//! The frame loop: the one code that flies, renders and benches.
//!
//! A frame, on the render thread: take what read-backs arrived, publish finished loads, cull, make resident what
//! rays asked for, upload, cast, compact, start the next read-back. Nothing in [`Renderer::frame`] waits for a disk or for
//! the device. [`Renderer::settle`] repeats frames, and does wait, until a picture has all it asks for.

mod settle;

use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::{Camera, Culler, Cut, Expiry, Readiness, VisibleTree};
use brickfell_pager::{Lookahead, PageFault, PageKey, Pager, PagerConfig, PagerStats, Store};

use crate::backend::{Backend, Cast, Device, Drawn};
use crate::bias::BiasController;
use crate::caster::{Feedback, MAX_TREES, REQUEST_CAPACITY};
use crate::depth::Depths;
use crate::effort::{Cost, Effort, EffortController, Wanted};
use crate::error::RuntimeError;
use crate::memory::{MAX_UPLOAD_BRICKS, PoolSizes};
use crate::node_lists::{ActiveTree, NodeList, NodeListProcessors};
use crate::picture::Picture;
use crate::present::Output;
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

/// What a frame did. Times in milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameReport {
    /// Number of the frame, from 1.
    pub frame: u32,
    /// Trees in view, where groups are far coarse ones instead of what is inside.
    pub trees_visible: usize,
    /// Of those, trees that were drawn.
    pub trees_active: usize,
    /// Trees in view, or to be drawn instead of others in view, whose roots are still on the way.
    pub trees_waiting: usize,
    /// Bricks in the pool.
    pub bricks_resident: u32,
    /// Of those, bricks that the newest rays read back used, those above them, and what came for them since.
    pub bricks_in_use: u32,
    /// Bricks uploaded.
    pub uploads: usize,
    /// Node words uploaded.
    pub node_updates: usize,
    /// Bytes uploaded.
    pub bytes_uploaded: u64,
    /// Pages and bricks asked for that are not there yet.
    pub pending: usize,
    /// Bias in effect, the user's and the controllers'.
    pub bias: f64,
    /// Part of the pixels per axis that were drawn.
    pub scale: f64,
    /// Publishing finished loads.
    pub merge_ms: f64,
    /// Culling and ordering.
    pub cull_ms: f64,
    /// Making resident, staging uploads.
    pub upload_ms: f64,
    /// Taking read-backs.
    pub readback_ms: f64,
    /// Encoding and submitting.
    pub submit_ms: f64,
    /// The whole call.
    pub cpu_ms: f64,
    /// From the begin of the call to the device's end; known when settling, where it is waited for.
    pub frame_ms: f64,
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

    /// The last picture, in linear light; waits for the device.
    ///
    /// # Errors
    /// If nothing was drawn yet or the device failed.
    pub fn read_picture(&self) -> Result<Picture, RuntimeError> {
        self.backend.read_picture()
    }

    /// From now on another camera than the one that draws decides which trees are drawn, so that they can be looked at from outside;
    /// `None` ends that.
    pub fn cull_from(&mut self, camera: Option<Camera>) {
        self.frozen = camera;
    }

    /// From now on rays end at the depths of polygons, or say where they have lost half of their light; the default ends both. What is
    /// wrong with a depth texture is told by the next frame, and that only a GPU does this. A texture is read when a frame is
    /// drawn: what fills it has to be submitted to the same queue before.
    pub fn set_depths(&mut self, depths: Depths) {
        self.depths = depths;
    }

    /// Depths of the last picture on the device, if they were asked for: an `R32Float` texture of which so many columns and
    /// rows were drawn, with metres along the camera's axis, [`NO_DEPTH`](crate::depth::NO_DEPTH) where rays kept more than half of their light.
    pub fn depth(&self) -> Option<(&wgpu::TextureView, [u32; 2])> {
        self.backend.depth()
    }

    /// The same as values, a row after the other, and how many columns and rows; waits for the device.
    ///
    /// # Errors
    /// If none were asked for or the device failed.
    pub fn read_depths(&self) -> Result<(Vec<f32>, [u32; 2]), RuntimeError> {
        self.backend.read_depths()
    }

    /// The trees in view of the last frame, front to back.
    pub fn visible(&self) -> &[VisibleTree] {
        &self.culler.result().visible
    }

    /// Where the last picture is, to be shown; `None` if nothing was drawn yet.
    pub fn output(&self) -> Option<Output<'_>> {
        self.backend.output()
    }

    /// What the rays of the newest frame that was read back reported.
    pub fn feedback(&self) -> &Feedback {
        &self.feedback
    }

    /// The pager's counters.
    pub fn pager_stats(&self) -> PagerStats {
        self.pager.stats()
    }

    /// Bytes of a brick in the pool.
    pub fn brick_bytes(&self) -> u64 {
        self.backend.brick_bytes()
    }

    /// Brick slots of the pool.
    pub fn brick_slots(&self) -> u32 {
        self.backend.sizes().bricks()
    }

    /// Sizes of the pools.
    pub fn pool_sizes(&self) -> PoolSizes {
        self.backend.sizes()
    }

    /// What is in the pools.
    pub fn pool(&self) -> &TexturePoolManager {
        &self.pool
    }

    /// Whether bricks that are block-compressed on disk are not so on the device, because it cannot read them or is not to.
    pub fn decodes_blocks(&self) -> bool {
        self.terrain.compressed && !self.backend.sizes().blocks
    }

    /// Bytes held on the device.
    pub fn gpu_bytes(&self) -> u64 {
        self.backend.bytes()
    }

    /// Everything that could not be read so far, one line each.
    pub fn faults(&self) -> &[String] {
        &self.faults
    }

    /// The terrain that is drawn.
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }

    /// Waits until the device has drawn what it was given. Never called by a frame that runs in real time.
    ///
    /// # Errors
    /// If the device failed.
    pub fn wait(&self) -> Result<(), RuntimeError> {
        self.backend.wait()
    }

    /// Name and kind of the device, for reports.
    pub fn device(&self) -> String {
        self.backend.describe()
    }

    /// How the device is reached: `vulkan`, `metal`, `dx12`, or `cpu`.
    pub fn backend(&self) -> String {
        self.backend.name()
    }
}
