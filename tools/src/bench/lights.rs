//! Suite `lights`: what it costs that surfaces hide the sun and the sky from each other, and how far from the truth it is.
//!
//! A village on hills under a low sun. Every picture is compared with the truth under the same lights; `psnr_without_db` is what the
//! picture without shadows and occlusion would have, so what the option gains.

use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::settings::{RenderSettings, sun_direction};
use brickfell_runtime::terrain::Terrain;
use glam::{DVec2, DVec3};
use serde_json::json;

use super::filter_scenes::village_scene;
use super::filters::build_scene;
use super::scenes::hill_height;
use super::{Row, Settings, caster, row};
use crate::build::Filter;
use crate::commands::CommandError;
use crate::metrics::compare;
use crate::picture_file::linear_over_sky;
use crate::report::per_ray;
use crate::truth::{Bottom, Truth};

const WIDTH: u32 = 400;
const HEIGHT: u32 = 300;
/// Azimuth and elevation of the sun, degrees.
const SUN: (f64, f64) = (235.0, 25.0);

fn views() -> Result<[(&'static str, Camera); 2], CommandError> {
    let at = |x: f64, y: f64, up: f64| {
        let p = DVec2::new(x, y);
        p.extend(hill_height(p) + up)
    };
    let look = |eye: DVec3, target: DVec3| Camera::look_at(eye, target, 60.0, WIDTH, HEIGHT);
    Ok([
        ("over", look(at(20.0, -25.0, 60.0), at(50.0, 50.0, 0.0))?),
        ("among", look(at(40.0, 22.0, 3.0), at(60.0, 60.0, 4.0))?),
    ])
}

/// Suite `lights`.
///
/// # Errors
/// If the scene cannot be built or drawn.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let scene = village_scene(settings.folder)?;
    let built = build_scene(settings.folder, &scene, Filter::default())?;
    let input = scene.load()?;
    let truth = Truth::new(&input.meshes, &input.layers, &Bottom::Boxes(built.boxes.clone()))?;
    let lights = |shadows, occlusion| RenderSettings {
        sun: sun_direction(SUN.0, SUN.1),
        shadows,
        occlusion,
        ..RenderSettings::default()
    };
    let (repetitions, rays) = if settings.quick { (3, 4) } else { (9, 8) };
    let store: Arc<dyn Store> = Arc::new(FolderStore::open(&built.folder)?);
    let mut rows = Vec::new();
    for (view, camera) in views()? {
        let all = [
            ("neither", lights(false, false)),
            ("shadows", lights(true, false)),
            ("occlusion", lights(false, true)),
            ("both", lights(true, true)),
        ];
        let truths = all
            .iter()
            .map(|(_, render)| Ok(linear_over_sky(&truth.render(&camera, render, rays, 0)?, &camera)))
            .collect::<Result<Vec<_>, CommandError>>()?;
        for device in caster::devices(settings)? {
            let mut renderer = caster::renderer(device, Arc::clone(&store), Terrain::open(&store)?)?;
            let mut plain = None;
            for ((name, render), truth) in all.iter().zip(&truths) {
                let (ms, counters) = caster::measure(&mut renderer, &camera, render, repetitions)?;
                let picture = linear_over_sky(&renderer.read_picture()?, &camera);
                let (errors, _) = compare(&picture, truth)?;
                let (first_ms, without) = plain.get_or_insert((ms, picture));
                rows.push(row(json!({
                    "scene": scene.name,
                    "view": view,
                    "lights": name,
                    "backend": renderer.backend(),
                    "width": WIDTH,
                    "height": HEIGHT,
                    "ms_median": ms,
                    "ms_ratio": ms / *first_ms,
                    "nodes_per_ray": per_ray(counters.nodes, &counters),
                    "samples_per_ray": per_ray(counters.samples, &counters),
                    "psnr_db": errors.psnr,
                    "flip": errors.flip,
                    "psnr_without_db": compare(without, truth)?.0.psnr,
                }))?);
            }
        }
    }
    Ok(rows)
}
