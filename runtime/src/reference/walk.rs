//! One ray through one tree, segment by segment.
//!
//! A segment is where one formula holds: a constant node, or one voxel of a brick. Its level and the weight of the two
//! mixed levels are those of its start. Segments end at box planes (see `cells`) or at the depth where another
//! level is wanted; both move strictly forward, so a ray ends after at most as many segments as the lattice has planes
//! and the tree levels. Plain values: any thread.

use brickfell_formats::octree::octant;
use glam::DVec3;

use super::ReferenceError;
use super::cells::{CellBox, Trail};
use super::sampling::{Layer, Shading, Shown, Value, mix};
use super::tree::Tree;
use crate::picture::RayCounters;

/// A ray: `eye + z * direction`, where z is depth along the camera's axis in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// Where it starts, world metres.
    pub(super) eye: DVec3,
    /// World metres per metre of depth.
    pub(super) direction: DVec3,
    /// Length of the direction.
    pub(super) length: f64,
    /// Footprint of a pixel times 2^bias, metres per metre of depth.
    pub(super) footprint: f64,
    /// Part of a level over which it fades into the next, 0..1.
    pub(super) fade: f64,
    /// log2 of the voxels that a sampled segment spans along an axis, and the samples in it.
    pub(super) segment: (u32, u32),
    /// The light.
    pub(super) shading: Shading,
}

/// The part of a ray inside a tree's box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passage {
    /// Depth at which the ray enters, metres, not below 0.
    pub(super) enter: f64,
    /// Depth at which it leaves.
    pub(super) leave: f64,
}

impl Passage {
    /// The passage of a ray through a tree, `None` if it has no length.
    pub(super) fn through(tree: &Tree, ray: &Ray) -> Option<Self> {
        // In voxels, where all trees of a lattice have the same planes whatever their origins' rounding.
        let (eye, direction) = in_tree(tree, ray);
        let drawn = drawn(tree);
        let (low, high) = (drawn.lo.as_dvec3(), drawn.hi.as_dvec3());
        let (mut enter, mut leave) = (0f64, f64::INFINITY);
        for axis in 0..3 {
            let (p, d) = (eye[axis], direction[axis]);
            if d == 0.0 {
                if !(low[axis] <= p && p < high[axis]) {
                    return None;
                }
            } else {
                let (a, b) = ((low[axis] - p) / d, (high[axis] - p) / d);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        (enter < leave && leave.is_finite()).then_some(Self { enter, leave })
    }
}

/// What is drawn of a tree.
fn drawn(tree: &Tree) -> CellBox {
    let [lo, hi] = tree.header.voxels_within(tree.bounds).map(|p| p.as_i64vec3());
    CellBox { lo, hi }
}

/// A ray's eye and direction in finest voxels of a tree, from its low corner.
fn in_tree(tree: &Tree, ray: &Ray) -> (DVec3, DVec3) {
    // The eye and the corner are rounded metres; what they are but for that are whole voxels of the world's lattice.
    let voxels = |metres: f64| {
        let exact = metres / tree.header.voxel_size;
        let whole = exact.round();
        if (exact - whole).abs() <= whole.abs() * (4.0 * f64::EPSILON) {
            whole
        } else {
            exact
        }
    };
    let eye = ray.eye.map(voxels) - tree.header.origin.map(voxels);
    (eye, ray.direction / tree.header.voxel_size)
}

/// Transmittance below which a ray is taken to be opaque.
const OPAQUE: f64 = 1.0 / 1024.0;

/// What a ray has gathered, front to back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transport {
    color: DVec3,
    transmittance: f64,
    /// Counts of this ray; `rays_hit`, `capped` and `not_finite` are not used.
    pub(super) counters: RayCounters,
    /// Trees in which the segment cap stopped the ray.
    pub(super) capped: u64,
}

impl Default for Transport {
    fn default() -> Self {
        Self {
            color: DVec3::ZERO,
            transmittance: 1.0,
            counters: RayCounters::default(),
            capped: 0,
        }
    }
}

impl Transport {
    /// True once nothing behind can be seen.
    pub(super) fn saturated(&self) -> bool {
        self.transmittance == 0.0
    }

    /// Premultiplied linear colour and alpha.
    pub(super) fn rgba(&self) -> [f64; 4] {
        [self.color.x, self.color.y, self.color.z, 1.0 - self.transmittance]
    }

    fn under(&mut self, [r, g, b, a]: Layer) {
        self.color += DVec3::new(r, g, b) * self.transmittance;
        self.transmittance *= 1.0 - a;
        if self.transmittance < OPAQUE {
            self.color /= 1.0 - self.transmittance;
            self.transmittance = 0.0;
        }
    }
}

/// The node a descent ended at.
struct Place<'t> {
    level: u8,
    /// The level that was asked for.
    wanted: u8,
    terminal: bool,
    bounds: CellBox,
    shown: Shown<'t>,
    /// What the parent shows, where the node can be mixed with it.
    parent: Option<Shown<'t>>,
}

impl Place<'_> {
    /// True if a descent to `wanted` at `cell` would end at this node again, with the same parent.
    fn serves(&self, cell: glam::I64Vec3, wanted: u8) -> bool {
        self.bounds.contains(cell) && (wanted == self.wanted || self.terminal && wanted > self.level)
    }
}

/// How far a segment goes and what it shows.
struct Segment {
    /// The box it ends with.
    bounds: CellBox,
    /// Depth at which it ends at the latest.
    until: f64,
    /// The value all along it, or `None` if its middle is to be sampled.
    uniform: Option<Value>,
}

/// One ray in one tree.
pub(super) struct Walk<'t, 'r> {
    tree: &'t Tree,
    ray: &'r Ray,
    passage: Passage,
    trail: Trail,
    /// Depth reached.
    z: f64,
    /// Level wanted there; it only falls.
    wanted: u8,
    /// Least fractional level.
    least_level: f64,
    /// Segments after which the ray is stopped.
    pub(super) cap: u64,
}

impl<'t, 'r> Walk<'t, 'r> {
    /// A ray at the start of its passage.
    pub(super) fn new(tree: &'t Tree, ray: &'r Ray, passage: Passage, least_level: f64) -> Self {
        let header = &tree.header;
        let (eye, direction) = in_tree(tree, ray);
        let trail = Trail::new(eye, direction, passage.enter, &drawn(tree));
        Self {
            tree,
            ray,
            passage,
            trail,
            z: passage.enter,
            wanted: header.depth,
            least_level,
            // More than any ray needs: one per plane of the finest lattice and one per level, with room to spare.
            cap: 3 * header.side_voxels() + 2 * u64::from(header.depth) + 16,
        }
    }

    /// Gathers what the tree adds to the ray, until the ray leaves it or is opaque.
    pub(super) fn run(mut self, transport: &mut Transport) -> Result<(), ReferenceError> {
        let drawn = drawn(self.tree);
        let mut last: Option<Place<'t>> = None;
        for _ in 0..self.cap {
            if self.z >= self.passage.leave || !drawn.contains(self.trail.cell()) {
                return Ok(());
            }
            let weight = self.choose_level();
            let place = match last.take().filter(|p| p.serves(self.trail.cell(), self.wanted)) {
                Some(place) => last.insert(place),
                None => last.insert(self.descend(&mut transport.counters)?),
            };
            let pair = weight.zip(place.parent.as_ref());
            let segment = self.segment(place, pair.map(|(_, parent)| parent));
            let end = self
                .trail
                .exit(&segment.bounds)
                .min(segment.until)
                .min(self.passage.leave)
                .max(self.z);
            if end > self.z {
                match &segment.uniform {
                    Some(value) => transport.under(self.layer(value, place.level, end - self.z)),
                    None => self.sampled(place, pair, end, transport),
                }
                if transport.saturated() {
                    return Ok(());
                }
            }
            self.trail.advance(end, &segment.bounds);
            self.z = end;
        }
        transport.capped += 1;
        Ok(())
    }

    /// Cells of the finest level along a voxel's side.
    fn voxel(&self, level: u8) -> i64 {
        1 << (self.tree.header.depth - level)
    }

    /// Depth at which the fractional level has fallen so far; nowhere if levels do not.
    fn falls_to(&self, level: f64) -> f64 {
        if self.least_level > level {
            return f64::INFINITY;
        }
        self.tree.header.level_voxel_size(0) / self.ray.footprint * (-level).exp2()
    }

    /// Depth from which on a level is mixed with the coarser one: half of the fade before the middle between the two.
    fn fades(&self, level: u8) -> f64 {
        self.falls_to(f64::from(level) - 0.5 + 0.5 * self.ray.fade)
    }

    /// Depth from which on the coarser level stands alone.
    fn faded(&self, level: u8) -> f64 {
        self.falls_to(f64::from(level) - 0.5 - 0.5 * self.ray.fade)
    }

    /// Sets the level that is wanted here, the finer of two mixed ones, and gives its weight; `None` if it stands
    /// alone.
    fn choose_level(&mut self) -> Option<f64> {
        while self.wanted > 0 && self.z >= self.faded(self.wanted) {
            self.wanted -= 1;
        }
        if self.ray.fade == 0.0 || self.wanted == 0 || self.z < self.fades(self.wanted) {
            return None;
        }
        let lambda = (self.tree.header.level_voxel_size(0) / (self.ray.footprint * self.z))
            .log2()
            .max(self.least_level);
        let above = lambda - f64::from(self.wanted - 1);
        Some(((above - 0.5) / self.ray.fade + 0.5).clamp(0.0, 1.0))
    }

    /// Walks from the root to the node of the ray's cell.
    fn descend(&self, counters: &mut RayCounters) -> Result<Place<'t>, ReferenceError> {
        let cell = self.trail.cell();
        let size = |level: u8| 8 * self.voxel(level);
        let (mut level, mut parent) = (0u8, None);
        let mut node = self.tree.node(0, 0)?;
        counters.nodes += 1;
        while level < self.wanted
            && let Some(tile) = node.children()
        {
            parent = Some((level, node));
            level += 1;
            let here = CellBox::around(cell, size(level)).lo / size(level);
            node = self
                .tree
                .node(level, tile as usize * 8 + octant(here.as_uvec3()) as usize)?;
            counters.nodes += 1;
        }
        let parent = match parent {
            Some((l, n)) if self.ray.fade > 0.0 && level == self.wanted => {
                Some(Shown::fetch(self.tree, l, n.data())?)
            }
            _ => None,
        };
        Ok(Place {
            level,
            wanted: self.wanted,
            terminal: node.children().is_none(),
            bounds: CellBox::around(cell, size(level)),
            shown: Shown::fetch(self.tree, level, node.data())?,
            parent,
        })
    }

    /// The segment that starts here; `parent` is what is mixed in.
    fn segment(&self, place: &Place, parent: Option<&Shown>) -> Segment {
        let cell = self.trail.cell();
        // The faces of a constant node's inner box are planes of its own voxels, too.
        let sampled = Segment {
            bounds: CellBox::around(cell, self.voxel(place.level) << self.ray.segment.0),
            until: f64::INFINITY,
            uniform: None,
        };
        let uniform = |bounds, until, value| Segment {
            bounds,
            until,
            uniform: Some(value),
        };
        let Shown::Constant(value) = place.shown else {
            return sampled;
        };
        let Some(parent) = parent else {
            // The parent comes in when the footprint has grown.
            let ahead = Some(self.fades(place.level)).filter(|z| *z > self.z);
            return uniform(place.bounds, ahead.unwrap_or(f64::INFINITY), value);
        };
        let coarser = place.level - 1;
        match parent {
            Shown::Constant(p) if p.alpha == 0.0 && value.alpha == 0.0 => {
                uniform(place.bounds, self.faded(place.level), value)
            }
            Shown::Constant(_) => sampled,
            Shown::Brick(_) => {
                // Parent samples that touch what lies outside reach into the node by the rim only.
                let rim = self.tree.header.layout.rim() * self.voxel(coarser) as f64;
                let inner = place.bounds.shrunk(rim as i64);
                if inner.contains(cell) {
                    uniform(inner, self.faded(place.level), value)
                } else {
                    sampled
                }
            }
        }
    }

    /// What a path of `dz` metres of depth adds if it has one value of a level.
    fn layer(&self, value: &Value, level: u8, dz: f64) -> Layer {
        let header = &self.tree.header;
        let voxels = dz * self.ray.length / header.level_voxel_size(level);
        let direction = self.ray.direction / self.ray.length;
        self.ray
            .shading
            .layer(value, f64::from(header.gain), voxels, direction)
    }

    /// Adds a segment from here to `end` by the values in the middle of its parts; `pair` is the node's weight and its
    /// parent.
    fn sampled(&self, place: &Place, pair: Option<(f64, &Shown)>, end: f64, transport: &mut Transport) {
        let dz = (end - self.z) / f64::from(self.ray.segment.1);
        for part in 0..self.ray.segment.1 {
            let p = self.trail.at(self.z + dz * (f64::from(part) + 0.5));
            let reads_before = transport.counters.texture_reads;
            let mut at = |shown: &Shown, level: u8| {
                let voxel = self.voxel(level);
                let corner = CellBox::around(place.bounds.lo, 8 * voxel).lo;
                let value = shown.value(
                    (p - corner.as_dvec3()) / voxel as f64,
                    &mut transport.counters.texture_reads,
                );
                self.layer(&value, level, dz)
            };
            let fine = at(&place.shown, place.level);
            let layer = match pair {
                Some((weight, parent)) => mix(&at(parent, place.level - 1), &fine, weight),
                None => fine,
            };
            transport.counters.samples += u64::from(transport.counters.texture_reads > reads_before);
            transport.under(layer);
            if transport.saturated() {
                return;
            }
        }
    }
}
