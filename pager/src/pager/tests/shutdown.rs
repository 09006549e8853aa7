//! The end of a pager, and its cost with a long queue.

use std::time::{Duration, Instant};

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
    let start = Instant::now();
    drop(flight);
    // 100 ms are waited for loaders that decode; the rest is room for a busy machine.
    assert!(
        start.elapsed() < Duration::from_millis(2000),
        "{:?}",
        start.elapsed()
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

#[test]
fn a_frame_with_four_thousand_requests_is_cheap() {
    let store = store(&[7, 1]);
    let mut flight = Flight::new(pager(&store, 2, config(PLENTY, 1)));
    flight.settle(&[(level(0, 7), 0.0), (level(1, 1), 0.0)]);
    store.inject("1.L01.brk", Fault::Hang);
    flight.until(&[(chunk(1, 1, 0), 0.0)], |p| p.stats().loading == 1);
    let mut wants = many(0, 7);
    assert_eq!(wants.len(), 4096);
    wants.push((chunk(1, 1, 0), 0.0));
    let mut times: Vec<Duration> = (0..20)
        .map(|_| {
            let start = Instant::now();
            flight.frame(&wants);
            start.elapsed()
        })
        .collect();
    times.sort();
    assert_eq!(flight.pager.stats().queued, 4096);
    println!(
        "a frame with 4096 requests: median {:?}, worst {:?}",
        times[10], times[19]
    );
    assert!(times[10] < Duration::from_millis(50), "{times:?}");
    store.clear_faults("1.L01.brk");
}
