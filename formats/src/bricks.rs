//! The brick file of one level: header, chunk payloads in Morton order, directory. Little-endian.
//!
//! ```text
//! 0   magic "BRKFBRK\0"    8
//! 8   version u32          4
//! 12  level u8, layout u8, chunk side log2 u8, layers u8 (bit 0 colour, bit 1 normal, bit 2 opacities)
//! 16  encoding u8, zero × 3
//! 20  chunks u32           4
//! 24  bricks u32           4
//! 28  crc32 of the directory  4
//! 32  directory offset u64 8
//! 40  zero × 20
//! 60  crc32 of bytes 0..60 4
//! 64  payloads …
//!     directory: chunks × { Morton code u64, mask u64, offset u64, length u32, crc32 u32 }
//! ```
//! Bricks of a level are numbered in Morton order. Chunks are aligned cubes of 2^k bricks, so the bricks of a chunk have
//! consecutive numbers, beginning with the chunk's [`ChunkEntry::first_brick`].

use std::ops::Range;

use glam::UVec3;

use crate::blocks::BlockChunk;
use crate::chunk::{Chunk, Encoding, Layers, MAX_CHUNK_SIDE};
use crate::error::FormatError;
use crate::layout::SampleLayout;
use crate::morton;
use crate::octree::MAX_DEPTH;

/// First bytes of the file.
pub const MAGIC: [u8; 8] = *b"BRKFBRK\0";
/// Version written and read.
pub const VERSION: u32 = 1;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 64;
/// Bytes of a directory entry.
pub const ENTRY_BYTES: usize = 32;

/// Longest payload of a chunk. The largest chunk has 34³ samples of 7 or 10 bytes, and a compressor adds little to noise.
pub const MAX_PAYLOAD: u32 = 1 << 19;

const MAX_CHUNK_LOG2: u8 = MAX_CHUNK_SIDE.ilog2() as u8;

/// Properties of a brick file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickHeader {
    /// Level of the tree.
    pub level: u8,
    /// Where samples lie.
    pub layout: SampleLayout,
    /// Bricks per chunk and axis are `1 << chunk_log2`, at most 4.
    pub chunk_log2: u8,
    /// What is stored of each sample.
    pub layers: Layers,
    /// How payloads are coded.
    pub encoding: Encoding,
    /// Chunks in the file.
    pub chunks: u32,
    /// Bricks in the file.
    pub bricks: u32,
    /// Where the directory begins.
    pub directory_offset: u64,
    directory_crc: u32,
}

/// A chunk's place in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkEntry {
    /// Morton code of the chunk's position, in chunks of its level.
    pub morton: u64,
    /// Which bricks are present (Morton order inside the chunk).
    pub mask: u64,
    /// Byte offset of the payload.
    pub offset: u64,
    /// Bytes of the payload.
    pub length: u32,
    /// Checksum of the payload.
    pub crc: u32,
    /// Number, in the level, of the chunk's first brick.
    pub first_brick: u32,
}

/// Header and directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BrickIndex {
    /// Properties.
    pub header: BrickHeader,
    /// Chunks in Morton order.
    pub chunks: Vec<ChunkEntry>,
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    bytes
        .get(offset..offset + 4)
        .and_then(|b| b.try_into().ok())
        .map_or(0, u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    u64::from(u32_at(bytes, offset)) | u64::from(u32_at(bytes, offset + 4)) << 32
}

/// Reads the first [`HEADER_BYTES`] of a file that is `file_len` bytes long.
///
/// # Errors
/// Wrong magic, version or checksum, an unknown layout, layer or encoding, a directory outside the file.
pub fn decode_header(bytes: &[u8], file_len: u64) -> Result<BrickHeader, FormatError> {
    if bytes.len() < HEADER_BYTES || bytes[..8] != MAGIC {
        return Err(FormatError::at(0, "not a brickfell brick file (wrong magic)"));
    }
    let version = u32_at(bytes, 8);
    if version != VERSION {
        return Err(FormatError::at(
            8,
            format!("brick file version {version} is unknown (this reads {VERSION})"),
        ));
    }
    if crc32fast::hash(&bytes[..60]) != u32_at(bytes, 60) {
        return Err(FormatError::at(
            60,
            "header checksum does not match: the file is damaged",
        ));
    }
    let unknown = |at: u64, what: &str, code: u8| FormatError::at(at, format!("{what} {code} is unknown"));
    if bytes[12] > MAX_DEPTH {
        return Err(unknown(12, "level", bytes[12]));
    }
    if bytes[14] > MAX_CHUNK_LOG2 {
        return Err(unknown(14, "chunk size", bytes[14]));
    }
    // Whatever gives these bytes a meaning raises the version.
    if bytes[17..20].iter().chain(&bytes[40..60]).any(|b| *b != 0) {
        return Err(FormatError::at(17, "unused bytes are not zero"));
    }
    let header = BrickHeader {
        level: bytes[12],
        layout: SampleLayout::from_code(bytes[13]).ok_or_else(|| unknown(13, "sample layout", bytes[13]))?,
        chunk_log2: bytes[14],
        layers: Layers::from_code(bytes[15]).ok_or_else(|| unknown(15, "layer set", bytes[15]))?,
        encoding: Encoding::from_code(bytes[16]).ok_or_else(|| unknown(16, "encoding", bytes[16]))?,
        chunks: u32_at(bytes, 20),
        bricks: u32_at(bytes, 24),
        directory_crc: u32_at(bytes, 28),
        directory_offset: u64_at(bytes, 32),
    };
    let range = header.directory();
    if range.start < HEADER_BYTES as u64 || range.end != file_len {
        return Err(FormatError::at(
            32,
            format!("the directory ends at byte {}, the file at {file_len}", range.end),
        ));
    }
    Ok(header)
}

impl BrickHeader {
    /// Whether a chunk at a Morton code with these bricks lies inside the level.
    fn contains(&self, morton: u64, mask: u64) -> bool {
        // Bits of Morton codes: of bricks in a chunk (a coarse level may be smaller than one), of chunks in the level.
        let in_chunk = 3 * u32::from(self.chunk_log2.min(self.level));
        let in_level = 3 * u32::from(self.level - self.chunk_log2.min(self.level));
        self.level <= MAX_DEPTH
            && mask != 0
            && mask.checked_shr(1 << in_chunk).unwrap_or(0) == 0
            && morton.checked_shr(in_level).unwrap_or(0) == 0
    }

    /// Bytes of the directory in the file.
    pub fn directory(&self) -> Range<u64> {
        let len = u64::from(self.chunks) * ENTRY_BYTES as u64;
        self.directory_offset..self.directory_offset.saturating_add(len)
    }

    /// Reads the directory (the bytes of [`Self::directory`]).
    ///
    /// # Errors
    /// A bad checksum, chunks out of order, empty, outside the level or the payload area, counts that do not add up.
    pub fn decode_directory(self, bytes: &[u8]) -> Result<BrickIndex, FormatError> {
        let at = self.directory_offset;
        if bytes.len() as u64 != u64::from(self.chunks) * ENTRY_BYTES as u64 {
            return Err(FormatError::at(at, "the directory is cut short"));
        }
        if crc32fast::hash(bytes) != self.directory_crc {
            return Err(FormatError::at(
                at,
                "directory checksum does not match: the file is damaged",
            ));
        }
        let mut chunks = Vec::with_capacity(self.chunks as usize);
        let (mut end, mut first_brick, mut last) = (HEADER_BYTES as u64, 0u32, None);
        for (k, b) in bytes.chunks_exact(ENTRY_BYTES).enumerate() {
            let entry = ChunkEntry {
                morton: u64_at(b, 0),
                mask: u64_at(b, 8),
                offset: u64_at(b, 16),
                length: u32_at(b, 24),
                crc: u32_at(b, 28),
                first_brick,
            };
            let sound = self.contains(entry.morton, entry.mask)
                && entry.length <= MAX_PAYLOAD
                && last.is_none_or(|l| l < entry.morton)
                && entry.offset == end
                && entry.offset + u64::from(entry.length) <= at;
            if !sound {
                return Err(FormatError::at(
                    at + (k * ENTRY_BYTES) as u64,
                    "directory entry is not plausible",
                ));
            }
            end += u64::from(entry.length);
            first_brick = first_brick.saturating_add(entry.mask.count_ones());
            last = Some(entry.morton);
            chunks.push(entry);
        }
        if end != at {
            return Err(FormatError::at(
                end,
                format!("the payloads end here, the directory begins at byte {at}"),
            ));
        }
        if first_brick != self.bricks {
            return Err(FormatError::at(
                24,
                format!("{} bricks declared, {first_brick} listed", self.bricks),
            ));
        }
        Ok(BrickIndex { header: self, chunks })
    }
}

impl BrickIndex {
    /// The chunk that holds a brick of the level, and the brick's place among the chunk's bricks.
    pub fn locate(&self, brick: u32) -> Option<(u32, u32)> {
        let chunk = self
            .chunks
            .partition_point(|c| c.first_brick <= brick)
            .checked_sub(1)?;
        let local = brick - self.chunks[chunk].first_brick;
        (local < self.chunks[chunk].mask.count_ones()).then_some((chunk as u32, local))
    }

    /// Position of a chunk's low corner, in bricks (nodes) of its level.
    pub fn chunk_corner(&self, chunk: &ChunkEntry) -> UVec3 {
        morton::decode(chunk.morton) << u32::from(self.header.chunk_log2)
    }

    /// Checks a payload as read from the file and decodes it, from whatever encoding, to samples.
    ///
    /// # Errors
    /// A short read, a bad checksum, a payload that does not decode.
    pub fn decode_chunk(&self, chunk: u32, bytes: &[u8]) -> Result<Chunk, FormatError> {
        let entry = self.checked(chunk, bytes)?;
        let BrickHeader {
            layout,
            layers,
            encoding,
            ..
        } = self.header;
        Chunk::decode(bytes, entry.mask, layout, layers, encoding)
            .map_err(|e| FormatError::at(entry.offset, format!("chunk {chunk}: {}", e.message)))
    }

    /// Checks a payload as read from the file and keeps its blocks as they are.
    ///
    /// # Errors
    /// As [`Self::decode_chunk`], and if the file is not in blocks.
    pub fn block_chunk(&self, chunk: u32, bytes: Vec<u8>) -> Result<BlockChunk, FormatError> {
        let entry = self.checked(chunk, &bytes)?;
        if self.header.encoding != Encoding::Blocks {
            return Err(FormatError::at(16, "bricks are not block-compressed"));
        }
        BlockChunk::new(bytes, entry.mask, self.header.layout, self.header.layers)
            .map_err(|e| FormatError::at(entry.offset, format!("chunk {chunk}: {}", e.message)))
    }

    /// The entry of a payload whose length and checksum are right.
    fn checked(&self, chunk: u32, bytes: &[u8]) -> Result<&ChunkEntry, FormatError> {
        let Some(entry) = self.chunks.get(chunk as usize) else {
            return Err(FormatError::file(format!("there is no chunk {chunk}")));
        };
        if bytes.len() != entry.length as usize {
            return Err(FormatError::at(
                entry.offset,
                format!("chunk {chunk} is cut short"),
            ));
        }
        if crc32fast::hash(bytes) != entry.crc {
            return Err(FormatError::at(
                entry.offset,
                format!("checksum of chunk {chunk} does not match: the file is damaged"),
            ));
        }
        Ok(entry)
    }
}

/// Collects the payloads of a level in Morton order and gives the file's parts.
///
/// The caller writes the payloads as they come (their places are counted here), then the directory, and at last the
/// header, known only then, over the file's first bytes.
#[derive(Debug)]
pub struct BrickFileWriter {
    header: BrickHeader,
    directory: Vec<u8>,
    last: Option<u64>,
}

impl BrickFileWriter {
    /// A file of one level with chunks of `1 << chunk_log2` bricks per axis (at most 4). Write [`HEADER_BYTES`] zeros first.
    pub fn new(level: u8, layout: SampleLayout, chunk_log2: u8, encoding: Encoding) -> Self {
        Self {
            header: BrickHeader {
                level,
                layout,
                chunk_log2: chunk_log2.min(MAX_CHUNK_LOG2),
                layers: Layers::Plain,
                encoding,
                chunks: 0,
                bricks: 0,
                directory_offset: HEADER_BYTES as u64,
                directory_crc: 0,
            },
            directory: Vec::new(),
            last: None,
        }
    }

    /// The same with other layers, which all its chunks must have.
    pub fn with_layers(mut self, layers: Layers) -> Self {
        self.header.layers = layers;
        self
    }

    /// Enters the next payload, to be written where the last one ended.
    ///
    /// # Errors
    /// If the chunk does not follow the last one in Morton order, is empty or outside the level, or is longer than
    /// [`MAX_PAYLOAD`].
    pub fn push(&mut self, position: UVec3, mask: u64, payload: &[u8]) -> Result<(), FormatError> {
        let code = morton::encode(position);
        if morton::decode(code) != position || !self.header.contains(code, mask) {
            return Err(FormatError::file(format!(
                "chunk {position} with bricks {mask:#x} is empty or outside level {}",
                self.header.level
            )));
        }
        if self.last.is_some_and(|l| l >= code) {
            return Err(FormatError::file("chunks are not in Morton order"));
        }
        let length = u32::try_from(payload.len()).unwrap_or(u32::MAX);
        if length > MAX_PAYLOAD {
            return Err(FormatError::file(format!(
                "a chunk has {} bytes, above {MAX_PAYLOAD}",
                payload.len()
            )));
        }
        let counts = self
            .header
            .chunks
            .checked_add(1)
            .zip(self.header.bricks.checked_add(mask.count_ones()));
        let Some((chunks, bricks)) = counts else {
            return Err(FormatError::file("a level has more than 2^32 bricks"));
        };
        self.last = Some(code);
        self.directory.extend_from_slice(&code.to_le_bytes());
        self.directory.extend_from_slice(&mask.to_le_bytes());
        self.directory
            .extend_from_slice(&self.header.directory_offset.to_le_bytes());
        self.directory.extend_from_slice(&length.to_le_bytes());
        self.directory
            .extend_from_slice(&crc32fast::hash(payload).to_le_bytes());
        self.header.directory_offset += u64::from(length);
        (self.header.chunks, self.header.bricks) = (chunks, bricks);
        Ok(())
    }

    /// The directory, to be written after the last payload, and the header, to be written to the first bytes.
    pub fn finish(mut self) -> (Vec<u8>, [u8; HEADER_BYTES]) {
        self.header.directory_crc = crc32fast::hash(&self.directory);
        let h = &self.header;
        let mut out = [0u8; HEADER_BYTES];
        out[..8].copy_from_slice(&MAGIC);
        out[8..12].copy_from_slice(&VERSION.to_le_bytes());
        out[12..16].copy_from_slice(&[h.level, h.layout as u8, h.chunk_log2, h.layers as u8]);
        out[16] = h.encoding as u8;
        out[20..24].copy_from_slice(&h.chunks.to_le_bytes());
        out[24..28].copy_from_slice(&h.bricks.to_le_bytes());
        out[28..32].copy_from_slice(&h.directory_crc.to_le_bytes());
        out[32..40].copy_from_slice(&h.directory_offset.to_le_bytes());
        let crc = crc32fast::hash(&out[..60]);
        out[60..].copy_from_slice(&crc.to_le_bytes());
        (self.directory, out)
    }
}

/// Name of the brick file of a level, beside its octree file: `a/b.oct` → `a/b.L03.brk`.
pub fn brick_file_name(tree_file: &str, level: u8) -> String {
    let stem = match tree_file.rfind('.') {
        Some(dot) if dot > tree_file.rfind('/').map_or(0, |s| s + 1) => &tree_file[..dot],
        _ => tree_file,
    };
    format!("{stem}.L{level:02}.brk")
}
