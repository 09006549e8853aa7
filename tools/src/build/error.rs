//! What can go wrong in a build: one clear line each, the path first where there is one.

use std::io;
use std::path::{Path, PathBuf};

use brickfell_formats::FormatError;

use crate::input::InputError;

/// A build that cannot start or go on. Finished trees stay; the same arguments go on from there.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// An input cannot be used.
    #[error(transparent)]
    Input(#[from] InputError),
    /// There is nothing to build from.
    #[error("no input: name OBJ files or height maps")]
    NoInput,
    /// The voxel size is zero, negative or not a number.
    #[error("voxel size {0} m is not a positive length (1e-9 to 1e9 m)")]
    Voxel(f64),
    /// The tree size is not one that an octree of bricks has.
    #[error("tree size {0} is not 8 times a power of two between 16 and 8192 voxels")]
    TreeSize(u32),
    /// The bound on errors is too large.
    #[error("an error of {0} steps is too large (0 to {max})", max = brickfell_formats::steps::Steps::MOST)]
    Bound(u8),
    /// The chunk size is unknown.
    #[error("chunks of 2^{0} bricks per axis are unknown (0, 1 or 2)")]
    ChunkSize(u8),
    /// Inputs lie too far from the origin for the lattice.
    #[error("the inputs reach {metres:.0} m from the origin, too far for voxels of {voxel} m")]
    TooLarge {
        /// Distance on one axis.
        metres: f64,
        /// Voxel size in metres.
        voxel: f64,
    },
    /// More trees than a scene may have.
    #[error(
        "the terrain needs more than {limit} trees of {tree} voxels of {voxel} m: take larger voxels or trees"
    )]
    TooManyTrees {
        /// The limit.
        limit: usize,
        /// Voxel size in metres.
        voxel: f64,
        /// Tree side in voxels.
        tree: i64,
    },
    /// The output folder holds something that is not a database of this program.
    #[error("{}: is not empty and was not made by build; name another folder", .0.display())]
    Foreign(PathBuf),
    /// The output folder holds a database made from something else.
    #[error("{}: holds a database built from other arguments or inputs; --force replaces it", .0.display())]
    Exists(PathBuf),
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file of the database cannot be made or, on resuming, read.
    #[error("{}: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: FormatError,
    },
    /// No threads could be started.
    #[error("cannot start threads: {0}")]
    Threads(String),
}

impl BuildError {
    /// Wraps an error of the operating system on `path`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Io {
            path: path.to_path_buf(),
            source,
        }
    }

    /// Wraps an error of the formats on `path`.
    pub(crate) fn format(path: &Path) -> impl FnOnce(FormatError) -> Self + '_ {
        move |source| Self::Format {
            path: path.to_path_buf(),
            source,
        }
    }
}
