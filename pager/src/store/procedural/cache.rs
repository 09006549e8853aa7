//! What the store has made and may be asked for again, up to a number of bytes, least recently used out first.
//!
//! Called by loader threads under the store's mutex, which is not held while anything is made.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use super::bricks::BrickFile;
use super::tree::{Place, Shape};

/// Names something made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Key {
    Scene,
    Shape(Place),
    Octree(Place),
    Bricks(Place, u8),
    Payload(Place, u8, u32),
}

/// Something made.
#[derive(Clone, Debug)]
pub(super) enum Made {
    Bytes(Arc<Vec<u8>>),
    Shape(Arc<Shape>),
    Bricks(Arc<BrickFile>),
}

impl Made {
    fn bytes(&self) -> usize {
        match self {
            Self::Bytes(bytes) => bytes.len(),
            Self::Shape(shape) => shape.bytes(),
            Self::Bricks(file) => file.bytes(),
        }
    }
}

/// The cache.
#[derive(Debug, Default)]
pub(super) struct Cache {
    entries: HashMap<Key, (u64, Made)>,
    /// Keys by their last use.
    order: BTreeMap<u64, Key>,
    clock: u64,
    bytes: usize,
}

impl Cache {
    pub(super) fn get(&mut self, key: Key) -> Option<Made> {
        let (stamp, made) = self.entries.get_mut(&key)?;
        self.order.remove(stamp);
        self.clock += 1;
        *stamp = self.clock;
        self.order.insert(self.clock, key);
        Some(made.clone())
    }

    /// Keeps something, and drops older things until all fit the limit; the newest stays in any case.
    pub(super) fn put(&mut self, key: Key, made: Made, limit: usize) {
        self.take(key);
        self.clock += 1;
        self.bytes += made.bytes();
        self.entries.insert(key, (self.clock, made));
        self.order.insert(self.clock, key);
        while self.bytes > limit && self.entries.len() > 1 {
            let Some((_, oldest)) = self.order.first_key_value().map(|(k, v)| (*k, *v)) else {
                break;
            };
            self.take(oldest);
        }
    }

    fn take(&mut self, key: Key) {
        if let Some((stamp, made)) = self.entries.remove(&key) {
            self.order.remove(&stamp);
            self.bytes -= made.bytes();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_leaves_first() {
        let key = |k| {
            Key::Payload(
                Place {
                    height: 0,
                    column: [0, 0],
                },
                0,
                k,
            )
        };
        let bytes = |n: usize| Made::Bytes(Arc::new(vec![0; n]));
        let mut cache = Cache::default();
        for k in 0..4 {
            cache.put(key(k), bytes(10), 40);
        }
        assert!(cache.get(key(0)).is_some());
        cache.put(key(4), bytes(15), 40);
        let there: Vec<u32> = (0..5).filter(|k| cache.entries.contains_key(&key(*k))).collect();
        assert_eq!((there, cache.bytes), (vec![0, 3, 4], 35));
        cache.put(key(4), bytes(50), 40);
        assert_eq!((cache.entries.len(), cache.order.len(), cache.bytes), (1, 1, 50));
    }
}
