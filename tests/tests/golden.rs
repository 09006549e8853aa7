//! The GPU's pictures of real terrains: against the reference, against each other, and in pools that are too small.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use brickfell::build::Filter;
use brickfell::holes::count_holes;
use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::scene::{CoarseOctTree, Group, PagedOctTree};
use brickfell_runtime::reference::Reference;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::{RenderSettings, sun_direction};
use brickfell_runtime::terrain::{Terrain, read_header};
use brickfell_tests::demo::{Demo, SIZE};
use brickfell_tests::exact::exactly;
use brickfell_tests::pictures::{BOUND, Bound, SAME, assert_alike, covered};
use brickfell_tests::world::{self, World, settled};
use glam::DVec3;

/// Voxels per axis of the trees: 32 m, so that the terrain has several columns of them.
const TREE: u32 = 128;

fn demo() -> MutexGuard<'static, Demo> {
    static DEMO: OnceLock<Mutex<Demo>> = OnceLock::new();
    DEMO.get_or_init(|| Mutex::new(Demo::new(Path::new(env!("CARGO_TARGET_TMPDIR")))))
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

/// How far pictures of bricks in blocks are from those of samples; rims of foliage are the worst, by opacities against the axes.
const LOSS: Bound = Bound {
    near: 24.0,
    share: 0.99,
    worst: 200.0,
};

const PIXELS: [u32; 2] = [320, 240];

fn camera(eye: DVec3, target: DVec3) -> Camera {
    world::camera(eye, target, 60.0, PIXELS)
}

/// Everything from above, models from close by, and along the ground across the borders of trees.
fn cameras(demo: &Demo) -> [(&'static str, Camera); 3] {
    let middle = demo.above(0.5 * SIZE, 0.5 * SIZE, 0.0);
    let stand = demo.above(0.5 * SIZE, 0.2 * SIZE, 4.0);
    let ground = demo.above(3.0, 30.0, 1.0);
    [
        (
            "overview",
            camera(middle + DVec3::new(-50.0, -45.0, 45.0), middle),
        ),
        ("close", camera(stand, demo.above(0.4 * SIZE, 0.45 * SIZE, 2.0))),
        ("grazing", camera(ground, ground + DVec3::new(60.0, 2.0, 0.5))),
    ]
}

#[test]
fn the_gpu_agrees_with_the_reference() {
    exactly("the_gpu_agrees_with_the_reference", || {
        let (world, cameras) = {
            let mut demo = demo();
            (demo.world(TREE, SampleLayout::Centre), cameras(&demo))
        };
        assert!(world.trees.len() >= 5, "{} trees", world.trees.len());
        let mut renderer = world.renderer();
        for (name, camera) in cameras {
            let picture = world.check(name, &mut renderer, &camera, &RenderSettings::default(), BOUND);
            assert!(covered(&picture.gpu) > 320 * 240 / 5, "{name} shows little");
        }
    });
}

#[test]
fn the_gpu_agrees_with_the_reference_in_every_setting() {
    exactly("the_gpu_agrees_with_the_reference_in_every_setting", || {
        let default = RenderSettings::default();
        let settings = [
            ("default", default),
            ("nearest level", RenderSettings { fade: 0.0, ..default }),
            ("bias 0", RenderSettings { bias: 0.0, ..default }),
            ("bias 1", RenderSettings { bias: 1.0, ..default }),
            ("half steps", RenderSettings { step: -1, ..default }),
            ("double steps", RenderSettings { step: 1, ..default }),
            (
                "shadows",
                RenderSettings {
                    shadows: true,
                    sun: sun_direction(235.0, 25.0),
                    ..default
                },
            ),
            (
                "shadows and occlusion",
                RenderSettings {
                    shadows: true,
                    occlusion: true,
                    ..default
                },
            ),
        ];
        for layout in [SampleLayout::Corner, SampleLayout::Centre] {
            let (world, cameras) = {
                let mut demo = demo();
                (demo.world(TREE, layout), cameras(&demo))
            };
            let mut renderer = world.renderer();
            for (setting, render) in settings {
                for (name, camera) in &cameras[..2] {
                    let what = format!("{layout:?}, {setting}, {name}");
                    world.check(&what, &mut renderer, camera, &render, BOUND);
                }
            }
        }
    });
}

#[test]
fn the_gpu_agrees_with_the_reference_about_opacities_against_axes() {
    let name = "the_gpu_agrees_with_the_reference_about_opacities_against_axes";
    exactly(name, || {
        let default = RenderSettings::default();
        let coarse = RenderSettings { bias: 2.0, ..default };
        for layout in [SampleLayout::Corner, SampleLayout::Centre] {
            let (world, isotropic, cameras) = {
                let mut demo = demo();
                let isotropic = demo.filtered_world(TREE, layout, Filter::Coverage);
                (
                    demo.filtered_world(TREE, layout, Filter::Axes),
                    isotropic,
                    cameras(&demo),
                )
            };
            let (mut renderer, mut other) = (world.renderer(), isotropic.renderer());
            for (name, camera) in cameras {
                for (setting, render) in [("default", default), ("coarse", coarse)] {
                    let what = format!("{layout:?}, {setting}, {name}");
                    let picture = world.check(&what, &mut renderer, &camera, &render, BOUND);
                    assert!(covered(&picture.gpu) > 320 * 240 / 5, "{what} shows little");
                    // The layer is read: without it pictures would be those of the largest opacity.
                    let other = isotropic.check(&what, &mut other, &camera, &render, BOUND);
                    assert!(
                        picture.gpu.pixels != other.gpu.pixels,
                        "{what}: nothing depends on the direction"
                    );
                }
            }
        }
    });
}

#[test]
fn the_gpu_agrees_with_the_reference_about_blocks() {
    exactly("the_gpu_agrees_with_the_reference_about_blocks", || {
        let default = RenderSettings::default();
        for (layout, filter) in [
            (SampleLayout::Centre, Filter::Axes),
            (SampleLayout::Corner, Filter::Coverage),
        ] {
            let (world, samples, cameras) = {
                let mut demo = demo();
                (
                    demo.compressed_world(TREE, layout, filter),
                    demo.filtered_world(TREE, layout, filter),
                    cameras(&demo),
                )
            };
            let (mut renderer, mut other) = (world.renderer(), samples.renderer());
            assert!(!renderer.decodes_blocks(), "the device reads no blocks");
            for (name, camera) in cameras {
                for bias in [default.bias, 2.0] {
                    let what = format!("{layout:?}, {name}, bias {bias}");
                    let render = RenderSettings { bias, ..default };
                    let picture = world.check(&what, &mut renderer, &camera, &render, BOUND);
                    assert!(covered(&picture.gpu) > 320 * 240 / 5, "{what} shows little");
                    // Blocks lose something, but not much.
                    let (lossless, _) = settled(&mut other, &camera, &render);
                    assert_alike(&what, &picture.gpu, &lossless, LOSS);
                    assert!(picture.gpu.pixels != lossless.pixels);
                }
            }
        }
    });
}

/// Not run with exact filtering: no device draws.
#[test]
fn the_cpu_agrees_with_the_reference_about_samples_axes_and_blocks() {
    let default = RenderSettings::default();
    let settings = [
        ("default", default),
        ("nearest level", RenderSettings { fade: 0.0, ..default }),
        ("bias 2", RenderSettings { bias: 2.0, ..default }),
        ("half steps", RenderSettings { step: -1, ..default }),
        ("double steps", RenderSettings { step: 1, ..default }),
        (
            "shadows and occlusion",
            RenderSettings {
                shadows: true,
                occlusion: true,
                ..default
            },
        ),
    ];
    for (layout, filter) in [
        (SampleLayout::Centre, Filter::Axes),
        (SampleLayout::Corner, Filter::Coverage),
    ] {
        let (worlds, cameras) = {
            let mut demo = demo();
            let samples = demo.filtered_world(TREE, layout, filter);
            let blocks = demo.compressed_world(TREE, layout, filter).read_to_nearest();
            ([("samples", samples), ("blocks", blocks)], cameras(&demo))
        };
        for (kind, world) in &worlds {
            let mut renderer = world.cpu_renderer_within(world::GPU_BUDGET);
            assert!(!renderer.decodes_blocks());
            for (setting, render) in settings {
                for (name, camera) in &cameras[..2] {
                    let what = format!("{layout:?}, {kind}, {setting}, {name}, by the CPU");
                    let both = world.check(&what, &mut renderer, camera, &render, BOUND);
                    assert!(covered(&both.gpu) > 320 * 240 / 5, "{what} shows little");
                }
            }
        }
    }
}

#[test]
fn blocks_take_a_quarter_of_the_pool_and_of_memory() {
    exactly("blocks_take_a_quarter_of_the_pool_and_of_memory", || {
        let (world, cameras) = {
            let mut demo = demo();
            (
                demo.compressed_world(TREE, SampleLayout::Centre, Filter::Axes),
                cameras(&demo),
            )
        };
        let settings = RenderSettings::default();
        let (_, camera) = cameras[1];
        let small = RendererConfig {
            gpu_budget: 8 << 20,
            ..RendererConfig::default()
        };
        let mut blocks = world.renderer_with(small);
        let mut samples = world.renderer_with(RendererConfig {
            keep_blocks: false,
            ..small
        });
        assert!(samples.decodes_blocks() && !blocks.decodes_blocks());
        assert_eq!((blocks.brick_bytes(), samples.brick_bytes()), (2880, 12_000));
        // Each has a stamp, two node tiles and theirs.
        assert!(blocks.brick_slots() > samples.brick_slots() * 7 / 2);
        // In pools that are large enough both show the same but for what is mixed before it is multiplied with alpha.
        for config in [&mut blocks, &mut samples] {
            *config = world.renderer_with(RendererConfig {
                keep_blocks: !config.decodes_blocks(),
                ..RendererConfig::default()
            });
        }
        let (kept, _) = settled(&mut blocks, &camera, &settings);
        let (decoded, _) = settled(&mut samples, &camera, &settings);
        assert_alike("kept and decoded", &kept, &decoded, LOSS);
        let held = |renderer: &Renderer| renderer.pager_stats().resident_bytes;
        assert!(held(&blocks) * 3 < held(&samples));
    });
}

#[test]
fn the_hand_written_example_looks_as_the_reference_says() {
    exactly("the_hand_written_example_looks_as_the_reference_says", || {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/two_trees");
        let world = World::open(&folder);
        let mut renderer = world.renderer();
        let target = DVec3::new(28.0, 16.0, 4.0);
        for (name, eye) in [
            ("south", DVec3::new(24.0, -40.0, 30.0)),
            ("east", DVec3::new(80.0, 40.0, 20.0)),
            ("inside", DVec3::new(31.0, 15.0, 23.0)),
        ] {
            let camera = camera(eye, target);
            let picture = world.check(name, &mut renderer, &camera, &RenderSettings::default(), BOUND);
            assert!(covered(&picture.gpu) > 1000, "{name} shows little");
        }
    });
}

#[test]
fn one_tree_or_several_look_the_same() {
    exactly("one_tree_or_several_look_the_same", || {
        let (one, several, cameras, down) = {
            let mut demo = demo();
            let middle = demo.above(0.5 * SIZE, 0.5 * SIZE, 0.0);
            (
                demo.world(512, SampleLayout::Centre),
                demo.world(TREE, SampleLayout::Centre),
                cameras(&demo),
                camera(middle + DVec3::new(4.0, -6.0, 30.0), middle),
            )
        };
        assert_eq!(one.trees.len(), 1);
        let (mut one, mut several) = (one.renderer(), several.renderer());
        // Not the overview: the ground's solid sides reach as far down as a tree's coarsest voxels need it.
        let settings = RenderSettings::default();
        for (name, camera) in cameras.into_iter().skip(1).chain([("down", down)]) {
            let (a, _) = settled(&mut one, &camera, &settings);
            let (b, _) = settled(&mut several, &camera, &settings);
            assert_alike(name, &a, &b, BOUND);
        }
    });
}

#[test]
fn settling_again_gives_the_same_bits() {
    exactly("settling_again_gives_the_same_bits", || {
        let (world, cameras) = {
            let mut demo = demo();
            (demo.world(TREE, SampleLayout::Centre), cameras(&demo))
        };
        let settings = RenderSettings::default();
        let [(_, here), (_, there), _] = cameras;
        let mut renderer = world.renderer();
        let (first, _) = settled(&mut renderer, &here, &settings);
        let (second, report) = settled(&mut renderer, &here, &settings);
        assert_eq!(report.uploads, 0);
        assert!(first == second, "settled twice");
        for _ in 0..3 {
            renderer.frame(&here, &settings).unwrap();
        }
        assert!(first == renderer.read_picture().unwrap(), "the camera rests");
        settled(&mut renderer, &there, &settings);
        let (back, _) = settled(&mut renderer, &here, &settings);
        assert!(first == back, "after a look elsewhere");
        let (fresh, _) = settled(&mut world.renderer(), &here, &settings);
        assert_alike("by another renderer, with other slots", &first, &fresh, SAME);
    });
}

#[test]
fn a_pool_too_small_gives_a_coarser_picture_without_holes() {
    exactly("a_pool_too_small_gives_a_coarser_picture_without_holes", || {
        let (world, cameras) = {
            let mut demo = demo();
            (demo.world(TREE, SampleLayout::Centre), cameras(&demo))
        };
        let settings = RenderSettings::default();
        let (_, camera) = cameras[0];
        let mut large = world.renderer();
        settled(&mut large, &camera, &settings);
        let used: u32 = large.feedback().used_bricks.iter().map(|w| w.count_ones()).sum();
        let reference = world.reference(&camera, &settings);
        // Bricks above those in use need room, too: what is a little too small for both must not wait for ever.
        for share in [1, 2, 4] {
            // A slot has 12 bytes for each of 1000 samples, its stamp, and two node tiles with theirs.
            let mut small = world.renderer_within(u64::from(used / share) * 8_140);
            let slots = small.brick_slots();
            assert!(slots < used * 4 / 5 / share, "{slots} slots for {used}");
            let (picture, report) = settled(&mut small, &camera, &settings);
            assert!(report.bias > settings.bias, "{report:?}");
            assert_eq!(count_holes(&picture, &reference), 0);
            // What it shows is right for the bias that it has.
            let coarse = RenderSettings {
                bias: report.bias,
                ..settings
            };
            assert_alike("raised bias", &picture, &world.reference(&camera, &coarse), BOUND);
            let loads = small.pager_stats().loads;
            for _ in 0..20 {
                let rest = small.frame(&camera, &settings).unwrap();
                assert_eq!(
                    (rest.uploads, rest.node_updates, rest.pending),
                    (0, 0, 0),
                    "{rest:?}"
                );
                assert_eq!(rest.bias, report.bias);
            }
            assert_eq!(small.pager_stats().loads, loads);
            assert!(picture == small.read_picture().unwrap());
        }
    });
}

#[test]
fn a_far_eye_with_a_narrow_view_sees_what_a_near_one_does() {
    exactly("a_far_eye_with_a_narrow_view_sees_what_a_near_one_does", || {
        let (world, target) = {
            let mut demo = demo();
            let target = demo.above(0.5 * SIZE, 0.5 * SIZE, 0.0);
            (demo.world(TREE, SampleLayout::Centre), target)
        };
        let mut renderer = world.renderer();
        let direction = DVec3::new(-0.5, -0.6, 0.62).normalize();
        for distance in [1e4, 1e6] {
            let fov = 2.0 * (30.0f64 / distance).atan().to_degrees();
            let camera = world::camera(target + direction * distance, target, fov, PIXELS);
            let what = format!("from {distance} m");
            let picture = world.check(&what, &mut renderer, &camera, &RenderSettings::default(), BOUND);
            assert!(covered(&picture.gpu) > 320 * 240 / 2, "{what} shows little");
        }
    });
}

#[test]
fn nothing_is_lost_where_trees_are_cut_to_what_is_in_them() {
    let (world, cameras) = {
        let mut demo = demo();
        (demo.world(TREE, SampleLayout::Centre), cameras(&demo))
    };
    let mut scene = Terrain::open(&world.store).unwrap().scene;
    // Trees, and the coarse ones of each height: those lie one within the other.
    let mut parts: Vec<Vec<PagedOctTree>> = vec![scene.trees().cloned().collect()];
    let coarse: Vec<CoarseOctTree> = scene.coarse_trees().cloned().collect();
    let by_voxel = |voxel: f64| coarse.iter().filter(move |c| c.voxel == voxel);
    let voxels = (1..8).map(|height| 2.0 * f64::from(1 << height));
    parts.extend(
        voxels
            .map(|v| by_voxel(v).map(|c| c.tree.clone()).collect::<Vec<_>>())
            .filter(|p| !p.is_empty()),
    );
    assert!(parts.len() > 1, "no groups");
    for part in &parts {
        let names: Vec<String> = part.iter().map(|t| t.tree_file.clone()).collect();
        scene.root = Group {
            trees: part.clone(),
            ..Group::default()
        };
        let cut = Reference::open(Arc::clone(&world.store), &scene).unwrap();
        let whole = Reference::new(Arc::clone(&world.store), &names).unwrap();
        for (what, camera) in &cameras {
            for bias in [-1.0, 1.0, 3.0, 5.0] {
                let settings = RenderSettings {
                    bias,
                    ..RenderSettings::default()
                };
                let [(cut, counters), (whole, more)] =
                    [&cut, &whole].map(|r| r.render(camera, &settings).unwrap());
                assert_alike(&format!("{what} at {bias}"), &cut, &whole, SAME);
                assert!(counters.nodes <= more.nodes, "{what}: {counters:?} {more:?}");
            }
        }
    }
    let volume = |[lo, hi]: [DVec3; 2]| (hi - lo).element_product();
    let bounds = |t: &PagedOctTree| t.bounds.map(|b| [b.min, b.max]).unwrap();
    let trees = || parts.iter().flatten();
    let cut: f64 = trees().map(|t| volume(bounds(t))).sum();
    let whole: f64 = trees()
        .map(|t| volume(read_header(&*world.store, &t.tree_file).unwrap().bounds()))
        .sum();
    assert!(cut < 0.9 * whole, "{cut} of {whole} cubic metres");
}
