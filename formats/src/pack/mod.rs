//! Packed payloads: the samples of a chunk, each by what is known of it from its neighbours.
//!
//! | module | what |
//! |---|---|
//! | [`grid`] | the samples in their places, with their neighbours |
//! | [`opacity`] | where there are any, and how opaque they are |
//! | [`looks`] | their colours and normals |
//! | [`tables`] | what is stored of a colour or normal at an alpha |
//! | [`coder`] | symbols by what is expected, as bytes |
//!
//! Encoder and decoder run the same model; only the coder under it differs ([`coder::Coder`]). All that the model looks at is either
//! behind it or in a pass that is done, and every estimate begins anew with each chunk. A sample takes at most 40
//! symbols, and nothing is allocated by what a payload says.

mod coder;
mod grid;
mod looks;
mod opacity;
mod tables;

use coder::{Coder, Decoder, Encoder};
use grid::PARTIAL;
use looks::Looks;
use opacity::{Classes, Opacities};

pub(crate) use grid::Grid;

use crate::error::FormatError;

/// The payload of a grid whose samples are set.
pub(crate) fn encode(grid: &mut Grid) -> Vec<u8> {
    let mut coder = Encoder::new();
    code(&mut coder, grid);
    coder.finish()
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
    Classes::new().code(coder, grid);
    let mut opacities = Opacities::new(coder, grid);
    let mut looks = Looks::new(coder, grid);
    for column in grid.columns() {
        if coder.failed() {
            return;
        }
        for at in column.clone() {
            if grid.class[at] == PARTIAL {
                looks.surface(coder, grid, at, column.end);
                opacities.code(coder, grid, at);
                looks.stored(coder, grid, at);
            }
        }
    }
    for column in grid.columns() {
        if coder.failed() {
            return;
        }
        looks.solid(coder, grid, column);
    }
}
