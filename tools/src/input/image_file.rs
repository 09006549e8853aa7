//! Colour images from files: PNG, JPEG, BMP, TGA and TIFF as straight sRGB RGBA8.
//!
//! The kind of file is taken from its first bytes, and only then from its name. Called from any thread.

use std::fs;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use image::{DynamicImage, ImageDecoder, ImageReader};
use tiff::ColorType;
use tiff::decoder::DecodingResult;

use super::block_cache::{Cell, RasterCache};
use super::cells::{BLOCK, Blocks, CELL, Cells, See};
use super::error::InputError;
use super::png_rows::{self, PngRows};
use super::tiff_file::{self, Tiff, TiffImage};
use super::whole_file::{self, WholeRows};

/// Longest side of an image that is read, pixels.
pub const MAX_SIDE: u32 = 1 << 22;
/// Most pixels of an image that is read.
pub const MAX_PIXELS: u64 = 1 << 40;
/// Most pixels of an image that is decoded as a whole (2 GiB as RGBA8).
pub const MAX_WHOLE: u64 = 1 << 29;

/// How a raster file is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// TIFF or BigTIFF.
    Tiff,
    /// ESRI ASCII grid.
    Ascii,
    /// SRTM tile.
    Hgt,
    /// USGS ASCII DEM.
    UsgsDem,
    /// PNG, JPEG, BMP or TGA.
    Picture,
}

impl Kind {
    /// By the first bytes, and by the name where a format has no signature.
    pub(crate) fn of(path: &Path) -> Result<Self, InputError> {
        let start = file_start(path)?;
        let text = String::from_utf8_lossy(&start).trim_start().to_ascii_lowercase();
        let named = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
        let keys = ["ncols", "nrows", "xllc", "yllc", "cellsize", "dx", "nodata"];
        Ok(if tiff_file::is_tiff(&start) {
            Kind::Tiff
        } else if named("asc") || keys.iter().any(|key| text.starts_with(key)) {
            Kind::Ascii
        } else if named("hgt") {
            Kind::Hgt
        } else if named("dem") {
            Kind::UsgsDem
        } else {
            Kind::Picture
        })
    }
}

/// Size and samples of a picture, from its first bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PictureInfo {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) channels: usize,
    pub(crate) sixteen: bool,
}

/// Looks at a PNG, JPEG, BMP or TGA file without decoding it.
pub(crate) fn look(path: &Path) -> Result<PictureInfo, InputError> {
    if let Some(reader) = png_rows::open(path)? {
        let (channels, sixteen) = png_rows::layout(&reader);
        let (width, height) = (reader.info().width, reader.info().height);
        check_size(path, width, height)?;
        return Ok(PictureInfo {
            width,
            height,
            channels,
            sixteen,
        });
    }
    let file = fs::File::open(path).map_err(|e| InputError::io(path, e))?;
    let mut reader = ImageReader::new(BufReader::new(file));
    reader.set_format(whole_file::format(path)?);
    reader.no_limits();
    let decoder = reader.into_decoder().map_err(|e| whole_file::fault(path, e))?;
    let (width, height) = decoder.dimensions();
    check_size(path, width, height)?;
    let color = decoder.color_type();
    Ok(PictureInfo {
        width,
        height,
        channels: usize::from(color.channel_count()),
        sixteen: color.bytes_per_pixel() > color.channel_count(),
    })
}

/// Columns and rows of a colour image.
pub(crate) fn size(path: &Path) -> Result<(u32, u32), InputError> {
    if Kind::of(path)? == Kind::Tiff {
        let tiff = Tiff::open(path)?;
        return Ok((tiff.width, tiff.height));
    }
    let picture = look(path)?;
    Ok((picture.width, picture.height))
}

/// Reads a colour image of any size. `see` sees all of its pixels if it is given.
pub(crate) fn read_colors(
    path: &Path,
    nodata: Option<u8>,
    cache: &Arc<RasterCache>,
    see: Option<See>,
) -> Result<Cells, InputError> {
    let clear = move |pixels: &mut [Cell]| {
        if let Some(code) = nodata {
            pixels
                .iter_mut()
                .filter(|p| p[..3] == [code; 3])
                .for_each(|p| *p = [0; 4]);
        }
    };
    if Kind::of(path)? == Kind::Tiff {
        let tiff = Tiff::open(path)?;
        let grid = tiff.grid();
        return Cells::from_blocks(path, grid, Box::new(TiffColors { tiff, nodata }), cache, see);
    }
    let mut nothing = |_: u32, _: u32, _: &[Cell]| ();
    let see: See = see.unwrap_or(&mut nothing);
    if let Some(reader) = png_rows::open(path)? {
        let (channels, sixteen) = png_rows::layout(&reader);
        check_size(path, reader.info().width, reader.info().height)?;
        let convert = move |line: &[u8], row: &mut [Cell]| {
            let step = if sixteen { 2 * channels } else { channels };
            for (cell, pixel) in row.iter_mut().zip(line.chunks_exact(step)) {
                let code = |k: usize| match sixteen {
                    true => eight_bits(u16::from_be_bytes([pixel[2 * k], pixel[2 * k + 1]])),
                    false => pixel[k],
                };
                *cell = match channels {
                    1 => [code(0), code(0), code(0), 255],
                    2 => [code(0), code(0), code(0), code(1)],
                    3 => [code(0), code(1), code(2), 255],
                    _ => [code(0), code(1), code(2), code(3)],
                };
            }
            clear(row);
        };
        return Cells::from_rows(&mut PngRows::new(path, reader, convert), cache, see);
    }
    let is_jpeg = file_start(path)?.get(..2) == Some(&[0xff, 0xd8]);
    let convert = |line: DynamicImage, row: &mut [Cell]| {
        row.copy_from_slice(line.into_rgba8().as_chunks().0);
        if !is_jpeg {
            clear(row);
        }
        Ok(())
    };
    Cells::from_rows(&mut WholeRows::open(path, cache, convert)?, cache, see)
}

/// Bytes that [`read_colors`] takes, at most, beside the memory in which the picture is kept.
pub(crate) fn reading_bytes(path: &Path, cache: &RasterCache) -> Result<u64, InputError> {
    let (width, height) = size(path)?;
    let decoding = if Kind::of(path)? == Kind::Tiff {
        (u64::from(width) * u64::from(height) * CELL).min(cache.budget() / 4)
    } else if png_rows::open(path)?.is_some() {
        0
    } else {
        whole_file::decoding_bytes(path)?
    };
    Ok(decoding + (2 * u64::from(BLOCK) * u64::from(width) * CELL).min(cache.bands()))
}

/// Colours of a TIFF file, by its strips or tiles.
#[derive(Debug)]
struct TiffColors {
    tiff: Tiff,
    nodata: Option<u8>,
}

impl Blocks for TiffColors {
    fn read(&self, column: u32, row: u32) -> Result<Vec<Cell>, InputError> {
        let mut pixels = from_tiff(self.tiff.path(), self.tiff.block(column, row)?)?.pixels;
        if let Some(code) = self.nodata {
            pixels
                .iter_mut()
                .filter(|p| p[..3] == [code; 3])
                .for_each(|p| *p = [0; 4]);
        }
        Ok(pixels)
    }
}

fn eight_bits(code: u16) -> u8 {
    ((u32::from(code) * 255 + 32767) / 65535) as u8
}

/// A decoded colour image: sRGB, straight alpha, row 0 at the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` pixels, row by row from the top: red, green, blue, alpha.
    pub pixels: Vec<[u8; 4]>,
}

/// Refuses a declared size beyond [`MAX_SIDE`] and [`MAX_PIXELS`], or without pixels, before anything is allocated.
pub(crate) fn check_size(path: &Path, width: u32, height: u32) -> Result<(), InputError> {
    if width == 0 || height == 0 {
        return Err(InputError::damaged(
            path,
            format!("the image has no pixels ({width} x {height})"),
        ));
    }
    if width > MAX_SIDE || height > MAX_SIDE || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(InputError::TooLarge {
            path: path.to_path_buf(),
            width: u64::from(width),
            height: u64::from(height),
            limit: format!("{MAX_SIDE} pixels a side and {MAX_PIXELS} in all"),
        });
    }
    Ok(())
}

/// Like [`check_size`], for images that are decoded as a whole: at most [`MAX_WHOLE`] pixels.
pub(crate) fn check_whole(path: &Path, width: u32, height: u32) -> Result<(), InputError> {
    check_size(path, width, height)?;
    if u64::from(width) * u64::from(height) > MAX_WHOLE {
        return Err(InputError::TooLarge {
            path: path.to_path_buf(),
            width: u64::from(width),
            height: u64::from(height),
            limit: format!("{MAX_WHOLE} pixels where all of them are decoded at once"),
        });
    }
    Ok(())
}

/// The first bytes of a file, enough to tell its kind.
pub(crate) fn file_start(path: &Path) -> Result<Vec<u8>, InputError> {
    let mut start = Vec::with_capacity(16);
    fs::File::open(path)
        .and_then(|file| file.take(16).read_to_end(&mut start))
        .map_err(|e| InputError::io(path, e))?;
    Ok(start)
}

impl Raster {
    /// Reads an image file.
    ///
    /// # Errors
    /// A missing, damaged, truncated or unsupported file, or one beyond [`MAX_SIDE`] and [`MAX_PIXELS`].
    pub fn load(path: &Path) -> Result<Raster, InputError> {
        if tiff_file::is_tiff(&file_start(path)?) {
            return from_tiff(path, tiff_file::read_image(path)?);
        }
        let image = whole_file::decode(path, u64::MAX)?.into_rgba8();
        let (width, height) = image.dimensions();
        let pixels = image.into_raw().as_chunks::<4>().0.to_vec();
        Ok(Raster {
            width,
            height,
            pixels,
        })
    }

    /// The pixel at a column and row; both are clamped to the image.
    #[inline]
    pub fn pixel(&self, column: u32, row: u32) -> [u8; 4] {
        let (column, row) = (column.min(self.width - 1), row.min(self.height - 1));
        self.pixels[row as usize * self.width as usize + column as usize]
    }
}

fn from_tiff(path: &Path, image: TiffImage) -> Result<Raster, InputError> {
    let count = image.width as usize * image.height as usize;
    let bytes: Vec<u8> = match image.samples {
        DecodingResult::U8(samples) => samples,
        DecodingResult::U16(samples) => samples.into_iter().map(eight_bits).collect(),
        _ => {
            return Err(InputError::unsupported(
                path,
                "colour TIFF images are read with 8 or 16 bits a sample",
            ));
        }
    };
    let bands = image.bands;
    if bytes.len() < count * bands {
        return Err(InputError::damaged(
            path,
            "the TIFF image has fewer samples than its size asks for",
        ));
    }
    let (pixel_step, band_step) = if image.planar { (1, count) } else { (bands, 1) };
    let sample = |pixel: usize, band: usize| bytes[pixel * pixel_step + band * band_step];
    let grey = |i: usize| [sample(i, 0), sample(i, 0), sample(i, 0), 255];
    let rgb = |i: usize| [sample(i, 0), sample(i, 1), sample(i, 2), 255];
    let mut pixels: Vec<[u8; 4]> = match image.color {
        ColorType::Gray(8 | 16) => (0..count).map(grey).collect(),
        ColorType::GrayA(_) | ColorType::Multiband { num_samples: 2, .. } => (0..count)
            .map(|i| [sample(i, 0), sample(i, 0), sample(i, 0), sample(i, 1)])
            .collect(),
        ColorType::RGB(_) | ColorType::Multiband { num_samples: 3.., .. } if bands >= 3 => {
            (0..count).map(rgb).collect()
        }
        ColorType::RGBA(_) if bands >= 4 => (0..count)
            .map(|i| [sample(i, 0), sample(i, 1), sample(i, 2), sample(i, 3)])
            .collect(),
        ColorType::YCbCr(_) if bands == 3 => (0..count).map(|i| ycbcr(rgb(i))).collect(),
        other => {
            return Err(InputError::unsupported(
                path,
                format!("TIFF colour type {other:?} is not read"),
            ));
        }
    };
    if image.associated_alpha {
        pixels.iter_mut().for_each(straighten);
    }
    Ok(Raster {
        width: image.width,
        height: image.height,
        pixels,
    })
}

/// Full-range BT.601, which is what JPEG in TIFF uses.
fn ycbcr([y, cb, cr, a]: [u8; 4]) -> [u8; 4] {
    let (y, cb, cr) = (f32::from(y), f32::from(cb) - 128.0, f32::from(cr) - 128.0);
    let code = |v: f32| v.round().clamp(0.0, 255.0) as u8;
    [
        code(y + 1.402 * cr),
        code(y - 0.344_136 * cb - 0.714_136 * cr),
        code(y + 1.772 * cb),
        a,
    ]
}

fn straighten(pixel: &mut [u8; 4]) {
    let a = u32::from(pixel[3]);
    for c in &mut pixel[..3] {
        // What is not there has no colour.
        *c = (u32::from(*c) * 255 + a / 2).checked_div(a).unwrap_or(0).min(255) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::test_data::{self, data};
    use tiff::encoder::{TiffEncoder, colortype};

    #[test]
    fn png_keeps_alpha_and_row_order() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let mut image = image::RgbaImage::new(2, 2);
        image.put_pixel(1, 0, image::Rgba([10, 20, 30, 40]));
        image.save(&path).unwrap();
        let raster = Raster::load(&path).unwrap();
        assert_eq!((raster.width, raster.height), (2, 2));
        assert_eq!(raster.pixels[1], [10, 20, 30, 40]);
    }

    #[test]
    fn truncated_files_are_errors_naming_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let image = image::RgbImage::from_fn(64, 64, |x, y| {
            image::Rgb([(x * y) as u8, (x ^ y) as u8, (x * 7) as u8])
        });
        for name in ["a.png", "a.jpg", "a.bmp", "a.tga"] {
            let path = dir.path().join(name);
            image.save(&path).unwrap();
            assert!(Raster::load(&path).is_ok(), "{name}");
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
            let message = Raster::load(&path).unwrap_err().to_string();
            assert!(message.contains(name) && !message.contains('\n'), "{message}");
        }
    }

    #[test]
    fn sixteen_bit_and_rgba_tiff() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
        encoder
            .write_image::<colortype::RGB16>(1, 1, &[65535, 257 * 7, 0])
            .unwrap();
        assert_eq!(Raster::load(&path).unwrap().pixels, [[255, 7, 0, 255]]);
        let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
        encoder
            .write_image::<colortype::RGBA8>(1, 2, &[1, 2, 3, 4, 5, 6, 7, 0])
            .unwrap();
        assert_eq!(Raster::load(&path).unwrap().pixels, [[1, 2, 3, 4], [5, 6, 7, 0]]);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..12]).unwrap();
        assert!(Raster::load(&path).is_err());
    }

    #[test]
    fn planar_tiff_with_associated_alpha() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("planar.tif");
        // Two pixels, four planes; alpha is multiplied in.
        fs::write(
            &path,
            test_data::planar_tiff(2, 1, &[&[100, 1], &[50, 2], &[0, 3], &[128, 255]], 1),
        )
        .unwrap();
        assert_eq!(
            Raster::load(&path).unwrap().pixels,
            [[199, 100, 0, 128], [1, 2, 3, 255]]
        );
    }

    #[test]
    fn a_huge_declared_size_is_refused_before_allocation() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("huge.bmp");
        image::RgbImage::new(2, 2).save(&path).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        bytes[18..22].copy_from_slice(&60_000u32.to_le_bytes());
        bytes[22..26].copy_from_slice(&60_000u32.to_le_bytes());
        fs::write(&path, &bytes).unwrap();
        assert!(matches!(Raster::load(&path), Err(InputError::TooLarge { .. })));
    }

    #[test]
    fn sertig_rgba_tiff() {
        let Some(path) = data("sertig_valley_ch/sertig_valley_color.tif") else {
            return;
        };
        let raster = Raster::load(&path).unwrap();
        assert_eq!((raster.width, raster.height), (641, 917));
        assert!(raster.pixels.iter().any(|p| p[3] == 255));
    }
}
