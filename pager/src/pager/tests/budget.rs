//! The byte budget: never exceeded, least recently used out first, nothing moves at rest.

use std::sync::Arc;

use brickfell_culler::TreeId;
use brickfell_formats::octree::Node;
use proptest::prelude::*;

use crate::testing::{Flight, chunk, config, level, objects_of, octree, pager, root, store};
use crate::{Fault, MemoryStore, PageKey};

fn chunks(tree: u32, l: u8, range: std::ops::Range<u32>) -> Vec<(PageKey, f64)> {
    range.map(|k| (chunk(tree, l, k), f64::from(k))).collect()
}

/// Bytes of the root and all levels of a tree, and of one chunk of its deepest level.
fn sizes(depth: u8) -> (u64, u64) {
    let store = store(&[depth]);
    let mut flight = Flight::new(pager(&store, 1, config(1 << 30, 2)));
    flight.settle(&[(level(0, depth), 0.0)]);
    let levels = flight.pager.stats().resident_bytes;
    flight.settle(&[(chunk(0, depth, 0), 0.0)]);
    (levels, flight.pager.stats().resident_bytes - levels)
}

/// A budget that leaves so many bytes beside the reserve for roots.
fn beside_the_reserve(bytes: u64) -> u64 {
    bytes + bytes / 15 + 1
}

#[test]
fn a_second_look_back_loads_nothing_and_rest_is_rest() {
    let (levels, bytes) = sizes(4);
    let store = store(&[4]);
    let mut flight = Flight::new(pager(&store, 1, config(levels + bytes * 50, 2)));
    let (front, back) = (chunks(0, 4, 0..20), chunks(0, 4, 20..40));
    flight.settle(&front);
    flight.settle(&back);
    let loads = flight.pager.stats().loads;
    for view in [&front, &back, &front] {
        flight.settle(view);
    }
    let stats = flight.pager.stats();
    assert_eq!((stats.loads, stats.evicted), (loads, 0));
    assert!(flight.pager.over_budget() < 0.5);
}

#[test]
fn when_the_view_does_not_fit_the_nearest_is_served_and_nothing_moves() {
    let (levels, bytes) = sizes(4);
    let store = store(&[4]);
    let budget = levels + bytes * 20;
    let mut flight = Flight::new(pager(&store, 1, config(budget, 2)));
    let all = chunks(0, 4, 0..64);
    flight.settle(&all);
    let rest = flight.pager.stats();
    assert!(rest.deferred > 40 && rest.peak_bytes <= budget, "{rest:?}");
    assert!(flight.pager.over_budget() > 2.0);
    flight.pager.merge(u64::MAX);
    assert!(flight.pager.over_budget() > 2.0, "as of the last submit");
    let there: Vec<bool> = all.iter().map(|(key, _)| flight.has(*key)).collect();
    assert!(
        there[..15].iter().all(|there| *there),
        "the nearest are there: {there:?}"
    );
    for _ in 0..50 {
        assert!(flight.frame(&all).is_empty());
    }
    let later = flight.pager.stats();
    assert_eq!(
        (later.loads, later.evicted, later.bytes_read),
        (rest.loads, rest.evicted, rest.bytes_read)
    );
    // A smaller demand is served as a whole, whatever it needs to push out.
    flight.settle(&chunks(0, 4, 50..64));
    assert!((50..64).all(|k| flight.has(chunk(0, 4, k))));
    assert_eq!(flight.pager.stats().deferred, 0);
    assert!(flight.pager.over_budget() < 1.0);
}

#[test]
fn a_level_is_not_loaded_when_its_parent_has_no_room() {
    // Level 5 is large, level 6 is one tile.
    let mut tree = octree(6);
    for node in &mut tree.levels[5][1..] {
        *node = Node::new(None, node.data());
    }
    tree.levels[6].truncate(8);
    let store = Arc::new(MemoryStore::new());
    for (name, bytes) in objects_of(&tree, "0.oct", 0) {
        store.put(&name, bytes);
    }
    let wants = [(level(0, 6), 0.0)];
    let mut flight = Flight::new(pager(&store, 1, config(1 << 30, 1)));
    flight.settle(&[(level(0, 4), 0.0)]);
    let coarse = flight.pager.stats().resident_bytes;
    flight.settle(&wants);
    let mut flight = Flight::new(pager(&store, 1, config(beside_the_reserve(coarse + 6000), 1)));
    flight.settle(&wants);
    let (stats, status) = (flight.pager.stats(), flight.pager.loaders.loads.status());
    assert!(flight.has(level(0, 4)) && !flight.has(level(0, 5)));
    assert_eq!(
        (stats.deferred, stats.held),
        (2, 0),
        "level 6 would wait for a parent that does not come"
    );
    assert_eq!(status.committed, stats.resident_bytes);
}

#[test]
fn a_page_in_use_is_never_evicted() {
    let (levels, bytes) = sizes(4);
    let store = store(&[4]);
    let mut flight = Flight::new(pager(&store, 1, config(levels + bytes * 12, 2)));
    flight.settle(&chunks(0, 4, 0..4));
    for k in 4..64 {
        for _ in 0..3 {
            flight.frame += 1;
            flight.pager.merge(flight.frame);
            for used in 0..4 {
                flight.pager.touch(chunk(0, 4, used));
            }
            flight.pager.request(chunk(0, 4, k), 0.0);
            flight.pager.submit();
            flight.pager.wait_for_progress(std::time::Duration::from_secs(20));
        }
        assert!((0..4).all(|used| flight.has(chunk(0, 4, used))), "{k}");
    }
    assert!(flight.pager.stats().evicted > 30);
}

#[test]
fn a_released_tree_makes_room_and_comes_back() {
    let (levels, bytes) = sizes(4);
    let store = store(&[4, 4]);
    // One tree and eight chunks, and not the root of another.
    let budget = beside_the_reserve(levels + bytes * 8 + 2000);
    let mut flight = Flight::new(pager(&store, 2, config(budget, 2)));
    flight.settle(&chunks(0, 4, 0..6));
    let first = flight.pager.stats().resident_bytes;
    flight.settle(&chunks(1, 4, 0..8));
    assert!(flight.has(root(0)), "in use, though not looked at");
    assert!((0..6).all(|k| !flight.has(chunk(0, 4, k))));
    assert_eq!(
        flight.pager.stats().deferred,
        1,
        "the pinned root takes the room of a chunk"
    );
    flight.pager.release_tree(TreeId(0));
    flight.settle(&chunks(1, 4, 0..8));
    assert!(!flight.has(root(0)) && (0..8).all(|k| flight.has(chunk(1, 4, k))));
    flight.pager.release_tree(TreeId(1));
    flight.settle(&chunks(0, 4, 0..6));
    assert!((0..6).all(|k| flight.has(chunk(0, 4, k))));
    assert!(flight.pager.stats().resident_bytes >= first);
    assert!(flight.pager.drain_faults().is_empty());
}

#[test]
fn a_result_whose_parent_was_evicted_is_dropped_and_its_bytes_come_back() {
    let (levels, bytes) = sizes(4);
    let store = store(&[4, 4]);
    let budget = beside_the_reserve(levels * 3 / 2 + bytes * 8);
    let mut flight = Flight::new(pager(&store, 2, config(budget, 3)));
    flight.settle(&[(level(0, 4), 0.0)]);
    store.inject("0.L04.brk", Fault::Hang);
    flight.until(&[(chunk(0, 4, 3), 0.0)], |p| p.stats().loading == 1);
    flight.pager.release_tree(TreeId(0));
    flight.until(&chunks(1, 4, 0..7), |p| {
        p.tree(TreeId(0)).is_none_or(|t| t.level(4).is_none())
    });
    flight.until(&chunks(1, 4, 0..7), |p| {
        (0..7).all(|k| p.chunk(TreeId(1), 4, k).is_some())
    });
    let loads = flight.pager.stats().loads;
    store.clear_faults("0.L04.brk");
    flight.settle(&chunks(1, 4, 0..7));
    flight.until(&chunks(1, 4, 0..7), |p| {
        p.loaders.loads.status().leaving_bytes == 0
    });
    let (stats, status) = (flight.pager.stats(), flight.pager.loaders.loads.status());
    assert!(!flight.has(chunk(0, 4, 3)) && stats.loads == loads);
    assert_eq!(
        status.committed, stats.resident_bytes,
        "bytes of the dropped page are still counted"
    );
    // It can be had again.
    flight.settle(&[(chunk(0, 4, 3), 0.0)]);
    flight.settle(&[(chunk(0, 4, 3), 0.0)]);
    assert!(flight.has(chunk(0, 4, 3)));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Random views over three trees: the budget holds, parents stay, what stays was used later than what went.
    #[test]
    fn behaves_like_a_least_recently_used_list(
        views in proptest::collection::vec(proptest::collection::vec((0u32..3, 0u32..16), 1..8), 1..40),
        room in 10u64..30,
        threads in 1usize..4,
    ) {
        let (levels, bytes) = sizes(3);
        let budget = levels * 3 + bytes * room;
        let store = store(&[3, 3, 3]);
        let mut flight = Flight::new(pager(&store, 3, config(budget, threads)));
        let keep = [(level(0, 3), 0.0), (level(1, 3), 0.0), (level(2, 3), 0.0)];
        flight.settle(&keep);
        let mut used = std::collections::BTreeMap::new();
        for (step, view) in views.iter().enumerate() {
            let mut wants: Vec<(PageKey, f64)> = view.iter().map(|(t, k)| (chunk(*t, 3, *k), f64::from(*k))).collect();
            wants.extend(keep);
            flight.settle(&wants);
            for (key, _) in &wants[..view.len()] {
                used.insert(*key, step);
                prop_assert!(flight.has(*key));
            }
            let oldest_kept = used.iter().filter(|(k, _)| flight.has(**k)).map(|(_, s)| *s).min();
            let newest_gone = used.iter().filter(|(k, _)| !flight.has(**k)).map(|(_, s)| *s).max();
            if let (Some(kept), Some(gone)) = (oldest_kept, newest_gone) {
                prop_assert!(kept >= gone, "kept one of step {kept}, evicted one of step {gone}");
            }
            let stats = flight.pager.stats();
            prop_assert!(stats.peak_bytes <= budget, "{stats:?}");
            prop_assert!(stats.resident_bytes + bytes * 9 >= budget || stats.evicted == 0, "evicted too much: {stats:?}");
        }
    }

    /// Random requests that often do not fit, trees taken and released: bytes add up, the resident set is closed.
    #[test]
    fn any_flight_keeps_the_books(
        steps in proptest::collection::vec((0u32..3, 0u8..5, 0u32..64, 0u8..8), 1..200),
        share in 1u64..40,
    ) {
        let (levels, bytes) = sizes(4);
        let store = store(&[4, 4, 4]);
        let budget = levels / 2 + bytes * share;
        let mut flight = Flight::new(pager(&store, 3, config(budget, 2)));
        for (k, (tree, l, number, act)) in steps.iter().enumerate() {
            let key = if *act == 0 { level(*tree, *l) } else { chunk(*tree, *l, number % (1 << (2 * l.saturating_sub(1)))) };
            match act {
                7 => flight.pager.release_tree(TreeId(*tree)),
                1 => drop(flight.settle(&[(key, 0.0)])),
                _ => drop(flight.frame(&[(key, f64::from(*number)), (root((tree + 1) % 3), 9.0)])),
            }
            if k % 16 == 0 {
                flight.settle(&[]);
            }
            let stats = flight.pager.stats();
            prop_assert!(stats.peak_bytes <= budget, "{stats:?} of {budget}");
            for t in 0..3 {
                let Some(state) = flight.pager.tree(TreeId(t)) else {
                    prop_assert!((0..5).all(|l| (0..64).all(|k| !flight.has(chunk(t, l, k)))));
                    continue;
                };
                let there = state.levels.iter().take_while(|l| l.is_some()).count();
                prop_assert!(state.levels.iter().skip(there).all(Option::is_none), "a level without its parent");
                for l in there as u8..5 {
                    prop_assert!((0..64).all(|k| !flight.has(chunk(t, l, k))), "a chunk without its level");
                }
            }
        }
        for t in 0..3 {
            flight.pager.release_tree(TreeId(t));
        }
        flight.settle(&[]);
        flight.until(&[], |p| p.loaders.loads.status().leaving_bytes == 0);
        prop_assert_eq!(flight.pager.loaders.loads.status().committed, flight.pager.stats().resident_bytes);
    }
}
