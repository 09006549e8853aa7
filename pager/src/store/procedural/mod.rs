//! A terrain that nobody built: every file of it is made from a seed when it is read, so that a hundred kilometres are flown
//! without a disk.
//!
//! The files are those that a folder would hold (`scene.xml`, octree files, brick files), byte for byte the same in every run
//! and on every machine, and any range of them can be read. What was made is kept up to a number of bytes, since a reader
//! comes back for a header, a directory and payloads.
//!
//! | module | what |
//! |---|---|
//! | `field` | heights and looks: a pure function of seed, level and column |
//! | `tree` | which nodes of a tree are bricks; its octree file |
//! | `bricks` | chunks and brick files |
//! | `plan` | which trees and groups there are; names; the scene file |
//! | `cache` | what was made |
//!
//! Any thread; two that read the same at the same time may both make it. No lock is held while something is made.

mod bricks;
mod cache;
mod field;
mod plan;
#[cfg(test)]
mod tests;
mod tree;

use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use bricks::{BrickFile, Part};
use cache::{Cache, Key, Made};
use field::Field;
use plan::Object;
use tree::{Place, Shape};

use super::{SCENE_FILE, Store, ends_early};

/// Depths of trees.
const DEPTHS: std::ops::RangeInclusive<u8> = 3..=8;
/// Trees per axis that are aimed at.
const AIM: u32 = 256;
/// Most trees per axis: with their groups they stay below what a scene may list.
const MAX_TREES: u32 = 1 << 9;

/// A terrain to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProceduralConfig {
    /// Which one.
    pub seed: u64,
    /// Side, metres; rounded up to whole trees.
    pub extent: f64,
    /// Side of a finest voxel, metres.
    pub voxel: f64,
    /// Levels of a tree, less one: 3 to 8. `None` takes the least with which there are not too many trees.
    pub depth: Option<u8>,
    /// Bytes of made files that are kept.
    pub cache_bytes: usize,
}

impl Default for ProceduralConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            extent: 10_000.0,
            voxel: 1.0,
            depth: None,
            cache_bytes: 64 << 20,
        }
    }
}

/// A terrain that cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProceduralError {
    /// A part of the address that is not known or not a number.
    #[error("`{0}`: a terrain is SEED?extent=METRES&voxel=METRES&depth=LEVELS")]
    Address(String),
    /// A length that is not above 0, or beyond what coordinates hold.
    #[error("{what} of {value} m is not usable")]
    Length {
        /// Of what.
        what: &'static str,
        /// Metres.
        value: f64,
    },
    /// A depth out of range.
    #[error("depth {0} is not usable (3 to 8)")]
    Depth(u8),
    /// Too many trees for a scene file.
    #[error("{0:.0} trees a side are too many (up to {MAX_TREES}): take wider voxels or deeper trees")]
    Trees(f64),
}

impl ProceduralConfig {
    /// Reads `SEED?extent=METRES&voxel=METRES&depth=LEVELS`; what is left out is as in the default. Metres may be given
    /// as `10km`.
    ///
    /// # Errors
    /// [`ProceduralError::Address`].
    pub fn parse(text: &str) -> Result<Self, ProceduralError> {
        let unknown = |part: &str| ProceduralError::Address(part.to_owned());
        let metres = |part: &str, text: &str| {
            let (digits, unit) = match (text.strip_suffix("km"), text.strip_suffix('m')) {
                (Some(digits), _) => (digits, 1000.0),
                (_, Some(digits)) => (digits, 1.0),
                _ => (text, 1.0),
            };
            digits.parse::<f64>().map(|v| v * unit).map_err(|_| unknown(part))
        };
        let (seed, rest) = text.split_once('?').unwrap_or((text, ""));
        let mut config = Self {
            seed: seed.parse().map_err(|_| unknown(text))?,
            ..Self::default()
        };
        for part in rest.split('&').filter(|part| !part.is_empty()) {
            match part.split_once('=') {
                Some(("extent", value)) => config.extent = metres(part, value)?,
                Some(("voxel", value)) => config.voxel = metres(part, value)?,
                Some(("depth", value)) => config.depth = Some(value.parse().map_err(|_| unknown(part))?),
                _ => return Err(unknown(part)),
            }
        }
        Ok(config)
    }
}

/// The terrain.
#[derive(Debug)]
pub struct ProceduralStore {
    config: ProceduralConfig,
    field: Field,
    cache: Mutex<Cache>,
}

impl ProceduralStore {
    /// A terrain; nothing is made yet.
    ///
    /// # Errors
    /// If there is no such terrain.
    pub fn new(config: ProceduralConfig) -> Result<Self, ProceduralError> {
        for (what, value, range) in [
            ("a voxel", config.voxel, 1e-6..1e6),
            ("an extent", config.extent, 1e-6..1e9),
        ] {
            if !range.contains(&value) {
                return Err(ProceduralError::Length { what, value });
            }
        }
        let trees = |depth: u8| (config.extent / (config.voxel * f64::from(8u32 << depth))).ceil();
        let depth = config.depth.unwrap_or_else(|| {
            let mut depths = DEPTHS;
            depths
                .find(|depth| trees(*depth) <= f64::from(AIM))
                .unwrap_or(*DEPTHS.end())
        });
        if !DEPTHS.contains(&depth) {
            return Err(ProceduralError::Depth(depth));
        }
        if trees(depth) > f64::from(MAX_TREES) {
            return Err(ProceduralError::Trees(trees(depth)));
        }
        let field = Field {
            seed: config.seed,
            depth,
            trees: trees(depth) as u32,
        };
        Ok(Self {
            config,
            field,
            cache: Mutex::default(),
        })
    }

    /// Trees per axis.
    pub fn trees(&self) -> u32 {
        self.field.trees
    }

    /// Side of a tree, metres. Trees begin at the world's origin; the ground lies between a fifth of this below zero and
    /// two fifths above.
    pub fn tree_side(&self) -> f64 {
        self.config.voxel * f64::from(8u32 << self.field.depth)
    }

    /// The highest ground over a square around a point of the world, metres; `None` outside of the terrain. To fly low without
    /// reading anything.
    pub fn highest_ground(&self, x: f64, y: f64, around: f64) -> Option<f64> {
        // In voxels that the square is some 16 of wide.
        let mip = (around / (8.0 * self.config.voxel)).log2().clamp(0.0, 24.0) as u32;
        let voxel = self.config.voxel * (1u64 << mip) as f64;
        let side = (2.0 * around / voxel).ceil() as usize + 2;
        let low = [x, y].map(|v| ((v - around) / voxel).floor() as i64);
        let heights = self.field.heights(&field::Patch { mip, low, side });
        let highest = heights.into_iter().fold(f32::NEG_INFINITY, f32::max);
        highest.is_finite().then_some(f64::from(highest) * voxel)
    }

    /// What was made before, or is made now.
    fn made(&self, key: Key, make: impl FnOnce() -> io::Result<Made>) -> io::Result<Made> {
        let cached = self.cache.lock().unwrap_or_else(PoisonError::into_inner).get(key);
        match cached {
            Some(made) => Ok(made),
            None => {
                let made = make()?;
                self.keep(key, made.clone());
                Ok(made)
            }
        }
    }

    fn keep(&self, key: Key, made: Made) {
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        cache.put(key, made, self.config.cache_bytes);
    }

    fn shape(&self, place: Place) -> io::Result<Arc<Shape>> {
        let shape = || Ok(Made::Shape(Arc::new(Shape::new(&self.field, place))));
        match self.made(Key::Shape(place), shape)? {
            Made::Shape(shape) => Ok(shape),
            _ => Err(mixed_up()),
        }
    }

    fn bytes(&self, key: Key, make: impl FnOnce() -> io::Result<Vec<u8>>) -> io::Result<Arc<Vec<u8>>> {
        match self.made(key, || make().map(|bytes| Made::Bytes(Arc::new(bytes))))? {
            Made::Bytes(bytes) => Ok(bytes),
            _ => Err(mixed_up()),
        }
    }

    fn bricks(&self, place: Place, level: u8) -> io::Result<Arc<BrickFile>> {
        let key = Key::Bricks(place, level);
        let file = self.made(key, || {
            let shape = self.shape(place)?;
            let keep = |number, payload| {
                self.keep(Key::Payload(place, level, number), Made::Bytes(Arc::new(payload)));
            };
            let file = BrickFile::new(&self.field, place, &shape, level, keep).map_err(io::Error::other)?;
            Ok(Made::Bricks(Arc::new(file)))
        })?;
        match file {
            Made::Bricks(file) => Ok(file),
            _ => Err(mixed_up()),
        }
    }

    fn payload(&self, place: Place, level: u8, file: &BrickFile, number: u32) -> io::Result<Arc<Vec<u8>>> {
        self.bytes(Key::Payload(place, level, number), || {
            let chunk = file.chunks.get(number as usize).ok_or_else(mixed_up)?;
            chunk.payload(&self.field, place, level).map_err(io::Error::other)
        })
    }

    /// A file that is made as a whole.
    fn whole(&self, object: Object) -> io::Result<Arc<Vec<u8>>> {
        match object {
            Object::Octree(place) => self.bytes(Key::Octree(place), || {
                let shape = self.shape(place)?;
                let header = shape.header(&self.field, place, self.config.voxel);
                shape.octree(&self.field, place, header).map_err(io::Error::other)
            }),
            _ => self.bytes(Key::Scene, || {
                Ok(plan::scene(&self.field, self.config.voxel).to_xml().into_bytes())
            }),
        }
    }

    fn object(&self, name: &str) -> io::Result<Object> {
        plan::object(&self.field, SCENE_FILE, name)
            .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "the terrain has no such file"))
    }
}

/// A key of the cache stands for one kind of thing.
fn mixed_up() -> io::Error {
    io::Error::other("made as something else")
}

impl Store for ProceduralStore {
    fn len(&self, name: &str) -> io::Result<u64> {
        match self.object(name)? {
            Object::Bricks(place, level) => Ok(self.bricks(place, level)?.len()),
            object => Ok(self.whole(object)?.len() as u64),
        }
    }

    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let object = self.object(name)?;
        let end = offset.checked_add(len as u64);
        let within = |size: u64| {
            end.filter(|end| *end <= size)
                .ok_or_else(|| ends_early(offset, len, size))
        };
        let Object::Bricks(place, level) = object else {
            let bytes = self.whole(object)?;
            let end = within(bytes.len() as u64)?;
            return Ok(bytes[offset as usize..end as usize].to_vec());
        };
        let file = self.bricks(place, level)?;
        let end = within(file.len())?;
        let mut out = Vec::with_capacity(len);
        for (range, part) in file.parts(offset..end) {
            let payload;
            let bytes: &[u8] = match part {
                Part::Header(bytes) | Part::Directory(bytes) => bytes,
                Part::Payload(number) => {
                    payload = self.payload(place, level, &file, number)?;
                    &payload
                }
            };
            let (from, to) = (offset.max(range.start), end.min(range.end));
            out.extend_from_slice(&bytes[(from - range.start) as usize..(to - range.start) as usize]);
        }
        Ok(out)
    }

    fn describe(&self, name: &str) -> String {
        let ProceduralConfig {
            seed, extent, voxel, ..
        } = self.config;
        format!("procedural:{seed}?extent={extent}&voxel={voxel}: {name}")
    }
}
