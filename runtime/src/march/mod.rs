//! How a ray gathers light from trees: the rules of `docs/raycasting.md` on the CPU, in f64 and in f32.
//!
//! The CPU reference marches in f64 through the files' samples; the CPU caster in f32 through pools like the GPU's. Both run this code,
//! each with its own [`Source`]: how a ray gets from a cell to what is shown there, and how bricks are filtered. It shares nothing with
//! the GPU's caster.
//!
//! | module | what |
//! |---|---|
//! | `real` | the two precisions |
//! | `view` | a tree as a picture's rays see it; where a ray enters and leaves it |
//! | `walk` | one ray through one tree, segment by segment |
//! | `shade` | opacity, light, compositing |
//! | `light` | rays toward the sun and the sky |
//!
//! Plain values: any thread.

mod light;
mod real;
mod shade;
mod view;
mod walk;

pub(crate) use light::{Cone, LIFT, Lights, SKY_MIDDLE, SKY_TILT, SKY_WIDTH};
pub(crate) use shade::{Shading, Transport, Triple, Value};
pub(crate) use view::{Lens, Passage, View};
pub(crate) use walk::{ALL, Mask, Ray, Walk};

use crate::picture::RayCounters;

/// A finest cell of a tree, or something else that is counted in them.
pub(crate) type Cell = [i32; 3];

/// What a node shows at its own level.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shown<B> {
    /// One stored colour everywhere.
    Constant([u8; 4]),
    /// A brick.
    Brick(B),
}

/// The node a descent ended at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place<B> {
    /// Its level.
    pub(crate) level: u8,
    /// The level that was asked for, and whether it was to be mixed with the coarser one.
    pub(crate) wanted: u8,
    /// See `wanted`.
    pub(crate) mixing: bool,
    /// There are no children.
    pub(crate) terminal: bool,
    /// It is shown in the place of what is not there yet: the next cell may have more.
    pub(crate) stands_in: bool,
    /// Its first cell.
    pub(crate) low: Cell,
    /// What it shows.
    pub(crate) shown: Shown<B>,
    /// What its parent shows, where the two are mixed.
    pub(crate) parent: Option<Shown<B>>,
}

/// The samples of a brick.
pub(crate) trait Brick<T>: Copy {
    /// The voxels in which, or on whose faces, some value may be above nothing.
    fn occupied(&self) -> &Mask;

    /// Trilinear value at a position in the brick (voxels of its level from its low corner, 0..8 per axis, taken as that beyond),
    /// which is rounded to 1/256 voxel. `reads` counts the trilinear reads: one for an empty place, else colour, normal, and the
    /// opacities against the axes if there are any.
    fn value(&self, local: Triple<T>, reads: &mut u64) -> Value<T>;
}

/// Where the nodes of one tree come from.
pub(crate) trait Source<T> {
    /// Its bricks.
    type Brick: Brick<T>;
    /// Why there may be none.
    type Error;

    /// Goes from the root towards a cell until the wanted level or a node without children. With `mixing` the parent of a node of
    /// the wanted level is fetched, too, unless that is the root. `None` if there is nothing to show.
    fn descend(
        &mut self,
        cell: Cell,
        wanted: u8,
        mixing: bool,
        counters: &mut RayCounters,
    ) -> Result<Option<Place<Self::Brick>>, Self::Error>;
}
