//! The ray caster and the compaction of its feedback, encoded: pipelines, the buffers of a picture size, and the ring of
//! read-back buffers that nobody waits for.
//!
//! Called by the render thread. A ring entry is in flight from its submission until its mapping callback has run; when all
//! entries are in flight a frame goes without read-back.

mod target;

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use std::time::Instant;

use brickfell_shaders::layout::{self, COUNTER_WORDS, Request, TABLE_WORDS};
use brickfell_shaders::{BEAM, CAST, COMPACT, LISTS};

use crate::depth::Depths;
use crate::error::RuntimeError;
use crate::gpu::Gpu;
use crate::memory::PoolMemory;
use crate::picture::{Picture, RayCounters};
use crate::settings::{RenderSettings, Shows};
use target::{Cast, Target};

/// Requests that fit a read-back.
pub const REQUEST_CAPACITY: u32 = 8192;
/// Trees that fit a frame's list (a request names a tree in 16 bits, 0 for none).
pub const MAX_TREES: usize = 65_535;

const RING: usize = 3;
const QUERIES: u32 = 6;
const COUNTER_BYTES: u64 = COUNTER_WORDS as u64 * 4;

/// What a ray caster does besides the picture: each combination is compiled for itself, and costs nothing where it is not asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Kernel {
    /// Surfaces hide the sun.
    pub shadows: bool,
    /// Surfaces hide the sky.
    pub occlusion: bool,
    /// What is shown.
    pub shows: Shows,
    /// Rays end at depths.
    pub ends: bool,
    /// Depths are written.
    pub depths: bool,
}

impl Kernel {
    /// What settings and depths ask for.
    pub fn of(settings: &RenderSettings, depths: &Depths) -> Self {
        Self {
            shadows: settings.shadows,
            occlusion: settings.occlusion,
            shows: settings.shows,
            ends: depths.until.is_some(),
            depths: depths.written,
        }
    }

    fn pipeline(self, gpu: &Gpu) -> wgpu::ComputePipeline {
        let one = |wanted| f64::from(u8::from(wanted));
        let constants = [
            ("SUN_CONES", one(self.shadows)),
            ("SKY_CONES", 6.0 * one(self.occlusion)),
            ("SHOWS", f64::from(self.shows as u8)),
            ("ENDS", one(self.ends)),
            ("DEPTHS", one(self.depths)),
        ];
        gpu.compute_pipeline_with("cast", CAST, "cast_rays", &constants)
    }
}

/// What a frame's rays reported.
#[derive(Clone, Debug, Default)]
pub struct Feedback {
    /// The frame.
    pub frame: u32,
    /// What rays lacked, nearly without repetitions.
    pub requests: Vec<Request>,
    /// Requests made, those that did not fit counted too.
    pub request_count: u32,
    /// One bit for each brick slot that was used.
    pub used_bricks: Vec<u32>,
    /// One bit for each node tile that was used.
    pub used_tiles: Vec<u32>,
    /// Sums over the rays.
    pub counters: RayCounters,
    /// Milliseconds on the device: upload, cast, compaction; 0 where the device has no timestamps. That of the upload is an
    /// earlier frame's if nothing was uploaded.
    pub gpu_ms: [f64; 3],
    /// Milliseconds from the submission until the device's word that it is done was heard.
    pub done_ms: f64,
}

impl Feedback {
    /// True if there were more requests than room for them.
    pub fn is_truncated(&self) -> bool {
        self.request_count > REQUEST_CAPACITY
    }
}

#[derive(Debug)]
struct RingEntry {
    buffer: wgpu::Buffer,
    // 0 free, 1 in flight, 2 mapped, 3 failed
    state: Arc<AtomicU8>,
    /// From the submission to the mapping.
    micros: Arc<AtomicU32>,
    frame: u32,
}

/// Pipelines and per-frame buffers of the ray caster.
#[derive(Debug)]
pub struct Caster {
    list_trees: wgpu::ComputePipeline,
    start_rays: wgpu::ComputePipeline,
    /// Ray casters, each made when it was first asked for.
    casts: HashMap<Kernel, wgpu::ComputePipeline>,
    compact_pixels: wgpu::ComputePipeline,
    compact_usage: wgpu::ComputePipeline,
    uniform: wgpu::Buffer,
    trees: wgpu::Buffer,
    sampler: wgpu::Sampler,
    counters: wgpu::Buffer,
    requests: wgpu::Buffer,
    used: wgpu::Buffer,
    usage_bindings: wgpu::BindGroup,
    usage_words: u32,
    queries: Option<wgpu::QuerySet>,
    query_buffer: wgpu::Buffer,
    ring: Vec<RingEntry>,
    /// What is bound in the place of a depth texture to read and one to write.
    no_depths: [wgpu::TextureView; 2],
    target: Option<Target>,
    cast: Option<Cast>,
    /// Pixels of the target that the last frame drew.
    drawn: [u32; 2],
}

impl Caster {
    /// Compiles the kernels for the pools.
    ///
    /// # Errors
    /// If the device reports an error.
    pub fn new(gpu: &Gpu, pools: &PoolMemory) -> Result<Self, RuntimeError> {
        use wgpu::BufferUsages as B;
        let list_trees = gpu.compute_pipeline("list trees", LISTS, "list_trees");
        let start_rays = gpu.compute_pipeline("start rays", BEAM, "start_rays");
        let compact_pixels = gpu.compute_pipeline("compact pixels", COMPACT, "compact_pixels");
        let compact_usage = gpu.compute_pipeline("compact usage", COMPACT, "compact_usage");
        let usage_words = pools.sizes.bricks().div_ceil(32) + pools.sizes.tiles.div_ceil(32);
        let uniform = gpu.buffer(
            "frame",
            size_of::<layout::Frame>() as u64,
            B::UNIFORM | B::COPY_DST,
        );
        let trees = gpu.buffer(
            "trees",
            (MAX_TREES * size_of::<layout::Tree>()) as u64,
            B::STORAGE | B::COPY_DST,
        );
        let read = B::STORAGE | B::COPY_SRC | B::COPY_DST;
        let counters = gpu.buffer("counters", (COUNTER_WORDS + TABLE_WORDS) as u64 * 4, read);
        let requests = gpu.buffer("requests", u64::from(REQUEST_CAPACITY) * 16, read);
        let used = gpu.buffer("used", u64::from(usage_words) * 4, read);
        let usage_bindings = gpu.bind(
            &compact_usage,
            &[
                (0, uniform.as_entire_binding()),
                (2, pools.brick_stamps.as_entire_binding()),
                (3, pools.tile_stamps.as_entire_binding()),
                (5, used.as_entire_binding()),
            ],
        );
        let queries = gpu.timestamp_period.map(|_| {
            gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stages"),
                ty: wgpu::QueryType::Timestamp,
                count: QUERIES,
            })
        });
        let query_buffer = gpu.buffer(
            "stage times",
            u64::from(QUERIES) * 8,
            B::QUERY_RESOLVE | B::COPY_SRC,
        );
        let size = COUNTER_BYTES + requests.size() + used.size() + query_buffer.size();
        let ring = (0..RING)
            .map(|_| RingEntry {
                buffer: gpu.buffer("read-back", size, B::MAP_READ | B::COPY_DST),
                state: Arc::new(AtomicU8::new(0)),
                micros: Arc::new(AtomicU32::new(0)),
                frame: 0,
            })
            .collect();
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("trilinear"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let no_depths = [
            wgpu::TextureUsages::TEXTURE_BINDING,
            wgpu::TextureUsages::STORAGE_BINDING,
        ]
        .map(|usage| {
            let texture = target::texture(gpu, "no depths", [1, 1], wgpu::TextureFormat::R32Float, usage);
            texture.create_view(&Default::default())
        });
        gpu.check()?;
        Ok(Self {
            list_trees,
            start_rays,
            casts: HashMap::new(),
            compact_pixels,
            compact_usage,
            uniform,
            trees,
            sampler,
            counters,
            requests,
            used,
            usage_bindings,
            usage_words,
            queries,
            query_buffer,
            ring,
            no_depths,
            target: None,
            cast: None,
            drawn: [0; 2],
        })
    }

    /// Bytes on the device, the pools' not counted.
    pub fn bytes(&self) -> u64 {
        let fixed = self.trees.size() + self.requests.size() + self.used.size();
        let ring: u64 = self.ring.iter().map(|r| r.buffer.size()).sum();
        fixed + ring + self.target.as_ref().map_or(0, Target::bytes)
    }

    /// Makes buffers fit a picture of a size, and the kernel what is asked for; a kernel is compiled when it is first asked for. `until`:
    /// depths at which rays end, if the kernel has them end.
    ///
    /// # Errors
    /// If the size is zero or beyond the device's limits.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        pools: &PoolMemory,
        size: [u32; 2],
        kernel: Kernel,
        until: Option<&wgpu::TextureView>,
    ) -> Result<(), RuntimeError> {
        let has_size = self.target.as_ref().is_some_and(|t| t.size == size);
        if has_size && self.cast.as_ref().is_some_and(|c| c.is_for(kernel, until)) {
            return Ok(());
        }
        (self.cast, self.drawn) = (None, [0; 2]);
        let old = self.target.take().filter(|_| has_size);
        let mut target = old.map_or_else(|| Target::new(gpu, pools, self, size), Ok)?;
        target.keep_depth(gpu, kernel.depths);
        let pipeline = (self.casts.remove(&kernel)).unwrap_or_else(|| kernel.pipeline(gpu));
        let cast = Cast::new(gpu, pools, self, (&target, &pipeline), kernel, until);
        self.casts.insert(kernel, pipeline);
        gpu.check()?;
        (self.target, self.cast) = (Some(target), Some(cast));
        Ok(())
    }

    /// The last picture's texture, and how many of its columns and rows were drawn.
    pub fn output(&self) -> Option<(&wgpu::TextureView, [u32; 2])> {
        let target = self.target.as_ref().filter(|_| self.drawn != [0; 2])?;
        Some((&target.view, self.drawn))
    }

    /// The depths of the last picture, as [`Self::output`], if they were written.
    pub fn depth(&self) -> Option<(&wgpu::TextureView, [u32; 2])> {
        let target = self.target.as_ref().filter(|_| self.drawn != [0; 2])?;
        Some((target.depth.as_ref().map(|(_, view)| view)?, self.drawn))
    }

    /// Timestamps of stage k (0 upload, 1 cast, 2 compaction).
    pub fn timestamps(&self, stage: u32) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        self.queries
            .as_ref()
            .map(|query_set| wgpu::ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(stage * 2),
                end_of_pass_write_index: Some(stage * 2 + 1),
            })
    }

    /// Encodes the cast of `frame.size` pixels (at most the target's) and the compaction, and the copy to a free ring entry;
    /// returns that entry.
    pub fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        frame: &layout::Frame,
        trees: &[layout::Tree],
    ) -> Option<usize> {
        let (target, cast) = (self.target.as_ref()?, self.cast.as_ref()?);
        self.drawn = frame.size;
        gpu.queue
            .write_buffer(&self.uniform, 0, bytemuck::bytes_of(frame));
        gpu.queue
            .write_buffer(&self.trees, 0, bytemuck::cast_slice(trees));
        encoder.clear_buffer(&self.counters, 0, None);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("cast"),
                timestamp_writes: self.timestamps(1),
            });
            let [width, height] = frame.size;
            let tile_groups = target::tiles(frame.size).div_ceil(64);
            if frame.lists != 0 {
                pass.set_pipeline(&self.list_trees);
                pass.set_bind_group(0, &target.list_trees, &[]);
                pass.dispatch_workgroups(tile_groups, 1, 1);
            }
            pass.set_pipeline(&self.start_rays);
            pass.set_bind_group(0, &target.start_rays, &[]);
            pass.dispatch_workgroups(tile_groups, 1, 1);
            pass.set_pipeline(self.casts.get(&cast.kernel)?);
            pass.set_bind_group(0, &cast.bindings, &[]);
            pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        }
        let entry = self
            .ring
            .iter()
            .position(|r| r.state.load(Ordering::Acquire) == 0)?;
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("compact"),
                timestamp_writes: self.timestamps(2),
            });
            pass.set_pipeline(&self.compact_pixels);
            pass.set_bind_group(0, &target.compact_pixels, &[]);
            let pixels = frame.size[0] * frame.size[1];
            pass.dispatch_workgroups(pixels.div_ceil(64 * 64), 1, 1);
            pass.set_pipeline(&self.compact_usage);
            pass.set_bind_group(0, &self.usage_bindings, &[]);
            pass.dispatch_workgroups(self.usage_words.div_ceil(64), 1, 1);
        }
        if let Some(queries) = &self.queries {
            encoder.resolve_query_set(queries, 0..QUERIES, &self.query_buffer, 0);
        }
        let ring = &mut self.ring[entry];
        let mut at = 0;
        let whole = [&self.query_buffer, &self.used, &self.requests].map(|b| (b, b.size()));
        for (part, size) in [(&self.counters, COUNTER_BYTES)].into_iter().chain(whole) {
            encoder.copy_buffer_to_buffer(part, 0, &ring.buffer, at, size);
            at += size;
        }
        ring.frame = frame.frame;
        Some(entry)
    }

    /// To be called after the submission of what [`Self::encode`] recorded.
    pub fn submitted(&mut self, entry: usize) {
        let ring = &mut self.ring[entry];
        ring.state.store(1, Ordering::Release);
        let (state, micros) = (Arc::clone(&ring.state), Arc::clone(&ring.micros));
        let start = Instant::now();
        ring.buffer.slice(..).map_async(wgpu::MapMode::Read, move |r| {
            micros.store(start.elapsed().as_micros() as u32, Ordering::Relaxed);
            state.store(if r.is_ok() { 2 } else { 3 }, Ordering::Release)
        });
    }

    /// Takes what has arrived, oldest first, without waiting.
    pub fn collect(&mut self, gpu: &Gpu, pools: &PoolMemory) -> Vec<Feedback> {
        // A failed poll shows as a device error at the next check.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        let mut arrived = Vec::new();
        for ring in &mut self.ring {
            match ring.state.load(Ordering::Acquire) {
                2 => {
                    if let Ok(view) = ring.buffer.slice(..).get_mapped_range() {
                        let sizes = [COUNTER_BYTES, self.query_buffer.size(), self.used.size()];
                        let feedback = parse(ring.frame, &view, sizes, gpu.timestamp_period, pools);
                        arrived.push(Feedback {
                            done_ms: f64::from(ring.micros.load(Ordering::Relaxed)) * 1e-3,
                            ..feedback
                        });
                    }
                    ring.buffer.unmap();
                    ring.state.store(0, Ordering::Release);
                }
                3 => ring.state.store(0, Ordering::Release),
                _ => {}
            }
        }
        arrived.sort_by_key(|f| f.frame);
        arrived
    }

    /// Copies the last picture back and waits for it. One that was drawn with fewer pixels than the target has is enlarged to the target's
    /// size here, by the CPU: this is for files and figures.
    ///
    /// # Errors
    /// If nothing was drawn yet or the device failed.
    pub fn read_picture(&self, gpu: &Gpu) -> Result<Picture, RuntimeError> {
        let Some(target) = self.target.as_ref().filter(|_| self.drawn != [0; 2]) else {
            return Err(RuntimeError::Device("no picture was drawn yet".into()));
        };
        let drawn = Picture {
            width: self.drawn[0],
            height: self.drawn[1],
            pixels: target::read(gpu, &target.output, self.drawn)?,
        };
        let [width, height] = target.size;
        Ok(drawn.resized(width, height))
    }

    /// Copies the last picture's depths back and waits for them: a row after the other, as many as were drawn.
    ///
    /// # Errors
    /// If none were written or the device failed.
    pub fn read_depths(&self, gpu: &Gpu) -> Result<(Vec<f32>, [u32; 2]), RuntimeError> {
        let target = self.target.as_ref().filter(|_| self.drawn != [0; 2]);
        let Some((texture, _)) = target.and_then(|t| t.depth.as_ref()) else {
            return Err(RuntimeError::Device("no depths were drawn".into()));
        };
        Ok((target::read(gpu, texture, self.drawn)?, self.drawn))
    }
}

fn parse(frame: u32, bytes: &[u8], sizes: [u64; 3], period: Option<f32>, pools: &PoolMemory) -> Feedback {
    let words = |range: std::ops::Range<usize>| -> Vec<u32> {
        bytes[range]
            .chunks_exact(4)
            .map(bytemuck::pod_read_unaligned)
            .collect()
    };
    let [counters, queries, used] = sizes.map(|s| s as usize);
    let c = words(0..counters);
    let ticks: Vec<u64> = bytes[counters..counters + queries]
        .chunks_exact(8)
        .map(bytemuck::pod_read_unaligned)
        .collect();
    let used_words = words(counters + queries..counters + queries + used);
    let brick_words = pools.sizes.bricks().div_ceil(32) as usize;
    let tile_words = pools.sizes.tiles.div_ceil(32) as usize;
    let count = c[layout::COUNTER_REQUESTS].min(REQUEST_CAPACITY) as usize;
    let at = counters + queries + used;
    let requests = bytes[at..at + count * 16]
        .chunks_exact(16)
        .filter_map(|b| Request::unpack(bytemuck::pod_read_unaligned(&b[..12])))
        .collect();
    let stage = |k: usize| {
        period.map_or(0.0, |p| {
            ticks[k * 2 + 1].saturating_sub(ticks[k * 2]) as f64 * f64::from(p) * 1e-6
        })
    };
    Feedback {
        frame,
        requests,
        request_count: c[layout::COUNTER_REQUESTS],
        used_bricks: used_words[..brick_words].to_vec(),
        used_tiles: used_words[brick_words..brick_words + tile_words].to_vec(),
        counters: RayCounters {
            rays_hit: c[layout::COUNTER_HITS].into(),
            nodes: c[layout::COUNTER_NODES].into(),
            samples: c[layout::COUNTER_SAMPLES].into(),
            texture_reads: c[layout::COUNTER_READS].into(),
            capped: c[layout::COUNTER_CAPPED].into(),
            not_finite: c[layout::COUNTER_NOT_FINITE].into(),
        },
        gpu_ms: [stage(0), stage(1), stage(2)],
        done_ms: 0.0,
    }
}
