//! A tree as rays of one picture see it, worked out in f64: where it is, and at which depths its levels begin.
//!
//! Lengths are finest voxels of the tree, from its low corner. All planes at which a segment may end are integers there, at most
//! 2²³. Plain values: any thread.

use brickfell_formats::octree::{MAX_DEPTH, TreeHeader};
use glam::DVec3;

use super::real::Real;
use super::walk::Ray;

/// What the rays of a picture have in common besides the light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lens {
    /// Where rays start, world metres.
    pub(crate) eye: DVec3,
    /// Footprint of a pixel times 2^bias, metres per metre of depth.
    pub(crate) footprint: f64,
    /// Part of a level over which it fades into the next, 0..1.
    pub(crate) fade: f64,
    /// log2 of the voxels that a sampled segment spans along an axis, and the samples in it.
    pub(crate) segment: (u32, u32),
}

/// A tree in a picture.
#[derive(Clone, Debug)]
pub(crate) struct View {
    /// The eye.
    pub(super) eye: DVec3,
    /// Finest voxels per metre.
    pub(super) per_metre: f64,
    /// What is drawn of the tree: low corner, and high corner exclusive.
    pub(super) drawn: [[i32; 3]; 2],
    /// The deepest level.
    pub(super) depth: u8,
    /// Opacity gain.
    pub(super) gain: f64,
    /// Rim of constant nodes, in voxels of the node's own level.
    pub(super) rim: i32,
    /// Least fractional level; above 0 where a coarse tree has just taken over.
    pub(super) least_level: f64,
    /// log2 of the root's voxel over the footprint at a depth of 1 m.
    pub(super) log2_root: f64,
    /// Depth from which on each level is mixed with the coarser one: half of the fade before the middle between the two.
    pub(super) fades: [f64; MAX_DEPTH as usize + 1],
    /// Depth from which on the coarser level stands alone.
    pub(super) faded: [f64; MAX_DEPTH as usize + 1],
}

/// The part of a ray inside a tree's box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Passage {
    /// Depth at which the ray enters, metres, not below 0.
    pub(crate) enter: f64,
    /// Depth at which it leaves.
    pub(crate) leave: f64,
}

impl Passage {
    /// What of it lies behind a depth, `None` if nothing does.
    #[inline(always)]
    pub(crate) fn from(self, depth: f64) -> Option<Self> {
        let enter = self.enter.max(depth);
        (enter < self.leave).then_some(Self { enter, ..self })
    }

    /// What of it lies before a depth, `None` if nothing does.
    pub(crate) fn until(self, depth: f64) -> Option<Self> {
        let leave = self.leave.min(depth);
        (self.enter < leave).then_some(Self { leave, ..self })
    }
}

impl View {
    /// A tree of which what is in `bounds` (world metres) is drawn.
    pub(crate) fn new(header: &TreeHeader, bounds: [DVec3; 2], least_level: f64, lens: &Lens) -> Self {
        // The eye and the corner are rounded metres; what they are but for that are whole voxels of the world's lattice.
        let voxels = |metres: f64| {
            let exact = metres / header.voxel_size;
            let whole = exact.round();
            if (exact - whole).abs() <= whole.abs() * (4.0 * f64::EPSILON) {
                whole
            } else {
                exact
            }
        };
        let root = header.level_voxel_size(0) / lens.footprint;
        // Where the fractional level has fallen to a number; nowhere if it stays above.
        let falls_to = |level: f64| {
            if least_level > level {
                f64::INFINITY
            } else {
                root * (-level).exp2()
            }
        };
        let depths = |offset: f64| std::array::from_fn(|level| falls_to(level as f64 - 0.5 + offset));
        Self {
            eye: lens.eye.map(voxels) - header.origin.map(voxels),
            per_metre: 1.0 / header.voxel_size,
            drawn: header.voxels_within(bounds).map(|p| p.as_ivec3().to_array()),
            depth: header.depth,
            gain: f64::from(header.gain),
            rim: (header.layout.rim() * 2.0) as i32,
            least_level,
            log2_root: root.log2(),
            fades: depths(0.5 * lens.fade),
            faded: depths(-0.5 * lens.fade),
        }
    }

    /// The eye, in finest voxels from the low corner.
    pub(crate) fn eye(&self) -> DVec3 {
        self.eye
    }

    /// Finest voxels per metre.
    pub(crate) fn per_metre(&self) -> f64 {
        self.per_metre
    }

    /// Side of a node of a level, finest voxels.
    pub(crate) fn side(&self, level: u8) -> f64 {
        f64::from(8u32 << (self.depth - level.min(self.depth)))
    }

    /// Depth from which on a level may be shown, though there be finer ones: that from which the next finer one fades, less what a segment
    /// of 2^`step` voxels may be long, because it goes on with the level that it began with.
    pub(crate) fn shown_from(&self, level: u8, step: u32) -> f64 {
        let finer = usize::from(level) + 1;
        let fades = self.fades.get(finer).filter(|_| level < self.depth);
        let segment = 0.25 * self.side(level) * f64::from(1u32 << step) / self.per_metre;
        fades.map_or(0.0, |z| (z - segment).max(0.0))
    }

    /// Where a ray starts and what a metre of depth adds, in finest voxels: there all trees of a lattice have the same planes whatever
    /// their origins' rounding.
    #[inline(always)]
    pub(super) fn line<T: Real>(&self, ray: &Ray<T>) -> (DVec3, DVec3) {
        (
            self.eye + ray.from * self.per_metre,
            ray.direction * self.per_metre,
        )
    }

    /// The passage of a ray through what is drawn of the tree, `None` if it has no length.
    #[inline(always)]
    pub(crate) fn passage<T: Real>(&self, ray: &Ray<T>) -> Option<Passage> {
        let (eye, direction) = self.line(ray);
        let (mut enter, mut leave) = (0f64, f64::INFINITY);
        for axis in 0..3 {
            let [low, high] = self.drawn.map(|p| f64::from(p[axis]));
            let (p, d) = (eye[axis], direction[axis]);
            if d == 0.0 {
                if !(low <= p && p < high) {
                    return None;
                }
            } else {
                let (a, b) = ((low - p) / d, (high - p) / d);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        (enter < leave && leave.is_finite()).then_some(Passage { enter, leave })
    }
}
