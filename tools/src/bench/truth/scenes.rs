//! What suite `truth` looks at: three scenes of the demo's files, or the user's own; views, and settings to compare.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use brickfell_culler::Camera;
use brickfell_formats::chunk::Encoding;
use brickfell_formats::layout::SampleLayout;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::settings::RenderSettings;
use brickfell_runtime::terrain::{Terrain, read_header};
use clap::ValueEnum;
use glam::{DVec2, DVec3};

use super::super::Settings;
use super::super::scenes::{build_demo, demo_input};
use crate::build::{BuildArgs, DEFAULT_LAYOUT, Filter};
use crate::commands::CommandError;
use crate::input::demo::DemoInput;
use crate::input::{HeightOptions, Inputs, RasterCache};
use crate::truth::{Bottom, Truth};

/// The one at which settings are compared: there are finer levels to be had, and coarser ones.
const SWEPT: u32 = 4;
/// Errors of databases that are looked at beside the exact one, in steps.
const ERRORS: [u8; 4] = [1, 2, 4, 8];
const FOV: f64 = 60.0;
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
/// Distances in those at which a finest voxel is as wide as a pixel.
const DISTANCES: [u32; 5] = [1, 2, 4, 16, 64];
/// Where views from above come from, seen from what they look at.
const FROM: DVec3 = DVec3::new(-0.5, -0.6, 0.62);
/// Height of the eye above ground in the view along it, and how far it looks down over the distance of 1×, in those.
const ALONG: [f64; 2] = [0.25, 0.2];

/// A scene: its database, the input that it was built from, and where to look.
pub(super) struct Scene {
    pub(super) name: String,
    pub(super) folder: PathBuf,
    pub(super) inputs: Inputs,
    /// Boxes of its trees, world.
    pub(super) boxes: Vec<[DVec3; 2]>,
    /// What is looked at, on the ground; world X and Y.
    over: DVec2,
    voxel: f64,
    /// What it was built from, if it is built in.
    source: Option<DemoInput>,
}

/// A view.
pub(super) struct View {
    pub(super) name: String,
    pub(super) camera: Camera,
    /// Settings are compared on this one.
    pub(super) swept: bool,
}

/// A database of a scene built otherwise.
pub(super) struct Variant {
    pub(super) name: String,
    pub(super) folder: PathBuf,
}

/// Settings that need nothing built anew.
pub(super) fn settings() -> Vec<(String, RenderSettings)> {
    let default = RenderSettings::default();
    let bias = [-1.25, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0]
        .map(|bias| (format!("bias {bias}"), RenderSettings { bias, ..default }));
    let step = [("step 1/2", -1), ("step 2", 1)]
        .map(|(name, step)| (name.into(), RenderSettings { step, ..default }));
    let fade = [
        ("nearest level", 0.0, default.bias),
        ("mixed everywhere", 1.0, default.bias),
        ("mixed everywhere, bias -0.5", 1.0, -0.5),
    ]
    .map(|(name, fade, bias)| {
        (
            name.into(),
            RenderSettings {
                bias,
                fade,
                ..default
            },
        )
    });
    bias.into_iter().chain(step).chain(fade).collect()
}

/// The same view with so many times the pixels per axis.
pub(super) fn scaled(camera: &Camera, name: String, scale: f64) -> Result<View, CommandError> {
    let [width, height] =
        [camera.width, camera.height].map(|n| (f64::from(n) * scale).round().max(1.0) as u32);
    let fov = 2.0
        * (0.5 * camera.pixel_size() * f64::from(camera.height))
            .atan()
            .to_degrees();
    let camera = Camera::look_at(camera.eye, camera.eye + camera.forward, fov, width, height)?;
    Ok(View {
        name,
        camera,
        swept: false,
    })
}

/// The scenes to look at: the user's own, or those built in.
pub(super) fn scenes(settings: &Settings<'_>) -> Result<Vec<Scene>, CommandError> {
    if let Some(own) = settings.own {
        let name = own.folder.file_name().unwrap_or(own.folder.as_os_str());
        return Ok(vec![Scene::new(
            name.to_string_lossy().into_owned(),
            own.folder.clone(),
            own.input.load()?,
            None,
        )?]);
    }
    let demo = demo_input(settings.folder)?;
    let only = |part: &str| DemoInput {
        meshes: (demo.meshes.iter())
            .filter(|m| m.file_stem().is_some_and(|s| s == part))
            .cloned()
            .collect(),
        ..demo.clone()
    };
    // The foot of the crag, a wood beside it, the middle of the village.
    [
        ("terrain", "", DVec2::new(128.0, 140.0)),
        ("foliage", "trees", DVec2::new(100.0, 180.0)),
        ("buildings", "buildings", DVec2::new(170.0, 75.0)),
    ]
    .into_iter()
    .map(|(name, part, over)| Scene::built_in(name, &only(part), settings.folder, over))
    .collect()
}

impl Scene {
    fn built_in(name: &str, input: &DemoInput, folder: &Path, over: DVec2) -> Result<Self, CommandError> {
        let out = folder.join(format!("truth-{name}"));
        build_demo(input, &out, |_| {})?;
        let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
        let inputs = Inputs::load(
            &input.meshes,
            &[],
            &[input.layer()],
            input.up,
            HeightOptions::default(),
            &cache,
        )?;
        let mut scene = Self::new(name.into(), out, inputs, Some(input.clone()))?;
        scene.over = over;
        Ok(scene)
    }

    fn new(
        name: String,
        folder: PathBuf,
        inputs: Inputs,
        source: Option<DemoInput>,
    ) -> Result<Self, CommandError> {
        let store: Arc<dyn Store> = Arc::new(FolderStore::open(&folder)?);
        let terrain = Terrain::open(&store)?;
        let headers = terrain
            .trees
            .iter()
            .map(|name| read_header(store.as_ref(), name))
            .collect::<Result<Vec<_>, _>>()?;
        let boxes: Vec<[DVec3; 2]> = headers.iter().map(|h| h.bounds()).collect();
        let lo = boxes.iter().fold(DVec3::INFINITY, |lo, b| lo.min(b[0]));
        let hi = boxes.iter().fold(DVec3::NEG_INFINITY, |hi, b| hi.max(b[1]));
        Ok(Self {
            name,
            folder,
            inputs,
            boxes,
            over: ((lo + hi) * 0.5).truncate(),
            voxel: headers.iter().map(|h| h.voxel_size).fold(f64::INFINITY, f64::min),
            source,
        })
    }

    /// The truth of its input.
    pub(super) fn truth(&self) -> Result<Truth<'_>, CommandError> {
        let bottom = Bottom::Boxes(self.boxes.clone());
        Ok(Truth::new(&self.inputs.meshes, &self.inputs.layers, &bottom)?)
    }

    /// The views; with `quick`, the swept one alone.
    pub(super) fn views(&self, truth: &Truth<'_>, quick: bool) -> Result<Vec<View>, CommandError> {
        let lo = self.boxes.iter().fold(DVec3::INFINITY, |lo, b| lo.min(b[0]));
        let hi = self.boxes.iter().fold(DVec3::NEG_INFINITY, |hi, b| hi.max(b[1]));
        let above = |p: DVec2| {
            let eye = p.extend(hi.z + 1.0);
            let depth = truth.depth(eye, DVec3::NEG_Z)?.ok_or_else(|| {
                CommandError::new(
                    format!("there is no ground at {p}, the middle of the scene"),
                    "is this the input that the database was built from?",
                )
            })?;
            Ok::<_, CommandError>(eye - DVec3::Z * depth)
        };
        let target = above(self.over)?;
        let pixel = 2.0 * (0.5 * FOV.to_radians()).tan() / f64::from(HEIGHT);
        let fits = self.voxel / pixel;
        let extent = (hi - lo).truncate().length();
        let mut views = Vec::new();
        for distance in DISTANCES {
            // No more sky than needed: small pictures have the same pixels.
            let wide = 1.2 * extent / (self.voxel * f64::from(distance));
            let width = (wide.clamp(16.0, f64::from(WIDTH)) as u32).next_multiple_of(4);
            let height = width * HEIGHT / WIDTH;
            let fov = 2.0 * (0.5 * f64::from(height) * pixel).atan().to_degrees();
            let eye = target + FROM.normalize() * fits * f64::from(distance);
            views.push(View {
                name: format!("{distance}x"),
                camera: Camera::look_at(eye, target, fov, width, height)?,
                swept: distance == SWEPT,
            });
        }
        let back = FROM.truncate().normalize() * fits;
        let eye = above(self.over + back).unwrap_or(target) + DVec3::Z * (ALONG[0] * fits);
        let ahead = (self.over).extend(eye.z - ALONG[1] * fits);
        views.push(View {
            name: "along".into(),
            camera: Camera::look_at(eye, ahead, FOV, WIDTH, HEIGHT)?,
            swept: false,
        });
        views.retain(|v| v.swept || !quick);
        Ok(views)
    }

    /// The scene built with other filters, the other layout, and block-compressed; nothing for a database that is only given.
    pub(super) fn variants(&self, settings: &Settings<'_>) -> Result<Vec<Variant>, CommandError> {
        let Some(input) = &self.source else {
            return Ok(Vec::new());
        };
        let other = match DEFAULT_LAYOUT {
            SampleLayout::Centre => SampleLayout::Corner,
            SampleLayout::Corner => SampleLayout::Centre,
        };
        let variant = |name: String, change: &dyn Fn(&mut BuildArgs)| {
            let folder = format!("truth-{}-{}", self.name, name.replace(' ', "-"));
            let folder = settings.folder.join(folder);
            build_demo(input, &folder, change)?;
            Ok(Variant { name, folder })
        };
        let layout = variant(format!("layout {other:?}").to_lowercase(), &|args| {
            args.layout = other
        });
        let compressed = variant("compressed".into(), &|args| args.encoding = Encoding::Blocks);
        let filters = (Filter::value_variants().iter())
            // Ground has no skins for a filter to judge.
            .filter(|filter| **filter != Filter::default() && !input.meshes.is_empty())
            .map(|filter| variant(format!("filter {}", filter.name()), &|args| args.filter = *filter));
        let errors = ERRORS.map(|error| variant(format!("error {error}"), &|args| args.error = error));
        [layout, compressed]
            .into_iter()
            .chain(filters)
            .chain(errors)
            .collect()
    }
}
