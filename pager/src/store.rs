//! Where pages come from: named objects of which ranges can be read.
//!
//! Names are as the scene file writes them: relative, with `/`. Loader threads call a store, several at once; a store may
//! block for as long as it likes, never the render thread.

mod folder;
mod memory;
mod procedural;

use std::io;

pub use folder::FolderStore;
pub use memory::{Fault, MemoryStore, ReadRecord};
pub use procedural::{ProceduralConfig, ProceduralError, ProceduralStore};

/// Name of the scene file of a terrain.
pub const SCENE_FILE: &str = "scene.xml";

/// Named objects of which ranges can be read.
pub trait Store: Send + Sync {
    /// Length of an object in bytes, as it is now.
    ///
    /// # Errors
    /// If the object is missing, may not be named, or cannot be read.
    fn len(&self, name: &str) -> io::Result<u64>;

    /// Exactly `len` bytes from `offset`.
    ///
    /// # Errors
    /// As [`Store::len`], and if the object ends before the range does.
    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>>;

    /// What to call the object in a message to the user, for instance its path.
    fn describe(&self, name: &str) -> String;
}

/// The error of a range that the object does not have.
fn ends_early(offset: u64, len: usize, object: u64) -> io::Error {
    io::Error::new(
        io::ErrorKind::UnexpectedEof,
        format!(
            "bytes {offset}..{} are wanted, the file ends at byte {object}",
            offset.saturating_add(len as u64)
        ),
    )
}
