//! The end of a pager.

use crate::testing::{Flight, chunk, config, level, pager, store};
use crate::{Fault, PageKey};

const PLENTY: u64 = 1 << 30;

fn many(tree: u32, l: u8) -> Vec<(PageKey, f64)> {
    (0..1u32 << (2 * (l - 1)))
        .map(|k| (chunk(tree, l, k), f64::from(k.wrapping_mul(2654435761) >> 8)))
        .collect()
}

#[test]
fn a_drop_with_a_thousand_jobs_and_a_hung_read_returns() {
    let store = store(&[6, 1]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 2)));
    flight.settle(&[(level(0, 6), 0.0), (level(1, 1), 0.0)]);
    store.inject("0.L06.brk", Fault::Hang);
    let wants = many(0, 6);
    flight.until(&wants, |p| p.stats().loading == 1);
    assert!(flight.pager.stats().queued >= 1000);
    store.take_reads();
    // Were the read waited for, this would never return; `bench pager-rates` prints how long it takes.
    drop(flight);
    assert!(
        store.take_reads().is_empty(),
        "the queue is forgotten, not worked off"
    );
    store.clear_faults("0.L06.brk");
}

#[test]
fn a_drop_of_an_idle_pager_joins_its_threads() {
    let store = store(&[2]);
    let mut flight = Flight::new(pager(&store, 1, config(PLENTY, 4)));
    flight.settle(&many(0, 2));
    drop(flight);
    assert_eq!(std::sync::Arc::strong_count(&store), 1, "a loader is left");
}
