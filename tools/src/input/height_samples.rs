//! From the numbers in a height file to metres: integer and float samples, scale, unit, nodata; all formats.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::DynamicImage;
use tiff::decoder::DecodingResult;

use super::block_cache::{Cell, RasterCache};
use super::cells::{Blocks, Cells, See};
use super::error::InputError;
use super::georef::Placement;
use super::heights::{HeightOptions, HeightUnit, TerrainRgb};
use super::image_file::{self, Kind, check_size};
use super::png_rows::{self, PngRows};
use super::ranges::Ranges;
use super::tiff_file::Tiff;
use super::whole_file::WholeRows;
use super::{ascii_grid, hgt, usgs_dem};

/// Heights beyond this many units up or down are taken for nodata.
const MAX_HEIGHT: f64 = 1e6;

/// What the numbers of a height file mean.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Metres {
    scale: f64,
    offset: f64,
    unit: f64,
    nodata: Option<f64>,
    /// What 16-bit terrain files use for voids, stated or not.
    void: Option<f64>,
}

impl Metres {
    /// A number of the file as a height in metres; NaN where there is none.
    #[inline]
    pub(crate) fn cell(&self, raw: f64) -> Cell {
        let is_nodata = |n: f64| raw == n || raw as f32 == n as f32;
        let height = raw * self.scale + self.offset;
        let none = self.nodata.is_some_and(is_nodata)
            || self.void == Some(raw)
            || height.is_nan()
            || height.abs() > MAX_HEIGHT;
        let metres = if none {
            f32::NAN
        } else {
            (height * self.unit) as f32
        };
        metres.to_le_bytes()
    }
}

/// A height file whose kind and size are known.
pub(crate) struct HeightFile {
    path: PathBuf,
    pub(crate) width: u32,
    pub(crate) height: u32,
    kind: Kind,
    /// How colours code heights.
    rgb: Option<TerrainRgb>,
    /// Greatest value of a file of unsigned integers.
    greatest_code: Option<f64>,
    sixteen_signed: bool,
}

impl HeightFile {
    /// Looks at the file.
    pub(crate) fn open(path: &Path, options: &HeightOptions) -> Result<Self, InputError> {
        let mut file = Self {
            path: path.to_path_buf(),
            width: 0,
            height: 0,
            kind: Kind::of(path)?,
            rgb: None,
            greatest_code: None,
            sixteen_signed: false,
        };
        match file.kind {
            Kind::Tiff => {
                let tiff = Tiff::open(path)?;
                if tiff.bands != 1 {
                    return Err(one_band(path, tiff.bands));
                }
                (file.width, file.height) = (tiff.width, tiff.height);
                file.sixteen_signed = tiff.sixteen_signed;
                file.greatest_code = tiff.greatest_code;
            }
            Kind::Ascii => {
                let header = ascii_grid::Header::read(path)?;
                (file.width, file.height) = (header.width, header.height);
            }
            Kind::Hgt => {
                let side = hgt::side(path)?;
                (file.width, file.height) = (side, side);
                file.sixteen_signed = true;
            }
            Kind::UsgsDem => (file.width, file.height) = usgs_dem::Header::read(path)?.size,
            Kind::Picture => {
                let picture = image_file::look(path)?;
                (file.width, file.height) = (picture.width, picture.height);
                match (picture.channels, options.terrain_rgb) {
                    (1, _) => file.greatest_code = Some(if picture.sixteen { 65535.0 } else { 255.0 }),
                    (3 | 4, Some(rgb)) if !picture.sixteen => file.rgb = Some(rgb),
                    (bands, _) => return Err(one_band(path, bands)),
                }
            }
        }
        check_size(path, file.width, file.height)?;
        Ok(file)
    }

    /// Reads the heights, in metres. `unit` is metres per unit where neither the options nor the file say.
    pub(crate) fn read(
        self,
        place: &Placement,
        unit: f64,
        options: &HeightOptions,
        cache: &Arc<RasterCache>,
    ) -> Result<(Cells, Ranges), InputError> {
        let path = self.path.as_path();
        let own = if self.rgb.is_some() {
            Some(1.0)
        } else {
            place.vertical_unit
        };
        let (scale, offset) = match options.range {
            Some((low, high)) => {
                let top = self.greatest_code.ok_or_else(|| {
                    InputError::unsupported(path, "a height range applies to files of unsigned integers only")
                })?;
                (f64::from(high - low) / top, f64::from(low))
            }
            None => (place.scale.unwrap_or(1.0), place.offset.unwrap_or(0.0)),
        };
        let metres = Metres {
            scale,
            offset,
            unit: options
                .height_unit
                .map(HeightUnit::metres)
                .or(own)
                .unwrap_or(unit),
            nodata: place.nodata,
            void: self.sixteen_signed.then_some(-32768.0),
        };
        let mut ranges = Ranges::new(self.width, self.height);
        let see: See = &mut |column, row, cells: &[Cell]| ranges.add(column, row, cells);
        let cells = match self.kind {
            Kind::Tiff => {
                let tiff = Tiff::open(path)?;
                let grid = tiff.grid();
                let blocks = Box::new(TiffHeights { tiff, metres });
                Cells::from_blocks(path, grid, blocks, cache, Some(see))
            }
            Kind::Ascii => Cells::from_rows(&mut ascii_grid::Grid::open(path, metres)?, cache, see),
            Kind::Hgt => Cells::from_rows(&mut hgt::Tile::open(path, metres)?, cache, see),
            Kind::UsgsDem => Cells::from_rows(&mut usgs_dem::Dem::open(path, metres, cache)?, cache, see),
            Kind::Picture => self.read_picture(metres, cache, see),
        }?;
        Ok((cells, ranges))
    }

    fn read_picture(&self, metres: Metres, cache: &Arc<RasterCache>, see: See) -> Result<Cells, InputError> {
        let path = self.path.as_path();
        let rgb = self.rgb;
        if let Some(reader) = png_rows::open(path)? {
            let layout = png_rows::layout(&reader);
            let convert = move |line: &[u8], row: &mut [Cell]| match (rgb, layout) {
                (Some(rgb), (channels, _)) => {
                    for (cell, pixel) in row.iter_mut().zip(line.chunks_exact(channels)) {
                        *cell = rgb.cell(&metres, pixel);
                    }
                }
                (None, (_, true)) => {
                    for (cell, value) in row.iter_mut().zip(line.as_chunks::<2>().0) {
                        *cell = metres.cell(u16::from_be_bytes(*value).into());
                    }
                }
                (None, _) => {
                    for (cell, value) in row.iter_mut().zip(line) {
                        *cell = metres.cell(f64::from(*value));
                    }
                }
            };
            return Cells::from_rows(&mut PngRows::new(path, reader, convert), cache, see);
        }
        let convert = |line: DynamicImage, row: &mut [Cell]| {
            match (line, rgb) {
                (DynamicImage::ImageLuma8(line), _) => {
                    for (cell, value) in row.iter_mut().zip(line.as_raw()) {
                        *cell = metres.cell((*value).into());
                    }
                }
                (DynamicImage::ImageLuma16(line), _) => {
                    for (cell, value) in row.iter_mut().zip(line.as_raw()) {
                        *cell = metres.cell((*value).into());
                    }
                }
                (line, Some(rgb)) => {
                    for (cell, pixel) in row.iter_mut().zip(line.into_rgba8().pixels()) {
                        *cell = rgb.cell(&metres, &pixel.0);
                    }
                }
                (other, None) => return Err(one_band(path, usize::from(other.color().channel_count()))),
            }
            Ok(())
        };
        Cells::from_rows(&mut WholeRows::open(path, cache, convert)?, cache, see)
    }
}

impl TerrainRgb {
    /// A height of a pixel of three or four bytes; clear pixels have none.
    fn cell(self, metres: &Metres, pixel: &[u8]) -> Cell {
        let [r, g, b] = [0, 1, 2].map(|k| f64::from(pixel.get(k).copied().unwrap_or_default()));
        if pixel.get(3) == Some(&0) {
            return f32::NAN.to_le_bytes();
        }
        metres.cell(match self {
            TerrainRgb::Mapbox => (r * 65536.0 + g * 256.0 + b) * 0.1 - 10_000.0,
            TerrainRgb::Terrarium => r * 256.0 + g + b / 256.0 - 32_768.0,
        })
    }
}

/// Heights of a TIFF file, by its strips or tiles.
#[derive(Debug)]
struct TiffHeights {
    tiff: Tiff,
    metres: Metres,
}

impl Blocks for TiffHeights {
    fn read(&self, column: u32, row: u32) -> Result<Vec<Cell>, InputError> {
        fn convert<T: Copy>(values: &[T], metres: Metres, number: impl Fn(T) -> f64) -> Vec<Cell> {
            values.iter().map(|v| metres.cell(number(*v))).collect()
        }
        let m = self.metres;
        Ok(match self.tiff.block(column, row)?.samples {
            DecodingResult::U8(v) => convert(&v, m, f64::from),
            DecodingResult::U16(v) => convert(&v, m, f64::from),
            DecodingResult::U32(v) => convert(&v, m, f64::from),
            DecodingResult::U64(v) => convert(&v, m, |v| v as f64),
            DecodingResult::I8(v) => convert(&v, m, f64::from),
            DecodingResult::I16(v) => convert(&v, m, f64::from),
            DecodingResult::I32(v) => convert(&v, m, f64::from),
            DecodingResult::I64(v) => convert(&v, m, |v| v as f64),
            DecodingResult::F16(v) => convert(&v, m, f64::from),
            DecodingResult::F32(v) => convert(&v, m, f64::from),
            DecodingResult::F64(v) => convert(&v, m, |v| v),
        })
    }
}

fn one_band(path: &Path, bands: usize) -> InputError {
    InputError::unsupported(
        path,
        format!(
            "a height map has one band, this image has {bands} (heights coded in colours need --terrain-rgb)"
        ),
    )
}
