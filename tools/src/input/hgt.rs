//! SRTM tiles (`.hgt`): a square of big-endian 16-bit metres from the north-west, whose name says where it lies.
//!
//! `N46W122.hgt` has samples from 46 to 47 degrees north and from 122 to 121 degrees west, both edges included.

use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use glam::DVec2;

use super::block_cache::Cell;
use super::cells::Rows;
use super::crs::Crs;
use super::error::InputError;
use super::georef::{GeoTransform, Placement};
use super::height_samples::Metres;
use super::image_file::check_size;

/// Samples of a side.
pub(crate) fn side(path: &Path) -> Result<u32, InputError> {
    let bytes = fs::metadata(path).map_err(|e| InputError::io(path, e))?.len();
    let side = (bytes / 2).isqrt();
    if side < 2 || side * side * 2 != bytes {
        return Err(InputError::damaged(
            path,
            format!(
                "{bytes} bytes are not a square of 16-bit heights: the file is cut short or no SRTM tile"
            ),
        ));
    }
    let side = u32::try_from(side).unwrap_or(u32::MAX);
    check_size(path, side, side)?;
    Ok(side)
}

/// Longitude and latitude of the south-west sample, from the name.
fn corner(path: &Path) -> Option<DVec2> {
    let name = path.file_name()?.to_str()?.to_ascii_uppercase();
    let signed = |text: &str, positive: &str, negative: &str, most: i32| {
        let sign = match text.get(..1)? {
            s if s == positive => 1,
            s if s == negative => -1,
            _ => return None,
        };
        let digits = text.get(1..).filter(|d| d.bytes().all(|b| b.is_ascii_digit()))?;
        let value: i32 = digits.parse().ok()?;
        (value <= most).then_some(f64::from(sign * value))
    };
    Some(DVec2::new(
        signed(name.get(3..7)?, "E", "W", 180)?,
        signed(name.get(..3)?, "N", "S", 90)?,
    ))
}

pub(crate) fn placement(path: &Path) -> Result<Placement, InputError> {
    let corner = corner(path).ok_or_else(|| {
        InputError::georef(
            path,
            "an SRTM tile is placed by its name, such as N46W122.hgt, and this is none",
        )
    })?;
    let side = side(path)?;
    let step = 1.0 / f64::from(side - 1);
    Ok(Placement {
        transform: Some(GeoTransform::north_up(corner - 0.5 * step, step, side)),
        crs: Crs {
            name: Some("EPSG:4326".into()),
            geographic: true,
            ..Crs::default()
        },
        vertical_unit: Some(1.0),
        ..Placement::default()
    })
}

/// The heights of a tile.
pub(crate) struct Tile {
    path: PathBuf,
    file: BufReader<File>,
    side: u32,
    line: Vec<[u8; 2]>,
    metres: Metres,
}

impl Tile {
    pub(crate) fn open(path: &Path, metres: Metres) -> Result<Self, InputError> {
        let side = side(path)?;
        Ok(Self {
            path: path.to_path_buf(),
            file: BufReader::new(File::open(path).map_err(|e| InputError::io(path, e))?),
            side,
            line: vec![[0; 2]; side as usize],
            metres,
        })
    }
}

impl Rows for Tile {
    fn size(&self) -> (u32, u32) {
        (self.side, self.side)
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        let line = self.line.as_flattened_mut();
        self.file
            .read_exact(line)
            .map_err(|e| InputError::io(&self.path, e))?;
        for (cell, height) in row.iter_mut().zip(&self.line) {
            *cell = self.metres.cell(i16::from_be_bytes(*height).into());
        }
        Ok(())
    }
}
