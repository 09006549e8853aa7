//! The CPU reference: the ray caster's rules in f64, to find the faults of the others.
//!
//! It reads the same tree and brick files as the pager does and shares no code with the GPU's caster. With the CPU's it shares the march
//! (module `march`), but none of what that is fast by: it marches in f64, every descent starts at the root, every voxel
//! is looked at, and samples are decoded where they are filtered. Everything counts as resident, so there are no fallbacks and no
//! requests.
//!
//! | module | what |
//! |---|---|
//! | `tree` | a tree's files, read when rays need them; descents |
//! | `sampling` | filtering |
//! | `cut` | which trees, and coarse trees in their place |
//!
//! [`Reference`] may be used from any thread; [`Reference::render`] spreads rows over the rayon pool of its caller.

mod cut;
pub(crate) mod sampling;
mod tree;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests_files;
#[cfg(test)]
mod tests_levels;
#[cfg(test)]
mod tests_lights;
#[cfg(test)]
mod tests_rays;
#[cfg(test)]
mod tests_values;

use std::io;
use std::ops::Range;
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::FormatError;
use brickfell_formats::blocks::Between;
use brickfell_formats::scene;
use brickfell_pager::store::Store;
use glam::DVec3;
use rayon::prelude::*;

use crate::march::{Lens, Lights, Passage, Ray, Shading, Transport, View, Walk};
use crate::picture::{Picture, RayCounters};
use crate::settings::RenderSettings;
use cut::{Group, Numbers};
use tree::{FromRoot, Tree};

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
                    let ray = camera.ray(column as f64, row as f64);
                    let rgba = scene.cast(ray, f64::INFINITY, &mut passages, &mut counters)?;
                    *pixel = rgba.map(|c| c as f32);
                }
                Ok(counters)
            })
            .try_reduce(RayCounters::default, |a, b| Ok(a + b))?;
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
        self.cast_until(camera, settings, [px, py], f64::INFINITY)
    }

    /// The same ray as far as a depth, metres along the camera's axis: what lies behind is not there. Lights go on as if it were.
    ///
    /// # Errors
    /// As [`Reference::render`].
    pub fn cast_until(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        [px, py]: [f64; 2],
        depth: f64,
    ) -> Result<[f64; 4], ReferenceError> {
        let scene = Scene::new(self, camera, settings)?;
        let counters = &mut RayCounters::default();
        scene.cast(camera.ray(px, py), depth, &mut Vec::new(), counters)
    }

    /// Depth, in lengths of the direction, at which a single ray has lost half of its light; of one that never does the mean depth of what it
    /// sees, `None` if it sees nothing. `footprint` is its width, metres per length of the direction.
    ///
    /// # Errors
    /// As [`Reference::render`].
    pub fn depth(&self, eye: DVec3, direction: DVec3, footprint: f64) -> Result<Option<f64>, ReferenceError> {
        let settings = RenderSettings::default();
        let lens = Lens {
            eye,
            footprint,
            fade: settings.fade(),
            segment: settings.segment(),
        };
        let scene = Scene::through(self, direction.normalize_or(DVec3::Z), lens, &settings);
        let views = |k: usize| &scene.trees[k].1;
        let ray = Ray::new(DVec3::ZERO, direction);
        let all = 0.0..f64::INFINITY;
        let seen = scene.gather::<true>(&ray, &scene.lens, views, all, &mut Vec::new())?;
        Ok(seen.surface().map(|surface| surface.depth))
    }
}

/// What all rays of a picture share.
struct Scene<'a> {
    /// The trees that are drawn.
    trees: Vec<(&'a Tree, View)>,
    lens: Lens,
    shading: Shading<f64>,
    lights: Option<Lights>,
    /// The trees as seen by cones toward the sun and the sky.
    light_views: [Vec<View>; 2],
}

impl<'a> Scene<'a> {
    fn new(
        reference: &'a Reference,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Self, ReferenceError> {
        settings.check(camera).map_err(ReferenceError::Argument)?;
        let lens = Lens {
            eye: camera.eye,
            footprint: camera.pixel_size() * settings.bias.exp2(),
            fade: settings.fade(),
            segment: settings.segment(),
        };
        Ok(Self::through(reference, camera.forward, lens, settings))
    }

    /// The scene through a lens that looks along a direction.
    fn through(reference: &'a Reference, forward: DVec3, lens: Lens, settings: &RenderSettings) -> Self {
        let mut cut = Vec::new();
        (reference.root).cut(&reference.trees, lens.eye, forward, lens.footprint, &mut cut);
        let views = |lens: &Lens| {
            cut.iter()
                .map(|(k, least_level)| {
                    let tree = &reference.trees[*k];
                    View::new(&tree.header, tree.bounds, *least_level, lens)
                })
                .collect::<Vec<_>>()
        };
        let lights = Lights::new(settings, &lens);
        let light_views = lights.map_or([None; 2], |l| *l.lenses());
        Self {
            trees: cut
                .iter()
                .map(|(k, _)| &reference.trees[*k])
                .zip(views(&lens))
                .collect(),
            light_views: light_views.map(|lens| lens.as_ref().map(views).unwrap_or_default()),
            lens,
            shading: Shading::new(settings),
            lights,
        }
    }

    /// Premultiplied linear RGBA of a ray that ends at a depth. `passages` is scratch, so that rays do not allocate.
    fn cast(
        &self,
        direction: DVec3,
        until: f64,
        passages: &mut Vec<(Passage, usize)>,
        counters: &mut RayCounters,
    ) -> Result<[f64; 4], ReferenceError> {
        let views = |k: usize| &self.trees[k].1;
        let ray = Ray::new(DVec3::ZERO, direction);
        let mut transport = match self.lights {
            None => self.gather::<false>(&ray, &self.lens, views, 0.0..until, passages)?,
            Some(_) => self.gather::<true>(&ray, &self.lens, views, 0.0..until, passages)?,
        };
        let mut kept = 1.0;
        if let Some((lights, surface)) = self.lights.as_ref().zip(transport.surface()) {
            kept = lights.kept(&surface, direction, |cone| {
                let views = |k: usize| &self.light_views[cone.light][k];
                let Some(lens) = &lights.lenses()[cone.light] else {
                    return Ok(1.0);
                };
                let behind = cone.start..f64::INFINITY;
                let hidden = self.gather::<false>(&cone.ray, lens, views, behind, passages)?;
                transport.counters = transport.counters + hidden.counters;
                Ok(hidden.transmittance())
            })?;
        }
        let (rgba, counts) = transport.finish(kept);
        *counters = *counters + counts;
        Ok(rgba)
    }

    /// What a ray gathers between two depths.
    fn gather<'v, const LIT: bool>(
        &self,
        ray: &Ray<f64>,
        lens: &Lens,
        views: impl Fn(usize) -> &'v View,
        depths: Range<f64>,
        passages: &mut Vec<(Passage, usize)>,
    ) -> Result<Transport<f64>, ReferenceError> {
        passages.clear();
        let entered = (0..self.trees.len()).filter_map(|k| {
            let passage = views(k).passage(ray)?.from(depths.start)?.until(depths.end)?;
            Some((passage, k))
        });
        passages.extend(entered);
        passages.sort_by(|(a, _), (b, _)| a.enter.total_cmp(&b.enter).then(a.leave.total_cmp(&b.leave)));
        let mut transport = Transport::default();
        for (passage, k) in passages.iter() {
            let nodes = &mut FromRoot(self.trees[*k].0);
            Walk::<_, _, LIT>::new(views(*k), lens, &self.shading, nodes, ray, *passage)
                .run(&mut transport)?;
            if transport.saturated() {
                break;
            }
        }
        Ok(transport)
    }
}
