//! The loader threads: take the nearest job, read, check, decode, hand in; or drop what was evicted.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::JoinHandle;

use brickfell_formats::bricks::brick_file_name;

use crate::exchange::{Exchange, Job, Order};
use crate::load::{LoadError, Meters, Reader};
use crate::page::{LevelPage, Page, RootPage};
use crate::pager::PagerConfig;
use crate::store::Store;

/// What to load, with the pages that say where it is.
#[derive(Debug)]
pub(crate) enum Work {
    Root {
        file: Arc<str>,
    },
    Level {
        file: Arc<str>,
        root: Arc<RootPage>,
        level: u8,
    },
    Chunk {
        file: Arc<str>,
        page: Arc<LevelPage>,
        level: u8,
        chunk: u32,
    },
}

pub(crate) type Loads = Exchange<Work, Result<Page, LoadError>, Page>;

/// The loader threads and what they share.
#[derive(Debug)]
pub(crate) struct Loaders {
    pub(crate) loads: Arc<Loads>,
    pub(crate) meters: Arc<Meters>,
    /// Why there is no loader, if none could be started.
    pub(crate) failure: Option<String>,
    threads: Vec<JoinHandle<()>>,
}

impl Loaders {
    /// Starts the threads.
    pub(crate) fn start(store: Arc<dyn Store>, config: PagerConfig) -> Self {
        let threads = config.threads.max(1);
        let loads = Arc::new(Loads::new(config.limits(), threads));
        let meters = Arc::new(Meters::default());
        let mut loaders = Self {
            loads,
            meters,
            failure: None,
            threads: Vec::new(),
        };
        for k in 0..threads {
            let (loads, store, meters) = (loaders.loads.clone(), store.clone(), loaders.meters.clone());
            loads.enter();
            let thread = std::thread::Builder::new().name(format!("pager {k}"));
            match thread.spawn(move || run(&loads, &*store, &meters, config.keep_blocks)) {
                Ok(thread) => loaders.threads.push(thread),
                Err(e) => {
                    loaders.loads.leave();
                    loaders.failure = Some(format!("no loader thread could be started: {e}"));
                }
            }
        }
        if !loaders.threads.is_empty() {
            loaders.failure = None;
        }
        loaders
    }
}

/// How long a drop waits for loaders that are decoding; one that still reads after that is left behind.
const PATIENCE: std::time::Duration = std::time::Duration::from_millis(100);

impl Drop for Loaders {
    fn drop(&mut self) {
        self.loads.stop();
        let all_left = self.loads.wait_for_threads(PATIENCE);
        for thread in self.threads.drain(..) {
            // One that hangs in the store ends by itself when its read returns; it holds nothing but its own references.
            if all_left || thread.is_finished() {
                let _ = thread.join();
            }
        }
    }
}

fn run(loads: &Loads, store: &dyn Store, meters: &Meters, keep_blocks: bool) {
    loop {
        match loads.next() {
            Order::Stop => break,
            Order::Discard(pages, bytes) => {
                drop(pages);
                loads.discarded(bytes);
            }
            Order::Load(job) => {
                let handle = job.handle;
                // A store is foreign code: if it panics the page has failed, and the loader lives on.
                let reader = Reader {
                    store,
                    meters,
                    keep_blocks,
                    reserve: &|bytes| loads.reserve(handle, bytes),
                    read_done: &|| loads.read_done(handle),
                };
                let result = catch_unwind(AssertUnwindSafe(|| load(&reader, &job)));
                let result = result
                    .unwrap_or_else(|_| Err(LoadError::Failed("a loader panicked on this page".to_owned())));
                let bytes = result.as_ref().map_or(0, Page::memory);
                loads.finish(handle, result, bytes);
            }
        }
    }
    loads.leave();
}

fn load(reader: &Reader<'_>, job: &Job<Work>) -> Result<Page, LoadError> {
    let page = match &job.work {
        Work::Root { file } => reader.root(file).map(|page| Page::Root(Arc::new(page))),
        Work::Level { file, root, level } => match &root.index {
            Some(index) => reader
                .level(file, index, *level)
                .map(|page| Page::Level(Arc::new(page))),
            None => Err(reader.fail(file, format!("level {level} is part of the root page"))),
        },
        Work::Chunk {
            file,
            page,
            level,
            chunk,
        } => {
            let name = brick_file_name(file, *level);
            match &page.bricks {
                Some(bricks) => reader
                    .chunk(&name, bricks, *chunk)
                    .map(|page| Page::Chunk(Arc::new(page))),
                None => Err(reader.fail(&name, format!("level {level} has no bricks"))),
            }
        }
    }?;
    // Whatever was expected: a page that the budget has no room for does not come in.
    match (reader.reserve)(page.memory()) {
        true => Ok(page),
        false => Err(LoadError::Outgrown(page.memory())),
    }
}
