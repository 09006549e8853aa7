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

/// Objects in memory, with faults and a record of the reads. Shared by reference between the test and the loaders.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: Mutex<State>,
    cleared: Condvar,
}

#[derive(Debug, Default)]
struct State {
    objects: HashMap<String, Arc<Vec<u8>>>,
    faults: HashMap<String, Vec<Fault>>,
    reads: Vec<ReadRecord>,
}

impl State {
    fn faults(&self, name: &str) -> Vec<Fault> {
        self.faults.get(name).cloned().unwrap_or_default()
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
        while state.faults(name).contains(&Fault::Hang) {
            state = self.cleared.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        let (faults, object) = (state.faults(name), state.object(name));
        drop(state);
        let object = object?;
        let end = offset
            .checked_add(len as u64)
            .filter(|end| *end <= object.len() as u64);
        let end = end.ok_or_else(|| ends_early(offset, len, object.len() as u64))?;
        let mut bytes = object[offset as usize..end as usize].to_vec();
        for fault in faults {
            match fault {
                Fault::Error(kind) => return Err(kind.into()),
                Fault::Short => bytes.truncate(len / 2),
                Fault::Delay(time) => std::thread::sleep(time),
                Fault::FlipBit(bit) => {
                    let place = (bit / 8)
                        .checked_sub(offset)
                        .and_then(|at| bytes.get_mut(at as usize));
                    if let Some(byte) = place {
                        *byte ^= 1 << (bit % 8);
                    }
                }
                Fault::Hang => {}
            }
        }
        Ok(bytes)
    }

    fn describe(&self, name: &str) -> String {
        format!("memory:{name}")
    }
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
}
