//! What the render thread asks for: pages that are wanted now, pages that soon will be, levels by footprint.

use brickfell_culler::TreeId;

use crate::page::PageKey;
use crate::table::State;
use crate::tree::TreeState;

use super::Pager;

impl Pager {
    /// Asks for a page in this frame; smaller priorities load first, and the smallest of several counts. Parents that are
    /// missing are asked for too, with the same priority. A chunk, or a level, whose parents are not resident yet must be
    /// asked for again once they are. Asking for a resident page is a touch; for a page that does not exist, nothing.
    pub fn request(&mut self, key: PageKey, priority: f64) {
        let key = key.holder();
        let tree = key.tree();
        let Some(entry) = self.trees.get(tree.0 as usize) else {
            return;
        };
        let Some(state) = entry.state.clone() else {
            self.acquire(tree);
            return self.want(PageKey::Root(tree), priority, false);
        };
        let level = key.level();
        if level > state.root.header.depth {
            return;
        }
        self.use_levels(tree, level);
        self.want_missing(key, &state, priority, false);
    }

    /// Asks for a page that will be wanted soon. It loads after all that is wanted now, as far as what has come ahead of its use
    /// and was not used yet takes no more than an eighth of the budget; it neither pins nor pushes out anything in use, and
    /// counts for no demand. For a page that is there this does nothing.
    pub fn prefetch(&mut self, key: PageKey, priority: f64) {
        let key = key.holder();
        let tree = key.tree();
        let Some(entry) = self.trees.get(tree.0 as usize) else {
            return;
        };
        match entry.state.clone() {
            None => self.want(PageKey::Root(tree), priority, true),
            Some(state) if key.level() <= state.root.header.depth => {
                self.want_missing(key, &state, priority, true);
            }
            Some(_) => {}
        }
    }

    /// Asks for the levels of a tree down to the one whose voxels are as wide as a pixel, `footprint` metres, at the nearest
    /// point of its box: what a ray that gets there will need first. All at once, since each is read by itself; `priority`
    /// says how urgent a level is.
    pub fn request_levels(&mut self, tree: TreeId, footprint: f64, priority: impl Fn(u8) -> f64) {
        let Some(deepest) = self.level_for(tree, footprint) else {
            return self.request(PageKey::Root(tree), priority(0));
        };
        // The deepest one keeps or asks for those above it; one that is missing is as urgent as it is itself.
        let is_there = |level: &u8| self.tree(tree).is_some_and(|t| t.level(*level).is_some());
        let first = (0..deepest).find(|level| !is_there(level)).unwrap_or(deepest);
        for level in first..=deepest {
            self.request(PageKey::Level { tree, level }, priority(level));
        }
    }

    /// As [`Pager::request_levels`], ahead of use.
    pub fn prefetch_levels(&mut self, tree: TreeId, footprint: f64, priority: f64) {
        match self.level_for(tree, footprint) {
            Some(level) => self.prefetch(PageKey::Level { tree, level }, priority),
            None => self.prefetch(PageKey::Root(tree), priority),
        }
    }

    /// The coarsest level whose voxels are not wider than a footprint, or the deepest; `None` while the root is not there.
    fn level_for(&self, tree: TreeId, footprint: f64) -> Option<u8> {
        let header = &self.tree(tree)?.root.header;
        let octaves = (header.level_voxel_size(0) / footprint).log2().ceil();
        // A footprint of zero wants the deepest level, one that is not a number none.
        Some(octaves.clamp(0.0, f64::from(header.depth)) as u8)
    }

    /// Asks for a page of a tree whose root is there, and for the levels above that are missing.
    fn want_missing(&mut self, key: PageKey, state: &TreeState, priority: f64, ahead: bool) {
        let (tree, level) = (key.tree(), key.level());
        for l in 1..=level {
            let key = PageKey::Level { tree, level: l };
            if state.level(l).is_none() {
                if self
                    .table
                    .by_key(key)
                    .is_some_and(|s| matches!(s.state, State::GivenUp))
                {
                    return;
                }
                self.want(key, priority, ahead);
            }
        }
        if let (PageKey::Chunk { chunk, .. }, Some(page)) = (key, state.level(level))
            && page
                .bricks
                .as_ref()
                .is_some_and(|b| (chunk as usize) < b.chunks.len())
        {
            self.want(key, priority, ahead);
        }
    }
}
