//! The CPU caster: what a GPU does for the renderer, done by the CPU's cores: pools, the cast, its feedback.
//!
//! Pools, usage and requests are those of a GPU, so paging, budgets and settling are the same. A cast is done when the call returns. Rays
//! are marched in f32 by the code that the reference runs in f64 (module `march`).
//!
//! | module | what |
//! |---|---|
//! | `beam` | where the rays of a tile of pixels may begin |
//! | `pool` | node words, decoded bricks, usage stamps |
//! | `source` | descents through the pools, with fallback and requests |
//!
//! Called by the render thread; a cast spreads over the rayon pool of its caller, one task for each row of tiles.

mod beam;
mod pool;
mod source;
#[cfg(test)]
mod tests;

use std::convert::Infallible;
use std::time::Instant;

use brickfell_formats::chunk::Layers;
use brickfell_formats::layout::SampleLayout;
use brickfell_shaders::layout::Request;
use glam::DVec3;
use rayon::prelude::*;

use crate::backend::{Cast, Drawn};
use crate::caster::{Feedback, REQUEST_CAPACITY};
use crate::error::RuntimeError;
use crate::march::{Cone, Lens, Lights, Ray, Shading, Transport, View, Walk};
use crate::memory::PoolSizes;
use crate::picture::{Picture, RayCounters};
use crate::texture_pool::UploadBatch;
use beam::{Beam, Start};
use pool::{Packed, Pools};
use source::Nodes;

/// Pixels of a tile per axis: rays that are cast one after the other, so that they find in the caches what they share.
const TILE: usize = 8;

/// Pools and the last picture.
#[derive(Debug)]
pub(crate) struct CpuCaster {
    sizes: PoolSizes,
    pools: Pools,
    /// What was drawn of it, which may be fewer pixels.
    picture: Picture,
    /// Pixels of the whole one.
    whole: [u32; 2],
    /// Of the last cast, until it is collected.
    feedback: Option<Feedback>,
}

/// What the rays of a frame have in common.
struct Frame<'a> {
    cast: &'a Cast<'a>,
    pools: &'a Pools,
    lens: Lens,
    shading: Shading<f32>,
    /// Screen coordinates of the columns and the rows that are drawn: as the camera gives them, to the bit, so that what is 0 stays so.
    screen: [Vec<f64>; 2],
    trees: Vec<(View, &'a Drawn)>,
    lights: Option<Lights>,
    /// The trees as seen by cones toward the sun and the sky.
    light_views: [Vec<View>; 2],
}

impl CpuCaster {
    /// Pools within a byte budget.
    ///
    /// # Errors
    /// If not even a few bricks fit.
    pub(crate) fn new(
        budget: u64,
        layout: SampleLayout,
        layers: Layers,
        blocks: bool,
    ) -> Result<Self, RuntimeError> {
        let sizes = PoolSizes::fit_memory(budget, layout, layers, blocks, Packed::bytes(layout, layers))?;
        Ok(Self {
            sizes,
            pools: Pools::new(sizes.bricks(), sizes.tiles),
            picture: Picture::default(),
            whole: [0; 2],
            feedback: None,
        })
    }

    /// Sizes of the pools.
    pub(crate) fn sizes(&self) -> PoolSizes {
        self.sizes
    }

    /// Bytes of a brick in its slot.
    pub(crate) fn brick_bytes(&self) -> u64 {
        Packed::bytes(self.sizes.layout, self.sizes.layers)
    }

    /// Bytes of full pools and the picture.
    pub(crate) fn bytes(&self) -> u64 {
        let bricks = u64::from(self.sizes.bricks()) * (self.brick_bytes() + 4);
        bricks + u64::from(self.sizes.tiles) * 68 + size_of_val(&*self.picture.pixels) as u64
    }

    /// Puts node words and bricks in place; returns their bytes.
    pub(crate) fn upload(&mut self, batch: &UploadBatch) -> u64 {
        for [node, structure, data, _] in &batch.nodes {
            self.pools.nodes[*node as usize] = [*structure, *data];
        }
        let packed: Vec<Packed> = (batch.bricks.par_iter())
            .map(|upload| Packed::new(&upload.chunk, upload.brick))
            .collect();
        for (upload, packed) in batch.bricks.iter().zip(packed) {
            self.pools.bricks[upload.slot as usize] = Some(packed);
        }
        batch.nodes.len() as u64 * 16 + batch.bricks.len() as u64 * self.brick_bytes()
    }

    /// Casts the rays of a frame.
    pub(crate) fn cast(&mut self, cast: &Cast<'_>) {
        let start = Instant::now();
        let camera = cast.camera;
        let [columns, rows] = cast.raster.size;
        self.whole = [camera.width, camera.height];
        (self.picture.width, self.picture.height) = (columns, rows);
        self.picture
            .pixels
            .resize(columns as usize * rows as usize, [0.0; 4]);
        let lens = Lens {
            eye: camera.eye,
            footprint: camera.pixel_size() * cast.bias.exp2(),
            fade: cast.settings.fade(),
            segment: cast.settings.segment(),
        };
        let view = |drawn: &Drawn, lens: &Lens| {
            let bounds = [drawn.bounds.min, drawn.bounds.max];
            View::new(&drawn.header, bounds, drawn.least_level, lens)
        };
        let views = |lens: &Lens| cast.drawn.iter().map(|d| view(d, lens)).collect::<Vec<_>>();
        let lights = Lights::new(cast.settings, &lens);
        let light_views = lights.map_or([None; 2], |l| *l.lenses());
        let frame = Frame {
            screen: [
                (0..columns).map(|k| cast.raster.screen(camera, k, 0).x).collect(),
                (0..rows).map(|k| cast.raster.screen(camera, 0, k).y).collect(),
            ],
            trees: views(&lens).into_iter().zip(cast.drawn).collect(),
            light_views: light_views.map(|lens| lens.as_ref().map(views).unwrap_or_default()),
            lights,
            shading: Shading::new(cast.settings),
            pools: &self.pools,
            cast,
            lens,
        };
        let arch = pulp::Arch::new();
        let strips = self.picture.pixels.par_chunks_mut(TILE * columns as usize);
        let (counters, requests) = strips
            .enumerate()
            .map(|(strip, pixels)| {
                arch.dispatch(Strip {
                    frame: &frame,
                    strip,
                    pixels,
                })
            })
            .reduce(Default::default, |(a, mut some), (b, mut other)| {
                some.append(&mut other);
                (a + b, some)
            });
        let mut requests = requests;
        requests.sort_unstable();
        requests.dedup();
        let request_count = requests.len() as u32;
        requests.truncate(REQUEST_CAPACITY as usize);
        let [used_bricks, used_tiles] = self.pools.used(cast.frame);
        self.feedback = Some(Feedback {
            frame: cast.frame,
            requests,
            request_count,
            used_bricks,
            used_tiles,
            counters,
            gpu_ms: [0.0, start.elapsed().as_secs_f64() * 1e3, 0.0],
            done_ms: start.elapsed().as_secs_f64() * 1e3,
        });
    }

    /// Takes what the last cast reported, once.
    pub(crate) fn collect(&mut self) -> Option<Feedback> {
        self.feedback.take()
    }

    /// What was drawn of the last picture, which may be fewer pixels, if there is one.
    pub(crate) fn drawn(&self) -> Option<&Picture> {
        Some(&self.picture).filter(|p| !p.pixels.is_empty())
    }

    /// The last picture; enlarged if fewer pixels were drawn.
    pub(crate) fn picture(&self) -> Picture {
        let [width, height] = self.whole;
        self.picture.clone().resized(width, height)
    }
}

/// A row of tiles, cast with the widest instructions that the machine has: a type of its own, because only so all of it is inlined into
/// what is compiled for them.
struct Strip<'a> {
    frame: &'a Frame<'a>,
    strip: usize,
    pixels: &'a mut [[f32; 4]],
}

impl pulp::WithSimd for Strip<'_> {
    type Output = (RayCounters, Vec<Request>);

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Self::Output {
        match self.frame.lights {
            None => self.frame.strip::<false>(self.strip, self.pixels),
            Some(_) => self.frame.strip::<true>(self.strip, self.pixels),
        }
    }
}

impl Frame<'_> {
    /// Casts the rays of a row of tiles.
    #[inline(always)]
    fn strip<const LIT: bool>(&self, strip: usize, pixels: &mut [[f32; 4]]) -> (RayCounters, Vec<Request>) {
        let columns = self.screen[0].len();
        let mut counters = RayCounters::default();
        let mut nodes = Nodes::new(self.pools, self.cast.frame);
        let mut starts = vec![None; self.trees.len()];
        for tile in 0..columns.div_ceil(TILE) {
            // Which tiles may ask goes round, so that a full list does not starve the same ones for ever.
            let turn = (tile + strip * 61) as u32;
            let turn = turn.wrapping_add(self.cast.frame);
            let may_ask = turn.is_multiple_of(self.cast.request_share);
            let first = tile * TILE;
            let last = columns.min(first + TILE);
            let rows = pixels.len() / columns;
            let direction = |column: usize, row: usize| {
                let [x, y] = [self.screen[0][column], self.screen[1][strip * TILE + row]];
                let camera = self.cast.camera;
                camera.forward + camera.right * x + camera.up * y
            };
            let beam = Beam::new([
                direction(first, 0),
                direction(last - 1, 0),
                direction(first, rows - 1),
                direction(last - 1, rows - 1),
            ]);
            starts.iter_mut().for_each(|start| *start = None);
            for (row, pixels) in pixels.chunks_exact_mut(columns).enumerate() {
                for (column, pixel) in (first..last).zip(&mut pixels[first..last]) {
                    nodes.begin(may_ask);
                    let (rgba, counts) =
                        self.ray::<LIT>(direction(column, row), &beam, &mut starts, &mut nodes);
                    *pixel = rgba;
                    counters = counters + counts;
                }
            }
        }
        (counters, nodes.into_requests().into_iter().collect())
    }

    #[inline(always)]
    fn ray<const LIT: bool>(
        &self,
        direction: DVec3,
        beam: &Beam,
        starts: &mut [Option<f64>],
        nodes: &mut Nodes<'_>,
    ) -> ([f32; 4], RayCounters) {
        let ray = Ray::new(DVec3::ZERO, direction);
        let mut transport = Transport::default();
        for (k, (view, drawn)) in self.trees.iter().enumerate() {
            let Some(passage) = view.passage(&ray) else {
                continue;
            };
            let start = *starts[k].get_or_insert_with(|| {
                beam.start(&Start {
                    pools: self.pools,
                    frame: self.cast.frame,
                    view,
                    root: drawn.root,
                    step: self.lens.segment.0,
                })
            });
            let Some(passage) = passage.from(start) else {
                continue;
            };
            nodes.enter(k as u32, drawn.root, drawn.header.depth);
            let walk = Walk::<_, _, LIT>::new(view, &self.lens, &self.shading, nodes, &ray, passage);
            let Ok(()) = walk.run(&mut transport);
            if transport.saturated() {
                break;
            }
        }
        let mut kept = 1.0;
        if let Some((lights, surface)) = self.lights.as_ref().filter(|_| LIT).zip(transport.surface()) {
            let counters = &mut transport.counters;
            let gathered = lights.kept(&surface, direction, |cone| {
                let hidden = self.cone(lights, cone, nodes);
                *counters = *counters + hidden.counters;
                Ok::<_, Infallible>(hidden.transmittance())
            });
            let Ok(share) = gathered;
            kept = share as f32;
        }
        transport.finish(kept)
    }

    /// What hides a light.
    #[inline(always)]
    fn cone(&self, lights: &Lights, cone: &Cone<f32>, nodes: &mut Nodes<'_>) -> Transport<f32> {
        let mut transport = Transport::default();
        let views = &self.light_views[cone.light];
        for (k, (view, (_, drawn))) in views.iter().zip(&self.trees).enumerate() {
            let passage = view.passage(&cone.ray).and_then(|p| p.from(cone.start));
            let Some((passage, lens)) = passage.zip(lights.lenses()[cone.light].as_ref()) else {
                continue;
            };
            nodes.enter(k as u32, drawn.root, drawn.header.depth);
            let walk = Walk::<_, _, false>::new(view, lens, &self.shading, nodes, &cone.ray, passage);
            let Ok(()) = walk.run(&mut transport);
            if transport.saturated() {
                break;
            }
        }
        transport
    }
}
