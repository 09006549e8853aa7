//! What the ray caster draws into: textures and buffers of a picture's size, and what binds them to the kernels.
//!
//! Called by the render thread.

use brickfell_shaders::layout;
use bytemuck::AnyBitPattern;

use super::{Caster, Kernel};
use crate::error::RuntimeError;
use crate::gpu::Gpu;
use crate::memory::PoolMemory;

/// Textures and buffers that depend on the picture's size.
#[derive(Debug)]
pub(super) struct Target {
    /// Columns and rows.
    pub(super) size: [u32; 2],
    pub(super) output: wgpu::Texture,
    pub(super) view: wgpu::TextureView,
    /// Where rays have lost half of their light, if that was asked for.
    pub(super) depth: Option<(wgpu::Texture, wgpu::TextureView)>,
    feedback: wgpu::Buffer,
    lists: wgpu::Buffer,
    pub(super) list_trees: wgpu::BindGroup,
    pub(super) start_rays: wgpu::BindGroup,
    pub(super) compact_pixels: wgpu::BindGroup,
}

impl Target {
    /// For pictures of a size.
    ///
    /// # Errors
    /// If the size is zero or beyond the device's limits.
    pub(super) fn new(
        gpu: &Gpu,
        pools: &PoolMemory,
        caster: &Caster,
        size: [u32; 2],
    ) -> Result<Self, RuntimeError> {
        let feedback_bytes = check(&gpu.device.limits(), size)?;
        let format = wgpu::TextureFormat::Rgba32Float;
        let output = texture(
            gpu,
            "picture",
            size,
            format,
            READ | wgpu::TextureUsages::STORAGE_BINDING,
        );
        let feedback = gpu.buffer("feedback", feedback_bytes, wgpu::BufferUsages::STORAGE);
        let lists = gpu.buffer(
            "lists of trees",
            u64::from(tiles(size)) * layout::LIST_WORDS as u64 * 4,
            wgpu::BufferUsages::STORAGE,
        );
        let list_trees = gpu.bind(
            &caster.list_trees,
            &[
                (0, caster.uniform.as_entire_binding()),
                (1, caster.trees.as_entire_binding()),
                (2, lists.as_entire_binding()),
            ],
        );
        let start_rays = gpu.bind(
            &caster.start_rays,
            &[
                (0, caster.uniform.as_entire_binding()),
                (1, caster.trees.as_entire_binding()),
                (2, pools.nodes.as_entire_binding()),
                (3, pools.occupancy.as_entire_binding()),
                (4, pools.brick_stamps.as_entire_binding()),
                (5, pools.tile_stamps.as_entire_binding()),
                (6, lists.as_entire_binding()),
            ],
        );
        let compact_pixels = gpu.bind(
            &caster.compact_pixels,
            &[
                (0, caster.uniform.as_entire_binding()),
                (1, feedback.as_entire_binding()),
                (4, caster.counters.as_entire_binding()),
            ],
        );
        Ok(Self {
            size,
            view: output.create_view(&Default::default()),
            output,
            depth: None,
            feedback,
            lists,
            list_trees,
            start_rays,
            compact_pixels,
        })
    }

    /// Makes the texture of depths, or lets it go.
    pub(super) fn keep_depth(&mut self, gpu: &Gpu, wanted: bool) {
        self.depth = self.depth.take().filter(|_| wanted);
        if wanted && self.depth.is_none() {
            let usage = READ | wgpu::TextureUsages::STORAGE_BINDING;
            let depth = texture(gpu, "depths", self.size, wgpu::TextureFormat::R32Float, usage);
            let view = depth.create_view(&Default::default());
            self.depth = Some((depth, view));
        }
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> u64 {
        let [width, height] = self.size.map(u64::from);
        let depth = if self.depth.is_some() { 4 } else { 0 };
        width * height * (24 + depth) + self.lists.size()
    }
}

/// What a kernel is bound to.
#[derive(Debug)]
pub(super) struct Cast {
    pub(super) kernel: Kernel,
    until: Option<wgpu::TextureView>,
    pub(super) bindings: wgpu::BindGroup,
}

impl Cast {
    /// Binds a kernel to what it draws into, and the depths at which its rays end.
    pub(super) fn new(
        gpu: &Gpu,
        pools: &PoolMemory,
        caster: &Caster,
        (target, pipeline): (&Target, &wgpu::ComputePipeline),
        kernel: Kernel,
        until: Option<&wgpu::TextureView>,
    ) -> Self {
        use wgpu::BindingResource::{Sampler, TextureView};
        let [no_input, no_output] = &caster.no_depths;
        let depth = target.depth.as_ref().map_or(no_output, |(_, view)| view);
        let bindings = gpu.bind(
            pipeline,
            &[
                (0, caster.uniform.as_entire_binding()),
                (1, caster.trees.as_entire_binding()),
                (2, pools.nodes.as_entire_binding()),
                (3, TextureView(&pools.color)),
                (4, TextureView(&pools.normal)),
                (5, Sampler(&caster.sampler)),
                (6, pools.brick_stamps.as_entire_binding()),
                (7, pools.tile_stamps.as_entire_binding()),
                (8, target.feedback.as_entire_binding()),
                (9, TextureView(&target.view)),
                (10, caster.counters.as_entire_binding()),
                (11, caster.requests.as_entire_binding()),
                (12, TextureView(&pools.opacity)),
                (13, pools.occupancy.as_entire_binding()),
                (14, target.lists.as_entire_binding()),
                (15, TextureView(until.unwrap_or(no_input))),
                (16, TextureView(depth)),
            ],
        );
        Self {
            kernel,
            until: until.cloned(),
            bindings,
        }
    }

    /// Whether it binds these.
    pub(super) fn is_for(&self, kernel: Kernel, until: Option<&wgpu::TextureView>) -> bool {
        self.kernel == kernel && self.until.as_ref() == until
    }
}

/// What textures are used for once they are drawn.
const READ: wgpu::TextureUsages = wgpu::TextureUsages::COPY_SRC.union(wgpu::TextureUsages::TEXTURE_BINDING);

/// Tiles of 8×8 pixels.
pub(super) fn tiles([width, height]: [u32; 2]) -> u32 {
    width.div_ceil(8) * height.div_ceil(8)
}

/// Refuses a size that cannot be drawn; returns the bytes of the rays' feedback.
fn check(limits: &wgpu::Limits, [width, height]: [u32; 2]) -> Result<u64, RuntimeError> {
    let refuse = |reason: String| {
        Err(RuntimeError::Size {
            width,
            height,
            reason,
        })
    };
    let most = limits.max_texture_dimension_2d;
    if width == 0 || height == 0 {
        return refuse("it has no pixel".into());
    }
    if width.max(height) > most {
        return refuse(format!("this device draws up to {most} per axis"));
    }
    let feedback_bytes = u64::from(width) * u64::from(height) * 8;
    if feedback_bytes > limits.max_storage_buffer_binding_size {
        return refuse(format!(
            "its feedback needs {feedback_bytes} bytes in one binding"
        ));
    }
    Ok(feedback_bytes)
}

/// A texture without mip levels.
pub(super) fn texture(
    gpu: &Gpu,
    label: &str,
    [width, height]: [u32; 2],
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// Copies the first columns and rows of a texture back and waits for them; `T` is one of its texels.
///
/// # Errors
/// If the device failed.
pub(super) fn read<T: AnyBitPattern>(
    gpu: &Gpu,
    texture: &wgpu::Texture,
    [width, height]: [u32; 2],
) -> Result<Vec<T>, RuntimeError> {
    let line = width as usize * size_of::<T>();
    let row = (line as u32).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = gpu.buffer(
        "picture read-back",
        u64::from(row) * u64::from(height),
        wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
    );
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row),
                rows_per_image: None,
            },
        },
        wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
    );
    gpu.queue.submit([encoder.finish()]);
    buffer.slice(..).map_async(wgpu::MapMode::Read, |_| {});
    gpu.wait()?;
    let view = buffer
        .slice(..)
        .get_mapped_range()
        .map_err(|e| RuntimeError::Device(e.to_string()))?;
    Ok(view
        .chunks_exact(row as usize)
        .flat_map(|bytes| bytes[..line].chunks_exact(size_of::<T>()))
        .map(bytemuck::pod_read_unaligned)
        .collect())
}
