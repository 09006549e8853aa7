//! Node list processors: threads that turn a frame's requests into the nodes to make resident, whole chains at once.
//!
//! The render thread submits a frame's requests with a snapshot of the trees they name; a processor walks each request from
//! its root through the levels in RAM and lists every node on the way once, coarse levels first, and the pages of levels
//! that are not there yet. Jobs are taken last in, first out, and only the newest few are kept: what an old frame lacked
//! matters less. The newest finished list replaces older ones. No lock is held while a job is worked on.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use brickfell_culler::TreeId;
use brickfell_pager::{PageKey, Stop, TreeState};
use brickfell_shaders::layout::Request;
use glam::UVec3;

/// Jobs that wait at most.
const QUEUE: usize = 4;

/// A tree that requests may name, as it was when the frame was drawn.
#[derive(Clone, Debug)]
pub struct ActiveTree {
    /// The tree.
    pub tree: TreeId,
    /// Its levels in RAM.
    pub state: Arc<TreeState>,
}

/// A node to make resident.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WantedNode {
    /// The tree.
    pub tree: TreeId,
    /// The node's level.
    pub level: u8,
    /// Its index in the level.
    pub node: u32,
    /// Its parent's index in the level above; 0 for a root.
    pub parent: u32,
    /// Place of its tree in the visibility order, for priorities.
    pub order: u32,
    /// Whether its brick is wanted, too, or the node alone.
    pub brick: bool,
}

/// What a frame's rays lacked, resolved.
#[derive(Clone, Debug, Default)]
pub struct NodeList {
    /// The frame.
    pub frame: u32,
    /// Nodes, each once, parents before children.
    pub nodes: Vec<WantedNode>,
    /// Level pages that must be loaded to go on, each once, with the tree's place in the visibility order.
    pub pages: Vec<(PageKey, u32)>,
}

struct Job {
    frame: u32,
    requests: Vec<Request>,
    trees: Arc<[ActiveTree]>,
}

#[derive(Default)]
struct State {
    jobs: VecDeque<Job>,
    working: usize,
    finished: Option<NodeList>,
    stop: bool,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The threads and their queue.
pub struct NodeListProcessors {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl std::fmt::Debug for NodeListProcessors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NodeListProcessors")
            .field("threads", &self.threads.len())
            .finish()
    }
}

impl NodeListProcessors {
    /// Starts the threads, at least one.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new(threads: usize) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let threads = (0..threads.max(1))
            .map(|k| {
                let shared = Arc::clone(&shared);
                std::thread::Builder::new()
                    .name(format!("node lists {k}"))
                    .spawn(move || work(&shared))
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { shared, threads })
    }

    /// Hands over a frame's requests.
    pub fn submit(&self, frame: u32, requests: Vec<Request>, trees: Arc<[ActiveTree]>) {
        let mut state = self.shared.lock();
        if state.jobs.len() == QUEUE {
            state.jobs.pop_front();
        }
        state.jobs.push_back(Job {
            frame,
            requests,
            trees,
        });
        drop(state);
        self.shared.changed.notify_one();
    }

    /// The newest finished list, if there is one since the last call.
    pub fn take(&self) -> Option<NodeList> {
        self.shared.lock().finished.take()
    }

    /// Waits until no job is queued or being worked on; for settled rendering only.
    pub fn wait_idle(&self) {
        let mut state = self.shared.lock();
        while !(state.jobs.is_empty() && state.working == 0) {
            state = self
                .shared
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Drop for NodeListProcessors {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A processor that panicked has nothing left to hand over.
            let _ = thread.join();
        }
    }
}

fn work(shared: &Shared) {
    let mut state = shared.lock();
    while !state.stop {
        let Some(job) = state.jobs.pop_back() else {
            state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            continue;
        };
        state.working += 1;
        drop(state);
        let list = resolve(job.frame, &job.requests, &job.trees);
        state = shared.lock();
        state.working -= 1;
        if state.finished.as_ref().is_none_or(|f| f.frame < list.frame) {
            state.finished = Some(list);
        }
        shared.changed.notify_all();
    }
}

/// Levels above a request whose whole subtree of nodes comes with it: nodes are small, and a ray that knows them asks for
/// all the bricks it lacks at once instead of finding one unknown tile behind the other.
const SUBTREE_LEVELS: u8 = 2;

/// Nodes by level, tree and index, with the parent's index, the tree's order and whether the brick is wanted.
type Nodes = HashMap<(u8, TreeId, u32), (u32, u32, bool)>;

/// Walks the requests and lists what they need.
fn resolve(frame: u32, requests: &[Request], trees: &[ActiveTree]) -> NodeList {
    let mut nodes = Nodes::new();
    let mut pages = HashMap::new();
    for request in requests {
        let Some(active) = trees.get(request.tree as usize) else {
            continue;
        };
        let found = active.state.find(request.level, UVec3::from_array(request.node));
        let mut parent = 0;
        for (level, node) in found.path() {
            nodes
                .entry((level, active.tree, node))
                .or_insert((parent, request.tree, true))
                .2 = true;
            if level + SUBTREE_LEVELS == request.level {
                add_subtree(&mut nodes, active, level, node, request.level, request.tree);
            }
            parent = node;
        }
        if let (Stop::NotResident, Some((level, _))) = (found.stop, found.deepest()) {
            pages
                .entry(PageKey::Level {
                    tree: active.tree,
                    level: level + 1,
                })
                .or_insert(request.tree);
        }
    }
    let mut nodes: Vec<_> = nodes
        .into_iter()
        .map(|((level, tree, node), (parent, order, brick))| WantedNode {
            tree,
            level,
            node,
            parent,
            order,
            brick,
        })
        .collect();
    nodes.sort_unstable_by_key(|n| (n.level, n.order, n.node));
    let mut pages: Vec<_> = pages.into_iter().collect();
    pages.sort_unstable();
    NodeList { frame, nodes, pages }
}

/// Adds the tiles below a node down to a level, each by its first node.
fn add_subtree(nodes: &mut Nodes, active: &ActiveTree, level: u8, node: u32, last: u8, order: u32) {
    let Some(page) = active.state.level(level) else {
        return;
    };
    let Some(tile) = page.nodes.get(node as usize).and_then(|n| n.children()) else {
        return;
    };
    nodes
        .entry((level + 1, active.tree, tile * 8))
        .or_insert((node, order, false));
    if level + 1 < last {
        for child in tile * 8..tile * 8 + 8 {
            add_subtree(nodes, active, level + 1, child, last, order);
        }
    }
}

#[cfg(test)]
mod tests;
