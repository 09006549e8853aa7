//! Textures of meshes: repeat addressing, a mip pyramid filtered in premultiplied linear light.
//!
//! Level 0 is the picture as decoded; each further level halves both sides (never below 1) by the exact area mean, and has two
//! cells a texel: 16 bits each of red and green, then of blue and opacity. Every level is a raster as height maps are: whole or
//! in blocks, in the memory that all share. Samples do not depend on which it is.
//! OBJ convention: u to the right, v up, (0, 0) is the lower-left corner. Immutable; sampled from many threads.

use std::sync::Arc;

use glam::Vec2;

use super::block_cache::{Cell, RasterCache};
use super::cells::{Cells, Rows};
use super::error::InputError;
#[cfg(test)]
use super::image_file::Raster;
use super::linear::{LINEAR, premultiplied};
use super::pixels::{Pixels, some};

/// A picture that covers a mesh.
#[derive(Debug)]
pub struct Texture {
    /// Finest first; never empty.
    levels: Vec<Cells>,
    linear: Box<[f32; 256]>,
    cutout: bool,
}

/// A level of a texture, ready for samples of a surface. Near ones cost less than far ones.
#[derive(Clone, Debug)]
pub struct Sampler<'a> {
    /// Of level 0, whose texels are as decoded.
    linear: Option<&'a [f32; 256]>,
    /// Columns and rows of texels.
    size: (u32, u32),
    pixels: Pixels<'a>,
}

impl Texture {
    /// Builds the pyramid over a picture; `cutout` says whether any of it is less than opaque.
    pub(super) fn new(base: Cells, cutout: bool, cache: &Arc<RasterCache>) -> Result<Self, InputError> {
        let mut size = (base.width, base.height);
        let mut levels = vec![base];
        while size.0 > 1 || size.1 > 1 {
            let number = levels.len() - 1;
            let mut rows = Halved {
                from: &levels[number],
                fine: number == 0,
                size,
                next: 0,
            };
            size = rows.half();
            let level = Cells::from_rows(&mut rows, cache, &mut |_, _, _| ())?;
            levels.push(level);
        }
        Ok(Self {
            levels,
            linear: Box::new(*LINEAR),
            cutout,
        })
    }

    /// A texture of a picture in memory.
    #[cfg(test)]
    pub(crate) fn of(base: Raster) -> Self {
        let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
        let cutout = base.pixels.iter().any(|p| p[3] < 255);
        Self::new(Cells::whole(base.width, base.height, base.pixels), cutout, &cache).unwrap()
    }

    /// Width and height of level 0 in texels.
    pub fn size(&self) -> (u32, u32) {
        (self.levels[0].width, self.levels[0].height)
    }

    /// Whether any texel is not fully opaque.
    pub fn has_alpha(&self) -> bool {
        self.cutout
    }

    /// For samples that stand for what is `footprint_texels` wide, in texels of level 0: the level whose texel is nearest to it.
    pub fn sampler(&self, footprint_texels: f32) -> Sampler<'_> {
        let level = footprint_texels.max(1.0).log2().round() as usize;
        let level = level.min(self.levels.len() - 1);
        let cells = &self.levels[level];
        let wide = if level == 0 { 1 } else { 2 };
        Sampler {
            linear: (level == 0).then_some(&*self.linear),
            size: (cells.width / wide, cells.height),
            pixels: Pixels::new(cells),
        }
    }
}

impl Sampler<'_> {
    /// Colour at `uv`, repeated beyond 0..1, interpolated between texels: straight linear-light RGB and alpha.
    ///
    /// # Errors
    /// If a part of the texture cannot be read.
    #[inline]
    pub fn at(&mut self, uv: Vec2) -> Result<[f32; 4], InputError> {
        let (pixels, (w, h)) = (&mut self.pixels, self.size);
        let sum = match self.linear {
            Some(linear) => bilinear(w, h, uv, |x, y| {
                pixels.get(x, y).map(|[pixel]| premultiplied(linear, pixel))
            }),
            None => bilinear(w, h, uv, |x, y| pixels.get(2 * x, y).map(texel)),
        }?;
        Ok(match sum[3] {
            a if a > 0.0 => [sum[0] / a, sum[1] / a, sum[2] / a, a],
            _ => [0.0; 4],
        })
    }
}

/// A texel of a level above the first: linear premultiplied RGBA.
#[inline]
fn texel([[r0, r1, g0, g1], [b0, b1, a0, a1]]: [Cell; 2]) -> [f32; 4] {
    [[r0, r1], [g0, g1], [b0, b1], [a0, a1]].map(|c| f32::from(u16::from_le_bytes(c)) * (1.0 / 65535.0))
}

/// The next level of a picture, made row by row: exact area means, also of odd sizes.
struct Halved<'a> {
    from: &'a Cells,
    /// Whether that is level 0.
    fine: bool,
    /// Of it, texels.
    size: (u32, u32),
    next: u32,
}

impl Halved<'_> {
    /// Columns and rows of texels.
    fn half(&self) -> (u32, u32) {
        ((self.size.0 / 2).max(1), (self.size.1 / 2).max(1))
    }

    /// The texels of the next row, of rows of the level before with their weights.
    fn mean(&self, row: &mut [Cell], lines: &[(&[Cell], f32)], color: impl Fn(&[Cell], usize) -> [f32; 4]) {
        let (width, _) = self.half();
        for (x, to) in (0..width).zip(row.as_chunks_mut().0) {
            let mut sum = [0.0f32; 4];
            for (line, wy) in lines {
                for (column, wx) in taps(x, self.size.0, width) {
                    let color = color(line, column as usize);
                    for (total, channel) in sum.iter_mut().zip(color) {
                        *total += channel * wx * wy;
                    }
                }
            }
            let [r, g, b, a] = sum.map(|c| ((c.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes());
            *to = [[r[0], r[1], g[0], g[1]], [b[0], b[1], a[0], a[1]]];
        }
    }
}

impl Rows for Halved<'_> {
    fn size(&self) -> (u32, u32) {
        let (width, height) = self.half();
        (2 * width, height)
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        let rows: Vec<(u32, f32)> = taps(self.next, self.size.1, self.half().1).collect();
        let all = |rows: &[(u32, f32)]| Some(rows.first()?.0..rows.last()?.0 + 1);
        let window = self.from.window(0..self.from.width, all(&rows).unwrap_or(0..0))?;
        let line = |(y, weight): &(u32, f32)| (window.row(*y as usize, 0..self.from.width as usize), *weight);
        let lines: Vec<(&[Cell], f32)> = rows.iter().map(line).collect();
        if self.fine {
            let linear = &*LINEAR;
            self.mean(row, &lines, |line, x| {
                premultiplied(linear, some::<1>(line, x)[0])
            });
        } else {
            self.mean(row, &lines, |line, x| texel(some(line, 2 * x)));
        }
        self.next += 1;
        Ok(())
    }
}

/// Source texels under texel `index` of the smaller level, with weights that add up to 1.
fn taps(index: u32, from: u32, to: u32) -> impl Iterator<Item = (u32, f32)> {
    let ratio = f64::from(from) / f64::from(to);
    let (low, high) = (f64::from(index) * ratio, f64::from(index + 1) * ratio);
    (low as u32..(high.ceil() as u32).min(from)).map(move |i| {
        let covered = (f64::from(i) + 1.0).min(high) - f64::from(i).max(low);
        (i, (covered.max(0.0) / ratio) as f32)
    })
}

/// Bilinear interpolation with repetition; `v` upwards, row 0 at the top.
#[inline]
fn bilinear(
    w: u32,
    h: u32,
    uv: Vec2,
    mut at: impl FnMut(u32, u32) -> Result<[f32; 4], InputError>,
) -> Result<[f32; 4], InputError> {
    let axis = |t: f32, size: u32| {
        let wrapped = t - t.floor();
        let position = if wrapped.is_finite() {
            wrapped * size as f32 - 0.5
        } else {
            0.0
        };
        let low = position.floor();
        let first = (low as i64).rem_euclid(i64::from(size)) as u32;
        (first, (first + 1) % size, position - low)
    };
    let (x0, x1, tx) = axis(uv.x, w);
    let (y0, y1, ty) = axis(1.0 - uv.y, h);
    let (a, b, c, d) = (at(x0, y0)?, at(x1, y0)?, at(x0, y1)?, at(x1, y1)?);
    Ok(std::array::from_fn(|i| {
        let top = a[i] + tx * (b[i] - a[i]);
        let bottom = c[i] + tx * (d[i] - c[i]);
        top + ty * (bottom - top)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_formats::value::srgb_to_linear;

    const WHITE: [u8; 4] = [255; 4];
    const BLACK: [u8; 4] = [0, 0, 0, 255];
    const CLEAR: [u8; 4] = [0, 255, 0, 0];

    impl Texture {
        fn sample(&self, uv: Vec2, footprint_texels: f32) -> [f32; 4] {
            self.sampler(footprint_texels).at(uv).unwrap()
        }
    }

    fn texture(width: u32, height: u32, pixels: Vec<[u8; 4]>) -> Texture {
        Texture::of(Raster {
            width,
            height,
            pixels,
        })
    }

    #[test]
    fn v_is_up_and_uv_repeats() {
        let t = texture(1, 2, vec![WHITE, BLACK]);
        assert_eq!(t.sample(Vec2::new(0.5, 0.75), 0.0)[0], 1.0);
        assert_eq!(t.sample(Vec2::new(0.5, 0.25), 0.0)[0], 0.0);
        for shift in [-3.0, 7.0] {
            assert_eq!(t.sample(Vec2::new(0.5 - shift, 0.75 + shift), 0.0)[0], 1.0);
        }
        assert!(
            (t.sample(Vec2::new(0.5, 1.0), 0.0)[0] - 0.5).abs() < 1e-6,
            "the seam interpolates round"
        );
        assert!(
            t.sample(Vec2::new(f32::NAN, f32::INFINITY), f32::NAN)
                .iter()
                .all(|c| c.is_finite())
        );
    }

    #[test]
    fn clear_texels_do_not_tint() {
        let t = texture(2, 2, vec![WHITE, CLEAR, CLEAR, CLEAR]);
        let coarse = t.sample(Vec2::splat(0.3), 2.0);
        assert!(
            (coarse[3] - 0.25).abs() < 1e-4
                && (coarse[0] - 1.0).abs() < 1e-4
                && (coarse[1] - 1.0).abs() < 1e-4
        );
        assert!(t.has_alpha());
        assert_eq!(t.sample(Vec2::new(0.75, 0.25), 1.0), [0.0; 4]);
    }

    #[test]
    fn levels_are_means_in_linear_light() {
        let grey = [188, 188, 188, 255];
        let t = texture(3, 1, vec![grey, BLACK, WHITE]);
        let mean = (srgb_to_linear(188) + 1.0) / 3.0;
        assert!((t.sample(Vec2::splat(0.1), 64.0)[0] - mean).abs() < 1e-4);
        let odd = texture(5, 3, vec![WHITE; 15]);
        assert!((odd.sample(Vec2::splat(0.4), 2.0)[0] - 1.0).abs() < 1e-4);
    }
}
