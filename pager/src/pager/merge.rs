//! The first half of a frame: results come in and are published.

use std::sync::Arc;
use std::time::Instant;

use crate::load::LoadError;
use crate::page::{Page, PageKey};
use crate::table::{Handle, State};
use crate::tree::TreeState;

use super::{PageFault, Pager};

/// What can be done with a page that is ready.
enum Parent {
    Resident,
    Coming,
    Gone,
}

impl Pager {
    pub(super) fn begin_frame(&mut self) {
        self.tick += 1;
        self.now = Instant::now();
        self.used_bytes = 0;
        self.wanted.clear();
        self.published.clear();
        let (started, ready) = self.loaders.loads.take_news();
        self.note_started(started);
        let mut dropped = Vec::new();
        let mut dropped_bytes = 0;
        for done in ready {
            let Some(slot) = self.table.by_handle(done.handle) else {
                dropped_bytes += done.bytes;
                dropped.extend(done.result.ok());
                continue;
            };
            match done.result {
                Ok(page) => {
                    slot.state = State::Ready(page);
                    slot.bytes = done.bytes;
                }
                Err(LoadError::Outgrown(bytes)) => {
                    slot.state = State::Requested;
                    slot.bytes = bytes;
                    self.requested.push(done.handle);
                }
                Err(LoadError::Failed(message)) => self.note_failure(done.handle, message),
            }
        }
        self.publish_ready(&mut dropped, &mut dropped_bytes);
        self.loaders.loads.discard(dropped, dropped_bytes);
    }

    /// Marks the pages that loaders have taken from the queue.
    pub(super) fn note_started(&mut self, started: Vec<Handle>) {
        for handle in started {
            if let Some(slot) = self.table.by_handle(handle) {
                slot.state = State::Loading;
                self.arriving.push(handle);
            }
        }
    }

    pub(super) fn note_failure(&mut self, handle: Handle, message: String) {
        let retry_at = self.now + self.config.retry;
        let Some(slot) = self.table.by_handle(handle) else {
            return;
        };
        slot.attempts += 1;
        if slot.attempts < self.config.max_attempts {
            slot.state = State::Failed(retry_at);
            return;
        }
        slot.state = State::GivenUp;
        self.counters.failed += 1;
        self.faults.push(PageFault {
            key: slot.key,
            message,
        });
    }

    fn publish_ready(&mut self, dropped: &mut Vec<Page>, dropped_bytes: &mut u64) {
        let mut arriving = std::mem::take(&mut self.arriving);
        arriving.retain(|h| {
            self.table
                .by_handle(*h)
                .is_some_and(|s| matches!(s.state, State::Loading | State::Ready(_)))
        });
        arriving.sort_by_key(|h| {
            self.table
                .get(h.slot)
                .map(|s| (s.key.rank(), s.key.level(), s.key))
        });
        for handle in arriving {
            let Some(slot) = self.table.get(handle.slot) else {
                continue;
            };
            if !matches!(slot.state, State::Ready(_)) {
                self.arriving.push(handle);
                continue;
            }
            match self.parent(slot.key) {
                Parent::Resident => self.publish(handle.slot),
                Parent::Coming => self.arriving.push(handle),
                Parent::Gone => {
                    if let Some(slot) = self.table.remove(handle.slot)
                        && let State::Ready(page) = slot.state
                    {
                        *dropped_bytes += slot.bytes;
                        dropped.push(page);
                    }
                }
            }
        }
    }

    fn parent(&self, key: PageKey) -> Parent {
        let tree = key.tree();
        let level = match key {
            PageKey::Root(_) => return Parent::Resident,
            PageKey::Level { level, .. } => level.saturating_sub(1),
            PageKey::Chunk { level, .. } => level,
        };
        if self.tree(tree).is_some_and(|t| t.level(level).is_some()) {
            return Parent::Resident;
        }
        let parent = PageKey::Level { tree, level }.holder();
        match self.table.by_key(parent).map(|s| &s.state) {
            None | Some(State::GivenUp) => Parent::Gone,
            Some(_) => Parent::Coming,
        }
    }

    /// Makes a ready page visible to [`Pager::tree`] and [`Pager::chunk`].
    fn publish(&mut self, slot: u32) {
        let Some(entry) = self.table.get_mut(slot) else {
            return;
        };
        let State::Ready(page) = std::mem::replace(&mut entry.state, State::Requested) else {
            return;
        };
        entry.state = State::Resident(page.clone());
        entry.stamp = 0;
        entry.attempts = 0;
        let (key, bytes) = (entry.key, entry.bytes);
        let Some(tree) = self.trees.get_mut(key.tree().0 as usize) else {
            return;
        };
        // A root that was wanted ahead may be in use by now.
        entry.ahead &= !(tree.in_use && matches!(key, PageKey::Root(_)));
        let ahead = entry.ahead;
        match (page, key) {
            (Page::Root(root), _) => {
                tree.state = Some(Arc::new(TreeState::new(root)));
                if tree.in_use {
                    self.pinned_bytes += bytes;
                }
            }
            (Page::Level(page), PageKey::Level { level, .. }) => {
                if let Some(state) = &mut tree.state
                    && let Some(place) = Arc::make_mut(state).levels.get_mut(usize::from(level))
                {
                    *place = Some(page);
                }
            }
            _ => {}
        }
        tree.stamped = (0, 0);
        let loaded = &mut self.counters.loaded_bytes;
        if ahead {
            loaded.ahead += bytes;
            self.ahead_bytes += bytes;
            self.list_ahead(slot, key);
        } else {
            *match key {
                PageKey::Root(_) => &mut loaded.roots,
                PageKey::Level { .. } => &mut loaded.levels,
                PageKey::Chunk { .. } => &mut loaded.chunks,
            } += bytes;
            // What nobody could use before counts as used now; its place in the order is behind its children, before its
            // parents.
            if !matches!(key, PageKey::Root(_)) {
                self.use_slot(slot);
            }
            self.stamp_levels(key.tree(), key.level());
        }
        self.resident_bytes += bytes;
        self.counters.loads += 1;
        self.published.push(key);
    }
}
