//! USGS digital elevation models (`.dem`): text in records of 1024 bytes, a header and then profiles from south to north.
//!
//! "Standards for Digital Elevation Models", part 2 (USGS, 1998): fixed columns, Fortran numbers. Profiles go from west to
//! east, each with its own first sample, so a quadrangle of a UTM zone fills a rectangle only partly; the rest is nodata.
//! Placed in UTM (metres) or degrees (arc seconds); other systems of the standard are taken as an unnamed plane.

use std::fs::{self, File};
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use glam::DVec2;

use super::block_cache::{Cell, Held, RasterCache};
use super::cells::{CELL, Rows};
use super::crs::Crs;
use super::error::InputError;
use super::georef::{GeoTransform, Placement};
use super::height_samples::Metres;
use super::image_file::check_size;

const RECORD: usize = 1024;
/// Heights in the first record of a profile and in each that follows, six characters each.
const FIRST: usize = 146;
const MORE: usize = 170;
const WIDTH: usize = 6;
/// Value of heights that are not known.
const VOID: f64 = -32767.0;

/// The first record of a file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    system: i64,
    zone: i64,
    unit: i64,
    vertical_unit: i64,
    datum: i64,
    /// Steps in x, y and z, in the units of the file.
    step: [f64; 3],
    /// Size in samples, and place of the south-west one.
    pub(crate) size: (u32, u32),
    corner: DVec2,
    profiles: Vec<Profile>,
}

/// Where a profile is in the file, and its first sample in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Profile {
    offset: u64,
    count: usize,
    start: DVec2,
    /// Added to every height.
    base: f64,
}

/// A record, for reading numbers out of it.
struct Record<'a> {
    path: &'a Path,
    offset: u64,
    bytes: &'a [u8],
}

impl Record<'_> {
    fn text(&self, from: usize, to: usize) -> &str {
        let bytes = self.bytes.get(from..to).unwrap_or_default();
        std::str::from_utf8(bytes).unwrap_or("?").trim()
    }

    fn fault(&self, from: usize, what: &str) -> InputError {
        let at = self.offset + from as u64;
        InputError::damaged(
            self.path,
            format!("byte {at}: '{}' is not {what}", self.text(from, from + WIDTH)),
        )
    }

    fn integer(&self, from: usize, to: usize) -> Result<i64, InputError> {
        self.text(from, to)
            .parse()
            .map_err(|_| self.fault(from, "a whole number"))
    }

    /// A Fortran number, with D or E before its exponent.
    fn real(&self, from: usize, to: usize) -> Result<f64, InputError> {
        let text = self.text(from, to).replace(['D', 'd'], "E");
        let number = text.parse().ok().filter(|v: &f64| v.is_finite());
        number.ok_or_else(|| self.fault(from, "a number"))
    }
}

fn read_record<'a>(
    path: &'a Path,
    file: &mut (impl Read + Seek),
    offset: u64,
    bytes: &'a mut Vec<u8>,
) -> Result<Record<'a>, InputError> {
    bytes.clear();
    file.seek(SeekFrom::Start(offset))
        .and_then(|_| file.take(RECORD as u64).read_to_end(bytes))
        .map_err(|e| InputError::io(path, e))?;
    Ok(Record { path, offset, bytes })
}

impl Header {
    /// Reads the header and the places of the profiles.
    pub(crate) fn read(path: &Path) -> Result<Self, InputError> {
        let mut file = BufReader::new(File::open(path).map_err(|e| InputError::io(path, e))?);
        let length = fs::metadata(path).map_err(|e| InputError::io(path, e))?.len();
        let mut bytes = Vec::new();
        let record = read_record(path, &mut file, 0, &mut bytes)?;
        if record.bytes.len() < RECORD {
            return Err(InputError::damaged(
                path,
                "the first record of the USGS DEM is cut short",
            ));
        }
        let datum = record.text(890, 892);
        let mut header = Header {
            system: record.integer(156, 162)?,
            zone: record.integer(162, 168)?,
            unit: record.integer(528, 534)?,
            vertical_unit: record.integer(534, 540)?,
            // Files older than the field are on NAD27.
            datum: if datum.is_empty() {
                1
            } else {
                record.integer(890, 892)?
            },
            step: [
                record.real(816, 828)?,
                record.real(828, 840)?,
                record.real(840, 852)?,
            ],
            size: (0, 0),
            corner: DVec2::ZERO,
            profiles: Vec::new(),
        };
        if !header.step.iter().all(|s| (1e-6..=1e6).contains(s)) {
            return Err(InputError::damaged(
                path,
                "the steps of the USGS DEM are not positive numbers",
            ));
        }
        let count = record.integer(858, 864)?;
        // Each profile has a record of its own at least; the last may lack what follows its heights.
        if count < 1 || count as u64 > length / RECORD as u64 {
            return Err(InputError::damaged(
                path,
                format!("{count} profiles do not fit {length} bytes"),
            ));
        }
        let mut offset = RECORD as u64;
        for number in 1..=count {
            let record = read_record(path, &mut file, offset, &mut bytes)?;
            let samples = usize::try_from(record.integer(12, 18)?).unwrap_or(0);
            let records = 1 + samples.saturating_sub(FIRST).div_ceil(MORE);
            let heights = offset + 144 + (samples.min(FIRST) * WIDTH) as u64;
            let end = match records {
                1 => heights,
                n => offset + ((n - 1) * RECORD + (samples - FIRST - (n - 2) * MORE) * WIDTH) as u64,
            };
            if samples == 0 || end > length {
                return Err(InputError::damaged(
                    path,
                    format!(
                        "byte {offset}: profile {number} of {count} has {samples} heights, which do not fit: the file is cut short"
                    ),
                ));
            }
            header.profiles.push(Profile {
                offset,
                count: samples,
                start: DVec2::new(record.real(24, 48)?, record.real(48, 72)?),
                base: record.real(72, 96)?,
            });
            offset += (records * RECORD) as u64;
        }
        header.measure(path)?;
        Ok(header)
    }

    /// Finds the rectangle of all profiles.
    fn measure(&mut self, path: &Path) -> Result<(), InputError> {
        let step = DVec2::new(self.step[0], self.step[1]);
        let starts = || {
            self.profiles
                .iter()
                .map(|p| (p.start, p.start + DVec2::new(0.0, (p.count - 1) as f64 * step.y)))
        };
        let min = starts().fold(DVec2::INFINITY, |m, (a, _)| m.min(a));
        let max = starts().fold(DVec2::NEG_INFINITY, |m, (_, b)| m.max(b));
        let size = ((max - min) / step).round() + 1.0;
        let samples: usize = self.profiles.iter().map(|p| p.count).sum();
        // A quadrangle fills most of its rectangle; what would not is a damaged number.
        if !size.is_finite() || size.x * size.y > 16.0 * samples as f64 + 65536.0 {
            return Err(InputError::damaged(
                path,
                format!(
                    "the profiles of {samples} heights lie in {} x {} cells",
                    size.x, size.y
                ),
            ));
        }
        self.size = (size.x as u32, size.y as u32);
        self.corner = min;
        check_size(path, self.size.0, self.size.1)
    }

    /// Column of a profile, and the row of its first sample, counted from the south.
    fn cell(&self, profile: &Profile) -> (usize, usize) {
        let at = ((profile.start - self.corner) / DVec2::new(self.step[0], self.step[1])).round();
        (at.x as usize, at.y as usize)
    }

    pub(crate) fn placement(&self, path: &Path) -> Result<Placement, InputError> {
        let (unit, geographic) = match (self.unit, self.system) {
            (3, _) => (1.0 / 3600.0, true),
            (0, _) => (1f64.to_degrees(), true),
            (2, _) => (1.0, false),
            (1, _) => (1.0, false),
            (other, _) => {
                return Err(InputError::georef(
                    path,
                    format!("unit {other} of the USGS DEM is not known"),
                ));
            }
        };
        // Codes of the datums are NAD27, WGS72, WGS84, NAD83; UTM zones count up from these EPSG codes.
        let zone = self.zone.abs();
        let code = match (geographic, self.system, self.datum, self.zone < 0) {
            (true, _, 1, _) => Some(4267),
            (true, _, 2, _) => Some(4322),
            (true, _, 3, _) => Some(4326),
            (true, _, 4, _) => Some(4269),
            (false, 1, 1, false) => Some(26700 + zone),
            (false, 1, 2, south) => Some(if south { 32300 } else { 32200 } + zone),
            (false, 1, 3, south) => Some(if south { 32700 } else { 32600 } + zone),
            (false, 1, 4, false) => Some(26900 + zone),
            _ => None,
        };
        if self.system == 1 && !(1..=60).contains(&zone) {
            return Err(InputError::georef(path, format!("there is no UTM zone {zone}")));
        }
        let step = DVec2::new(self.step[0], self.step[1]) * unit;
        let transform = GeoTransform {
            origin: self.corner * unit + step * DVec2::new(-0.5, f64::from(self.size.1) - 0.5),
            column: DVec2::new(step.x, 0.0),
            row: DVec2::new(0.0, -step.y),
        };
        let feet = 0.3048;
        Ok(Placement {
            transform: Some(transform.checked(path)?),
            crs: Crs {
                name: code.map(|code| format!("EPSG:{code}")),
                geographic,
                ..Crs::default()
            },
            linear_unit: (!geographic).then_some(if self.unit == 1 { 1200.0 / 3937.0 } else { 1.0 }),
            vertical_unit: Some(if self.vertical_unit == 1 { feet } else { 1.0 }),
            ..Placement::default()
        })
    }
}

/// The heights of a file.
pub(crate) struct Dem {
    size: (u32, u32),
    /// From the north.
    heights: Vec<Cell>,
    next: usize,
    _used: Held,
}

impl Dem {
    /// Reads all of them: profiles are columns, and rows are wanted.
    pub(crate) fn open(path: &Path, metres: Metres, cache: &Arc<RasterCache>) -> Result<Self, InputError> {
        let header = Header::read(path)?;
        let (width, height) = (header.size.0 as usize, header.size.1 as usize);
        let bytes = (width * height) as u64 * CELL;
        if bytes > cache.whole_file() {
            return Err(InputError::Memory {
                path: path.to_path_buf(),
                bytes,
                budget: cache.whole_file(),
            });
        }
        let used = cache.borrow(bytes);
        let mut heights = vec![metres.cell(f64::NAN); width * height];
        let mut file = BufReader::new(File::open(path).map_err(|e| InputError::io(path, e))?);
        let mut bytes = Vec::new();
        for profile in &header.profiles {
            let (column, south) = header.cell(profile);
            let mut offset = profile.offset;
            let (mut done, mut from, mut room) = (0, 144, FIRST);
            while done < profile.count {
                let record = read_record(path, &mut file, offset, &mut bytes)?;
                let count = room.min(profile.count - done);
                for k in 0..count {
                    let at = from + k * WIDTH;
                    let raw = record.integer(at, at + WIDTH)? as f64;
                    let row = (south + done + k < height).then(|| height - 1 - (south + done + k));
                    let cell = row.and_then(|row| heights.get_mut(row * width + column));
                    if let Some(cell) = cell.filter(|_| raw != VOID) {
                        *cell = metres.cell(raw * header.step[2] + profile.base);
                    }
                }
                done += count;
                offset += RECORD as u64;
                (from, room) = (0, MORE);
            }
        }
        Ok(Self {
            size: header.size,
            heights,
            next: 0,
            _used: used,
        })
    }
}

impl Rows for Dem {
    fn size(&self) -> (u32, u32) {
        self.size
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        let start = self.next * row.len();
        if let Some(cells) = self.heights.get(start..start + row.len()) {
            row.copy_from_slice(cells);
        }
        self.next += 1;
        Ok(())
    }
}
