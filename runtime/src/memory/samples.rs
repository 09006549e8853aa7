//! Bricks as samples: RGBA8 textures, and the kernel that scatters the bricks of a frame, which travel in one buffer.
//!
//! wgpu pads texture rows to 256 bytes and pays for every copy, so a brick of ten samples a row is not copied. Called by the render
//! thread.

use brickfell_formats::chunk::Layers;
use brickfell_pager::Bricks;
use brickfell_shaders::SCATTER;

use super::{BrickUpload, MAX_UPLOAD_BRICKS, PoolSizes, Views, texture};
use crate::gpu::Gpu;

/// Pipeline and buffers of the scatter.
#[derive(Debug)]
pub(super) struct SampleWriter {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    slots: wgpu::Buffer,
    data: wgpu::Buffer,
    staging: Vec<u32>,
}

impl SampleWriter {
    /// Allocates the textures, and what writes them; `uniform` is what the kernels of an upload are told.
    pub(super) fn new(gpu: &Gpu, sizes: PoolSizes, uniform: &wgpu::Buffer) -> (Self, Views) {
        use wgpu::{BufferUsages as B, TextureFormat as F, TextureUsages as T};
        let usage = T::TEXTURE_BINDING | T::STORAGE_BINDING;
        let pool = sizes.texels();
        let pair = |label, size, format, sampled| {
            let texture = texture(gpu, label, size, format, sampled, usage);
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
        let (color, color_store) = pair("brick colours", pool, F::Rgba8Unorm, F::Rgba8UnormSrgb);
        let (normal, normal_store) = pair("brick normals", pool, F::Rgba8Snorm, F::Rgba8Snorm);
        let opacities = match sizes.layers {
            Layers::Plain => [1; 3],
            Layers::Axes => pool,
        };
        let (opacity, opacity_store) = pair("brick opacities", opacities, F::Rgba8Unorm, F::Rgba8Unorm);
        let slots = gpu.buffer(
            "brick slots",
            MAX_UPLOAD_BRICKS as u64 * 4,
            B::STORAGE | B::COPY_DST,
        );
        let data = gpu.buffer(
            "brick data",
            MAX_UPLOAD_BRICKS as u64 * sizes.brick_bytes(),
            B::STORAGE | B::COPY_DST,
        );
        let pipeline = gpu.compute_pipeline("scatter bricks", SCATTER, "scatter_bricks");
        let bindings = gpu.bind(
            &pipeline,
            &[
                (0, uniform.as_entire_binding()),
                (3, slots.as_entire_binding()),
                (4, data.as_entire_binding()),
                (5, wgpu::BindingResource::TextureView(&color_store)),
                (6, wgpu::BindingResource::TextureView(&normal_store)),
                (7, wgpu::BindingResource::TextureView(&opacity_store)),
            ],
        );
        let writer = Self {
            pipeline,
            bindings,
            slots,
            data,
            staging: Vec::new(),
        };
        let views = Views {
            color,
            normal,
            opacity,
        };
        (writer, views)
    }

    /// Bytes of the upload's buffers on the device.
    pub(super) fn buffer_bytes(&self) -> u64 {
        self.slots.size() + self.data.size()
    }

    /// Sends the bricks; [`Self::scatter`] puts them into their slots. Returns the bytes sent.
    pub(super) fn send(&mut self, gpu: &Gpu, sizes: PoolSizes, bricks: &[BrickUpload]) -> u64 {
        let queue = &gpu.queue;
        self.staging.clear();
        self.staging.extend(bricks.iter().map(|b| b.slot));
        queue.write_buffer(&self.slots, 0, bytemuck::cast_slice(&self.staging));
        let bytes = bricks.len() as u64 * sizes.brick_bytes();
        let Some(size) = wgpu::BufferSize::new(bytes) else {
            return 0;
        };
        // Straight into the one buffer that carries all of them; a device without memory for it has said so.
        let Some(mut view) = queue.write_buffer_with(&self.data, 0, size) else {
            return 0;
        };
        let layer = sizes.layout.samples() * 4;
        for (k, upload) in bricks.iter().enumerate() {
            let Bricks::Samples(chunk) = upload.chunk.bricks() else {
                continue;
            };
            let brick = upload.brick as usize;
            let parts = [
                Some(chunk.brick_color(brick).as_flattened()),
                Some(bytemuck::cast_slice(chunk.brick_normal(brick))),
                chunk.brick_opacity(brick).map(|o| o.as_flattened()),
            ];
            let count = sizes.layers.sample_bytes() / 4;
            for (part, samples) in parts.into_iter().take(count).enumerate() {
                if let Some(samples) = samples {
                    let at = (k * count + part) * layer;
                    view.slice(at..at + layer).copy_from_slice(samples);
                }
            }
        }
        bytes + bricks.len() as u64 * 4
    }

    /// Encodes the kernel for so many bricks.
    pub(super) fn scatter(&self, pass: &mut wgpu::ComputePass<'_>, sizes: PoolSizes, bricks: usize) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups((sizes.layout.samples() as u32).div_ceil(64), bricks as u32, 1);
    }
}
