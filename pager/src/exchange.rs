//! What the render thread and the loader threads share: the queue, the loads under way, the finished ones, and the count
//! of bytes. One mutex, held for moments only; never across a read, a decode or the drop of a page.
//!
//! The render thread calls [`Exchange::install`], [`Exchange::take_news`], [`Exchange::status`], [`Exchange::wait`] and
//! [`Exchange::stop`]; loader threads call the rest. Every byte that the pager answers for is in `committed`: resident and
//! finished pages, loads under way by their estimate, and evicted pages that a loader has yet to drop; the queue's own bytes are
//! counted beside it. Nothing is ever committed beyond [`Limits::all`].

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::queue::{Queue, Urgency, Verdict};
use super::sync::{Condvar, Mutex, MutexGuard};
use super::table::Handle;

/// A page to be loaded.
#[derive(Debug)]
pub(crate) struct Job<J> {
    pub(crate) handle: Handle,
    /// Bytes that loading is expected to take.
    pub(crate) estimate: u64,
    /// May use the reserve: a root, without which nothing can be shown.
    pub(crate) reserved: bool,
    pub(crate) work: J,
}

/// A finished load.
#[derive(Debug)]
pub(crate) struct Done<R> {
    pub(crate) handle: Handle,
    pub(crate) result: R,
    /// Bytes the result takes; committed.
    pub(crate) bytes: u64,
}

/// What a loader thread is to do next.
#[derive(Debug)]
pub(crate) enum Order<J, T> {
    /// Load, then call [`Exchange::finish`].
    Load(Job<J>),
    /// Drop, then call [`Exchange::discarded`] with the bytes.
    Discard(Vec<T>, u64),
    /// End.
    Stop,
}

/// How many bytes may be committed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    /// By roots.
    pub(crate) all: u64,
    /// By everything else: the rest is the reserve.
    pub(crate) usual: u64,
}

impl Limits {
    fn of(&self, reserved: bool) -> u64 {
        if reserved { self.all } else { self.usual }
    }
}

/// Counts of one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Status {
    pub(crate) queued: usize,
    pub(crate) loading: usize,
    pub(crate) ready: usize,
    /// Estimates of the loads under way and bytes of the finished ones.
    pub(crate) arriving_bytes: u64,
    /// Bytes of evicted pages that are not dropped yet.
    pub(crate) leaving_bytes: u64,
    /// Bytes of the queue itself.
    pub(crate) queue_bytes: u64,
    pub(crate) committed: u64,
    /// Most bytes ever committed, with those of the queue.
    pub(crate) peak: u64,
}

#[derive(Debug)]
struct Claim {
    handle: Handle,
    file: u64,
    bytes: u64,
    reserved: bool,
    reading: bool,
}

#[derive(Debug)]
struct State<J, R, T> {
    queue: Queue<Job<J>>,
    claims: Vec<Claim>,
    /// Loaders that read a file at this moment.
    readers: HashMap<u64, usize>,
    ready: Vec<Done<R>>,
    /// Taken from the queue since the render thread last asked.
    started: Vec<Handle>,
    trash: Vec<T>,
    trash_bytes: u64,
    /// Bytes of the trash and of what loaders are dropping.
    leaving_bytes: u64,
    committed: u64,
    peak: u64,
    threads: usize,
    stop: bool,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Exchange<J, R, T> {
    state: Mutex<State<J, R, T>>,
    /// Loaders wait here for something to do.
    work: Condvar,
    /// The render thread waits here for results, and for loaders to leave.
    progress: Condvar,
    limits: Limits,
    readers_per_file: usize,
}

type Guard<'a, J, R, T> = MutexGuard<'a, State<J, R, T>>;

impl<J, R, T> Exchange<J, R, T> {
    /// Bytes that a job takes while it is queued.
    pub(crate) const JOB_BYTES: u64 = size_of::<(Urgency, u64, Job<J>)>() as u64;

    /// An exchange for a number of loaders, which may commit up to these limits. One loader is kept off every file, if
    /// there is more than one, so that a file that does not answer leaves a loader to the others.
    pub(crate) fn new(limits: Limits, threads: usize) -> Self {
        let state = State {
            queue: Queue::default(),
            claims: Vec::new(),
            readers: HashMap::new(),
            ready: Vec::new(),
            started: Vec::new(),
            trash: Vec::new(),
            trash_bytes: 0,
            leaving_bytes: 0,
            committed: 0,
            peak: 0,
            threads: 0,
            stop: false,
        };
        Self {
            state: Mutex::new(state),
            work: Condvar::new(),
            progress: Condvar::new(),
            limits,
            readers_per_file: threads.saturating_sub(1).max(1),
        }
    }

    fn lock(&self) -> Guard<'_, J, R, T> {
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Counts a loader thread in, before it is spawned.
    pub(crate) fn enter(&self) {
        self.lock().threads += 1;
    }

    /// Counts a loader thread out: its last call, or one for a thread that could not be spawned.
    pub(crate) fn leave(&self) {
        self.lock().threads -= 1;
        self.progress.notify_all();
    }

    /// Waits for something to do.
    pub(crate) fn next(&self) -> Order<J, T> {
        let mut state = self.lock();
        loop {
            if state.stop {
                return Order::Stop;
            }
            if !state.trash.is_empty() {
                let bytes = std::mem::take(&mut state.trash_bytes);
                return Order::Discard(std::mem::take(&mut state.trash), bytes);
            }
            if let Some(job) = self.take(&mut state) {
                return Order::Load(job);
            }
            state = self
                .work
                .wait(state)
                .unwrap_or_else(|poisoned| poisoned.into_inner());
        }
    }

    fn take(&self, state: &mut State<J, R, T>) -> Option<Job<J>> {
        let State {
            queue,
            readers,
            committed,
            ..
        } = state;
        let (file, job) = queue.take(|file, job| {
            if readers.get(&file).is_some_and(|n| *n >= self.readers_per_file) {
                Verdict::SkipFile
            } else if fits(*committed, job.estimate, self.limits.of(job.reserved)) {
                Verdict::Take
            } else {
                Verdict::Wait
            }
        })?;
        *readers.entry(file).or_default() += 1;
        state.commit(job.estimate);
        state.started.push(job.handle);
        state.claims.push(Claim {
            handle: job.handle,
            file,
            bytes: job.estimate,
            reserved: job.reserved,
            reading: true,
        });
        Some(job)
    }

    /// Says that a load reads no more, so that others may read its file.
    pub(crate) fn read_done(&self, handle: Handle) {
        self.lock().release_file(handle);
        self.work.notify_all();
    }

    /// Asks for `bytes` in all for a load under way.
    pub(crate) fn reserve(&self, handle: Handle, bytes: u64) -> bool {
        let mut state = self.lock();
        let State {
            claims, committed, ..
        } = &mut *state;
        let Some(claim) = claims.iter_mut().find(|c| c.handle == handle) else {
            return false;
        };
        let more = bytes.saturating_sub(claim.bytes);
        let granted = fits(*committed, more, self.limits.of(claim.reserved));
        if granted {
            claim.bytes += more;
            state.commit(more);
        }
        granted
    }

    /// Hands a result in; `bytes` is what it takes.
    pub(crate) fn finish(&self, handle: Handle, result: R, bytes: u64) {
        let mut state = self.lock();
        state.release_file(handle);
        if let Some(k) = state.claims.iter().position(|c| c.handle == handle) {
            state.committed -= state.claims.swap_remove(k).bytes;
        }
        state.commit(bytes);
        let done = Done {
            handle,
            result,
            bytes,
        };
        let late = if state.stop {
            Some(done)
        } else {
            state.ready.push(done);
            None
        };
        drop(state);
        drop(late);
        self.work.notify_all();
        self.progress.notify_all();
    }

    /// Says that evicted pages of that many bytes are dropped.
    pub(crate) fn discarded(&self, bytes: u64) {
        let mut state = self.lock();
        state.leaving_bytes -= bytes;
        state.committed -= bytes;
        drop(state);
        self.work.notify_all();
        self.progress.notify_all();
    }

    /// Replaces the queue by these jobs, less those a loader has begun meanwhile.
    pub(crate) fn install(&self, jobs: Vec<(Urgency, u64, Job<J>)>) {
        let mut queue = Queue::new(jobs);
        let mut state = self.lock();
        if !state.started.is_empty() {
            queue.retain(|job| !state.started.contains(&job.handle));
        }
        let old = std::mem::replace(&mut state.queue, queue);
        state.commit(0);
        drop(state);
        drop(old);
        self.work.notify_all();
    }

    /// Gives pages of that many committed bytes to the loaders, to be dropped there.
    pub(crate) fn discard(&self, pages: Vec<T>, bytes: u64) {
        if pages.is_empty() {
            return;
        }
        let mut state = self.lock();
        state.trash.extend(pages);
        state.trash_bytes += bytes;
        state.leaving_bytes += bytes;
        drop(state);
        self.work.notify_one();
    }

    /// Takes the handles of the loads begun since the last call of this or [`Self::take_news`].
    pub(crate) fn take_started(&self) -> Vec<Handle> {
        std::mem::take(&mut self.lock().started)
    }

    /// Takes the loads begun since the last call of this or [`Self::take_started`], and the finished ones, at one moment: no
    /// load is finished before the render thread knows that it has begun.
    pub(crate) fn take_news(&self) -> (Vec<Handle>, Vec<Done<R>>) {
        let mut state = self.lock();
        (
            std::mem::take(&mut state.started),
            std::mem::take(&mut state.ready),
        )
    }

    /// Counts of this moment.
    pub(crate) fn status(&self) -> Status {
        let state = self.lock();
        let loading: u64 = state.claims.iter().map(|c| c.bytes).sum();
        Status {
            queued: state.queue.len(),
            loading: state.claims.len(),
            ready: state.ready.len(),
            arriving_bytes: loading + state.ready.iter().map(|d| d.bytes).sum::<u64>(),
            leaving_bytes: state.leaving_bytes,
            queue_bytes: state.queue_bytes(),
            committed: state.committed,
            peak: state.peak,
        }
    }

    /// Waits until a result is ready or the loaders can do nothing more; false if that took longer than `timeout`.
    pub(crate) fn wait(&self, timeout: Duration) -> bool {
        let end = Instant::now().checked_add(timeout);
        let mut state = self.lock();
        while state.ready.is_empty() && state.moving(self.limits) {
            let left = end.map_or(timeout, |end| end.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                return false;
            }
            state = self
                .progress
                .wait_timeout(state, left)
                .unwrap_or_else(|poisoned| poisoned.into_inner())
                .0;
        }
        true
    }

    /// Tells the loaders to end and forgets the queue.
    pub(crate) fn stop(&self) {
        let mut state = self.lock();
        state.stop = true;
        let queue = std::mem::take(&mut state.queue);
        drop(state);
        drop(queue);
        self.work.notify_all();
        self.progress.notify_all();
    }

    /// Waits until all loaders have left; false if that took longer than `timeout`.
    pub(crate) fn wait_for_threads(&self, timeout: Duration) -> bool {
        let end = Instant::now() + timeout;
        let mut state = self.lock();
        while state.threads > 0 {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            state = self
                .progress
                .wait_timeout(state, left)
                .unwrap_or_else(|poisoned| poisoned.into_inner())
                .0;
        }
        true
    }
}

fn fits(committed: u64, more: u64, limit: u64) -> bool {
    committed.checked_add(more).is_some_and(|sum| sum <= limit)
}

impl<J, R, T> State<J, R, T> {
    fn commit(&mut self, bytes: u64) {
        self.committed += bytes;
        self.peak = self.peak.max(self.committed + self.queue_bytes());
    }

    fn queue_bytes(&self) -> u64 {
        self.queue.len() as u64 * Exchange::<J, R, T>::JOB_BYTES
    }

    fn release_file(&mut self, handle: Handle) {
        let Some(claim) = self.claims.iter_mut().find(|c| c.handle == handle && c.reading) else {
            return;
        };
        claim.reading = false;
        if let Some(n) = self.readers.get_mut(&claim.file) {
            *n -= 1;
            if *n == 0 {
                self.readers.remove(&claim.file);
            }
        }
    }

    /// Whether something will change without the render thread.
    fn moving(&self, limits: Limits) -> bool {
        let fit = |job: &Job<J>| fits(self.committed, job.estimate, limits.of(job.reserved));
        !self.stop
            && (!self.claims.is_empty() || self.leaving_bytes > 0 || self.queue.peek().is_some_and(fit))
    }
}
