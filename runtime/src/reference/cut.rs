//! Which trees the reference draws: those of the scene, or coarse ones in their place. Written apart from the culler, which
//! answers the same for the GPU; here everything is loaded, and what is out of view counts, too.

use brickfell_formats::scene;
use glam::DVec3;

use super::tree::Tree;

/// A group: the trees in it by number, and those that stand for them.
pub(super) struct Group {
    trees: Vec<usize>,
    groups: Vec<Group>,
    coarse: Vec<usize>,
    /// Finest voxel of the coarse trees, metres.
    voxel: f64,
    /// Box of everything, world metres; its corners are swapped if there is nothing.
    bounds: [DVec3; 2],
}

/// Numbers trees, then coarse trees, in the order of the scene.
pub(super) struct Numbers {
    /// The next tree.
    pub(super) tree: usize,
    /// The next coarse tree.
    pub(super) coarse: usize,
}

impl Group {
    /// A group of so many trees.
    pub(super) fn flat(trees: usize) -> Self {
        Self {
            trees: (0..trees).collect(),
            groups: Vec::new(),
            coarse: Vec::new(),
            voxel: 0.0,
            bounds: [DVec3::INFINITY, DVec3::NEG_INFINITY],
        }
    }

    /// A group of a scene.
    pub(super) fn new(group: &scene::Group, all: &[Tree], next: &mut Numbers) -> Self {
        let take = |next: &mut usize, count: usize| {
            *next += count;
            (*next - count..*next).collect::<Vec<usize>>()
        };
        let trees = take(&mut next.tree, group.trees.len());
        let coarse = take(&mut next.coarse, group.coarse.len());
        let groups: Vec<Group> = group.groups.iter().map(|g| Group::new(g, all, next)).collect();
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let boxes = trees.iter().chain(&coarse).map(|k| all[*k].bounds);
        for [min, max] in boxes.chain(groups.iter().map(|g| g.bounds)) {
            bounds = [bounds[0].min(min), bounds[1].max(max)];
        }
        Self {
            voxel: group.coarse.iter().map(|c| c.voxel).fold(0.0, f64::max),
            trees,
            groups,
            coarse,
            bounds,
        }
    }

    /// Adds the trees to be drawn, each with its least fractional level.
    pub(super) fn cut(
        &self,
        trees: &[Tree],
        eye: DVec3,
        forward: DVec3,
        footprint: f64,
        out: &mut Vec<(usize, f64)>,
    ) {
        // The least depth of a box is at one of its corners.
        let corners = (0..8).map(|k| {
            let pick = |axis: usize| self.bounds[k >> axis & 1][axis];
            (DVec3::new(pick(0), pick(1), pick(2)) - eye).dot(forward)
        });
        let nearest = corners.fold(f64::INFINITY, f64::min);
        if !self.coarse.is_empty() && nearest * footprint >= self.voxel {
            let octaves = (nearest * footprint / self.voxel).log2();
            out.extend(self.coarse.iter().map(|k| {
                let depth = f64::from(trees[*k].header.depth);
                (*k, (depth - octaves).max(0.0))
            }));
            return;
        }
        out.extend(self.trees.iter().map(|k| (*k, 0.0)));
        for group in &self.groups {
            group.cut(trees, eye, forward, footprint, out);
        }
    }
}
