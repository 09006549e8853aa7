//! The pager as the render thread sees it. See the crate for the order of calls.

mod ask;
mod merge;
mod stats;
mod submit;
#[cfg(test)]
mod tests;
mod usage;

pub use stats::{LoadedBytes, PagerStats};

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_culler::TreeId;

use crate::exchange::Limits;
use crate::loader::Loaders;
use crate::lru::Lru;
use crate::page::{ChunkPage, Page, PageKey};
use crate::store::Store;
use crate::table::{Handle, State, Table};
use crate::tree::TreeState;

/// Limits of a pager.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PagerConfig {
    /// Bytes that pages may take in all (see the crate for what is counted).
    pub budget_bytes: u64,
    /// Loader threads, and so loads under way; at least one is started.
    pub threads: usize,
    /// How long a page that failed is left alone.
    pub retry: Duration,
    /// Attempts after which a page is given up; 0 counts as 1.
    pub max_attempts: u32,
    /// Whether chunks stay in the blocks in which they are stored, and those that are not are faults; else all become samples.
    pub keep_blocks: bool,
}

impl Default for PagerConfig {
    fn default() -> Self {
        Self {
            budget_bytes: 512 << 20,
            threads: 2,
            retry: Duration::from_secs(1),
            max_attempts: 3,
            keep_blocks: false,
        }
    }
}

/// The part of the budget that only roots may use, and that is cleared at once for what is queued: 1 / this. So the high
/// mark, up to which other pages are loaded, is the budget less one such part, and the low mark, down to which pages are
/// evicted, is the budget less two.
const PARTS: u64 = 16;

/// The part of the budget that may be taken by what comes ahead of its use: 1 / this.
const AHEAD_PART: u64 = 8;

impl PagerConfig {
    pub(crate) fn limits(&self) -> Limits {
        Limits {
            all: self.budget_bytes,
            usual: self.budget_bytes - self.budget_bytes / PARTS,
        }
    }
}

/// A page that was given up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageFault {
    /// The page.
    pub key: PageKey,
    /// Path, place and reason, on one line.
    pub message: String,
}

impl fmt::Display for PageFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// A tree of the scene.
#[derive(Debug)]
struct Tree {
    file: Arc<str>,
    state: Option<Arc<TreeState>>,
    /// Its root is pinned.
    in_use: bool,
    /// Tick in which its levels were last stamped, and the deepest of them.
    stamped: (u64, u8),
}

/// What [`Pager::submit`] found.
#[derive(Debug, Default)]
struct Demand {
    /// Bytes of requested pages that are not resident.
    missing_bytes: u64,
    /// Those, the resident pages used in the frame, and the pinned roots.
    bytes: u64,
    /// Pages that the budget has no room for.
    deferred: usize,
    /// When the first of the requested pages that failed may be tried again.
    retry_at: Option<Instant>,
}

#[derive(Debug, Default)]
struct Counters {
    requested: u64,
    loads: u64,
    loaded_bytes: LoadedBytes,
    cancelled: u64,
    evicted: u64,
    failed: u64,
}

/// Keeps the pages of a terrain. Owned by the render thread; nothing here waits for a loader, [`Pager::wait_for_progress`]
/// apart.
#[derive(Debug)]
pub struct Pager {
    config: PagerConfig,
    loaders: Loaders,
    trees: Vec<Tree>,
    table: Table,
    /// Resident chunks.
    chunks: Lru,
    /// Resident levels, and roots of trees not in use. A page always comes before its parents.
    levels: Lru,
    /// Counts the merges; stamps are ticks.
    tick: u64,
    merged: Option<u64>,
    /// Time of the last merge.
    now: Instant,
    /// Slots requested in this tick that are not resident.
    wanted: Vec<u32>,
    /// Slots that may be in the queue.
    requested: Vec<Handle>,
    /// Slots that a loader has, or that wait for their parent.
    arriving: Vec<Handle>,
    published: Vec<PageKey>,
    faults: Vec<PageFault>,
    resident_bytes: u64,
    /// Of those, roots of trees in use.
    pinned_bytes: u64,
    /// Of those, other pages stamped in this tick.
    used_bytes: u64,
    /// Of those, pages that came ahead of their use and were not used yet.
    ahead_bytes: u64,
    demand: Demand,
    counters: Counters,
}

impl Pager {
    /// A pager over the trees in these octree files, `TreeId(k)` being the k-th. Starts the loader threads; loads nothing
    /// by itself.
    pub fn new(store: Arc<dyn Store>, trees: Vec<String>, config: PagerConfig) -> Self {
        let tree = |file: String| Tree {
            file: file.into(),
            state: None,
            in_use: false,
            stamped: (0, 0),
        };
        Self {
            config,
            loaders: Loaders::start(store, config),
            trees: trees.into_iter().map(tree).collect(),
            table: Table::default(),
            chunks: Lru::default(),
            levels: Lru::default(),
            tick: 1,
            merged: None,
            now: Instant::now(),
            wanted: Vec::new(),
            requested: Vec::new(),
            arriving: Vec::new(),
            published: Vec::new(),
            faults: Vec::new(),
            resident_bytes: 0,
            pinned_bytes: 0,
            used_bytes: 0,
            ahead_bytes: 0,
            demand: Demand::default(),
            counters: Counters::default(),
        }
    }

    /// Begins a frame: publishes finished loads, parents before children, and says which pages became resident. A root
    /// brings level 0 and its chunk, and of an XML octree all levels; only [`PageKey::Root`] is listed for them.
    ///
    /// A second call with the same frame number changes nothing and gives the same list.
    pub fn merge(&mut self, frame: u64) -> &[PageKey] {
        if self.merged != Some(frame) {
            self.merged = Some(frame);
            self.begin_frame();
        }
        &self.published
    }

    /// Says that a page is used in this frame, so that it and its parents are kept.
    pub fn touch(&mut self, key: PageKey) {
        let key = key.holder();
        if self
            .trees
            .get(key.tree().0 as usize)
            .is_none_or(|t| t.state.is_none())
        {
            return;
        }
        if let PageKey::Chunk { .. } = key {
            match self.table.find(key) {
                Some(slot) => self.use_slot(slot),
                None => return,
            }
        }
        self.use_levels(key.tree(), key.level());
    }

    /// Ends this frame's requests: the queue becomes exactly what was asked for in this frame, and pages are evicted as
    /// far as the budget needs it, least recently used first, chunks before levels. Pages asked for or touched in this
    /// frame and roots of trees in use stay.
    pub fn submit(&mut self) {
        self.end_frame();
    }

    /// The resident part of a tree, `None` before its root is there.
    pub fn tree(&self, tree: TreeId) -> Option<&Arc<TreeState>> {
        self.trees.get(tree.0 as usize)?.state.as_ref()
    }

    /// A chunk, if it is resident.
    pub fn chunk(&self, tree: TreeId, level: u8, chunk: u32) -> Option<&Arc<ChunkPage>> {
        if level == 0 {
            return self.tree(tree)?.root.chunk0.as_ref().filter(|_| chunk == 0);
        }
        match &self.table.by_key(PageKey::Chunk { tree, level, chunk })?.state {
            State::Resident(Page::Chunk(chunk)) => Some(chunk),
            _ => None,
        }
    }

    /// True if the page, or one it needs, was given up.
    pub fn is_failed(&self, key: PageKey) -> bool {
        let key = key.holder();
        let tree = key.tree();
        let given_up = |key| {
            self.table
                .by_key(key)
                .is_some_and(|s| matches!(s.state, State::GivenUp))
        };
        given_up(PageKey::Root(tree))
            || (1..=key.level().min(brickfell_formats::octree::MAX_DEPTH))
                .any(|level| given_up(PageKey::Level { tree, level }))
            || given_up(key)
    }

    /// Takes the faults found since the last call. Each page that is given up appears once.
    pub fn drain_faults(&mut self) -> Vec<PageFault> {
        std::mem::take(&mut self.faults)
    }

    /// Says that a tree is no longer in use: its root may be evicted like its other pages. The next request or touch puts it
    /// in use again.
    pub fn release_tree(&mut self, tree: TreeId) {
        let Some(entry) = self.trees.get_mut(tree.0 as usize) else {
            return;
        };
        if !std::mem::take(&mut entry.in_use) {
            return;
        }
        entry.stamped = (0, 0);
        if let Some((slot, bytes)) = self.resident_root(tree) {
            self.pinned_bytes -= bytes;
            self.levels.touch(slot);
        }
    }

    /// True if nothing of what [`Pager::submit`] last handed over is queued, under way, ready to merge, or waiting for
    /// another attempt. Deferred pages do not count: they wait for a smaller demand.
    pub fn is_idle(&self) -> bool {
        let status = self.loaders.loads.status();
        status.queued + status.loading + status.ready == 0 && self.demand.retry_at.is_none()
    }

    /// Waits until a result is ready to merge, a failed page may be asked for again, or nothing is under way; false if that
    /// takes longer than `timeout`. Only for settled rendering.
    pub fn wait_for_progress(&self, timeout: Duration) -> bool {
        let retry = self
            .demand
            .retry_at
            .map(|at| at.saturating_duration_since(Instant::now()));
        if !self.loaders.loads.wait(retry.map_or(timeout, |r| r.min(timeout))) {
            return retry.is_some_and(|r| r <= timeout);
        }
        let status = self.loaders.loads.status();
        match retry.filter(|_| status.queued + status.loading + status.ready == 0) {
            Some(retry) => {
                std::thread::sleep(retry.min(timeout));
                retry <= timeout
            }
            None => true,
        }
    }

    /// Demand over budget as of the last [`Pager::submit`]: bytes of the pages requested and touched in the frame, and of the
    /// pinned roots, over the budget. Above 1 some of them are deferred.
    pub fn over_budget(&self) -> f64 {
        match self.demand.bytes {
            0 => 0.0,
            bytes => bytes as f64 / self.config.budget_bytes as f64,
        }
    }

    fn is_ready(&self, handle: Handle) -> bool {
        self.table
            .get(handle.slot)
            .is_some_and(|s| matches!(s.state, State::Ready(_)))
            && self.table.handle(handle.slot) == Some(handle)
    }

    fn resident_root(&self, tree: TreeId) -> Option<(u32, u64)> {
        let slot = self.table.find(PageKey::Root(tree))?;
        let entry = self.table.get(slot)?;
        matches!(entry.state, State::Resident(_)).then_some((slot, entry.bytes))
    }
}
