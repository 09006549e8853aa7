//! What is loaded, and when it becomes visible.

use std::sync::Arc;

use brickfell_culler::TreeId;
use glam::UVec3;

use crate::testing::{Flight, chunk, color, config, level, objects, octree, pager, root, store};
use crate::{Fault, MemoryStore, PageKey, Pager, Stop};

const PLENTY: u64 = 1 << 30;

fn chunks(tree: u32, l: u8, range: std::ops::Range<u32>) -> Vec<(PageKey, f64)> {
    range.map(|k| (chunk(tree, l, k), f64::from(k))).collect()
}

#[test]
fn a_tree_comes_back_as_it_was_written() {
    let store = store(&[4]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    let mut wants = Vec::new();
    for l in 0..=4u8 {
        wants.extend(chunks(0, l, 0..1 << (2 * l.saturating_sub(1))));
    }
    flight.settle(&wants);
    let state = flight.pager.tree(TreeId(0)).unwrap().clone();
    let tree = octree(4);
    assert_eq!(state.root.header, tree.header);
    for (l, nodes) in tree.levels.iter().enumerate() {
        assert_eq!(&state.level(l as u8).unwrap().nodes, nodes);
    }
    for (key, _) in &wants {
        let PageKey::Chunk { tree, level, chunk } = *key else {
            unreachable!()
        };
        let samples = flight.pager.chunk(tree, level, chunk).unwrap().samples().unwrap();
        assert!(samples.color.iter().all(|c| *c == color(0, level, chunk)));
    }
    assert!(flight.pager.chunk(TreeId(0), 4, 64).is_none());
    assert_eq!(
        flight.pager.stats().loads,
        1 + 4 + wants.len() as u64 - 1,
        "the root brings its chunk"
    );
    assert!(flight.pager.drain_faults().is_empty());

    for p in [
        UVec3::new(0, 0, 0),
        UVec3::new(15, 3, 0),
        UVec3::new(5, 10, 7),
        UVec3::new(9, 9, 15),
    ] {
        let found = state.find(4, p);
        let (l, index) = found.deepest().unwrap();
        assert_eq!(tree.positions(l)[index as usize], p >> u32::from(4 - l), "{p}");
        assert_eq!(found.stop, if p.z == 0 { Stop::Reached } else { Stop::Terminal });
        assert_eq!(found.path().count(), usize::from(l) + 1);
    }
    assert_eq!(state.find(4, UVec3::new(16, 0, 0)).stop, Stop::Outside);
    assert_eq!(state.find(200, UVec3::ZERO).stop, Stop::Outside);
}

#[test]
fn a_look_up_says_which_level_is_not_there() {
    let store = store(&[4]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    flight.settle(&[(level(0, 2), 0.0)]);
    let state = flight.pager.tree(TreeId(0)).unwrap();
    let found = state.find(4, UVec3::new(3, 2, 0));
    assert_eq!((found.stop, found.deepest().unwrap().0), (Stop::NotResident, 2));
}

#[test]
fn an_xml_octree_is_loaded_as_a_whole() {
    let store = Arc::new(MemoryStore::new());
    for (name, bytes) in objects("hand.xml", 3, 7) {
        store.put(&name, bytes);
    }
    let mut flight = Flight::new(Pager::new(store, vec!["hand.xml".into()], config(PLENTY, 2)));
    assert_eq!(flight.settle(&[(level(0, 3), 0.0)]), [root(0)]);
    let state = flight.pager.tree(TreeId(0)).unwrap();
    assert!(state.root.index.is_none());
    assert_eq!(state.find(3, UVec3::new(7, 7, 0)).stop, Stop::Reached);
    assert_eq!(flight.settle(&[(chunk(0, 3, 5), 0.0)]), [chunk(0, 3, 5)]);
    assert_eq!(
        flight
            .pager
            .chunk(TreeId(0), 3, 5)
            .unwrap()
            .samples()
            .unwrap()
            .color[0],
        color(7, 3, 5)
    );
}

#[test]
fn parents_are_published_before_children() {
    let store = store(&[4]);
    store.inject("0.L01.brk", Fault::Hang);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 4)));
    let wants = [(level(0, 4), 1.0)];
    flight.until(&wants, |p| p.stats().held == 3);
    for _ in 0..5 {
        flight.frame(&wants);
        let state = flight.pager.tree(TreeId(0)).unwrap();
        assert!(
            state.levels[1..].iter().all(Option::is_none),
            "a child before its parent"
        );
    }
    store.clear_faults("0.L01.brk");
    assert_eq!(
        flight.settle(&wants),
        [level(0, 1), level(0, 2), level(0, 3), level(0, 4)]
    );
}

#[test]
fn a_snapshot_does_not_change_and_a_frame_merges_once() {
    let store = store(&[3]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    flight.settle(&[(root(0), 0.0)]);
    let before = flight.pager.tree(TreeId(0)).unwrap().clone();
    flight.settle(&[(level(0, 1), 0.0)]);
    assert!(before.level(1).is_none());
    assert!(flight.pager.tree(TreeId(0)).unwrap().level(1).is_some());

    flight.frame(&[(level(0, 2), 0.0)]);
    assert!(flight.pager.wait_for_progress(std::time::Duration::from_secs(20)));
    let frame = flight.frame;
    assert!(
        flight.pager.merge(frame).is_empty(),
        "the frame has begun already"
    );
    assert_eq!(flight.pager.merge(frame + 1), [level(0, 2)]);
    assert_eq!(flight.pager.merge(frame + 1), [level(0, 2)]);
}

#[test]
fn a_stale_request_leaves_the_queue_and_can_be_asked_again() {
    let store = store(&[3, 3]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 1)));
    flight.settle(&[(level(0, 3), 0.0), (level(1, 3), 0.0)]);
    store.inject("0.L03.brk", Fault::Hang);
    flight.until(&[(chunk(0, 3, 0), 0.0)], |p| p.stats().loading == 1);
    flight.frame(&[(chunk(0, 3, 0), 0.0), (chunk(1, 3, 4), 1.0)]);
    assert_eq!(flight.pager.stats().queued, 1);
    flight.frame(&[(chunk(0, 3, 0), 0.0)]);
    let stats = flight.pager.stats();
    assert_eq!((stats.queued, stats.cancelled), (0, 1));
    store.take_reads();
    store.clear_faults("0.L03.brk");
    flight.settle(&[(chunk(0, 3, 0), 0.0)]);
    assert!(store.take_reads().is_empty(), "what was cancelled is not read");
    assert!(!flight.has(chunk(1, 3, 4)));
    let published = flight.settle(&[(chunk(1, 3, 4), 1.0)]);
    assert_eq!(published, [chunk(1, 3, 4)]);
    assert_eq!(store.take_reads().len(), 1);
}

#[test]
fn after_a_teleport_the_first_loads_belong_to_the_new_view() {
    let store = store(&[5, 5, 1]);
    let mut flight = Flight::new(pager(&store, 3, config(PLENTY, 1)));
    flight.settle(&[(level(0, 5), 0.0), (level(1, 5), 0.0), (level(2, 1), 0.0)]);
    store.inject("2.L01.brk", Fault::Hang);
    let held = (chunk(2, 1, 0), 0.0);
    flight.until(&[held], |p| p.stats().loading == 1);
    let mut wants = chunks(0, 5, 0..200);
    wants.push(held);
    flight.frame(&wants);
    assert_eq!(flight.pager.stats().queued, 200);
    // Half of the old view is still wanted, but far away now.
    let mut wants: Vec<(PageKey, f64)> = chunks(0, 5, 0..100)
        .iter()
        .map(|(k, p)| (*k, p + 1000.0))
        .collect();
    wants.extend(chunks(1, 5, 0..20).iter().map(|(k, p)| (*k, 500.0 - p)));
    flight.frame(&wants);
    assert_eq!(flight.pager.stats().cancelled, 100);
    store.take_reads();
    store.clear_faults("2.L01.brk");
    flight.settle(&wants);
    let reads = store.take_reads();
    assert_eq!(reads.len(), 120);
    assert!(
        reads[..20].iter().all(|r| r.name == "1.L05.brk"),
        "{:?}",
        &reads[..20]
    );
    assert!(
        reads[..20].windows(2).all(|w| w[0].offset > w[1].offset),
        "the most urgent first"
    );
}

#[test]
fn requests_for_pages_that_do_not_exist_are_ignored() {
    let store = store(&[2]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 1)));
    let nonsense = [
        (root(5), 0.0),
        (level(0, 3), 0.0),
        (level(0, 255), f64::NAN),
        (chunk(0, 2, 4), -1.0),
        (chunk(0, 0, 9), 0.0),
        (chunk(9, 9, 9), 0.0),
    ];
    flight.settle(&nonsense);
    flight.settle(&[(chunk(0, 2, 4), 0.0)]);
    for (key, _) in nonsense {
        flight.pager.touch(key);
        assert!(!flight.pager.is_failed(key));
    }
    flight.pager.release_tree(TreeId(7));
    assert!(flight.pager.chunk(TreeId(0), 0, 9).is_none() && flight.pager.tree(TreeId(5)).is_none());
    assert!(flight.pager.drain_faults().is_empty());
    assert_eq!(flight.pager.stats().loads, 3, "the root and two levels");
}
