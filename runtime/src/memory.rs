//! The pools' memory on the device: node pool, brick pool textures, usage stamps, and what writes them.
//!
//! All node words and bricks of a frame travel in one buffer each. Node words are put in place by a dispatch; so are bricks where they
//! are samples (`samples`), and where they are blocks they are copied (`blocks`). Called by the render thread.

mod blocks;
mod samples;

use std::sync::Arc;

use brickfell_formats::blocks as coding;
use brickfell_formats::chunk::Layers;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::occupancy::{GAP_WORDS, Occupancy};
use brickfell_pager::ChunkPage;
use brickfell_shaders::{SCATTER, layout};

use crate::error::RuntimeError;
use crate::gpu::Gpu;
use blocks::BlockWriter;
use samples::SampleWriter;

/// Most bricks of one upload; at 10³ samples of 8 bytes, 16 MB.
pub const MAX_UPLOAD_BRICKS: usize = 2048;
/// Most node words of one upload.
pub const MAX_UPLOAD_NODES: usize = 1 << 16;

/// Bytes of a brick slot's stamp, and of two node tiles with theirs.
const SLOT_BYTES: u64 = 4 + 2 * (64 + 4);

/// Refuses pools of so few bricks that not even the roots of a view fit.
fn check_count(budget: u64, bricks: u64) -> Result<(), RuntimeError> {
    if bricks < 8 {
        return Err(RuntimeError::Budget {
            budget,
            reason: format!("it holds {bricks} bricks"),
        });
    }
    Ok(())
}

/// Bytes that tell where a brick shows anything.
const OCCUPANCY_BYTES: u64 = layout::OCCUPANCY_WORDS as u64 * 4;
const _: () = assert!(layout::OCCUPANCY_WORDS == 2 + GAP_WORDS);

/// Sizes of the pools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolSizes {
    /// Where the samples of bricks lie.
    pub layout: SampleLayout,
    /// What is stored of a sample; where that is more than a brick has, the rest is unused.
    pub layers: Layers,
    /// Whether bricks are blocks instead of samples.
    pub blocks: bool,
    /// Brick slots per axis.
    pub slots: [u32; 3],
    /// Node tiles; tile 0 is the null tile.
    pub tiles: u32,
}

impl PoolSizes {
    /// The largest pools of a layout in a byte budget: a tile for each half brick slot and more, the rest bricks.
    ///
    /// # Errors
    /// If not even a few bricks fit.
    pub fn fit(
        budget: u64,
        layout: SampleLayout,
        layers: Layers,
        blocks: bool,
        limits: &wgpu::Limits,
    ) -> Result<Self, RuntimeError> {
        let smallest = Self {
            layout,
            layers,
            blocks,
            slots: [1; 3],
            tiles: 1,
        };
        let wanted = budget / (smallest.brick_bytes() + OCCUPANCY_BYTES + SLOT_BYTES);
        let most = smallest.slot().map(|s| limits.max_texture_dimension_3d / s);
        // A tile has 64 bytes, in one storage binding.
        let binding = limits.max_storage_buffer_binding_size;
        let mut slots = [(wanted as f64).cbrt().floor().max(1.0) as u32; 3];
        for axis in 0..3 {
            let others: u64 = slots
                .iter()
                .enumerate()
                .filter(|(a, _)| *a != axis)
                .map(|(_, s)| u64::from(*s))
                .product();
            slots[axis] = ((wanted / others.max(1)) as u32).clamp(1, most[axis]);
        }
        let bricks: u64 = slots.iter().map(|s| u64::from(*s)).product();
        check_count(budget, wanted.min(bricks))?;
        let tiles = (bricks * 2 + 64).min(binding / 64).min(1 << 27) as u32;
        Ok(Self {
            slots,
            tiles,
            ..smallest
        })
    }

    /// The same in RAM, where nothing but the budget is a limit; `brick_bytes`: of a brick there.
    ///
    /// # Errors
    /// If not even a few bricks fit.
    pub(crate) fn fit_memory(
        budget: u64,
        layout: SampleLayout,
        layers: Layers,
        blocks: bool,
        brick_bytes: u64,
    ) -> Result<Self, RuntimeError> {
        let bricks = (budget / (brick_bytes + SLOT_BYTES)).min(1 << 26);
        check_count(budget, bricks)?;
        Ok(Self {
            layout,
            layers,
            blocks,
            slots: [bricks as u32, 1, 1],
            tiles: (bricks * 2 + 64) as u32,
        })
    }

    /// Brick slots.
    pub fn bricks(&self) -> u32 {
        self.slots.iter().product()
    }

    /// Texels of a brick slot per axis.
    pub fn slot(&self) -> [u32; 3] {
        let side = self.layout.side();
        if self.blocks {
            [coding::SLICE_SIDE, coding::SLICE_SIDE, side]
        } else {
            [side; 3]
        }
    }

    /// Texels of the brick pool per axis.
    pub fn texels(&self) -> [u32; 3] {
        let slot = self.slot();
        std::array::from_fn(|axis| self.slots[axis] * slot[axis])
    }

    /// The first texel of a slot.
    pub fn slot_corner(&self, slot: u32) -> [u32; 3] {
        let [x, y, _] = self.slots;
        let (cell, size) = ([slot % x, slot / x % y, slot / (x * y)], self.slot());
        std::array::from_fn(|axis| cell[axis] * size[axis])
    }

    /// Bytes of a brick slot in the textures.
    pub fn brick_bytes(&self) -> u64 {
        let bytes = if self.blocks {
            coding::brick_bytes(self.layout, self.layers)
        } else {
            self.layout.samples() * self.layers.sample_bytes()
        };
        bytes as u64
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.brick_bytes() * u64::from(self.bricks())
            + u64::from(self.bricks()) * (OCCUPANCY_BYTES + 4)
            + u64::from(self.tiles) * 68
    }
}

/// A brick on its way to a slot.
#[derive(Clone, Debug)]
pub struct BrickUpload {
    /// Where to.
    pub slot: u32,
    /// The chunk it is in.
    pub chunk: Arc<ChunkPage>,
    /// Its place among the chunk's bricks.
    pub brick: u32,
}

/// The brick pool as the kernel reads it.
#[derive(Debug)]
struct Views {
    color: wgpu::TextureView,
    normal: wgpu::TextureView,
    /// Hardly anything where no brick has opacities against the axes.
    opacity: wgpu::TextureView,
}

/// What puts bricks into their slots.
#[derive(Debug)]
enum BrickWriter {
    Samples(SampleWriter),
    Blocks(BlockWriter),
}

/// The pools on the device.
#[derive(Debug)]
pub struct PoolMemory {
    /// Their sizes.
    pub sizes: PoolSizes,
    pub(crate) nodes: wgpu::Buffer,
    /// Where each slot's brick shows anything: [`layout::OCCUPANCY_WORDS`] words.
    pub(crate) occupancy: wgpu::Buffer,
    pub(crate) brick_stamps: wgpu::Buffer,
    pub(crate) tile_stamps: wgpu::Buffer,
    pub(crate) color: wgpu::TextureView,
    pub(crate) normal: wgpu::TextureView,
    pub(crate) opacity: wgpu::TextureView,
    scatter_nodes: wgpu::ComputePipeline,
    node_bindings: wgpu::BindGroup,
    scatter_occupancy: wgpu::ComputePipeline,
    occupancy_bindings: wgpu::BindGroup,
    occupancy_updates: wgpu::Buffer,
    staging: Vec<u32>,
    uniform: wgpu::Buffer,
    node_updates: wgpu::Buffer,
    bricks: BrickWriter,
}

impl PoolMemory {
    /// Allocates the pools, all slots empty.
    ///
    /// # Errors
    /// If the device cannot hold them, or cannot read blocks and they are to be kept.
    pub fn new(gpu: &Gpu, sizes: PoolSizes) -> Result<Self, RuntimeError> {
        use wgpu::BufferUsages as B;
        if sizes.blocks && !gpu.reads_blocks {
            return Err(RuntimeError::Device(
                "it has no block-compressed 3D textures".into(),
            ));
        }
        let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let nodes = gpu.buffer("node pool", u64::from(sizes.tiles) * 64, B::STORAGE);
        let occupancy = gpu.buffer(
            "occupancy",
            u64::from(sizes.bricks()) * OCCUPANCY_BYTES,
            B::STORAGE,
        );
        let brick_stamps = gpu.buffer("brick stamps", u64::from(sizes.bricks()) * 4, B::STORAGE);
        let tile_stamps = gpu.buffer("tile stamps", u64::from(sizes.tiles) * 4, B::STORAGE);
        let uniform = gpu.buffer(
            "scatter",
            size_of::<layout::Scatter>() as u64,
            B::UNIFORM | B::COPY_DST,
        );
        let node_updates = gpu.buffer(
            "node updates",
            MAX_UPLOAD_NODES as u64 * 16,
            B::STORAGE | B::COPY_DST,
        );
        let occupancy_updates = gpu.buffer(
            "occupancy updates",
            MAX_UPLOAD_BRICKS as u64 * (OCCUPANCY_BYTES + 4),
            B::STORAGE | B::COPY_DST,
        );
        let (bricks, views) = if sizes.blocks {
            let (writer, views) = BlockWriter::new(gpu, sizes);
            (BrickWriter::Blocks(writer), views)
        } else {
            let (writer, views) = SampleWriter::new(gpu, sizes, &uniform);
            (BrickWriter::Samples(writer), views)
        };
        let scatter = |kernel, first, updates: &wgpu::Buffer, to: &wgpu::Buffer| {
            let pipeline = gpu.compute_pipeline(kernel, SCATTER, kernel);
            let buffers = [(0, &uniform), (first, updates), (first + 1, to)];
            let bindings = gpu.bind(&pipeline, &buffers.map(|(k, b)| (k, b.as_entire_binding())));
            (pipeline, bindings)
        };
        let (scatter_nodes, node_bindings) = scatter("scatter_nodes", 1, &node_updates, &nodes);
        let (scatter_occupancy, occupancy_bindings) =
            scatter("scatter_occupancy", 8, &occupancy_updates, &occupancy);
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(RuntimeError::Budget {
                budget: sizes.bytes(),
                reason: error.to_string(),
            });
        }
        gpu.check()?;
        Ok(Self {
            sizes,
            nodes,
            occupancy,
            brick_stamps,
            tile_stamps,
            color: views.color,
            normal: views.normal,
            opacity: views.opacity,
            scatter_nodes,
            node_bindings,
            scatter_occupancy,
            occupancy_bindings,
            occupancy_updates,
            staging: Vec::new(),
            uniform,
            node_updates,
            bricks,
        })
    }

    /// Bytes on the device, upload buffers included.
    pub fn bytes(&self) -> u64 {
        let upload = match &self.bricks {
            BrickWriter::Samples(writer) => writer.buffer_bytes(),
            BrickWriter::Blocks(writer) => writer.buffer_bytes(),
        };
        self.sizes.bytes() + self.node_updates.size() + self.occupancy_updates.size() + upload
    }

    /// Writes the staging buffers and encodes what puts their contents in place. At most [`MAX_UPLOAD_NODES`] node words (index,
    /// word, word, 0) and [`MAX_UPLOAD_BRICKS`] bricks, in the form that the pool has. Returns the bytes sent.
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        nodes: &[[u32; 4]],
        bricks: &[BrickUpload],
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) -> u64 {
        let sizes = self.sizes;
        let uniform = layout::Scatter {
            nodes: nodes.len() as u32,
            bricks: bricks.len() as u32,
            brick_side: sizes.layout.side(),
            words: sizes.layers.sample_bytes() as u32 / 4,
            slots: [sizes.slots[0], sizes.slots[1], sizes.slots[2], 0],
        };
        let queue = &gpu.queue;
        queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
        queue.write_buffer(&self.node_updates, 0, bytemuck::cast_slice(nodes));
        self.staging.clear();
        for upload in bricks {
            let Occupancy { cells, gaps } = upload.chunk.occupancy()[upload.brick as usize];
            self.staging
                .extend([upload.slot, cells as u32, (cells >> 32) as u32]);
            self.staging.extend(gaps);
        }
        let staging = bytemuck::cast_slice(&self.staging);
        queue.write_buffer(&self.occupancy_updates, 0, staging);
        let mut sent = nodes.len() as u64 * 16 + staging.len() as u64;
        let mut timestamps = timestamps;
        match &mut self.bricks {
            BrickWriter::Samples(writer) => sent += writer.send(gpu, sizes, bricks),
            BrickWriter::Blocks(writer) => {
                // Copies stand outside of passes: an empty one before them tells when they began.
                if let Some(begin) = &mut timestamps {
                    let end = begin.end_of_pass_write_index.take();
                    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                        label: Some("upload begins"),
                        timestamp_writes: Some(begin.clone()),
                    });
                    begin.beginning_of_pass_write_index = None;
                    begin.end_of_pass_write_index = end;
                }
                sent += writer.copy(gpu, encoder, sizes, bricks);
            }
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("upload"),
            timestamp_writes: timestamps,
        });
        if !bricks.is_empty() {
            if let BrickWriter::Samples(writer) = &self.bricks {
                writer.scatter(&mut pass, sizes, bricks.len());
            }
            pass.set_pipeline(&self.scatter_occupancy);
            pass.set_bind_group(0, &self.occupancy_bindings, &[]);
            pass.dispatch_workgroups(1, bricks.len() as u32, 1);
        }
        if !nodes.is_empty() {
            pass.set_pipeline(&self.scatter_nodes);
            pass.set_bind_group(0, &self.node_bindings, &[]);
            pass.dispatch_workgroups((nodes.len() as u32).div_ceil(64), 1, 1);
        }
        sent
    }
}

/// A texture of the brick pool, written in one format and sampled in another that differs at most in its encoding.
fn texture(
    gpu: &Gpu,
    label: &str,
    [width, height, depth_or_array_layers]: [u32; 3],
    format: wgpu::TextureFormat,
    sampled: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    let other = [sampled];
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D3,
        format,
        usage,
        view_formats: if sampled == format { &[] } else { &other },
    })
}
