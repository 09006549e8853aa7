//! ESRI ASCII grids (`.asc`): a header of keys and numbers, then heights as text, row by row from the north.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use glam::DVec2;

use super::block_cache::Cell;
use super::cells::Rows;
use super::error::InputError;
use super::georef::{GeoTransform, Placement};
use super::height_samples::Metres;
use super::image_file::check_size;

/// Longest word that is taken for a number.
const MAX_WORD: usize = 64;

/// What stands before the heights.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Lower-left outer corner.
    corner: DVec2,
    pixel: DVec2,
    nodata: f64,
}

/// Words of a text file, with the line they are in.
struct Words {
    path: PathBuf,
    file: BufReader<File>,
    line: usize,
    word: String,
}

impl Words {
    fn open(path: &Path) -> Result<Self, InputError> {
        Ok(Self {
            path: path.to_path_buf(),
            file: BufReader::with_capacity(1 << 16, File::open(path).map_err(|e| InputError::io(path, e))?),
            line: 1,
            word: String::new(),
        })
    }

    fn fault(&self, what: impl Into<String>) -> InputError {
        InputError::line(&self.path, self.line, what)
    }

    /// The next word; empty at the end of the file.
    fn next(&mut self) -> Result<&str, InputError> {
        self.word.clear();
        loop {
            let bytes = self.file.fill_buf().map_err(|e| InputError::io(&self.path, e))?;
            if bytes.is_empty() {
                return Ok(&self.word);
            }
            let mut used = 0;
            let mut whole = false;
            for byte in bytes {
                if byte.is_ascii_whitespace() {
                    whole = !self.word.is_empty();
                    if whole {
                        break;
                    }
                    self.line += usize::from(*byte == b'\n');
                } else if byte.is_ascii_graphic() && self.word.len() < MAX_WORD {
                    self.word.push(char::from(*byte));
                } else {
                    let word = std::mem::take(&mut self.word);
                    return Err(self.fault(format!("'{word}…' is not a number")));
                }
                used += 1;
            }
            self.file.consume(used);
            if whole {
                return Ok(&self.word);
            }
        }
    }

    fn number(&mut self) -> Result<f64, InputError> {
        match self.next()?.parse() {
            Ok(number) => Ok(number),
            Err(_) if self.word.is_empty() => Err(InputError::damaged(
                &self.path,
                format!("line {}: the file is cut short", self.line),
            )),
            Err(_) => {
                let what = format!("'{}' is not a number", self.word);
                Err(self.fault(what))
            }
        }
    }
}

impl Header {
    /// Reads the header of a file.
    pub(crate) fn read(path: &Path) -> Result<Self, InputError> {
        Ok(open(path)?.0)
    }

    pub(crate) fn placement(&self) -> Placement {
        Placement {
            transform: Some(GeoTransform {
                origin: self.corner + DVec2::new(0.0, self.pixel.y * f64::from(self.height)),
                column: DVec2::new(self.pixel.x, 0.0),
                row: DVec2::new(0.0, -self.pixel.y),
            }),
            nodata: Some(self.nodata),
            ..Placement::default()
        }
    }
}

/// The header, the words behind it, and the first height, which had to be read to know where the header ends.
fn open(path: &Path) -> Result<(Header, Words, f64), InputError> {
    let mut words = Words::open(path)?;
    let (mut size, mut corner, mut centred) = ([None; 2], [None; 2], [false; 2]);
    let mut pixel = [None; 2];
    // What ESRI's programs write where the header is silent.
    let mut nodata = -9999.0;
    let first = loop {
        let word = words.next()?.to_ascii_lowercase();
        if let Ok(first) = word.parse::<f64>() {
            break first;
        }
        match word.as_str() {
            "ncols" => size[0] = Some(words.number()?),
            "nrows" => size[1] = Some(words.number()?),
            "xllcorner" | "xllcenter" => {
                (corner[0], centred[0]) = (Some(words.number()?), word.ends_with("center"))
            }
            "yllcorner" | "yllcenter" => {
                (corner[1], centred[1]) = (Some(words.number()?), word.ends_with("center"))
            }
            "cellsize" => pixel = [Some(words.number()?); 2],
            "dx" => pixel[0] = Some(words.number()?),
            "dy" => pixel[1] = Some(words.number()?),
            "nodata_value" | "nodata" => nodata = words.number()?,
            "" => return Err(InputError::damaged(path, "the grid has no heights")),
            _ => return Err(words.fault(format!("'{word}' is no key of an ASCII grid"))),
        }
    };
    let ([Some(w), Some(h)], [Some(x), Some(y)], [Some(dx), Some(dy)]) = (size, corner, pixel) else {
        return Err(words.fault("the header needs ncols, nrows, xllcorner, yllcorner and cellsize"));
    };
    let whole = |v: f64| (v.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&v)).then_some(v as u32);
    let (Some(width), Some(height)) = (whole(w), whole(h)) else {
        return Err(words.fault(format!("{w} columns and {h} rows are not a size")));
    };
    check_size(path, width, height)?;
    let centre = [0, 1].map(|k| if centred[k] { 0.5 } else { 0.0 });
    let header = Header {
        width,
        height,
        corner: DVec2::new(x - centre[0] * dx, y - centre[1] * dy),
        pixel: DVec2::new(dx, dy),
        nodata,
    };
    let placed = header.pixel.min_element() > 0.0
        && header.placement().transform.is_some_and(|t| t.origin.is_finite());
    if !placed {
        return Err(words.fault("the corner and the cell size are not finite, or the size is not positive"));
    }
    // Every height takes a digit and, but for the last, a space.
    let bytes = fs::metadata(path).map_err(|e| InputError::io(path, e))?.len();
    if u64::from(width) * u64::from(height) > bytes.div_ceil(2) {
        return Err(InputError::damaged(
            path,
            format!("{bytes} bytes are too few for {width} x {height} heights: the file is cut short"),
        ));
    }
    Ok((header, words, first))
}

/// The heights of a file.
pub(crate) struct Grid {
    pub(crate) header: Header,
    words: Words,
    first: Option<f64>,
    metres: Metres,
}

impl Grid {
    pub(crate) fn open(path: &Path, metres: Metres) -> Result<Self, InputError> {
        let (header, words, first) = open(path)?;
        Ok(Self {
            header,
            words,
            first: Some(first),
            metres,
        })
    }
}

impl Rows for Grid {
    fn size(&self) -> (u32, u32) {
        (self.header.width, self.header.height)
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        for cell in row {
            let height = match self.first.take() {
                Some(first) => first,
                None => self.words.number()?,
            };
            *cell = self.metres.cell(height);
        }
        Ok(())
    }
}
