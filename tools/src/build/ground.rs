//! Height maps on the lattice: the surface over the columns of cells around one tree, and the colours of solid ground.
//!
//! The surface of a column is the fan of four triangles between the heights at its corners, which neighbouring columns
//! share, and at its centre. Heights are in cell coordinates of the whole lattice.

use glam::DVec3;
use rayon::prelude::*;

use super::lattice::{CellBox, Lattice};
use super::spill::{Reader, Writer};
use crate::input::{Columns, InputError, Layer};

use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::{linear_to_srgb, srgb_to_linear};

/// One layer over the columns of a rectangle of cells.
#[derive(Debug)]
pub(crate) struct GroundGrid {
    lo: [i64; 2],
    size: [i64; 2],
    corners: Vec<f64>,
    columns: Vec<Column>,
}

#[derive(Clone, Copy, Debug)]
struct Column {
    /// NaN where there is no ground.
    centre: f64,
    rgb: [f32; 3],
    normal: [f32; 3],
}

/// The ground in one column of cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ground {
    heights: [f64; 5],
    /// Cells that the surface meets, both inclusive; those below are solid.
    pub(crate) lowest: i64,
    pub(crate) highest: i64,
    /// Straight linear light.
    pub(crate) rgb: [f32; 3],
    pub(crate) normal: [f32; 3],
}

impl Ground {
    /// The part of the cell at height `z` that lies under the surface.
    pub(crate) fn filled(&self, z: i64) -> f32 {
        const SHARE: [f64; 5] = [0.125, 0.125, 0.125, 0.125, 0.5];
        let z = z as f64;
        self.heights
            .iter()
            .zip(SHARE)
            .map(|(h, w)| (h - z).clamp(0.0, 1.0) * w)
            .sum::<f64>() as f32
    }
}

impl Layer {
    /// The rectangle of cells that the map may reach.
    pub(crate) fn extent(&self, lattice: &Lattice) -> ([i64; 2], [i64; 2]) {
        let (min, max) = self.map.bounds();
        let lo = min.to_array().map(|v| lattice.cell_of(v).floor() as i64 - 1);
        let hi = max.to_array().map(|v| lattice.cell_of(v).ceil() as i64 + 1);
        (lo, hi)
    }

    /// Least and greatest height (cell coordinates) that the columns of a rectangle of cells may have, if there may be
    /// ground: never too narrow, and too wide by what lies some pixels around it.
    pub(crate) fn range(&self, lattice: &Lattice, lo: [i64; 2], hi: [i64; 2]) -> Option<(f64, f64)> {
        let (l, h) = self.extent(lattice);
        let lo = [0, 1].map(|k| lo[k].max(l[k]));
        let hi = [0, 1].map(|k| hi[k].min(h[k]));
        if lo[0] >= hi[0] || lo[1] >= hi[1] {
            return None;
        }
        let (low, high) = self.map.range_over(columns(lattice), lo, hi)?;
        Some((lattice.cell_of(low), lattice.cell_of(high)))
    }
}

fn columns(lattice: &Lattice) -> Columns {
    Columns {
        step: lattice.voxel,
        zero: lattice.shift(),
    }
}

impl GroundGrid {
    /// A layer over a rectangle of cells; `None` where it has no ground there.
    ///
    /// # Errors
    /// If a part of the layer's files cannot be read.
    pub(crate) fn new(layer: &Layer, lattice: &Lattice, area: &CellBox) -> Result<Option<Self>, InputError> {
        let (l, h) = layer.extent(lattice);
        let lo: [i64; 2] = std::array::from_fn(|k| area.lo[k].max(l[k]));
        let size: [i64; 2] = std::array::from_fn(|k| area.hi[k].min(h[k]) - lo[k]);
        if size[0] <= 0 || size[1] <= 0 {
            return Ok(None);
        }
        let heights = |at: f64, more: i64| {
            let [w, h] = size.map(|s| (s + more) as usize);
            let mut heights = vec![0.0; w * h];
            layer
                .map
                .heights(columns(lattice), lo.map(|v| v as f64 + at), w, &mut heights)?;
            Ok::<_, InputError>(heights)
        };
        let centres = heights(0.5, 0)?;
        if centres.iter().all(|z| z.is_nan()) {
            return Ok(None);
        }
        let mut corners = heights(0.0, 1)?;
        corners.par_iter_mut().for_each(|z| *z = lattice.cell_of(*z));
        let mut grid = Self {
            lo,
            size,
            corners,
            columns: Vec::new(),
        };
        let width = size[0] as usize;
        let column = |k: usize| {
            let centre = lattice.cell_of(centres[k]);
            let normal = if centre.is_nan() {
                DVec3::ZERO
            } else {
                let [a, b, c, d] = grid.corner_heights((k % width) as i64, (k / width) as i64, centre);
                let slope = [(b + d - a - c) * 0.5, (c + d - a - b) * 0.5];
                DVec3::new(-slope[0], -slope[1], 1.0).normalize()
            };
            Column {
                centre,
                rgb: [0.0; 3],
                normal: normal.as_vec3().to_array(),
            }
        };
        let mut all: Vec<Column> = (0..centres.len()).into_par_iter().map(column).collect();
        let ground: Vec<(f64, f32)> = centres.iter().zip(&all).map(|(z, c)| (*z, c.normal[2])).collect();
        let colors = layer.colors(columns(lattice), lo, width, &ground)?;
        all.iter_mut()
            .zip(colors)
            .for_each(|(column, rgb)| column.rgb = rgb);
        grid.columns = all;
        Ok(Some(grid))
    }

    /// Heights at the corners of a column, the centre's where there is none (at the rim of the map).
    fn corner_heights(&self, i: i64, j: i64, centre: f64) -> [f64; 4] {
        let at = (j * (self.size[0] + 1) + i) as usize;
        let next = at + self.size[0] as usize + 1;
        [at, at + 1, next, next + 1].map(|k| match self.corners.get(k) {
            Some(h) if !h.is_nan() => *h,
            _ => centre,
        })
    }

    /// The ground in the column of cells at (x, y).
    pub(crate) fn ground(&self, x: i64, y: i64) -> Option<Ground> {
        let (i, j) = (x - self.lo[0], y - self.lo[1]);
        if i < 0 || j < 0 || i >= self.size[0] || j >= self.size[1] {
            return None;
        }
        let column = self
            .columns
            .get((j * self.size[0] + i) as usize)
            .filter(|c| !c.centre.is_nan())?;
        let [a, b, c, d] = self.corner_heights(i, j, column.centre);
        let heights = [a, b, c, d, column.centre];
        let least = heights.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(Ground {
            heights,
            lowest: least.floor() as i64,
            highest: greatest.floor() as i64,
            rgb: column.rgb,
            normal: column.normal,
        })
    }
}

/// Colour and normal of solid ground that no surface gives them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Hint {
    /// Straight linear light.
    pub(crate) rgb: [f32; 3],
    /// Mean normal, length up to 1.
    pub(crate) normal: [f32; 3],
}

/// Steps of the colours of deep solid (sRGB codes) and of its normals.
const DEEP_COLOR: u8 = 16;
const DEEP_NORMAL: f32 = 32.0 / 127.0;

/// Hints by column of cells of one mip: the mean of the ground above.
#[derive(Debug)]
pub(crate) struct Hints {
    lo: [i64; 2],
    size: [i64; 2],
    /// Sums of colours (linear light) and normals, and their share.
    looks: Vec<[f32; 7]>,
}

impl Hints {
    /// Of the finest level over a rectangle of cells; the first layer with ground counts.
    pub(crate) fn finest(grids: &[GroundGrid], area: &CellBox) -> Self {
        let [x0, y0, _] = area.lo;
        let size = if grids.is_empty() {
            [0, 0]
        } else {
            [area.hi[0] - x0, area.hi[1] - y0]
        };
        let look = |(i, j): (i64, i64)| {
            let ground = grids.iter().find_map(|g| g.ground(x0 + i, y0 + j));
            ground.map_or([0.0; 7], |g| {
                let ([r, g, b], [x, y, z]) = (g.rgb, g.normal);
                [r, g, b, x, y, z, 1.0]
            })
        };
        let cells = (0..size[1])
            .into_par_iter()
            .flat_map_iter(|j| (0..size[0]).map(move |i| (i, j)));
        Self {
            lo: [x0, y0],
            size,
            looks: cells.map(look).collect(),
        }
    }

    /// Of the next coarser mip, over a rectangle of its cells.
    pub(crate) fn coarser(&self, layout: SampleLayout, area: &CellBox) -> Self {
        let [x0, y0, _] = area.lo;
        let size = if self.looks.is_empty() {
            [0, 0]
        } else {
            [area.hi[0] - x0, area.hi[1] - y0]
        };
        let taps: &[(i64, f32)] = match layout {
            SampleLayout::Centre => &[(0, 0.5), (1, 0.5)],
            SampleLayout::Corner => &[(-1, 0.25), (0, 0.5), (1, 0.25)],
        };
        let look = |(i, j): (i64, i64)| {
            let mut sum = [0.0f32; 7];
            for (dy, wy) in taps {
                for (dx, wx) in taps {
                    let c = self.at(2 * (x0 + i) + dx, 2 * (y0 + j) + dy);
                    (0..7).for_each(|k| sum[k] += c[k] * wx * wy);
                }
            }
            sum
        };
        let cells = (0..size[1])
            .into_par_iter()
            .flat_map_iter(|j| (0..size[0]).map(move |i| (i, j)));
        Self {
            lo: [x0, y0],
            size,
            looks: cells.map(look).collect(),
        }
    }

    /// Writes those of the columns in a box.
    pub(crate) fn write(&self, cells: &CellBox, out: &mut Writer) {
        let (lo, hi) = (cells.lo, cells.hi);
        let columns = (lo[1]..hi[1]).flat_map(|y| (lo[0]..hi[0]).map(move |x| (x, y)));
        let looks = columns
            .filter(|_| !self.looks.is_empty())
            .map(|(x, y)| self.at(x, y));
        out.list(&looks.collect::<Vec<_>>());
    }

    /// Hints over a rectangle of cells, of what was written of boxes that do not meet.
    pub(crate) fn read(area: &CellBox, parts: &mut [(CellBox, Reader)]) -> Option<Self> {
        let lo = [area.lo[0], area.lo[1]];
        let size = [area.hi[0] - lo[0], area.hi[1] - lo[1]];
        let mut looks = vec![[0.0; 7]; (size[0] * size[1]) as usize];
        for (cells, part) in parts {
            let width = cells.hi[0] - cells.lo[0];
            for (k, look) in part.list::<[f32; 7]>()?.into_iter().enumerate() {
                let k = k as i64;
                let (x, y) = (cells.lo[0] + k % width - lo[0], cells.lo[1] + k / width - lo[1]);
                if x >= 0 && y >= 0 && x < size[0] && y < size[1] {
                    looks[(y * size[0] + x) as usize] = look;
                }
            }
        }
        Some(Self { lo, size, looks })
    }

    /// The sums of colours and normals of a column of cells, and their share.
    pub(crate) fn at(&self, x: i64, y: i64) -> [f32; 7] {
        let (i, j) = (x - self.lo[0], y - self.lo[1]);
        if i < 0 || j < 0 || i >= self.size[0] || j >= self.size[1] {
            return [0.0; 7];
        }
        self.looks
            .get((j * self.size[0] + i) as usize)
            .copied()
            .unwrap_or_default()
    }

    /// The hint of the column of cells at (x, y).
    pub(crate) fn hint(&self, x: i64, y: i64) -> Hint {
        self.mean([x, y], 1)
    }

    /// For solid that no surface is near, at (x, y): the mean of the 2×2 columns that have the same place, roughly. Rays do not get
    /// that far but for a tint, so it may be told in few bytes.
    pub(crate) fn deep_hint(&self, x: i64, y: i64) -> Hint {
        let Hint { rgb, normal } = self.mean([x & !1, y & !1], 2);
        let rough = |c: f32| (linear_to_srgb(c) & !(DEEP_COLOR - 1)) + DEEP_COLOR / 2;
        Hint {
            rgb: rgb.map(|c| srgb_to_linear(rough(c))),
            normal: normal.map(|c| ((c / DEEP_NORMAL).round() * DEEP_NORMAL).clamp(-1.0, 1.0)),
        }
    }

    /// The mean of a square of columns.
    pub(crate) fn mean(&self, lo: [i64; 2], side: i64) -> Hint {
        let mut sum = [0.0f32; 7];
        for y in lo[1]..lo[1] + side {
            for x in lo[0]..lo[0] + side {
                let c = self.at(x, y);
                (0..7).for_each(|k| sum[k] += c[k]);
            }
        }
        let [r, g, b, x, y, z, w] = sum;
        if w > 0.0 {
            Hint {
                rgb: [r / w, g / w, b / w],
                normal: [x / w, y / w, z / w],
            }
        } else {
            Hint::default()
        }
    }
}
