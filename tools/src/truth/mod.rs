//! The truth T: pictures of the input itself, meshes and height maps, by many rays per pixel in f64.
//!
//! What the input means (materials, textures, normals, the colour of ground, what is solid) is what the builder takes it
//! to mean, in code that both use (`input`). Nothing else is shared: there is no lattice here, no voxel and no database,
//! so a difference between T and a picture of the database is the database's error or the ray caster's.
//!
//! - A triangle shows its texture's finest level at the point that the ray meets. A cut-out surface of opacity a lets
//!   1 − a of the ray through to what is behind it; all others are opaque.
//! - Ground is the bilinear surface of its samples, and all below it is solid down to a [`Bottom`]. Where the data or the
//!   valid samples end there are vertical walls. Any point of the solid, seen from outside or from within, shows colour
//!   and normal of the ground above it.
//! - Light is that of the renderers: `ambient + diffuse · max(0, n · sun)`, with the mesh's normal, not turned to the ray. Where the
//!   settings ask for it, a ray to a random point of the sun and some to random points of the sky, by cosine, say how much is hidden.
//! - A pixel is the mean over its square (box filter) of jittered rays, one in each of n × n equal parts.
//!
//! | module | what |
//! |---|---|
//! | `boxes` | a bounding volume hierarchy in f32 around tests in f64 |
//! | `triangle` | a ray and a triangle |
//! | `ground` | a ray and a block of a height map's solid |
//! | `bottom` | how deep solid ground goes |
//!
//! [`Truth`] may be used from any thread; [`Truth::render`] spreads rows over the rayon pool of its caller. Pictures do
//! not depend on the number of threads.

mod bottom;
mod boxes;
mod ground;
#[cfg(test)]
mod tests;
mod triangle;

use brickfell_culler::Camera;
use brickfell_runtime::picture::Picture;
use brickfell_runtime::settings::{RenderSettings, SUN_WIDTH};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub use bottom::Bottom;

use crate::input::{InputError, Layer, Look, Mesh, Triangle};
use crate::noise::Random;
use boxes::Boxes;
use ground::Ground;
use triangle::Shear;

/// A ray with less light left than this ends.
const DARK: f64 = 1e-6;

/// Rays toward the sky from each hit.
const SKY_RAYS: u32 = 4;

/// Most rays of a pixel along each axis; more are not cast.
const MAX_RAYS_PER_AXIS: u32 = 1024;

/// Why there is no truth.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// A file can no longer be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// No mesh and no height map.
    #[error("there is no input to draw")]
    NoInput,
    /// More than a 32-bit number can count.
    #[error("{0} triangles and blocks of ground are more than can be drawn")]
    TooMany(usize),
}

/// The input of a terrain, ready for rays.
pub struct Truth<'a> {
    meshes: &'a [Mesh],
    /// Number of the first triangle of each mesh.
    first: Vec<usize>,
    /// Triangles of all meshes; blocks of ground are numbered after them.
    triangles: usize,
    ground: Ground<'a>,
    boxes: Boxes,
}

/// What a ray meets.
#[derive(Clone, Copy, Debug)]
struct Hit {
    /// In lengths of the ray's direction.
    depth: f64,
    /// Number of the triangle or block; orders hits of one depth.
    number: usize,
    look: Look,
}

impl<'a> Truth<'a> {
    /// Takes meshes and height maps together.
    ///
    /// # Errors
    /// No input, or too much of it.
    pub fn new(meshes: &'a [Mesh], layers: &'a [Layer], bottom: &Bottom) -> Result<Self, TruthError> {
        let first = meshes.iter().scan(0, |next, mesh| {
            let first = *next;
            *next += mesh.triangles.len();
            Some(first)
        });
        let ground = Ground::new(layers, bottom)?;
        let triangles = meshes.iter().map(|m| m.triangles.len()).sum();
        let boxes: Vec<(DVec3, DVec3)> = meshes
            .par_iter()
            .flat_map(|mesh| {
                mesh.triangles.par_iter().map(|t| {
                    let [a, b, c] = mesh.corners(t);
                    (a.min(b).min(c), a.max(b).max(c))
                })
            })
            .chain(ground.boxes())
            .collect();
        if u32::try_from(boxes.len()).is_err() {
            return Err(TruthError::TooMany(boxes.len()));
        }
        Ok(Self {
            meshes,
            first: first.collect(),
            triangles,
            ground,
            boxes: Boxes::new(&boxes).ok_or(TruthError::NoInput)?,
        })
    }

    /// Draws a picture of the camera's size with `rays_per_axis`² rays a pixel: premultiplied linear light, alpha the
    /// share of the rays that was stopped. The same seed gives the same picture.
    ///
    /// # Errors
    /// If a part of a texture cannot be read.
    pub fn render(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        rays_per_axis: u32,
        seed: u64,
    ) -> Result<Picture, InputError> {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let rays_per_axis = rays_per_axis.clamp(1, MAX_RAYS_PER_AXIS);
        let mut pixels = vec![[0f32; 4]; width * height];
        pixels
            .par_chunks_mut(width.max(1))
            .enumerate()
            .try_for_each(|(row, pixels)| {
                for (column, pixel) in pixels.iter_mut().enumerate() {
                    let key = (row * width + column) as u64;
                    let mut random = Random::new(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ key);
                    let mut sum = [0.0; 4];
                    for k in 0..rays_per_axis.pow(2) {
                        let part = [k % rays_per_axis, k / rays_per_axis];
                        let [x, y] =
                            part.map(|p| (f64::from(p) + random.unit()) / f64::from(rays_per_axis) - 0.5);
                        let d = camera.ray(column as f64 + x, row as f64 + y);
                        let rgba = self.cast(camera.eye, d, settings, &mut random)?;
                        (0..4).for_each(|c| sum[c] += rgba[c]);
                    }
                    *pixel = sum.map(|c| (c / f64::from(rays_per_axis.pow(2))) as f32);
                }
                Ok(())
            })?;
        Ok(Picture {
            width: camera.width,
            height: camera.height,
            pixels,
        })
    }

    /// How far the first surface along a ray is, in lengths of its direction.
    ///
    /// # Errors
    /// Those of [`Self::render`].
    pub fn depth(&self, eye: DVec3, direction: DVec3) -> Result<Option<f64>, InputError> {
        Ok(self.next_hit(eye, direction, None)?.map(|hit| hit.depth))
    }

    /// Premultiplied linear light and opacity along one ray.
    fn cast(
        &self,
        eye: DVec3,
        d: DVec3,
        settings: &RenderSettings,
        random: &mut Random,
    ) -> Result<[f64; 4], InputError> {
        let mut sum = [0.0; 4];
        let mut left = 1.0;
        let mut after = None;
        while left > DARK
            && let Some(hit) = self.next_hit(eye, d, after)?
        {
            let Look { alpha, rgb, normal } = hit.look;
            let light = if normal == Vec3::ZERO {
                1.0
            } else {
                let normal = normal.as_dvec3();
                let (mut sky, mut sun) = (1.0, normal.dot(settings.sun).max(0.0));
                // So far from the surface that rounding cannot put it in front of itself.
                let from = |toward: DVec3| eye + d * hit.depth + toward * (1e-5 + 1e-6 * hit.depth);
                if settings.shadows && sun > 0.0 {
                    let toward = (settings.sun + 0.5 * SUN_WIDTH * in_disc(random, settings.sun)).normalize();
                    sun *= self.light_through(from(toward), toward)?;
                }
                if settings.occlusion {
                    sky = 0.0;
                    for _ in 0..SKY_RAYS {
                        let toward = (normal + on_sphere(random)).normalize_or(normal);
                        sky += self.light_through(from(toward), toward)? / f64::from(SKY_RAYS);
                    }
                }
                settings.ambient * sky + settings.diffuse * sun
            };
            let alpha = f64::from(alpha).min(1.0);
            (0..3).for_each(|c| sum[c] += left * alpha * light * f64::from(rgb[c]));
            sum[3] += left * alpha;
            left *= 1.0 - alpha;
            after = Some((hit.depth, hit.number));
        }
        Ok(sum)
    }

    /// What light comes from a direction.
    fn light_through(&self, from: DVec3, toward: DVec3) -> Result<f64, InputError> {
        let mut left = 1.0;
        let mut after = None;
        while left > DARK
            && let Some(hit) = self.next_hit(from, toward, after)?
        {
            left *= 1.0 - f64::from(hit.look.alpha).min(1.0);
            after = Some((hit.depth, hit.number));
        }
        Ok(if left > DARK { left } else { 0.0 })
    }

    /// The first hit behind another one, in order of depth and number.
    fn next_hit(&self, eye: DVec3, d: DVec3, after: Option<(f64, usize)>) -> Result<Option<Hit>, InputError> {
        let mut best: Option<Hit> = None;
        let mut failed = None;
        let shear = Shear::new(d);
        let from = after.map_or(0.0, |(depth, _)| depth);
        self.boxes.visit(eye, d, from, |number| {
            let is_next = |depth: f64| {
                depth >= 0.0
                    && after.is_none_or(|after| (depth, number) > after)
                    && best
                        .as_ref()
                        .is_none_or(|best| (depth, number) < (best.depth, best.number))
            };
            let hit = if let Some(block) = number.checked_sub(self.triangles) {
                let met = self.ground.meet(block, eye, d);
                met.filter(|(depth, _)| is_next(*depth)).map(|(depth, cell)| Hit {
                    depth,
                    number,
                    look: self.ground.look(block, cell, eye + d * depth),
                })
            } else {
                self.triangle(number).and_then(|(mesh, triangle)| {
                    let corners = mesh.corners(triangle).map(|p| p - eye);
                    let (depth, w) = shear.meet(&corners).filter(|(depth, _)| is_next(*depth))?;
                    let face = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                    let face = face.normalize_or_zero().as_vec3();
                    let look = mesh.look(triangle, w.map(|w| w as f32), face, 0.0);
                    let look = look.unwrap_or_else(|e| {
                        failed = Some(e);
                        None
                    })?;
                    Some(Hit { depth, number, look })
                })
            };
            best = hit.or(best);
            best.as_ref().map_or(f64::INFINITY, |best| best.depth)
        });
        failed.map_or(Ok(best), Err)
    }

    fn triangle(&self, number: usize) -> Option<(&'a Mesh, &'a Triangle)> {
        let mesh = self.first.partition_point(|f| *f <= number).checked_sub(1)?;
        let triangle = self.meshes[mesh].triangles.get(number - self.first[mesh])?;
        Some((&self.meshes[mesh], triangle))
    }
}

/// A random point of the unit sphere.
fn on_sphere(random: &mut Random) -> DVec3 {
    let z = random.between(-1.0, 1.0);
    let (sin, cos) = random.between(0.0, std::f64::consts::TAU).sin_cos();
    DVec3::new(cos, sin, 0.0) * (1.0 - z * z).max(0.0).sqrt() + DVec3::Z * z
}

/// A random point of a disc of radius 1 around the origin, across an axis.
fn in_disc(random: &mut Random, axis: DVec3) -> DVec3 {
    let (u, v) = axis.any_orthonormal_pair();
    let (sin, cos) = random.between(0.0, std::f64::consts::TAU).sin_cos();
    (u * cos + v * sin) * random.unit().sqrt()
}
