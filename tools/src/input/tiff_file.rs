//! TIFF and GeoTIFF: samples of any supported layout, and the tags that place them.

use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use tiff::ColorType;
use tiff::TiffError;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::cells::Grid;
use super::error::InputError;
use super::image_file::{check_size, check_whole};

/// GDAL's XML with scale, offset and unit of the bands.
const GDAL_METADATA: u16 = 42112;
/// Value of `Compression` for samples as they are.
const UNCOMPRESSED: u16 = 1;
/// Value of `ExtraSamples` for alpha that is multiplied into the colour.
const ASSOCIATED_ALPHA: u16 = 1;

/// The tags that place an image in the world, as stored.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct TiffTags {
    pub(crate) pixel_scale: Vec<f64>,
    pub(crate) tiepoints: Vec<f64>,
    pub(crate) transformation: Vec<f64>,
    pub(crate) keys: Vec<u16>,
    pub(crate) doubles: Vec<f64>,
    pub(crate) ascii: String,
    pub(crate) nodata: Option<String>,
    pub(crate) gdal_metadata: Option<String>,
}

/// The first image of a TIFF file.
pub(crate) struct TiffImage {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) color: ColorType,
    /// Samples per pixel.
    pub(crate) bands: usize,
    /// All samples: pixel by pixel, or plane by plane when `planar`.
    pub(crate) samples: DecodingResult,
    pub(crate) planar: bool,
    pub(crate) associated_alpha: bool,
}

type Reader = Decoder<BufReader<File>>;

/// Whether the file starts with a TIFF or BigTIFF signature.
pub(crate) fn is_tiff(start: &[u8]) -> bool {
    matches!(
        start.get(..4),
        Some([b'I', b'I', 42 | 43, 0]) | Some([b'M', b'M', 0, 42 | 43])
    )
}

/// Reads only the tags.
pub(crate) fn read_tags(path: &Path) -> Result<TiffTags, InputError> {
    let mut decoder = open(path)?;
    tags(path, &mut decoder)
}

/// Decodes the first image of the file.
pub(crate) fn read_image(path: &Path) -> Result<TiffImage, InputError> {
    let tiff = Tiff::open(path)?;
    check_whole(path, tiff.width, tiff.height)?;
    let mut samples = DecodingResult::U8(Vec::new());
    let layout = open(path)?
        .read_image_to_buffer(&mut samples)
        .map_err(|e| fault(path, e))?;
    if samples.as_buffer(0).byte_len() < layout.complete_len {
        return Err(InputError::damaged(
            path,
            "the TIFF image has more planes than fit the reader's limit",
        ));
    }
    Ok(tiff.image(tiff.width, tiff.height, samples))
}

/// The first image of a TIFF file, read by its strips or tiles. Any thread; as many decoders as read at one time.
pub(crate) struct Tiff {
    path: PathBuf,
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Samples per pixel.
    pub(crate) bands: usize,
    /// Greatest value of unsigned integers.
    pub(crate) greatest_code: Option<f64>,
    /// Whether samples are integers of 16 bits with a sign.
    pub(crate) sixteen_signed: bool,
    sample_bytes: usize,
    color: ColorType,
    planar: bool,
    associated_alpha: bool,
    block: (u32, u32),
    decoders: Mutex<Vec<Reader>>,
}

impl fmt::Debug for Tiff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tiff({})", self.path.display())
    }
}

impl Tiff {
    /// Looks at the file.
    pub(crate) fn open(path: &Path) -> Result<Self, InputError> {
        let mut decoder = open(path)?;
        let fault = |e: TiffError| fault(path, e);
        let (width, height) = decoder.dimensions().map_err(fault)?;
        check_size(path, width, height)?;
        let color = decoder.colortype().map_err(fault)?;
        let mut number = |tag: Tag| decoder.find_tag_unsigned::<u16>(tag).map_err(fault);
        let bands = usize::from(number(Tag::SamplesPerPixel)?.unwrap_or(1));
        let planar = bands > 1 && number(Tag::PlanarConfiguration)? == Some(2);
        let compression = number(Tag::Compression)?.unwrap_or(1);
        let mut numbers = |tag: Tag| {
            let values = decoder.find_tag_unsigned_vec::<u16>(tag).map_err(fault)?;
            Ok::<_, InputError>(values.unwrap_or_default())
        };
        let extra = numbers(Tag::ExtraSamples)?;
        let bits = numbers(Tag::BitsPerSample)?.first().copied().unwrap_or(1);
        // 1 is unsigned, 2 signed, 3 floating-point.
        let format = numbers(Tag::SampleFormat)?.first().copied().unwrap_or(1);
        let (w, h) = decoder.chunk_dimensions();
        if w == 0 || h == 0 {
            return Err(InputError::damaged(path, "strips or tiles without pixels"));
        }
        if compression == UNCOMPRESSED {
            check_stored(
                path,
                &mut decoder,
                (u64::from(width) * u64::from(height)).saturating_mul(bands as u64 * u64::from(bits)) / 8,
            )?;
        }
        Ok(Self {
            path: path.to_path_buf(),
            width,
            height,
            bands,
            greatest_code: (format == 1 && bits <= 32).then(|| 2f64.powi(bits.into()) - 1.0),
            sixteen_signed: format == 2 && bits == 16,
            sample_bytes: usize::from(bits.div_ceil(8)),
            color,
            planar,
            associated_alpha: extra.first() == Some(&ASSOCIATED_ALPHA),
            block: (w.min(width), h.min(height)),
            decoders: Mutex::new(vec![decoder]),
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Its division into strips or tiles.
    pub(crate) fn grid(&self) -> Grid {
        Grid {
            size: (self.width, self.height),
            block: self.block,
        }
    }

    fn image(&self, width: u32, height: u32, samples: DecodingResult) -> TiffImage {
        TiffImage {
            width,
            height,
            color: self.color,
            bands: self.bands,
            samples,
            planar: self.planar,
            associated_alpha: self.associated_alpha,
        }
    }

    /// Decodes a strip or tile, without what lies outside of the image.
    pub(crate) fn block(&self, column: u32, row: u32) -> Result<TiffImage, InputError> {
        let free = || self.decoders.lock().unwrap_or_else(PoisonError::into_inner);
        let decoder = free().pop();
        let mut decoder = match decoder {
            Some(decoder) => decoder,
            None => open(&self.path)?,
        };
        let (across, down) = (
            self.width.div_ceil(self.block.0),
            self.height.div_ceil(self.block.1),
        );
        let first = row * across + column;
        let (columns, rows) = self.grid().area(column, row);
        let place = || format!("at column {} and row {}", columns.start, rows.start);
        let mut all: Option<DecodingResult> = None;
        let planes = if self.planar { self.bands as u32 } else { 1 };
        for plane in 0..planes {
            let number = plane
                .checked_mul(across * down)
                .and_then(|n| n.checked_add(first));
            let number =
                number.ok_or_else(|| InputError::damaged(&self.path, "the TIFF image has too many tiles"))?;
            let part = decoder
                .read_chunk(number)
                .map_err(|e| match fault(&self.path, e) {
                    InputError::Damaged { path, what } => InputError::Damaged {
                        path,
                        what: format!("{what} ({})", place()),
                    },
                    other => other,
                })?;
            all = Some(match (all, part) {
                (None, part) => part,
                (Some(DecodingResult::U8(mut a)), DecodingResult::U8(b)) => {
                    a.extend(b);
                    DecodingResult::U8(a)
                }
                (Some(DecodingResult::U16(mut a)), DecodingResult::U16(b)) => {
                    a.extend(b);
                    DecodingResult::U16(a)
                }
                _ => {
                    return Err(InputError::unsupported(
                        &self.path,
                        "planes are read with 8 or 16 bits a sample",
                    ));
                }
            });
        }
        free().push(decoder);
        let mut samples = all.unwrap_or(DecodingResult::U8(Vec::new()));
        let count = columns.len() * rows.len() * self.bands;
        if samples.as_buffer(0).byte_len() < count * self.sample_bytes {
            return Err(InputError::damaged(
                &self.path,
                format!("fewer samples than there should be {}", place()),
            ));
        }
        Ok(self.image(columns.len() as u32, rows.len() as u32, samples))
    }
}

/// Refuses an uncompressed file with fewer bytes than its pixels take: the decoder reads on behind a strip or tile that
/// is too short, into whatever follows.
fn check_stored(path: &Path, decoder: &mut Reader, needed: u64) -> Result<(), InputError> {
    let counts =
        [Tag::StripByteCounts, Tag::TileByteCounts].map(|tag| decoder.find_tag_unsigned_vec::<u64>(tag));
    let stored: u64 = counts
        .into_iter()
        .flatten()
        .flatten()
        .flatten()
        .fold(0, u64::saturating_add);
    if stored < needed {
        let what = format!("its strips hold {stored} bytes where the image has {needed}");
        return Err(InputError::damaged(path, what));
    }
    Ok(())
}

fn open(path: &Path) -> Result<Reader, InputError> {
    let file = File::open(path).map_err(|e| InputError::io(path, e))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::MAX / 4;
    limits.intermediate_buffer_size = 1 << 30;
    limits.ifd_value_size = 64 << 20;
    Ok(Decoder::new(BufReader::new(file))
        .map_err(|e| fault(path, e))?
        .with_limits(limits))
}

fn fault(path: &Path, error: TiffError) -> InputError {
    match error {
        TiffError::UnsupportedError(e) => {
            InputError::unsupported(path, format!("TIFF variant not read: {e}"))
        }
        TiffError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            InputError::damaged(path, "the TIFF file is cut short")
        }
        e => InputError::damaged(path, format!("TIFF: {e}")),
    }
}

fn tags(path: &Path, decoder: &mut Reader) -> Result<TiffTags, InputError> {
    let mut doubles = |tag: Tag| -> Result<Vec<f64>, InputError> {
        match decoder.find_tag(tag).map_err(|e| fault(path, e))? {
            Some(value) => value.into_f64_vec().map_err(|e| fault(path, e)),
            None => Ok(Vec::new()),
        }
    };
    let pixel_scale = doubles(Tag::ModelPixelScaleTag)?;
    let tiepoints = doubles(Tag::ModelTiepointTag)?;
    let transformation = doubles(Tag::ModelTransformationTag)?;
    let params = doubles(Tag::GeoDoubleParamsTag)?;
    let mut text = |tag: Tag| -> Option<String> {
        // A text tag of a wrong type says nothing about the image; it is as good as absent.
        decoder
            .find_tag(tag)
            .ok()
            .flatten()
            .and_then(|value| value.into_string().ok())
    };
    let ascii = text(Tag::GeoAsciiParamsTag).unwrap_or_default();
    let nodata = text(Tag::GdalNodata);
    let gdal_metadata = text(Tag::Unknown(GDAL_METADATA));
    let keys = decoder
        .find_tag_unsigned_vec::<u16>(Tag::GeoKeyDirectoryTag)
        .map_err(|e| fault(path, e))?
        .unwrap_or_default();
    Ok(TiffTags {
        pixel_scale,
        tiepoints,
        transformation,
        keys,
        doubles: params,
        ascii,
        nodata,
        gdal_metadata,
    })
}
