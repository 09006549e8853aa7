//! Depths that rays and polygons exchange: where rays end, and where they have lost half of their light.

use brickfell_culler::Camera;
use brickfell_runtime::depth::{DepthScale, DepthTexture, Depths, NO_DEPTH};
use brickfell_runtime::picture::Picture;
use brickfell_runtime::reference::Reference;
use brickfell_runtime::terrain::Terrain;
use brickfell_tests::pictures::assert_alike;
use brickfell_tests::trees::{path_in_box, sample};
use brickfell_tests::world::gpu;

use super::*;

/// A texture of values, a row after the other.
fn texture(camera: &Camera, values: &[f32], scale: DepthScale) -> DepthTexture {
    let size = wgpu::Extent3d {
        width: camera.width,
        height: camera.height,
        depth_or_array_layers: 1,
    };
    let gpu = gpu();
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
    gpu.queue.write_texture(
        texture.as_image_copy(),
        &bytes,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(camera.width * 4),
            rows_per_image: None,
        },
        size,
    );
    DepthTexture {
        view: texture.create_view(&Default::default()),
        scale,
    }
}

/// The settled picture of rays that end at these depths.
fn cut(world: &World, camera: &Camera, until: &[f32], scale: DepthScale) -> Picture {
    let mut renderer = world.renderer_within(SMALL_POOL);
    let values: Vec<f32> = until.iter().map(|depth| scale.value(*depth)).collect();
    renderer.set_depths(Depths {
        until: Some(texture(camera, &values, scale)),
        written: false,
    });
    settled(&mut renderer, camera, &RenderSettings::default()).0
}

fn reference(world: &World) -> Reference {
    let terrain = Terrain::open(&world.store).unwrap();
    Reference::open(world.store.clone(), &terrain.scene).unwrap()
}

fn pixels(camera: &Camera) -> impl Iterator<Item = [f64; 2]> + use<> {
    let [width, height] = [camera.width, camera.height];
    (0..height).flat_map(move |y| (0..width).map(move |x| [f64::from(x), f64::from(y)]))
}

/// A reversed projection without a far plane, as the camera's.
fn projection(camera: &Camera) -> DepthScale {
    let aspect = camera.width as f32 / camera.height as f32;
    let columns =
        glam::camera::rh::proj::directx::perspective_infinite_reverse(camera.fov_y as f32, aspect, 0.1);
    DepthScale::of_projection(&columns.to_cols_array_2d()).unwrap()
}

#[test]
fn depths_say_where_half_of_the_light_is_lost() {
    exactly("depths::depths_say_where_half_of_the_light_is_lost", || {
        let world = neighbours().finish();
        let reference = reference(&world);
        let camera = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 72, 48);
        let settings = RenderSettings::default();
        let mut renderer = world.renderer_within(SMALL_POOL);
        let (plain, _) = settled(&mut renderer, &camera, &settings);
        assert!(renderer.depth().is_none() && renderer.read_depths().is_err());
        renderer.set_depths(Depths {
            written: true,
            ..Default::default()
        });
        let (picture, _) = settled(&mut renderer, &camera, &settings);
        assert_eq!(picture, plain, "depths do not change the picture");
        let (depths, size) = renderer.read_depths().unwrap();
        assert_eq!(size, [camera.width, camera.height]);
        let footprint = camera.pixel_size() * settings.bias.exp2();
        let (mut seen, mut near, mut clear) = (0, 0, 0);
        for (k, [x, y]) in pixels(&camera).enumerate() {
            if picture.pixels[k][3] < 0.49 {
                assert_eq!(depths[k], NO_DEPTH, "{x}, {y}");
                clear += 1;
            } else if picture.pixels[k][3] > 0.51 {
                let ray = camera.ray(x, y);
                let expected = reference.depth(camera.eye, ray, footprint).unwrap().unwrap();
                seen += 1;
                near += usize::from((f64::from(depths[k]) - expected).abs() < 0.25);
            }
        }
        println!("{near} of {seen} depths within a voxel, {clear} pixels clear");
        assert!(seen > 500 && clear > 500, "{seen}, {clear}");
        assert!(near * 100 >= seen * 99, "{near} of {seen}");
        renderer.set_depths(Depths::default());
        assert_eq!(settled(&mut renderer, &camera, &settings).0, plain);
        assert!(renderer.depth().is_none());
    });
}

#[test]
fn rays_end_at_the_depths_of_polygons() {
    exactly("depths::rays_end_at_the_depths_of_polygons", || {
        let world = neighbours().finish();
        let reference = reference(&world);
        let camera = look(DVec3::new(-24.0, -8.0, 14.0), DVec3::new(1.0, 0.7, -0.5), 64, 40);
        // Slanted walls, and every seventh pixel without one.
        let until: Vec<f32> = (pixels(&camera).enumerate())
            .map(|(k, [x, y])| match k % 7 {
                0 => NO_DEPTH,
                _ => (12.0 + 0.2 * x + 0.2 * y) as f32,
            })
            .collect();
        let settings = RenderSettings::default();
        let expected = Picture {
            width: camera.width,
            height: camera.height,
            pixels: (pixels(&camera).zip(&until))
                .map(|(pixel, depth)| {
                    let rgba = reference.cast_until(&camera, &settings, pixel, f64::from(*depth));
                    rgba.unwrap().map(|c| c as f32)
                })
                .collect(),
        };
        let whole = world.reference(&camera, &settings);
        let hidden = compare(&whole, &expected, BOUND).beyond;
        assert!(hidden > 200, "walls hide {hidden} pixels only");
        for scale in [DepthScale::METRES, projection(&camera)] {
            let picture = cut(&world, &camera, &until, scale);
            assert_alike(&format!("{scale:?}"), &picture, &expected, CLOSE);
        }
    });
}

#[test]
fn a_wall_hides_what_is_behind_it_and_nothing_before() {
    exactly(
        "depths::a_wall_hides_what_is_behind_it_and_nothing_before",
        || {
            let west = header(DVec3::new(-16.0, 0.0, 0.0), 1.0, 1, Centre, 2);
            let east = header(DVec3::new(0.0, 0.0, 0.0), 0.5, 2, Centre, 2);
            let alone = blob_tree(Maker::new(), west).finish();
            let both = blob_tree(blob_tree(Maker::new(), west), east).finish();
            let camera = look(DVec3::new(-40.0, 7.0, 9.0), DVec3::X, 48, 32);
            let settings = RenderSettings::default();
            let (front, _) = settled(&mut alone.renderer_within(SMALL_POOL), &camera, &settings);
            let mut renderer = both.renderer_within(SMALL_POOL);
            let wall = vec![40.0; front.pixels.len()];
            renderer.set_depths(Depths {
                until: Some(texture(&camera, &wall, DepthScale::METRES)),
                written: false,
            });
            let (walled, report) = settled(&mut renderer, &camera, &settings);
            assert_alike("wall between the trees", &walled, &front, SMOOTH);
            renderer.set_depths(Depths::default());
            let (open, open_report) = settled(&mut renderer, &camera, &settings);
            assert!(compare(&open, &front, BOUND).beyond > 50);
            assert!(
                report.bricks_resident < open_report.bricks_resident,
                "what the wall hides is not asked for: {report:?}, {open_report:?}"
            );
        },
    );
}

#[test]
fn a_wall_in_a_medium_leaves_the_opacity_before_it() {
    exactly("depths::a_wall_in_a_medium_leaves_the_opacity_before_it", || {
        let alpha = 40u8;
        let medium = [alpha, 0, 0, alpha];
        let camera = look(DVec3::new(-3.0, 3.0, 5.0), DVec3::new(1.0, 0.1, -0.1), 24, 24);
        for kind in [Kind::Leaf(medium), Kind::BrickLeaf] {
            let tree = header(DVec3::ZERO, 1.0, 0, Centre, 1);
            let world = Maker::new()
                .tree(tree, |_, _| kind, |_, _| sample(medium))
                .finish();
            for depth in [4.3f32, 7.0, 9.9] {
                let picture = cut(
                    &world,
                    &camera,
                    &vec![depth; picture_size(&camera)],
                    DepthScale::METRES,
                );
                let [lo, hi] = tree.bounds();
                let mut worst = 0f64;
                for (pixel, [x, y]) in picture.pixels.iter().zip(pixels(&camera)) {
                    let ray = camera.ray(x, y);
                    let all = path_in_box(camera.eye, ray, lo, hi);
                    let at = camera.eye + ray * f64::from(depth);
                    let behind = path_in_box(at, ray, lo, hi);
                    let through = (1.0 - f64::from(alpha) / 255.0).powf(all - behind);
                    worst = worst.max((1.0 - f64::from(pixel[3]) - through).abs());
                }
                assert!(worst < 1e-4, "{kind:?} until {depth}: off by {worst}");
            }
        }
    });
}

#[test]
fn fewer_pixels_end_at_the_depths_in_their_middles() {
    exactly("depths::fewer_pixels_end_at_the_depths_in_their_middles", || {
        let world = neighbours().finish();
        let mut renderer = world.renderer_within(SMALL_POOL);
        let camera = look(DVec3::new(-24.0, -8.0, 14.0), DVec3::new(1.0, 0.7, -0.5), 64, 40);
        let timed = RenderSettings {
            target_ms: Some(1e-3),
            ..RenderSettings::default()
        };
        let (open, _) = settled(&mut renderer, &camera, &timed);
        // A wall before the right half.
        let wall: Vec<f32> = pixels(&camera)
            .map(|[x, _]| if x < 32.0 { NO_DEPTH } else { 1.0 })
            .collect();
        renderer.set_depths(Depths {
            until: Some(texture(&camera, &wall, DepthScale::METRES)),
            written: true,
        });
        let mut report = None;
        for frame in 0..40 {
            let moved = Camera {
                eye: camera.eye + DVec3::X * (1e-3 * f64::from(frame)),
                ..camera
            };
            report = Some(renderer.frame(&moved, &timed).unwrap());
            renderer.wait().unwrap();
        }
        assert_eq!(report.unwrap().scale, 0.5);
        assert_eq!(renderer.read_depths().unwrap().1, [32, 20]);
        let picture = renderer.read_picture().unwrap();
        // Enlarged pixels reach two beyond the wall's edge.
        let seen = |picture: &Picture, columns: std::ops::Range<usize>| {
            let rows = picture.pixels.chunks_exact(64);
            let hit = rows.flat_map(|row| &row[columns.clone()]);
            hit.filter(|p| p[3] > 0.5).count()
        };
        let [left, right] = [0..30, 34..64].map(|columns| seen(&open, columns));
        assert!(left > 100 && right > 100, "{left}, {right}");
        assert_eq!(seen(&picture, 34..64), 0);
        assert!(seen(&picture, 0..30).abs_diff(left) * 5 < left, "{left}");
    });
}

fn picture_size(camera: &Camera) -> usize {
    camera.width as usize * camera.height as usize
}

#[test]
fn depths_that_cannot_be_exchanged_are_refused() {
    let world = neighbours().finish();
    let camera = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 40, 30);
    let small = look(camera.eye, camera.forward, 20, 30);
    let settings = RenderSettings::default();
    let until = texture(&small, &vec![1.0; picture_size(&small)], DepthScale::METRES);
    let depths = Depths {
        until: Some(until),
        written: true,
    };
    for (mut renderer, fits, expected) in [
        (world.renderer_within(SMALL_POOL), &small, "size of the picture"),
        (world.cpu_renderer_within(SMALL_POOL), &camera, "only a GPU"),
    ] {
        renderer.set_depths(depths.clone());
        let error = renderer.frame(&camera, &settings).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        renderer.set_depths(Depths::default());
        renderer.frame(fits, &settings).unwrap();
    }
}
