//! TIFF and GeoTIFF: samples of any supported layout, and the tags that place them.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::ColorType;
use tiff::TiffError;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::error::InputError;
use super::image_file::check_size;

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
    let mut decoder = open(path)?;
    let fault = |e: TiffError| fault(path, e);
    let (width, height) = decoder.dimensions().map_err(fault)?;
    check_size(path, width, height)?;
    let bands = usize::from(
        decoder
            .find_tag_unsigned::<u16>(Tag::SamplesPerPixel)
            .map_err(fault)?
            .unwrap_or(1),
    );
    let planar = bands > 1
        && decoder
            .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
            .map_err(fault)?
            == Some(2);
    let extra = decoder
        .find_tag_unsigned_vec::<u16>(Tag::ExtraSamples)
        .map_err(fault)?
        .unwrap_or_default();
    let color = decoder.colortype().map_err(fault)?;
    let mut samples = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut samples).map_err(fault)?;
    if samples.as_buffer(0).byte_len() < layout.complete_len {
        return Err(InputError::damaged(
            path,
            "the TIFF image has more planes than fit the reader's limit",
        ));
    }
    if decoder
        .find_tag_unsigned::<u16>(Tag::Compression)
        .map_err(fault)?
        .unwrap_or(1)
        == UNCOMPRESSED
    {
        // The decoder reads on behind a strip or tile that is too short, into whatever follows.
        let counts =
            [Tag::StripByteCounts, Tag::TileByteCounts].map(|tag| decoder.find_tag_unsigned_vec::<u64>(tag));
        let stored: u64 = counts
            .into_iter()
            .flatten()
            .flatten()
            .flatten()
            .fold(0, u64::saturating_add);
        if stored < layout.complete_len as u64 {
            let what = format!(
                "its strips hold {stored} bytes where the image has {}",
                layout.complete_len
            );
            return Err(InputError::damaged(path, what));
        }
    }
    Ok(TiffImage {
        width,
        height,
        color,
        bands,
        samples,
        planar,
        associated_alpha: extra.first() == Some(&ASSOCIATED_ALPHA),
    })
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
