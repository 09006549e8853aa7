//! Positions in a raster for a rectangle of the builder's columns: affine where the raster's place is, else between nodes.
//!
//! Geodetic and projected coordinates take some hundred nanoseconds a point, and in a local frame several points a
//! column. So they are computed at nodes, one in [`STEP`] columns along each axis and always the same ones, and
//! interpolated linearly between them: the earth bends by `(STEP · voxel)² / 8 R` in between along both axes, together
//! 10 µm for voxels of 1 m and 10 cm for 100 m. Along a column's vertical, source space is linear to within millimetres. Any thread.

use glam::{DVec2, DVec3};

use super::geodesy::AXIS;
use super::georef::GeoTransform;
use super::place::Place;

/// Columns from node to node.
const STEP: i64 = 16;
/// Heights between which the way along a vertical is taken as straight, metres.
const RISE: f64 = 4096.0;
/// Positions are rounded to 2^-20 pixels, so that a sample that counts nothing by computation without errors does so.
const ROUND: f64 = 1.5 * (1u64 << 32) as f64;

/// The builder's columns along an axis: a coordinate in columns and one in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Columns {
    /// Metres from column to column.
    pub(crate) step: f64,
    /// The coordinate in columns of the origin of the world.
    pub(crate) zero: f64,
}

impl Columns {
    pub(crate) fn world(&self, at: f64) -> f64 {
        (at - self.zero) * self.step
    }
}

/// The vertical line over a point: where it meets the ellipsoid, and what it does a metre above that.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Vertical {
    /// Column and row at height 0, in pixel space.
    pub(crate) pixel: [f64; 2],
    /// z of height 0 in the world, metres.
    pub(crate) z: f64,
    /// Change of all three for a metre of height.
    pub(crate) pixel_rise: [f64; 2],
    pub(crate) z_rise: f64,
}

impl Vertical {
    #[inline]
    pub(crate) fn pixel_at(&self, height: f64) -> [f64; 2] {
        [0, 1].map(|k| round(self.pixel[k] + self.pixel_rise[k] * height))
    }

    #[inline]
    pub(crate) fn z_at(&self, height: f64) -> f64 {
        self.z + self.z_rise * height
    }

    fn mix(&self, other: &Self, t: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * t;
        Self {
            pixel: [0, 1].map(|k| mix(self.pixel[k], other.pixel[k])),
            z: mix(self.z, other.z),
            pixel_rise: [0, 1].map(|k| mix(self.pixel_rise[k], other.pixel_rise[k])),
            z_rise: mix(self.z_rise, other.z_rise),
        }
    }
}

#[inline]
fn round(pixel: f64) -> f64 {
    (pixel + ROUND) - ROUND
}

/// From coordinates in columns to a raster.
#[derive(Debug)]
pub(crate) enum Mapping {
    /// To pixel space; heights are z.
    Affine(GeoTransform),
    Nodes(Nodes),
}

#[derive(Debug)]
pub(crate) struct Nodes {
    lo: [i64; 2],
    across: usize,
    verticals: Vec<Vertical>,
}

impl Mapping {
    /// For columns `lo..=hi`.
    pub(crate) fn new(place: &Place, columns: Columns, lo: [i64; 2], hi: [i64; 2]) -> Self {
        match place {
            Place::Affine { to_pixel, .. } => Mapping::Affine(GeoTransform {
                origin: to_pixel.at(DVec2::splat(columns.world(0.0))),
                column: to_pixel.column * columns.step,
                row: to_pixel.row * columns.step,
            }),
            Place::Warped(_) => {
                let lo = lo.map(|v| v.div_euclid(STEP));
                let hi = hi.map(|v| v.div_euclid(STEP) + 1);
                let node = |k: i64| columns.world((k * STEP) as f64);
                Mapping::Nodes(Nodes {
                    lo,
                    across: (hi[0] - lo[0] + 1) as usize,
                    verticals: (lo[1]..=hi[1])
                        .flat_map(|j| (lo[0]..=hi[0]).map(move |i| (i, j)))
                        .map(|(i, j)| vertical(place, node(i), node(j)))
                        .collect(),
                })
            }
        }
    }

    /// The vertical over a point given in columns.
    #[inline]
    pub(crate) fn at(&self, x: f64, y: f64) -> Vertical {
        match self {
            Mapping::Affine(t) => Vertical {
                pixel: [
                    t.origin.x + t.column.x * x + t.row.x * y,
                    t.origin.y + t.column.y * x + t.row.y * y,
                ],
                z_rise: 1.0,
                ..Vertical::default()
            },
            Mapping::Nodes(nodes) => nodes.at(x, y),
        }
    }

    /// Half of the box around a column in pixel space.
    #[inline]
    pub(crate) fn half(&self, x: f64, y: f64) -> [f64; 2] {
        match self {
            Mapping::Affine(t) => ((t.column.abs() + t.row.abs()) * 0.5).to_array(),
            Mapping::Nodes(nodes) => {
                let (a, b, c) = (nodes.at(x, y), nodes.at(x + 0.5, y), nodes.at(x, y + 0.5));
                [0, 1].map(|k| (b.pixel[k] - a.pixel[k]).abs() + (c.pixel[k] - a.pixel[k]).abs())
            }
        }
    }

    /// Positions, heights `range` apart, that all those in a rectangle of points lie between: columns, rows and z.
    pub(crate) fn around(&self, lo: [f64; 2], hi: [f64; 2], range: (f64, f64)) -> [(f64, f64); 3] {
        let mut around = [(f64::INFINITY, f64::NEG_INFINITY); 3];
        let mut take = |v: Vertical| {
            for height in [range.0, range.1] {
                let [u, v, z] = [v.pixel_at(height)[0], v.pixel_at(height)[1], v.z_at(height)];
                for (range, at) in around.iter_mut().zip([u, v, z]) {
                    *range = (range.0.min(at), range.1.max(at));
                }
            }
        };
        match self {
            Mapping::Affine(_) => {
                for (x, y) in [(lo[0], lo[1]), (hi[0], lo[1]), (lo[0], hi[1]), (hi[0], hi[1])] {
                    take(self.at(x, y));
                }
            }
            Mapping::Nodes(nodes) => {
                let first = [0, 1].map(|k| (lo[k].floor() as i64).div_euclid(STEP) - nodes.lo[k]);
                let last = [0, 1].map(|k| (hi[k].floor() as i64).div_euclid(STEP) + 1 - nodes.lo[k]);
                for j in first[1]..=last[1] {
                    for i in first[0]..=last[0] {
                        if let Some(v) = nodes.verticals.get(j as usize * nodes.across + i as usize) {
                            take(*v);
                        }
                    }
                }
            }
        }
        around
    }

    /// Like [`Mapping::around`], for a rectangle of any size and from few points: too wide rather than too narrow.
    pub(crate) fn far_around(
        place: &Place,
        columns: Columns,
        lo: [i64; 2],
        hi: [i64; 2],
        range: (f64, f64),
    ) -> [(f64, f64); 3] {
        const PARTS: i64 = 4;
        if matches!(place, Place::Affine { .. }) {
            let [lo, hi] = [lo, hi].map(|p| p.map(|v| v as f64));
            return Mapping::new(place, columns, [0; 2], [0; 2]).around(lo, hi, range);
        }
        let mut around = [(f64::INFINITY, f64::NEG_INFINITY); 3];
        let at = |k: i64, axis: usize| {
            columns.world(lo[axis] as f64 + (hi[axis] - lo[axis]) as f64 * k as f64 / PARTS as f64)
        };
        for (i, j) in (0..=PARTS).flat_map(|j| (0..=PARTS).map(move |i| (i, j))) {
            let vertical = vertical(place, at(i, 0), at(j, 1));
            for height in [range.0, range.1] {
                let [u, v] = vertical.pixel_at(height);
                for (range, at) in around.iter_mut().zip([u, v, vertical.z_at(height)]) {
                    *range = (range.0.min(at), range.1.max(at));
                }
            }
        }
        // The earth, and lines of a projection, bulge between the points by a part of what they do over the rectangle.
        let side = (0..2)
            .map(|k| (hi[k] - lo[k]) as f64 * columns.step)
            .fold(0.0, f64::max);
        let bulge = side * side / (8.0 * AXIS);
        let part = |(lo, hi): (f64, f64)| (hi - lo) / PARTS as f64;
        let margin = [part(around[0]), part(around[1]), bulge];
        std::array::from_fn(|k| (around[k].0 - margin[k], around[k].1 + margin[k]))
    }
}

impl Nodes {
    #[inline]
    fn at(&self, x: f64, y: f64) -> Vertical {
        let (s, t) = (
            x / STEP as f64 - self.lo[0] as f64,
            y / STEP as f64 - self.lo[1] as f64,
        );
        let (i, j) = (s.floor(), t.floor());
        let k = j as usize * self.across + i as usize;
        let none = Vertical {
            pixel: [f64::NAN; 2],
            ..Vertical::default()
        };
        let node = |k: usize| self.verticals.get(k).unwrap_or(&none);
        let (low, high) = (k, k + self.across);
        let low = node(low).mix(node(low + 1), s - i);
        let high = node(high).mix(node(high + 1), s - i);
        low.mix(&high, t - j)
    }
}

/// The vertical at a place of the world, metres.
fn vertical(place: &Place, x: f64, y: f64) -> Vertical {
    // The z of a height: heights grow nearly evenly with z.
    let find = |height: f64| {
        let at = |z: f64| place.pixel(DVec3::new(x, y, z));
        let mut z = height - (x * x + y * y) / (2.0 * AXIS);
        let low = at(z);
        let slope = (at(z + 1000.0).z - low.z) / 1000.0;
        let mut here = low;
        for _ in 0..4 {
            z += (height - here.z) / slope;
            here = at(z);
        }
        (here, z)
    };
    let ((low, z0), (high, z1)) = if place.is_level() {
        let low = place.pixel(DVec3::new(x, y, 0.0));
        ((low, 0.0), (low, RISE))
    } else {
        (find(0.0), find(RISE))
    };
    Vertical {
        pixel: [low.x, low.y],
        z: z0,
        pixel_rise: [(high.x - low.x) / RISE, (high.y - low.y) / RISE],
        z_rise: (z1 - z0) / RISE,
    }
}
