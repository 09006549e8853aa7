//! A window's surface: what pictures are shown on, through resizing, hiding and loss.
//!
//! Called by the thread that owns the window.

use std::sync::Arc;

use crate::error::RuntimeError;
use crate::gpu::Gpu;

/// A window's surface.
#[derive(Debug)]
pub struct WindowSurface {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    /// Whether the surface is as `config` says.
    configured: bool,
}

impl Gpu {
    /// Opens the best adapter that can show something in a window, and the window's surface, which has no size yet.
    ///
    /// # Errors
    /// If there is no such adapter, or it gives no device.
    pub fn open_window(
        window: impl Into<wgpu::SurfaceTarget<'static>>,
    ) -> Result<(Arc<Self>, WindowSurface), RuntimeError> {
        let no_surface =
            |e: String| RuntimeError::Device(format!("nothing can be drawn into the window: {e}"));
        let instance = Self::instance();
        let surface = instance
            .create_surface(window)
            .map_err(|e| no_surface(e.to_string()))?;
        let (gpu, adapter) = pollster::block_on(Self::open_async(&instance, Some(&surface)))?;
        let mut config = surface
            .get_default_config(&adapter, 1, 1)
            .ok_or_else(|| no_surface("it has no format".into()))?;
        // What is written is sRGB already, as user interfaces are blended.
        let formats = surface.get_capabilities(&adapter).formats;
        let plain = formats.into_iter().find(|format| {
            use wgpu::TextureFormat as F;
            matches!(format, F::Bgra8Unorm | F::Rgba8Unorm)
        });
        config.format = plain.unwrap_or(config.format);
        config.present_mode = wgpu::PresentMode::AutoVsync;
        let surface = WindowSurface {
            surface,
            config,
            configured: false,
        };
        Ok((gpu, surface))
    }
}

impl WindowSurface {
    /// The format of its textures.
    pub fn format(&self) -> wgpu::TextureFormat {
        self.config.format
    }

    /// Pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    /// To be called when the window has another size. A size without pixels, as that of a minimised window, is not taken.
    pub fn resize(&mut self, size: [u32; 2]) {
        if size.contains(&0) || size == self.size() {
            return;
        }
        [self.config.width, self.config.height] = size;
        self.configured = false;
    }

    /// A texture to draw into and to present; `None` if there is none now, because the window is hidden or changing.
    ///
    /// # Errors
    /// If the surface is lost; it has to be opened anew.
    pub fn acquire(&mut self, gpu: &Gpu) -> Result<Option<wgpu::SurfaceTexture>, RuntimeError> {
        use wgpu::CurrentSurfaceTexture as Current;
        if !self.configured {
            self.surface.configure(&gpu.device, &self.config);
            self.configured = true;
        }
        match self.surface.get_current_texture() {
            Current::Success(texture) => Ok(Some(texture)),
            Current::Suboptimal(texture) => {
                self.configured = false;
                Ok(Some(texture))
            }
            Current::Outdated => {
                self.configured = false;
                Ok(None)
            }
            Current::Timeout | Current::Occluded => Ok(None),
            Current::Lost | Current::Validation => {
                gpu.check()?;
                Err(RuntimeError::Device("the window's surface is lost".into()))
            }
        }
    }
}
