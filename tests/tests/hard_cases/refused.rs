//! What cannot be drawn is refused with an error by both casters, or left out of the scene; nothing panics.

use std::sync::Arc;

use brickfell_formats::{octree_binary, octree_xml};
use brickfell_pager::{MemoryStore, Store as _};
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::reference::{Reference, ReferenceError};
use brickfell_runtime::renderer::RendererConfig;
use brickfell_runtime::terrain::{SCENE_FILE, Terrain};
use brickfell_tests::trees::Store;

use super::*;

#[test]
fn cameras_and_settings_without_a_picture() {
    exactly("refused::cameras_and_settings_without_a_picture", || {
        let world = neighbours().finish();
        let mut renderer = world.renderer_within(SMALL_POOL);
        let reference = Reference::new(Arc::clone(&world.store), &world.trees).unwrap();
        let good = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 8, 6);
        let plain = RenderSettings::default();
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let mut refused = |what: &str, camera: Camera, settings: RenderSettings| {
            let gpu = [
                renderer.frame(&camera, &settings).map(|_| ()),
                renderer.settle(&camera, &settings).map(|_| ()),
            ];
            for result in gpu {
                assert!(
                    matches!(result, Err(RuntimeError::Argument(_))),
                    "GPU, {what}: {result:?}"
                );
            }
            let result = reference.render(&camera, &settings);
            assert!(
                matches!(result, Err(ReferenceError::Argument(_))),
                "reference, {what}"
            );
        };
        for bad in [nan, inf, -inf] {
            refused(
                "eye",
                Camera {
                    eye: DVec3::new(0.0, bad, 0.0),
                    ..good
                },
                plain,
            );
            refused(
                "forward",
                Camera {
                    forward: DVec3::new(bad, 0.0, 0.0),
                    ..good
                },
                plain,
            );
            refused(
                "right",
                Camera {
                    right: DVec3::splat(bad),
                    ..good
                },
                plain,
            );
            refused(
                "up",
                Camera {
                    up: DVec3::splat(bad),
                    ..good
                },
                plain,
            );
            refused("field of view", Camera { fov_y: bad, ..good }, plain);
            refused("bias", good, RenderSettings { bias: bad, ..plain });
            for target_ms in [bad, 0.0, -1.0] {
                let timed = RenderSettings {
                    target_ms: Some(target_ms),
                    ..plain
                };
                refused("time", good, timed);
            }
            refused(
                "sun",
                good,
                RenderSettings {
                    sun: DVec3::splat(bad),
                    ..plain
                },
            );
            refused(
                "ambient",
                good,
                RenderSettings {
                    ambient: bad,
                    ..plain
                },
            );
            refused(
                "diffuse",
                good,
                RenderSettings {
                    diffuse: bad,
                    ..plain
                },
            );
        }
        refused("no angle", Camera { fov_y: 0.0, ..good }, plain);
        refused("no column", Camera { width: 0, ..good }, plain);
        refused("no row", Camera { height: 0, ..good }, plain);
        refused("bias beyond f64", good, biased(1e9));
        // The renderer goes on, and numbers that are only large are drawn.
        let cpu = world.cpu_renderer_within(SMALL_POOL);
        let mut stage = Stage { world, renderer, cpu };
        assert!(covered(&stage.close("good", &good).gpu) > 0);
        for far in [1e12, 1e30, 1e300] {
            let eye = DVec3::new(far, -far, far);
            let camera = Camera { eye, ..good };
            let both = stage.close(&format!("from {far} m"), &camera);
            assert_eq!(covered(&both.gpu) + covered(&both.reference), 0, "from {far} m");
        }
    });
}

/// Gives the last attribute of this name another value.
fn with(text: &str, attribute: &str, value: &str) -> String {
    let start = text.rfind(&format!(" {attribute}=\"")).unwrap() + attribute.len() + 3;
    let end = start + text[start..].find('"').unwrap();
    format!("{}{value}{}", &text[..start], &text[end..])
}

/// A tree file as XML, and its entry in a scene.
fn tree_and_entry(name: &str, x: u32) -> (String, String) {
    let mut trees = Store::default();
    let tree = header(DVec3::new(f64::from(x), 0.0, 0.0), 1.0, 1, Centre, 1);
    let kind = |level, _| match level {
        0 => Kind::Inner([90, 80, 70, 255]),
        _ => Kind::Leaf([90, 80, 70, 255]),
    };
    trees.add(name, tree, kind, |_, _| Default::default());
    let bytes = trees
        .0
        .read(name, 0, trees.0.len(name).unwrap() as usize)
        .unwrap();
    let entry = format!(
        "<PagedOctTree TreeFile=\"{name}\" CenterX=\"{}\" CenterY=\"8\" CenterZ=\"8\" Radius=\"14\" \
         MinX=\"{x}\" MinY=\"0\" MinZ=\"0\" MaxX=\"{}\" MaxY=\"16\" MaxZ=\"16\"/>\n",
        x + 8,
        x + 16
    );
    (
        octree_xml::encode(&octree_binary::decode(&bytes).unwrap()).unwrap(),
        entry,
    )
}

#[test]
fn numbers_in_files_that_are_no_sizes() {
    exactly("refused::numbers_in_files_that_are_no_sizes", || {
        let camera = look(DVec3::new(-12.0, -20.0, 30.0), DVec3::new(1.0, 1.0, -0.9), 32, 24);
        let settings = RenderSettings::default();
        let numbers = ["NaN", "inf", "-inf", "0", "-1", "1e300", "", "x"];
        let store = Arc::new(MemoryStore::default());
        let (good, good_entry) = tree_and_entry("good.oct", 0);
        store.put("good.oct", good.into_bytes());
        let open = |name: &str| Reference::new(Arc::clone(&store) as _, &[name.to_owned()]);
        let (expected, _) = open("good.oct").unwrap().render(&camera, &settings).unwrap();
        assert!(covered(&expected) > 100);
        // Settles with the scene and expects one fault for each of its trees but the good one.
        let draw = |entries: &str, faulty: &str, count: usize| {
            let scene = format!("<OctTreeGroup Version=\"1\">\n{good_entry}{entries}</OctTreeGroup>\n");
            store.put(SCENE_FILE, scene.into_bytes());
            let store: Arc<dyn brickfell_pager::Store> = Arc::clone(&store) as _;
            let config = RendererConfig {
                gpu_budget: 1 << 20,
                ..Default::default()
            };
            let terrain = Terrain::open(&store).unwrap();
            let mut renderer = Renderer::new(world::gpu(), store, terrain, config).unwrap();
            renderer.settle(&camera, &settings).unwrap();
            let faults = renderer.faults();
            assert_eq!(faults.len(), count, "{faults:?}");
            assert!(faults.iter().all(|f| f.contains(faulty)), "{faults:?}");
            let found = compare(&renderer.read_picture().unwrap(), &expected, CLOSE);
            assert_eq!(found.beyond, 0, "{entries}: {found:?}");
        };

        let mut entries = String::new();
        let mut count = 0;
        for (attribute, values) in [
            ("X", &numbers[..3]),
            ("DeltaY", &numbers),
            ("VolumeZSize", &numbers),
            ("BrickXSize", &numbers),
            ("Gain", &numbers),
        ] {
            for value in values {
                let name = format!("bad{count}.oct");
                let (tree, entry) = tree_and_entry(&name, 16);
                store.put(&name, tree.clone().into_bytes());
                assert!(open(&name).is_ok());
                store.put(&name, with(&tree, attribute, value).into_bytes());
                let said = open(&name).err().map(|e| e.to_string());
                let said = said.unwrap_or_else(|| panic!("{attribute} = {value} is read"));
                assert!(
                    said.starts_with(&format!("memory:{name}: ")),
                    "{attribute} = {value}: {said}"
                );
                entries += &entry;
                count += 1;
            }
        }
        draw(&entries, "memory:bad", count);

        let (_, entry) = tree_and_entry("good.oct", 16);
        for (attribute, values) in [
            ("MinX", &numbers[..3]),
            ("MaxY", &["NaN", "-1"]),
            ("Radius", &numbers[..3]),
        ] {
            for value in values {
                draw(&with(&entry, attribute, value), SCENE_FILE, 1);
            }
        }
    });
}

#[test]
fn a_device_of_an_application_that_has_too_little() {
    exactly("refused::a_device_of_an_application_that_has_too_little", || {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
        let open = |required_limits: wgpu::Limits| {
            let descriptor = wgpu::DeviceDescriptor {
                required_limits,
                ..Default::default()
            };
            let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
            Gpu::from_parts(device, queue)
        };
        let error = open(wgpu::Limits::default()).unwrap_err().to_string();
        assert!(error.contains("storage buffers"), "{error}");
        // With what is asked for and nothing else it draws the same, and says what goes wrong once it is asked to watch.
        let gpu = Arc::new(open(Gpu::limits(wgpu::Limits::default())).unwrap());
        let world = neighbours().finish();
        let config = RendererConfig {
            gpu_budget: SMALL_POOL,
            ..RendererConfig::default()
        };
        let terrain = Terrain::open(&world.store).unwrap();
        let mut renderer = Renderer::new(gpu.clone(), Arc::clone(&world.store), terrain, config).unwrap();
        let camera = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 40, 30);
        let settings = RenderSettings::default();
        let (own, _) = settled(&mut renderer, &camera, &settings);
        let (opened, _) = settled(&mut world.renderer_within(SMALL_POOL), &camera, &settings);
        assert_eq!(own, opened);
        gpu.watch();
        let _refused = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 3,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
        assert!(matches!(
            renderer.frame(&camera, &settings),
            Err(RuntimeError::Device(_))
        ));
    });
}
