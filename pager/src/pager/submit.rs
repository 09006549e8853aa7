//! The second half of a frame: what is wanted goes to the loaders, what the budget needs is evicted.

use std::collections::HashMap;
use std::sync::Arc;

use brickfell_culler::TreeId;

use crate::exchange::Job;
use crate::load::{ROOT_ESTIMATE, chunk_estimate, level_estimate};
use crate::loader::{Loads, Work};
use crate::page::{Page, PageKey};
use crate::queue::Urgency;
use crate::table::{Handle, State};

use super::{AHEAD_PART, Demand, PARTS, Pager};

impl Pager {
    pub(super) fn end_frame(&mut self) {
        let started = self.loaders.loads.take_started();
        self.note_started(started);
        self.cancel_stale();
        let mut wanted = self.gather();
        self.demand.bytes = self.pinned_bytes + self.used_bytes + self.demand.missing_bytes;
        if let Some(reason) = &self.loaders.failure {
            let reason = reason.clone();
            for (_, slot) in wanted.drain(..) {
                if let (Some(handle), Some(entry)) = (self.table.handle(slot), self.table.get_mut(slot)) {
                    entry.attempts = self.config.max_attempts;
                    self.note_failure(handle, reason.clone());
                }
            }
        }
        let clear = self.admit(&mut wanted);
        self.evict_for(clear);
        let jobs: Vec<_> = wanted
            .iter()
            .filter_map(|(urgency, slot)| self.job(*urgency, *slot))
            .collect();
        self.requested = jobs.iter().map(|(_, _, job)| job.handle).collect();
        self.loaders.loads.install(jobs);
    }

    /// Forgets requests that this frame did not renew.
    fn cancel_stale(&mut self) {
        for handle in std::mem::take(&mut self.requested) {
            let stale = self
                .table
                .by_handle(handle)
                .is_some_and(|s| s.stamp != self.tick && matches!(s.state, State::Requested));
            if stale {
                self.table.remove(handle.slot);
                self.counters.cancelled += 1;
            }
        }
    }

    /// The pages to be queued, and what this frame's requests amount to.
    fn gather(&mut self) -> Vec<(Urgency, u32)> {
        self.demand = Demand::default();
        let mut wanted = Vec::with_capacity(self.wanted.len());
        for slot in &self.wanted {
            let Some(entry) = self.table.get(*slot) else {
                continue;
            };
            let (key, ahead) = (entry.key, entry.ahead);
            let demand = |bytes: u64| if ahead { 0 } else { bytes };
            match entry.state {
                State::Failed(at) if at > self.now => {
                    self.demand.retry_at = Some(self.demand.retry_at.map_or(at, |t| t.min(at)));
                    self.demand.missing_bytes += demand(entry.bytes);
                    continue;
                }
                State::Requested | State::Failed(_) => {}
                State::Loading | State::Ready(_) => {
                    self.demand.missing_bytes += demand(entry.bytes);
                    continue;
                }
                State::Resident(_) | State::GivenUp => continue,
            }
            let estimate = self.estimate(key);
            let Some(entry) = self.table.get_mut(*slot) else {
                continue;
            };
            entry.state = State::Requested;
            entry.bytes = entry.bytes.max(estimate);
            self.demand.missing_bytes += demand(entry.bytes);
            let class = match key {
                _ if ahead => 2,
                PageKey::Root(_) => 0,
                _ => 1,
            };
            let order = u16::from(key.rank()) * 32 + u16::from(key.level());
            wanted.push((
                Urgency {
                    class,
                    priority: entry.priority,
                    order,
                    slot: *slot,
                },
                *slot,
            ));
        }
        wanted
    }

    /// Bytes that loading a page is expected to take.
    fn estimate(&self, key: PageKey) -> u64 {
        let Some(state) = self.tree(key.tree()) else {
            return ROOT_ESTIMATE;
        };
        let bytes = match key {
            PageKey::Root(_) => Some(ROOT_ESTIMATE),
            PageKey::Level { level, .. } => {
                let entry = state
                    .root
                    .index
                    .as_ref()
                    .and_then(|i| i.levels.get(usize::from(level)));
                entry.map(level_estimate)
            }
            PageKey::Chunk { level, chunk, .. } => {
                let bricks = state.level(level).and_then(|page| page.bricks.as_ref());
                let keep = self.config.keep_blocks;
                bricks.and_then(|b| Some(chunk_estimate(b.chunks.get(chunk as usize)?, &b.header, keep)))
            }
        };
        bytes.unwrap_or(ROOT_ESTIMATE)
    }

    /// Takes out what does not fit beside the pages in use, the least urgent first, and what would come without its
    /// parents; leaves the rest in order. Gives the bytes to clear for it.
    fn admit(&mut self, wanted: &mut Vec<(Urgency, u32)>) -> u64 {
        let bytes = |slot: u32| self.table.get(slot).map_or(0, |s| s.bytes);
        let status = self.loaders.loads.status();
        let held: u64 = self
            .arriving
            .iter()
            .filter(|h| self.is_ready(**h))
            .map(|h| bytes(h.slot))
            .sum();
        let taken = self.pinned_bytes + self.used_bytes + held + status.arriving_bytes;
        let limits = self.config.limits();
        let mut room = limits.all.saturating_sub(taken);
        let reserve = limits.all - limits.usual;
        let under_way = self.arriving.iter().filter_map(|h| self.table.get(h.slot));
        let coming: u64 = under_way.filter(|s| s.ahead).map(|s| s.bytes).sum();
        let mut ahead_room = (limits.all / AHEAD_PART).saturating_sub(self.ahead_bytes + coming);
        let before = wanted.len();
        wanted.sort_unstable_by_key(|(urgency, _)| *urgency);
        let mut missing: HashMap<TreeId, u8> = HashMap::new();
        let mut ahead_left = 0;
        wanted.retain(|(_, slot)| {
            let Some(entry) = self.table.get(*slot) else {
                return false;
            };
            let (tree, level) = (entry.key.tree(), entry.key.level());
            let cost = entry.bytes + Loads::JOB_BYTES;
            let usable = match entry.key {
                PageKey::Root(_) if !entry.ahead => room,
                _ => room.saturating_sub(reserve),
            };
            let orphan = missing.get(&tree).is_some_and(|l| *l <= level);
            if cost <= usable && !orphan && (!entry.ahead || cost <= ahead_room) {
                room -= cost;
                ahead_room -= if entry.ahead { cost } else { 0 };
                return true;
            }
            ahead_left += usize::from(entry.ahead);
            if matches!(entry.key, PageKey::Level { .. }) {
                missing
                    .entry(tree)
                    .and_modify(|l| *l = (*l).min(level))
                    .or_insert(level);
            }
            false
        });
        self.demand.deferred = before - wanted.len() - ahead_left;
        let cost = |slot: u32| bytes(slot) + Loads::JOB_BYTES;
        let first = wanted.first().map_or(0, |(_, slot)| cost(*slot));
        let total: u64 = wanted.iter().map(|(_, slot)| cost(*slot)).sum();
        first.max(total.min(self.config.budget_bytes / PARTS))
    }

    /// Evicts unused pages until `clear` bytes are free, as far as there are any.
    fn evict_for(&mut self, clear: u64) {
        let status = self.loaders.loads.status();
        let staying = status.committed - status.leaving_bytes;
        // Roots, too, leave the reserve alone as long as something else can go.
        let mut excess = (staying + clear).saturating_sub(self.config.limits().usual);
        let mut pages = Vec::new();
        let mut freed = 0;
        while excess > 0 {
            let unused = |slot: &u32| self.table.get(*slot).is_some_and(|s| s.stamp != self.tick);
            let oldest = self
                .chunks
                .oldest()
                .filter(unused)
                .or_else(|| self.levels.oldest().filter(unused));
            let Some(slot) = oldest else { break };
            let bytes = self.evict(slot, &mut pages);
            excess = excess.saturating_sub(bytes);
            freed += bytes;
        }
        self.loaders.loads.discard(pages, freed);
    }

    /// Takes a page away, and with it what was under way below it. Gives the bytes.
    fn evict(&mut self, slot: u32, pages: &mut Vec<Page>) -> u64 {
        self.not_ahead(slot);
        self.chunks.remove(slot);
        self.levels.remove(slot);
        let Some(entry) = self.table.remove(slot) else {
            return 0;
        };
        let mut freed = 0;
        if let State::Resident(page) = entry.state {
            self.resident_bytes -= entry.bytes;
            freed += entry.bytes;
            pages.push(page);
        }
        self.counters.evicted += 1;
        let (key, tree) = (entry.key, entry.key.tree());
        if matches!(key, PageKey::Chunk { .. }) {
            return freed;
        }
        if let Some(state) = self.trees.get_mut(tree.0 as usize).map(|t| &mut t.state) {
            match (key, &mut *state) {
                (PageKey::Level { level, .. }, Some(state)) => {
                    if let Some(place) = Arc::make_mut(state).levels.get_mut(usize::from(level)) {
                        *place = None;
                    }
                }
                _ => *state = None,
            }
        }
        let below: Vec<Handle> = self
            .arriving
            .iter()
            .copied()
            .filter(|h| {
                let entry = self
                    .table
                    .get(h.slot)
                    .filter(|_| self.table.handle(h.slot) == Some(*h));
                entry.is_some_and(|s| s.key.tree() == tree && s.key.level() >= key.level())
            })
            .collect();
        for handle in below {
            if let Some(entry) = self.table.remove(handle.slot)
                && let State::Ready(page) = entry.state
            {
                freed += entry.bytes;
                pages.push(page);
            }
        }
        freed
    }

    /// The job of a requested page, with its file.
    fn job(&self, urgency: Urgency, slot: u32) -> Option<(Urgency, u64, Job<Work>)> {
        let entry = self.table.get(slot)?;
        let tree = self.trees.get(entry.key.tree().0 as usize)?;
        let file = tree.file.clone();
        let octree_file = u8::MAX;
        let (work, part) = match entry.key {
            PageKey::Root(_) => (Work::Root { file }, octree_file),
            PageKey::Level { level, .. } => (
                Work::Level {
                    file,
                    root: tree.state.as_ref()?.root.clone(),
                    level,
                },
                octree_file,
            ),
            PageKey::Chunk { level, chunk, .. } => {
                let page = tree.state.as_ref()?.level(level)?.clone();
                (
                    Work::Chunk {
                        file,
                        page,
                        level,
                        chunk,
                    },
                    level,
                )
            }
        };
        let job = Job {
            handle: self.table.handle(slot)?,
            estimate: entry.bytes,
            reserved: matches!(entry.key, PageKey::Root(_)) && !entry.ahead,
            work,
        };
        Some((urgency, u64::from(entry.key.tree().0) << 8 | u64::from(part), job))
    }
}
