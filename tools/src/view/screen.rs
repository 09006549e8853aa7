//! The window's surface and what draws on it: the picture, and figures over it.

use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::present::{Output, Presenter};
use brickfell_runtime::window::WindowSurface;
use egui_wgpu::{Renderer, RendererOptions, ScreenDescriptor};
use winit::window::Window;

/// A window with a device.
pub(super) struct Screen {
    pub(super) window: Arc<Window>,
    pub(super) gpu: Arc<Gpu>,
    surface: WindowSurface,
    presenter: Presenter,
    pub(super) input: egui_winit::State,
    painter: Renderer,
}

impl Screen {
    /// Opens the best device that can show something in a window.
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn open(window: Arc<Window>) -> Result<Self, RuntimeError> {
        let (gpu, surface) = Gpu::open_window(Arc::clone(&window))?;
        let format = surface.format();
        Ok(Self {
            input: egui_winit::State::new(
                egui::Context::default(),
                egui::ViewportId::ROOT,
                &window,
                Some(window.scale_factor() as f32),
                window.theme(),
                Some(gpu.device.limits().max_texture_dimension_2d as usize),
            ),
            painter: Renderer::new(&gpu.device, format, RendererOptions::default()),
            presenter: Presenter::new(&gpu, format),
            window,
            gpu,
            surface,
        })
    }

    /// Pixels; 0 while the window is minimised.
    pub(super) fn size(&self) -> [u32; 2] {
        self.window.inner_size().into()
    }

    /// A texture to be painted; `None` while the window is hidden.
    ///
    /// # Errors
    /// If the surface is lost.
    pub(super) fn acquire(&mut self) -> Result<Option<wgpu::SurfaceTexture>, RuntimeError> {
        self.surface.resize(self.size());
        // Once more if the surface was out of date.
        match self.surface.acquire(&self.gpu)? {
            None => self.surface.acquire(&self.gpu),
            some => Ok(some),
        }
    }

    /// Lays out figures.
    pub(super) fn lay_out(&mut self, mut show: impl FnMut(&egui::Context)) -> egui::FullOutput {
        let input = self.input.take_egui_input(&self.window);
        let ctx = self.input.egui_ctx().clone();
        let output = ctx.run_ui(input, |ui| show(&ui.ctx().clone()));
        self.input
            .handle_platform_output(&self.window, output.platform_output.clone());
        output
    }

    /// Shows the picture, if there is one, and what was laid out over it.
    ///
    /// # Errors
    /// If the device failed.
    pub(super) fn paint(
        &mut self,
        texture: wgpu::SurfaceTexture,
        (picture, camera): (Option<Output<'_>>, &Camera),
        mut output: egui::FullOutput,
    ) -> Result<(), RuntimeError> {
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let jobs = (self.input.egui_ctx()).tessellate(output.shapes, output.pixels_per_point);
        for (id, deltas) in &output.textures_delta.set {
            for delta in deltas {
                self.painter.update_texture(device, queue, *id, delta);
            }
        }
        let size = [texture.texture.width(), texture.texture.height()];
        let screen = ScreenDescriptor {
            size_in_pixels: size,
            pixels_per_point: output.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&Default::default());
        let more = (self.painter).update_buffers(device, queue, &mut encoder, &jobs, &screen);
        let view = texture.texture.create_view(&Default::default());
        if let Some(picture) = picture {
            (self.presenter).draw(&self.gpu, &mut encoder, (&view, size), picture, camera);
        }
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("figures"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Load,
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            self.painter.render(&mut pass.forget_lifetime(), &jobs, &screen);
        }
        queue.submit(more.into_iter().chain([encoder.finish()]));
        for id in &output.textures_delta.free {
            self.painter.free_texture(id);
        }
        output.textures_delta.clear();
        self.window.pre_present_notify();
        queue.present(texture);
        self.gpu.check()
    }
}
