//! Least recently used order over the slots of the page table: a doubly linked list in one array, all steps O(1).
//!
//! Owned by the render thread.

const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Link {
    before: u32,
    after: u32,
    listed: bool,
}

const UNLISTED: Link = Link {
    before: NONE,
    after: NONE,
    listed: false,
};

/// A list of slot numbers, the least recently used first.
#[derive(Debug)]
pub(crate) struct Lru {
    links: Vec<Link>,
    first: u32,
    last: u32,
}

impl Default for Lru {
    fn default() -> Self {
        Self {
            links: Vec::new(),
            first: NONE,
            last: NONE,
        }
    }
}

impl Lru {
    /// The least recently used slot.
    pub(crate) fn oldest(&self) -> Option<u32> {
        (self.first != NONE).then_some(self.first)
    }

    /// Makes the slot the most recently used one, listing it if it was not.
    pub(crate) fn touch(&mut self, slot: u32) {
        self.remove(slot);
        if self.links.len() <= slot as usize {
            self.links.resize(slot as usize + 1, UNLISTED);
        }
        self.links[slot as usize] = Link {
            before: self.last,
            after: NONE,
            listed: true,
        };
        match self.last {
            NONE => self.first = slot,
            last => self.links[last as usize].after = slot,
        }
        self.last = slot;
    }

    /// Takes the slot out of the list, if it is in it.
    pub(crate) fn remove(&mut self, slot: u32) {
        let Some(link) = self.links.get_mut(slot as usize).filter(|l| l.listed) else {
            return;
        };
        let Link { before, after, .. } = std::mem::replace(link, UNLISTED);
        match before {
            NONE => self.first = after,
            before => self.links[before as usize].after = after,
        }
        match after {
            NONE => self.last = before,
            after => self.links[after as usize].before = before,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn order(lru: &Lru) -> Vec<u32> {
        std::iter::successors(lru.oldest(), |s| {
            Some(lru.links[*s as usize].after).filter(|a| *a != NONE)
        })
        .collect()
    }

    proptest! {
        #[test]
        fn behaves_like_a_plain_list(steps in proptest::collection::vec((any::<bool>(), 0u32..12), 0..200)) {
            let (mut lru, mut model) = (Lru::default(), Vec::new());
            for (touch, slot) in steps {
                model.retain(|s| *s != slot);
                if touch {
                    lru.touch(slot);
                    model.push(slot);
                } else {
                    lru.remove(slot);
                }
                prop_assert_eq!(order(&lru), model.clone());
                let mut backwards: Vec<u32> = std::iter::successors(
                    (lru.last != NONE).then_some(lru.last),
                    |s| Some(lru.links[*s as usize].before).filter(|b| *b != NONE),
                ).collect();
                backwards.reverse();
                prop_assert_eq!(backwards, model.clone());
            }
        }
    }
}
