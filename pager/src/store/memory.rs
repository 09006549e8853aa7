//! Objects in memory that can be made to fail, so that every fault of a disk can be had on demand.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::{Store, ends_early};

/// What goes wrong when an object is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Every read and length is an error of this kind.
    Error(io::ErrorKind),
    /// Reads give only the first half of what was asked for.
    Short,
    /// Reads take at least this long.
    Delay(Duration),
    /// A read returns only after one that began later has returned, or after this long if there is none: reads come back
    /// in another order than they were begun.
    Overtaken(Duration),
    /// Reads do not return before the faults of the object are cleared.
    Hang,
    /// The bit of this number in the object is inverted.
    FlipBit(u64),
}

/// One read that was begun.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadRecord {
    /// The object.
    pub name: String,
    /// First byte.
    pub offset: u64,
    /// Bytes asked for.
    pub len: usize,
}

/// Objects in memory, with faults and a record of the reads: for tests of whatever reads from a [`Store`], and for trying
/// out what a slow or broken disk does to a program. Shared by reference between who injects and the loaders.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: Mutex<State>,
    cleared: Condvar,
}

#[derive(Debug, Default)]
struct State {
    objects: HashMap<String, Arc<Vec<u8>>>,
    faults: HashMap<String, Vec<Fault>>,
    /// Faults of all objects.
    everywhere: Vec<Fault>,
    reads: Vec<ReadRecord>,
    /// Reads begun so far, and the number of the latest one that has returned.
    begun: u64,
    returned: u64,
}

impl State {
    fn faults(&self, name: &str) -> Vec<Fault> {
        let own = self.faults.get(name).into_iter().flatten();
        own.chain(&self.everywhere).copied().collect()
    }

    fn object(&self, name: &str) -> io::Result<Arc<Vec<u8>>> {
        self.objects
            .get(name)
            .cloned()
            .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such object"))
    }
}

impl MemoryStore {
    /// An empty store.
    pub fn new() -> Self {
        Self::default()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts an object, in place of one of the same name.
    pub fn put(&self, name: &str, bytes: Vec<u8>) {
        self.lock().objects.insert(name.to_owned(), Arc::new(bytes));
    }

    /// Takes an object away.
    pub fn remove(&self, name: &str) {
        self.lock().objects.remove(name);
    }

    /// Cuts an object to a length.
    pub fn truncate(&self, name: &str, len: usize) {
        if let Some(object) = self.lock().objects.get_mut(name) {
            Arc::make_mut(object).truncate(len);
        }
    }

    /// Adds a fault to the later reads of an object.
    pub fn inject(&self, name: &str, fault: Fault) {
        self.lock().faults.entry(name.to_owned()).or_default().push(fault);
    }

    /// Adds a fault to the later reads of all objects.
    pub fn inject_everywhere(&self, fault: Fault) {
        self.lock().everywhere.push(fault);
    }

    /// Takes all faults away and lets hung reads go on.
    pub fn clear_all_faults(&self) {
        let mut state = self.lock();
        state.faults.clear();
        state.everywhere.clear();
        drop(state);
        self.cleared.notify_all();
    }

    /// Takes all faults of an object away and lets its hung reads go on.
    pub fn clear_faults(&self, name: &str) {
        self.lock().faults.remove(name);
        self.cleared.notify_all();
    }

    /// The reads begun since the last call, in order.
    pub fn take_reads(&self) -> Vec<ReadRecord> {
        std::mem::take(&mut self.lock().reads)
    }
}

impl Store for MemoryStore {
    fn len(&self, name: &str) -> io::Result<u64> {
        let state = self.lock();
        for fault in state.faults(name) {
            if let Fault::Error(kind) = fault {
                return Err(kind.into());
            }
        }
        Ok(state.object(name)?.len() as u64)
    }

    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let mut state = self.lock();
        state.reads.push(ReadRecord {
            name: name.to_owned(),
            offset,
            len,
        });
        state.begun += 1;
        let number = state.begun;
        while state.faults(name).contains(&Fault::Hang) {
            state = self.cleared.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        let (faults, object) = (state.faults(name), state.object(name));
        for fault in &faults {
            if let Fault::Overtaken(most) = fault {
                let waits = |state: &mut State| state.returned <= number;
                let waited = self.cleared.wait_timeout_while(state, *most, waits);
                state = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
        }
        drop(state);
        let bytes = object.and_then(|object| damaged(&object, &faults, offset, len));
        let mut state = self.lock();
        state.returned = state.returned.max(number);
        drop(state);
        self.cleared.notify_all();
        bytes
    }

    fn describe(&self, name: &str) -> String {
        format!("memory:{name}")
    }
}

/// A range of an object as a read with these faults gives it.
fn damaged(object: &[u8], faults: &[Fault], offset: u64, len: usize) -> io::Result<Vec<u8>> {
    let size = object.len() as u64;
    let end = offset.checked_add(len as u64).filter(|end| *end <= size);
    let end = end.ok_or_else(|| ends_early(offset, len, size))?;
    let mut bytes = object[offset as usize..end as usize].to_vec();
    for fault in faults {
        match fault {
            Fault::Error(kind) => return Err((*kind).into()),
            Fault::Short => bytes.truncate(len / 2),
            Fault::Delay(time) => std::thread::sleep(*time),
            Fault::FlipBit(bit) => {
                let place = (bit / 8)
                    .checked_sub(offset)
                    .and_then(|at| bytes.get_mut(at as usize));
                if let Some(byte) = place {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Fault::Hang | Fault::Overtaken(_) => {}
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_come_and_go() {
        let store = MemoryStore::new();
        store.put("a", vec![0; 8]);
        assert_eq!(store.read("a", 2, 4).unwrap(), [0; 4]);
        assert!(store.read("a", 6, 4).is_err());
        assert!(store.read("b", 0, 0).is_err());
        store.inject("a", Fault::FlipBit(17));
        assert_eq!(store.read("a", 1, 3).unwrap(), [0, 2, 0]);
        assert_eq!(store.read("a", 3, 3).unwrap(), [0; 3]);
        store.inject("a", Fault::Short);
        assert_eq!(store.read("a", 0, 8).unwrap().len(), 4);
        store.inject("a", Fault::Error(io::ErrorKind::PermissionDenied));
        assert!(store.len("a").is_err());
        store.clear_faults("a");
        assert_eq!(store.read("a", 0, 8).unwrap(), [0; 8]);
        assert_eq!(store.take_reads().len(), 7);
    }

    #[test]
    fn a_read_that_is_overtaken_returns_second() {
        let store = MemoryStore::new();
        store.put("a", vec![1]);
        store.put("b", vec![2]);
        store.inject("a", Fault::Overtaken(Duration::from_secs(20)));
        let order = Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            scope.spawn(|| {
                store.read("a", 0, 1).unwrap();
                order.lock().unwrap().push("a");
            });
            while store.lock().begun == 0 {
                std::thread::yield_now();
            }
            let b = store.read("b", 0, 1).unwrap();
            assert_eq!(b, [2]);
        });
        // It returned at all: nobody waited twenty seconds for nothing.
        assert_eq!(
            (order.into_inner().unwrap(), store.lock().returned),
            (vec!["a"], 2)
        );
    }

    #[test]
    fn faults_everywhere_meet_every_object() {
        let store = MemoryStore::new();
        store.put("a", vec![0; 2]);
        store.put("b", vec![0; 2]);
        store.inject_everywhere(Fault::Error(io::ErrorKind::TimedOut));
        assert!(store.read("a", 0, 1).is_err() && store.len("b").is_err());
        store.clear_all_faults();
        assert!(store.read("a", 0, 1).is_ok() && store.len("b").is_ok());
    }
}
