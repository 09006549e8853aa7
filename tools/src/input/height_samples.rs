//! From the numbers in a height file to metres: integer and float samples, scale, unit, nodata.

use std::path::Path;

use glam::DVec2;
use image::DynamicImage;
use rayon::prelude::*;
use tiff::decoder::DecodingResult;

use super::error::InputError;
use super::georef::{GeoTransform, Georef, Placement};
use super::heights::{HeightMap, HeightOptions, HeightUnit};
use super::image_file::{self, file_start};
use super::tiff_file;

/// Heights beyond this many units up or down are taken for nodata.
const MAX_HEIGHT: f64 = 1e6;

/// Decoded samples before units and nodata.
pub(crate) struct Samples {
    pub(crate) width: u32,
    pub(crate) height: u32,
    values: DecodingResult,
}

impl Samples {
    /// Decodes the file, whatever unit its numbers have.
    pub(crate) fn read(path: &Path) -> Result<Samples, InputError> {
        if !tiff_file::is_tiff(&file_start(path)?) {
            return Samples::from_png(path);
        }
        let image = tiff_file::read_image(path)?;
        if image.bands != 1 {
            return Err(one_band(path, image.bands));
        }
        Ok(Samples {
            width: image.width,
            height: image.height,
            values: image.samples,
        })
    }

    fn from_png(path: &Path) -> Result<Samples, InputError> {
        let image = image_file::decode(path)?;
        let (width, height) = (image.width(), image.height());
        let values = match image {
            DynamicImage::ImageLuma8(image) => DecodingResult::U8(image.into_raw()),
            DynamicImage::ImageLuma16(image) => DecodingResult::U16(image.into_raw()),
            other => return Err(one_band(path, usize::from(other.color().channel_count()))),
        };
        Ok(Samples {
            width,
            height,
            values,
        })
    }

    /// Turns the numbers into metres and puts them in their place.
    pub(crate) fn place(
        self,
        path: &Path,
        place: Placement,
        options: HeightOptions,
    ) -> Result<HeightMap, InputError> {
        let georef = match (place.georef(), options.pixel_size) {
            (Some(georef), _) => georef,
            (None, Some(size)) if !(size.is_finite() && size > 0.0) => {
                return Err(InputError::georef(
                    path,
                    format!("pixel size {size} is not a positive number"),
                ));
            }
            (None, size) => Georef {
                transform: GeoTransform::north_up(DVec2::ZERO, size.unwrap_or(1.0), self.height),
                crs: None,
                linear_unit_metres: 1.0,
                vertical_unit_metres: place.vertical_unit,
                geographic: false,
            },
        };
        let unit = options
            .height_unit
            .map(HeightUnit::metres)
            .or(place.vertical_unit)
            .unwrap_or(georef.linear_unit_metres);
        let (scale, offset) = match options.range {
            Some((low, high)) => {
                let top = self.greatest_code().ok_or_else(|| {
                    InputError::unsupported(path, "a height range applies to files of unsigned integers only")
                })?;
                (f64::from(high - low) / top, f64::from(low))
            }
            None => (place.scale.unwrap_or(1.0), place.offset.unwrap_or(0.0)),
        };
        // -32768 is what 16-bit terrain files use for voids, stated or not.
        let void = matches!(self.values, DecodingResult::I16(_)).then_some(-32768.0);
        let nodata = place.nodata;
        let metres = |raw: f64| -> f32 {
            let is_nodata = |n: f64| raw == n || raw as f32 == n as f32;
            let height = raw * scale + offset;
            if nodata.is_some_and(is_nodata)
                || void == Some(raw)
                || height.is_nan()
                || height.abs() > MAX_HEIGHT
            {
                f32::NAN
            } else {
                (height * unit) as f32
            }
        };
        let data = match self.values {
            DecodingResult::U8(v) => convert(v, metres),
            DecodingResult::U16(v) => convert(v, metres),
            DecodingResult::U32(v) => convert(v, metres),
            DecodingResult::I8(v) => convert(v, metres),
            DecodingResult::I16(v) => convert(v, metres),
            DecodingResult::I32(v) => convert(v, metres),
            DecodingResult::F32(v) => convert(v, metres),
            DecodingResult::F64(v) => convert(v, metres),
            _ => {
                return Err(InputError::unsupported(
                    path,
                    "heights are read as 8, 16 or 32-bit integers or 32 or 64-bit floats",
                ));
            }
        };
        HeightMap::new(path, (self.width, self.height), data, georef)
    }

    fn greatest_code(&self) -> Option<f64> {
        match self.values {
            DecodingResult::U8(_) => Some(f64::from(u8::MAX)),
            DecodingResult::U16(_) => Some(f64::from(u16::MAX)),
            DecodingResult::U32(_) => Some(f64::from(u32::MAX)),
            _ => None,
        }
    }
}

fn one_band(path: &Path, bands: usize) -> InputError {
    InputError::unsupported(path, format!("a height map has one band, this image has {bands}"))
}

fn convert<T: Into<f64> + Send>(values: Vec<T>, metres: impl Fn(f64) -> f32 + Sync) -> Vec<f32> {
    values.into_par_iter().map(|value| metres(value.into())).collect()
}
