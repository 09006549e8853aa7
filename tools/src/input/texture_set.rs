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
