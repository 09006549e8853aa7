//! The renderer's last picture over the sky, drawn into a window's texture or any other one.
//!
//! Called by the render thread, after [`Renderer::frame`](crate::renderer::Renderer::frame).

use brickfell_culler::Camera;
use brickfell_shaders::{PRESENT, layout};
use glam::Vec3;

use crate::gpu::Gpu;
use crate::picture::Picture;

/// Linear light of the sky at the horizon.
pub const HORIZON: [f32; 3] = [0.55, 0.68, 0.82];
/// Linear light of the sky at the zenith.
pub const ZENITH: [f32; 3] = [0.12, 0.27, 0.60];

/// Where the renderer's last picture is.
#[derive(Clone, Copy, Debug)]
pub enum Output<'a> {
    /// On the device: a texture of premultiplied linear light, of which so many columns and rows were drawn.
    Device(&'a wgpu::TextureView, [u32; 2]),
    /// In memory.
    Memory(&'a Picture),
}

/// Draws pictures into textures of one format.
#[derive(Debug)]
pub struct Presenter {
    pipeline: wgpu::RenderPipeline,
    uniform: wgpu::Buffer,
    /// Whether the format keeps what is written instead of encoding it as sRGB.
    encode: bool,
    /// What pictures in memory are copied to.
    copy: Option<wgpu::Texture>,
}

impl Presenter {
    /// For textures of a format.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("present"),
            source: wgpu::ShaderSource::Wgsl(PRESENT.into()),
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("present"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("whole_target"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("over_sky"),
                compilation_options: Default::default(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let uniform = gpu.buffer(
            "present",
            size_of::<layout::Present>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        Self {
            pipeline,
            uniform,
            encode: !format.is_srgb(),
            copy: None,
        }
    }

    /// Encodes a pass that fills a target of `size` pixels with the picture that the camera sees.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (target, size): (&wgpu::TextureView, [u32; 2]),
        output: Output<'_>,
        camera: &Camera,
    ) {
        let copied;
        let (view, drawn) = match output {
            Output::Device(view, drawn) => (view, drawn),
            Output::Memory(picture) => {
                copied = self.copied(gpu, picture).create_view(&Default::default());
                (&copied, [picture.width, picture.height])
            }
        };
        let axis = |v: glam::DVec3| v.extend(0.0).as_vec4().to_array();
        let uniform = layout::Present {
            forward: axis(camera.forward),
            right: axis(camera.right),
            up: axis(camera.up),
            horizon: Vec3::from(HORIZON).extend(0.0).to_array(),
            zenith: Vec3::from(ZENITH).extend(0.0).to_array(),
            drawn,
            size,
            half: camera.screen_half_extent().as_vec2().to_array(),
            encode: u32::from(self.encode),
            pad: 0,
        };
        gpu.queue
            .write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
        let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: self.uniform.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(view),
                },
            ],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("present"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.draw(0..3, 0..1);
    }

    fn copied(&mut self, gpu: &Gpu, picture: &Picture) -> &wgpu::Texture {
        let size = wgpu::Extent3d {
            width: picture.width,
            height: picture.height,
            depth_or_array_layers: 1,
        };
        let copy = self.copy.take().filter(|texture| texture.size() == size);
        let texture = self.copy.insert(copy.unwrap_or_else(|| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("picture from memory"),
                size,
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            })
        }));
        gpu.queue.write_texture(
            texture.as_image_copy(),
            bytemuck::cast_slice(&picture.pixels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(picture.width * 16),
                rows_per_image: None,
            },
            size,
        );
        texture
    }
}
