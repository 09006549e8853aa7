//! Coarse trees of groups in pictures: they take over without a change that could be seen, and save what they are for.

use std::path::Path;
use std::sync::{Mutex, OnceLock, PoisonError};

use brickfell::metrics::{LinearImage, compare};
use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use brickfell_tests::demo::{Demo, SIZE};
use brickfell_tests::exact::exactly;
use brickfell_tests::pictures::{Bound, assert_alike, covered};
use brickfell_tests::world::{self, World, settled};
use glam::DVec3;

/// Voxels per axis of the trees: many small ones.
const TREE: u32 = 32;
const PIXELS: [u32; 2] = [160, 120];
/// One step of 255 everywhere.
const EQUAL: Bound = Bound {
    near: 1.0,
    share: 1.0,
    worst: 1.0,
};

fn terrain() -> (World, DVec3) {
    static DEMO: OnceLock<Mutex<Demo>> = OnceLock::new();
    let demo = DEMO.get_or_init(|| Mutex::new(Demo::new(Path::new(env!("CARGO_TARGET_TMPDIR")))));
    let mut demo = demo.lock().unwrap_or_else(PoisonError::into_inner);
    let middle = demo.above(0.5 * SIZE, 0.5 * SIZE, 0.0);
    (demo.world(TREE, SampleLayout::Centre), middle)
}

/// So many metres across, seen from afar.
fn view(middle: DVec3, metres: f64) -> Camera {
    const DISTANCE: f64 = 1000.0;
    let fov = (2.0 * (0.5 * metres / DISTANCE).atan()).to_degrees();
    let direction = DVec3::new(-0.4, -0.5, 0.7).normalize();
    world::camera(middle + direction * DISTANCE, middle, fov, PIXELS)
}

/// The bias at which the outermost group is far, to the last bit or so.
fn takes_over(terrain: &Terrain, camera: &Camera) -> f64 {
    let voxel = terrain.scene.root.coarse[0].voxel;
    let bounds = terrain.graph.bounds().expect("a terrain with trees");
    let (nearest, _) = bounds.depth_range(camera.eye, camera.forward);
    (voxel / (nearest * camera.pixel_size())).log2()
}

fn at(bias: f64) -> RenderSettings {
    RenderSettings {
        bias,
        ..RenderSettings::default()
    }
}

#[test]
fn both_sides_of_a_switch_are_one_picture() {
    exactly("both_sides_of_a_switch_are_one_picture", || {
        let (world, middle) = terrain();
        let terrain = Terrain::open(&world.store).unwrap();
        let camera = view(middle, 1.2 * SIZE);
        let bias = takes_over(&terrain, &camera);
        let mut renderer = world.renderer();
        let (before, near) = settled(&mut renderer, &camera, &at(bias - 1e-6));
        let (after, far) = settled(&mut renderer, &camera, &at(bias + 1e-6));
        assert!(covered(&before) > 5000);
        assert!(
            far.trees_active <= 2 && near.trees_active > far.trees_active,
            "{near:?} {far:?}"
        );
        assert_alike("GPU", &before, &after, EQUAL);
        let drawn = [-1e-6, 1e-6].map(|step| world.reference(&camera, &at(bias + step)));
        assert_alike("reference", &drawn[0], &drawn[1], EQUAL);
        assert_alike(
            "GPU against reference",
            &after,
            &drawn[1],
            Bound {
                near: 1.0,
                share: 0.999,
                worst: 16.0,
            },
        );
        // Two levels farther on, trees alone would show something else.
        let trees = Reference::new(world.store.clone(), &world.trees).unwrap();
        let alone = trees.render(&camera, &at(bias + 1.0)).unwrap().0;
        let coarse = world.reference(&camera, &at(bias + 1.0));
        let pairs = alone.pixels.iter().zip(&coarse.pixels);
        let differ = pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| (a - b).abs() > 0.02));
        assert!(differ.count() > 1000, "the coarse tree has a level of its own");
    });
}

#[test]
fn a_zoom_across_switches_has_no_popping() {
    exactly("a_zoom_across_switches_has_no_popping", || {
        const FRAMES: i32 = 24;
        let (world, middle) = terrain();
        let terrain = Terrain::open(&world.store).unwrap();
        let size = |k: i32| SIZE * 2f64.powf(f64::from(k) / f64::from(FRAMES));
        let settings = at(takes_over(&terrain, &view(middle, size(FRAMES / 2))));
        let mut renderer = world.renderer();
        let mut active = Vec::new();
        let pictures: Vec<LinearImage> = (0..=FRAMES)
            .map(|k| {
                let (picture, report): (Picture, _) =
                    settled(&mut renderer, &view(middle, size(k)), &settings);
                active.push(report.trees_active);
                LinearImage {
                    width: picture.width,
                    height: picture.height,
                    rgb: picture.pixels.iter().map(|[r, g, b, _]| [*r, *g, *b]).collect(),
                }
            })
            .collect();
        let changes: Vec<f64> = pictures
            .windows(2)
            .map(|p| compare(&p[0], &p[1]).unwrap().0.flip)
            .collect();
        println!("{active:?} {changes:.4?}");
        assert!(active[0] > 2 * active[FRAMES as usize], "{active:?}");
        for (k, change) in changes.iter().enumerate() {
            let mut around = changes[k.saturating_sub(2)..(k + 3).min(changes.len())].to_vec();
            around.sort_by(f64::total_cmp);
            assert!(
                *change < 1.2 * around[around.len() / 2],
                "frame {k}: {changes:.4?}"
            );
        }
    });
}

#[test]
fn near_ground_keeps_its_trees_and_far_ground_does_not() {
    exactly("near_ground_keeps_its_trees_and_far_ground_does_not", || {
        let (world, middle) = terrain();
        let mut renderer = world.renderer();
        let eye = middle + DVec3::new(-0.45 * SIZE, -0.45 * SIZE, 4.0);
        let camera = world::camera(eye, middle, 50.0, PIXELS);
        let settings = at(1.5);
        let both = world.check(
            "along the ground",
            &mut renderer,
            &camera,
            &settings,
            brickfell_tests::pictures::BOUND,
        );
        assert!(covered(&both.gpu) > 5000);
        let all = Terrain::open(&world.store).unwrap().trees.len();
        let (_, report) = settled(&mut renderer, &camera, &settings);
        assert!(
            4 * report.trees_active < 3 * all,
            "{} of {all}",
            report.trees_active
        );
    });
}
