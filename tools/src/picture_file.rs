//! Pictures on disk: linear light to sRGB PNG over a sky and back, and the animated overview of a flight.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use brickfell_culler::Camera;
use brickfell_formats::value::{linear_to_srgb, srgb_to_linear};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::present::{HORIZON, ZENITH};

use crate::input::{InputError, Raster};
use crate::metrics::LinearImage;

/// 8-bit sRGB pixels, three bytes each, row 0 at the top.
#[derive(Clone, Debug)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height * 3` bytes.
    pub rgb: Vec<u8>,
}

/// Composites a picture over the sky that its camera sees, in linear light.
pub fn linear_over_sky(picture: &Picture, camera: &Camera) -> LinearImage {
    let pixel = |(k, pixel): (usize, &[f32; 4])| {
        let (x, y) = (k % picture.width as usize, k / picture.width as usize);
        let sky = if pixel[3] < 1.0 {
            let rise = camera
                .ray(x as f64, y as f64)
                .normalize_or_zero()
                .z
                .clamp(0.0, 1.0) as f32;
            let up = rise * (2.0 - rise);
            std::array::from_fn(|c| HORIZON[c] + (ZENITH[c] - HORIZON[c]) * up)
        } else {
            [0.0; 3]
        };
        std::array::from_fn(|c| pixel[c] + (1.0 - pixel[3]) * sky[c])
    };
    LinearImage {
        width: picture.width,
        height: picture.height,
        rgb: picture.pixels.iter().enumerate().map(pixel).collect(),
    }
}

/// Composites a picture over the sky that its camera sees.
pub fn over_sky(picture: &Picture, camera: &Camera) -> Image {
    Image::from(&linear_over_sky(picture, camera))
}

impl From<&LinearImage> for Image {
    fn from(linear: &LinearImage) -> Self {
        Self {
            width: linear.width,
            height: linear.height,
            rgb: linear.rgb.iter().flatten().copied().map(linear_to_srgb).collect(),
        }
    }
}

/// Reads a picture (PNG, JPEG, BMP, TGA, TIFF) as linear light; what is not opaque lies over black.
///
/// # Errors
/// A file that cannot be read, or whose picture is too large.
pub fn load_linear(path: &Path) -> Result<LinearImage, InputError> {
    let raster = Raster::load(path)?;
    let linear = |[r, g, b, a]: [u8; 4]| [r, g, b].map(|c| srgb_to_linear(c) * (f32::from(a) / 255.0));
    Ok(LinearImage {
        width: raster.width,
        height: raster.height,
        rgb: raster.pixels.into_iter().map(linear).collect(),
    })
}

impl Image {
    /// Writes a PNG file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> io::Result<()> {
        self.write(BufWriter::new(File::create(path)?))
    }

    /// Writes a PNG.
    ///
    /// # Errors
    /// If `to` does not take it.
    pub fn write(&self, to: impl Write) -> io::Result<()> {
        let mut writer = encoder(to, self.width, self.height).write_header()?;
        writer.write_image_data(&self.rgb)?;
        Ok(writer.finish()?)
    }

    /// The picture scaled down by averaging boxes of pixels.
    fn scaled(&self, width: u32, height: u32) -> Self {
        let mut rgb = Vec::with_capacity((width * height * 3) as usize);
        let range = |k: u32, of: u32, from: u32| {
            let lo = u64::from(k) * u64::from(from) / u64::from(of);
            let hi = (u64::from(k) + 1) * u64::from(from) / u64::from(of);
            lo as usize..(hi.max(lo + 1)).min(u64::from(from)) as usize
        };
        for y in 0..height {
            for x in 0..width {
                let (ys, xs) = (range(y, height, self.height), range(x, width, self.width));
                for c in 0..3 {
                    let mut sum = 0;
                    for row in ys.clone() {
                        sum += xs
                            .clone()
                            .map(|col| u32::from(self.rgb[(row * self.width as usize + col) * 3 + c]))
                            .sum::<u32>();
                    }
                    let count = (ys.len() * xs.len()) as u32;
                    rgb.push(((sum + count / 2) / count.max(1)) as u8);
                }
            }
        }
        Self { width, height, rgb }
    }
}

fn encoder<W: Write>(to: W, width: u32, height: u32) -> png::Encoder<'static, W> {
    let mut encoder = png::Encoder::new(to, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder
}

/// Widest overview, pixels.
const OVERVIEW_WIDTH: u32 = 640;

/// Writes the animated overview of a flight: an animated PNG whose still picture, shown where animation is not, is the
/// contact sheet of all frames.
///
/// # Errors
/// If the file cannot be written or there is no frame.
pub fn save_overview(path: &Path, frames: &[Image], frames_per_second: f64) -> io::Result<()> {
    let first = frames
        .first()
        .ok_or_else(|| io::Error::other("a flight without frames has no overview"))?;
    let width = first.width.min(OVERVIEW_WIDTH);
    let height = (u64::from(first.height) * u64::from(width) / u64::from(first.width)).max(1) as u32;
    let columns = (frames.len() as f64).sqrt().ceil() as u32;
    let rows = (frames.len() as u32).div_ceil(columns);
    let (cell_width, cell_height) = ((width / columns).max(1), (height / rows).max(1));
    let mut sheet = Image {
        width,
        height,
        rgb: vec![0; (width * height * 3) as usize],
    };
    for (k, frame) in frames.iter().enumerate() {
        let cell = frame.scaled(cell_width, cell_height);
        let (left, top) = (k as u32 % columns * cell_width, k as u32 / columns * cell_height);
        for y in 0..cell_height.min(height.saturating_sub(top)) {
            let count = (cell_width.min(width.saturating_sub(left)) * 3) as usize;
            let to = (((top + y) * width + left) * 3) as usize;
            let from = (y * cell_width * 3) as usize;
            sheet.rgb[to..to + count].copy_from_slice(&cell.rgb[from..from + count]);
        }
    }
    let mut encoder = encoder(BufWriter::new(File::create(path)?), width, height);
    encoder.set_animated(frames.len() as u32, 0)?;
    encoder.set_sep_def_img(true)?;
    encoder.set_frame_delay(
        (1000.0 / frames_per_second.max(0.1)).clamp(10.0, 2000.0) as u16,
        1000,
    )?;
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&sheet.rgb)?;
    for frame in frames {
        writer.write_image_data(&frame.scaled(width, height).rgb)?;
    }
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn half_covered_pixels_mix_with_the_sky_in_linear_light() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Y, 1.0, 2, 1).unwrap();
        let picture = Picture {
            width: 2,
            height: 1,
            pixels: vec![[0.5, 0.5, 0.5, 1.0], [0.0, 0.0, 0.0, 0.5]],
        };
        let image = over_sky(&picture, &camera);
        assert_eq!(image.rgb[..3], [188; 3]);
        assert_eq!(image.rgb[3], linear_to_srgb(0.5 * HORIZON[0]));
    }

    #[test]
    fn the_overview_is_an_animation_with_a_contact_sheet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("overview.png");
        let frames: Vec<_> = (0..5u8)
            .map(|k| Image {
                width: 8,
                height: 6,
                rgb: vec![k * 50; 8 * 6 * 3],
            })
            .collect();
        save_overview(&path, &frames, 10.0).unwrap();
        let mut reader = png::Decoder::new(io::BufReader::new(File::open(&path).unwrap()))
            .read_info()
            .unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 5);
        let mut sheet = vec![0; 8 * 6 * 3];
        reader.next_frame(&mut sheet).unwrap();
        // Three columns of two pixels: frames 0, 1, 2 in the first row.
        assert_eq!((sheet[0], sheet[2 * 3], sheet[4 * 3]), (0, 50, 100));
        assert!(save_overview(&path, &[], 10.0).is_err());
    }
}
