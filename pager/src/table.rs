//! The page table: what the pager knows about every page that is wanted, under way, resident or failed.
//!
//! A page that nobody wants has no entry. Entries are named by handles; the generation changes whenever a slot is
//! given up, so a result that comes in for an old handle is recognised. Owned by the render thread.

use std::collections::HashMap;
use std::time::Instant;

use crate::page::{Page, PageKey};

/// A slot of the table and the generation of its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct Handle {
    pub(crate) slot: u32,
    pub(crate) generation: u32,
}

/// Where a page is on its way. Absent pages have no slot.
#[derive(Debug)]
pub(crate) enum State {
    /// Wanted and waiting for a loader, or for room in the budget.
    Requested,
    /// A loader has it.
    Loading,
    /// Loaded and checked, waiting for its parent to become resident.
    Ready(Page),
    /// Published.
    Resident(Page),
    /// Not to be tried again before that time.
    Failed(Instant),
    /// Not to be tried again.
    GivenUp,
}

/// An entry.
#[derive(Debug)]
pub(crate) struct Slot {
    pub(crate) key: PageKey,
    pub(crate) state: State,
    /// Frame of the last request or touch.
    pub(crate) stamp: u64,
    /// Smallest priority of the requests of that frame.
    pub(crate) priority: f64,
    /// Bytes: of the page once it is loaded, else what loading it is expected to take.
    pub(crate) bytes: u64,
    /// Wanted ahead of its use only; of a resident page, not used since it came.
    pub(crate) ahead: bool,
    /// Failed attempts so far.
    pub(crate) attempts: u32,
    generation: u32,
}

/// All entries.
#[derive(Debug, Default)]
pub(crate) struct Table {
    by_key: HashMap<PageKey, u32>,
    slots: Vec<Option<Slot>>,
    free: Vec<u32>,
    next_generation: u32,
}

impl Table {
    pub(crate) fn find(&self, key: PageKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    pub(crate) fn get(&self, slot: u32) -> Option<&Slot> {
        self.slots.get(slot as usize)?.as_ref()
    }

    pub(crate) fn get_mut(&mut self, slot: u32) -> Option<&mut Slot> {
        self.slots.get_mut(slot as usize)?.as_mut()
    }

    pub(crate) fn by_key(&self, key: PageKey) -> Option<&Slot> {
        self.get(self.find(key)?)
    }

    /// The entry of a handle, unless the slot has another generation by now.
    pub(crate) fn by_handle(&mut self, handle: Handle) -> Option<&mut Slot> {
        self.get_mut(handle.slot)
            .filter(|s| s.generation == handle.generation)
    }

    pub(crate) fn handle(&self, slot: u32) -> Option<Handle> {
        self.get(slot).map(|s| Handle {
            slot,
            generation: s.generation,
        })
    }

    /// The slot of a page, made as requested if there is none.
    pub(crate) fn find_or_insert(&mut self, key: PageKey) -> u32 {
        if let Some(slot) = self.find(key) {
            return slot;
        }
        self.next_generation = self.next_generation.wrapping_add(1);
        let entry = Slot {
            key,
            state: State::Requested,
            stamp: 0,
            priority: f64::INFINITY,
            bytes: 0,
            ahead: false,
            attempts: 0,
            generation: self.next_generation,
        };
        let slot = match self.free.pop() {
            Some(slot) => slot,
            None => {
                self.slots.push(None);
                (self.slots.len() - 1) as u32
            }
        };
        self.slots[slot as usize] = Some(entry);
        self.by_key.insert(key, slot);
        slot
    }

    /// Forgets a page; handles to it are void from here on.
    pub(crate) fn remove(&mut self, slot: u32) -> Option<Slot> {
        let entry = self.slots.get_mut(slot as usize)?.take()?;
        self.by_key.remove(&entry.key);
        self.free.push(slot);
        Some(entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_culler::TreeId;

    #[test]
    fn handles_do_not_survive_their_page() {
        let mut table = Table::default();
        let key = PageKey::Root(TreeId(3));
        let slot = table.find_or_insert(key);
        let old = table.handle(slot).unwrap();
        assert_eq!(table.find_or_insert(key), slot);
        assert!(table.by_handle(old).is_some());
        table.remove(slot);
        assert!(table.by_key(key).is_none() && table.by_handle(old).is_none());
        assert_eq!(table.find_or_insert(key), slot, "slots are used again");
        assert!(table.by_handle(old).is_none());
    }
}
