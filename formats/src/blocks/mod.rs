//! Bricks in the blocks of BC3 and BC1, which graphics hardware samples as they are: a quarter of the memory, with a loss.
//!
//! A brick is cut into slices along z and those into blocks of 4×4 samples; a slice of 9 or 10 samples a side is filled up to 12×12 by
//! repeating its last row and column. Bricks stand one after the other, in the order of the mask, each with these layers:
//!
//! ```text
//! colour and alpha   BC3, 16 bytes a block    straight sRGB colour; the alpha of the sample
//! normal             BC1,  8 bytes a block    straight normal, around a code of 0 that blocks can have exactly
//! shares             BC1,  8 bytes a block    opacities against x, y, z over alpha, if there are opacities against the axes
//!
//! a layer            slices from the low z up, in each rows of blocks from the low y up, in these blocks from the low x up
//! ```
//!
//! Only alpha says how much is there. What it is multiplied with is stored without it (a look, `looks`) because four values on a line serve
//! for the colours of a surface, but not for these and all their products with what is a little of it. Who draws blocks
//! multiplies after filtering.
//!
//! Invariants: a sample is nothing if and only if it was before, and opaque under the builder's gain if it was, with the margin of solid
//! ground. Samples that
//! neighbouring bricks share are coded with each of them, and come out a little different. Any thread.
//!
//! | module | what |
//! |---|---|
//! | `color` | BC1, and the colour half of BC3 |
//! | `alpha` | the alpha half of BC3 |
//! | `looks` | samples to looks and back |

mod alpha;
mod color;
mod looks;

use crate::chunk::{Chunk, Layers};
use crate::error::FormatError;
use crate::layout::SampleLayout;
use crate::occupancy::Occupancy;

/// Texels of a slice of a brick per axis, x and y.
pub const SLICE_SIDE: u32 = BLOCKS_PER_AXIS as u32 * 4;
/// Blocks of a slice.
pub const SLICE_BLOCKS: usize = BLOCKS_PER_AXIS * BLOCKS_PER_AXIS;
/// Bytes of a block of colour and alpha.
pub const COLOR_BYTES: usize = alpha::BYTES + color::BYTES;
/// Bytes of a block of normals or of shares.
pub const PLAIN_BYTES: usize = color::BYTES;
/// Code of 0 in each component of a normal: what end points of 5, 6 and 5 bits have nearest to the middle.
pub const NORMAL_ZERO: [u8; 3] = [132, 130, 132];
/// Codes from 0 to 1 of a component of a normal.
pub const NORMAL_SCALE: [u8; 3] = [123, 125, 123];

const BLOCKS_PER_AXIS: usize = 3;

/// Stored alpha from which on samples are opaque under the builder's gain of 2.
const OPAQUE: u8 = 128;

/// Bytes of a brick in blocks.
pub const fn brick_bytes(layout: SampleLayout, layers: Layers) -> usize {
    let block = match layers {
        Layers::Plain => COLOR_BYTES + PLAIN_BYTES,
        Layers::Axes => COLOR_BYTES + 2 * PLAIN_BYTES,
    };
    layout.side() as usize * SLICE_BLOCKS * block
}

/// How the values between the end points of a block become bytes. The specification leaves that to devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Between {
    /// The nearest byte. Files mean this one.
    #[default]
    Nearest,
    /// Weights in 1/256, and all rounded down: Mesa's software devices.
    Floored,
}

impl Between {
    /// `part` of `parts` of the way from one byte to another.
    fn mix(self, from: u8, to: u8, part: u16, parts: u16) -> u8 {
        match self {
            Self::Nearest => {
                let sum = u16::from(from) * (parts - part) + u16::from(to) * part;
                ((sum + parts / 2) / parts) as u8
            }
            Self::Floored => {
                let weight = (255 * 64 / i32::from(parts) * i32::from(part)) >> 6;
                (i32::from(from) + (((i32::from(to) - i32::from(from)) * weight) >> 8)) as u8
            }
        }
    }
}

/// Bricks of a chunk in blocks, in Morton order of their place in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockChunk {
    mask: u64,
    layout: SampleLayout,
    layers: Layers,
    bytes: Vec<u8>,
}

/// What the blocks of a brick say, before anything is multiplied with alpha: x fastest, without the padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texels {
    /// Straight sRGB colour, and alpha.
    pub color: Vec<[u8; 4]>,
    /// Straight normals in codes of [`NORMAL_ZERO`] and [`NORMAL_SCALE`].
    pub normal: Vec<[u8; 3]>,
    /// Opacities against the axes over alpha, over 255; empty where the brick has none.
    pub share: Vec<[u8; 3]>,
}

impl BlockChunk {
    /// The chunk of a payload whose checksum has been verified.
    ///
    /// # Errors
    /// If it does not have the bytes of its bricks.
    pub fn new(bytes: Vec<u8>, mask: u64, layout: SampleLayout, layers: Layers) -> Result<Self, FormatError> {
        let expected = mask.count_ones() as usize * brick_bytes(layout, layers);
        if bytes.len() != expected {
            return Err(FormatError::file(format!(
                "chunk payload has {} bytes, {expected} expected",
                bytes.len()
            )));
        }
        Ok(Self {
            mask,
            layout,
            layers,
            bytes,
        })
    }

    /// Codes samples, which match their mask.
    pub(crate) fn encode(chunk: &Chunk) -> Self {
        let (layout, layers) = (chunk.layout, chunk.layers());
        let mut bytes = Vec::with_capacity(chunk.bricks() * brick_bytes(layout, layers));
        for k in 0..chunk.bricks() {
            let looks = looks::Looks::new(chunk, k);
            let side = layout.side() as usize;
            for block in blocks(side) {
                let alphas = block.map(|at| chunk.brick_color(k)[at][3]);
                bytes.extend(alpha::encode(&alphas));
                bytes.extend(color::encode(
                    &block.map(|at| looks.color[at]),
                    &weights(&block, &looks),
                ));
            }
            for layer in [Some(&looks.normal), looks.share.as_ref()].into_iter().flatten() {
                for block in blocks(side) {
                    bytes.extend(color::encode(
                        &block.map(|at| layer[at]),
                        &weights(&block, &looks),
                    ));
                }
            }
        }
        Self {
            mask: chunk.mask,
            layout,
            layers,
            bytes,
        }
    }

    /// Which bricks are present, as in [`Chunk::mask`].
    pub fn mask(&self) -> u64 {
        self.mask
    }

    /// Where samples lie.
    pub fn layout(&self) -> SampleLayout {
        self.layout
    }

    /// What is stored of each sample.
    pub fn layers(&self) -> Layers {
        self.layers
    }

    /// Number of bricks.
    pub fn bricks(&self) -> usize {
        self.mask.count_ones() as usize
    }

    /// Bytes the chunk takes in memory.
    pub fn memory(&self) -> usize {
        self.bytes.len() + size_of::<Self>()
    }

    /// The payload.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The payload, taken.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// The blocks of brick k: those of colours, of normals, and of shares (none where the file has none).
    pub fn brick(&self, k: usize) -> [&[u8]; 3] {
        let mut bricks = self.bytes.chunks_exact(brick_bytes(self.layout, self.layers));
        let blocks = self.layout.side() as usize * SLICE_BLOCKS;
        let brick = bricks.nth(k).unwrap_or_default();
        let (color, rest) = brick.split_at_checked(blocks * COLOR_BYTES).unwrap_or_default();
        let (normal, share) = rest.split_at_checked(blocks * PLAIN_BYTES).unwrap_or_default();
        [color, normal, share]
    }

    /// Where brick k shows anything.
    pub fn occupancy(&self, k: usize) -> Occupancy {
        let (halves, _) = self.brick(k)[0].as_chunks::<8>();
        let mut some = vec![false; self.layout.samples()];
        for (block, halves) in blocks(self.layout.side() as usize).zip(halves.chunks_exact(2)) {
            let alphas = alpha::decode(halves[0], Between::Nearest);
            for (t, at) in block.into_iter().enumerate().rev() {
                some[at] = alphas[t] != 0;
            }
        }
        Occupancy::new(self.layout, |at| some[at])
    }

    /// What the blocks of brick k say.
    pub fn texels(&self, k: usize, between: Between) -> Texels {
        let samples = self.layout.samples();
        let side = self.layout.side() as usize;
        let [colors, normals, shares] = self.brick(k);
        let mut out = Texels {
            color: vec![[0; 4]; samples],
            normal: vec![[0; 3]; samples],
            share: vec![[0; 3]; if shares.is_empty() { 0 } else { samples }],
        };
        let (halves, _) = colors.as_chunks::<8>();
        for (block, halves) in blocks(side).zip(halves.chunks_exact(2)) {
            let alphas = alpha::decode(halves[0], between);
            let colors = color::decode(halves[1], true, between);
            // Backwards, so that of places that are named more than once the first, not the padding, counts.
            for (t, at) in block.into_iter().enumerate().rev() {
                let [r, g, b] = colors[t];
                out.color[at] = [r, g, b, alphas[t]];
            }
        }
        for (layer, coded) in [(&mut out.normal, normals), (&mut out.share, shares)] {
            let (coded, _) = coded.as_chunks::<8>();
            for (block, coded) in blocks(side).zip(coded) {
                let codes = color::decode(*coded, false, between);
                for (t, at) in block.into_iter().enumerate().rev() {
                    layer[at] = codes[t];
                }
            }
        }
        out
    }

    /// The samples, with looks multiplied as far as there is something.
    pub fn samples(&self) -> Chunk {
        let mut chunk = Chunk {
            mask: self.mask,
            layout: self.layout,
            color: Vec::new(),
            normal: Vec::new(),
            opacity: Vec::new(),
        };
        for k in 0..self.bricks() {
            looks::append(&self.texels(k, Between::Nearest), &mut chunk);
        }
        chunk
    }
}

/// The samples of each block of a brick, x fastest; places in the padding are those of the samples that are repeated there.
fn blocks(side: usize) -> impl Iterator<Item = [usize; 16]> {
    let last = side - 1;
    (0..side * SLICE_BLOCKS).map(move |block| {
        let z = block / SLICE_BLOCKS;
        let [x, y] = [block % BLOCKS_PER_AXIS, block / BLOCKS_PER_AXIS % BLOCKS_PER_AXIS].map(|b| b * 4);
        std::array::from_fn(|t| (z * side + (y + t / 4).min(last)) * side + (x + t % 4).min(last))
    })
}

/// What the looks of a block's texels weigh; those in the padding, which are never drawn, nothing.
fn weights(block: &[usize; 16], looks: &looks::Looks) -> [f32; 16] {
    std::array::from_fn(|t| match block[..t].contains(&block[t]) {
        true => 0.0,
        false => looks.weight[block[t]],
    })
}
