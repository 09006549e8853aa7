//! What the renderer draws with: a GPU, or the CPU in its place. One interface to both: pools that are written, casts, feedback.
//!
//! Called by the render thread.

use std::sync::Arc;

use brickfell_culler::{Aabb, Camera};
use brickfell_formats::blocks::{NORMAL_SCALE, NORMAL_ZERO};
use brickfell_formats::octree::TreeHeader;
use brickfell_shaders::layout;

use crate::caster::{Caster, Feedback, Kernel, REQUEST_CAPACITY};
use crate::cpu::CpuCaster;
use crate::depth::{DepthScale, Depths};
use crate::error::RuntimeError;
use crate::gpu::Gpu;
use crate::march::{LIFT, SKY_MIDDLE, SKY_TILT, SKY_WIDTH};
use crate::memory::{PoolMemory, PoolSizes};
use crate::picture::Picture;
use crate::present::Output;
use crate::raster::Raster;
use crate::record::tree_record;
use crate::settings::{RenderSettings, SUN_WIDTH};
use crate::terrain::Terrain;
use crate::texture_pool::UploadBatch;

/// Trees above which tiles of pixels get lists of those that their rays may meet.
const LISTED_FROM: usize = 8;

/// What to draw with.
#[derive(Clone, Debug)]
pub enum Device {
    /// A GPU, or a software device that is like one.
    Gpu(Arc<Gpu>),
    /// The cores of the CPU; pools are in RAM.
    Cpu,
}

impl From<Arc<Gpu>> for Device {
    fn from(gpu: Arc<Gpu>) -> Self {
        Self::Gpu(gpu)
    }
}

/// A tree in a frame's list.
#[derive(Clone, Debug)]
pub(crate) struct Drawn {
    /// Its properties.
    pub(crate) header: TreeHeader,
    /// What is drawn of it, world metres.
    pub(crate) bounds: Aabb,
    /// Its root in the node pool.
    pub(crate) root: u32,
    /// Least fractional level.
    pub(crate) least_level: f64,
}

/// What is cast.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cast<'a> {
    /// The camera.
    pub(crate) camera: &'a Camera,
    /// How.
    pub(crate) settings: &'a RenderSettings,
    /// Number of the frame, from 1.
    pub(crate) frame: u32,
    /// Bias in effect.
    pub(crate) bias: f64,
    /// Which pixels are drawn.
    pub(crate) raster: Raster,
    /// One of so many tiles of pixels may ask.
    pub(crate) request_share: u32,
    /// How the depths at which rays end are told, if they do.
    pub(crate) until: Option<DepthScale>,
    /// The trees, front to back.
    pub(crate) drawn: &'a [Drawn],
}

/// A device with its pools.
#[derive(Debug)]
pub(crate) enum Backend {
    /// A GPU.
    Gpu(Box<GpuBackend>),
    /// The CPU.
    Cpu(Box<CpuCaster>),
}

/// A GPU with its pools and kernels.
#[derive(Debug)]
pub(crate) struct GpuBackend {
    gpu: Arc<Gpu>,
    memory: PoolMemory,
    caster: Caster,
    /// What is encoded and not submitted.
    encoder: Option<wgpu::CommandEncoder>,
}

impl GpuBackend {
    fn encoder(&mut self) -> wgpu::CommandEncoder {
        let device = &self.gpu.device;
        (self.encoder.take()).unwrap_or_else(|| device.create_command_encoder(&Default::default()))
    }

    fn submit(&mut self) {
        if let Some(encoder) = self.encoder.take() {
            self.gpu.queue.submit([encoder.finish()]);
        }
    }

    fn cast(&mut self, cast: &Cast<'_>) -> bool {
        let (uniform, camera) = (frame_uniform(cast, self.memory.sizes), cast.camera);
        let records: Vec<layout::Tree> = (cast.drawn.iter())
            .map(|d| tree_record(camera, &d.header, &d.bounds, d.root, d.least_level))
            .collect();
        let mut encoder = self.encoder();
        let entry = (self.caster).encode(&self.gpu, &mut encoder, &uniform, &records);
        self.encoder = Some(encoder);
        self.submit();
        if let Some(entry) = entry {
            self.caster.submitted(entry);
        }
        entry.is_some()
    }
}

impl Backend {
    /// Pools on a device for a terrain.
    ///
    /// # Errors
    /// If they do not fit the budget or the device.
    pub(crate) fn new(
        device: Device,
        budget: u64,
        terrain: &Terrain,
        keep_blocks: bool,
    ) -> Result<Self, RuntimeError> {
        let (layout, layers) = (terrain.layout, terrain.layers);
        let blocks = terrain.compressed && keep_blocks;
        Ok(match device {
            Device::Gpu(gpu) => {
                let blocks = blocks && gpu.reads_blocks;
                let sizes = PoolSizes::fit(budget, layout, layers, blocks, &gpu.device.limits())?;
                let memory = PoolMemory::new(&gpu, sizes)?;
                Self::Gpu(Box::new(GpuBackend {
                    caster: Caster::new(&gpu, &memory)?,
                    memory,
                    gpu,
                    encoder: None,
                }))
            }
            Device::Cpu => Self::Cpu(Box::new(CpuCaster::new(budget, layout, layers, blocks)?)),
        })
    }

    /// Sizes of the pools.
    pub(crate) fn sizes(&self) -> PoolSizes {
        match self {
            Self::Gpu(b) => b.memory.sizes,
            Self::Cpu(caster) => caster.sizes(),
        }
    }

    /// Bytes of a brick in the pool.
    pub(crate) fn brick_bytes(&self) -> u64 {
        match self {
            Self::Gpu(b) => b.memory.sizes.brick_bytes(),
            Self::Cpu(caster) => caster.brick_bytes(),
        }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> u64 {
        match self {
            Self::Gpu(b) => b.memory.bytes() + b.caster.bytes(),
            Self::Cpu(caster) => caster.bytes(),
        }
    }

    /// Where the last picture is, if there is one.
    pub(crate) fn output(&self) -> Option<Output<'_>> {
        match self {
            Self::Gpu(b) => (b.caster.output()).map(|(view, drawn)| Output::Device(view, drawn)),
            Self::Cpu(caster) => caster.drawn().map(Output::Memory),
        }
    }

    /// Where the last picture's depths are, and how many columns and rows of them, if they were written.
    pub(crate) fn depth(&self) -> Option<(&wgpu::TextureView, [u32; 2])> {
        match self {
            Self::Gpu(b) => b.caster.depth(),
            Self::Cpu(_) => None,
        }
    }

    /// Makes ready for a picture of the camera's size.
    ///
    /// # Errors
    /// If the device failed or draws none of this size, or rays cannot end at these depths.
    pub(crate) fn begin(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        depths: &Depths,
    ) -> Result<(), RuntimeError> {
        match self {
            Self::Gpu(b) => {
                b.gpu.check()?;
                let size = [camera.width, camera.height];
                depths.until.as_ref().map_or(Ok(()), |d| d.check(size))?;
                let until = depths.until.as_ref().map(|d| &d.view);
                (b.caster).prepare(&b.gpu, &b.memory, size, Kernel::of(settings, depths), until)
            }
            Self::Cpu(_) if depths.until.is_some() || depths.written => Err(RuntimeError::Argument(
                "only a GPU exchanges depths with polygons, and this draws with the CPU",
            )),
            Self::Cpu(_) => Ok(()),
        }
    }

    /// Puts node words and bricks in place before the next cast; returns the bytes sent.
    pub(crate) fn upload(&mut self, batch: &UploadBatch) -> u64 {
        if batch.nodes.is_empty() && batch.bricks.is_empty() {
            return 0;
        }
        match self {
            Self::Gpu(b) => {
                let mut encoder = b.encoder();
                let times = b.caster.timestamps(0);
                let sent = (b.memory).upload(&b.gpu, &mut encoder, &batch.nodes, &batch.bricks, times);
                b.encoder = Some(encoder);
                sent
            }
            Self::Cpu(caster) => caster.upload(batch),
        }
    }

    /// Sends what was uploaded without a cast.
    pub(crate) fn flush(&mut self) {
        if let Self::Gpu(b) = self {
            b.submit();
        }
    }

    /// Casts; true if there will be feedback.
    pub(crate) fn cast(&mut self, cast: &Cast<'_>) -> bool {
        match self {
            Self::Gpu(b) => b.cast(cast),
            Self::Cpu(caster) => {
                caster.cast(cast);
                true
            }
        }
    }

    /// Takes the feedback that has arrived, oldest first, without waiting.
    pub(crate) fn collect(&mut self) -> Vec<Feedback> {
        match self {
            Self::Gpu(b) => b.caster.collect(&b.gpu, &b.memory),
            Self::Cpu(caster) => caster.collect().into_iter().collect(),
        }
    }

    /// Waits until the device has done what it was given.
    ///
    /// # Errors
    /// If it failed.
    pub(crate) fn wait(&self) -> Result<(), RuntimeError> {
        match self {
            Self::Gpu(b) => b.gpu.wait(),
            Self::Cpu(_) => Ok(()),
        }
    }

    /// The last picture.
    ///
    /// # Errors
    /// If nothing was drawn yet or the device failed.
    pub(crate) fn read_picture(&self) -> Result<Picture, RuntimeError> {
        match self {
            Self::Gpu(b) => b.caster.read_picture(&b.gpu),
            Self::Cpu(caster) => Ok(caster.picture()),
        }
    }

    /// The last picture's depths.
    ///
    /// # Errors
    /// If none were written or the device failed.
    pub(crate) fn read_depths(&self) -> Result<(Vec<f32>, [u32; 2]), RuntimeError> {
        match self {
            Self::Gpu(b) => b.caster.read_depths(&b.gpu),
            Self::Cpu(_) => Err(RuntimeError::Device("no depths were drawn".into())),
        }
    }

    /// Name and kind of the device, for reports.
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Gpu(b) => b.gpu.describe(),
            Self::Cpu(_) => format!("CPU ({} threads)", rayon::current_num_threads()),
        }
    }

    /// `vulkan`, `metal`, `dx12`, or `cpu`.
    pub(crate) fn name(&self) -> String {
        match self {
            Self::Gpu(b) => format!("{:?}", b.gpu.info.backend).to_lowercase(),
            Self::Cpu(_) => "cpu".into(),
        }
    }
}

fn frame_uniform(cast: &Cast<'_>, sizes: PoolSizes) -> layout::Frame {
    let Cast {
        camera,
        settings,
        raster,
        ..
    } = *cast;
    let [origin, next] = [0, 1].map(|k| raster.screen(camera, k, k));
    let axis = |v: glam::DVec3, w: f64| v.extend(w).as_vec4().to_array();
    let (segment_shift, segment_samples) = settings.segment();
    let texels = sizes.texels().map(|t| 1.0 / t as f32);
    let [x, y, z] = sizes.slot();
    let [normal_scale, normal_zero] = [NORMAL_SCALE, NORMAL_ZERO].map(|v| glam::Vec3::from(v.map(f32::from)));
    let [offset, factor, empty] = cast.until.unwrap_or(DepthScale::METRES).to_array();
    layout::Frame {
        size: raster.size,
        tree_count: cast.drawn.len() as u32,
        frame: cast.frame,
        screen_origin: origin.as_vec2().to_array(),
        screen_step: (next - origin).as_vec2().to_array(),
        forward: axis(camera.forward, 0.0),
        right: axis(camera.right, 0.0),
        up: axis(camera.up, 0.0),
        sun: axis(settings.sun, settings.ambient),
        diffuse: settings.diffuse as f32,
        footprint: (camera.pixel_size() * cast.bias.exp2()) as f32,
        fade: settings.fade() as f32,
        blocks: u32::from(sizes.blocks),
        slots: [sizes.slots[0], sizes.slots[1], sizes.slots[2], 0],
        texel: [texels[0], texels[1], texels[2], 0.0],
        brick_slots: sizes.bricks(),
        node_tiles: sizes.tiles,
        request_capacity: REQUEST_CAPACITY,
        request_share: cast.request_share,
        segment_shift,
        segment_samples,
        lists: u32::from(cast.drawn.len() > LISTED_FROM),
        sky_middle: SKY_MIDDLE as f32,
        slot: [x, y, z, 0],
        normal_scale: (255.0 / normal_scale).extend(0.0).to_array(),
        normal_zero: (-normal_zero / normal_scale).extend(0.0).to_array(),
        cones: [SUN_WIDTH, SKY_WIDTH, LIFT, SKY_TILT].map(|x| x as f32),
        pixels: raster.pixels().as_vec4().to_array(),
        depth_in: [offset, factor, empty, 0.0],
    }
}
