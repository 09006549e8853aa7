//! Puts a tree together from its tiles and writes its folder.
//!
//! The tiles have made the finest levels; from the samples that they and the tiles around the tree leave, the rest is made up to
//! the root. The folder is written under a name of its own and renamed when it is complete.

use std::fs::{self, File};
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Encoding, Layers};
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::steps::Steps;
use brickfell_formats::value::BUILD_GAIN;
use brickfell_formats::{morton, octree_binary};

use super::bins::Bins;
use super::error::BuildError;
use super::filter::{Filter, Level, Target};
use super::finest::Met;
use super::ground::Hints;
use super::groups::GroupPlace;
use super::lattice::{CellBox, Lattice, TreePlace};
use super::manifest::{PARTIAL, TREES, remove_tree};
use super::nodes::{LevelNodes, State, level_nodes, octree};
use super::overlap::Voxelise;
use super::plan::Plan;
use super::spill::Reader;
use super::texels::TexelLevel;
use super::tile::{StoredChunk, Tile, TileFile, TileLevel, code_chunks, tile_top};
use crate::input::Layer;

/// Name of the octree file in a tree's folder.
pub(crate) const TREE_FILE: &str = "tree.oct";

/// Everything that trees are built from.
pub(crate) struct Terrain<'a> {
    pub(crate) lattice: Lattice,
    pub(crate) layers: &'a [Layer],
    pub(crate) faces: &'a Bins,
    pub(crate) plan: &'a Plan,
    pub(crate) encoding: Encoding,
    pub(crate) chunk_log2: u8,
    pub(crate) filter: Filter,
    pub(crate) voxelise: Voxelise,
    /// Whether the inside of closed meshes is solid.
    pub(crate) solid: bool,
    /// By how much looks may be off.
    pub(crate) error: u8,
}

impl Terrain<'_> {
    /// What files store of each sample.
    pub(crate) fn layers(&self) -> Layers {
        match self.filter {
            Filter::Axes => Layers::Axes,
            _ => Layers::Plain,
        }
    }
}

/// A payload of a level under way to its file.
enum Payload {
    Made(Vec<u8>),
    /// In the file of the tile with this number.
    Stored(usize, StoredChunk),
}

/// Puts a tree together in the output folder `out` and leaves the samples of its root for the groups above; `None` if nothing is in it,
/// and then it has no folder. `own` are the files of its tiles, `around` those of all tiles that may meet its margin, its own
/// included.
///
/// # Errors
/// If a file cannot be read or written.
pub(crate) fn finish_tree(
    terrain: &Terrain,
    place: TreePlace,
    own: &[PathBuf],
    around: &[(Tile, PathBuf)],
    out: &Path,
) -> Result<Option<TreeHeader>, BuildError> {
    let lattice = &terrain.lattice;
    let top = tile_top(lattice);
    let (mut met, mut occupied) = (Met::default(), false);
    let mut tiles: Vec<Vec<TileLevel>> = Vec::with_capacity(own.len());
    for path in own {
        let file = TileFile::open(path).ok_or_else(|| damaged(path))?;
        let (head, _) = file.read(top).ok_or_else(|| damaged(path))?;
        met = met.with(&head.met);
        occupied |= head.occupied;
        tiles.push(head.levels);
    }
    if !occupied {
        return Ok(None);
    }
    let folder = &out.join(TREES).join(lattice.tree_name(place));
    let mut writer = FolderWriter::new(folder)?;
    let mut levels: Vec<LevelNodes> = Vec::new();
    for mip in 0..top {
        let at = lattice.depth - mip;
        let (mut nodes, mut chunks) = (Vec::new(), Vec::new());
        for (number, tile) in tiles.iter_mut().enumerate() {
            let level = &mut tile[usize::from(mip)];
            chunks.extend(
                level
                    .chunks
                    .iter()
                    .map(|c| (c.morton, c.mask, Payload::Stored(number, *c))),
            );
            nodes.push(level.nodes.clone());
        }
        chunks.sort_unstable_by_key(|c| c.0);
        write_bricks(terrain, at, &chunks, own, &mut writer)?;
        levels.push(LevelNodes::joined(1 << at, nodes));
    }
    drop(tiles);
    let region = lattice.tree(place);
    let (mut level, mut hints) = gather(terrain, &region.support(top), around)?;
    for mip in top..=lattice.depth {
        if mip > top {
            let cells = region.support(mip);
            hints = hints.coarser(lattice.layout, &cells);
            let target = Target {
                layout: lattice.layout,
                mip,
                cells,
            };
            level = level.coarser(terrain.filter, &target);
        }
        let at = lattice.depth - mip;
        let texels = TexelLevel::new(
            &level.samples,
            level.skins(terrain.filter, at > 0),
            Steps::within(terrain.error),
            &hints,
            region.stored(lattice.layout, mip),
            &region.support(mip),
        );
        add_level(terrain, place, &texels, &hints, &mut levels, &mut writer)?;
    }
    // Before the folder: what is finished has both.
    GroupPlace::tree(lattice, place).leave(&level, &hints, out)?;
    finish(terrain, place, &met, levels, writer, folder)
}

/// Codes the next coarser level of a tree and writes its bricks.
///
/// # Errors
/// If a file cannot be written.
pub(crate) fn add_level(
    terrain: &Terrain,
    place: TreePlace,
    texels: &TexelLevel,
    hints: &Hints,
    levels: &mut Vec<LevelNodes>,
    writer: &mut FolderWriter,
) -> Result<(), BuildError> {
    let lattice = &terrain.lattice;
    let at = lattice.depth - levels.len() as u8;
    let nodes = level_nodes(
        lattice,
        place,
        &lattice.tree(place),
        at,
        texels,
        hints,
        levels.last(),
    );
    let chunks = code_chunks(terrain, place, at, texels, &nodes.bricks());
    let chunks: Vec<_> = chunks
        .into_iter()
        .map(|c| (morton::encode(c.at), c.mask, Payload::Made(c.payload)))
        .collect();
    write_bricks(terrain, at, &chunks, &[], writer)?;
    levels.push(nodes);
    Ok(())
}

/// Writes the octree over levels, the finest first, and ends a tree's folder; `None`, and no folder, if nothing is in it.
///
/// # Errors
/// If a file cannot be written.
pub(crate) fn finish(
    terrain: &Terrain,
    place: TreePlace,
    met: &Met,
    mut levels: Vec<LevelNodes>,
    mut writer: FolderWriter,
    folder: &Path,
) -> Result<Option<TreeHeader>, BuildError> {
    levels.reverse();
    if let Some(State::Constant {
        color: [_, _, _, 0], ..
    }) = levels.first().map(|l| l.state(UVec3::ZERO))
    {
        writer.discard()?;
        return Ok(None);
    }
    let path = folder.join(TREE_FILE);
    let header = header(&terrain.lattice, place, met);
    let tree = octree(header, &levels).map_err(BuildError::format(&path))?;
    let bytes = octree_binary::encode(&tree).map_err(BuildError::format(&path))?;
    writer.file(TREE_FILE, |file| file.write_all(&bytes))?;
    writer.finish()?;
    Ok(Some(tree.header))
}

pub(crate) fn damaged(path: &Path) -> BuildError {
    BuildError::io(path)(std::io::Error::new(
        std::io::ErrorKind::InvalidData,
        "is damaged; the same build again makes it anew",
    ))
}

/// Samples and hints over a box of cells of the coarsest mip that tiles leave.
fn gather(
    terrain: &Terrain,
    extent: &CellBox,
    around: &[(Tile, PathBuf)],
) -> Result<(Level, Hints), BuildError> {
    let top = tile_top(&terrain.lattice);
    let mut files = Vec::new();
    for (tile, path) in around {
        files.push((
            tile.region.cells(top),
            path,
            TileFile::open(path).ok_or_else(|| damaged(path))?,
        ));
    }
    let mut readers: Vec<(CellBox, Reader)> = Vec::new();
    for (cells, path, file) in &files {
        let (_, rest) = file.read(top).ok_or_else(|| damaged(path))?;
        readers.push((*cells, rest));
    }
    read_samples(extent, readers, terrain.filter)
        .ok_or_else(|| damaged(files.first().map_or(Path::new(""), |f| f.1)))
}

/// Samples and hints over a box of cells, of what was written of boxes that do not meet; `None` if that is damaged.
pub(crate) fn read_samples(
    extent: &CellBox,
    mut parts: Vec<(CellBox, Reader)>,
    filter: Filter,
) -> Option<(Level, Hints)> {
    let hints = Hints::read(extent, &mut parts)?;
    let level = Level::read(extent, &mut parts, filter)?;
    Some((level, hints))
}

fn header(lattice: &Lattice, place: TreePlace, met: &Met) -> TreeHeader {
    let local = |p: [i64; 3]| UVec3::from_array(std::array::from_fn(|k| (p[k] - place.origin[k]) as u32));
    TreeHeader {
        origin: lattice.tree_corner(place),
        voxel_size: lattice.voxel,
        depth: lattice.depth,
        layout: lattice.layout,
        gain: BUILD_GAIN,
        surface_voxels: met.count,
        surface_bounds: met
            .bounds
            .map_or([UVec3::ZERO; 2], |b| [local(b.lo), local(b.hi)]),
    }
}

/// Writes the brick file of a level, if it has bricks.
fn write_bricks(
    terrain: &Terrain,
    level: u8,
    chunks: &[(u64, u64, Payload)],
    tiles: &[PathBuf],
    writer: &mut FolderWriter,
) -> Result<(), BuildError> {
    if chunks.is_empty() {
        return Ok(());
    }
    let name = brick_file_name(TREE_FILE, level);
    let path = writer.path(&name);
    let mut index = BrickFileWriter::new(
        level,
        terrain.lattice.layout,
        terrain.chunk_log2,
        terrain.encoding,
    )
    .with_layers(terrain.layers());
    writer.try_file(&name, |file| {
        let io = |e| BuildError::io(&path)(e);
        let mut file = BufWriter::with_capacity(1 << 18, file);
        file.write_all(&[0; HEADER_BYTES]).map_err(io)?;
        let mut open: Vec<Option<File>> = tiles.iter().map(|_| None).collect();
        let mut stored = Vec::new();
        for (at, mask, payload) in chunks {
            let payload = match payload {
                Payload::Made(payload) => payload,
                Payload::Stored(tile, chunk) => {
                    let from = |e| BuildError::io(&tiles[*tile])(e);
                    let source = match &mut open[*tile] {
                        Some(file) => file,
                        slot => slot.insert(File::open(&tiles[*tile]).map_err(from)?),
                    };
                    stored.resize(chunk.bytes as usize, 0);
                    source.seek(SeekFrom::Start(chunk.offset)).map_err(from)?;
                    source.read_exact(&mut stored).map_err(from)?;
                    &stored
                }
            };
            index
                .push(morton::decode(*at), *mask, payload)
                .map_err(BuildError::format(&path))?;
            file.write_all(payload).map_err(io)?;
        }
        let (directory, header) = index.finish();
        file.write_all(&directory).map_err(io)?;
        file.seek(SeekFrom::Start(0))
            .and_then(|_| file.write_all(&header))
            .and_then(|_| file.flush())
            .map_err(io)
    })
}

/// Writes a folder under another name and renames it when it is complete.
pub(crate) struct FolderWriter {
    partial: PathBuf,
    folder: PathBuf,
    /// What has been written but may not be on the disk yet.
    files: Vec<(PathBuf, File)>,
}

impl FolderWriter {
    pub(crate) fn new(folder: &Path) -> Result<Self, BuildError> {
        let mut name = folder.as_os_str().to_os_string();
        name.push(PARTIAL);
        let partial = PathBuf::from(name);
        if partial.exists() {
            remove_tree(&partial)?;
        }
        fs::create_dir_all(&partial).map_err(BuildError::io(&partial))?;
        Ok(Self {
            partial,
            folder: folder.to_path_buf(),
            files: Vec::new(),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.partial.join(name)
    }

    fn file(
        &mut self,
        name: &str,
        write: impl FnOnce(&mut File) -> std::io::Result<()>,
    ) -> Result<(), BuildError> {
        let path = self.path(name);
        self.try_file(name, |file| write(file).map_err(BuildError::io(&path)))
    }

    fn try_file(
        &mut self,
        name: &str,
        write: impl FnOnce(&mut File) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let path = self.path(name);
        let mut file = File::create(&path).map_err(BuildError::io(&path))?;
        write(&mut file)?;
        self.files.push((path, file));
        Ok(())
    }

    /// Waits until all files are on the disk. All at once: one after the other, each would wait for a commit of its own.
    fn sync(&mut self) -> Result<(), BuildError> {
        let files = std::mem::take(&mut self.files);
        std::thread::scope(|scope| {
            let sync = |(path, file): &(PathBuf, File)| file.sync_data().map_err(BuildError::io(path));
            let waits: Vec<_> = (files.iter())
                .map(|file| {
                    let thread = std::thread::Builder::new().spawn_scoped(scope, move || sync(file));
                    thread.map_err(|_| sync(file))
                })
                .collect();
            waits.into_iter().try_for_each(|wait| match wait {
                Ok(thread) => match thread.join() {
                    Ok(done) => done,
                    Err(panic) => std::panic::resume_unwind(panic),
                },
                Err(done) => done,
            })
        })
    }

    fn discard(self) -> Result<(), BuildError> {
        drop(self.files);
        remove_tree(&self.partial)
    }

    /// What is there already is the same.
    fn finish(mut self) -> Result<(), BuildError> {
        if self.folder.is_dir() {
            return self.discard();
        }
        self.sync()?;
        fs::rename(&self.partial, &self.folder).map_err(BuildError::io(&self.folder))
    }
}
