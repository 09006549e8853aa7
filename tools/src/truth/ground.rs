//! The solid below height maps, in blocks of cells, and where rays enter it.
//!
//! *Cells* lie between the centres of neighbouring samples: cell (i, j) has the samples (i − 1, j − 1) to (i, j), and
//! along the map's edges are half cells whose missing samples are those of the edge, as
//! [`crate::input::HeightMap::height_at`] has it.
//! *Cell coordinates* are pixel space + ½, so that cell i is the interval [i, i + 1). A cell with a nodata sample has no
//! ground. Inside a cell the surface is a bilinear patch, its depth along a ray the root of a quadratic.
//!
//! A ray meets a block where it first is inside its solid, be that on the surface, a wall, the bottom or at its start: as
//! the surface goes on from cell to cell there is no need to know which. Any thread.

use std::ops::Range;

use glam::{DVec2, DVec3, dvec2};
use rayon::prelude::*;

use super::bottom::{Bottom, Floors};
use crate::input::heights::Relief;
use crate::input::{InputError, Layer, LayerView, Look};

/// Cells of a block per axis, at most.
const SIDE: usize = 16;

/// How far inside of the map's edge colours are looked up, pixels.
const INSIDE: f64 = 1e-3;

/// Column and row of a cell.
pub(super) type Cell = (usize, usize);

/// All height maps.
pub(super) struct Ground<'a> {
    layers: Vec<LayerView<'a>>,
    blocks: Vec<Block>,
}

/// Some cells of a height map.
struct Block {
    layer: usize,
    columns: Range<usize>,
    rows: Range<usize>,
    /// Metres.
    bottom: f64,
    highest: f64,
}

/// The patch of a cell: `h + u·x + v·y + w·x·y` in metres, with x and y from 0 to 1.
#[derive(Clone, Copy)]
struct Patch {
    h: f64,
    u: f64,
    v: f64,
    w: f64,
}

impl Patch {
    /// `None` where there is no ground.
    #[inline]
    fn new(map: &Relief, (i, j): Cell) -> Option<Self> {
        let (width, height) = (map.width as usize, map.height as usize);
        let sample = |i: usize, j: usize| {
            let (column, row) = (
                i.saturating_sub(1).min(width - 1),
                j.saturating_sub(1).min(height - 1),
            );
            map.sample(column, row)
        };
        let [a, b, c, d] = [
            sample(i, j),
            sample(i + 1, j),
            sample(i, j + 1),
            sample(i + 1, j + 1),
        ];
        let w = (d - c) - (b - a);
        (!w.is_nan()).then_some(Self {
            h: a,
            u: b - a,
            v: c - a,
            w,
        })
    }

    fn height(&self, at: DVec2) -> f64 {
        self.h + self.u * at.x + (self.v + self.w * at.x) * at.y
    }

    /// Where in `0..=length` a point that starts at `at` and `z`, with steps `step` and `dz`, first is not above the patch.
    #[inline]
    fn meet(&self, at: DVec2, z: f64, step: DVec2, dz: f64, length: f64) -> Option<f64> {
        let c = z - self.height(at);
        if c <= 0.0 {
            return Some(0.0);
        }
        let a = -self.w * step.x * step.y;
        let b = dz - self.u * step.x - self.v * step.y - self.w * (at.x * step.y + at.y * step.x);
        // Above the patch at the start: a·t² + b·t + c has to fall to 0. The form of the roots that does not cancel.
        let inner = b * b - 4.0 * a * c;
        if inner >= 0.0 {
            let q = -0.5 * (b + inner.sqrt().copysign(b));
            let first = [q / a, c / q].into_iter().filter(|t| *t >= 0.0).reduce(f64::min);
            if let Some(t) = first.filter(|t| *t <= length) {
                return Some(t);
            }
        }
        // What rounding has put just behind the end.
        (length.is_finite() && (a * length + b) * length + c <= 0.0).then_some(length)
    }
}

impl<'a> Ground<'a> {
    pub(super) fn new(layers: &'a [Layer], bottom: &Bottom) -> Result<Self, InputError> {
        let floors = Floors::new(bottom);
        let layers = layers.iter().map(Layer::view).collect::<Result<Vec<_>, _>>()?;
        let blocks = layers.iter().enumerate().flat_map(|(layer, l)| {
            let map = &l.relief;
            let size = [map.width as usize + 1, map.height as usize + 1];
            // The world place of a cell's middle; cells along the edge are halves.
            let end = dvec2(f64::from(map.width), f64::from(map.height));
            let place =
                |i: f64, j: f64| map.pixel_to_world(dvec2(i, j).clamp(DVec2::splat(0.25), end - 0.25));
            // Blocks end where the bottom changes: exactly so where rows go from west to east, else nearly.
            let columns = cut(size[0], |i| floors.interval(0, place(i as f64, end.y * 0.5).x));
            let rows = cut(size[1], |j| floors.interval(1, place(end.x * 0.5, j as f64).y));
            let blocks: Vec<Block> = rows
                .par_iter()
                .flat_map_iter(|rows| columns.iter().map(move |columns| (rows, columns)))
                .filter_map(|(rows, columns)| {
                    let cells = rows.clone().flat_map(|j| columns.clone().map(move |i| (i, j)));
                    let heights = cells.filter_map(|cell| {
                        let p = Patch::new(map, cell)?;
                        let corners = [p.h, p.h + p.u, p.h + p.v, p.h + p.u + p.v + p.w];
                        corners.into_iter().reduce(f64::max)
                    });
                    let highest = heights.reduce(f64::max)?;
                    let middle = |cells: &Range<usize>| (cells.start + cells.end - 1) as f64 * 0.5;
                    let bottom = floors.at(place(middle(columns), middle(rows)));
                    (highest >= bottom).then(|| Block {
                        layer,
                        columns: columns.clone(),
                        rows: rows.clone(),
                        bottom,
                        highest,
                    })
                })
                .collect();
            blocks
        });
        let blocks = blocks.collect();
        Ok(Self { layers, blocks })
    }

    /// Boxes of the blocks: least and greatest corner, world metres.
    pub(super) fn boxes(&self) -> impl ParallelIterator<Item = (DVec3, DVec3)> {
        self.blocks.par_iter().map(|block| {
            let map = &self.layers[block.layer].relief;
            let corner = |x: usize, y: usize| map.pixel_to_world(dvec2(x as f64, y as f64) - 0.5);
            let (x, y) = (&block.columns, &block.rows);
            let corners = [
                corner(x.start, y.start),
                corner(x.end, y.start),
                corner(x.start, y.end),
                corner(x.end, y.end),
            ];
            let min = corners.into_iter().fold(DVec2::INFINITY, DVec2::min);
            let max = corners.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max);
            (min.extend(block.bottom), max.extend(block.highest))
        })
    }

    /// Depth (at least 0, in lengths of `d`) at which a ray first is in the solid of a block, and the cell it is in.
    pub(super) fn meet(&self, block: usize, eye: DVec3, d: DVec3) -> Option<(f64, Cell)> {
        let block = self.blocks.get(block)?;
        let map = &self.layers[block.layer].relief;
        let start = map.world_to_pixel(eye.truncate()) + 0.5;
        let step = map.direction_to_pixel(d.truncate());
        // Cells along the edge of the map are half as wide.
        let lo = dvec2(block.columns.start as f64, block.rows.start as f64).max(DVec2::splat(0.5));
        let size = dvec2(f64::from(map.width), f64::from(map.height));
        let hi = dvec2(block.columns.end as f64, block.rows.end as f64).min(size + 0.5);
        let (mut t, mut leave) = (0.0f64, f64::INFINITY);
        for (at, step, lo, hi) in [
            (start.x, step.x, lo.x, hi.x),
            (start.y, step.y, lo.y, hi.y),
            (eye.z, d.z, block.bottom, block.highest),
        ] {
            if step == 0.0 {
                if at < lo || at > hi {
                    return None;
                }
            } else {
                let (a, b) = ((lo - at) / step, (hi - at) / step);
                t = t.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        if t > leave {
            return None;
        }
        let first =
            |at: f64, range: &Range<usize>| (at.floor().max(0.0) as usize).clamp(range.start, range.end - 1);
        let entry = start + step * t;
        let mut cell = (first(entry.x, &block.columns), first(entry.y, &block.rows));
        let border = |cell: usize, at: f64, step: f64| match step {
            s if s > 0.0 => ((cell + 1) as f64 - at) / s,
            s if s < 0.0 => (cell as f64 - at) / s,
            _ => f64::INFINITY,
        };
        loop {
            let (x, y) = (border(cell.0, start.x, step.x), border(cell.1, start.y, step.y));
            let end = x.min(y).min(leave).max(t);
            if let Some(patch) = Patch::new(map, cell) {
                let at = start + step * t - dvec2(cell.0 as f64, cell.1 as f64);
                let at = at.clamp(DVec2::ZERO, DVec2::ONE);
                if let Some(more) = patch.meet(at, eye.z + d.z * t, step, d.z, end - t) {
                    return Some((t + more, cell));
                }
            }
            if end >= leave {
                return None;
            }
            let (next, range, forward) = if x <= y {
                (&mut cell.0, &block.columns, step.x > 0.0)
            } else {
                (&mut cell.1, &block.rows, step.y > 0.0)
            };
            *next = if forward { *next + 1 } else { next.checked_sub(1)? };
            if !range.contains(next) {
                return None;
            }
            t = end;
        }
    }

    /// Colour and normal of the ground over a point of the solid in a cell.
    pub(super) fn look(&self, block: usize, cell: Cell, point: DVec3) -> Look {
        let layer = &self.layers[self.blocks[block].layer];
        let map = &layer.relief;
        let corner = dvec2(cell.0 as f64, cell.1 as f64) - 0.5;
        let at = (map.world_to_pixel(point.truncate()) - corner).clamp(DVec2::ZERO, DVec2::ONE);
        // A wall's colour is that of the ground at it, whatever side of the map's edge rounding puts the point on.
        let size = dvec2(f64::from(map.width), f64::from(map.height));
        let place = map.pixel_to_world((corner + at).clamp(DVec2::splat(INSIDE), size - INSIDE));
        let patch = Patch::new(map, cell).unwrap_or(Patch {
            h: 0.0,
            u: 0.0,
            v: 0.0,
            w: 0.0,
        });
        let rise = dvec2(patch.u + patch.w * at.y, patch.v + patch.w * at.x);
        let slope = dvec2(
            rise.dot(map.direction_to_pixel(DVec2::X)),
            rise.dot(map.direction_to_pixel(DVec2::Y)),
        );
        let normal = DVec3::new(-slope.x, -slope.y, 1.0).normalize().as_vec3();
        Look {
            alpha: 1.0,
            rgb: layer.color(place.extend(patch.height(at)), normal.z),
            normal,
        }
    }
}

/// Cuts `0..count` into ranges of at most [`SIDE`] that `kind` does not change in.
fn cut(count: usize, kind: impl Fn(usize) -> usize) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    let mut last = None;
    for k in 0..count {
        let kind = Some(kind(k));
        match ranges.last_mut() {
            Some(range) if kind == last && range.len() < SIDE => range.end = k + 1,
            _ => ranges.push(k..k + 1),
        }
        last = kind;
    }
    ranges
}
