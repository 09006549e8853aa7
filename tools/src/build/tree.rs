//! Builds one tree and writes its folder: brick files level by level from the finest up, then the octree file.
//!
//! The folder is written under a name of its own and renamed when it is complete. Called from one thread at a time,
//! which spreads the work over the pool's threads: memory then holds one tree.

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;
use rayon::prelude::*;

use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::value::BUILD_GAIN;
use brickfell_formats::{morton, octree_binary};

use super::error::BuildError;
use super::filter::{Filter, Target};
use super::finest::{Met, Sources, triangle_cells, voxelise};
use super::ground::{GroundGrid, Hints};
use super::groups::leave_root;
use super::lattice::{Lattice, TreePlace};
use super::manifest::{PARTIAL, remove_tree};
use super::nodes::{LevelNodes, State, level_nodes, node_cube, octree};
use super::plan::Plan;
use super::surface::Surfaces;
use super::texels::TexelLevel;
use crate::input::Layer;

/// Name of the octree file in a tree's folder.
pub(crate) const TREE_FILE: &str = "tree.oct";
/// Chunks that are coded together before they are written.
const BATCH: usize = 64;

/// Everything that trees are built from.
pub(crate) struct Terrain<'a> {
    pub(crate) lattice: Lattice,
    pub(crate) layers: &'a [Layer],
    pub(crate) surfaces: &'a Surfaces<'a>,
    pub(crate) plan: &'a Plan,
    pub(crate) encoding: Encoding,
    pub(crate) chunk_log2: u8,
    pub(crate) filter: Filter,
}

/// Builds a tree into `folder` and leaves the samples of its root for the groups above; `None` if nothing is in it, and then
/// there is no folder.
///
/// # Errors
/// If a file cannot be written.
pub(crate) fn build_tree(
    terrain: &Terrain,
    place: TreePlace,
    folder: &Path,
    root_samples: &Path,
) -> Result<Option<TreeHeader>, BuildError> {
    let lattice = &terrain.lattice;
    let support = lattice.support(place, 0);
    let grids: Vec<GroundGrid> = terrain
        .layers
        .iter()
        .filter_map(|layer| GroundGrid::new(layer, lattice, &support))
        .collect();
    let column = terrain
        .plan
        .columns
        .get(&lattice.column_of(place.origin[0], place.origin[1]));
    let near = |number: &u32| {
        let corners = terrain.surfaces.corners(*number as usize);
        corners.is_some_and(|c| !triangle_cells(&c).intersection(&support).is_empty())
    };
    let triangles: Vec<u32> =
        column.map_or(Vec::new(), |c| c.triangles.iter().copied().filter(near).collect());
    let (mut samples, met) = voxelise(&Sources {
        lattice: *lattice,
        place,
        grids: &grids,
        bottom: &|column| terrain.plan.bottom(column),
        surfaces: terrain.surfaces,
        triangles: &triangles,
        covers: terrain.filter.covers(),
    });
    if samples.samples.is_empty_in(&lattice.own(place).blocks()) {
        return Ok(None);
    }
    let mut hints = Hints::finest(&grids, &support);
    drop(grids);
    let mut writer = FolderWriter::new(folder)?;
    let mut levels: Vec<LevelNodes> = Vec::new();
    for mip in 0..=lattice.depth {
        if mip > 0 {
            let cells = lattice.support(place, mip);
            hints = hints.coarser(lattice.layout, &cells);
            samples = samples.coarser(
                terrain.filter,
                &Target {
                    layout: lattice.layout,
                    mip,
                    cells,
                },
            );
        }
        let level = lattice.depth - mip;
        let texels = TexelLevel::new(
            &samples.samples,
            samples.skins(terrain.filter, level > 0),
            &hints,
            lattice.stored(place, mip),
            &lattice.support(place, mip),
        );
        let nodes = level_nodes(lattice, place, level, &texels, &hints, levels.last());
        write_bricks(terrain, place, level, &texels, &nodes.bricks(), &mut writer)?;
        levels.push(nodes);
    }
    // Before the folder: what is finished has both.
    leave_root(lattice, place, &samples, &hints, root_samples)?;
    finish(terrain, place, &met, levels, writer, folder)
}

/// Writes the octree over levels, the finest first, and ends a tree's folder; `None`, and no folder, if nothing is in it.
pub(crate) fn finish(
    terrain: &Terrain,
    place: TreePlace,
    met: &Met,
    mut levels: Vec<LevelNodes>,
    writer: FolderWriter,
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
pub(crate) fn write_bricks(
    terrain: &Terrain,
    place: TreePlace,
    level: u8,
    texels: &TexelLevel,
    bricks: &[UVec3],
    writer: &mut FolderWriter,
) -> Result<(), BuildError> {
    if bricks.is_empty() {
        return Ok(());
    }
    let lattice = &terrain.lattice;
    let chunk_of = |p: &UVec3| *p >> u32::from(terrain.chunk_log2);
    let chunks: Vec<&[UVec3]> = bricks.chunk_by(|a, b| chunk_of(a) == chunk_of(b)).collect();
    let name = brick_file_name(TREE_FILE, level);
    let path = writer.path(&name);
    let encode = |bricks: &&[UVec3]| {
        let within = (1u32 << terrain.chunk_log2) - 1;
        let samples = bricks.len() * lattice.layout.samples();
        let mut chunk = Chunk {
            mask: 0,
            layout: lattice.layout,
            color: Vec::with_capacity(samples),
            normal: Vec::with_capacity(samples),
            opacity: Vec::new(),
        };
        let (mut cube, mut opacities) = (Vec::new(), Vec::new());
        for brick in *bricks {
            chunk.mask |= 1 << morton::encode(*brick & within);
            let (base, side) = node_cube(lattice, place, level, *brick);
            texels.gather(base, side, &mut cube);
            chunk.color.extend(cube.iter().map(|t| t.color));
            chunk
                .normal
                .extend(cube.iter().map(|t| [t.normal[0], t.normal[1], t.normal[2], 0]));
            if texels.gather_opacities(base, side, &mut opacities) {
                chunk
                    .opacity
                    .extend(opacities.iter().map(|[x, y, z]| [*x, *y, *z, 0]));
            }
        }
        let payload = chunk
            .encode(terrain.encoding)
            .map_err(BuildError::format(&path))?;
        Ok((chunk.mask, payload))
    };
    let mut index = BrickFileWriter::new(level, lattice.layout, terrain.chunk_log2, terrain.encoding)
        .with_layers(texels.layers());
    writer.try_file(&name, |file| {
        let io = |e| BuildError::io(&path)(e);
        file.write_all(&[0; HEADER_BYTES]).map_err(io)?;
        for batch in chunks.chunks(BATCH) {
            let coded: Vec<(u64, Vec<u8>)> =
                batch.par_iter().map(encode).collect::<Result<_, BuildError>>()?;
            for (bricks, (mask, payload)) in batch.iter().zip(coded) {
                index
                    .push(chunk_of(&bricks[0]), mask, &payload)
                    .map_err(BuildError::format(&path))?;
                file.write_all(&payload).map_err(io)?;
            }
        }
        let (directory, header) = index.finish();
        file.write_all(&directory).map_err(io)?;
        file.seek(SeekFrom::Start(0))
            .and_then(|_| file.write_all(&header))
            .map_err(io)
    })
}

/// Writes a folder under another name and renames it when it is complete.
pub(crate) struct FolderWriter {
    partial: PathBuf,
    folder: PathBuf,
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
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.partial.join(name)
    }

    fn file(
        &self,
        name: &str,
        write: impl FnOnce(&mut File) -> std::io::Result<()>,
    ) -> Result<(), BuildError> {
        let path = self.path(name);
        self.try_file(name, |file| write(file).map_err(BuildError::io(&path)))
    }

    fn try_file(
        &self,
        name: &str,
        write: impl FnOnce(&mut File) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let path = self.path(name);
        let mut file = File::create(&path).map_err(BuildError::io(&path))?;
        write(&mut file)?;
        file.sync_data().map_err(BuildError::io(&path))
    }

    fn discard(self) -> Result<(), BuildError> {
        remove_tree(&self.partial)
    }

    fn finish(self) -> Result<(), BuildError> {
        fs::rename(&self.partial, &self.folder).map_err(BuildError::io(&self.folder))
    }
}
