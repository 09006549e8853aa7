//! GDAL's side files: `NAME.aux.xml` beside an image, and the XML that GDAL keeps in a TIFF tag.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec2;
use serde::Deserialize;

use super::error::InputError;
use super::georef::{GeoTransform, Placement};
use super::wkt;

/// Largest side file that is read (they can hold histograms and attribute tables).
const MAX_BYTES: u64 = 64 << 20;

#[derive(Deserialize)]
struct Dataset {
    #[serde(rename = "SRS")]
    srs: Option<String>,
    #[serde(rename = "GeoTransform")]
    geo_transform: Option<String>,
    #[serde(rename = "PAMRasterBand", default)]
    bands: Vec<Band>,
}

#[derive(Deserialize)]
struct Band {
    #[serde(rename = "NoDataValue")]
    nodata: Option<String>,
    #[serde(rename = "Scale")]
    scale: Option<String>,
    #[serde(rename = "Offset")]
    offset: Option<String>,
    #[serde(rename = "UnitType")]
    unit: Option<String>,
}

#[derive(Deserialize)]
struct Metadata {
    #[serde(rename = "Item", default)]
    items: Vec<MetadataItem>,
}

#[derive(Deserialize)]
struct MetadataItem {
    #[serde(rename = "@role")]
    role: Option<String>,
    #[serde(rename = "@sample")]
    sample: Option<usize>,
    #[serde(rename = "$text")]
    text: Option<String>,
}

/// What `NAME.aux.xml` beside `image` says; nothing if there is none.
pub(crate) fn read_beside(image: &Path) -> Result<Placement, InputError> {
    let mut name: OsString = image.as_os_str().to_owned();
    name.push(".aux.xml");
    let path = PathBuf::from(name);
    if !path.is_file() {
        return Ok(Placement::default());
    }
    let size = fs::metadata(&path).map_err(|e| InputError::io(&path, e))?.len();
    if size > MAX_BYTES {
        return Err(InputError::georef(
            &path,
            format!("the side file has {size} bytes, the limit is {MAX_BYTES}"),
        ));
    }
    let bytes = fs::read(&path).map_err(|e| InputError::io(&path, e))?;
    read(&path, &String::from_utf8_lossy(&bytes))
}

fn read(path: &Path, text: &str) -> Result<Placement, InputError> {
    let dataset: Dataset =
        quick_xml::de::from_str(text).map_err(|e| InputError::damaged(path, format!("side file: {e}")))?;
    let mut placement = Placement::default();
    if let Some(text) = dataset.srs.filter(|text| !text.trim().is_empty()) {
        placement.set_crs(wkt::parse(&text).map_err(|what| InputError::georef(path, what))?);
    }
    if let Some(text) = dataset.geo_transform {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|word| number(path, "GeoTransform", word))
            .collect::<Result<_, _>>()?;
        let &[x, a, b, y, d, e] = numbers.as_slice() else {
            return Err(InputError::georef(
                path,
                format!("GeoTransform has {} numbers instead of 6", numbers.len()),
            ));
        };
        let transform = GeoTransform {
            origin: DVec2::new(x, y),
            column: DVec2::new(a, d),
            row: DVec2::new(b, e),
        };
        placement.transform = Some(transform.checked(path)?);
    }
    if let Some(band) = dataset.bands.first() {
        let value = |name: &str, text: &Option<String>| {
            text.as_deref().map(|text| number(path, name, text)).transpose()
        };
        placement.nodata = band.nodata.as_deref().and_then(|text| text.trim().parse().ok());
        placement.scale = value("Scale", &band.scale)?;
        placement.offset = value("Offset", &band.offset)?;
        placement.vertical_unit = band.unit.as_deref().and_then(unit).or(placement.vertical_unit);
    }
    Ok(placement)
}

/// Scale, offset and unit of the first band out of the XML in TIFF tag 42112; what cannot be read there is ignored.
pub(crate) fn from_tiff_metadata(text: &str) -> Placement {
    let mut placement = Placement::default();
    let Ok(metadata) = quick_xml::de::from_str::<Metadata>(text.trim_end_matches('\0')) else {
        return placement;
    };
    for item in metadata.items.iter().filter(|item| item.sample.unwrap_or(0) == 0) {
        let text = item.text.as_deref().unwrap_or_default().trim();
        let finite = || text.parse::<f64>().ok().filter(|v| v.is_finite());
        match item.role.as_deref() {
            Some("scale") => placement.scale = finite(),
            Some("offset") => placement.offset = finite(),
            Some("unittype") => placement.vertical_unit = unit(text),
            _ => {}
        }
    }
    placement
}

fn number(path: &Path, element: &str, text: &str) -> Result<f64, InputError> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(InputError::georef(
            path,
            format!("{element}: '{}' is not a finite number", text.trim()),
        )),
    }
}

/// Metres per unit of a band's unit name.
fn unit(name: &str) -> Option<f64> {
    match name.trim().to_ascii_lowercase().as_str() {
        "m" | "metre" | "metres" | "meter" | "meters" => Some(1.0),
        "ft" | "foot" | "feet" | "international foot" => Some(0.3048),
        "us-ft" | "ftus" | "us survey foot" | "us_survey_foot" | "foot_us" => Some(1200.0 / 3937.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transform_crs_nodata_and_scale() {
        let text = r#"<PAMDataset>
            <SRS dataAxisToSRSAxisMapping="1,2">PROJCS[&quot;x&quot;,UNIT[&quot;foot&quot;,0.3048],AUTHORITY[&quot;EPSG&quot;,&quot;2992&quot;]]</SRS>
            <GeoTransform> 1e3, 2, 0, 5e2, 0, -2</GeoTransform>
            <Metadata><MDI key="AREA_OR_POINT">Area</MDI></Metadata>
            <PAMRasterBand band="1"><NoDataValue le_hex_equiv="00">-1.5</NoDataValue><Scale>0.5</Scale>
              <Offset>-7</Offset><UnitType>ft</UnitType></PAMRasterBand>
            <PAMRasterBand band="2"><Scale>9</Scale></PAMRasterBand>
          </PAMDataset>"#;
        let placement = read(Path::new("a.png.aux.xml"), text).unwrap();
        assert_eq!(placement.crs.name.as_deref(), Some("EPSG:2992"));
        assert_eq!(placement.linear_unit, Some(0.3048));
        let transform = placement.transform.unwrap();
        assert_eq!(transform.at(DVec2::new(1.0, 1.0)), DVec2::new(1002.0, 498.0));
        assert_eq!(
            (placement.nodata, placement.scale, placement.offset),
            (Some(-1.5), Some(0.5), Some(-7.0))
        );
        assert_eq!(placement.vertical_unit, Some(0.3048));
    }

    #[test]
    fn faults_are_named() {
        let path = Path::new("a.aux.xml");
        for text in [
            "<PAMDataset><GeoTransform>1,2,3</GeoTransform></PAMDataset>",
            "<PAMDataset><GeoTransform>1,2,3,4,5,nan</GeoTransform></PAMDataset>",
            "<PAMDataset><GeoTransform>0,0,0,0,0,0</GeoTransform></PAMDataset>",
            "<PAMDataset><GeoTransform>",
            "<PAMDataset><SRS>nonsense</SRS></PAMDataset>",
        ] {
            let message = read(path, text).unwrap_err().to_string();
            assert!(
                message.starts_with("a.aux.xml: ") && !message.contains('\n'),
                "{message}"
            );
        }
    }

    #[test]
    fn scale_and_unit_in_a_tiff() {
        let placement = from_tiff_metadata(
            "<GDALMetadata><Item name=\"A\">x</Item><Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.1</Item>\
             <Item name=\"SCALE\" sample=\"1\" role=\"scale\">3</Item>\
             <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">ft</Item></GDALMetadata>",
        );
        assert_eq!(
            (placement.scale, placement.vertical_unit),
            (Some(0.1), Some(0.3048))
        );
    }
}
