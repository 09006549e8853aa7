//! The binary octree file: header, table of levels, node tiles breadth-first. Little-endian.
//!
//! ```text
//! 0    magic "BRKFOCT\0"           8
//! 8    version u32                 4
//! 12   depth u8, layout u8, gain u8, zero u8
//! 16   origin x, y, z f64          24   metres
//! 40   voxel size f64              8    metres
//! 48   surface voxels u64          8
//! 56   crc32 of bytes 0..56 and 64..end of the table   4
//! 60   zero                        4
//! 64   surface bounds 6 × u32      24   finest voxels from the origin, low then high (exclusive)
//! 88   table: (depth + 1) × { offset u64, nodes u32, crc32 u32 }
//!      level 0, level 1, …: their nodes, packed; a level ends where the next begins, the last with the file
//! ```
//! A reader that wants only the coarse tree reads [`prefix_len`] bytes, decodes the header, then one level at a time.

use glam::{DVec3, UVec3};

use crate::error::FormatError;
use crate::layout::SampleLayout;
use crate::octree::{MAX_DEPTH, Node, Octree, TreeHeader, check_level};
use crate::pack::{decode_nodes, encode_nodes, packed_nodes_bytes};

/// First bytes of the file.
pub const MAGIC: [u8; 8] = *b"BRKFOCT\0";
/// Version written and read.
pub const VERSION: u32 = 2;

const TABLE: usize = 88;
const ENTRY: usize = 16;

/// Longest header and table: what to read (or the whole file if shorter) before [`decode_header`].
pub const fn prefix_len() -> usize {
    TABLE + ENTRY * (MAX_DEPTH as usize + 1)
}

/// Where a level's nodes are in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelEntry {
    /// Byte offset in the file.
    pub offset: u64,
    /// Bytes in the file.
    pub bytes: u64,
    /// Number of nodes: 1 for the root, else a multiple of 8.
    pub nodes: u32,
    /// Checksum of the level's bytes.
    pub crc: u32,
}

/// Header and table of an octree file.
#[derive(Clone, Debug, PartialEq)]
pub struct OctreeIndex {
    /// The tree's properties.
    pub header: TreeHeader,
    /// One entry a level, `depth + 1` of them.
    pub levels: Vec<LevelEntry>,
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

fn f64_at(bytes: &[u8], offset: usize) -> f64 {
    f64::from_bits(u64_at(bytes, offset))
}

fn header_crc(bytes: &[u8], table_end: usize) -> u32 {
    let mut crc = crc32fast::Hasher::new();
    crc.update(&bytes[..56]);
    crc.update(&bytes[64..table_end]);
    crc.finalize()
}

/// True if the bytes begin as a binary octree file does (else it may be XML).
pub fn is_binary(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC[..4])
}

/// Writes a tree.
///
/// # Errors
/// If the tree breaks an invariant of [`crate::octree`].
pub fn encode(tree: &Octree) -> Result<Vec<u8>, FormatError> {
    tree.validate()?;
    let h = &tree.header;
    let mut out = Vec::new();
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&[h.depth, h.layout as u8, h.gain, 0]);
    for v in h.origin.to_array().into_iter().chain([h.voxel_size]) {
        out.extend_from_slice(&v.to_le_bytes());
    }
    out.extend_from_slice(&h.surface_voxels.to_le_bytes());
    out.extend_from_slice(&[0; 8]);
    for v in h.surface_bounds.iter().flat_map(|p| p.to_array()) {
        out.extend_from_slice(&v.to_le_bytes());
    }
    let table_end = TABLE + ENTRY * tree.levels.len();
    let mut body = Vec::new();
    for nodes in &tree.levels {
        let level = encode_nodes(nodes);
        out.extend_from_slice(&((table_end + body.len()) as u64).to_le_bytes());
        out.extend_from_slice(&(nodes.len() as u32).to_le_bytes());
        out.extend_from_slice(&crc32fast::hash(&level).to_le_bytes());
        body.extend_from_slice(&level);
    }
    let crc = header_crc(&out, table_end);
    out[56..60].copy_from_slice(&crc.to_le_bytes());
    out.extend_from_slice(&body);
    Ok(out)
}

/// Reads header and table from the first bytes of a file that is `file_len` bytes long.
///
/// # Errors
/// Wrong magic or version, unknown layout or gain, a bad checksum, levels that do not end where the file does.
pub fn decode_header(bytes: &[u8], file_len: u64) -> Result<OctreeIndex, FormatError> {
    if bytes.len() < 16 || bytes[..8] != MAGIC {
        return Err(FormatError::at(0, "not a brickfell octree file (wrong magic)"));
    }
    let version = u32_at(bytes, 8);
    if version != VERSION {
        return Err(FormatError::at(
            8,
            format!("octree version {version} is unknown (this reads {VERSION})"),
        ));
    }
    let depth = bytes[12];
    if depth > MAX_DEPTH {
        return Err(FormatError::at(12, format!("depth {depth} is above {MAX_DEPTH}")));
    }
    let table_end = TABLE + ENTRY * (usize::from(depth) + 1);
    if bytes.len() < table_end {
        return Err(FormatError::at(
            bytes.len() as u64,
            "the file ends inside its header",
        ));
    }
    if header_crc(bytes, table_end) != u32_at(bytes, 56) {
        return Err(FormatError::at(
            56,
            "header checksum does not match: the file is damaged",
        ));
    }
    // Outside the checksum or not used yet; whatever gives these bytes a meaning raises the version.
    for range in [15..16, 60..64] {
        if bytes[range.clone()].iter().any(|b| *b != 0) {
            return Err(FormatError::at(
                range.start as u64,
                "unused bytes are not zero: the file is damaged",
            ));
        }
    }
    let layout = SampleLayout::from_code(bytes[13])
        .ok_or_else(|| FormatError::at(13, format!("sample layout {} is unknown", bytes[13])))?;
    let header = TreeHeader {
        origin: DVec3::new(f64_at(bytes, 16), f64_at(bytes, 24), f64_at(bytes, 32)),
        voxel_size: f64_at(bytes, 40),
        depth,
        layout,
        gain: bytes[14],
        surface_voxels: u64_at(bytes, 48),
        surface_bounds: [64, 76]
            .map(|o| UVec3::new(u32_at(bytes, o), u32_at(bytes, o + 4), u32_at(bytes, o + 8))),
    };
    header.validate()?;
    let mut levels = Vec::with_capacity(usize::from(depth) + 1);
    let mut offset = table_end as u64;
    for level in 0..=depth {
        let at = TABLE + ENTRY * usize::from(level);
        let end = if level == depth {
            file_len
        } else {
            u64_at(bytes, at + ENTRY)
        };
        let nodes = u32_at(bytes, at + 8);
        let whole = if level == 0 {
            nodes == 1
        } else {
            nodes.is_multiple_of(8)
        };
        let [least, most] = packed_nodes_bytes(nodes).map(|bytes| offset.saturating_add(bytes));
        if !whole || u64_at(bytes, at) != offset || end < least || end > most {
            return Err(FormatError::at(
                at as u64,
                format!("table entry of level {level} is not plausible"),
            ));
        }
        if end > file_len {
            return Err(FormatError::at(
                file_len,
                format!("the file ends inside level {level}"),
            ));
        }
        levels.push(LevelEntry {
            offset,
            bytes: end - offset,
            nodes,
            crc: u32_at(bytes, at + 12),
        });
        offset = end;
    }
    Ok(OctreeIndex { header, levels })
}

impl OctreeIndex {
    /// Decodes the bytes of one level, as read from [`LevelEntry::offset`], [`LevelEntry::bytes`] long, and checks its
    /// checksum and running indices.
    ///
    /// # Errors
    /// A short read, a bad checksum, an index out of order, references that do not match the next level.
    pub fn decode_level(&self, level: u8, bytes: &[u8]) -> Result<Vec<Node>, FormatError> {
        let Some(entry) = self.levels.get(usize::from(level)) else {
            return Err(FormatError::file(format!("there is no level {level}")));
        };
        if bytes.len() as u64 != entry.bytes {
            return Err(FormatError::at(
                entry.offset,
                format!("level {level} is cut short"),
            ));
        }
        if crc32fast::hash(bytes) != entry.crc {
            return Err(FormatError::at(
                entry.offset,
                format!("checksum of level {level} does not match: the file is damaged"),
            ));
        }
        let nodes = decode_nodes(bytes, entry.nodes)
            .map_err(|e| FormatError::at(entry.offset, format!("level {level}: {}", e.message)))?;
        let counts = check_level(&nodes, level, self.header.depth)?;
        let next = self.levels.get(usize::from(level) + 1).map_or(0, |e| e.nodes / 8);
        if counts.tiles != next {
            return Err(FormatError::at(
                entry.offset,
                format!(
                    "level {level} refers to {} tiles, the next level has {next}",
                    counts.tiles
                ),
            ));
        }
        Ok(nodes)
    }
}

/// Reads a whole file.
///
/// # Errors
/// As [`decode_header`] and [`OctreeIndex::decode_level`].
pub fn decode(bytes: &[u8]) -> Result<Octree, FormatError> {
    let index = decode_header(bytes, bytes.len() as u64)?;
    let levels = index
        .levels
        .iter()
        .enumerate()
        .map(|(level, e)| {
            let range = e.offset as usize..(e.offset + e.bytes) as usize;
            index.decode_level(level as u8, bytes.get(range).unwrap_or_default())
        })
        .collect::<Result<_, _>>()?;
    Ok(Octree {
        header: index.header,
        levels,
    })
}
