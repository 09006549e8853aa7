//! T against what can be said about its pictures without drawing them: what the tests share, light, coverage, hits of
//! triangles; ground in a module of its own.

mod ground;

use std::path::Path;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec2, dvec3};

use super::*;
use crate::input::{GeoTransform, Georef, HeightMap, Material, Raster, Texture};

/// A height map of n × n pixels of 1 m with its low corner at a point; `height` is asked at pixel centres.
fn layer(n: u32, corner: DVec2, height: impl Fn(f64, f64) -> f64) -> Layer {
    let transform = GeoTransform::north_up(corner, 1.0, n);
    let georef = Georef {
        transform,
        crs: None,
        linear_unit_metres: 1.0,
        vertical_unit_metres: None,
        geographic: false,
    };
    let center = |c: u32, r: u32| transform.at(DVec2::new(f64::from(c) + 0.5, f64::from(r) + 0.5)) - corner;
    let places = (0..n).flat_map(|r| (0..n).map(move |c| center(c, r)));
    let data = places.map(|p| height(p.x, p.y) as f32).collect();
    let map = HeightMap::new(Path::new("test"), (n, n), data, georef).unwrap();
    Layer { map, imagery: None }
}

impl Truth<'_> {
    fn hit(&self, eye: DVec3, d: DVec3, after: Option<(f64, usize)>) -> Option<Hit> {
        self.next_hit(eye, d, after).unwrap()
    }

    fn draw(&self, camera: &Camera, settings: &RenderSettings, rays_per_axis: u32, seed: u64) -> Picture {
        self.render(camera, settings, rays_per_axis, seed).unwrap()
    }
}

fn material(color: [f32; 4], texture: Option<Texture>) -> Material {
    Material {
        name: "m".into(),
        color,
        cutout: color[3] < 1.0 || texture.as_ref().is_some_and(Texture::has_alpha),
        texture: texture.map(Arc::new),
    }
}

/// Triangles of one material.
fn mesh(triangles: &[[DVec3; 3]], material: Material) -> Mesh {
    let triangle = |k: usize| Triangle {
        v: [0, 1, 2].map(|c| (3 * k + c) as u32),
        uv: [Vec2::new(0.0, 0.0), Vec2::new(1.0, 0.0), Vec2::new(1.0, 1.0)],
        n: None,
        material: 0,
    };
    Mesh {
        positions: triangles.iter().flatten().copied().collect(),
        triangles: (0..triangles.len()).map(triangle).collect(),
        materials: vec![material],
        ..Mesh::default()
    }
}

#[test]
fn a_roof_hides_the_sun_and_its_part_of_the_sky() {
    let white = || material([1.0, 1.0, 1.0, 1.0], None);
    let ground = mesh(&square(-50.0, -50.0, 50.0, 50.0, 0.0), white());
    let half = material([1.0, 1.0, 1.0, 0.5], None);
    let roof = mesh(&square(-50.0, 0.0, 50.0, 50.0, 1.0), white());
    let pane = mesh(&square(-50.0, -20.0, 50.0, -10.0, 1.0), half);
    let meshes = [ground, roof, pane];
    let truth = Truth::new(&meshes, &[], &Bottom::Boxes(Vec::new())).unwrap();
    let settings = RenderSettings {
        sun: dvec3(0.0, 1.0, 1.0).normalize(),
        shadows: true,
        occlusion: true,
        ..RenderSettings::default()
    };
    // Rays that start below roof and pane.
    let seen = |y: f64, settings: &RenderSettings| {
        let camera = Camera::look_at(dvec3(0.2, y, 0.5), dvec3(0.2, y, 0.0), 1.0, 1, 1).unwrap();
        f64::from(truth.draw(&camera, settings, 64, 1).pixels[0][0])
    };
    let sun = RenderSettings {
        ambient: 0.0,
        diffuse: 1.0,
        ..settings
    };
    let cosine = 0.5f64.sqrt();
    for (y, expected) in [(-5.0, cosine), (-0.5, 0.0), (5.0, 0.0), (-15.0, 0.5 * cosine)] {
        assert!((seen(y, &sun) - expected).abs() < 0.01, "{y}");
    }
    // Below the edge of the roof half of the sky is left, but for the pane.
    let sky = RenderSettings {
        ambient: 1.0,
        diffuse: 0.0,
        ..settings
    };
    assert!((seen(0.0, &sky) - 0.5).abs() < 0.02);
    assert!(seen(30.0, &sky) < 0.01 && seen(-45.0, &sky) > 0.99);
}

/// A level square with corners at (x0, y0) and (x1, y1), seen counter-clockwise from above.
fn square(x0: f64, y0: f64, x1: f64, y1: f64, z: f64) -> [[DVec3; 3]; 2] {
    let [a, b, c, d] = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| dvec3(x, y, z));
    [[a, b, c], [c, d, a]]
}

const GREY: [f32; 4] = [0.5, 0.4, 0.3, 1.0];

/// A camera at (0, 0, `height`) that looks down on `size` × `size` metres at z = 0, `pixels` a side.
fn down(height: f64, size: f64, pixels: u32) -> Camera {
    let fov = 2.0 * (0.5 * size / height).atan().to_degrees();
    Camera::look_at(dvec3(0.0, 0.0, height), DVec3::ZERO, fov, pixels, pixels).unwrap()
}

fn random_point(random: &mut Random, size: f64) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| random.between(-size, size)))
}

#[test]
fn a_plane_has_its_light_and_its_back_is_not_turned() {
    let settings = RenderSettings::default();
    let up = square(-50.0, -50.0, 50.0, 50.0, 0.0);
    let turned = up.map(|[a, b, c]| [c, b, a]);
    for (triangles, light) in [
        (up, settings.ambient + settings.diffuse * settings.sun.z),
        (turned, settings.ambient),
    ] {
        let meshes = [mesh(&triangles, material(GREY, None))];
        let truth = Truth::new(&meshes, &[], &Bottom::Level(0.0)).unwrap();
        let picture = truth.draw(&down(10.0, 4.0, 5), &settings, 3, 7);
        for pixel in picture.pixels {
            assert_eq!(pixel[3], 1.0, "no ray passes between the two triangles");
            for c in 0..3 {
                assert!((f64::from(pixel[c]) - light * f64::from(GREY[c])).abs() < 1e-6);
            }
        }
    }
    assert!(matches!(
        Truth::new(&[], &[], &Bottom::Level(0.0)).err(),
        Some(TruthError::NoInput)
    ));
}

#[test]
fn coverage_of_a_pixel_is_that_of_its_area() {
    // Edges at x = 0.35 and y = -0.6 m; the pixels are 1 m wide.
    let meshes = [mesh(&square(-0.35, -0.6, 9.0, 9.0, 0.0), material(GREY, None))];
    let truth = Truth::new(&meshes, &[], &Bottom::Level(0.0)).unwrap();
    let n = 16;
    let picture = truth.draw(&down(100.0, 4.0, 4), &RenderSettings::default(), n, 1);
    let share = |low: f64, edge: f64| (low + 1.0 - edge).clamp(0.0, 1.0);
    for (k, pixel) in picture.pixels.iter().enumerate() {
        let (x, y) = ((k % 4) as f64 - 2.0, 1.0 - (k / 4) as f64);
        let expected = share(x, -0.35) * share(y, -0.6);
        // Only parts that an edge cuts can err, each by less than itself.
        assert!(
            (f64::from(pixel[3]) - expected).abs() <= 1.0 / f64::from(n),
            "{x} {y}: {}",
            pixel[3]
        );
    }
    assert!(picture.pixels.iter().any(|p| p[3] > 0.2 && p[3] < 0.8));
}

#[test]
fn the_hierarchy_misses_nothing() {
    let mut random = Random::new(5);
    let triangles: Vec<[DVec3; 3]> = (0..400)
        .map(|k| {
            let at = random_point(&mut random, 100.0);
            // From specks to sheets, some of them flat boxes.
            let size = [0.01, 1.0, 30.0][k % 3];
            let flat = dvec3(1.0, 1.0, if k % 5 == 0 { 0.0 } else { 1.0 });
            [0; 3].map(|_| at + random_point(&mut random, size) * flat)
        })
        .collect();
    let meshes = [
        mesh(&triangles[..150], material(GREY, None)),
        mesh(&triangles[150..], material(GREY, None)),
    ];
    let truth = Truth::new(&meshes, &[], &Bottom::Level(0.0)).unwrap();
    let mut hits = 0;
    for far in [0.0, 200.0, 1e5] {
        for k in 0..1000 {
            let eye = random_point(&mut random, 1.0).normalize() * far + random_point(&mut random, 50.0);
            let [a, b, c] = triangles[k % 400];
            // At a corner, an edge, or the middle.
            let target = [a, (a + b) * 0.5, (a + b + c) / 3.0][k % 3];
            let d = target - eye;
            let shear = Shear::new(d);
            let brute = triangles.iter().enumerate().filter_map(|(k, t)| {
                let (depth, _) = shear.meet(&t.map(|p| p - eye))?;
                (depth >= 0.0).then_some((depth, k))
            });
            let brute = brute.reduce(|a, b| if b < a { b } else { a });
            let hit = truth.hit(eye, d, None).map(|h| (h.depth, h.number));
            assert_eq!(hit, brute);
            hits += u32::from(hit.is_some());
        }
    }
    assert!(hits > 2500, "{hits}");
}

#[test]
fn all_directions_leave_a_closed_box_at_its_faces() {
    let corner = |k: usize| dvec3((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2) as f64) * 2.0 - 1.0;
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles: Vec<[DVec3; 3]> = faces
        .iter()
        .flat_map(|f| {
            let [a, b, c, d] = f.map(corner);
            [[a, b, c], [a, c, d]]
        })
        .collect();
    let meshes = [mesh(&triangles, material(GREY, None))];
    let truth = Truth::new(&meshes, &[], &Bottom::Level(0.0)).unwrap();
    let values = [-1.0, -0.5, -0.0, 0.0, 0.5, 1.0];
    for k in 0..216 {
        let d = dvec3(values[k % 6], values[k / 6 % 6], values[k / 36]);
        if d == DVec3::ZERO {
            continue;
        }
        let hit = truth.hit(DVec3::ZERO, d, None).unwrap();
        assert_eq!(hit.depth, 1.0 / d.abs().max_element(), "{d}");
        // From outside, the same face from the other side.
        let hit = truth.hit(d * 8.0, -d, None).unwrap();
        assert_eq!(hit.depth, 8.0 - 1.0 / d.abs().max_element(), "{d}");
    }
}

#[test]
fn cut_out_surfaces_let_through_what_they_do_not_cover() {
    let unlit = RenderSettings {
        ambient: 1.0,
        diffuse: 0.0,
        ..RenderSettings::default()
    };
    let texel = |alpha: u8| {
        Texture::of(Raster {
            width: 1,
            height: 1,
            pixels: vec![[255, 255, 255, alpha]],
        })
    };
    let sheet = |z: f64, material: Material| mesh(&square(-9.0, -9.0, 9.0, 9.0, z), material);
    // From above: nothing, half, two of a quarter in the same plane, opaque; and what must not show.
    let meshes = [
        sheet(5.0, material([1.0, 1.0, 1.0, 1.0], Some(texel(0)))),
        sheet(4.0, material([0.8, 0.0, 0.0, 0.5], None)),
        sheet(3.0, material([0.0, 0.8, 0.0, 0.25], None)),
        sheet(3.0, material([0.0, 0.0, 0.8, 0.5], Some(texel(127)))),
        sheet(1.0, material([0.1, 0.1, 0.1, 1.0], None)),
        sheet(0.0, material([1.0, 0.0, 0.0, 1.0], None)),
    ];
    let camera = down(10.0, 2.0, 1);
    let draw = |meshes: &[Mesh]| {
        let truth = Truth::new(meshes, &[], &Bottom::Level(0.0)).unwrap();
        truth.draw(&camera, &unlit, 2, 0).pixels[0]
    };
    let close = |a: [f32; 4], b: [f64; 4]| {
        (0..4).for_each(|c| assert!((f64::from(a[c]) - b[c]).abs() < 1e-6, "{a:?} is not {b:?}"));
    };
    let quarter = 0.5 * 127.0 / 255.0;
    let (red, green, blue) = (0.5 * 0.8, 0.5 * 0.25 * 0.8, 0.5 * 0.75 * quarter * 0.8);
    let left = 0.5 * 0.75 * (1.0 - quarter);
    close(
        draw(&meshes),
        [red + 0.1 * left, green + 0.1 * left, blue + 0.1 * left, 1.0],
    );
    close(draw(&meshes[..4]), [red, green, blue, 1.0 - left]);
    close(draw(&meshes[..1]), [0.0; 4]);
}

#[test]
fn pictures_are_the_same_far_from_the_origin() {
    let draw = |offset: DVec3| {
        let height = |x: f64, y: f64| 2.0 * (x * 0.7).sin() + (y * 0.5).cos() + offset.z;
        let layers = [layer(24, offset.truncate(), height)];
        let tower = square(8.0, 8.0, 14.0, 14.0, 6.0).map(|t| t.map(|p| p + offset));
        let meshes = [mesh(&tower, material(GREY, None))];
        let truth = Truth::new(&meshes, &layers, &Bottom::Level(offset.z - 8.0)).unwrap();
        let eye = offset + dvec3(-9.0, -14.0, 13.0);
        let camera = Camera::look_at(eye, offset + dvec3(12.0, 12.0, 1.0), 55.0, 32, 24).unwrap();
        truth.draw(&camera, &RenderSettings::default(), 4, 1)
    };
    let here = draw(DVec3::ZERO);
    let covered = here.pixels.iter().filter(|p| p[3] == 1.0).count();
    assert!(covered > 150, "{covered}");
    for far in [1e6, 1e9] {
        let there = draw(dvec3(far, -far, 0.0));
        let differ = |(p, q): &(&[f32; 4], &[f32; 4])| (0..4).any(|c| (p[c] - q[c]).abs() > 1.0 / 255.0);
        let pairs = || here.pixels.iter().zip(&there.pixels);
        // A ray at a silhouette may pass on its other side: of 16 rays of a pixel.
        assert!(pairs().filter(differ).count() <= 2, "{far}");
        assert!(pairs().all(|(p, q)| (p[3] - q[3]).abs() < 0.07), "{far}");
    }
}

#[test]
fn a_seed_gives_one_picture_whatever_the_number_of_threads() {
    let layers = [layer(12, DVec2::ZERO, |x, y| (x * y * 0.1).sin())];
    let truth = Truth::new(&[], &layers, &Bottom::Level(-2.0)).unwrap();
    let camera = Camera::look_at(dvec3(-4.0, -5.0, 6.0), dvec3(6.0, 6.0, 0.0), 60.0, 16, 12).unwrap();
    let draw = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| truth.draw(&camera, &RenderSettings::default(), 3, seed))
    };
    assert_eq!(draw(1, 5), draw(3, 5));
    assert_ne!(draw(1, 5), draw(1, 6));
}
