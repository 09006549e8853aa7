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

use exchange::{Exchange, Job, Limits, Order};
use shuttle::sync::Arc;
use shuttle::thread;

/// A job is its own number, a result a number of bytes; what is dropped is a number too.
type Loads = Exchange<u32, u32, u32>;

const LIMITS: Limits = Limits { all: 40, usual: 30 };
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
            reserved: number == 0,
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
    let loads = Arc::new(Loads::new(LIMITS, threads));
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
                loads.status().peak <= LIMITS.all + 5 * Loads::JOB_BYTES,
                "the limit, and the queue"
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

#[test]
fn a_request_that_leaves_the_queue_is_either_begun_or_never_read() {
    let flight = || {
        let (loads, threads) = start(2);
        loads.install((0..4).map(|k| job(k, 1)).collect());
        // Half of it is not asked for again. What a loader has taken by then is reported as begun, and comes.
        let mut begun = loads.take_started();
        let again = [0, 2].map(|k| job(k, 1));
        loads.install(
            again
                .into_iter()
                .filter(|j| !begun.contains(&j.2.handle))
                .collect(),
        );
        let mut finished = Vec::new();
        while {
            let (started, ready) = loads.take_news();
            begun.extend(started);
            finished.extend(ready.iter().map(|done| done.handle));
            loads.discard(
                ready.iter().map(|done| done.result).collect(),
                ready.iter().map(|done| done.bytes).sum(),
            );
            let status = loads.status();
            status.queued + status.loading + status.ready > 0 || status.leaving_bytes > 0
        } {
            assert!(loads.wait(FOREVER));
        }
        let (started, _) = loads.take_news();
        begun.extend(started);
        begun.sort_unstable();
        finished.sort_unstable();
        assert_eq!(begun, finished, "each begun load comes once, and nothing else");
        for kept in [0, 2] {
            assert!(
                finished.iter().any(|h| h.slot == kept),
                "what is still wanted comes"
            );
        }
        assert_eq!(loads.status().committed, 0);
        loads.stop();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    };
    shuttle::check_random(flight, 2000);
    shuttle::check_pct(flight, 500, 3);
}

#[test]
fn what_expires_makes_room_for_what_waits() {
    let flight = || {
        let (loads, threads) = start(2);
        // The limit holds three pages beside the reserve. As many come, and stay until they expire.
        loads.install((1..4).map(|k| job(k + 4, 1)).collect());
        let mut resident = Vec::new();
        while resident.len() < 3 {
            assert!(loads.wait(FOREVER));
            resident.extend(loads.take_news().1);
        }
        loads.install((10..13).map(|k| job(k, 2)).collect());
        let mut came = 0;
        while came < 3 {
            // One page expires for each that waits; it is dropped by a loader while others read.
            if let Some(old) = resident.pop() {
                loads.discard(vec![old.result], old.bytes);
            }
            assert!(loads.wait(FOREVER));
            let ready = loads.take_news().1;
            came += ready.len();
            for done in ready {
                loads.discard(vec![done.result], done.bytes);
            }
            assert!(loads.status().committed <= LIMITS.all);
        }
        loads.stop();
        assert!(loads.wait_for_threads(FOREVER));
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    };
    shuttle::check_random(flight, 2000);
}
