//! Heights and colours of rectangles of the builder's columns.
//!
//! A rectangle is taken in parts whose pixels fit a window of some megabytes, on as many threads as there are; what a
//! point gets depends on the point alone. Where the raster's place is affine, a position costs two multiplications.

use rayon::prelude::*;

use super::cells::Window;
use super::error::InputError;
use super::heights::HeightMap;
use super::imagery::Span;
use super::layer::Layer;
use super::mapping::{Columns, Mapping, Vertical};
use super::place::Place;

/// Rows of a part, at most.
const ROWS: usize = 32;
/// Pixels of a window, unless it is for a single point.
const WINDOW: f64 = (1 << 20) as f64;
/// Heights of a slanting vertical are found to so many metres.
const HEIGHT_STEP: f64 = 1e-5;

/// Some points of a rectangle: the first, and how many along x and y.
#[derive(Clone, Copy)]
struct Part {
    first: [usize; 2],
    size: [usize; 2],
}

impl Part {
    /// Calls `each` for parts of it whose pixels, as `pixels` counts them, fit a window.
    fn split(
        self,
        pixels: &impl Fn(Part) -> f64,
        each: &mut impl FnMut(Part) -> Result<(), InputError>,
    ) -> Result<(), InputError> {
        let axis = usize::from(self.size[1] > self.size[0]);
        if self.size[axis] <= 1 || pixels(self) <= WINDOW {
            return each(self);
        }
        let (mut low, mut high) = (self, self);
        low.size[axis] /= 2;
        high.first[axis] += low.size[axis];
        high.size[axis] -= low.size[axis];
        low.split(pixels, each)?;
        high.split(pixels, each)
    }
}

/// The pixels that positions in a range need, with so many around.
fn pixels(range: (f64, f64), around: f64, size: u32) -> std::ops::Range<u32> {
    // Casting cuts at the ends of what u32 holds, and makes 0 of NaN.
    let start = (range.0 - around).floor() as u32;
    let end = ((range.1 + around).ceil() as u32).min(size);
    start.min(end)..end
}

impl HeightMap {
    /// Heights of the ground (its z, metres) at points a column apart, `width` of them in a row, from `first` on (in
    /// columns). NaN where there is none.
    ///
    /// # Errors
    /// If a part of the file cannot be read.
    pub(crate) fn heights(
        &self,
        columns: Columns,
        first: [f64; 2],
        width: usize,
        z: &mut [f64],
    ) -> Result<(), InputError> {
        let rows = z.len() / width.max(1);
        let lo = first.map(|v| v.floor() as i64);
        let hi = [0, 1].map(|k| (first[k] + [width, rows][k] as f64).ceil() as i64);
        let mapping = Mapping::new(&self.place, columns, lo, hi);
        let range = self.min_max();
        let range = (f64::from(range.0), f64::from(range.1));
        z.par_chunks_mut(ROWS * width.max(1))
            .enumerate()
            .try_for_each(|(band, z)| {
                let at = |i: usize, j: usize| [first[0] + i as f64, first[1] + (band * ROWS + j) as f64];
                let around = |part: Part| {
                    let [x, y] = [0, 1].map(|k| part.first[k] + part.size[k] - 1);
                    mapping.around(at(part.first[0], part.first[1]), at(x, y), range)
                };
                let count = |part: Part| {
                    let [u, v, _] = around(part);
                    (u.1 - u.0 + 3.0) * (v.1 - v.0 + 3.0)
                };
                let all = Part {
                    first: [0; 2],
                    size: [width, z.len() / width.max(1)],
                };
                all.split(&count, &mut |part| {
                    let [u, v, _] = around(part);
                    let window = self
                        .cells
                        .window(pixels(u, 1.0, self.width), pixels(v, 1.0, self.height))?;
                    for j in part.first[1]..part.first[1] + part.size[1] {
                        let start = j * width + part.first[0];
                        for (z, i) in z[start..start + part.size[0]].iter_mut().zip(part.first[0]..) {
                            let [x, y] = at(i, j);
                            *z = ground(&window, &mapping, x, y, range);
                        }
                    }
                    Ok(())
                })
            })
    }

    /// Least and greatest z, metres, that the ground may have over a rectangle of columns, if there may be any.
    pub(crate) fn range_over(&self, columns: Columns, lo: [i64; 2], hi: [i64; 2]) -> Option<(f64, f64)> {
        let around = |range: (f32, f32)| {
            Mapping::far_around(&self.place, columns, lo, hi, (range.0.into(), range.1.into()))
        };
        let [u, v, _] = around(self.min_max());
        // A rectangle that only touches the map has no column's middle on it.
        let on_map = |(low, high): (f64, f64), size: u32| low < f64::from(size) && high > 0.0;
        if !(on_map(u, self.width) && on_map(v, self.height)) {
            return None;
        }
        let range = self
            .ranges
            .over(pixels(u, 1.0, self.width), pixels(v, 1.0, self.height))?;
        Some(around(range)[2])
    }
}

/// z of the ground over a point given in columns.
#[inline]
fn ground(window: &Window, mapping: &Mapping, x: f64, y: f64, range: (f64, f64)) -> f64 {
    match mapping {
        Mapping::Affine(_) => bilinear(window, mapping.at(x, y).pixel_at(0.0)),
        Mapping::Nodes(_) => {
            let vertical = mapping.at(x, y);
            let mut height = 0.5 * (range.0 + range.1);
            // Verticals differ by a few degrees from the frame's Z: each step leaves a few hundredths of the error.
            for _ in 0..16 {
                let next = bilinear(window, vertical.pixel_at(height));
                let done = (next - height).abs() < HEIGHT_STEP;
                height = next;
                if done || next.is_nan() || vertical.pixel_rise == [0.0; 2] {
                    break;
                }
            }
            vertical.z_at(height)
        }
    }
}

/// Height at a position in pixel space: bilinear between samples, constant across the outer half pixel, NaN outside and
/// where a sample that counts is nodata.
#[inline]
fn bilinear(window: &Window, [u, v]: [f64; 2]) -> f64 {
    let (w, h) = (f64::from(window.size.0), f64::from(window.size.1));
    if !(u >= 0.0 && v >= 0.0 && u <= w && v <= h) {
        return f64::NAN;
    }
    let fx = (u - 0.5).clamp(0.0, w - 1.0);
    let fy = (v - 0.5).clamp(0.0, h - 1.0);
    let (column, row) = (fx as usize, fy as usize);
    let (tx, ty) = (fx - column as f64, fy - row as f64);
    // A neighbour of weight zero must not spoil the result, nor lie outside the raster.
    let right = usize::from(tx > 0.0);
    let mix = |row: usize| match window.row(row, column..column + 1 + right) {
        [a] => f64::from(f32::from_le_bytes(*a)),
        [a, b] => {
            let [a, b] = [a, b].map(|h| f64::from(f32::from_le_bytes(*h)));
            a + tx * (b - a)
        }
        _ => f64::NAN,
    };
    let top = mix(row);
    if ty > 0.0 {
        top + ty * (mix(row + 1) - top)
    } else {
        top
    }
}

impl Layer {
    /// Colours of columns of a rectangle, `width` of them in a row, from column `first` on, straight linear light. For
    /// each there are z of the ground in its middle (metres, NaN without ground) and of its unit normal.
    ///
    /// # Errors
    /// If a part of the file cannot be read.
    pub(crate) fn colors(
        &self,
        columns: Columns,
        first: [i64; 2],
        width: usize,
        ground: &[(f64, f32)],
    ) -> Result<Vec<[f32; 3]>, InputError> {
        let mut rgb = vec![[0.0; 3]; ground.len()];
        let hi = [
            first[0] + width as i64,
            first[1] + (ground.len() / width.max(1)) as i64,
        ];
        let heights = Mapping::new(&self.map.place, columns, first, hi);
        let picture = self
            .imagery
            .as_ref()
            .map(|i| (i, Mapping::new(&i.place, columns, first, hi)));
        rgb.par_chunks_mut(ROWS * width.max(1))
            .zip(ground.par_chunks(ROWS * width.max(1)))
            .enumerate()
            .try_for_each(|(band, (rgb, ground))| {
                let middle = |i: usize, j: usize| {
                    [
                        (first[0] + i as i64) as f64 + 0.5,
                        (first[1] + (band * ROWS + j) as i64) as f64 + 0.5,
                    ]
                };
                let height = |x: f64, y: f64, z: f64| {
                    let vertical = heights.at(x, y);
                    (z - vertical.z) / vertical.z_rise
                };
                let Some((imagery, mapping)) = &picture else {
                    for (k, (rgb, (z, up))) in rgb.iter_mut().zip(ground).enumerate().filter(|(_, c)| !c.1.0.is_nan()) {
                        let [x, y] = middle(k % width, k / width);
                        *rgb = self.color(None, || height(x, y, *z), *up);
                    }
                    return Ok(());
                };
                // Heights in the picture's own sense, from z; for all that is level they are the same.
                let in_picture = |vertical: &Vertical, z: f64| (z - vertical.z) / vertical.z_rise;
                let zs = ground.iter().filter(|g| !g.0.is_nan());
                let (low, high) = zs.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), g| (l.min(g.0), h.max(g.0)));
                if low > high {
                    return Ok(());
                }
                let size = (imagery.cells.width, imagery.cells.height);
                let around = |part: Part| {
                    let [x, y] = [0, 1].map(|k| part.first[k] + part.size[k] - 1);
                    let (a, b) = (middle(part.first[0], part.first[1]), middle(x, y));
                    let base = mapping.around(a, b, (0.0, 0.0))[2];
                    mapping.around(a, b, (low - base.1 - 1.0, high - base.0 + 1.0))
                };
                let half = mapping.half(middle(0, 0)[0], middle(0, 0)[1]).map(|h| h.max(0.5));
                let count = |part: Part| {
                    let [u, v, _] = around(part);
                    (u.1 - u.0 + 2.0 * half[0]) * (v.1 - v.0 + 2.0 * half[1])
                };
                let all = Part {
                    first: [0; 2],
                    size: [width, ground.len() / width.max(1)],
                };
                // Where rows of the picture go from west to east, spans are those of the part's rows and columns.
                let straight = matches!(&imagery.place, Place::Affine { to_pixel, .. } if to_pixel.column.y == 0.0 && to_pixel.row.x == 0.0);
                all.split(&count, &mut |part| {
                    let [u, v, _] = around(part);
                    let (mx, my) = (half[0] * 1.5 + 1.0, half[1] * 1.5 + 1.0);
                    let window = imagery.cells.window(pixels(u, mx, size.0), pixels(v, my, size.1))?;
                    let spans: Vec<Option<Span>> = if straight {
                        let span = |i: usize| {
                            let [x, y] = middle(part.first[0] + i, part.first[1]);
                            Span::new(mapping.at(x, y).pixel_at(0.0)[0], mapping.half(x, y)[0], size.0)
                        };
                        (0..part.size[0]).map(span).collect()
                    } else {
                        Vec::new()
                    };
                    for j in part.first[1]..part.first[1] + part.size[1] {
                        let row = {
                            let [x, y] = middle(part.first[0], j);
                            Span::new(mapping.at(x, y).pixel_at(0.0)[1], mapping.half(x, y)[1], size.1)
                        };
                        for i in part.first[0]..part.first[0] + part.size[0] {
                            let k = j * width + i;
                            let (z, up) = ground[k];
                            if z.is_nan() {
                                continue;
                            }
                            let [x, y] = middle(i, j);
                            let color = if straight {
                                let column = spans.get(i - part.first[0]).and_then(Option::as_ref);
                                column.zip(row.as_ref()).and_then(|(c, r)| imagery.mean_of(&window, c, r))
                            } else {
                                let vertical = mapping.at(x, y);
                                let pixel = vertical.pixel_at(in_picture(&vertical, z));
                                imagery.mean(&window, pixel, mapping.half(x, y))
                            };
                            rgb[k] = self.color(color, || height(x, y, z), up);
                        }
                    }
                    Ok(())
                })
            })?;
        Ok(rgb)
    }
}
