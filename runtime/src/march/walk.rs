//! One ray through one tree, segment by segment.
//!
//! A segment is where one formula holds: a constant node, or one voxel of a brick. Its level and the weight of the two
//! mixed levels are those of its start. Segments end at planes of the lattice or at the depth where another level is
//! wanted. The ray's finest cell is kept as integers: a ray that crosses a plane is put behind it whatever the rounded position
//! says, and on the other axes it stays in the voxel it is in, so it can neither turn back nor stand still, and ends after at
//! most as many segments as the lattice has planes and the tree levels.
//!
//! In f32 positions and depths are relative to the cell and the depth where the walk begins, so that they are small where the ray is and
//! digits suffice; in f64 to the tree and the eye, so that trees of a lattice agree to the bit. Plain values: any thread.

use glam::DVec3;

use super::real::Real;
use super::shade::{Layer, Shading, Transport, Triple, Value, mix};
use super::view::{Lens, Passage, View};
use super::{Brick, Cell, Place, Shown, Source};

/// A ray: `eye + from + z * direction`, where z is depth in metres: for rays of the camera, whose `from` is zero, along its axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray<T> {
    pub(super) from: DVec3,
    pub(super) direction: DVec3,
    length: f64,
    /// The direction with a length of 1.
    unit: Triple<T>,
}

impl<T: Real> Ray<T> {
    /// A ray from a point (world metres from the eye) along a direction, world metres per metre of depth.
    #[inline(always)]
    pub(crate) fn new(from: DVec3, direction: DVec3) -> Self {
        let length = direction.length();
        Self {
            from,
            direction,
            length,
            unit: (direction / length).to_array().map(T::of),
        }
    }
}

/// One ray in one tree. With `LIT` the ray notes the surface that it sees, for lights that others may hide.
pub(crate) struct Walk<'a, T, S, const LIT: bool> {
    view: &'a View,
    lens: &'a Lens,
    shading: &'a Shading<T>,
    source: &'a mut S,
    unit: Triple<T>,
    /// Length of the path per metre of depth, in finest voxels.
    path: T,
    gain: T,
    /// The cell and the depth (metres) that everything below is relative to.
    anchor: Cell,
    start: f64,
    origin: Triple<T>,
    /// What one metre of depth adds, and its inverse: infinite along an axis to which the ray is parallel.
    direction: Triple<T>,
    inverse: Triple<T>,
    /// 1 where the ray runs upwards or parallel, else 0.
    upwards: Cell,
    /// Depth at which the ray leaves.
    leave: T,
    /// Depth reached, and the cell there.
    z: T,
    cell: Cell,
    /// Level wanted there, the finer of the two mixed ones; it only falls.
    wanted: u8,
    /// Whether it is mixed with the coarser one.
    mixing: bool,
    /// Where that changes.
    until: T,
    /// Places after which the ray is stopped.
    pub(crate) cap: u64,
}

/// A box of cells.
#[derive(Clone, Copy)]
struct Cube {
    low: Cell,
    side: i32,
}

impl<'a, T: Real, S: Source<T>, const LIT: bool> Walk<'a, T, S, LIT> {
    /// A ray at the start of its passage.
    #[inline(always)]
    pub(crate) fn new(
        view: &'a View,
        lens: &'a Lens,
        shading: &'a Shading<T>,
        source: &'a mut S,
        ray: &Ray<T>,
        passage: Passage,
    ) -> Self {
        let (eye, direction) = view.line(ray);
        let at = eye + direction * passage.enter;
        let start = if T::IS_SHORT { passage.enter } else { 0.0 };
        let from = eye + direction * start;
        let (mut cell, mut anchor, mut origin) = ([0; 3], [0; 3], [T::ZERO; 3]);
        let (mut upwards, mut inverse) = ([1; 3], [T::INFINITY; 3]);
        for k in 0..3 {
            // A ray that runs downwards and is on a plane is below it.
            let floor = at[k].floor();
            let down = i32::from(direction[k] < 0.0 && floor == at[k]);
            let [low, high] = view.drawn.map(|p| p[k]);
            cell[k] = (floor as i32 - down).clamp(low, high - 1);
            if T::IS_SHORT {
                anchor[k] = cell[k];
            }
            origin[k] = T::of(from[k] - f64::from(anchor[k]));
            if direction[k] != 0.0 {
                inverse[k] = T::of(1.0 / direction[k]);
                upwards[k] = i32::from(direction[k] > 0.0);
            } else if T::IS_SHORT {
                // Below the plane above it, which is never reached.
                origin[k] = origin[k].min(T::BELOW_ONE);
            }
        }
        let mut walk = Self {
            view,
            lens,
            shading,
            source,
            unit: ray.unit,
            path: T::of(ray.length * view.per_metre),
            gain: T::of(view.gain),
            anchor,
            start,
            origin,
            direction: direction.to_array().map(T::of),
            inverse,
            upwards,
            leave: T::of(passage.leave - start),
            z: T::of(passage.enter - start),
            cell,
            wanted: view.depth,
            mixing: false,
            until: T::ZERO,
            // More than any ray needs: one per plane of the finest lattice and one per level, with room to spare.
            cap: 3 * (8u64 << view.depth) + 2 * u64::from(view.depth) + 16,
        };
        walk.until = walk.change();
        walk
    }

    /// Gathers what the tree adds to the ray, until the ray leaves it or is opaque.
    ///
    /// # Errors
    /// What the source lacks.
    #[inline(always)]
    pub(crate) fn run(mut self, transport: &mut Transport<T>) -> Result<(), S::Error> {
        let [low, high] = self.view.drawn;
        let mut last: Option<Place<S::Brick>> = None;
        for _ in 0..self.cap {
            let inside = (0..3).all(|k| low[k] <= self.cell[k] && self.cell[k] < high[k]);
            if !(inside && self.z < self.leave) {
                return Ok(());
            }
            self.choose_level();
            let place = match last {
                Some(place) if self.serves(&place) => place,
                _ => {
                    let (wanted, mixing) = (self.wanted, self.mixing);
                    let counters = &mut transport.counters;
                    match self.source.descend(self.cell, wanted, mixing, counters)? {
                        Some(place) => place,
                        None => return Ok(()),
                    }
                }
            };
            match self.uniform(&place) {
                Some((cube, until, value)) => self.closed(&place, cube, until, value, transport),
                None => self.voxels(&place, transport),
            }
            if transport.saturated() {
                return Ok(());
            }
            last = Some(place);
        }
        transport.counters.capped += 1;
        Ok(())
    }

    /// log2 of the side of a level's voxel, in finest ones.
    #[inline(always)]
    fn shift(&self, level: u8) -> u32 {
        u32::from(self.view.depth - level)
    }

    /// True if a descent from here would end at this node again, with the same parent.
    #[inline(always)]
    fn serves(&self, place: &Place<S::Brick>) -> bool {
        let shift = self.shift(place.level) + 3;
        let apart = (0..3).fold(0, |d, k| d | (self.cell[k] ^ place.low[k]));
        let as_wanted = (self.wanted, self.mixing) == (place.wanted, place.mixing);
        !place.stands_in && apart >> shift == 0 && (as_wanted || place.terminal && self.wanted > place.level)
    }

    /// A depth of the picture as a depth of the walk.
    #[inline(always)]
    fn depth(&self, z: f64) -> T {
        T::of(z - self.start)
    }

    /// Where wanted level or mixing change next.
    #[inline(always)]
    fn change(&self) -> T {
        let level = usize::from(self.wanted);
        match (self.wanted, self.mixing) {
            (0, _) => T::INFINITY,
            (_, false) => self.depth(self.view.fades[level]),
            (_, true) => self.depth(self.view.faded[level]),
        }
    }

    /// Sets the level that is wanted here, and whether it is mixed with the coarser one.
    #[inline(always)]
    fn choose_level(&mut self) {
        while self.z >= self.until {
            self.mixing = !self.mixing && self.lens.fade > 0.0;
            self.wanted -= u8::from(!self.mixing);
            self.until = self.change();
        }
    }

    /// Share of the wanted level at this depth, where it is mixed.
    #[inline(always)]
    fn weight(&self) -> T {
        let z = T::of(self.start) + self.z;
        let lambda = (T::of(self.view.log2_root) - z.log2()).max(T::of(self.view.least_level));
        let above = lambda - T::whole(i32::from(self.wanted) - 1);
        ((above - T::HALF) / T::of(self.lens.fade) + T::HALF)
            .max(T::ZERO)
            .min(T::ONE)
    }

    /// Depth of a plane that the ray leaves a box through.
    #[inline(always)]
    fn reach(&self, k: usize, plane: T) -> T {
        (plane - self.origin[k]) * self.inverse[k]
    }

    /// The plane, relative to the anchor, through which the ray leaves a box on an axis.
    #[inline(always)]
    fn plane(&self, k: usize, low: i32, side: i32) -> T {
        T::whole(low - self.anchor[k] + self.upwards[k] * side)
    }

    /// The box with one value in which the ray is, and where that ends at the latest; `None` if its middle is to be sampled.
    #[inline(always)]
    fn uniform(&self, place: &Place<S::Brick>) -> Option<(Cube, T, [u8; 4])> {
        let Shown::Constant(value) = place.shown else {
            return None;
        };
        let shift = self.shift(place.level);
        let node = Cube {
            low: place.low,
            side: 8 << shift,
        };
        let level = usize::from(place.level);
        match place.parent {
            None => {
                // The parent comes in when the footprint has grown.
                let ahead = if level == 0 {
                    T::INFINITY
                } else {
                    self.depth(self.view.fades[level])
                };
                let until = if ahead > self.z { ahead } else { T::INFINITY };
                Some((node, until, value))
            }
            Some(Shown::Constant(parent)) => {
                (value[3] == 0 && parent[3] == 0).then(|| (node, self.depth(self.view.faded[level]), value))
            }
            Some(Shown::Brick(_)) => {
                // Parent samples that touch what lies outside reach into the node by the rim only.
                let rim = self.view.rim << shift;
                let inner = Cube {
                    low: place.low.map(|p| p + rim),
                    side: node.side - 2 * rim,
                };
                let inside = (0..3).all(|k| (0..inner.side).contains(&(self.cell[k] - inner.low[k])));
                inside.then(|| (inner, self.depth(self.view.faded[level]), value))
            }
        }
    }

    /// What a path of `dz` metres of depth adds if it has one value of a level; `scale`: voxels of the level in a finest one.
    #[inline(always)]
    fn layer(&self, value: &Value<T>, scale: T, dz: T) -> Layer<T> {
        self.shading
            .layer(value, self.gain, dz * self.path * scale, &self.unit)
    }

    /// Adds a layer that is `dz` metres deep from a depth on.
    #[inline(always)]
    fn add(&self, layer: Layer<T>, z: T, dz: T, transport: &mut Transport<T>) {
        if LIT {
            let z = self.start + z.wide();
            transport.note(&layer, z, dz.wide(), 1.0 / self.view.per_metre);
        }
        transport.under(layer.rgba);
    }

    /// Adds a box of one value, and moves on to where it ends.
    #[inline(always)]
    fn closed(
        &mut self,
        place: &Place<S::Brick>,
        cube: Cube,
        until: T,
        value: [u8; 4],
        transport: &mut Transport<T>,
    ) {
        let planes = [0, 1, 2].map(|k| self.reach(k, self.plane(k, cube.low[k], cube.side)));
        let exit = planes[0].min(planes[1]).min(planes[2]);
        let end = exit.min(until).min(self.leave).max(self.z);
        if value[3] != 0 && end > self.z {
            let scale = T::ONE / T::whole(1 << self.shift(place.level));
            let layer = self.layer(&Value::constant(value), scale, end - self.z);
            self.add(layer, self.z, end - self.z, transport);
        }
        self.z = end;
        self.cell = [0, 1, 2].map(|k| {
            if planes[k] <= end {
                cube.low[k] - 1 + self.upwards[k] * (cube.side + 1)
            } else {
                self.settled(k, cube.low[k], cube.side)
            }
        });
    }

    /// The cell on an axis at the depth reached, within a box that the ray is known to be in.
    #[inline(always)]
    fn settled(&self, k: usize, low: i32, side: i32) -> i32 {
        if side == 1 {
            return low;
        }
        let p = self.origin[k] + self.direction[k] * self.z;
        let floor = p.floor();
        // A ray that runs downwards and is on a plane is below it.
        let down = i32::from(!T::IS_SHORT && self.upwards[k] == 0 && T::whole(floor) == p);
        (floor - down)
            .saturating_add(self.anchor[k])
            .clamp(low, low + side - 1)
    }

    /// Goes through a node voxel by voxel, and adds what is sampled in the middle of each, until the ray leaves the node, or
    /// another level is wanted.
    #[inline(always)]
    fn voxels(&mut self, place: &Place<S::Brick>, transport: &mut Transport<T>) {
        let voxel = self.shift(place.level);
        let shift = voxel + self.lens.segment.0;
        let (side, scale) = (1 << shift, T::ONE / T::whole(1 << voxel));
        let low = [0, 1, 2].map(|k| T::whole(place.low[k] - self.anchor[k]));
        // Segments of several voxels are as occupied as can be.
        let masks = [Some(&place.shown), place.parent.as_ref()].map(|shown| match shown {
            _ if self.lens.segment.0 > 0 => &ALL,
            Some(Shown::Brick(brick)) => brick.occupied(),
            Some(Shown::Constant(color)) if color[3] > 0 => &ALL,
            _ => &NOTHING,
        });
        // A constant may have a closed form in the next voxel, and in the place of what is missing there may be something.
        let once = place.stands_in || matches!(place.shown, Shown::Constant(_));
        // The octant of the node in its parent, in voxels of the node.
        let octant = place.low.map(|p| (p >> (voxel + 3) & 1) << 3);

        let mut at = [0, 1, 2].map(|k| (self.cell[k] - place.low[k]) >> shift);
        let mut plane = [0, 1, 2].map(|k| self.plane(k, place.low[k] + (at[k] << shift), side));
        let mut reach = [0, 1, 2].map(|k| self.reach(k, plane[k]));
        let step = self.upwards.map(|up| 2 * up - 1);
        let advance = step.map(|s| T::whole(s * side));
        let exit = [0, 1, 2].map(|k| self.reach(k, self.plane(k, place.low[k], 8 << voxel)));
        let exit = exit[0].min(exit[1]).min(exit[2]).min(self.leave);
        let stop = if once { -T::INFINITY } else { exit.min(self.until) };
        loop {
            let end = reach[0].min(reach[1]).min(reach[2]).min(self.leave);
            let occupied = is_set(masks[0], at)
                || place.parent.is_some() && is_set(masks[1], [0, 1, 2].map(|k| (at[k] + octant[k]) >> 1));
            if end > self.z {
                if occupied {
                    self.sample(place, &low, octant, scale, end, transport);
                    if transport.saturated() {
                        return;
                    }
                }
                self.z = end;
            }
            for k in 0..3 {
                let crossed = reach[k] <= end;
                at[k] += if crossed { step[k] } else { 0 };
                plane[k] = plane[k] + if crossed { advance[k] } else { T::ZERO };
                reach[k] = self.reach(k, plane[k]);
            }
            if end >= stop {
                break;
            }
        }
        self.cell = [0, 1, 2].map(|k| self.settled(k, place.low[k] + (at[k] << shift), side));
    }

    /// Adds a segment from here to `end` by the values in the middle of its parts.
    #[inline(always)]
    fn sample(
        &mut self,
        place: &Place<S::Brick>,
        low: &Triple<T>,
        octant: Cell,
        scale: T,
        end: T,
        transport: &mut Transport<T>,
    ) {
        let parts = self.lens.segment.1;
        let weight = place.parent.map(|parent| (self.weight(), parent));
        let dz = (end - self.z) / T::whole(parts as i32);
        for part in 0..parts {
            let z = self.z + dz * (T::whole(part as i32) + T::HALF);
            let local = [0, 1, 2].map(|k| (self.origin[k] + self.direction[k] * z - low[k]) * scale);
            let reads_before = transport.counters.texture_reads;
            let mut value = |shown: &Shown<S::Brick>, local| match shown {
                Shown::Constant(color) => Value::constant(*color),
                Shown::Brick(brick) => brick.value(local, &mut transport.counters.texture_reads),
            };
            let mut layer = self.layer(&value(&place.shown, local), scale, dz);
            if let Some((weight, parent)) = weight {
                let local = [0, 1, 2].map(|k| (local[k] + T::whole(octant[k])) * T::HALF);
                let coarse = self.layer(&value(&parent, local), scale * T::HALF, dz);
                layer = mix(&coarse, &layer, weight);
            }
            transport.counters.samples += u64::from(transport.counters.texture_reads > reads_before);
            self.add(layer, z - dz * T::HALF, dz, transport);
            if transport.saturated() {
                return;
            }
        }
    }
}

/// One bit for each voxel of a brick, x fastest, a word for each layer in z.
pub(crate) type Mask = [u64; 8];

/// Every voxel.
pub(crate) static ALL: Mask = [u64::MAX; 8];
/// No voxel.
static NOTHING: Mask = [0; 8];

#[inline(always)]
fn is_set(mask: &Mask, [x, y, z]: Cell) -> bool {
    mask[z as usize & 7] >> (x & 7 | (y & 7) << 3) & 1 == 1
}
