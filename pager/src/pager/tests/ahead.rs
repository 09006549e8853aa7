//! What is asked for before it is wanted, and levels asked for by footprint.

use brickfell_culler::TreeId;

use crate::testing::{Flight, chunk, config, level, pager, root, store};
use crate::{Fault, LoadedBytes, PageKey};

const PLENTY: u64 = 1 << 30;

impl Flight {
    /// Frames with these requests, and others ahead of their use, until nothing moves.
    fn settle_ahead(&mut self, wants: &[(PageKey, f64)], ahead: &[(PageKey, f64)]) {
        for _ in 0..1000 {
            self.frame += 1;
            self.pager.merge(self.frame);
            for (key, priority) in wants {
                self.pager.request(*key, *priority);
            }
            for (key, priority) in ahead {
                self.pager.prefetch(*key, *priority);
            }
            self.pager.submit();
            if self.pager.is_idle() {
                return;
            }
            self.pager.wait_for_progress(std::time::Duration::from_secs(20));
        }
        panic!("never idle: {:?}", self.pager.stats());
    }
}

fn chunks(range: std::ops::Range<u32>) -> Vec<(PageKey, f64)> {
    range.map(|k| (chunk(0, 4, k), f64::from(k))).collect()
}

#[test]
fn what_is_wanted_now_is_read_first_whatever_the_priorities() {
    let store = store(&[4, 1]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 1)));
    flight.settle(&[(level(0, 4), 0.0), (level(1, 1), 0.0)]);
    store.inject("1.L01.brk", Fault::Hang);
    let held = (chunk(1, 1, 0), 0.0);
    flight.until(&[held], |p| p.stats().loading == 1);
    let mut wants = chunks(10..14);
    wants.push(held);
    flight.frame += 1;
    flight.pager.merge(flight.frame);
    chunks(0..5)
        .iter()
        .for_each(|(key, _)| flight.pager.prefetch(*key, -5.0));
    wants.iter().for_each(|(key, p)| flight.pager.request(*key, *p));
    // Wanted both ways: it is wanted now.
    flight.pager.request(chunk(0, 4, 4), 99.0);
    flight.pager.prefetch(chunk(0, 4, 13), -9.0);
    flight.pager.submit();
    store.take_reads();
    store.clear_faults("1.L01.brk");
    wants.push((chunk(0, 4, 4), 99.0));
    flight.settle_ahead(&wants, &chunks(0..4));
    let reads = store.take_reads();
    let index = flight
        .pager
        .tree(TreeId(0))
        .unwrap()
        .level(4)
        .unwrap()
        .bricks
        .clone()
        .unwrap();
    let order: Vec<usize> = reads
        .iter()
        .filter_map(|r| {
            index
                .chunks
                .iter()
                .position(|c| c.offset == r.offset && r.name == "0.L04.brk")
        })
        .collect();
    assert_eq!(order, [10, 11, 12, 13, 4, 0, 1, 2, 3]);
}

#[test]
fn pages_ahead_keep_to_their_share_and_count_for_no_demand() {
    let probe = store(&[4]);
    let mut flight = Flight::new(pager(&probe, 1, config(PLENTY, 2)));
    flight.settle(&[(level(0, 4), 0.0)]);
    let levels = flight.pager.stats().resident_bytes;
    flight.settle(&[(chunk(0, 4, 0), 0.0)]);
    let bytes = flight.pager.stats().resident_bytes - levels;

    let store = store(&[4]);
    let budget = levels + 64 * bytes;
    let mut flight = Flight::new(pager(&store, 1, config(budget, 2)));
    let view = [(level(0, 4), 0.0), (chunk(0, 4, 0), 0.0)];
    flight.settle(&view);
    flight.settle(&view);
    let demand = flight.pager.over_budget();
    flight.settle_ahead(&view, &chunks(0..64));
    let stats = flight.pager.stats();
    let ahead = (1..64).filter(|k| flight.has(chunk(0, 4, *k))).count() as u64;
    assert!(
        ahead > 2 && ahead * bytes <= budget / 8,
        "{ahead} of {bytes}: {stats:?}"
    );
    assert_eq!(
        (stats.ahead_bytes, stats.loaded_bytes.ahead),
        (ahead * bytes, ahead * bytes)
    );
    assert_eq!((stats.deferred, flight.pager.over_budget()), (0, demand));
    // At rest it rests, though more is asked for ahead.
    for _ in 0..20 {
        flight.settle_ahead(&view, &chunks(0..64));
    }
    assert_eq!(flight.pager.stats().loads, stats.loads);
    // Once used it makes room for more.
    flight.settle_ahead(&chunks(0..3), &chunks(0..64));
    let later = flight.pager.stats();
    assert!(
        later.ahead_bytes <= budget / 8 && later.loads > stats.loads,
        "{later:?}"
    );
    assert!(later.peak_bytes <= budget);
}

#[test]
fn a_root_ahead_is_not_pinned_and_gives_way() {
    let store = store(&[4, 4]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 2)));
    flight.settle_ahead(&[], &[(level(0, 4), 0.0)]);
    flight.settle_ahead(&[], &[(level(0, 4), 0.0)]);
    assert!(flight.has(level(0, 4)));
    let stats = flight.pager.stats();
    assert_eq!((stats.pinned_bytes, stats.ahead_bytes), (0, stats.resident_bytes));
    let LoadedBytes {
        roots,
        levels,
        chunks,
        ahead,
    } = stats.loaded_bytes;
    assert_eq!((roots, levels, chunks, ahead), (0, 0, 0, stats.resident_bytes));
    // Used, all of it is there for its use.
    flight.frame(&[(level(0, 4), 0.0)]);
    let used = flight.pager.stats();
    assert_eq!((used.ahead_bytes, used.loads), (0, stats.loads));
    assert!(used.pinned_bytes > 0 && used.used_bytes + used.pinned_bytes == used.resident_bytes);

    // Where there is no room it goes, children first.
    let budget = stats.resident_bytes * 3 / 2;
    let mut flight = Flight::new(pager(&store, 2, config(budget, 2)));
    for _ in 0..3 {
        flight.settle_ahead(&[], &[(level(0, 3), 0.0)]);
    }
    let before = flight.pager.stats().resident_bytes;
    assert!(before <= budget / 8, "no more than their share");
    flight.settle(&[(level(1, 4), 0.0)]);
    flight.settle(&[(level(1, 4), 0.0)]);
    assert!(flight.has(level(1, 4)));
    assert!(flight.pager.stats().peak_bytes <= budget);
}

#[test]
fn what_is_not_asked_for_again_leaves_the_queue() {
    let store = store(&[4, 1]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 1)));
    flight.settle(&[(level(0, 4), 0.0), (level(1, 1), 0.0)]);
    store.inject("1.L01.brk", Fault::Hang);
    let held = (chunk(1, 1, 0), 0.0);
    flight.until(&[held], |p| p.stats().loading == 1);
    flight.frame += 1;
    flight.pager.merge(flight.frame);
    flight.pager.request(held.0, held.1);
    chunks(0..9)
        .iter()
        .for_each(|(key, p)| flight.pager.prefetch(*key, *p));
    flight.pager.submit();
    assert_eq!(flight.pager.stats().queued, 9);
    flight.frame(&[held]);
    let stats = flight.pager.stats();
    assert_eq!((stats.queued, stats.cancelled), (0, 9));
    store.clear_faults("1.L01.brk");
}

#[test]
fn levels_are_asked_for_down_to_the_footprint_and_all_at_once() {
    let store = store(&[4]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
    // Voxels of half a metre at level 4, of 8 m at level 0.
    for (footprint, deepest) in [
        (20.0, 0),
        (8.0, 0),
        (7.9, 1),
        (2.0, 2),
        (0.51, 4),
        (0.0, 4),
        (f64::INFINITY, 0),
        (f64::NAN, 0),
    ] {
        let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 2)));
        flight.settle(&[(root(0), 0.0)]);
        flight.frame += 1;
        flight.pager.merge(flight.frame);
        flight.pager.request_levels(TreeId(0), footprint, f64::from);
        flight.pager.submit();
        while !flight.pager.is_idle() {
            flight.pager.wait_for_progress(std::time::Duration::from_secs(20));
            flight.frame += 1;
            flight.pager.merge(flight.frame);
        }
        let there = (0..=4).take_while(|l| flight.has(level(0, *l))).count();
        assert_eq!(there, deepest + 1, "{footprint}");
    }
    flight.pager.merge(1);
    flight.pager.request_levels(TreeId(0), 1.0, f64::from);
    flight.pager.submit();
    assert_eq!(flight.pager.stats().requested, 1, "the root first");
}
