//! PNG files row by row.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Reader, Transformations};

use super::block_cache::Cell;
use super::cells::Rows;
use super::error::InputError;
use super::image_file::file_start;

/// What the decoder may use for rows and text: rows of the longest side that is read take less.
const LIMIT: usize = 256 << 20;

pub(crate) type PngReader = Reader<BufReader<File>>;

/// Opens a PNG file; `None` if it is another kind, or interlaced, and so can only be decoded as a whole.
/// Palettes and small depths are expanded to 8 bits.
pub(crate) fn open(path: &Path) -> Result<Option<PngReader>, InputError> {
    if file_start(path)?.get(..8) != Some(b"\x89PNG\r\n\x1a\n") {
        return Ok(None);
    }
    let file = File::open(path).map_err(|e| InputError::io(path, e))?;
    let mut decoder =
        Decoder::new_with_limits(BufReader::with_capacity(1 << 16, file), Limits { bytes: LIMIT });
    decoder.set_transformations(Transformations::EXPAND);
    let reader = decoder.read_info().map_err(|e| fault(path, e))?;
    Ok((!reader.info().interlaced).then_some(reader))
}

/// Samples of a pixel, and whether they have 16 bits.
pub(crate) fn layout(reader: &PngReader) -> (usize, bool) {
    let (color, depth) = reader.output_color_type();
    let channels = match color {
        ColorType::Grayscale | ColorType::Indexed => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
    };
    (channels, depth == BitDepth::Sixteen)
}

fn fault(path: &Path, error: DecodingError) -> InputError {
    match error {
        DecodingError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            InputError::damaged(path, "the image file is cut short")
        }
        e => InputError::damaged(path, e),
    }
}

/// Rows of a PNG file, turned into cells by a function.
pub(crate) struct PngRows<F> {
    path: PathBuf,
    reader: PngReader,
    convert: F,
}

impl<F: FnMut(&[u8], &mut [Cell])> PngRows<F> {
    pub(crate) fn new(path: &Path, reader: PngReader, convert: F) -> Self {
        Self {
            path: path.to_path_buf(),
            reader,
            convert,
        }
    }
}

impl<F: FnMut(&[u8], &mut [Cell])> Rows for PngRows<F> {
    fn size(&self) -> (u32, u32) {
        (self.reader.info().width, self.reader.info().height)
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        match self.reader.next_row() {
            Ok(Some(line)) => (self.convert)(line.data(), row),
            Ok(None) => return Err(InputError::damaged(&self.path, "the image file is cut short")),
            Err(e) => return Err(fault(&self.path, e)),
        }
        Ok(())
    }
}
