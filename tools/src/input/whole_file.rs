//! Pictures that are decoded in one piece: JPEG, BMP, TGA, interlaced PNG.
//!
//! What decoding takes is told by the file's first bytes, and held against what there is before anything is allocated. Called
//! from any thread.

use std::fs::{self, File};
use std::io::{self, BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use image::{DynamicImage, ImageError, ImageFormat, ImageReader, Limits};

use super::block_cache::{Cell, Held, RasterCache};
use super::cells::Rows;
use super::error::InputError;
use super::image_file::{check_whole, file_start, look};

/// What a decoder may take for what files hold beside pixels: colour profiles, text.
const BESIDE: u64 = 64 << 20;

/// The format of a picture that is decoded as a whole, by its first bytes, else by its name.
pub(crate) fn format(path: &Path) -> Result<ImageFormat, InputError> {
    let start = file_start(path)?;
    let format = image::guess_format(&start)
        .ok()
        .or_else(|| ImageFormat::from_path(path).ok());
    match format {
        Some(f @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Bmp | ImageFormat::Tga)) => Ok(f),
        _ => Err(InputError::unsupported(
            path,
            "not a PNG, JPEG, BMP, TGA or TIFF image, ASCII grid, SRTM tile (.hgt) or USGS DEM (.dem)",
        )),
    }
}

/// Bytes that decoding takes: pixels as the decoder gives them, what it holds of a JPEG until all of it has been read, the file.
pub(crate) fn decoding_bytes(path: &Path) -> Result<u64, InputError> {
    let picture = look(path)?;
    let fault = |e| InputError::io(path, e);
    let file = fs::metadata(path).map_err(fault)?.len();
    let sample = if picture.sixteen { 2 } else { 1 };
    let mut each = (picture.channels * sample) as u64;
    if format(path)? == ImageFormat::Jpeg {
        let scan = first_scan(BufReader::new(File::open(path).map_err(fault)?));
        each += scan.map_err(fault)?.map_or(0, |scan| scan.coefficients);
    }
    Ok(u64::from(picture.width) * u64::from(picture.height) * each + file)
}

/// Decodes PNG, JPEG, BMP or TGA; the decoder is stopped where it wants more than `most` bytes for pixels.
pub(crate) fn decode(path: &Path, most: u64) -> Result<DynamicImage, InputError> {
    let picture = look(path)?;
    check_whole(path, picture.width, picture.height)?;
    let io_fault = |e| InputError::io(path, e);
    let format = format(path)?;
    if format == ImageFormat::Jpeg && !jpeg_is_complete(&fs::read(path).map_err(io_fault)?) {
        return Err(InputError::damaged(
            path,
            "the JPEG file is cut short (no end marker)",
        ));
    }
    let file = File::open(path).map_err(io_fault)?;
    let mut reader = ImageReader::with_format(BufReader::new(file), format);
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(most.saturating_add(BESIDE));
    reader.limits(limits);
    reader.decode().map_err(|e| fault(path, e))
}

pub(crate) fn fault(path: &Path, error: ImageError) -> InputError {
    match error {
        ImageError::Unsupported(e) => InputError::unsupported(path, e.to_string()),
        ImageError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => {
            InputError::damaged(path, "the image file is cut short")
        }
        e => InputError::damaged(path, e),
    }
}

/// The first scan of a JPEG file.
struct Scan {
    /// Where it begins.
    at: u64,
    /// Bytes a pixel of what the decoder holds until all scans have been read; none where this one has all there is.
    coefficients: u64,
}

/// Goes through the markers of a JPEG file; `None` where they do not lead to a scan.
fn first_scan(mut file: impl Read + Seek) -> io::Result<Option<Scan>> {
    let mut at = 2;
    let mut frame = None;
    loop {
        // Marker, length, and the bytes of frames and scans that say how many components they have.
        let mut head = [0; 10];
        file.seek(SeekFrom::Start(at))?;
        match file.read_exact(&mut head) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let [0xff, marker, high, low, in_scan, .., components] = head else {
            return Ok(None);
        };
        match marker {
            0xda => {
                let coefficients = match frame {
                    Some((0xc0 | 0xc1, all)) if all == in_scan => 0,
                    Some((_, all)) => 2 * u64::from(all),
                    None => 0,
                };
                return Ok(Some(Scan { at, coefficients }));
            }
            // Not tables, which have numbers between those of frames.
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => frame = Some((marker, components)),
            _ => {}
        }
        at += match marker {
            // Fill bytes before a marker are legal.
            0xff => 1,
            _ => 2 + u64::from(u16::from_be_bytes([high, low])),
        };
    }
}

/// Whether an end-of-image marker follows the first scan. The decoder is lenient and would fill a missing rest with grey.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let scan = first_scan(Cursor::new(bytes)).ok().flatten();
    let after = scan.and_then(|scan| bytes.get(scan.at as usize..));
    after.is_some_and(|after| after.windows(2).rev().any(|pair| pair == [0xff, 0xd9]))
}

/// Rows of a picture that had to be decoded as a whole, each turned into cells by a function.
pub(crate) struct WholeRows<F> {
    image: DynamicImage,
    convert: F,
    next: u32,
    _used: Held,
}

impl<F: FnMut(DynamicImage, &mut [Cell]) -> Result<(), InputError>> WholeRows<F> {
    /// Decodes a picture, if what that takes fits the part of the rasters' memory that is for it.
    pub(crate) fn open(path: &Path, cache: &Arc<RasterCache>, convert: F) -> Result<Self, InputError> {
        let (bytes, budget) = (decoding_bytes(path)?, cache.whole_file());
        if bytes > budget {
            return Err(InputError::Memory {
                path: path.to_path_buf(),
                bytes,
                budget,
            });
        }
        let _used = cache.borrow(bytes);
        let image = decode(path, bytes)?;
        Ok(Self {
            image,
            convert,
            next: 0,
            _used,
        })
    }
}

impl<F: FnMut(DynamicImage, &mut [Cell]) -> Result<(), InputError>> Rows for WholeRows<F> {
    fn size(&self) -> (u32, u32) {
        (self.image.width(), self.image.height())
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        let line = self.image.crop_imm(0, self.next, self.image.width(), 1);
        self.next += 1;
        (self.convert)(line, row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_decoder_holds_of_a_jpeg() {
        let file = |frame: u8, in_scan: u8| {
            let mut file = vec![0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2, 0xff];
            file.extend([0xff, frame, 0, 17, 8, 0, 1, 0, 1, 3]);
            file.extend([0; 9]);
            // A table, which is no frame.
            file.extend([0xff, 0xc4, 0, 10, 9, 9, 9, 9, 9, 9, 9, 9]);
            file.extend([0xff, 0xda, 0, 12, in_scan, 0, 0, 0, 0, 0, 0, 0]);
            file
        };
        let held = |bytes: &[u8]| first_scan(Cursor::new(bytes)).unwrap().map(|s| s.coefficients);
        assert_eq!(held(&file(0xc0, 3)), Some(0));
        assert_eq!(held(&file(0xc0, 1)), Some(6));
        assert_eq!(held(&file(0xc2, 3)), Some(6));
        assert_eq!(held(&file(0xc0, 3)[..30]), None);
        assert_eq!(held(&file(0xc0, 3)[..3]), None);
    }

    #[test]
    fn decoding_takes_pixels_and_file() {
        let dir = tempfile::tempdir().unwrap();
        for (name, each) in [("a.jpg", 3), ("a.bmp", 3), ("a.tga", 3)] {
            let path = dir.path().join(name);
            image::RgbImage::new(70, 30).save(&path).unwrap();
            let file = fs::metadata(&path).unwrap().len();
            assert_eq!(decoding_bytes(&path).unwrap(), 70 * 30 * each + file, "{name}");
        }
    }
}
