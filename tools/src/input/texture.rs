//! Textures of meshes: repeat addressing, a mip pyramid filtered in premultiplied linear light.
//!
//! Level 0 is the picture as decoded; each further level halves both sides (never below 1) by the exact area mean.
//! OBJ convention: u to the right, v up, (0, 0) is the lower-left corner. Immutable; sampled from many threads.

use glam::Vec2;

use super::image_file::Raster;
use super::linear::{LINEAR, premultiplied};

/// Linear premultiplied RGBA, 16 bits a channel.
type Texel = [u16; 4];

/// A picture that covers a mesh.
#[derive(Debug, Clone)]
pub struct Texture {
    base: Raster,
    mips: Vec<Mip>,
    linear: Box<[f32; 256]>,
    cutout: bool,
}

#[derive(Debug, Clone)]
struct Mip {
    width: u32,
    height: u32,
    texels: Vec<Texel>,
}

impl Texture {
    /// Builds the pyramid over a picture of at least one pixel.
    pub fn new(base: Raster) -> Texture {
        let linear = Box::new(*LINEAR);
        let mut mips: Vec<Mip> = Vec::new();
        while let (w, h) = mips
            .last()
            .map_or((base.width, base.height), |m| (m.width, m.height))
            && (w > 1 || h > 1)
        {
            let mip = match mips.last() {
                None => halve(w, h, |x, y| premultiplied(&linear, base.pixel(x, y))),
                Some(last) => halve(w, h, |x, y| last.at(x, y)),
            };
            mips.push(mip);
        }
        let cutout = base.pixels.iter().any(|p| p[3] < 255);
        Texture {
            base,
            mips,
            linear,
            cutout,
        }
    }

    /// Width and height of level 0 in texels.
    pub fn size(&self) -> (u32, u32) {
        (self.base.width, self.base.height)
    }

    /// Whether any texel is not fully opaque.
    pub fn has_alpha(&self) -> bool {
        self.cutout
    }

    /// Colour at `uv`, repeated beyond 0..1: straight linear-light RGB and alpha. `footprint_texels` is the width, in
    /// texels of level 0, of what the sample stands for: the level whose texel is nearest to it is interpolated.
    pub fn sample(&self, uv: Vec2, footprint_texels: f32) -> [f32; 4] {
        let level = footprint_texels.max(1.0).log2().round() as usize;
        let sum = match level
            .min(self.mips.len())
            .checked_sub(1)
            .and_then(|i| self.mips.get(i))
        {
            None => bilinear(self.base.width, self.base.height, uv, |x, y| {
                premultiplied(&self.linear, self.base.pixel(x, y))
            }),
            Some(mip) => bilinear(mip.width, mip.height, uv, |x, y| mip.at(x, y)),
        };
        match sum[3] {
            a if a > 0.0 => [sum[0] / a, sum[1] / a, sum[2] / a, a],
            _ => [0.0; 4],
        }
    }
}

impl Mip {
    #[inline]
    fn at(&self, x: u32, y: u32) -> [f32; 4] {
        let texel = self.texels[y as usize * self.width as usize + x as usize];
        texel.map(|c| f32::from(c) * (1.0 / 65535.0))
    }
}

/// The next level of a picture of `w × h` texels: exact area means, also of odd sizes.
fn halve(w: u32, h: u32, at: impl Fn(u32, u32) -> [f32; 4]) -> Mip {
    let (width, height) = ((w / 2).max(1), (h / 2).max(1));
    let mut texels = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0f32; 4];
            for (row, wy) in taps(y, h, height) {
                for (column, wx) in taps(x, w, width) {
                    let color = at(column, row);
                    for (total, channel) in sum.iter_mut().zip(color) {
                        *total += channel * wx * wy;
                    }
                }
            }
            texels.push(sum.map(|c| (c.clamp(0.0, 1.0) * 65535.0).round() as u16));
        }
    }
    Mip {
        width,
        height,
        texels,
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
fn bilinear(w: u32, h: u32, uv: Vec2, at: impl Fn(u32, u32) -> [f32; 4]) -> [f32; 4] {
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
    let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
    std::array::from_fn(|i| {
        let top = a[i] + tx * (b[i] - a[i]);
        let bottom = c[i] + tx * (d[i] - c[i]);
        top + ty * (bottom - top)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickfell_formats::value::srgb_to_linear;

    const WHITE: [u8; 4] = [255; 4];
    const BLACK: [u8; 4] = [0, 0, 0, 255];
    const CLEAR: [u8; 4] = [0, 255, 0, 0];

    fn texture(width: u32, height: u32, pixels: Vec<[u8; 4]>) -> Texture {
        Texture::new(Raster {
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
