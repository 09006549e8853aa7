//! What the pager holds and did, in numbers. Render thread.

use std::sync::atomic::Ordering;

use super::Pager;

/// Bytes by what they are there for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadedBytes {
    /// Root pages, without which nothing of a tree is shown.
    pub roots: u64,
    /// Levels: what says which nodes there are, and where their bricks are.
    pub levels: u64,
    /// Chunks of bricks.
    pub chunks: u64,
    /// Pages of any kind that were wanted ahead of their use when they came.
    pub ahead: u64,
}

/// What the pager holds and did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PagerStats {
    /// Bytes of resident pages.
    pub resident_bytes: u64,
    /// Of those, roots of trees in use.
    pub pinned_bytes: u64,
    /// Of those, other pages that the last frame used.
    pub used_bytes: u64,
    /// Of those, pages that came ahead of their use and were not used yet.
    pub ahead_bytes: u64,
    /// Bytes of loads under way by estimate, and of finished ones that wait.
    pub arriving_bytes: u64,
    /// Bytes of evicted pages that are not dropped yet.
    pub leaving_bytes: u64,
    /// Most bytes ever held: resident, ready, under way by estimate, evicted but not yet dropped, and the queue.
    pub peak_bytes: u64,
    /// Pages asked for that were not known, each time.
    pub requested: u64,
    /// Bytes of pages published, by what they were wanted for.
    pub loaded_bytes: LoadedBytes,
    /// Bytes read from the store.
    pub bytes_read: u64,
    /// Nanoseconds in which loaders verified and decoded chunks, all together.
    pub decode_nanos: u64,
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

impl Pager {
    /// Counts of this moment.
    pub fn stats(&self) -> PagerStats {
        let status = self.loaders.loads.status();
        let held = self.arriving.iter().filter(|h| self.is_ready(**h)).count();
        PagerStats {
            resident_bytes: self.resident_bytes,
            pinned_bytes: self.pinned_bytes,
            used_bytes: self.used_bytes,
            ahead_bytes: self.ahead_bytes,
            arriving_bytes: status.arriving_bytes,
            leaving_bytes: status.leaving_bytes,
            peak_bytes: status.peak,
            requested: self.counters.requested,
            loaded_bytes: self.counters.loaded_bytes,
            bytes_read: self.loaders.meters.bytes_read.load(Ordering::Relaxed),
            decode_nanos: self.loaders.meters.decode_nanos.load(Ordering::Relaxed),
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
}
