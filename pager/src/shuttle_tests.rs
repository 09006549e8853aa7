//! The exchange between render thread and loaders under a model checker, which tries random interleavings.
//!
//! `exchange.rs` is compiled here a second time, over the checker's locks. Its `wait_timeout` never times out, so a
//! notification that is missing shows as a deadlock.

use crate::queue::Urgency;
use crate::table::Handle;

mod sync {
    pub(crate) use shuttle::sync::{Condvar, Mutex, MutexGuard};
}

mod queue {
    pub(crate) use crate::queue::{Queue, Urgency, Verdict};
}

mod table {
    pub(crate) use crate::table::Handle;
}

#[path = "exchange.rs"]
#[allow(
    dead_code,
    clippy::duplicate_mod,
    reason = "compiled a second time, over other locks"
)]
mod exchange;

use std::collections::BTreeMap;
use std::time::Duration;

use exchange::{Exchange, Job, Order};
use shuttle::sync::Arc;
use shuttle::thread;

/// A job is its own number, a result a number of bytes; what is dropped is a number too.
type Loads = Exchange<u32, u32, u32>;

const LIMIT: u64 = 30;
const FOREVER: Duration = Duration::from_secs(1 << 20);

fn job(number: u32, generation: u32) -> (Urgency, u64, Job<u32>) {
    let handle = Handle {
        slot: number,
        generation,
    };
    let urgency = Urgency {
        class: 1,
        priority: f64::from(number),
        order: 0,
        slot: number,
    };
    (
        urgency,
        u64::from(number % 2),
        Job {
            handle,
            estimate: 10,
            exempt: number == 0,
            work: number,
        },
    )
}

fn run(loads: &Loads) {
    loop {
        match loads.next() {
            Order::Stop => break,
            Order::Discard(_, bytes) => loads.discarded(bytes),
            Order::Load(job) => {
                if job.work == 3 && !loads.reserve(job.handle, 12) {
                    loads.finish(job.handle, u32::MAX, 0);
                    continue;
                }
                if job.work % 3 == 0 {
                    loads.read_done(job.handle);
                }
                loads.finish(job.handle, job.work, 8);
            }
        }
    }
    loads.leave();
}

fn start(threads: usize) -> (Arc<Loads>, Vec<thread::JoinHandle<()>>) {
    let loads = Arc::new(Loads::new(LIMIT, threads));
    let threads = (0..threads)
        .map(|_| {
            loads.enter();
            let loads = loads.clone();
            thread::spawn(move || run(&loads))
        })
        .collect();
    (loads, threads)
}

#[test]
fn every_job_is_done_once_within_the_limit_and_the_bytes_come_back() {
    let flight = || {
        let (loads, threads) = start(2);
        // Each frame asks for what is missing; what is there is given back at once, so that there is room.
        let mut done = BTreeMap::new();
        let mut begun = Vec::new();
        while done.len() < 5 {
            begun.extend(loads.take_started());
            let wanted =
                (0..5).filter(|k| !done.contains_key(k) && !begun.iter().any(|h: &Handle| h.slot == *k));
            loads.install(wanted.map(|k| job(k, 1)).collect());
            assert!(loads.wait(FOREVER));
            let (started, ready) = loads.take_news();
            begun.extend(started);
            for result in ready {
                assert!(
                    begun.contains(&result.handle),
                    "a result before the word that its load has begun"
                );
                begun.retain(|h| *h != result.handle);
                if result.result == u32::MAX {
                    continue;
                }
                assert_eq!(result.result, result.handle.slot);
                assert!(done.insert(result.result, ()).is_none(), "loaded twice");
                loads.discard(vec![result.result], result.bytes);
            }
            assert!(
                loads.status().peak <= LIMIT + 10,
                "the limit and the job that is exempt"
            );
        }
        loads.install(Vec::new());
        assert!(loads.wait(FOREVER));
        let status = loads.status();
        assert_eq!(
            (
                status.committed,
                status.leaving_bytes,
                status.queued,
                status.loading
            ),
            (0, 0, 0, 0)
        );
        loads.stop();
        assert!(loads.wait_for_threads(FOREVER));
        for thread in threads {
            thread.join().unwrap();
        }
    };
    shuttle::check_random(flight, 2000);
    shuttle::check_pct(flight, 1000, 3);
}

#[test]
fn a_stop_at_any_moment_ends_the_loaders() {
    let flight = || {
        let (loads, threads) = start(2);
        loads.install((0..4).map(|k| job(k, 1)).collect());
        loads.install((2..6).map(|k| job(k, 2)).collect());
        loads.discard(vec![9], 0);
        loads.stop();
        assert!(loads.wait_for_threads(FOREVER));
        for thread in threads {
            thread.join().unwrap();
        }
        let status = loads.status();
        assert_eq!((status.queued, status.loading), (0, 0));
    };
    shuttle::check_random(flight, 2000);
}
