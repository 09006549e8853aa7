//! The application's side: polygons with colour and depth, and what lays a picture with depths over them. Nothing in it knows the ray caster
//! but [`Layer`], which it fills.

use brickfell_runtime::depth::DepthScale;
use glam::{Mat4, Vec3, Vec4};
use wgpu::util::DeviceExt;

const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Linear light.
const SKY: wgpu::Color = wgpu::Color {
    r: 0.4,
    g: 0.55,
    b: 0.75,
    a: 1.0,
};

const SHADERS: &str = "
struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
}

@group(0) @binding(0) var<uniform> clip: mat4x4<f32>;

@vertex
fn polygon(@location(0) position: vec3<f32>, @location(1) color: vec4<f32>) -> Vertex {
    return Vertex(clip * vec4(position, 1.0), color);
}

@fragment
fn paint(vertex: Vertex) -> @location(0) vec4<f32> {
    return vertex.color;
}

// The picture's light, premultiplied by its opacity; depths along the camera's axis; a depth buffer's value is x + y / depth.
@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var depths: texture_2d<f32>;
@group(0) @binding(2) var<uniform> scale: vec4<f32>;

struct Pixel {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@vertex
fn everywhere(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn lay_over(@builtin(position) position: vec4<f32>) -> Pixel {
    let at = vec2<i32>(position.xy);
    let depth = textureLoad(depths, at, 0).x;
    return Pixel(textureLoad(picture, at, 0), scale.x + scale.y / depth);
}
";

/// Triangles of premultiplied linear colours.
#[derive(Default)]
pub(crate) struct Mesh {
    vertices: Vec<[f32; 7]>,
}

impl Mesh {
    fn add_face(&mut self, corner: Vec3, u: Vec3, v: Vec3, color: Vec4) {
        for at in [
            corner,
            corner + u,
            corner + v,
            corner + v,
            corner + u,
            corner + u + v,
        ] {
            let [x, y, z] = at.to_array();
            let [r, g, b, a] = color.to_array();
            self.vertices.push([x, y, z, r * a, g * a, b * a, a]);
        }
    }

    /// A box's upper face.
    pub(crate) fn add_top(&mut self, low: Vec3, high: Vec3, color: Vec4) {
        let side = high - low;
        self.add_face(low.with_z(high.z), side.x * Vec3::X, side.y * Vec3::Y, color);
    }

    /// A box, lit by the renderer's sun, which is in the south-east.
    pub(crate) fn add_box(&mut self, low: Vec3, high: Vec3, color: Vec4) {
        let (x, y, z) = (
            (high - low) * Vec3::X,
            (high - low) * Vec3::Y,
            (high - low) * Vec3::Z,
        );
        let lit = |light: f32| (color.truncate() * light).extend(color.w);
        self.add_top(low, high, lit(0.8));
        self.add_face(low, x, z, lit(0.65));
        self.add_face(low + x, y, z, lit(0.65));
        self.add_face(low + y, x, z, lit(0.3));
        self.add_face(low, y, z, lit(0.3));
    }
}

/// A picture of the same camera with its depths.
pub(crate) struct Layer<'a> {
    pub(crate) picture: &'a wgpu::TextureView,
    pub(crate) depths: &'a wgpu::TextureView,
}

/// An application's picture in the making.
pub(crate) struct Polygons {
    device: wgpu::Device,
    queue: wgpu::Queue,
    color: wgpu::Texture,
    color_view: wgpu::TextureView,
    /// What is nearer has the larger value: a reversed projection.
    pub(crate) depth: wgpu::TextureView,
    paint: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    /// Colour over what is there, then depth where it is nearer.
    lay_over: [wgpu::RenderPipeline; 2],
}

impl Polygons {
    /// `clip`: from metres relative to the eye.
    pub(crate) fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        [width, height]: [u32; 2],
        clip: Mat4,
    ) -> Self {
        let texture = |format, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: None,
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | usage,
                view_formats: &[],
            })
        };
        let color = texture(COLOR, wgpu::TextureUsages::COPY_SRC);
        // Bound by the ray caster, too.
        let depth = texture(DEPTH, wgpu::TextureUsages::TEXTURE_BINDING);
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(SHADERS.into()),
        });
        let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x4];
        let vertices = wgpu::VertexBufferLayout {
            array_stride: size_of::<[f32; 7]>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &attributes,
        };
        let pipeline = |[vertex, fragment]: [&str; 2], write_mask, depth_compare, writes_depth: bool| {
            let vertices = [Some(vertices.clone())];
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(fragment),
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: Default::default(),
                    buffers: if vertex == "polygon" { &vertices } else { &[] },
                },
                primitive: Default::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(writes_depth),
                    depth_compare: Some(depth_compare),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: Default::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: COLOR,
                        blend: Some(wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING),
                        write_mask,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        use wgpu::{ColorWrites as Writes, CompareFunction as Compare};
        let paint = pipeline(["polygon", "paint"], Writes::ALL, Compare::Greater, true);
        let over = ["everywhere", "lay_over"];
        let uniform = uniform(device, &clip.to_cols_array());
        Self {
            bindings: device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &paint.get_bind_group_layout(0),
                entries: &[wgpu::BindGroupEntry {
                    binding: 0,
                    resource: uniform.as_entire_binding(),
                }],
            }),
            paint,
            lay_over: [
                pipeline(over, Writes::ALL, Compare::Always, false),
                pipeline(over, Writes::empty(), Compare::Greater, true),
            ],
            color_view: color.create_view(&Default::default()),
            color,
            depth: depth.create_view(&Default::default()),
            device: device.clone(),
            queue: queue.clone(),
        }
    }

    /// Draws and submits; the first time over the sky.
    fn pass(&self, is_first: bool, draw: impl FnOnce(&mut wgpu::RenderPass<'_>)) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: None,
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.color_view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: if is_first {
                        wgpu::LoadOp::Clear(SKY)
                    } else {
                        wgpu::LoadOp::Load
                    },
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: if is_first {
                        wgpu::LoadOp::Clear(0.0)
                    } else {
                        wgpu::LoadOp::Load
                    },
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        draw(&mut pass);
        drop(pass);
        self.queue.submit([encoder.finish()]);
    }

    /// Draws polygons; the first time over the sky.
    pub(crate) fn draw(&self, mesh: &Mesh, is_first: bool) {
        let vertices = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&mesh.vertices),
            usage: wgpu::BufferUsages::VERTEX,
        });
        self.pass(is_first, |pass| {
            pass.set_pipeline(&self.paint);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.set_vertex_buffer(0, vertices.slice(..));
            pass.draw(0..mesh.vertices.len() as u32, 0..1);
        });
    }

    /// Lays a picture over what was drawn. All of it is in front of that, for its rays ended there: so its colour is blended
    /// everywhere, and its depth taken over where rays did not get through.
    pub(crate) fn lay_over(&self, layer: &Layer<'_>, scale: DepthScale) {
        let [offset, factor, _] = scale.to_array();
        let scale = uniform(&self.device, &[offset, factor, 0.0, 0.0]);
        let resources = [
            wgpu::BindingResource::TextureView(layer.picture),
            wgpu::BindingResource::TextureView(layer.depths),
            scale.as_entire_binding(),
        ];
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.pass(false, |pass| {
            for pipeline in &self.lay_over {
                let bindings = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: None,
                    layout: &pipeline.get_bind_group_layout(0),
                    entries: &entries,
                });
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, &bindings, &[]);
                pass.draw(0..3, 0..1);
            }
        });
    }

    /// The picture's bytes, row after row; waits for the device.
    pub(crate) fn read(&self) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
        let (width, height) = (self.color.width(), self.color.height());
        let row = (width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: u64::from(row) * u64::from(height),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            self.color.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row),
                    rows_per_image: None,
                },
            },
            self.color.size(),
        );
        self.queue.submit([encoder.finish()]);
        buffer.slice(..).map_async(wgpu::MapMode::Read, |_| {});
        self.device.poll(wgpu::PollType::wait_indefinitely())?;
        let rows = buffer.slice(..).get_mapped_range()?;
        let rows = rows.chunks_exact(row as usize);
        Ok(rows
            .flat_map(|bytes| bytes[..width as usize * 4].to_vec())
            .collect())
    }
}

fn uniform(device: &wgpu::Device, values: &[f32]) -> wgpu::Buffer {
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: None,
        contents: bytemuck::cast_slice(values),
        usage: wgpu::BufferUsages::UNIFORM,
    })
}
