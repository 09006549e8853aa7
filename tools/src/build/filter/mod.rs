//! How a coarser level is made of a finer one: the filters, and what each keeps of a level beside what is stored.
//!
//! All of them agree about solid (its mean), and about colour and normal (means weighted by the part that surfaces meet); they
//! differ in the opacity of skins. What a filter gives a sample depends on its place, its level and the finer samples
//! around it only, so trees agree at borders with every filter. `docs/decisions.md` §3 compares them.

mod coverage;
mod outline;
mod step;

use brickfell_formats::layout::SampleLayout;

use self::coverage::Coverage;
pub(crate) use self::coverage::{Cover, Skins};
pub(crate) use self::outline::{Outlines, thinned};
use self::step::{Parts, Rule, coarser};
use super::blocks::Blocks;
use super::cells::Cells;
use super::lattice::CellBox;
use super::sample::{SKIN_MAX, Sample};
use super::spill::{Reader, Writer, read_blocks, write_blocks};

/// How the opacity of open surfaces goes up a level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum Filter {
    /// The mean of the parts' opacities
    Mean,
    /// Their mean to the power of one minus the mean, taken of the level two below (Pecoraro 2015)
    Pow,
    /// Twice the mean, at most opaque
    Double,
    /// The covered part of the cross-section, the largest of the three axes'
    Coverage,
    /// The covered part of the cross-section, for each axis; bricks take half as much again in the pools
    #[default]
    Axes,
}

impl Filter {
    /// Whether it asks for what finest samples cover.
    pub(crate) fn covers(self) -> bool {
        matches!(self, Self::Coverage | Self::Axes)
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Pow => "pow",
            Self::Double => "double",
            Self::Coverage => "coverage",
            Self::Axes => "axes",
        }
    }
}

/// The samples of one level under construction, and what its filter keeps beside them.
#[derive(Debug)]
pub(crate) struct Level {
    pub(crate) samples: Blocks<Cells<Sample>>,
    kept: Kept,
}

/// What is kept of a level, in blocks as its samples are.
#[derive(Debug)]
enum Kept {
    Nothing,
    Means(Blocks<Cells<f32>>),
    Covers(Blocks<Cells<Cover>>),
}

/// A level to be made: where, and from what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    pub(crate) layout: SampleLayout,
    /// The coarser level: its voxel is 2 to this power finest voxels.
    pub(crate) mip: u8,
    /// Its extent, in its own cells. Those of which the finer level lacks a part are meaningless.
    pub(crate) cells: CellBox,
}

impl Level {
    /// The finest one, with what its samples cover if the filter asks for it.
    pub(crate) fn finest(samples: Blocks<Cells<Sample>>, covers: Option<Blocks<Cells<Cover>>>) -> Self {
        Self {
            samples,
            kept: covers.map_or(Kept::Nothing, Kept::Covers),
        }
    }

    /// The next coarser level.
    pub(crate) fn coarser(&self, filter: Filter, target: &Target) -> Self {
        let plain = |(samples, _)| (samples, Kept::Nothing);
        let (samples, kept) = match (filter, &self.kept) {
            (Filter::Mean, _) => plain(coarser(&Mean, &self.samples, None, target)),
            (Filter::Double, _) => plain(coarser(&Double, &self.samples, None, target)),
            (Filter::Pow, kept) => {
                let means = if let Kept::Means(m) = kept { Some(m) } else { None };
                let (samples, means) = coarser(&Pow, &self.samples, means, target);
                (samples, Kept::Means(means))
            }
            (Filter::Coverage | Filter::Axes, kept) => {
                let covers = if let Kept::Covers(c) = kept { Some(c) } else { None };
                let (samples, covers) = coarser(&Coverage, &self.samples, covers, target);
                (samples, Kept::Covers(covers))
            }
        };
        Self { samples, kept }
    }

    /// Writes what the blocks in a box of cells hold.
    pub(crate) fn write(&self, cells: &CellBox, out: &mut Writer) {
        write_blocks(&self.samples, cells, out);
        match &self.kept {
            Kept::Nothing => out.put(&0u8),
            Kept::Means(means) => {
                out.put(&1u8);
                write_blocks(means, cells, out);
            }
            Kept::Covers(covers) => {
                out.put(&2u8);
                write_blocks(covers, cells, out);
            }
        }
    }

    /// A level over an extent (cells), of what was written of some boxes that do not meet.
    pub(crate) fn read(extent: &CellBox, parts: &mut [(CellBox, Reader)], filter: Filter) -> Option<Self> {
        let samples = read_blocks(extent, parts)?;
        let mut kinds = Vec::new();
        for (_, part) in parts.iter_mut() {
            kinds.push(part.get::<u8>()?);
        }
        let kept = match filter {
            Filter::Mean | Filter::Double => Kept::Nothing,
            Filter::Pow => Kept::Means(read_blocks(extent, parts)?),
            Filter::Coverage | Filter::Axes => Kept::Covers(read_blocks(extent, parts)?),
        };
        let kind = match &kept {
            Kept::Nothing => 0,
            Kept::Means(_) => 1,
            Kept::Covers(_) => 2,
        };
        kinds.iter().all(|k| *k == kind).then_some(Self { samples, kept })
    }

    /// Skins by what samples cover, if the filter goes by that. `neighbours` tells whether the level reaches two cells beyond
    /// what is stored of it.
    pub(crate) fn skins(&self, filter: Filter, neighbours: bool) -> Option<Skins<'_>> {
        match &self.kept {
            Kept::Covers(covers) => Some(Skins {
                covers,
                neighbours,
                axes: filter == Filter::Axes,
            }),
            _ => None,
        }
    }
}

struct Mean;

impl Rule for Mean {
    type Kept = ();

    fn finest(&self, _: &Sample) {}

    fn up(&self, mean: f32, _: &Parts<()>) -> (f32, ()) {
        (mean, ())
    }
}

/// A plane through a voxel meets half of its eight parts and stays what it is, a line a quarter and halves, a speck an
/// eighth and quarters: so do their cross-sections.
struct Double;

impl Rule for Double {
    type Kept = ();

    fn finest(&self, _: &Sample) {}

    fn up(&self, mean: f32, _: &Parts<()>) -> (f32, ()) {
        ((2.0 * mean).min(SKIN_MAX), ())
    }
}

/// Pecoraro 2015: stored alphas, 1 the most; of 4×4×4 samples two levels below, of 2×2×2 where there is but one. A level
/// keeps the mean of its parts' alphas, since the mean of those means is the mean over 4×4×4.
struct Pow;

impl Rule for Pow {
    type Kept = f32;

    fn finest(&self, sample: &Sample) -> f32 {
        sample.skin() / SKIN_MAX
    }

    fn up(&self, mean: f32, parts: &Parts<f32>) -> (f32, f32) {
        let below = parts.mean();
        (SKIN_MAX * below.powf(1.0 - below), mean / SKIN_MAX)
    }
}
