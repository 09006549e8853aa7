//! The memory that rasters share (height maps, imagery, textures of meshes): a bounded cache of their blocks, and the file for
//! those that have to be laid out anew.
//!
//! Whole rasters are kept as long as they take no more than 3/8 of the budget together; a picture that has to be decoded as a
//! whole takes up to a half, and 1/8 is for laying it out. Blocks of the others share what is left, least recently used first
//! out. Bytes count from before a block is read until its last user lets go of it or it leaves the cache, whichever the cache
//! sees first. Any thread.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::InputError;
use super::scratch::ScratchFile;

/// Four bytes of a raster: a height (f32, little-endian) or a colour (red, green, blue, alpha).
pub(crate) type Cell = [u8; 4];

/// Raster and number of a block in it.
type Key = (u32, u64);

/// Memory for rasters, in bytes, and a folder for what does not fit.
#[derive(Debug)]
pub struct RasterCache {
    budget: u64,
    scratch: ScratchFile,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    rasters: u32,
    blocks: HashMap<Key, (u64, Arc<[Cell]>)>,
    /// Keys by their time of last use.
    order: BTreeMap<u64, Key>,
    time: u64,
    held: u64,
    used: u64,
    peak: u64,
}

/// Memory outside of blocks; given back when dropped.
#[derive(Debug)]
pub(crate) struct Held {
    cache: Arc<RasterCache>,
    bytes: u64,
    /// Whether a whole raster lies in it.
    raster: bool,
}

impl Drop for Held {
    fn drop(&mut self) {
        let mut state = self.cache.lock();
        state.used -= self.bytes;
        if self.raster {
            state.held -= self.bytes;
        }
    }
}

impl RasterCache {
    /// Rasters unless told, bytes.
    pub const DEFAULT_BUDGET: u64 = 512 << 20;

    /// A cache of at most `budget` bytes. A file without a name is made in `scratch` when a raster does not fit and
    /// its own file cannot be read in parts; it is gone when the process ends.
    pub fn new(budget: u64, scratch: impl Into<PathBuf>) -> Arc<Self> {
        Arc::new(Self {
            budget,
            scratch: ScratchFile::new(scratch.into()),
            state: Mutex::default(),
        })
    }

    /// A cache whose scratch folder is one that exists, as near to `path` as there is one.
    pub fn near(budget: u64, path: &Path) -> Arc<Self> {
        let folder = path.ancestors().find(|p| p.is_dir());
        Self::new(budget, folder.unwrap_or(Path::new(".")))
    }

    /// The most bytes that were in use at one time.
    pub fn peak_bytes(&self) -> u64 {
        self.lock().peak
    }

    pub(crate) fn budget(&self) -> u64 {
        self.budget
    }

    /// Most that a file may take which has to be read in one piece.
    pub(crate) fn whole_file(&self) -> u64 {
        self.budget / 2
    }

    /// Most that rows take while a raster is laid out.
    pub(crate) fn bands(&self) -> u64 {
        self.budget / 8
    }

    pub(crate) fn scratch(&self) -> &ScratchFile {
        &self.scratch
    }

    /// Takes memory for a whole raster, if there is enough.
    pub(crate) fn hold(self: &Arc<Self>, bytes: u64) -> Option<Held> {
        let mut state = self.lock();
        if state.held.saturating_add(bytes) > self.budget / 8 * 3 {
            return None;
        }
        state.held += bytes;
        state.take(bytes, self.budget);
        Some(Held {
            cache: Arc::clone(self),
            bytes,
            raster: true,
        })
    }

    /// Counts memory that a reader needs for a while.
    pub(crate) fn borrow(self: &Arc<Self>, bytes: u64) -> Held {
        self.lock().take(bytes, self.budget);
        Held {
            cache: Arc::clone(self),
            bytes,
            raster: false,
        }
    }

    /// A number for a raster whose blocks are to be cached.
    pub(crate) fn raster(&self) -> u32 {
        let mut state = self.lock();
        state.rasters += 1;
        state.rasters
    }

    /// A block, read by `load` unless it is there. Two threads that lack the same block may both read it.
    ///
    /// # Errors
    /// Those of `load`.
    pub(crate) fn block(
        &self,
        key: Key,
        bytes: u64,
        load: impl FnOnce() -> Result<Vec<Cell>, InputError>,
    ) -> Result<Arc<[Cell]>, InputError> {
        let mut state = self.lock();
        if let Some(block) = state.find(key) {
            return Ok(block);
        }
        state.take(bytes, self.budget);
        drop(state);
        let block = load();
        let mut state = self.lock();
        let block: Arc<[Cell]> = match block {
            Ok(block) => block.into(),
            Err(e) => {
                state.used -= bytes;
                return Err(e);
            }
        };
        if let Some(other) = state.find(key) {
            state.used -= bytes;
            return Ok(other);
        }
        state.time += 1;
        let time = state.time;
        state.order.insert(time, key);
        state.blocks.insert(key, (time, Arc::clone(&block)));
        Ok(block)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every change is whole before anything can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn find(&mut self, key: Key) -> Option<Arc<[Cell]>> {
        let (time, block) = self.blocks.get_mut(&key)?;
        self.time += 1;
        self.order.remove(time);
        self.order.insert(self.time, key);
        *time = self.time;
        Some(Arc::clone(block))
    }

    /// Counts bytes as used, after the oldest blocks have made room for them as far as there are any.
    fn take(&mut self, bytes: u64, budget: u64) {
        while self.used.saturating_add(bytes) > budget {
            let Some((_, key)) = self.order.pop_first() else {
                break;
            };
            if let Some((_, block)) = self.blocks.remove(&key) {
                self.used -= size_of_val(&*block) as u64;
            }
        }
        self.used += bytes;
        self.peak = self.peak.max(self.used);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_block_goes_first_and_the_budget_holds() {
        let cache = RasterCache::new(48, "");
        let read = |key: u64| {
            let mut loaded = false;
            let block = cache.block((0, key), 16, || {
                loaded = true;
                Ok(vec![[key as u8; 4]; 4])
            });
            assert_eq!(block.unwrap()[0], [key as u8; 4]);
            loaded
        };
        assert!(read(1) && read(2) && read(3));
        assert!(!read(1));
        assert!(read(4), "takes the place of 2");
        assert!(!read(1) && !read(3) && !read(4) && read(2));
        assert_eq!(cache.peak_bytes(), 48);
        let fails = cache.block((0, 9), 16, || {
            Err(InputError::NoHeights {
                path: PathBuf::from("a"),
            })
        });
        assert!(fails.is_err() && read(9));
        assert_eq!(cache.peak_bytes(), 48);
    }

    #[test]
    fn whole_rasters_take_at_most_their_part() {
        let cache = RasterCache::new(80, "");
        let held = cache.hold(30).unwrap();
        assert!(cache.hold(1).is_none());
        drop(held);
        assert!(cache.hold(31).is_none());
        assert!(cache.hold(30).is_some());
    }
}
