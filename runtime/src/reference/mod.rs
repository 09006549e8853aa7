//! The CPU reference: the ray caster's rules once more, in f64, to find the GPU's faults.
//!
//! It reads the same tree and brick files as the pager does but shares no code with the GPU's caster: positions are f64
//! in finest voxels instead of fixed point, every descent starts at the root, and the end of each segment is the exit
//! of an explicit box, found by dividing. Everything counts as resident, so there are no fallbacks and no requests.
//!
//! | module | what |
//! |---|---|
//! | `tree` | a tree's files, read when rays need them |
//! | `sampling` | filtering, light, opacity over a segment |
//! | `walk` | one ray through one tree, segment by segment |
//! | `cut` | which trees, and coarse trees in their place |
//! | `cells` | integer boxes and the exact way through them |
//!
//! [`Reference`] may be used from any thread; [`Reference::render`] spreads rows over the rayon pool of its caller.

mod cells;
mod cut;
mod sampling;
mod tree;
mod walk;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests_files;
#[cfg(test)]
mod tests_levels;
#[cfg(test)]
mod tests_rays;
#[cfg(test)]
mod tests_values;

use std::io;
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::FormatError;
use brickfell_formats::blocks::Between;
use brickfell_formats::scene;
use brickfell_pager::store::Store;
use glam::DVec3;
use rayon::prelude::*;

use crate::picture::{Picture, RayCounters};
use crate::settings::RenderSettings;
use cut::{Group, Numbers};
use sampling::Shading;
use tree::Tree;
use walk::{Passage, Ray, Transport, Walk};

/// Why the reference cannot draw.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ReferenceError {
    /// A file cannot be read.
    #[error("{name}: {error}")]
    Read {
        /// What the store calls the object, for instance its path.
        name: String,
        /// What the store said.
        error: Arc<io::Error>,
    },
    /// A file is damaged or does not fit its tree.
    #[error("{name}: {error}")]
    Format {
        /// What the store calls the object, for instance its path.
        name: String,
        /// What is wrong and where.
        error: FormatError,
    },
    /// Camera or settings that no picture can be made of.
    #[error("{0}")]
    Argument(&'static str),
}

impl ReferenceError {
    fn read(store: &dyn Store, name: &str, error: io::Error) -> Self {
        Self::Read {
            name: store.describe(name),
            error: Arc::new(error),
        }
    }

    fn format(store: &dyn Store, name: &str, error: FormatError) -> Self {
        Self::Format {
            name: store.describe(name),
            error,
        }
    }
}

/// Some trees of a terrain, drawn by the CPU. Pages are read when rays first need them and kept.
pub struct Reference {
    trees: Vec<Tree>,
    root: Group,
}

impl Reference {
    /// Opens the trees of a scene, coarse ones too, and reads their headers.
    ///
    /// # Errors
    /// A tree file that cannot be read or whose header is not sound.
    pub fn open(store: Arc<dyn Store>, scene: &scene::Scene) -> Result<Self, ReferenceError> {
        let trees = scene.trees().chain(scene.coarse_trees().map(|c| &c.tree));
        let trees = trees
            .map(|tree| {
                let bounds = tree.bounds.map(|b| [b.min, b.max]);
                Tree::open(store.clone(), &tree.tree_file, bounds)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut next = Numbers {
            tree: 0,
            coarse: scene.trees().count(),
        };
        let root = Group::new(&scene.root, &trees, &mut next);
        Ok(Self { trees, root })
    }

    /// Opens tree files (binary or XML octrees) by name and reads their headers; all of them are drawn.
    ///
    /// # Errors
    /// A tree file that cannot be read or whose header is not sound.
    pub fn new(store: Arc<dyn Store>, trees: &[String]) -> Result<Self, ReferenceError> {
        let trees = trees
            .iter()
            .map(|name| Tree::open(store.clone(), name, None))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            root: Group::flat(trees.len()),
            trees,
        })
    }

    /// The same with the values between the end points of blocks as a device makes them, to be compared with it. To be called before
    /// anything is drawn.
    pub fn with_blocks(mut self, between: Between) -> Self {
        for tree in &mut self.trees {
            tree.between = between;
        }
        self
    }

    /// Draws a picture of the camera's size.
    ///
    /// # Errors
    /// Nodes or bricks that a ray needs and that cannot be read; a camera or settings that are not finite.
    pub fn render(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Picture, RayCounters), ReferenceError> {
        let scene = Scene::new(self, camera, settings)?;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let mut pixels = vec![[0f32; 4]; width * height];
        let counters = pixels
            .par_chunks_mut(width.max(1))
            .enumerate()
            .map(|(row, pixels)| {
                let mut counters = RayCounters::default();
                let mut passages = Vec::new();
                for (column, pixel) in pixels.iter_mut().enumerate() {
                    let ray = scene.ray(camera, column as f64, row as f64);
                    let rgba = scene.cast(&ray, &mut passages, &mut counters)?;
                    *pixel = rgba.map(|c| c as f32);
                }
                Ok(counters)
            })
            .try_reduce(RayCounters::default, |a, b| Ok(add(&a, &b)))?;
        Ok((
            Picture {
                width: camera.width,
                height: camera.height,
                pixels,
            },
            counters,
        ))
    }

    /// One ray, through the centre of pixel (`px`, `py`) moved by its fractions: premultiplied linear RGBA.
    ///
    /// # Errors
    /// As [`Reference::render`].
    pub fn cast(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        px: f64,
        py: f64,
    ) -> Result<[f64; 4], ReferenceError> {
        let scene = Scene::new(self, camera, settings)?;
        scene.cast(
            &scene.ray(camera, px, py),
            &mut Vec::new(),
            &mut RayCounters::default(),
        )
    }
}

/// Components from here on count as not finite.
const LARGEST: f64 = 1e6;

/// What all rays of a picture share.
struct Scene<'a> {
    trees: &'a [Tree],
    /// Those that are drawn, with their least fractional levels.
    cut: Vec<(usize, f64)>,
    shading: Shading,
    fade: f64,
    segment: (u32, u32),
    /// Footprint of a pixel times 2^bias, metres per metre of depth.
    footprint: f64,
}

impl<'a> Scene<'a> {
    fn new(
        reference: &'a Reference,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Self, ReferenceError> {
        settings.check(camera).map_err(ReferenceError::Argument)?;
        let footprint = camera.pixel_size() * settings.bias.exp2();
        let (trees, mut cut) = (&reference.trees, Vec::new());
        (reference.root).cut(trees, camera.eye, camera.forward, footprint, &mut cut);
        Ok(Self {
            trees,
            cut,
            shading: Shading::new(settings),
            fade: settings.fade(),
            segment: settings.segment(),
            footprint,
        })
    }

    fn ray(&self, camera: &Camera, px: f64, py: f64) -> Ray {
        self.ray_along(camera.eye, camera.ray(px, py))
    }

    fn ray_along(&self, eye: DVec3, direction: DVec3) -> Ray {
        let Self {
            footprint,
            fade,
            segment,
            shading,
            ..
        } = *self;
        Ray {
            eye,
            direction,
            length: direction.length(),
            footprint,
            fade,
            segment,
            shading,
        }
    }

    /// Premultiplied linear RGBA of a ray. `passages` is scratch, so that rays do not allocate.
    fn cast(
        &self,
        ray: &Ray,
        passages: &mut Vec<(Passage, (usize, f64))>,
        counters: &mut RayCounters,
    ) -> Result<[f64; 4], ReferenceError> {
        passages.clear();
        passages.extend(
            self.cut
                .iter()
                .filter_map(|drawn| Some((Passage::through(&self.trees[drawn.0], ray)?, *drawn))),
        );
        passages.sort_by(|(a, _), (b, _)| a.enter.total_cmp(&b.enter).then(a.leave.total_cmp(&b.leave)));
        let mut transport = Transport::default();
        for (passage, (k, least_level)) in passages.iter() {
            Walk::new(&self.trees[*k], ray, *passage, *least_level).run(&mut transport)?;
            if transport.saturated() {
                break;
            }
        }
        let mut rgba = transport.rgba();
        // Not-a-number is not below anything.
        if !rgba.iter().all(|c| c.abs() < LARGEST) {
            rgba = [0.0; 4];
            counters.not_finite += 1;
        } else if rgba[3] > 0.0 {
            *counters = add(
                counters,
                &RayCounters {
                    rays_hit: 1,
                    ..transport.counters
                },
            );
        }
        counters.capped += transport.capped;
        Ok(rgba)
    }
}

/// Sums of two sets of counters.
fn add(a: &RayCounters, b: &RayCounters) -> RayCounters {
    RayCounters {
        rays_hit: a.rays_hit + b.rays_hit,
        nodes: a.nodes + b.nodes,
        samples: a.samples + b.samples,
        texture_reads: a.texture_reads + b.texture_reads,
        capped: a.capped + b.capped,
        not_finite: a.not_finite + b.not_finite,
    }
}
