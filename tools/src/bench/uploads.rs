//! Suite `uploads`: bricks on their way into the pool, as the renderer sends them (one buffer, one kernel) and by a copy for each brick
//! and texture. The same bricks to the same slots; what they hold does not matter.

use std::sync::Arc;
use std::time::Instant;

use brickfell_formats::chunk::{Chunk, Layers};
use brickfell_formats::layout::SampleLayout;
use brickfell_pager::{Bricks, ChunkPage};
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::memory::{BrickUpload, MAX_UPLOAD_BRICKS, PoolMemory, PoolSizes};
use serde_json::json;

use super::{Row, Settings, row};
use crate::commands::{CommandError, open_gpu};
use crate::report::Percentiles;

/// Bricks of an upload.
const COUNTS: [usize; 3] = [32, 256, MAX_UPLOAD_BRICKS];
/// Slots per axis of a pool that holds them.
const SLOTS: [u32; 3] = [16, 16, 8];
const REPETITIONS: usize = 15;

/// Bricks of whole chunks, each to a slot of its own.
fn bricks(layout: SampleLayout, layers: Layers, count: usize) -> Vec<BrickUpload> {
    let codes = |n: usize| (0..n).map(|k| [k as u8, (k >> 8) as u8, 90, 200]);
    let chunk = || {
        let samples = 64 * layout.samples();
        let opacities = match layers {
            Layers::Plain => 0,
            Layers::Axes => samples,
        };
        Arc::new(ChunkPage::new(Bricks::Samples(Chunk {
            mask: u64::MAX,
            layout,
            color: codes(samples).collect(),
            normal: codes(samples).map(|c| c.map(u8::cast_signed)).collect(),
            opacity: codes(opacities).collect(),
        })))
    };
    let chunks: Vec<_> = (0..count.div_ceil(64)).map(|_| chunk()).collect();
    (0..count)
        .map(|k| BrickUpload {
            slot: k as u32,
            chunk: Arc::clone(&chunks[k / 64]),
            brick: k as u32 % 64,
        })
        .collect()
}

/// Textures like those of the pool, for copies.
fn textures(gpu: &Gpu, sizes: PoolSizes) -> Vec<wgpu::Texture> {
    use wgpu::TextureFormat as F;
    let formats = [F::Rgba8Unorm, F::Rgba8Snorm, F::Rgba8Unorm];
    let [width, height, depth_or_array_layers] = sizes.texels();
    let texture = |format| {
        gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("bricks by copies"),
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D3,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    };
    let layers = sizes.layers.sample_bytes() / 4;
    formats.into_iter().take(layers).map(texture).collect()
}

/// Asks for a copy for each brick and texture.
fn copy(gpu: &Gpu, textures: &[wgpu::Texture], sizes: PoolSizes, bricks: &[BrickUpload]) {
    let side = sizes.layout.side();
    for upload in bricks {
        let Bricks::Samples(chunk) = upload.chunk.bricks() else {
            continue;
        };
        let k = upload.brick as usize;
        let layers = [
            Some(chunk.brick_color(k).as_flattened()),
            Some(bytemuck::cast_slice(chunk.brick_normal(k))),
            chunk.brick_opacity(k).map(|o| o.as_flattened()),
        ];
        let [x, y, z] = sizes.slot_corner(upload.slot);
        for (texture, samples) in textures.iter().zip(layers.into_iter().flatten()) {
            gpu.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x, y, z },
                    aspect: wgpu::TextureAspect::All,
                },
                samples,
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(side * 4),
                    rows_per_image: Some(side),
                },
                wgpu::Extent3d {
                    width: side,
                    height: side,
                    depth_or_array_layers: side,
                },
            );
        }
    }
}

/// Milliseconds until it is submitted, and until the device has done it.
fn timed(gpu: &Gpu, mut upload: impl FnMut(&mut wgpu::CommandEncoder)) -> Result<[f64; 2], CommandError> {
    let (mut thread, mut done) = (Vec::new(), Vec::new());
    for repetition in 0..REPETITIONS {
        let start = Instant::now();
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        upload(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        let submitted = start.elapsed();
        gpu.wait()?;
        // The first time textures are cleared, too.
        if repetition > 0 {
            thread.push(submitted.as_secs_f64() * 1e3);
            done.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    Ok([thread, done].map(|times| Percentiles::of(times).p50))
}

/// Suite `uploads`.
///
/// # Errors
/// If the device has no room or fails.
pub fn rows(_: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let gpu = open_gpu()?;
    let mut rows = Vec::new();
    for layers in [Layers::Plain, Layers::Axes] {
        let sizes = PoolSizes {
            layout: SampleLayout::Centre,
            layers,
            blocks: false,
            slots: SLOTS,
            tiles: 64,
        };
        let mut pool = PoolMemory::new(&gpu, sizes)?;
        let textures = textures(&gpu, sizes);
        for count in COUNTS {
            let bricks = bricks(sizes.layout, layers, count);
            let scatter = timed(&gpu, |encoder| {
                pool.upload(&gpu, encoder, &[], &bricks, None);
            })?;
            let copies = timed(&gpu, |_| copy(&gpu, &textures, sizes, &bricks))?;
            let bytes = count as f64 * sizes.brick_bytes() as f64;
            rows.push(row(json!({
                "bricks": count,
                "brick_bytes": sizes.brick_bytes(),
                "scatter_thread_ms": scatter[0],
                "scatter_ms": scatter[1],
                "scatter_gb_per_second": bytes * 1e-6 / scatter[1],
                "copies_thread_ms": copies[0],
                "copies_ms": copies[1],
                "copies_gb_per_second": bytes * 1e-6 / copies[1],
                "ratio": copies[1] / scatter[1],
            }))?);
        }
    }
    Ok(rows)
}
