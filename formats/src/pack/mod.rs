//! Packed payloads: the samples of a chunk, each by what is known of it from its neighbours.
//!
//! | module | what |
//! |---|---|
//! | [`grid`] | the samples in their places, with their neighbours |
//! | [`classes`] | where there are any |
//! | [`opacity`] | how opaque they are |
//! | [`slope`] | where surfaces are, and how steep |
//! | [`looks`] | colours and normals of surfaces |
//! | [`solid`] | those of solid |
//! | [`nodes`] | nodes of an octree's level, apart from any chunk |
//! | [`tables`] | what is stored of a colour or normal at an alpha |
//! | [`coder`] | symbols by what is expected, as bytes |
//! | [`meter`] | what parts of a payload take |
//!
//! Encoder and decoder run the same model; only the coder under it differs ([`coder::Coder`]). All that the model looks at is either
//! behind it or in a pass that is done, and every estimate begins anew with each chunk. A sample takes at most 48
//! symbols, and nothing is allocated by what a payload says.

mod classes;
mod coder;
mod grid;
mod looks;
mod meter;
mod nodes;
mod opacity;
mod slope;
mod solid;
mod tables;

use classes::Classes;
use coder::{Coder, Decoder, Encoder};
use looks::Looks;
use meter::Meter;
use opacity::Opacities;
use solid::Solids;

pub(crate) use grid::Grid;
pub use meter::{Costs, Part};
pub(crate) use nodes::{decode_nodes, encode_nodes, packed_nodes_bytes};

use crate::error::FormatError;
use crate::steps::Steps;

/// The payload of a grid whose samples are set.
pub(crate) fn encode(grid: &mut Grid) -> Vec<u8> {
    let mut coder = Encoder::new();
    code(&mut coder, grid);
    coder.finish()
}

/// What is stored of the look of a sample in steps: of one that is there already, if what is stored is also of that, else of the
/// nearest to the middle of those it is of. What is of no look stays.
pub(crate) fn in_steps(color: [u8; 4], normal: [i8; 4], error: u8) -> ([u8; 4], [i8; 4]) {
    let ([r, g, b, alpha], [x, y, z, _]) = (color, normal);
    let [x, y, z] = [x, y, z].map(|n| tables::flip(n.cast_unsigned()));
    let stored = [r, g, b, x, y, z];
    let bounds = tables::looks(alpha, &stored);
    if tables::stored(alpha, &bounds.map(|[first, _]| first)) != stored {
        return (color, normal);
    }
    let steps = Steps::within(error);
    let look = std::array::from_fn(|k| {
        let (zero, [low, high]) = (tables::ZERO[k], bounds[k]);
        let [first, last] = steps.in_range(zero, bounds[k]);
        if first <= last {
            steps.code(zero, first)
        } else {
            steps.nearest(zero, low.midpoint(high))
        }
    });
    let [r, g, b, x, y, z] = tables::stored(alpha, &look);
    let [x, y, z] = [x, y, z].map(|n| tables::flip(n).cast_signed());
    ([r, g, b, alpha], [x, y, z, 0])
}

/// What the parts of that payload take.
pub(crate) fn costs(grid: &mut Grid) -> Costs {
    let mut meter = Meter::new();
    code(&mut meter, grid);
    meter.costs
}

/// Reads the samples of a grid in which they are announced.
///
/// # Errors
/// If the samples do not end with the payload.
pub(crate) fn decode(bytes: &[u8], grid: &mut Grid) -> Result<(), FormatError> {
    let mut coder = Decoder::new(bytes);
    code(&mut coder, grid);
    if coder.is_done() {
        return Ok(());
    }
    Err(FormatError::file(
        "packed samples do not end where the payload does",
    ))
}

/// Codes all samples; gives up when bytes run out.
fn code<C: Coder>(coder: &mut C, grid: &mut Grid) {
    Classes::new(grid).code(coder, grid);
    let mut opacities = Opacities::new(coder, grid);
    let mut looks = Looks::new(coder, grid);
    for column in grid.inside() {
        if coder.failed() {
            return;
        }
        if !grid.axes {
            opacities.column(coder, grid, column);
            continue;
        }
        for place in grid::bits(grid.columns[column].partial()) {
            let at = column * grid.height + place;
            looks.surface(coder, grid, at);
            opacities.code(coder, grid, at);
            looks.stored(coder, grid, at);
        }
    }
    if !grid.axes {
        for column in grid.inside() {
            if coder.failed() {
                return;
            }
            looks.column(coder, grid, column);
        }
    }
    let mut solids = Solids::new(grid);
    for column in grid.inside() {
        if coder.failed() {
            return;
        }
        solids.code(coder, &mut looks, grid, column);
    }
}
