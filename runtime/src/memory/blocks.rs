//! Bricks in blocks: textures of BC3 and BC1, which no kernel can write, so each brick is copied, layer by layer, from one
//! buffer.
//!
//! A row of a brick's blocks has 48 or 24 bytes, and wgpu wants rows that begin 256 bytes apart. So bricks lie side by side in the buffer:
//!
//! ```text
//!            256 bytes
//! row 0   | brick 0 | brick 1 | … | brick 4 | 16 spare     a band of five bricks (ten of normals), 3 rows a slice
//! row 1   | brick 0 | brick 1 | …
//! ```
//! Called by the render thread.

use brickfell_formats::blocks::{COLOR_BYTES, PLAIN_BYTES, SLICE_BLOCKS, SLICE_SIDE};
use brickfell_formats::chunk::Layers;
use brickfell_pager::Bricks;

use super::{BrickUpload, MAX_UPLOAD_BRICKS, PoolSizes, Views, texture};
use crate::gpu::Gpu;

/// Bytes from one row of blocks in the buffer to the next.
const ROW: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;
/// Rows of blocks of a slice, and blocks of a row.
const ROWS: usize = SLICE_SIDE as usize / 4;

/// One texture, and how its bricks lie in the buffer.
#[derive(Debug)]
struct Layer {
    texture: wgpu::Texture,
    /// Which of a brick's layers.
    index: usize,
    /// Bytes of a row of a brick's blocks.
    width: usize,
    /// Where the layer's first band begins.
    offset: usize,
}

impl Layer {
    /// Bricks of a band.
    fn bricks_abreast(&self) -> usize {
        ROW / self.width
    }

    /// Where the k-th brick begins. `rows`: of a brick.
    fn place(&self, k: usize, rows: usize) -> usize {
        let abreast = self.bricks_abreast();
        self.offset + k / abreast * rows * ROW + k % abreast * self.width
    }
}

/// Textures and the buffer that bricks are copied from.
#[derive(Debug)]
pub(super) struct BlockWriter {
    layers: Vec<Layer>,
    buffer: wgpu::Buffer,
    staging: Vec<u8>,
}

impl BlockWriter {
    /// Allocates the textures and the buffer.
    pub(super) fn new(gpu: &Gpu, sizes: PoolSizes) -> (Self, Views) {
        use wgpu::{BufferUsages as B, TextureFormat as F, TextureUsages as T};
        let usage = T::TEXTURE_BINDING | T::COPY_DST;
        let pool = sizes.texels();
        let make = |label, size, format| texture(gpu, label, size, format, format, usage);
        let color = make("brick colours", pool, F::Bc3RgbaUnormSrgb);
        let normal = make("brick normals", pool, F::Bc1RgbaUnorm);
        let opacity = match sizes.layers {
            // As large as a block, where nothing is read.
            Layers::Plain => make("brick opacities", [4, 4, 1], F::Bc1RgbaUnorm),
            Layers::Axes => make("brick opacities", pool, F::Bc1RgbaUnorm),
        };
        let views = Views {
            color: color.create_view(&Default::default()),
            normal: normal.create_view(&Default::default()),
            opacity: opacity.create_view(&Default::default()),
        };
        let rows = rows(sizes);
        let (mut layers, mut offset) = (Vec::new(), 0);
        let textures = [
            (color, COLOR_BYTES),
            (normal, PLAIN_BYTES),
            (opacity, PLAIN_BYTES),
        ];
        let count = match sizes.layers {
            Layers::Plain => 2,
            Layers::Axes => 3,
        };
        for (index, (texture, block)) in textures.into_iter().take(count).enumerate() {
            let layer = Layer {
                texture,
                index,
                width: block * SLICE_BLOCKS / ROWS,
                offset,
            };
            offset += MAX_UPLOAD_BRICKS.div_ceil(layer.bricks_abreast()) * rows * ROW;
            layers.push(layer);
        }
        let writer = Self {
            layers,
            buffer: gpu.buffer("brick blocks", offset as u64, B::COPY_SRC | B::COPY_DST),
            staging: Vec::new(),
        };
        (writer, views)
    }

    /// Bytes of the upload's buffer on the device.
    pub(super) fn buffer_bytes(&self) -> u64 {
        self.buffer.size()
    }

    /// Sends the bricks and encodes their copies into their slots. Returns the bytes sent.
    pub(super) fn copy(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        sizes: PoolSizes,
        bricks: &[BrickUpload],
    ) -> u64 {
        let rows = rows(sizes);
        let mut sent = 0;
        for layer in &self.layers {
            let bands = bricks.len().div_ceil(layer.bricks_abreast());
            self.staging.clear();
            self.staging.resize(bands * rows * ROW, 0);
            for (k, upload) in bricks.iter().enumerate() {
                let Bricks::Blocks(chunk) = upload.chunk.bricks() else {
                    continue;
                };
                let from = chunk.brick(upload.brick as usize)[layer.index];
                let first = layer.place(k, rows) - layer.offset;
                for (row, blocks) in from.chunks_exact(layer.width).enumerate() {
                    let at = first + row * ROW;
                    self.staging[at..at + layer.width].copy_from_slice(blocks);
                }
            }
            gpu.queue
                .write_buffer(&self.buffer, layer.offset as u64, &self.staging);
            sent += self.staging.len() as u64;
            for (k, upload) in bricks.iter().enumerate() {
                let [x, y, z] = sizes.slot_corner(upload.slot);
                encoder.copy_buffer_to_texture(
                    wgpu::TexelCopyBufferInfo {
                        buffer: &self.buffer,
                        layout: wgpu::TexelCopyBufferLayout {
                            offset: layer.place(k, rows) as u64,
                            bytes_per_row: Some(ROW as u32),
                            rows_per_image: Some(ROWS as u32),
                        },
                    },
                    wgpu::TexelCopyTextureInfo {
                        texture: &layer.texture,
                        mip_level: 0,
                        origin: wgpu::Origin3d { x, y, z },
                        aspect: wgpu::TextureAspect::All,
                    },
                    wgpu::Extent3d {
                        width: SLICE_SIDE,
                        height: SLICE_SIDE,
                        depth_or_array_layers: sizes.layout.side(),
                    },
                );
            }
        }
        sent
    }
}

/// Rows of blocks of a brick.
fn rows(sizes: PoolSizes) -> usize {
    sizes.layout.side() as usize * ROWS
}
