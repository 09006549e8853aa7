//! GeoTIFF tags and keys: from stored numbers to a transform, a coordinate system and units.

use std::path::Path;

use glam::{DMat4, DVec2, DVec3, DVec4};

use super::error::InputError;
use super::georef::{GeoTransform, Placement};
use super::pam;
use super::tiff_file::TiffTags;

const GT_MODEL_TYPE: u16 = 1024;
const GT_RASTER_TYPE: u16 = 1025;
const GT_CITATION: u16 = 1026;
const GEOGRAPHIC_TYPE: u16 = 2048;
const GEOG_CITATION: u16 = 2049;
const PROJECTED_CS_TYPE: u16 = 3072;
const PCS_CITATION: u16 = 3073;
const PROJ_LINEAR_UNITS: u16 = 3076;
const PROJ_LINEAR_UNIT_SIZE: u16 = 3077;
const VERTICAL_UNITS: u16 = 4099;

const MODEL_GEOGRAPHIC: u16 = 2;
const MODEL_GEOCENTRIC: u16 = 3;
const PIXEL_IS_POINT: u16 = 2;
const USER_DEFINED: u16 = 32767;

/// What the tags of a TIFF file say.
pub(crate) fn placement(path: &Path, tags: &TiffTags) -> Result<Placement, InputError> {
    let keys = Keys { tags };
    let mut placement = Placement::default();
    let model = keys.short(GT_MODEL_TYPE);
    let point = keys.short(GT_RASTER_TYPE) == Some(PIXEL_IS_POINT);
    if model == Some(MODEL_GEOCENTRIC) {
        placement.geocentric = Some(geocentric(path, tags, point)?);
    } else {
        placement.transform = transform(path, tags, point)?;
    }
    let code = |key| {
        let code = keys.short(key).filter(|code| *code != 0 && *code != USER_DEFINED);
        code.map(|code| format!("EPSG:{code}"))
    };
    let cited = |ids: &[u16]| ids.iter().find_map(|key| keys.text(*key));
    placement.crs.geographic = model == Some(MODEL_GEOGRAPHIC);
    placement.crs.name = if placement.crs.geographic {
        code(GEOGRAPHIC_TYPE)
    } else {
        code(PROJECTED_CS_TYPE).or_else(|| cited(&[PCS_CITATION, GT_CITATION, GEOG_CITATION]))
    };
    placement.linear_unit = match keys.short(PROJ_LINEAR_UNITS) {
        Some(USER_DEFINED) | None => keys.double(PROJ_LINEAR_UNIT_SIZE),
        Some(code) => Some(unit(path, code)?),
    };
    if placement
        .linear_unit
        .is_some_and(|metres| !metres.is_finite() || metres <= 0.0)
    {
        return Err(InputError::georef(
            path,
            "the size of the linear unit is not a positive number",
        ));
    }
    placement.vertical_unit = match keys.short(VERTICAL_UNITS) {
        Some(USER_DEFINED) | None => None,
        Some(code) => Some(unit(path, code)?),
    };
    placement.nodata = tags
        .nodata
        .as_deref()
        .and_then(|t| t.trim_matches(['\0', ' ', '\n']).parse().ok());
    Ok(placement.or(tags
        .gdal_metadata
        .as_deref()
        .map(pam::from_tiff_metadata)
        .unwrap_or_default()))
}

/// Metres per unit of an EPSG unit code.
fn unit(path: &Path, code: u16) -> Result<f64, InputError> {
    match code {
        9001 => Ok(1.0),
        9002 => Ok(0.3048),
        9003 => Ok(1200.0 / 3937.0),
        9030 => Ok(1852.0),
        9036 => Ok(1000.0),
        _ => Err(InputError::georef(
            path,
            format!("linear unit with EPSG code {code} is not known"),
        )),
    }
}

fn transform(path: &Path, tags: &TiffTags, point: bool) -> Result<Option<GeoTransform>, InputError> {
    let shift = if point { DVec2::splat(-0.5) } else { DVec2::ZERO };
    let mut transform = match (
        tags.transformation.as_slice(),
        tags.pixel_scale.as_slice(),
        tags.tiepoints.as_slice(),
    ) {
        (&[a, b, _, x, d, e, _, y, ..], _, _) => GeoTransform {
            origin: DVec2::new(x, y),
            column: DVec2::new(a, d),
            row: DVec2::new(b, e),
        },
        // Further tiepoints repeat what the first and the scale say.
        ([], &[sx, sy, ..], &[i, j, _, x, y, _, ..]) => GeoTransform {
            origin: DVec2::new(x - i * sx, y + j * sy),
            column: DVec2::new(sx, 0.0),
            row: DVec2::new(0.0, -sy),
        },
        ([], _, []) => return Ok(None),
        _ => {
            return Err(InputError::georef(
                path,
                "ground control points without a pixel scale are not supported",
            ));
        }
    };
    transform.origin = transform.at(shift);
    transform.checked(path).map(Some)
}

/// Pixel space and height to geocentric metres: four by four numbers, row by row.
fn geocentric(path: &Path, tags: &TiffTags, point: bool) -> Result<DMat4, InputError> {
    let numbers: Option<[f64; 16]> = tags.transformation.as_slice().try_into().ok();
    let matrix = numbers.map(|n| DMat4::from_cols_array(&n).transpose());
    let shift = if point { -0.5 } else { 0.0 };
    match matrix.map(|m| m * DMat4::from_translation(DVec3::new(shift, shift, 0.0))) {
        Some(m) if m.is_finite() && m.inverse().is_finite() && m.row(3) == DVec4::W => Ok(m),
        _ => Err(InputError::georef(
            path,
            "geocentric coordinates need a ModelTransformation of columns, rows and heights",
        )),
    }
}

/// The key directory: a header of four numbers, then four numbers a key.
struct Keys<'a> {
    tags: &'a TiffTags,
}

impl Keys<'_> {
    /// (place, count, value or offset) of a key.
    fn entry(&self, key: u16) -> Option<(u16, usize, u16)> {
        let entries = self.tags.keys.as_chunks::<4>().0.iter().skip(1);
        entries
            .filter(|entry| entry[0] == key)
            .map(|entry| (entry[1], usize::from(entry[2]), entry[3]))
            .next()
    }

    fn short(&self, key: u16) -> Option<u16> {
        self.entry(key).filter(|entry| entry.0 == 0).map(|entry| entry.2)
    }

    fn double(&self, key: u16) -> Option<f64> {
        let (_, _, offset) = self.entry(key).filter(|entry| entry.0 == 34736)?;
        self.tags.doubles.get(usize::from(offset)).copied()
    }

    fn text(&self, key: u16) -> Option<String> {
        let (_, count, offset) = self.entry(key).filter(|entry| entry.0 == 34737)?;
        let text = self.tags.ascii.get(usize::from(offset)..)?;
        let text = text
            .get(..count)
            .unwrap_or(text)
            .trim_end_matches(['|', '\0', ' ']);
        (!text.is_empty()).then(|| text.replace('|', ", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tags(keys: &[[u16; 4]]) -> TiffTags {
        let mut all = vec![1, 1, 0, keys.len() as u16];
        all.extend(keys.iter().flatten());
        TiffTags {
            pixel_scale: vec![10.0, 10.0, 0.0],
            tiepoints: vec![0.0, 0.0, 0.0, 1000.0, 2000.0, 0.0],
            keys: all,
            ..TiffTags::default()
        }
    }

    #[test]
    fn point_pixels_shift_by_half() {
        let path = Path::new("a.tif");
        let area = placement(path, &tags(&[[GT_RASTER_TYPE, 0, 1, 1]]))
            .unwrap()
            .transform
            .unwrap();
        let point = placement(path, &tags(&[[GT_RASTER_TYPE, 0, 1, 2]]))
            .unwrap()
            .transform
            .unwrap();
        assert_eq!(area.origin, DVec2::new(1000.0, 2000.0));
        assert_eq!(point.origin, DVec2::new(995.0, 2005.0));
    }

    #[test]
    fn transformation_matrix() {
        let mut tags = tags(&[]);
        tags.pixel_scale.clear();
        tags.transformation = vec![
            0.0, 2.0, 0.0, 7.0, 3.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        ];
        let transform = placement(Path::new("a.tif"), &tags).unwrap().transform.unwrap();
        assert_eq!(transform.at(DVec2::new(1.0, 10.0)), DVec2::new(27.0, 11.0));
    }

    #[test]
    fn units_and_systems() {
        let path = Path::new("a.tif");
        let feet = placement(
            path,
            &tags(&[[3072, 0, 1, 2992], [3076, 0, 1, 9002], [4099, 0, 1, 9003]]),
        )
        .unwrap();
        assert_eq!(
            (feet.linear_unit, feet.crs.name.as_deref()),
            (Some(0.3048), Some("EPSG:2992"))
        );
        assert_eq!(feet.vertical_unit, Some(1200.0 / 3937.0));
        let mut own = tags(&[
            [3076, 0, 1, USER_DEFINED],
            [3077, 34736, 1, 1],
            [1026, 34737, 3, 1],
        ]);
        own.doubles = vec![0.0, 0.2];
        own.ascii = "xab|".into();
        let own = placement(path, &own).unwrap();
        assert_eq!(
            (own.linear_unit, own.crs.name.as_deref()),
            (Some(0.2), Some("ab"))
        );
        let degrees = placement(path, &tags(&[[1024, 0, 1, 2], [2048, 0, 1, 4326]]))
            .unwrap()
            .crs;
        assert!(degrees.geographic && degrees.name.as_deref() == Some("EPSG:4326"));
        assert!(placement(path, &tags(&[[3076, 0, 1, 4]])).is_err());
    }

    #[test]
    fn a_zero_pixel_scale_is_an_error() {
        let mut tags = tags(&[]);
        tags.pixel_scale = vec![0.0, 10.0, 0.0];
        assert!(
            placement(Path::new("a.tif"), &tags)
                .unwrap_err()
                .to_string()
                .contains("a.tif")
        );
    }
}
