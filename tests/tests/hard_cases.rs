//! Cases that break ray casters, on tiny trees made in memory: both renderers must say the same, and the right thing.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout::{Centre, Corner};
use brickfell_formats::octree::TreeHeader;
use brickfell_formats::value::{SKIN_ALPHA, SOLID_ALPHA, Stored};
use brickfell_runtime::renderer::Renderer;
use brickfell_runtime::settings::RenderSettings;
use brickfell_tests::exact::exactly;
use brickfell_tests::pictures::{BOUND, Bound, SAME, assert_alike, compare, covered};
use brickfell_tests::trees::{Kind, Maker, header, sample};
use brickfell_tests::world::{self, World, settled};
use glam::{DVec3, IVec3, UVec3};

/// All pixels close: these scenes are smooth.
const CLOSE: Bound = Bound {
    near: 1.0,
    share: 0.99,
    worst: 16.0,
};

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
fn neighbours() -> World {
    let west = header(DVec3::new(-16.0, 0.0, 0.0), 1.0, 1, Centre, 2);
    let east = header(DVec3::new(0.0, 4.0, -3.0), 0.25, 2, Centre, 2);
    blob_tree(blob_tree(Maker::new(), west), east).finish()
}

fn look(eye: DVec3, direction: DVec3, width: u32, height: u32) -> Camera {
    world::camera(eye, eye + direction, 50.0, [width, height])
}

fn check(world: &World, renderer: &mut Renderer, what: &str, camera: &Camera, bound: Bound) -> [f32; 4] {
    let picture = world.check(what, renderer, camera, &RenderSettings::default(), bound);
    picture.pixels[picture.pixels.len() / 2]
}

#[test]
fn rays_along_the_axes_from_faces_edges_and_corners() {
    exactly("rays_along_the_axes_from_faces_edges_and_corners", || {
        let world = neighbours();
        let mut renderer = world.renderer();
        let eyes = [
            DVec3::new(0.0, 8.0, 1.0),   // in the face that the trees share
            DVec3::new(0.0, 4.0, -3.0),  // a corner of one, in a face of the other
            DVec3::new(-16.0, 0.0, 0.0), // a corner
            DVec3::new(-8.0, 8.0, 8.0),  // a corner of eight bricks
            DVec3::new(2.0, 6.0, -1.0),  // inside a brick, on voxel planes
            DVec3::new(8.0, 12.0, 5.0),  // the high corner
            DVec3::new(0.0, -30.0, 1.0), // outside, in the plane of the shared face
            DVec3::new(-40.0, 4.0, 4.0), // outside, in the plane of a face
        ];
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let mut hits = 0;
        for eye in eyes {
            for axis in axes.into_iter().flat_map(|a| [a, -a]) {
                let camera = look(eye, axis, 17, 17);
                let flip = |v: DVec3| DVec3::select(v.cmpeq(DVec3::ZERO), -v, v);
                // The same directions with the zeros' signs turned.
                let turned = Camera {
                    forward: flip(camera.forward),
                    right: flip(camera.right),
                    up: flip(camera.up),
                    ..camera
                };
                let what = format!("{eye} along {axis}");
                let pixel = check(&world, &mut renderer, &what, &camera, CLOSE);
                check(
                    &world,
                    &mut renderer,
                    &format!("{what}, zeros turned"),
                    &turned,
                    CLOSE,
                );
                hits += u32::from(pixel[3] > 0.5);
            }
        }
        assert!(hits > 8, "{hits} of the rays along axes hit");
    });
}

#[test]
fn an_eye_inside_a_solid_sees_its_colour() {
    exactly("an_eye_inside_a_solid_sees_its_colour", || {
        let colour = [120, 60, 30, 255];
        let tree = header(DVec3::ZERO, 1.0, 1, Corner, 1);
        let world = Maker::new()
            .tree(tree, all_bricks, |_, _| sample(colour))
            .finish();
        let mut renderer = world.renderer();
        for eye in [DVec3::splat(8.0), DVec3::splat(3.3), DVec3::new(0.0, 5.0, 15.9)] {
            let camera = look(eye, DVec3::new(0.6, 0.3, -0.4), 9, 9);
            let picture = world.check(
                "inside",
                &mut renderer,
                &camera,
                &RenderSettings::default(),
                CLOSE,
            );
            for pixel in picture.pixels {
                let red = brickfell_formats::value::srgb_to_linear(colour[0]);
                assert!(
                    pixel[3] >= 0.999 && (pixel[0] - red).abs() < 0.002,
                    "{eye}: {pixel:?}"
                );
            }
        }
    });
}

#[test]
fn trees_of_different_size_stand_side_by_side_without_a_gap() {
    exactly("trees_of_different_size_stand_side_by_side_without_a_gap", || {
        // Ground of one colour in three trees, flush where they meet.
        let solid = [90, 90, 90, SOLID_ALPHA];
        let ground = |level_voxel: f64, z0: f64| {
            move |z: i32| {
                let height = z0 + (f64::from(z) + 0.5) * level_voxel;
                sample(if height < 2.0 { solid } else { [0; 4] })
            }
        };
        let mut maker = Maker::new();
        for (origin, voxel, depth) in [
            (DVec3::new(-16.0, 0.0, 0.0), 0.5, 2u8),
            (DVec3::new(0.0, 0.0, -4.0), 0.25, 2),
            (DVec3::new(0.0, 8.0, -4.0), 0.5, 1),
        ] {
            let tree = header(origin, voxel, depth, Centre, 2);
            maker = maker.tree(tree, all_bricks, move |level, p| {
                ground(tree.level_voxel_size(level), origin.z)(p.z)
            });
        }
        let world = maker.finish();
        let mut renderer = world.renderer();
        for (eye, target) in [
            (DVec3::new(-7.0, 1.0, 9.0), DVec3::new(3.0, 8.0, 2.0)),
            (DVec3::new(0.0, 8.0, 12.0), DVec3::new(0.0, 8.0, 0.0)),
            (DVec3::new(-10.0, 8.0, 2.6), DVec3::new(6.0, 8.0, 1.9)),
        ] {
            let camera = world::camera(eye, target, 30.0, [64, 64]);
            let picture = world.check(
                &format!("{eye}"),
                &mut renderer,
                &camera,
                &RenderSettings::default(),
                CLOSE,
            );
            for (k, pixel) in picture.pixels.iter().enumerate() {
                let ray = camera.ray((k % 64) as f64, (k / 64) as f64);
                let hit = eye + ray * ((eye.z - 2.0) / -ray.z);
                let inside = ray.z < 0.0 && hit.x > -15.0 && hit.x < 7.0 && hit.y > 1.0 && hit.y < 15.0;
                assert!(!inside || pixel[3] > 0.99, "{eye}, pixel {k} at {hit}: {pixel:?}");
            }
        }
    });
}

#[test]
fn a_skin_one_voxel_thick_is_opaque_at_every_phase() {
    exactly("a_skin_one_voxel_thick_is_opaque_at_every_phase", || {
        for layout in [Centre, Corner] {
            let tree = header(DVec3::ZERO, 1.0, 2, layout, 2);
            let skin = |level: u8, p: IVec3| match p.z == 13 >> (2 - level) {
                true => sample([200, 180, 160, SKIN_ALPHA]),
                false => sample([0; 4]),
            };
            let world = Maker::new().tree(tree, all_bricks, skin).finish();
            let mut renderer = world.renderer();
            for phase in 0..8 {
                let shift = f64::from(phase) / 8.0;
                let eye = DVec3::new(15.0 + shift, 14.3 + 0.37 * shift, 29.0 + shift);
                let target = DVec3::new(16.0 - shift, 16.4, 13.0 + shift);
                let camera = world::camera(eye, target, 35.0, [48, 48]);
                let what = format!("{layout:?} phase {phase}");
                let picture = world.check(&what, &mut renderer, &camera, &RenderSettings::default(), CLOSE);
                let least = picture.pixels.iter().map(|p| p[3]).fold(1.0, f32::min);
                assert!(least >= 0.99, "{what}: {least}");
            }
        }
    });
}

#[test]
fn the_picture_is_the_same_far_from_the_worlds_origin() {
    exactly("the_picture_is_the_same_far_from_the_worlds_origin", || {
        let picture = |offset: DVec3| {
            let west = header(offset, 1.0, 2, Centre, 2);
            let east = header(offset + DVec3::new(32.0, 0.0, -8.0), 1.0, 2, Centre, 2);
            let world = blob_tree(blob_tree(Maker::new(), west), east).finish();
            let eye = offset + DVec3::new(20.0, -30.0, 24.0);
            let camera = world::camera(eye, offset + DVec3::new(31.0, 16.0, 8.0), 60.0, [160, 120]);
            let mut renderer = world.renderer();
            let (picture, _) = settled(&mut renderer, &camera, &RenderSettings::default());
            (picture, world.reference(&camera, &RenderSettings::default()))
        };
        let (here, reference) = picture(DVec3::ZERO);
        assert!(covered(&here) > 4000);
        assert_alike("at the origin", &here, &reference, BOUND);
        for distance in [1.1e3, 1.1e6, 1.1e9] {
            let (there, reference) = picture(DVec3::new(distance, -distance, 1e-3 * distance));
            assert_alike(&format!("at {distance} m"), &here, &there, SAME);
            assert_alike(
                &format!("at {distance} m against the reference"),
                &there,
                &reference,
                BOUND,
            );
        }
    });
}

#[test]
fn pictures_of_one_pixel_and_of_one_row() {
    exactly("pictures_of_one_pixel_and_of_one_row", || {
        let world = neighbours();
        let mut renderer = world.renderer();
        for (width, height, fov) in [
            (1, 1, 40.0),
            (16384, 1, 0.004),
            (1, 16384, 60.0),
            (16384, 3, 0.01),
            (7, 5, 60.0),
        ] {
            let eye = DVec3::new(-6.0, -20.0, 12.0);
            let camera = world::camera(eye, DVec3::new(-3.0, 8.0, 3.0), fov, [width, height]);
            let what = format!("{width}x{height}");
            let picture = world.check(&what, &mut renderer, &camera, &RenderSettings::default(), CLOSE);
            assert_eq!(picture.pixels.len() as u32, width * height);
            assert!(covered(&picture) > 0, "{what}");
        }
    });
}

#[test]
fn an_empty_scene_is_empty() {
    exactly("an_empty_scene_is_empty", || {
        let world = Maker::new().finish();
        let camera = look(DVec3::ZERO, DVec3::X, 20, 10);
        let mut renderer = world.renderer();
        let picture = world.check("empty", &mut renderer, &camera, &RenderSettings::default(), BOUND);
        assert!(picture.pixels.iter().all(|p| *p == [0.0; 4]));
        // So is one that is behind the eye.
        let world = neighbours();
        let camera = look(DVec3::new(50.0, 0.0, 0.0), DVec3::X, 20, 10);
        let picture = world.check(
            "behind",
            &mut world.renderer(),
            &camera,
            &RenderSettings::default(),
            BOUND,
        );
        assert!(picture.pixels.iter().all(|p| *p == [0.0; 4]));
    });
}

/// Metres of a ray in the cube between `lo` and `hi`.
fn path(eye: DVec3, ray: DVec3, lo: DVec3, hi: DVec3) -> f64 {
    let (a, b) = ((lo - eye) / ray, (hi - eye) / ray);
    let (enter, leave) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
    (leave - enter).max(0.0) * ray.length()
}

#[test]
fn a_constant_root_lets_light_through_as_beers_law_says() {
    exactly("a_constant_root_lets_light_through_as_beers_law_says", || {
        for (alpha, voxel, depth) in [(40u8, 1.0, 0u8), (3, 0.5, 3), (1, 1000.0, 4), (254, 0.01, 1)] {
            let tree = header(DVec3::splat(-voxel), voxel, depth, Centre, 1);
            let world = Maker::new()
                .tree(
                    tree,
                    |_, _| Kind::Leaf([alpha, 0, 0, alpha]),
                    |_, _| sample([0; 4]),
                )
                .finish();
            let side = tree.side();
            let [lo, hi] = tree.bounds();
            for eye in [DVec3::new(-1.3, -0.9, 1.7), DVec3::new(0.4, 0.3, 0.2)] {
                let eye = lo + eye * side;
                let camera = world::camera(eye, (lo + hi) * 0.5, 50.0, [32, 32]);
                let what = format!("alpha {alpha}, voxel {voxel}, depth {depth}, from {eye}");
                let picture = world.check(
                    &what,
                    &mut world.renderer(),
                    &camera,
                    &RenderSettings::default(),
                    BOUND,
                );
                let mut worst = 0f64;
                for (k, pixel) in picture.pixels.iter().enumerate() {
                    let ray = camera.ray((k % 32) as f64, (k / 32) as f64);
                    // A constant's alpha is its opacity across an eighth of its side.
                    let tau = -(-f64::from(alpha) / 255.0).ln_1p() * path(eye, ray, lo, hi) / (side / 8.0);
                    let transmittance = if (-tau).exp() < 1.0 / 1024.0 {
                        0.0
                    } else {
                        (-tau).exp()
                    };
                    worst = worst.max((1.0 - f64::from(pixel[3]) - transmittance).abs());
                }
                assert!(worst < 1e-4, "{what}: off by {worst}");
            }
        }
    });
}

#[test]
fn what_is_compared_can_differ() {
    exactly("what_is_compared_can_differ", || {
        let world = neighbours();
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
