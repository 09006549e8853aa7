//! Pictures in motion: what rests does not change, what moves slowly changes slowly.

use std::path::Path;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_runtime::picture::Picture;
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::settings::RenderSettings;
use brickfell_tests::demo::{Demo, SIZE};
use brickfell_tests::exact::exactly;
use brickfell_tests::pictures::{covered, rmse};
use brickfell_tests::world::{self, World, settled};
use glam::DVec3;

/// Voxels per axis of the trees.
const TREE: u32 = 128;
const PIXELS: [u32; 2] = [160, 120];
const FRAMES: u32 = 24;

fn demo() -> MutexGuard<'static, Demo> {
    static DEMO: OnceLock<Mutex<Demo>> = OnceLock::new();
    DEMO.get_or_init(|| Mutex::new(Demo::new(Path::new(env!("CARGO_TARGET_TMPDIR")))))
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

/// The terrain and a point on it.
fn terrain() -> (World, DVec3) {
    let mut demo = demo();
    let middle = demo.above(0.5 * SIZE, 0.5 * SIZE, 0.0);
    (demo.world(TREE, SampleLayout::Centre), middle)
}

fn overview(middle: DVec3, distance: f64) -> Camera {
    let direction = DVec3::new(-0.5, -0.6, 0.5).normalize();
    world::camera(middle + direction * distance, middle, 50.0, PIXELS)
}

#[test]
fn a_camera_that_rests_sees_the_same_bits_in_every_frame() {
    exactly("a_camera_that_rests_sees_the_same_bits_in_every_frame", || {
        let (world, middle) = terrain();
        let (camera, settings) = (overview(middle, 40.0), RenderSettings::default());
        let mut renderer = world.renderer();
        let (first, _) = settled(&mut renderer, &camera, &settings);
        assert!(covered(&first) > 5000);
        for frame in 0..30 {
            renderer.frame(&camera, &settings).unwrap();
            assert!(renderer.read_picture().unwrap() == first, "frame {frame}");
        }
    });
}

#[test]
fn two_renderers_settle_to_the_same_bits() {
    exactly("two_renderers_settle_to_the_same_bits", || {
        let (world, middle) = terrain();
        let settings = RenderSettings::default();
        let camera = overview(middle, 40.0);
        // The second one has seen something else before: its bricks are in other slots.
        let mut other = world.renderer();
        settled(
            &mut other,
            &overview(middle + DVec3::new(9.0, -7.0, 2.0), 12.0),
            &settings,
        );
        let (a, _) = settled(&mut world.renderer(), &camera, &settings);
        let (b, _) = settled(&mut other, &camera, &settings);
        let (c, _) = settled(&mut world.renderer(), &camera, &settings);
        let differ =
            |a: &Picture, b: &Picture| a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count();
        assert_eq!((differ(&a, &b), differ(&a, &c)), (0, 0));
    });
}

/// Differences between the settled pictures of neighbouring cameras of a path, by a measure.
fn changes(
    renderer: &mut Renderer,
    settings: &RenderSettings,
    path: impl Iterator<Item = Camera>,
    measure: fn(&Picture, &Picture) -> f64,
) -> Vec<f64> {
    let pictures: Vec<Picture> = path
        .map(|camera| settled(renderer, &camera, settings).0)
        .collect();
    pictures.windows(2).map(|w| measure(&w[0], &w[1])).collect()
}

/// The largest change in terms of the median one.
fn spike(mut changes: Vec<f64>) -> f64 {
    changes.sort_by(f64::total_cmp);
    changes[changes.len() - 1] / changes[changes.len() / 2]
}

#[test]
fn a_slow_zoom_has_no_popping() {
    exactly("a_slow_zoom_has_no_popping", || {
        let (world, middle) = terrain();
        let mut renderer = world.renderer();
        let mut zoom = |mix_levels: bool| {
            let settings = RenderSettings {
                mix_levels,
                ..RenderSettings::default()
            };
            let path = (0..FRAMES).map(|k| {
                let way = f64::from(k) / f64::from(FRAMES - 1);
                overview(middle, 60.0 / 1.5f64.powf(way))
            });
            let all = changes(&mut renderer, &settings, path, rmse);
            println!("DBG mixing {mix_levels}: {all:?}");
            spike(all)
        };
        let (mixed, nearest) = (zoom(true), zoom(false));
        assert!(mixed < 1.5 && nearest > 2.0, "{mixed} {nearest}");
    });
}

#[test]
fn a_slow_pan_does_not_flicker() {
    exactly("a_slow_pan_does_not_flicker", || {
        let (world, middle) = terrain();
        let mut renderer = world.renderer();
        let mut pan = |mix_levels: bool| {
            let settings = RenderSettings {
                mix_levels,
                ..RenderSettings::default()
            };
            // A quarter of a pixel at the middle of the picture.
            let camera = overview(middle, 45.0);
            let step = camera.right * (0.25 * 45.0 * camera.pixel_size());
            let path = (0..FRAMES).map(|k| Camera {
                eye: camera.eye + step * f64::from(k),
                ..camera
            });
            let all = changes(&mut renderer, &settings, path, rmse);
            println!("DBG pan mixing {mix_levels}: {all:?}");
            spike(all)
        };
        let (mixed, nearest) = (pan(true), pan(false));
        assert!(mixed < 1.5, "{mixed} {nearest}");
    });
}
