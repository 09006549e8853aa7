//! Files that are damaged, missing, slow, or change while they are read.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use brickfell_culler::TreeId;

use crate::testing::{Flight, chunk, config, level, objects, pager, root, store};
use crate::{Fault, FolderStore, MemoryStore, PageKey, Pager, Store};

const PLENTY: u64 = 1 << 30;

fn all(tree: u32, l: u8) -> Vec<(PageKey, f64)> {
    (0..1 << (2 * (l - 1)))
        .map(|k| (chunk(tree, l, k), f64::from(k)))
        .collect()
}

#[test]
fn a_corrupt_chunk_is_given_up_with_one_message_and_the_others_load() {
    let store = store(&[3]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    flight.settle(&[(level(0, 3), 0.0)]);
    let bricks = flight
        .pager
        .tree(TreeId(0))
        .unwrap()
        .level(3)
        .unwrap()
        .bricks
        .clone()
        .unwrap();
    let offset = bricks.chunks[5].offset;
    store.inject("0.L03.brk", Fault::FlipBit(offset * 8 + 11));
    store.take_reads();
    flight.settle(&all(0, 3));
    let faults = flight.pager.drain_faults();
    assert_eq!(faults.len(), 1);
    assert_eq!(faults[0].key, chunk(0, 3, 5));
    let expected = format!("memory:0.L03.brk: byte {offset}: checksum of chunk 5 does not match");
    assert!(faults[0].message.starts_with(&expected), "{}", faults[0]);
    let attempts = |reads: Vec<crate::store::ReadRecord>| reads.iter().filter(|r| r.offset == offset).count();
    assert_eq!(attempts(store.take_reads()), 3);
    for (key, _) in all(0, 3) {
        assert_eq!(flight.has(key), key != chunk(0, 3, 5));
        assert_eq!(flight.pager.is_failed(key), key == chunk(0, 3, 5));
    }
    for _ in 0..5 {
        flight.settle(&all(0, 3));
    }
    assert_eq!(attempts(store.take_reads()), 0);
    assert!(flight.pager.drain_faults().is_empty());
    assert_eq!(flight.pager.stats().failed, 1);
}

#[test]
fn a_fault_that_passes_is_retried_after_the_delay() {
    let store = store(&[2]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    for fault in [Fault::Error(io::ErrorKind::TimedOut), Fault::Short] {
        store.inject("0.oct", fault);
    }
    flight.until(&[(root(0), 0.0)], |p| {
        p.stats().bytes_read == 0 && p.stats().queued + p.stats().loading == 0
    });
    store.clear_faults("0.oct");
    flight.settle(&[(root(0), 0.0)]);
    assert!(flight.has(root(0)) && flight.pager.drain_faults().is_empty());
}

#[test]
fn damaged_and_missing_files_name_the_path_and_leave_the_other_trees() {
    let swap = |store: &MemoryStore, name: &str, from: &str| {
        store.put(
            name,
            store.read(from, 0, store.len(from).unwrap() as usize).unwrap(),
        );
    };
    type Damage = fn(&MemoryStore, &dyn Fn(&MemoryStore, &str, &str));
    let cases: [(&str, Damage, &str); 9] = [
        ("0.oct", |s, _| s.remove("0.oct"), "cannot be opened"),
        (
            "0.oct",
            |s, _| s.truncate("0.oct", 150),
            "the file ends inside level",
        ),
        ("0.oct", |s, _| s.inject("0.oct", Fault::FlipBit(160)), "checksum"),
        ("0.oct", |s, _| s.put("0.oct", b"<Octree>".to_vec()), "line"),
        ("0.oct", |s, _| s.put("0.oct", Vec::new()), "0.oct"),
        ("0.L00.brk", |s, _| s.remove("0.L00.brk"), "cannot be opened"),
        (
            "0.L02.brk",
            |s, swap| swap(s, "0.L02.brk", "0.L01.brk"),
            "it is of level 1, not of level 2",
        ),
        (
            "0.L02.brk",
            |s, swap| swap(s, "0.L02.brk", "2.L02.brk"),
            "bricks, the octree refers to",
        ),
        ("0.L02.brk", |s, _| s.truncate("0.L02.brk", 40), "0.L02.brk"),
    ];
    for (file, damage, reason) in cases {
        let store = store(&[2, 2]);
        let tree = brickfell_formats::octree::Octree {
            ..crate::testing::octree(2)
        };
        let mut writer = brickfell_formats::bricks::BrickFileWriter::new(
            2,
            tree.header.layout,
            1,
            brickfell_formats::chunk::Encoding::Plain,
        );
        writer.push(glam::UVec3::ZERO, 1, &[]).unwrap();
        let (directory, header) = writer.finish();
        store.put("2.L02.brk", [header.to_vec(), directory].concat());
        damage(&store, &swap);
        let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 2)));
        let mut wants = all(0, 2);
        wants.extend(all(1, 2));
        flight.settle(&wants);
        let faults = flight.pager.drain_faults();
        assert_eq!(faults.len(), 1, "{reason}: {faults:?}");
        let message = &faults[0].message;
        assert!(message.starts_with(&format!("memory:{file}: ")), "{message}");
        assert!(message.contains(reason) && !message.contains('\n'), "{message}");
        assert!(all(1, 2).iter().all(|(key, _)| flight.has(*key)));
        assert!(
            all(0, 2)
                .iter()
                .all(|(key, _)| !flight.has(*key) && flight.pager.is_failed(*key))
        );
        assert_eq!(
            flight.pager.stats().held,
            0,
            "nothing waits for what was given up"
        );
    }
}

#[test]
fn a_file_truncated_or_replaced_while_running_is_a_fault() {
    let dir = tempfile::tempdir().unwrap();
    for k in 0..2u8 {
        for (name, bytes) in objects(&format!("{k}.oct"), 3, k) {
            std::fs::write(dir.path().join(name), bytes).unwrap();
        }
    }
    let store = Arc::new(FolderStore::open(dir.path()).unwrap());
    let mut flight = Flight::new(Pager::new(
        store,
        vec!["0.oct".into(), "1.oct".into()],
        config(PLENTY, 2),
    ));
    flight.settle(&[(chunk(0, 3, 0), 0.0), (level(0, 3), 0.0), (chunk(1, 3, 0), 0.0)]);
    flight.settle(&[(chunk(0, 3, 0), 0.0), (chunk(1, 3, 0), 0.0)]);
    let cut = std::fs::File::options()
        .write(true)
        .open(dir.path().join("0.L03.brk"))
        .unwrap();
    cut.set_len(65).unwrap();
    let other = std::fs::read(dir.path().join("0.L02.brk")).unwrap();
    std::fs::write(dir.path().join("1.L03.brk"), other).unwrap();
    let wants = [
        (chunk(0, 3, 0), 0.0),
        (chunk(0, 3, 7), 0.0),
        (chunk(0, 2, 1), 0.0),
        (chunk(1, 3, 6), 0.0),
    ];
    flight.settle(&wants);
    assert!(
        flight.has(wants[0].0) && flight.has(wants[2].0),
        "what is there stays, other files go on"
    );
    let faults = flight.pager.drain_faults();
    assert_eq!(faults.len(), 2, "{faults:?}");
    for (tree, file) in [(0, "0.L03.brk"), (1, "1.L03.brk")] {
        let fault = faults.iter().find(|f| f.key.tree() == TreeId(tree)).unwrap();
        assert!(
            fault
                .message
                .contains(&dir.path().join(file).display().to_string()),
            "{fault}"
        );
    }
}

#[test]
fn a_stalled_file_does_not_hold_up_the_others() {
    let store = store(&[3, 3]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 2)));
    flight.settle(&[(level(0, 3), 0.0), (level(1, 3), 0.0)]);
    store.inject("0.L03.brk", Fault::Hang);
    let mut wants: Vec<(PageKey, f64)> = all(0, 3).iter().map(|(k, p)| (*k, p - 1000.0)).collect();
    wants.extend(all(1, 3));
    flight.until(&wants, |p| {
        all(1, 3)
            .iter()
            .all(|(k, _)| p.chunk(k.tree(), 3, (*k).chunk_number()).is_some())
    });
    assert!(all(0, 3).iter().all(|(k, _)| !flight.has(*k)));
    store.clear_faults("0.L03.brk");
    flight.settle(&wants);
    assert!(wants.iter().all(|(k, _)| flight.has(*k)));
}

impl PageKey {
    fn chunk_number(self) -> u32 {
        match self {
            PageKey::Chunk { chunk, .. } => chunk,
            _ => 0,
        }
    }
}

/// A store that panics on one object.
struct Panics(Arc<MemoryStore>);

impl Store for Panics {
    fn len(&self, name: &str) -> io::Result<u64> {
        assert!(name != "0.oct");
        self.0.len(name)
    }

    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        self.0.read(name, offset, len)
    }

    fn describe(&self, name: &str) -> String {
        self.0.describe(name)
    }
}

#[test]
fn a_store_that_panics_fails_the_page_and_not_the_loader() {
    let store = Arc::new(Panics(store(&[1, 2])));
    let mut flight = Flight::new(Pager::new(
        store,
        vec!["0.oct".into(), "1.oct".into()],
        config(PLENTY, 1),
    ));
    flight.settle(&[(root(0), 0.0), (chunk(1, 2, 3), 0.0)]);
    assert!(flight.pager.is_failed(root(0)) && flight.has(chunk(1, 2, 3)));
    assert_eq!(flight.pager.drain_faults().len(), 1);
}

#[test]
fn slow_reads_are_waited_for_only_by_who_asks_for_it() {
    let store = store(&[1]);
    store.inject("0.oct", Fault::Delay(Duration::from_millis(60)));
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 1)));
    flight.frame(&[(root(0), 0.0)]);
    assert!(!flight.pager.wait_for_progress(Duration::from_millis(5)));
    assert!(!flight.pager.is_idle() && !flight.has(root(0)));
    flight.settle(&[(root(0), 0.0)]);
    assert!(flight.has(root(0)));
}

#[test]
fn reads_that_are_late_and_come_in_any_order_give_the_same_tree() {
    let wants: Vec<(PageKey, f64)> = all(0, 3).into_iter().chain(all(1, 3)).collect();
    let flown = |slow: bool| {
        let store = store(&[3, 3]);
        if slow {
            store.inject_everywhere(Fault::Overtaken(Duration::from_millis(3)));
            store.inject("0.L02.brk", Fault::Delay(Duration::from_millis(2)));
        }
        let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 3)));
        flight.settle(&wants);
        flight.settle(&wants);
        assert!(flight.pager.drain_faults().is_empty());
        let chunk = |key: &PageKey| match *key {
            PageKey::Chunk { tree, level, chunk } => flight.pager.chunk(tree, level, chunk).cloned(),
            _ => None,
        };
        wants.iter().map(|(key, _)| chunk(key)).collect::<Vec<_>>()
    };
    assert_eq!(flown(true), flown(false));
}
