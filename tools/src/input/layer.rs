//! A height map with the picture that lies over it: the ground, and its colour.
//!
//! Immutable once loaded; read from many threads. For rectangles of the builder's columns there is [`super::survey`].

use std::path::Path;
use std::sync::Arc;

use glam::DVec3;

use super::block_cache::RasterCache;
use super::cells::Window;
use super::error::InputError;
use super::files::HeightInput;
use super::georef::{self, GeoTransform, Placement};
use super::height_samples::HeightFile;
use super::heights::{HeightMap, HeightOptions, Relief};
use super::image_file;
use super::imagery::{Imagery, ramp_color};
use super::place::Frame;

/// A height map and the picture laid over it.
#[derive(Debug)]
pub struct Layer {
    /// The heights.
    pub map: HeightMap,
    /// The picture; without one, ground is coloured by height and slope.
    pub imagery: Option<Imagery>,
}

/// A layer that is all in memory, for rays.
#[derive(Debug)]
pub(crate) struct LayerView<'a> {
    layer: &'a Layer,
    pub(crate) relief: Relief<'a>,
    picture: Option<Window<'a>>,
}

impl Layer {
    /// The layer with all of its pixels.
    pub(crate) fn view(&self) -> Result<LayerView<'_>, InputError> {
        Ok(LayerView {
            layer: self,
            relief: self.map.relief()?,
            picture: self.imagery.as_ref().map(|i| i.cells.all()).transpose()?,
        })
    }

    /// Colour of ground at a height of the map, with the z of its unit normal, under a premultiplied colour of the
    /// picture: straight linear light.
    #[inline]
    pub(super) fn color(&self, picture: Option<[f32; 4]>, height: impl FnOnce() -> f64, up: f32) -> [f32; 3] {
        let [r, g, b, a] = picture.filter(|c| c[3] > 0.0).unwrap_or_else(|| {
            let (low, high) = self.map.min_max();
            let above = (height() as f32 - low) / (high - low).max(f32::MIN_POSITIVE);
            ramp_color(above, up)
        });
        [r / a, g / a, b / a]
    }
}

impl LayerView<'_> {
    /// Colour of the ground at a point of the world, metres, with the z of its unit normal: straight linear light.
    pub(crate) fn color(&self, point: DVec3, up: f32) -> [f32; 3] {
        let picture = self.layer.imagery.as_ref().zip(self.picture.as_ref());
        let picture = picture.and_then(|(imagery, window)| {
            let pixel = imagery.place.pixel(point);
            imagery.mean(window, [pixel.x, pixel.y], [0.0; 2])
        });
        self.layer.color(picture, || self.layer.map.height_of(point), up)
    }
}

/// The highest ground of several layers at world metres `(x, y)`, if there is any.
///
/// # Errors
/// If a part of a file cannot be read.
pub(crate) fn highest_ground(layers: &[Layer], x: f64, y: f64) -> Result<Option<f64>, InputError> {
    layers.iter().try_fold(None, |highest: Option<f64>, layer| {
        let here = layer.map.height_at(x, y)?;
        Ok(highest.into_iter().chain(here).reduce(f64::max))
    })
}

/// Reads height maps with their pictures and puts them together in one frame.
///
/// Where only one of a pair of files has a georeference it serves both: an image without one covers exactly the height
/// map, and heights without one (and without `pixel_size`) cover exactly the image. A missing coordinate system is taken
/// from the other file likewise.
///
/// # Errors
/// Missing, damaged or unsupported files, no valid height, systems that cannot be related, a picture beside the heights.
pub fn load_layers(
    heights: &[HeightInput],
    options: HeightOptions,
    cache: &Arc<RasterCache>,
) -> Result<Vec<Layer>, InputError> {
    let sources = heights
        .iter()
        .map(|h| Source::look(h, &options))
        .collect::<Result<Vec<_>, _>>()?;
    let places: Vec<_> = sources
        .iter()
        .map(|s| (s.input.path.as_path(), &s.place, (s.file.width, s.file.height)))
        .collect();
    let frame = Frame::of(&places)?;
    sources
        .into_iter()
        .map(|s| s.read(&frame, &options, cache))
        .collect()
}

/// Files that have been looked at.
struct Source<'a> {
    input: &'a HeightInput,
    file: HeightFile,
    place: Placement,
    picture: Option<Placement>,
    notes: Vec<String>,
}

impl<'a> Source<'a> {
    fn look(input: &'a HeightInput, options: &HeightOptions) -> Result<Self, InputError> {
        let path = &input.path;
        let file = HeightFile::open(path, options)?;
        let size = (file.width, file.height);
        let mut notes = Vec::new();
        let mut place = read_place(path, size, &mut notes)?;
        let mut picture = None;
        if let Some(path) = &input.imagery {
            let image_size = image_file::size(path)?;
            let image = read_place(path, image_size, &mut notes)?;
            if !place.is_placed() && options.pixel_size.is_none() {
                place.transform = image.transform.map(|t| t.resized(image_size, size));
            }
            if place.is_placed() && !place.has_system() {
                place.crs = image.crs.clone();
                place.linear_unit = image.linear_unit;
            }
            picture = Some(image);
        }
        if !place.is_placed() {
            let pixel = options.pixel_size.unwrap_or(1.0);
            if !(pixel.is_finite() && pixel > 0.0) {
                return Err(InputError::georef(
                    path,
                    format!("pixel size {pixel} is not a positive number"),
                ));
            }
            place.transform = Some(GeoTransform::north_up(glam::DVec2::ZERO, pixel, size.1));
        }
        Ok(Self {
            input,
            file,
            place,
            picture,
            notes,
        })
    }

    fn read(
        self,
        frame: &Frame,
        options: &HeightOptions,
        cache: &Arc<RasterCache>,
    ) -> Result<Layer, InputError> {
        let mut map = HeightMap::read(&self.input.path, self.file, &self.place, frame, options, cache)?;
        map.notes = self.notes;
        let imagery = match (&self.input.imagery, self.picture) {
            (Some(path), Some(place)) => Some(Imagery::read(path, place, &map, &self.place, frame, cache)?),
            _ => None,
        };
        Ok(Layer { map, imagery })
    }
}

fn read_place(path: &Path, size: (u32, u32), notes: &mut Vec<String>) -> Result<Placement, InputError> {
    let mut place = georef::read(path)?;
    if place.guess_degrees(size) {
        notes.push(format!(
            "{}: coordinates of no stated system are taken for degrees; a .prj file beside it can say otherwise",
            path.display()
        ));
    }
    Ok(place)
}

/// A height map and, if given, its picture, as tests have them.
#[cfg(test)]
pub(crate) fn load_layer(
    heights: &Path,
    imagery: Option<&Path>,
    options: HeightOptions,
) -> Result<Layer, InputError> {
    let input = HeightInput {
        path: heights.to_path_buf(),
        imagery: imagery.map(Path::to_path_buf),
    };
    let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
    let mut layers = load_layers(&[input], options, &cache)?;
    Ok(layers.remove(0))
}
