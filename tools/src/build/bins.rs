//! The triangles of all meshes, each beside the tiles that it may meet: a stream of faces is sorted into one bin per column of
//! tiles, in memory as long as they fit, else in files of the scratch folder.
//!
//! A face is in every bin whose tiles, margin included, it may meet, whole and with all that its look needs ([`FaceWriter`]). Faces of a bin are in
//! the order of the input whatever the number of threads, since what a cell gets of several faces depends on it. Filled from one
//! thread; read from many.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::error::BuildError;
use super::faces::{Binned, FaceReader, FaceWriter};
use super::finest::triangle_cells;
use super::lattice::{CellBox, Lattice};
use super::manifest::{SCRATCH, is_free};
use super::plan::{MAX_TREES, check, heights_inside};
use super::tile::{tile_side, tile_top};
#[cfg(test)]
use crate::input::Mesh;
use crate::input::{Face, Material, Placing};

/// Bytes of a spilled bin that are read at a time: far more than a face has.
const PIECE: usize = 1 << 20;

/// Faces of a column of tiles.
#[derive(Debug, Default)]
struct Bin {
    held: Vec<u8>,
    /// Bytes in its file, which come before those that are held.
    spilled: u64,
}

/// Least and greatest height, cells.
type Range = (f64, f64);

/// All bins by column of tiles.
#[derive(Debug)]
pub(crate) struct Bins {
    lattice: Lattice,
    out: PathBuf,
    /// Bytes that may be held.
    limit: usize,
    held: usize,
    bins: BTreeMap<(i64, i64), Bin>,
    pub(crate) materials: Vec<(Material, Placing)>,
    /// Columns of trees that faces meet, and the heights that they have there.
    pub(crate) columns: BTreeMap<(i64, i64), Range>,
    faces: u64,
}

/// What a part of the faces puts into bins and columns.
#[derive(Default)]
struct Sorted {
    bins: BTreeMap<(i64, i64), FaceWriter>,
    columns: BTreeMap<(i64, i64), Range>,
}

impl Bins {
    /// Without faces. `out` is the folder of the database, `limit` the bytes that may be held in memory.
    pub(crate) fn new(lattice: Lattice, out: &Path, limit: usize) -> Self {
        Self {
            lattice,
            out: out.to_path_buf(),
            limit,
            held: 0,
            bins: BTreeMap::new(),
            materials: Vec::new(),
            columns: BTreeMap::new(),
            faces: 0,
        }
    }

    /// Number of faces.
    pub(crate) fn len(&self) -> u64 {
        self.faces
    }

    /// Adds a mesh that is in memory.
    ///
    /// # Errors
    /// Those of [`Self::add`].
    #[cfg(test)]
    pub(crate) fn add_mesh(&mut self, mesh: &Mesh) -> Result<(), BuildError> {
        let first = self.materials.len() as u32;
        let faces: Vec<Face> = mesh
            .triangles
            .iter()
            .map(|t| Face {
                corners: mesh.corners(t),
                at: mesh.at_corners(t),
                material: t.material.into(),
            })
            .collect();
        self.add(&faces, first)?;
        self.materials
            .extend(mesh.materials.iter().cloned().map(|m| (m, Placing::NONE)));
        Ok(())
    }

    /// Adds faces. Their materials are numbered from `first_material` on.
    ///
    /// # Errors
    /// Faces too far from the origin, too many trees, a file that cannot be written.
    pub(crate) fn add(&mut self, faces: &[Face], first_material: u32) -> Result<(), BuildError> {
        const PART: usize = 4096;
        let (lattice, first) = (self.lattice, self.faces);
        let sorted: Vec<Sorted> = faces
            .par_chunks(PART)
            .enumerate()
            .map(|(part, faces)| {
                let mut sorted = Sorted::default();
                for (k, face) in faces.iter().enumerate() {
                    let number = first + (part * PART + k) as u64;
                    let mut face = *face;
                    face.material += first_material;
                    sorted.add(&lattice, &Binned { number, face })?;
                }
                Ok(sorted)
            })
            .collect::<Result<_, BuildError>>()?;
        self.faces += faces.len() as u64;
        for part in sorted {
            for (at, bytes) in part.bins {
                let bytes = bytes.into_bytes();
                self.held += bytes.len();
                self.bins.entry(at).or_default().held.extend(bytes);
            }
            for (at, range) in part.columns {
                cover(&mut self.columns, at, range);
            }
        }
        if self.columns.len() > MAX_TREES {
            return Err(too_many(&lattice));
        }
        if self.held > self.limit {
            self.spill()?;
        }
        Ok(())
    }

    fn path(&self, (x, y): (i64, i64)) -> PathBuf {
        self.out.join(SCRATCH).join(format!("bin_{x}_{y}"))
    }

    fn spill(&mut self) -> Result<(), BuildError> {
        if !is_free(&self.out)? {
            return Err(BuildError::Foreign(self.out.clone()));
        }
        let scratch = self.out.join(SCRATCH);
        fs::create_dir_all(&scratch).map_err(BuildError::io(&scratch))?;
        let paths: Vec<PathBuf> = self.bins.keys().map(|at| self.path(*at)).collect();
        for (bin, path) in self.bins.values_mut().zip(paths) {
            // The file of an earlier run begins anew.
            let file = File::options()
                .create(true)
                .write(true)
                .append(bin.spilled > 0)
                .truncate(bin.spilled == 0)
                .open(&path);
            file.and_then(|mut file| file.write_all(&bin.held))
                .map_err(BuildError::io(&path))?;
            bin.spilled += bin.held.len() as u64;
            bin.held = Vec::new();
        }
        self.held = 0;
        Ok(())
    }

    /// The faces that may meet a box of cells which lies, but for the margin of tiles, in one column of tiles, given by a cell.
    ///
    /// # Errors
    /// If its file cannot be read.
    pub(crate) fn near(&self, cell: [i64; 3], area: &CellBox) -> Result<Vec<Binned>, BuildError> {
        let side = tile_side(&self.lattice);
        let at = (cell[0].div_euclid(side), cell[1].div_euclid(side));
        let Some(bin) = self.bins.get(&at) else {
            return Ok(Vec::new());
        };
        let mut near = Vec::new();
        let mut reader = FaceReader::default();
        // Gives the number of bytes after the last whole face.
        let mut collect = |mut bytes: &[u8]| {
            while let Some(binned) = reader.get(&mut bytes) {
                let corners = binned.face.corners.map(|p| self.lattice.cells_of(p));
                if !triangle_cells(&corners).intersection(area).is_empty() {
                    near.push(binned);
                }
            }
            bytes.len()
        };
        if bin.spilled > 0 {
            let path = self.path(at);
            let mut file = File::open(&path).map_err(BuildError::io(&path))?;
            let mut piece = Vec::with_capacity(PIECE);
            while (&mut file)
                .take((PIECE - piece.len()) as u64)
                .read_to_end(&mut piece)
                .map_err(BuildError::io(&path))?
                > 0
            {
                let rest = collect(&piece);
                piece.drain(..piece.len() - rest);
            }
        }
        collect(&bin.held);
        Ok(near)
    }
}

impl Sorted {
    fn add(&mut self, lattice: &Lattice, binned: &Binned) -> Result<(), BuildError> {
        let corners = binned.face.corners.map(|p| lattice.cells_of(p));
        for corner in corners {
            check(lattice, corner)?;
        }
        let range = |margin: f64, side: i64| {
            let lo = corners[0].min(corners[1]).min(corners[2]).floor() - margin;
            let hi = corners[0].max(corners[1]).max(corners[2]).floor() + margin;
            let index = |v: f64| (v as i64).div_euclid(side);
            (index(lo.x)..=index(hi.x), index(lo.y)..=index(hi.y))
        };
        // A voxel more on all sides keeps what only touches the box.
        let margin = ((1 << tile_top(lattice)) + 1) as f64;
        for (margin, side, is_bin) in [(margin, tile_side(lattice), true), (1.0, lattice.side(), false)] {
            let (xs, ys) = range(margin, side);
            let single = xs.start() == xs.end() && ys.start() == ys.end();
            let columns = (xs.end() - xs.start() + 1).saturating_mul(ys.end() - ys.start() + 1);
            if columns > 64 * MAX_TREES as i64 {
                return Err(too_many(lattice));
            }
            for y in ys {
                for x in xs.clone() {
                    let heights = if single {
                        let z = corners.map(|p| p.z);
                        Some((z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2])))
                    } else {
                        let own = [x * side, y * side, (x + 1) * side, (y + 1) * side].map(|v| v as f64);
                        let area = [own[0] - margin, own[1] - margin, own[2] + margin, own[3] + margin];
                        heights_inside(&corners, area)
                    };
                    match heights {
                        None => {}
                        Some(_) if is_bin => self.bins.entry((x, y)).or_default().put(binned),
                        Some(range) => cover(&mut self.columns, (x, y), range),
                    }
                }
                if self.columns.len() > MAX_TREES {
                    return Err(too_many(lattice));
                }
            }
        }
        Ok(())
    }
}

fn cover(columns: &mut BTreeMap<(i64, i64), Range>, at: (i64, i64), (lo, hi): Range) {
    let range = columns.entry(at).or_insert((lo, hi));
    *range = (range.0.min(lo), range.1.max(hi));
}

fn too_many(lattice: &Lattice) -> BuildError {
    BuildError::TooManyTrees {
        limit: MAX_TREES,
        voxel: lattice.voxel,
        tree: lattice.side(),
    }
}
