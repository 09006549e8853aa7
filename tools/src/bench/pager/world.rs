//! The frame loop without a device: culler, pager, lookahead and bias as the renderer uses them, with rays of the CPU in
//! place of the kernel's read-back.

use std::sync::Arc;
use std::time::Instant;

use brickfell_culler::{Camera, Culler, Cut, Expiry, Readiness, TreeId, VisibleTree};
use brickfell_pager::{Lookahead, PageKey, Pager, PagerConfig, Store};
use brickfell_runtime::bias::BiasController;
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use brickfell_runtime::texture_pool::priority;

use super::rays::{Look, look};

/// Frames after which the root of a tree that is out of view is unpinned.
const KEEP: u64 = 300;

/// A pager over a terrain, and what drives it.
pub(super) struct World {
    terrain: Arc<Terrain>,
    pub(super) pager: Pager,
    culler: Culler,
    in_use: Expiry,
    lookahead: Lookahead,
    bias: BiasController,
    frame: u32,
}

/// What a frame came to.
pub(super) struct Frame {
    pub(super) look: Look,
    /// Trees drawn, front to back, and trees that were wanted beside them.
    pub(super) trees: Vec<TreeId>,
    pub(super) visible: usize,
    /// Trees in view whose roots are not there.
    pub(super) waiting: usize,
    /// Pages published at its beginning.
    pub(super) published: Vec<PageKey>,
    /// The render thread's time for publishing, culling and handing over, milliseconds.
    pub(super) merge_ms: f64,
    pub(super) cull_ms: f64,
    pub(super) submit_ms: f64,
    /// Pages that were under way or waiting to be published when this frame's requests replaced the queue: begun before.
    pub(super) under_way: usize,
    /// Whether the bias changed.
    pub(super) bias_moved: bool,
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

impl World {
    pub(super) fn new(store: &Arc<dyn Store>, terrain: &Arc<Terrain>, budget: u64) -> Self {
        let files = terrain
            .trees
            .iter()
            .chain(&terrain.coarse_trees)
            .cloned()
            .collect();
        let config = PagerConfig {
            budget_bytes: budget,
            ..PagerConfig::default()
        };
        Self {
            terrain: Arc::clone(terrain),
            pager: Pager::new(Arc::clone(store), files, config),
            culler: Culler::new(),
            in_use: Expiry::default(),
            lookahead: Lookahead::default(),
            bias: BiasController::default(),
            frame: 0,
        }
    }

    /// Keeps a tree's root, or asks for it; false while it has to be waited for.
    fn use_root(pager: &mut Pager, tree: &VisibleTree) -> bool {
        if pager.tree(tree.tree).is_some() {
            pager.touch(PageKey::Root(tree.tree));
            return true;
        }
        pager.request(
            PageKey::Root(tree.tree),
            tree.distance / (tree.distance + 1000.0) - 1.0,
        );
        pager.is_failed(PageKey::Root(tree.tree))
    }

    /// One frame.
    pub(super) fn frame(&mut self, camera: &Camera) -> Frame {
        self.frame += 1;
        let frame = u64::from(self.frame);
        let start = Instant::now();
        let published = self.pager.merge(frame).to_vec();
        let merge_ms = ms(start);
        let start = Instant::now();
        let bias = RenderSettings::default().bias + self.bias.extra();
        let footprint = camera.pixel_size() * bias.exp2();
        let pager = &self.pager;
        let cut = Cut {
            footprint,
            readiness: &|tree| match pager.tree(tree) {
                Some(_) => Readiness::Ready,
                None if pager.is_failed(PageKey::Root(tree)) => Readiness::Failed,
                None => Readiness::Awaited,
            },
        };
        let seen = self.culler.cull_cut(&self.terrain.graph, camera, &cut, frame);
        let cull_ms = ms(start);
        let look = look(&self.pager, &seen.visible, camera, footprint);
        let start = Instant::now();
        let mut waiting = 0;
        for tree in seen.wanted.iter().chain(&seen.visible) {
            self.in_use.touch(tree.tree, frame);
            waiting += usize::from(!Self::use_root(&mut self.pager, tree));
        }
        for (order, tree) in (0..).zip(&seen.visible) {
            if tree.beyond.is_none() && self.pager.tree(tree.tree).is_some() {
                let wanted = tree.distance * footprint;
                (self.pager).request_levels(tree.tree, wanted, |level| priority(level, order));
            }
        }
        let trees = seen.visible.iter().chain(&seen.wanted).map(|t| t.tree).collect();
        let visible = seen.visible.len();
        for (key, priority) in &look.pages {
            self.pager.request(*key, *priority);
        }
        let pager = &mut self.pager;
        self.in_use.expire(frame, KEEP, |tree| pager.release_tree(tree));
        self.lookahead
            .ask(&mut self.pager, &self.terrain.graph, camera, footprint);
        self.pager.submit();
        let submit_ms = ms(start);
        let stats = self.pager.stats();
        let before = self.bias.extra();
        self.bias
            .update(self.frame, camera, &[(self.pager.over_budget(), 1.0)]);
        Frame {
            look,
            trees,
            visible,
            waiting,
            published,
            merge_ms,
            cull_ms,
            submit_ms,
            under_way: stats.loading + stats.ready + stats.held,
            bias_moved: self.bias.extra() != before || self.bias.is_waiting(),
        }
    }

    /// Bias on top of the usual one.
    pub(super) fn extra_bias(&self) -> f64 {
        self.bias.extra()
    }
}
