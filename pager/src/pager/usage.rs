//! Who wants and who uses what: stamps, the order of use, and the pins of roots.

use brickfell_culler::TreeId;

use crate::page::PageKey;
use crate::table::State;

use super::Pager;

impl Pager {
    /// Puts a tree in use, which pins its root.
    pub(super) fn acquire(&mut self, tree: TreeId) {
        let Some(entry) = self.trees.get_mut(tree.0 as usize) else {
            return;
        };
        if !std::mem::replace(&mut entry.in_use, true)
            && let Some((slot, bytes)) = self.resident_root(tree)
        {
            self.not_ahead(slot);
            self.pinned_bytes += bytes;
            self.levels.remove(slot);
        }
    }

    /// Notes a request for a page whose parents are there, or are asked for too. One that is not ahead of its use comes before
    /// one that is.
    pub(super) fn want(&mut self, key: PageKey, priority: f64, ahead: bool) {
        let tick = self.tick;
        let known = self.table.find(key);
        self.counters.requested += u64::from(known.is_none());
        let slot = known.unwrap_or_else(|| self.table.find_or_insert(key));
        let Some(entry) = self.table.get_mut(slot) else {
            return;
        };
        match entry.state {
            State::Resident(_) if ahead => {}
            State::Resident(_) => self.use_slot(slot),
            State::GivenUp => {}
            _ if entry.stamp != tick => {
                (entry.stamp, entry.priority, entry.ahead) = (tick, priority, ahead);
                self.wanted.push(slot);
            }
            _ if entry.ahead == ahead => entry.priority = entry.priority.min(priority),
            _ if entry.ahead => (entry.priority, entry.ahead) = (priority, false),
            _ => {}
        }
    }

    /// A page that came ahead of its use is used, or leaves.
    pub(super) fn not_ahead(&mut self, slot: u32) {
        if let Some(entry) = self.table.get_mut(slot)
            && std::mem::take(&mut entry.ahead)
            && matches!(entry.state, State::Resident(_))
        {
            self.ahead_bytes -= entry.bytes;
        }
    }

    /// Puts a page that came ahead of its use at the end of its list, and what is above it behind it.
    pub(super) fn list_ahead(&mut self, slot: u32, key: PageKey) {
        match key {
            PageKey::Chunk { .. } => self.chunks.touch(slot),
            PageKey::Level { .. } => self.levels.touch(slot),
            PageKey::Root(_) => {}
        }
        let tree = key.tree();
        let above = (1..key.level()).rev().map(|level| PageKey::Level { tree, level });
        for key in above {
            if let Some(slot) = self.table.find(key) {
                self.levels.touch(slot);
            }
        }
        let in_use = self.trees.get(tree.0 as usize).is_some_and(|t| t.in_use);
        if let (false, Some((root, _))) = (in_use, self.resident_root(tree)) {
            self.levels.touch(root);
        }
    }

    /// Stamps a resident page other than a root.
    pub(super) fn use_slot(&mut self, slot: u32) {
        self.not_ahead(slot);
        let Some(entry) = self.table.get_mut(slot) else {
            return;
        };
        if entry.stamp == self.tick || !matches!(entry.state, State::Resident(_)) {
            return;
        }
        entry.stamp = self.tick;
        self.used_bytes += entry.bytes;
        match entry.key {
            PageKey::Chunk { .. } => self.chunks.touch(slot),
            _ => self.levels.touch(slot),
        }
    }

    /// Puts the tree in use and stamps its resident levels down to this one.
    pub(super) fn use_levels(&mut self, tree: TreeId, level: u8) {
        self.acquire(tree);
        self.stamp_levels(tree, level);
    }

    pub(super) fn stamp_levels(&mut self, tree: TreeId, level: u8) {
        let tick = self.tick;
        let Some(entry) = self.trees.get_mut(tree.0 as usize) else {
            return;
        };
        if entry.stamped.0 == tick && entry.stamped.1 >= level {
            return;
        }
        entry.stamped = (tick, level);
        let in_use = entry.in_use;
        // From the finest up, and every one of them again: parents stay behind their children in the list.
        for level in (1..=level).rev() {
            if let Some(slot) = self.table.find(PageKey::Level { tree, level }) {
                self.use_slot(slot);
                if self
                    .table
                    .get(slot)
                    .is_some_and(|s| matches!(s.state, State::Resident(_)))
                {
                    self.levels.touch(slot);
                }
            }
        }
        if let Some((slot, _)) = self.resident_root(tree) {
            if let Some(root) = self.table.get_mut(slot) {
                root.stamp = tick;
            }
            if !in_use {
                self.levels.touch(slot);
            }
        }
    }
}
