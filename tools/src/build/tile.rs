//! A tile: the finest levels of a part of one tree, made at a time by one worker.
//!
//! Tiles are cut so that no chunk of these levels lies in two of them. A tile is voxelised with a margin of one voxel of the
//! level above its own levels; it codes its chunks, and leaves its samples of that level, its own only and exactly, to the trees
//! that are made of them. What it leaves is one file in the scratch folder, so that a build goes on from there.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use glam::UVec3;
use rayon::prelude::*;

use brickfell_formats::chunk::ChunkBox;
use brickfell_formats::morton;
use brickfell_formats::steps::Steps;

use super::error::BuildError;
use super::filter::{Level, Target};
use super::finest::{Met, Sources, voxelise};
use super::ground::{GroundGrid, Hints};
use super::inside::Inside;
use super::lattice::{CellBox, Lattice, Region, TreePlace};
use super::nodes::{LevelNodes, NodeColumn, State, level_nodes, node_cube};
use super::spill::{Reader, Writer};
use super::texels::TexelLevel;
use super::tree::Terrain;

/// Most levels that tiles make.
const LEVELS: u8 = 3;
/// Finest cells of a tile per axis, unless the tree is smaller. Chunks of the coarsest level of a tile are half as large.
const SIDE: i64 = 256;
const MAGIC: [u8; 8] = *b"BRKFTIL\x02";

/// A tile of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    pub(crate) tree: TreePlace,
    pub(crate) region: Region,
}

/// A chunk as it will be stored.
#[derive(Clone, Debug)]
pub(crate) struct CodedChunk {
    /// Its position, in chunks of its level.
    pub(crate) at: UVec3,
    pub(crate) mask: u64,
    pub(crate) payload: Vec<u8>,
}

/// A chunk of a tile that lies in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StoredChunk {
    pub(crate) morton: u64,
    pub(crate) mask: u64,
    /// Of the payload in the file.
    pub(crate) offset: u64,
    pub(crate) bytes: u32,
}

/// One level of a tile.
#[derive(Clone, Debug)]
pub(crate) struct TileLevel {
    pub(crate) nodes: LevelNodes,
    pub(crate) chunks: Vec<StoredChunk>,
}

/// What the file of a tile says, but for payloads, hints and samples.
#[derive(Debug)]
pub(crate) struct TileHead {
    pub(crate) met: Met,
    /// Whether anything is in its blocks.
    pub(crate) occupied: bool,
    /// Finest first.
    pub(crate) levels: Vec<TileLevel>,
}

/// Mip of the samples that tiles leave.
pub(crate) fn tile_top(lattice: &Lattice) -> u8 {
    lattice.depth.min(LEVELS)
}

/// Finest cells of a tile per axis.
pub(crate) fn tile_side(lattice: &Lattice) -> i64 {
    lattice.side().min(SIDE)
}

/// The tiles of a tree.
pub(crate) fn tiles(lattice: &Lattice, tree: TreePlace) -> Vec<Tile> {
    let own = lattice.own(tree);
    let side = tile_side(lattice);
    let steps = |k: usize| (own.lo[k]..own.hi[k]).step_by(side as usize);
    steps(1)
        .flat_map(|y| steps(0).map(move |x| (x, y)))
        .map(|(x, y)| Tile {
            tree,
            region: Region {
                own: CellBox {
                    lo: [x, y, own.lo[2]],
                    hi: [x + side, y + side, own.hi[2]],
                },
                top: tile_top(lattice),
            },
        })
        .collect()
}

impl Tile {
    /// Its name in the scratch folder.
    pub(crate) fn name(&self) -> String {
        let [x, y, z] = self.region.own.lo;
        format!("tile_{x}_{y}_{z}")
    }

    /// Makes it and writes its file. Gives the surface voxels in it.
    ///
    /// # Errors
    /// If the file cannot be written, or an input no longer be read.
    pub(crate) fn build(&self, terrain: &Terrain, path: &Path) -> Result<u64, BuildError> {
        let lattice = &terrain.lattice;
        let support = self.region.support(0);
        let grids: Vec<GroundGrid> = terrain
            .layers
            .iter()
            .filter_map(|layer| GroundGrid::new(layer, lattice, &support).transpose())
            .collect::<Result<_, _>>()?;
        let mut area = support;
        if terrain.solid {
            // What is inside is seen from all faces above and below.
            (area.lo[2], area.hi[2]) = (i64::MIN, i64::MAX);
        }
        let faces = terrain.faces.near(self.region.own.lo, &area)?;
        let inside = terrain.solid.then(|| {
            let corners = faces.iter().map(|f| f.face.corners.map(|p| lattice.cells_of(p)));
            Inside::new(&support, corners)
        });
        let (mut level, met) = voxelise(&Sources {
            lattice: *lattice,
            region: self.region,
            grids: &grids,
            bottom: &|column| terrain.plan.bottom(column),
            materials: &terrain.faces.materials,
            faces: &faces,
            inside: inside.as_ref(),
            by: terrain.voxelise,
            covers: terrain.filter.covers(),
        })?;
        drop(faces);
        let occupied = !level.samples.is_empty_in(&self.region.own.blocks());
        let mut hints = Hints::finest(&grids, &support);
        drop(grids);
        let mut levels: Vec<(LevelNodes, Vec<CodedChunk>)> = Vec::new();
        for mip in 0..self.region.top {
            let texels = TexelLevel::new(
                &level.samples,
                level.skins(terrain.filter, true),
                Steps::within(terrain.error),
                &hints,
                self.region.stored(lattice.layout, mip),
                &self.region.support(mip),
            );
            let at = lattice.depth - mip;
            let finer = levels.last().map(|l| &l.0);
            let nodes = level_nodes(lattice, self.tree, &self.region, at, &texels, &hints, finer);
            let chunks = code_chunks(terrain, self.tree, at, &texels, &nodes.bricks());
            drop(texels);
            levels.push((nodes, chunks));
            // Of the samples that are left behind, only the tile's own are asked for.
            let cells = match mip + 1 < self.region.top {
                true => self.region.support(mip + 1),
                false => self.region.cells(mip + 1),
            };
            hints = hints.coarser(lattice.layout, &cells);
            level = level.coarser(
                terrain.filter,
                &Target {
                    layout: lattice.layout,
                    mip: mip + 1,
                    cells,
                },
            );
        }
        self.write(path, &met, occupied, &levels, &hints, &level)?;
        Ok(met.count)
    }

    fn write(
        &self,
        path: &Path,
        met: &Met,
        occupied: bool,
        levels: &[(LevelNodes, Vec<CodedChunk>)],
        hints: &Hints,
        level: &Level,
    ) -> Result<(), BuildError> {
        let mut head = Writer::default();
        met.write(&mut head);
        head.put(&u8::from(occupied));
        let mut offset = 0u64;
        for (nodes, chunks) in levels {
            write_nodes(nodes, &mut head);
            head.put(&(chunks.len() as u64));
            for chunk in chunks {
                head.put(&[
                    morton::encode(chunk.at),
                    chunk.mask,
                    offset,
                    chunk.payload.len() as u64,
                ]);
                offset += chunk.payload.len() as u64;
            }
        }
        let cells = self.region.cells(self.region.top);
        hints.write(&cells, &mut head);
        level.write(&cells, &mut head);
        let head = head.0;
        let mut partial = path.as_os_str().to_os_string();
        partial.push(super::manifest::PARTIAL);
        let partial = PathBuf::from(partial);
        let write = || {
            let mut file = std::io::BufWriter::with_capacity(1 << 16, File::create(&partial)?);
            file.write_all(&MAGIC)?;
            file.write_all(&(head.len() as u64).to_le_bytes())?;
            file.write_all(&offset.to_le_bytes())?;
            file.write_all(&u64::from(crc32fast::hash(&head)).to_le_bytes())?;
            file.write_all(&head)?;
            for chunk in levels.iter().flat_map(|l| &l.1) {
                file.write_all(&chunk.payload)?;
            }
            file.flush()
        };
        write().map_err(BuildError::io(&partial))?;
        fs::rename(&partial, path).map_err(BuildError::io(path))
    }
}

/// Bytes before the head: magic, bytes of the head, bytes of the payloads, checksum of the head.
const PREFIX: usize = 32;

/// A tile's file, but for the payloads.
pub(crate) struct TileFile {
    head: Vec<u8>,
}

impl TileFile {
    /// Whether there is a whole one.
    pub(crate) fn is_whole(path: &Path) -> bool {
        Self::open(path).is_some()
    }

    /// Reads it; `None` if it is missing or damaged.
    pub(crate) fn open(path: &Path) -> Option<Self> {
        let mut file = File::open(path).ok()?;
        let mut prefix = [0; PREFIX];
        std::io::Read::read_exact(&mut file, &mut prefix).ok()?;
        let mut reader = Reader(&prefix);
        let (magic, [bytes, payload, crc]) = (reader.get::<[u8; 8]>()?, reader.get::<[u64; 3]>()?);
        let length = file.metadata().ok()?.len();
        if magic != MAGIC || length != (PREFIX as u64).checked_add(bytes)?.checked_add(payload)? {
            return None;
        }
        let mut head = vec![0; usize::try_from(bytes).ok()?];
        std::io::Read::read_exact(&mut file, &mut head).ok()?;
        (u64::from(crc32fast::hash(&head)) == crc).then_some(Self { head })
    }

    /// What it says, and the rest of it: hints, then samples.
    pub(crate) fn read(&self, levels: u8) -> Option<(TileHead, Reader<'_>)> {
        let mut reader = Reader(&self.head);
        let first_payload = (PREFIX + self.head.len()) as u64;
        let met = Met::read(&mut reader)?;
        let occupied = reader.get::<u8>()? == 1;
        let mut read = Vec::new();
        for _ in 0..levels {
            let nodes = read_nodes(&mut reader)?;
            let mut chunks = Vec::new();
            for _ in 0..reader.get::<u64>()? {
                let [morton, mask, offset, bytes] = reader.get::<[u64; 4]>()?;
                chunks.push(StoredChunk {
                    morton,
                    mask,
                    offset: first_payload + offset,
                    bytes: bytes as u32,
                });
            }
            read.push(TileLevel { nodes, chunks });
        }
        let head = TileHead {
            met,
            occupied,
            levels: read,
        };
        Some((head, reader))
    }
}

/// Chunks of a level, given its bricks in Morton order.
pub(crate) fn code_chunks(
    terrain: &Terrain,
    place: TreePlace,
    level: u8,
    texels: &TexelLevel,
    bricks: &[UVec3],
) -> Vec<CodedChunk> {
    let lattice = &terrain.lattice;
    let chunk_of = |p: &UVec3| *p >> u32::from(terrain.chunk_log2);
    let groups: Vec<&[UVec3]> = bricks.chunk_by(|a, b| chunk_of(a) == chunk_of(b)).collect();
    let code = |bricks: &[UVec3]| {
        let within = (1u32 << terrain.chunk_log2) - 1;
        let mask = bricks
            .iter()
            .fold(0, |mask, brick| mask | 1 << morton::encode(*brick & within));
        let at = chunk_of(&bricks[0]);
        let mut chunk = ChunkBox::new(mask, lattice.layout, terrain.layers(), terrain.error);
        let first = (at << u32::from(terrain.chunk_log2)) + chunk.corner();
        texels.fill(node_cube(lattice, place, level, first).0, &mut chunk);
        CodedChunk {
            at,
            mask,
            payload: chunk.encode(terrain.encoding),
        }
    };
    groups.into_par_iter().map(code).collect()
}

fn write_nodes(nodes: &LevelNodes, out: &mut Writer) {
    out.put(&[nodes.lo, nodes.size]);
    for column in &nodes.columns {
        out.put(&[column.solid.start, column.solid.end]);
        out.put(&column.color);
        out.put(&(column.known.len() as u32));
        for (z, state) in &column.known {
            out.put(z);
            let code = match state {
                State::Brick => [0; 5],
                State::Constant { color, deep } => {
                    let [r, g, b, a] = *color;
                    [1 + u8::from(*deep), r, g, b, a]
                }
            };
            out.put(&code);
        }
    }
}

fn read_nodes(reader: &mut Reader) -> Option<LevelNodes> {
    let [lo, size] = reader.get::<[[u32; 2]; 2]>()?;
    let mut columns = Vec::new();
    for _ in 0..u64::from(size[0]) * u64::from(size[1]) {
        let [start, end] = reader.get::<[u32; 2]>()?;
        let color = reader.get()?;
        let mut known = Vec::new();
        for _ in 0..reader.get::<u32>()? {
            let z = reader.get()?;
            let [code, color @ ..] = reader.get::<[u8; 5]>()?;
            let state = match code {
                0 => State::Brick,
                _ => State::Constant {
                    color,
                    deep: code == 2,
                },
            };
            known.push((z, state));
        }
        columns.push(NodeColumn {
            known,
            solid: start..end,
            color,
        });
    }
    Some(LevelNodes { lo, size, columns })
}
