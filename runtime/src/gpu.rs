//! The device: adapter choice, limits, errors. Created once, or an application's own; shared by everything that draws.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::error::RuntimeError;

/// What was asked of a device so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GpuCalls {
    /// Buffers, bind groups and pipelines made; not what wgpu makes for a write to carry it to the device.
    pub made: u64,
    /// Times that somebody waited for it.
    pub waits: u64,
}

/// Features by which block-compressed 3D textures are read.
const BLOCKS: wgpu::Features =
    wgpu::Features::TEXTURE_COMPRESSION_BC.union(wgpu::Features::TEXTURE_COMPRESSION_BC_SLICED_3D);
/// Bindings of the largest kernel, the ray caster.
const STORAGE_BUFFERS: u32 = 9;
const STORAGE_TEXTURES: u32 = 2;

/// An open device and its queue.
#[derive(Debug)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// What the adapter says of itself.
    pub info: wgpu::AdapterInfo,
    /// Nanoseconds per tick if timestamps can be queried.
    pub timestamp_period: Option<f32>,
    /// Whether it samples block-compressed 3D textures.
    pub reads_blocks: bool,
    fault: Arc<Mutex<Option<String>>>,
    made: AtomicU64,
    waits: AtomicU64,
}

impl Gpu {
    /// Opens the best adapter: discrete, integrated, virtual, then software.
    ///
    /// # Errors
    /// If there is no adapter or it gives no device.
    pub fn open() -> Result<Arc<Self>, RuntimeError> {
        let (gpu, _) = pollster::block_on(Self::open_async(&Self::instance(), None))?;
        Ok(gpu)
    }

    pub(crate) fn instance() -> wgpu::Instance {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::PRIMARY;
        wgpu::Instance::new(descriptor)
    }

    /// The best adapter's device; with a surface, the best that can show something on it.
    pub(crate) async fn open_async(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<(Arc<Self>, wgpu::Adapter), RuntimeError> {
        let mut adapters = instance.enumerate_adapters(wgpu::Backends::PRIMARY).await;
        adapters.retain(|a| surface.is_none_or(|s| a.is_surface_supported(s)));
        adapters.sort_by_key(|a| match a.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        let adapter = adapters.into_iter().next().ok_or(RuntimeError::NoAdapter)?;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("brickfell"),
                required_features: Self::features(adapter.features()),
                required_limits: adapter.limits(),
                experimental_features: wgpu::ExperimentalFeatures::disabled(),
                memory_hints: wgpu::MemoryHints::Performance,
                trace: wgpu::Trace::Off,
            })
            .await
            .map_err(|e| RuntimeError::NoDevice {
                adapter: adapter.get_info().name,
                reason: e.to_string(),
            })?;
        let gpu = Self::from_parts(device, queue)?;
        gpu.watch();
        Ok((Arc::new(gpu), adapter))
    }

    /// Features of those available that are made use of: for an application that opens the device itself. None is needed: without
    /// timestamps there are no times of stages, without block-compressed 3D textures such bricks are decoded before they are sent.
    pub fn features(available: wgpu::Features) -> wgpu::Features {
        available & (wgpu::Features::TIMESTAMP_QUERY | BLOCKS)
    }

    /// A device's limits raised to what is needed: for an application that opens the device itself. Those for the size of textures and
    /// buffers bound the pools, so it is best to take `adapter.limits()`.
    pub fn limits(base: wgpu::Limits) -> wgpu::Limits {
        let (buffers, textures) = (
            base.max_storage_buffers_per_shader_stage,
            base.max_storage_textures_per_shader_stage,
        );
        wgpu::Limits {
            max_storage_buffers_per_shader_stage: buffers.max(STORAGE_BUFFERS),
            max_storage_textures_per_shader_stage: textures.max(STORAGE_TEXTURES),
            ..base
        }
    }

    /// A device that an application has opened, to draw on it together with what else is drawn there. Errors of the device go to
    /// where the application has sent them, unless [`Self::watch`] is called. Frames poll the device and so run callbacks of the
    /// application, too.
    ///
    /// # Errors
    /// If its limits are below what [`Self::limits`] asks for.
    pub fn from_parts(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self, RuntimeError> {
        let (info, limits, features) = (device.adapter_info(), device.limits(), device.features());
        if Self::limits(limits.clone()) != limits {
            return Err(RuntimeError::NoDevice {
                adapter: info.name,
                reason: format!(
                    "shaders need {STORAGE_BUFFERS} storage buffers and {STORAGE_TEXTURES} storage textures, it has {} and {}",
                    limits.max_storage_buffers_per_shader_stage, limits.max_storage_textures_per_shader_stage
                ),
            });
        }
        let timestamp_period = features
            .contains(wgpu::Features::TIMESTAMP_QUERY)
            .then(|| queue.get_timestamp_period());
        Ok(Self {
            device,
            queue,
            info,
            timestamp_period,
            reads_blocks: features.contains(BLOCKS),
            fault: Arc::new(Mutex::new(None)),
            made: AtomicU64::new(0),
            waits: AtomicU64::new(0),
        })
    }

    /// From now on errors and the loss of the device are told by [`Self::check`] and so by the next frame, instead of to whom they were
    /// told before.
    pub fn watch(&self) {
        let remember = || {
            let fault = Arc::clone(&self.fault);
            move |message: String| {
                fault
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .get_or_insert(message);
            }
        };
        let (on_error, on_lost) = (remember(), remember());
        (self.device).on_uncaptured_error(Arc::new(move |e: wgpu::Error| on_error(e.to_string())));
        self.device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                on_lost(format!("lost: {message}"));
            }
        });
    }

    /// The first error the device reported, if any.
    ///
    /// # Errors
    /// That error.
    pub fn check(&self) -> Result<(), RuntimeError> {
        match self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone() {
            Some(message) => Err(RuntimeError::Device(message)),
            None => Ok(()),
        }
    }

    /// Waits until everything submitted is done. Never called by a frame that runs in real time.
    ///
    /// # Errors
    /// If the device failed.
    pub fn wait(&self) -> Result<(), RuntimeError> {
        self.waits.fetch_add(1, Ordering::Relaxed);
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| RuntimeError::Device(e.to_string()))?;
        self.check()
    }

    /// What was asked of it so far, by all that share it.
    pub fn calls(&self) -> GpuCalls {
        GpuCalls {
            made: self.made.load(Ordering::Relaxed),
            waits: self.waits.load(Ordering::Relaxed),
        }
    }

    /// Whether the adapter is the CPU with a driver that stands in for a GPU.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Name and kind of the adapter, for reports.
    pub fn describe(&self) -> String {
        format!(
            "{} ({:?}, {})",
            self.info.name, self.info.backend, self.info.driver_info
        )
    }

    pub(crate) fn compute_pipeline(&self, label: &str, source: &str, entry: &str) -> wgpu::ComputePipeline {
        self.compute_pipeline_with(label, source, entry, &[])
    }

    /// With constants of the source.
    pub(crate) fn compute_pipeline_with(
        &self,
        label: &str,
        source: &str,
        entry: &str,
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        self.made.fetch_add(1, Ordering::Relaxed);
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        self.device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: None,
                module: &module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    ..Default::default()
                },
                cache: None,
            })
    }

    pub(crate) fn bind(
        &self,
        pipeline: &wgpu::ComputePipeline,
        resources: &[(u32, wgpu::BindingResource<'_>)],
    ) -> wgpu::BindGroup {
        self.made.fetch_add(1, Ordering::Relaxed);
        let entries: Vec<_> = resources
            .iter()
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding: *binding,
                resource: resource.clone(),
            })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    }

    pub(crate) fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.made.fetch_add(1, Ordering::Relaxed);
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size.next_multiple_of(16).max(16),
            usage,
            mapped_at_creation: false,
        })
    }
}
