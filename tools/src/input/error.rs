//! What can be wrong with an input file. Every message is one line: the file, the place in it where there is one, the fault.

use std::io;
use std::path::{Path, PathBuf};

/// A fault of an input file. Nothing has been written when one of these is returned by a reader.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// The file cannot be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The kind of file, or the variant of it, is not one that is read.
    #[error("{}: {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported, and what is.
        what: String,
    },
    /// The file contradicts its own format: cut short, damaged, or something else under that name.
    #[error("{}: {what}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The fault, with the strip, tile or element where it is known.
        what: String,
    },
    /// The declared size is beyond the limits of the reader; nothing was allocated.
    #[error("{}: image of {width} x {height} pixels is beyond the limit of {limit}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Declared width in pixels.
        width: u64,
        /// Declared height in pixels.
        height: u64,
        /// The limit, in words.
        limit: String,
    },
    /// A fault in a line of a text file (OBJ, MTL, world file).
    #[error("{}: line {line}: {what}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The fault.
        what: String,
    },
    /// A vertex of a mesh has a coordinate that is NaN or infinite.
    #[error("{}: vertex {vertex} (line {line}): coordinate is not finite", path.display())]
    VertexNotFinite {
        /// The file.
        path: PathBuf,
        /// Vertex number as OBJ counts, from 1.
        vertex: usize,
        /// Line, from 1.
        line: usize,
    },
    /// A face names a vertex, texture coordinate or normal that does not exist.
    #[error("{}: line {line}: {kind} index {index} is outside 1..{count}", path.display())]
    IndexOutOfRange {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// "vertex", "texture coordinate" or "normal".
        kind: &'static str,
        /// The index as written.
        index: i64,
        /// How many there are.
        count: usize,
    },
    /// A mesh without a single triangle.
    #[error("{}: the mesh has no triangles", path.display())]
    EmptyMesh {
        /// The file.
        path: PathBuf,
    },
    /// A height map without a single valid sample.
    #[error("{}: the height map has no valid height (everything is nodata)", path.display())]
    NoHeights {
        /// The file.
        path: PathBuf,
    },
    /// The georeference (tags, side file or world file) is wrong or not supported.
    #[error("{}: georeference: {what}", path.display())]
    Georef {
        /// The file that holds the georeference.
        path: PathBuf,
        /// The fault.
        what: String,
    },
    /// A part of the file that can only be read as one is too large for the memory that rasters may use.
    #[error("{}: {bytes} bytes have to be read at once, and {budget} are allowed; a tiled TIFF or a PNG that is not interlaced needs less", path.display())]
    Memory {
        /// The file.
        path: PathBuf,
        /// What it takes.
        bytes: u64,
        /// What there is.
        budget: u64,
    },
    /// An image and the height map it belongs to do not fit together.
    #[error("{}: {what}", path.display())]
    Mismatch {
        /// The image.
        path: PathBuf,
        /// The fault.
        what: String,
    },
}

impl InputError {
    /// Wraps an error of the operating system on `path`.
    pub fn io(path: &Path, source: io::Error) -> Self {
        InputError::Io {
            path: path.to_path_buf(),
            source,
        }
    }

    /// A variant of a format that is not read.
    pub fn unsupported(path: &Path, what: impl Into<String>) -> Self {
        InputError::Unsupported {
            path: path.to_path_buf(),
            what: what.into(),
        }
    }

    /// A damaged file; line breaks in `what` (some decoders write them) become spaces.
    pub fn damaged(path: &Path, what: impl std::fmt::Display) -> Self {
        let what = what.to_string().replace(['\n', '\r'], " ");
        InputError::Damaged {
            path: path.to_path_buf(),
            what,
        }
    }

    /// A fault in line `line` (from 1) of a text file.
    pub fn line(path: &Path, line: usize, what: impl Into<String>) -> Self {
        InputError::Line {
            path: path.to_path_buf(),
            line,
            what: what.into(),
        }
    }

    /// A fault of the georeference held by `path`.
    pub fn georef(path: &Path, what: impl Into<String>) -> Self {
        InputError::Georef {
            path: path.to_path_buf(),
            what: what.into(),
        }
    }
}
