//! The brick files of a tree: which chunks they have, what is in a chunk, and the file's bytes by range.
//!
//! The directory has the length and the checksum of every payload, so it takes making all of them once; after that a payload
//! is made alone when it is read.

use std::collections::BTreeMap;
use std::ops::Range;

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES};
use brickfell_formats::chunk::{Chunk, Encoding, brick_positions};
use brickfell_formats::error::FormatError;
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::morton;
use glam::UVec3;

use super::field::Field;
use super::tree::{Place, Shape};

const LAYOUT: SampleLayout = SampleLayout::Centre;
/// Bricks of a chunk per axis, log2.
const CHUNK_LOG2: u8 = 2;

/// A chunk of a level.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkPlace {
    /// In chunks of the level.
    position: UVec3,
    mask: u64,
    /// Where its payload is in the file.
    offset: u64,
    length: u64,
}

/// A brick file without its payloads.
#[derive(Clone, Debug)]
pub(super) struct BrickFile {
    header: [u8; HEADER_BYTES],
    directory: Vec<u8>,
    pub(super) chunks: Vec<ChunkPlace>,
}

/// A part of a brick file.
pub(super) enum Part<'a> {
    Header(&'a [u8]),
    Payload(u32),
    Directory(&'a [u8]),
}

impl BrickFile {
    /// Makes every payload of a level, calls with each and its number, and keeps the directory.
    ///
    /// # Errors
    /// None for a terrain within the limits of the store.
    pub(super) fn new(
        field: &Field,
        place: Place,
        shape: &Shape,
        level: u8,
        mut made: impl FnMut(u32, Vec<u8>),
    ) -> Result<Self, FormatError> {
        let mut masks: BTreeMap<u64, u64> = BTreeMap::new();
        for y in 0..1u32 << level {
            for x in 0..1u32 << level {
                for z in shape.bricks(level, x, y) {
                    let p = UVec3::new(x, y, z);
                    let in_chunk = morton::encode(p & UVec3::splat((1 << CHUNK_LOG2) - 1));
                    *masks
                        .entry(morton::encode(p >> u32::from(CHUNK_LOG2)))
                        .or_default() |= 1 << in_chunk;
                }
            }
        }
        let mut writer = BrickFileWriter::new(level, LAYOUT, CHUNK_LOG2, Encoding::Packed);
        let mut offset = HEADER_BYTES as u64;
        let mut chunks = Vec::with_capacity(masks.len());
        for (number, (code, mask)) in (0..).zip(masks) {
            let mut chunk = ChunkPlace {
                position: morton::decode(code),
                mask,
                offset,
                length: 0,
            };
            let payload = chunk.payload(field, place, level)?;
            writer.push(chunk.position, mask, &payload)?;
            chunk.length = payload.len() as u64;
            offset += chunk.length;
            chunks.push(chunk);
            made(number, payload);
        }
        let (directory, header) = writer.finish();
        Ok(Self {
            header,
            directory,
            chunks,
        })
    }

    fn payloads_end(&self) -> u64 {
        self.chunks
            .last()
            .map_or(HEADER_BYTES as u64, |c| c.offset + c.length)
    }

    /// Bytes of the file.
    pub(super) fn len(&self) -> u64 {
        self.payloads_end() + self.directory.len() as u64
    }

    /// Bytes it takes in memory.
    pub(super) fn bytes(&self) -> usize {
        size_of::<Self>() + self.directory.len() + self.chunks.len() * size_of::<ChunkPlace>()
    }

    /// The parts that a range of the file touches, each with its own range in the file.
    pub(super) fn parts(&self, range: Range<u64>) -> impl Iterator<Item = (Range<u64>, Part<'_>)> {
        let end = self.payloads_end();
        let header = (0..HEADER_BYTES as u64, Part::Header(&self.header));
        let directory = (end..self.len(), Part::Directory(&self.directory));
        let first = self
            .chunks
            .partition_point(|c| c.offset + c.length <= range.start);
        let last = self.chunks.partition_point(|c| c.offset < range.end).max(first);
        let payloads = (first..last).map(|k| {
            let chunk = &self.chunks[k];
            (chunk.offset..chunk.offset + chunk.length, Part::Payload(k as u32))
        });
        std::iter::once(header)
            .chain(payloads)
            .chain(std::iter::once(directory))
            .filter(move |(part, _)| part.start < range.end && range.start < part.end)
    }
}

impl ChunkPlace {
    /// Makes the payload.
    ///
    /// # Errors
    /// None for a terrain within the limits of the store.
    pub(super) fn payload(&self, field: &Field, place: Place, level: u8) -> Result<Vec<u8>, FormatError> {
        let apron = i64::from(LAYOUT.low_apron());
        let brick = BRICK_VOXELS as usize;
        let bricks = 1usize << CHUNK_LOG2.min(level);
        let side = bricks * brick + (LAYOUT.side() as usize - brick);
        let corner = self.position.as_i64vec3() * ((i64::from(BRICK_VOXELS)) << CHUNK_LOG2);
        let patch = place.patch(field, level, [corner.x - apron, corner.y - apron], side);
        let columns = field.columns(&patch);
        let bottom = place.low(level)[2] + corner.z - apron;
        let samples = self.mask.count_ones() as usize * LAYOUT.samples();
        let mut chunk = Chunk {
            mask: self.mask,
            layout: LAYOUT,
            color: Vec::with_capacity(samples),
            normal: Vec::with_capacity(samples),
            opacity: Vec::new(),
        };
        let n = LAYOUT.side() as usize;
        for p in brick_positions(self.mask) {
            let [x, y, z] = (p * BRICK_VOXELS).as_usizevec3().to_array();
            for height in 0..n {
                for row in columns.chunks_exact(side).skip(y).take(n) {
                    for column in &row[x..x + n] {
                        let sample = Field::sample(column, bottom + (z + height) as i64);
                        chunk.color.push(sample.color);
                        chunk.normal.push(sample.normal);
                    }
                }
            }
        }
        chunk.encode(Encoding::Packed)
    }
}
