//! The pools' memory on the device: node pool, brick pool textures, usage stamps, and the upload kernels that write them.
//!
//! All node words and bricks of a frame travel in one buffer each and are put in place by two dispatches: wgpu pads
//! texture rows to 256 bytes and pays for every copy. Called by the render thread.

use std::sync::Arc;

use brickfell_formats::chunk::{Chunk, Layers};
use brickfell_formats::layout::SampleLayout;
use brickfell_shaders::{SCATTER, layout};

use crate::error::RuntimeError;
use crate::gpu::Gpu;

/// Most bricks of one upload; at 10³ samples of 8 bytes, 16 MB.
pub const MAX_UPLOAD_BRICKS: usize = 2048;
/// Most node words of one upload.
pub const MAX_UPLOAD_NODES: usize = 1 << 16;

/// Sizes of the pools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolSizes {
    /// Samples of a brick slot per axis.
    pub brick_side: u32,
    /// What is stored of a sample; where that is more than a brick has, the rest is unused.
    pub layers: Layers,
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
        sample_layout: SampleLayout,
        layers: Layers,
        limits: &wgpu::Limits,
    ) -> Result<Self, RuntimeError> {
        let side = sample_layout.side();
        // A brick slot with its stamp, and two node tiles with theirs.
        let per_brick = (sample_layout.samples() * layers.sample_bytes()) as u64 + 4 + 2 * (64 + 4);
        let wanted = budget / per_brick;
        let most_per_axis = limits.max_texture_dimension_3d / side;
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
            slots[axis] = ((wanted / others.max(1)) as u32).clamp(1, most_per_axis);
        }
        let bricks: u64 = slots.iter().map(|s| u64::from(*s)).product();
        if wanted < 8 || bricks < 8 {
            return Err(RuntimeError::Budget {
                budget,
                reason: format!("it holds {wanted} bricks"),
            });
        }
        let tiles = (bricks * 2 + 64).min(binding / 64).min(1 << 27) as u32;
        Ok(Self {
            brick_side: side,
            layers,
            slots,
            tiles,
        })
    }

    /// Brick slots.
    pub fn bricks(&self) -> u32 {
        self.slots.iter().product()
    }

    /// Bytes of a brick slot in the textures.
    pub fn brick_bytes(&self) -> u64 {
        u64::from(self.brick_side).pow(3) * self.layers.sample_bytes() as u64
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.brick_bytes() * u64::from(self.bricks())
            + u64::from(self.bricks()) * 4
            + u64::from(self.tiles) * 68
    }
}

/// A brick on its way to a slot.
#[derive(Clone, Debug)]
pub struct BrickUpload {
    /// Where to.
    pub slot: u32,
    /// The chunk it is in.
    pub chunk: Arc<Chunk>,
    /// Its place among the chunk's bricks.
    pub brick: u32,
}

/// The pools on the device.
#[derive(Debug)]
pub struct PoolMemory {
    /// Their sizes.
    pub sizes: PoolSizes,
    pub(crate) nodes: wgpu::Buffer,
    pub(crate) brick_stamps: wgpu::Buffer,
    pub(crate) tile_stamps: wgpu::Buffer,
    pub(crate) color: wgpu::TextureView,
    pub(crate) normal: wgpu::TextureView,
    /// One texel where no brick has opacities against the axes.
    pub(crate) opacity: wgpu::TextureView,
    scatter_nodes: wgpu::ComputePipeline,
    scatter_bricks: wgpu::ComputePipeline,
    node_bindings: wgpu::BindGroup,
    brick_bindings: wgpu::BindGroup,
    uniform: wgpu::Buffer,
    node_updates: wgpu::Buffer,
    brick_slots: wgpu::Buffer,
    brick_data: wgpu::Buffer,
    staging: Vec<u32>,
}

impl PoolMemory {
    /// Allocates the pools, all slots empty.
    ///
    /// # Errors
    /// If the device cannot hold them.
    pub fn new(gpu: &Gpu, sizes: PoolSizes) -> Result<Self, RuntimeError> {
        use wgpu::{BufferUsages as B, TextureFormat as F, TextureUsages as T};
        let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let pool = sizes.slots.map(|s| s * sizes.brick_side);
        let texture = |label, [x, y, z]: [u32; 3], format, sampled: F| {
            let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width: x,
                    height: y,
                    depth_or_array_layers: z,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D3,
                format,
                usage: T::TEXTURE_BINDING | T::STORAGE_BINDING,
                view_formats: if sampled == format {
                    &[]
                } else {
                    &[F::Rgba8UnormSrgb]
                },
            });
            let view = |format, usage| {
                texture.create_view(&wgpu::TextureViewDescriptor {
                    format: Some(format),
                    usage: Some(usage),
                    ..Default::default()
                })
            };
            (
                view(sampled, T::TEXTURE_BINDING),
                view(format, T::STORAGE_BINDING),
            )
        };
        let (color, color_store) = texture("brick colours", pool, F::Rgba8Unorm, F::Rgba8UnormSrgb);
        let (normal, normal_store) = texture("brick normals", pool, F::Rgba8Snorm, F::Rgba8Snorm);
        let opacities = match sizes.layers {
            Layers::Plain => [1; 3],
            Layers::Axes => pool,
        };
        let (opacity, opacity_store) = texture("brick opacities", opacities, F::Rgba8Unorm, F::Rgba8Unorm);
        let nodes = gpu.buffer("node pool", u64::from(sizes.tiles) * 64, B::STORAGE);
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
        let brick_slots = gpu.buffer(
            "brick slots",
            MAX_UPLOAD_BRICKS as u64 * 4,
            B::STORAGE | B::COPY_DST,
        );
        let brick_data = gpu.buffer(
            "brick data",
            MAX_UPLOAD_BRICKS as u64 * sizes.brick_bytes(),
            B::STORAGE | B::COPY_DST,
        );
        let scatter_nodes = gpu.compute_pipeline("scatter nodes", SCATTER, "scatter_nodes");
        let scatter_bricks = gpu.compute_pipeline("scatter bricks", SCATTER, "scatter_bricks");
        let node_bindings = gpu.bind(
            &scatter_nodes,
            &[
                (0, uniform.as_entire_binding()),
                (1, node_updates.as_entire_binding()),
                (2, nodes.as_entire_binding()),
            ],
        );
        let brick_bindings = gpu.bind(
            &scatter_bricks,
            &[
                (0, uniform.as_entire_binding()),
                (3, brick_slots.as_entire_binding()),
                (4, brick_data.as_entire_binding()),
                (5, wgpu::BindingResource::TextureView(&color_store)),
                (6, wgpu::BindingResource::TextureView(&normal_store)),
                (7, wgpu::BindingResource::TextureView(&opacity_store)),
            ],
        );
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
            brick_stamps,
            tile_stamps,
            color,
            normal,
            opacity,
            scatter_nodes,
            scatter_bricks,
            node_bindings,
            brick_bindings,
            uniform,
            node_updates,
            brick_slots,
            brick_data,
            staging: Vec::new(),
        })
    }

    /// Bytes on the device, upload buffers included.
    pub fn bytes(&self) -> u64 {
        self.sizes.bytes() + self.node_updates.size() + self.brick_slots.size() + self.brick_data.size()
    }

    /// Writes the staging buffers and encodes the scatter. At most [`MAX_UPLOAD_NODES`] node words (index, word, word, 0)
    /// and [`MAX_UPLOAD_BRICKS`] bricks. Returns the bytes sent.
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        nodes: &[[u32; 4]],
        bricks: &[BrickUpload],
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) -> u64 {
        let uniform = layout::Scatter {
            nodes: nodes.len() as u32,
            bricks: bricks.len() as u32,
            brick_side: self.sizes.brick_side,
            words: self.sizes.layers.sample_bytes() as u32 / 4,
            slots: [self.sizes.slots[0], self.sizes.slots[1], self.sizes.slots[2], 0],
        };
        let queue = &gpu.queue;
        queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
        queue.write_buffer(&self.node_updates, 0, bytemuck::cast_slice(nodes));
        self.staging.clear();
        self.staging.extend(bricks.iter().map(|b| b.slot));
        queue.write_buffer(&self.brick_slots, 0, bytemuck::cast_slice(&self.staging));
        let samples = (self.sizes.brick_side as usize).pow(3);
        for (k, upload) in bricks.iter().enumerate() {
            let at = k as u64 * self.sizes.brick_bytes();
            let brick = upload.brick as usize;
            queue.write_buffer(
                &self.brick_data,
                at,
                upload.chunk.brick_color(brick).as_flattened(),
            );
            queue.write_buffer(
                &self.brick_data,
                at + samples as u64 * 4,
                bytemuck::cast_slice(upload.chunk.brick_normal(brick)),
            );
            if let (Layers::Axes, Some(opacity)) = (self.sizes.layers, upload.chunk.brick_opacity(brick)) {
                queue.write_buffer(&self.brick_data, at + samples as u64 * 8, opacity.as_flattened());
            }
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("upload"),
            timestamp_writes: timestamps,
        });
        if !bricks.is_empty() {
            pass.set_pipeline(&self.scatter_bricks);
            pass.set_bind_group(0, &self.brick_bindings, &[]);
            pass.dispatch_workgroups((samples as u32).div_ceil(64), bricks.len() as u32, 1);
        }
        if !nodes.is_empty() {
            pass.set_pipeline(&self.scatter_nodes);
            pass.set_bind_group(0, &self.node_bindings, &[]);
            pass.dispatch_workgroups((nodes.len() as u32).div_ceil(64), 1, 1);
        }
        nodes.len() as u64 * 16 + bricks.len() as u64 * (self.sizes.brick_bytes() + 4)
    }
}
