//! The pager as the render thread sees it. See the crate for the order of calls.

mod merge;
mod submit;
#[cfg(test)]
mod tests;
mod usage;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use brickfell_culler::TreeId;

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

/// What the pager holds and did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PagerStats {
    /// Bytes of resident pages.
    pub resident_bytes: u64,
    /// Most bytes ever held: resident, ready, under way by estimate, and evicted but not yet dropped.
    pub peak_bytes: u64,
    /// Bytes read from the store.
    pub bytes_read: u64,
    /// Pages published.
    pub loads: u64,
    /// Requests that left the queue before a loader took them.
    pub cancelled: u64,
    /// Pages evicted.
    pub evicted: u64,
    /// Pages given up.
    pub failed: u64,
    /// Pages in the queue.
    pub queued: usize,
    /// Pages asked for in the last frame for which the budget has no room.
    pub deferred: usize,
    /// Pages under way.
    pub loading: usize,
    /// Pages loaded, to be taken by the next merge.
    pub ready: usize,
    /// Pages loaded that wait for their parents.
    pub held: usize,
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
    loads: u64,
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

    /// Asks for a page in this frame; smaller priorities load first, and the smallest of several counts. Parents that are
    /// missing are asked for too, with the same priority. A chunk, or a level, whose parents are not resident yet must be
    /// asked for again once they are. Asking for a resident page is a touch; for a page that does not exist, nothing.
    pub fn request(&mut self, key: PageKey, priority: f64) {
        let key = key.holder();
        let tree = key.tree();
        let Some(entry) = self.trees.get(tree.0 as usize) else {
            return;
        };
        let Some(state) = entry.state.clone() else {
            self.acquire(tree);
            return self.want(PageKey::Root(tree), priority);
        };
        let level = key.level();
        if level > state.root.header.depth {
            return;
        }
        self.use_levels(tree, level);
        for l in 1..=level {
            let key = PageKey::Level { tree, level: l };
            if state.level(l).is_none() {
                if self
                    .table
                    .by_key(key)
                    .is_some_and(|s| matches!(s.state, State::GivenUp))
                {
                    return;
                }
                self.want(key, priority);
            }
        }
        if let (PageKey::Chunk { chunk, .. }, Some(page)) = (key, state.level(level))
            && page
                .bricks
                .as_ref()
                .is_some_and(|b| (chunk as usize) < b.chunks.len())
        {
            self.want(key, priority);
        }
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

    /// Counts of this moment.
    pub fn stats(&self) -> PagerStats {
        let status = self.loaders.loads.status();
        let held = self.arriving.iter().filter(|h| self.is_ready(**h)).count();
        PagerStats {
            resident_bytes: self.resident_bytes,
            peak_bytes: status.peak,
            bytes_read: self.loaders.bytes_read.load(Ordering::Relaxed),
            loads: self.counters.loads,
            cancelled: self.counters.cancelled,
            evicted: self.counters.evicted,
            failed: self.counters.failed,
            queued: status.queued,
            deferred: self.demand.deferred,
            loading: status.loading,
            ready: status.ready,
            held,
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
