//! The textures of all meshes of a terrain: each picture, or pair of colours and opacities, is read once, whoever names it.
//!
//! They are kept in the memory of rasters. As many are read at a time as what reading takes beside them has room in it. Called
//! from one thread; the work is spread over the rayon pool of its caller.

use std::collections::HashMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;

use super::block_cache::{Cell, RasterCache};
use super::cells::{Cells, Rows};
use super::error::InputError;
use super::image_file::{read_colors, reading_bytes};
use super::texture::Texture;

/// The files of a texture's colours and of its opacities; one at least, but for a material without a texture.
pub(crate) type Maps = (Option<PathBuf>, Option<PathBuf>);

/// The textures that were read so far.
#[derive(Debug)]
pub struct TextureSet {
    cache: Arc<RasterCache>,
    /// By the files' own paths, however they were written.
    textures: HashMap<Maps, Arc<Texture>>,
}

impl TextureSet {
    /// Without textures; they will be kept in the memory of `cache`.
    pub fn new(cache: &Arc<RasterCache>) -> Self {
        Self {
            cache: Arc::clone(cache),
            textures: HashMap::new(),
        }
    }

    /// The memory that they share with other rasters.
    pub fn cache(&self) -> &Arc<RasterCache> {
        &self.cache
    }

    /// The textures of some materials, in their order; those that are not there yet are read.
    ///
    /// # Errors
    /// Damaged or unsupported pictures, those that need more memory than there is, the scratch file.
    pub(crate) fn load(&mut self, all: &[Maps]) -> Result<Vec<Option<Arc<Texture>>>, InputError> {
        let own = |path: &PathBuf| fs::canonicalize(path).unwrap_or_else(|_| path.clone());
        let keys: Vec<Maps> = all
            .iter()
            .map(|(color, alpha)| (color.as_ref().map(own), alpha.as_ref().map(own)))
            .collect();
        // Messages are to have the paths as they were written.
        let missing: HashMap<&Maps, &Maps> = keys
            .iter()
            .zip(all)
            .filter(|(key, _)| key.0.is_some() || key.1.is_some())
            .filter(|(key, _)| !self.textures.contains_key(key))
            .collect();
        let mut sorted: Vec<(&Maps, &Maps)> = missing.into_iter().collect();
        sorted.sort();
        let room = self.cache.whole_file() + self.cache.bands();
        let mut rest = &sorted[..];
        while !rest.is_empty() {
            let (mut count, mut bytes) = (0, 0);
            for (_, maps) in rest {
                bytes += needs(maps, &self.cache)?;
                if count > 0 && bytes > room {
                    break;
                }
                count += 1;
            }
            let (some, others) = rest.split_at(count);
            let read = some
                .par_iter()
                .map(|(key, maps)| Ok(((*key).clone(), Arc::new(read(maps, &self.cache)?))))
                .collect::<Result<Vec<_>, InputError>>()?;
            self.textures.extend(read);
            rest = others;
        }
        Ok(keys.iter().map(|key| self.textures.get(key).cloned()).collect())
    }
}

/// What reading a texture takes, at most, beside the memory in which it is kept: its files are read one after the other.
fn needs((color, alpha): &Maps, cache: &RasterCache) -> Result<u64, InputError> {
    let files = [color, alpha].into_iter().flatten();
    files
        .map(|path| reading_bytes(path, cache))
        .try_fold(0, |most, bytes| Ok(bytes?.max(most)))
}

/// One texture out of a colour picture and an opacity picture, either of which may be missing.
fn read((color, alpha): &Maps, cache: &Arc<RasterCache>) -> Result<Texture, InputError> {
    let picture = |path: &PathBuf| {
        let mut clear = false;
        let cells = read_colors(path, None, cache, Some(&mut |_, _, row| clear |= any_clear(row)))?;
        Ok::<_, InputError>((cells, clear))
    };
    let color = color.as_ref().map(picture).transpose()?;
    let (base, cutout) = match (color, alpha.as_ref().map(picture).transpose()?) {
        (color, Some((mask, by_alpha))) => {
            let mut rows = Masked {
                color: color.as_ref().map(|(cells, _)| cells),
                mask: &mask,
                by_alpha,
                next: 0,
            };
            let mut clear = false;
            let cells = Cells::from_rows(&mut rows, cache, &mut |_, _, row| clear |= any_clear(row))?;
            (cells, clear)
        }
        (Some(color), None) => color,
        (None, None) => (Cells::whole(1, 1, vec![[255; 4]]), false),
    };
    Texture::new(base, cutout, cache)
}

fn any_clear(pixels: &[Cell]) -> bool {
    pixels.iter().any(|p| p[3] < 255)
}

/// A picture, white if there is none, with its opacity multiplied by a mask that is stretched over it.
struct Masked<'a> {
    color: Option<&'a Cells>,
    mask: &'a Cells,
    /// A mask with an alpha channel keeps the opacity there, otherwise in its brightness.
    by_alpha: bool,
    next: u32,
}

impl Rows for Masked<'_> {
    fn size(&self) -> (u32, u32) {
        let cells = self.color.unwrap_or(self.mask);
        (cells.width, cells.height)
    }

    fn next(&mut self, row: &mut [Cell]) -> Result<(), InputError> {
        let ((width, height), mask) = (self.size(), self.mask);
        match self.color {
            Some(color) => color.copy_row(self.next, row)?,
            None => row.fill([255; 4]),
        }
        let y = (u64::from(self.next) * u64::from(mask.height) / u64::from(height)) as u32;
        let mut line = vec![Cell::default(); mask.width as usize];
        mask.copy_row(y, &mut line)?;
        for (x, pixel) in row.iter_mut().enumerate() {
            let column = x as u64 * u64::from(mask.width) / u64::from(width);
            let [r, g, b, a] = line[column as usize].map(u32::from);
            let opacity = if self.by_alpha { a } else { (r + g + b) / 3 };
            pixel[3] = ((u32::from(pixel[3]) * opacity + 127) / 255) as u8;
        }
        self.next += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::test_data::textures;
    use crate::input::whole_file;
    use glam::Vec2;
    use std::path::Path;

    /// A picture without order.
    fn noise(width: u32, height: u32, seed: u32) -> image::RgbaImage {
        image::RgbaImage::from_fn(width, height, |x, y| {
            let h = (x * 7919 + y * 104_729 + seed).wrapping_mul(2_654_435_761);
            image::Rgba((h ^ h >> 13).to_le_bytes())
        })
    }

    fn color(path: &Path) -> Maps {
        (Some(path.to_path_buf()), None)
    }

    /// Samples of all levels, between texels and across the seam.
    fn samples(texture: &Texture) -> Vec<[u32; 4]> {
        let mut all = Vec::new();
        for level in 0..11 {
            let mut sampler = texture.sampler(f32::powi(2.0, level));
            for k in 0..400 {
                let k = k as f32;
                let uv = [
                    Vec2::new(k * 0.0137, k * 0.0713 - 9.0),
                    Vec2::new(-1e-4 * k, 1.0 + 1e-4 * k),
                ];
                all.extend(uv.map(|uv| sampler.at(uv).unwrap().map(f32::to_bits)));
            }
        }
        all
    }

    #[test]
    fn samples_do_not_depend_on_the_memory() {
        let dir = tempfile::tempdir().unwrap();
        let budget = 100_000;
        for (w, h) in [(1, 1), (3, 5), (257, 2), (900, 431)] {
            let path = dir.path().join("a.png");
            noise(w, h, 1).save(&path).unwrap();
            let whole = textures().load(&[color(&path)]).unwrap();
            let cache = RasterCache::new(budget, dir.path());
            let parts = TextureSet::new(&cache).load(&[color(&path)]).unwrap();
            let [whole, parts] = [whole, parts].map(|t| t[0].clone().unwrap());
            assert_eq!(
                (whole.size(), whole.has_alpha()),
                (parts.size(), parts.has_alpha())
            );
            assert_eq!(whole.size(), (w, h));
            assert!(samples(&whole) == samples(&parts), "{w} x {h}");
            assert!(cache.peak_bytes() <= budget, "{}", cache.peak_bytes());
            assert!(
                w < 900 || cache.peak_bytes() > budget / 4 * 3,
                "{}",
                cache.peak_bytes()
            );
        }
    }

    #[test]
    fn a_picture_is_read_once_whoever_names_it() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("sub")).unwrap();
        let [a, b, again] = ["a.png", "b.png", "sub/../a.png"].map(|name| dir.path().join(name));
        noise(4, 4, 1).save(&a).unwrap();
        noise(4, 4, 2).save(&b).unwrap();
        let mut set = textures();
        let first = set
            .load(&[color(&a), color(&again), (None, None), color(&b)])
            .unwrap();
        fs::remove_file(&b).unwrap();
        let second = set.load(&[color(&b), color(&again)]).unwrap();
        let same = |a: &Option<Arc<Texture>>, b: &Option<Arc<Texture>>| {
            Arc::ptr_eq(a.as_ref().unwrap(), b.as_ref().unwrap())
        };
        assert!(first[2].is_none() && !same(&first[0], &first[3]));
        assert!(same(&first[0], &first[1]) && same(&first[0], &second[1]) && same(&first[3], &second[0]));
    }

    #[test]
    fn pictures_in_one_piece_are_read_as_memory_allows() {
        let dir = tempfile::tempdir().unwrap();
        let mut all: Vec<Maps> = Vec::new();
        for k in 0..8 {
            let path = dir.path().join(format!("{k}.jpg"));
            let picture = image::DynamicImage::from(noise(200, 200, k));
            picture.into_rgb8().save(&path).unwrap();
            all.push(color(&path));
        }
        let load = |budget: u64| {
            let cache = RasterCache::new(budget, dir.path());
            let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
            (
                pool.install(|| TextureSet::new(&cache).load(&all)),
                cache.peak_bytes(),
            )
        };
        let need = whole_file::decoding_bytes(all[0].0.as_ref().unwrap()).unwrap();
        let budget = 2 * need + need / 8;
        let (read, peak) = load(budget);
        assert!(
            read.is_ok() && peak <= budget && peak > need,
            "{peak} of {budget}"
        );
        let message = load(need).0.unwrap_err().to_string();
        assert!(
            message.contains(".jpg") && message.contains(&need.to_string()),
            "{message}"
        );
    }

    #[test]
    fn a_mask_is_stretched_over_its_picture() {
        let dir = tempfile::tempdir().unwrap();
        let [picture, grey, alpha] = ["p.png", "grey.png", "alpha.png"].map(|name| dir.path().join(name));
        image::RgbaImage::from_pixel(4, 2, image::Rgba([255, 0, 0, 128]))
            .save(&picture)
            .unwrap();
        image::GrayImage::from_raw(2, 1, vec![0, 255])
            .unwrap()
            .save(&grey)
            .unwrap();
        image::RgbaImage::from_raw(1, 1, vec![255, 255, 255, 51])
            .unwrap()
            .save(&alpha)
            .unwrap();
        let maps = [
            (Some(picture.clone()), Some(grey.clone())),
            (None, Some(grey)),
            (Some(picture), Some(alpha)),
        ];
        let read = textures().load(&maps).unwrap();
        let opacity = |k: usize, u: f32| {
            let texture = read[k].as_ref().unwrap();
            (255.0 * texture.sampler(1.0).at(Vec2::new(u, 0.5)).unwrap()[3]).round()
        };
        assert_eq!([opacity(0, 0.25), opacity(0, 0.75)], [0.0, 128.0]);
        assert_eq!([opacity(1, 0.25), opacity(1, 0.75)], [0.0, 255.0]);
        assert_eq!([opacity(2, 0.25), opacity(2, 0.75)], [26.0, 26.0]);
    }
}
