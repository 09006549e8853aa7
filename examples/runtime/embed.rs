//! Embeds the ray caster in an application that has a device of its own and draws polygons: both hide each other.
//!
//! 1. The application draws two towers into colour and depth.
//! 2. The renderer casts its rays, which end at the depths of the towers, and writes the depths of the ground.
//! 3. The application lays the ground's colour over its own and takes over its depth. Then it draws water, which the ground and
//!    the towers hide.
//!
//! `cargo run -p brickfell-runtime --example embed -- mixed.png`

#[path = "embed/polygons.rs"]
mod polygons;

use std::error::Error;
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_pager::{ProceduralConfig, ProceduralStore, Store};
use brickfell_runtime::depth::{DepthScale, DepthTexture, Depths};
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::present::Output;
use brickfell_runtime::renderer::{Renderer, RendererConfig};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::Terrain;
use glam::camera::rh::proj::directx::perspective_infinite_reverse;
use glam::camera::rh::view::look_to_mat4;
use glam::{Vec3, Vec4, dvec3};
use polygons::{Layer, Mesh, Polygons};

type Failure = Box<dyn Error>;

/// The application's device, opened so that the ray caster can use it, too.
fn open_device() -> Result<(wgpu::Device, wgpu::Queue), Failure> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default()))?;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("the application's"),
        required_features: Gpu::features(adapter.features()),
        required_limits: Gpu::limits(adapter.limits()),
        ..Default::default()
    };
    Ok(pollster::block_on(adapter.request_device(&descriptor))?)
}

/// Draws the picture: bytes in sRGB with alpha, row after row.
fn draw(width: u32, height: u32) -> Result<Vec<u8>, Failure> {
    let (device, queue) = open_device()?;
    // Ground that is made from a seed, a kilometre of it; any store does, for instance a `FolderStore`.
    let ground = ProceduralStore::new(ProceduralConfig {
        seed: 6,
        extent: 1024.0,
        depth: Some(5),
        ..Default::default()
    })?;
    // Over a bay; one tower stands in it, the other behind a hill.
    let eye = dvec3(330.0, 40.0, 16.0);
    let camera = Camera::look_at(eye, dvec3(345.0, 450.0, 6.0), 45.0, width, height)?;
    let on_ground = |x: f64, y: f64| dvec3(x, y, ground.highest_ground(x, y, 1.0).unwrap_or_default());
    let towers = [
        (on_ground(305.0, 122.0), 8.0, Vec4::new(0.7, 0.1, 0.05, 1.0)),
        (on_ground(362.0, 690.0), 20.0, Vec4::new(0.8, 0.7, 0.5, 1.0)),
    ];

    // The same camera as a matrix. The world is larger than f32 is fine, so polygons are told relative to the eye.
    let projection = perspective_infinite_reverse(camera.fov_y as f32, width as f32 / height as f32, 0.1);
    let view = look_to_mat4(Vec3::ZERO, camera.forward.as_vec3(), camera.up.as_vec3());
    let scale = DepthScale::of_projection(&projection.to_cols_array_2d())?;
    let mut stone = Mesh::default();
    for (foot, side, color) in towers {
        let low = (foot - eye).as_vec3();
        stone.add_box(low, low + side * Vec3::new(1.0, 1.0, 3.0), color);
    }
    let mut water = Mesh::default();
    let low = (dvec3(0.0, 0.0, -6.0) - eye).as_vec3();
    let deep = Vec4::new(0.02, 0.1, 0.2, 0.7);
    water.add_top(low, low + 1024.0 * Vec3::new(1.0, 1.0, 0.0), deep);
    let polygons = Polygons::new(&device, &queue, [width, height], projection * view);

    let store: Arc<dyn Store> = Arc::new(ground);
    let terrain = Terrain::open(&store)?;
    let gpu = Arc::new(Gpu::from_parts(device.clone(), queue.clone())?);
    let mut renderer = Renderer::new(gpu, store, terrain, RendererConfig::default())?;
    renderer.set_depths(Depths {
        until: Some(DepthTexture {
            view: polygons.depth.clone(),
            scale,
        }),
        written: true,
    });

    polygons.draw(&stone, true);
    // A frame of an application that moves is `renderer.frame`, which waits for nothing; this one waits until all is there.
    renderer.settle(&camera, &RenderSettings::default())?;
    let (Some(Output::Device(picture, _)), Some((depths, _))) = (renderer.output(), renderer.depth()) else {
        return Err("nothing was drawn".into());
    };
    polygons.lay_over(&Layer { picture, depths }, scale);
    polygons.draw(&water, false);
    polygons.read()
}

fn main() -> Result<(), Failure> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "mixed.png".into());
    let [width, height] = [960, 540];
    let mut encoder = png::Encoder::new(std::fs::File::create(&path)?, width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.write_header()?.write_image_data(&draw(width, height)?)?;
    println!("wrote {path}");
    Ok(())
}

#[test]
fn ground_towers_and_water_are_all_seen() -> Result<(), Failure> {
    let pixels = draw(160, 90)?;
    let count = |is: fn(i32, i32, i32) -> bool| {
        let rgb = pixels.chunks_exact(4).map(|p| [p[0], p[1], p[2]].map(i32::from));
        rgb.filter(|[r, g, b]| is(*r, *g, *b)).count()
    };
    let red = count(|r, g, _| r > 2 * g + 20);
    let green = count(|r, g, b| g > r && g > b);
    let blue = count(|r, g, b| b > g && g > r);
    // The foot of a tower, through the water.
    let purple = count(|r, g, b| r > g + 20 && b > g + 5);
    assert!(
        red > 100 && green > 1000 && blue > 500 && purple > 5,
        "{red}, {green}, {blue}, {purple}"
    );
    Ok(())
}
