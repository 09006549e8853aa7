//! Cases that break ray casters, on small trees made in memory: both casters must say the same, and the right thing.
//!
//! Unless a test states its own, the bound between the casters is [`CLOSE`], and what is hit and what is missed differs
//! nowhere but at silhouettes. [`World::check`] holds that, and that no ray was stopped and no pixel not a number.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test that called it")]

mod counters;
mod depths;
mod directions;
mod extremes;
mod places;
mod refused;
mod surfaces;
mod volume;

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout::{self, Centre, Corner};
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::value::Stored;
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::settings::RenderSettings;
use brickfell_tests::exact::exactly;
use brickfell_tests::pictures::{BOUND, Bound, compare, covered};
use brickfell_tests::trees::{Kind, Maker, header};
use brickfell_tests::world::{self, Both, World, settled};
use glam::{DVec3, IVec3, UVec3};

const LAYOUTS: [SampleLayout; 2] = [Centre, Corner];

/// Bytes for the pools of scenes this small.
const SMALL_POOL: u64 = 24 << 20;

/// All pixels close: these scenes are smooth.
const CLOSE: Bound = Bound {
    near: 1.0,
    share: 0.99,
    worst: 16.0,
};

/// Where everything is thin: no pixel is a step off. (Software devices decode dark sRGB codes to within half a step.)
const SMOOTH: Bound = Bound {
    near: 1.0,
    share: 1.0,
    worst: 1.0,
};

/// The largest difference of the two casters' alpha.
fn alpha_apart(both: &Both) -> f32 {
    let pairs = both.gpu.pixels.iter().zip(&both.reference.pixels);
    pairs.map(|(g, r)| (g[3] - r[3]).abs()).fold(0.0, f32::max)
}

/// Opaque blobs that touch some borders of a tree of 8·2^depth voxels, the same at every level.
fn blobs(depth: u8) -> impl Fn(u8, IVec3) -> Stored {
    move |level, p| {
        let voxel = f64::from(1u32 << (depth - level));
        let q = (p.as_dvec3() + 0.5) * voxel * 0.35;
        let density = q.x.sin() + (q.y * 1.3).sin() + (q.z * 0.8).cos();
        let alpha = (density * 90.0).clamp(0.0, 132.0) as u8;
        let shade = |f: f64| (f64::from(alpha) * (0.5 + 0.4 * (f * 0.5).sin())) as u8;
        let slope = |f: f64| (f64::from(alpha.min(100)) * 0.7 * f.cos()) as i8;
        let normal = [slope(q.x), slope(q.y * 1.3), slope(q.z), 0];
        Stored {
            color: [shade(q.x), shade(q.y), shade(q.z), alpha],
            normal,
        }
    }
}

fn all_bricks(_: u8, _: UVec3) -> Kind {
    Kind::Brick
}

fn blob_tree(maker: Maker, header: TreeHeader) -> Maker {
    maker.tree(header, all_bricks, blobs(header.depth))
}

/// Two trees that share the face x = 0, of different size and beginning at different heights.
fn neighbours() -> Maker {
    let west = header(DVec3::new(-16.0, 0.0, 0.0), 1.0, 1, Centre, 2);
    let east = header(DVec3::new(0.0, 4.0, -3.0), 0.25, 2, Centre, 2);
    blob_tree(blob_tree(Maker::new(), west), east)
}

fn look(eye: DVec3, direction: DVec3, width: u32, height: u32) -> Camera {
    world::camera(eye, eye + direction, 50.0, [width, height])
}

fn biased(bias: f64) -> RenderSettings {
    RenderSettings {
        bias,
        ..RenderSettings::default()
    }
}

/// A number from numbers, the same every time.
fn hash(values: impl IntoIterator<Item = i32>) -> u32 {
    let mixed = values.into_iter().fold(0x9e37_79b9u32, |h, v| {
        let h = (h ^ v as u32).wrapping_mul(0x85eb_ca6b);
        (h ^ h >> 15).wrapping_mul(0xc2b2_ae35)
    });
    mixed ^ mixed >> 16
}

/// A small scene with its renderers.
struct Stage {
    world: World,
    renderer: Renderer,
    cpu: Renderer,
}

impl Stage {
    fn new(maker: Maker) -> Self {
        Self::within(maker, SMALL_POOL)
    }

    /// For scenes of thousands of bricks.
    fn large(maker: Maker) -> Self {
        Self::within(maker, world::GPU_BUDGET)
    }

    fn within(maker: Maker, gpu_budget: u64) -> Self {
        let world = maker.finish();
        Self {
            renderer: world.renderer_within(gpu_budget),
            cpu: world.cpu_renderer_within(gpu_budget),
            world,
        }
    }

    /// Both casters against the reference; the GPU's picture is given back.
    fn check(&mut self, what: &str, camera: &Camera, settings: &RenderSettings, bound: Bound) -> Both {
        let name = format!("{what}, by the CPU");
        (self.world).check(&name, &mut self.cpu, camera, settings, bound);
        (self.world).check(what, &mut self.renderer, camera, settings, bound)
    }

    /// With the settings of every day and the bound of these tests.
    fn close(&mut self, what: &str, camera: &Camera) -> Both {
        self.check(what, camera, &RenderSettings::default(), CLOSE)
    }
}

#[test]
fn what_is_compared_can_differ() {
    exactly("what_is_compared_can_differ", || {
        let world = neighbours().finish();
        let camera = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 40, 30);
        let plain = RenderSettings::default();
        let (lit, _) = settled(&mut world.renderer(), &camera, &plain);
        assert!(covered(&lit) > 100);
        let unlit = RenderSettings {
            ambient: 1.0,
            diffuse: 0.0,
            ..plain
        };
        let coarse = RenderSettings { bias: 4.0, ..plain };
        for other in [unlit, coarse] {
            let found = compare(&lit, &world.reference(&camera, &other), BOUND);
            assert!(found.beyond > 50, "{other:?}: {found:?}");
        }
    });
}
