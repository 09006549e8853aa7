//! Scenes on which filters differ, written as a user's input would be: walls, leaves, hills with buildings.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use image::{ImageBuffer, Rgba};

use super::scenes::{HILLS_SIZE, hill_height, hills_input};
use crate::commands::CommandError;
use crate::input::{HeightInput, HeightOptions, Inputs, RasterCache, UpAxis};
use crate::noise::Random;

/// Finest voxel of the small scenes, metres.
const VOXEL: f64 = 0.1;

/// A scene to be built and looked at.
pub(super) struct FilterScene {
    pub(super) name: &'static str,
    pub(super) meshes: Vec<PathBuf>,
    pub(super) heights: Vec<HeightInput>,
    /// Finest voxel, metres.
    pub(super) voxel: f64,
    pub(super) tree_voxels: u32,
    /// What is looked at: middle and greatest extent, metres.
    pub(super) middle: DVec3,
    pub(super) extent: f64,
    /// Where it is looked at from: degrees from east towards north, and above the horizon.
    pub(super) views: &'static [(f64, f64)],
}

/// An OBJ file in the making.
#[derive(Default)]
struct Obj {
    text: String,
    vertices: usize,
}

impl Obj {
    fn material(&mut self, name: &str) {
        let _ = writeln!(self.text, "usemtl {name}");
    }

    /// A parallelogram, texture coordinates 0..1 along its edges; front where `u × v` points.
    fn quad(&mut self, corner: DVec3, u: DVec3, v: DVec3) {
        for p in [corner, corner + u, corner + u + v, corner + v] {
            let _ = writeln!(self.text, "v {:.6} {:.6} {:.6}", p.x, p.y, p.z);
        }
        self.text += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
        let [a, b, c, d] = [1, 2, 3, 4].map(|k| self.vertices + k);
        let _ = writeln!(self.text, "f {a}/{a} {b}/{b} {c}/{c} {d}/{d}");
        self.vertices += 4;
    }

    /// A box, its faces to the outside.
    fn cuboid(&mut self, lo: DVec3, size: DVec3) {
        let hi = lo + size;
        let [x, y, z] = [DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z];
        for (corner, u, v) in [
            (lo, y, x),
            (lo, x, z),
            (lo, z, y),
            (hi, -x, -y),
            (hi, -z, -x),
            (hi, -y, -z),
        ] {
            self.quad(corner, u, v);
        }
    }

    fn write(&self, path: &Path) -> Result<PathBuf, CommandError> {
        fs::write(path, format!("mtllib materials.mtl\n{}", self.text))?;
        Ok(path.to_path_buf())
    }
}

/// A leaf's outline in a square: pointed at both ends, some 0.4 of it.
fn leaf(x: f64, y: f64) -> bool {
    (y - 0.5).abs() < 0.34 * (std::f64::consts::PI * x).sin()
}

fn write_materials(folder: &Path) -> Result<(), CommandError> {
    // Three twigs of leaves to a card.
    let picture = ImageBuffer::from_fn(64, 64, |x, y| {
        let (u, v) = (f64::from(x) / 64.0, f64::from(y) / 64.0);
        let (cell_x, cell_y) = ((u * 2.0).fract(), (v * 3.0).fract());
        let shade = 0.8 + 0.2 * u;
        let green = [50.0, 110.0, 30.0].map(|c| (c * shade) as u8);
        let alpha = if leaf(cell_x, cell_y) { 255 } else { 0 };
        Rgba([green[0], green[1], green[2], alpha])
    });
    picture.save(folder.join("leaf.png")).map_err(io::Error::other)?;
    let plain = |name: &str, [r, g, b]: [f64; 3]| format!("newmtl {name}\nKd {r} {g} {b}\n");
    let text = plain("red", [0.8, 0.05, 0.05])
        + &plain("green", [0.05, 0.7, 0.1])
        + &plain("stone", [0.6, 0.57, 0.5])
        + &plain("roof", [0.5, 0.2, 0.12])
        + &plain("bark", [0.3, 0.2, 0.12])
        + "newmtl leaf\nKd 1 1 1\nmap_Kd leaf.png\nmap_d leaf.png\n";
    fs::write(folder.join("materials.mtl"), text)?;
    Ok(())
}

/// A wall of one voxel's thickness, off the lattice.
fn wall() -> Obj {
    let mut obj = Obj::default();
    obj.material("stone");
    obj.cuboid(DVec3::new(0.53, 6.23, 0.57), DVec3::new(11.6, VOXEL, 8.0));
    obj
}

/// A red sheet to the south and a green one to the north, a voxel apart.
fn two_walls() -> Obj {
    let mut obj = Obj::default();
    let (x, z) = (DVec3::X * 11.6, DVec3::Z * 8.0);
    obj.material("red");
    obj.quad(DVec3::new(0.53, 6.23, 0.57), x, z);
    obj.material("green");
    obj.quad(DVec3::new(0.53, 6.23 + VOXEL, 0.57), z, x);
    obj
}

/// Crowns of leaf cards on trunks.
fn add_tree(obj: &mut Obj, random: &mut Random, foot: DVec3, radius: f64, cards: usize) {
    let height = 2.2 * radius;
    obj.material("bark");
    obj.cuboid(
        foot - DVec3::new(0.12, 0.12, 0.5),
        DVec3::new(0.24, 0.24, height + 0.5),
    );
    obj.material("leaf");
    let mut done = 0;
    while done < cards {
        let mut point = || {
            DVec3::new(
                random.between(-1.0, 1.0),
                random.between(-1.0, 1.0),
                random.between(-1.0, 1.0),
            )
        };
        let (p, a, b) = (point(), point(), point());
        if p.length() > 1.0 || a.length() < 0.2 || a.cross(b).length() < 0.05 {
            continue;
        }
        let size = 0.22 * radius;
        let u = a.normalize() * size;
        let v = a.cross(b).normalize() * size;
        obj.quad(foot + DVec3::Z * height + p * radius - 0.5 * (u + v), u, v);
        done += 1;
    }
}

fn foliage() -> Obj {
    let mut obj = Obj::default();
    let mut random = Random::new(11);
    for (x, y, radius, cards) in [(3.1, 3.3, 2.4, 700), (8.6, 4.1, 2.0, 260), (5.7, 9.2, 2.6, 120)] {
        add_tree(&mut obj, &mut random, DVec3::new(x, y, 0.6), radius, cards);
    }
    obj
}

/// Houses with saddle roofs, thin walls and trees on the hills.
fn village() -> Obj {
    let mut obj = Obj::default();
    let mut random = Random::new(5);
    for k in 0..60 {
        let at = DVec2::new(random.between(8.0, 90.0), random.between(8.0, 90.0));
        let foot = at.extend(hill_height(at));
        match k % 3 {
            0 => {
                let size = DVec3::new(
                    random.between(4.0, 8.0),
                    random.between(4.0, 6.0),
                    random.between(3.0, 6.0),
                );
                obj.material("stone");
                obj.cuboid(foot - DVec3::Z, size + DVec3::Z);
                obj.material("roof");
                let (eaves, rise) = (foot + DVec3::new(-0.4, -0.4, size.z), 0.4 * size.y);
                let (along, half) = (DVec3::X * (size.x + 0.8), 0.5 * size.y + 0.4);
                obj.quad(eaves, along, DVec3::new(0.0, half, rise));
                obj.quad(eaves + DVec3::Y * 2.0 * half, DVec3::new(0.0, -half, rise), along);
            }
            1 => {
                let long = random.between(5.0, 14.0);
                let size = if k % 2 == 0 {
                    DVec3::new(long, 0.2, 2.2)
                } else {
                    DVec3::new(0.2, long, 2.2)
                };
                obj.material("stone");
                obj.cuboid(foot - DVec3::Z * 3.0, size + DVec3::Z * 3.0);
            }
            _ => add_tree(&mut obj, &mut random, foot, random_radius(k), 160),
        }
    }
    obj
}

fn random_radius(k: usize) -> f64 {
    1.4 + 0.1 * (k % 13) as f64
}

/// Writes all scenes' inputs below a folder.
pub(super) fn scenes(folder: &Path) -> Result<Vec<FilterScene>, CommandError> {
    let input = input_folder(folder)?;
    let small = |name, mesh: PathBuf, views| FilterScene {
        name,
        meshes: vec![mesh],
        heights: Vec::new(),
        voxel: VOXEL,
        tree_voxels: 256,
        middle: DVec3::new(6.3, 6.2, 4.5),
        extent: 13.0,
        views,
    };
    let wall = wall().write(&input.join("wall.obj"))?;
    let two_walls = two_walls().write(&input.join("two_walls.obj"))?;
    let foliage = foliage().write(&input.join("foliage.obj"))?;
    Ok(vec![
        small("wall edge-on", wall.clone(), &[(0.5, 4.0), (181.0, 20.0)]),
        small("wall oblique", wall.clone(), &[(-20.0, 10.0), (150.0, 35.0)]),
        small("wall face-on", wall, &[(-88.0, 5.0), (75.0, 20.0)]),
        small("two walls", two_walls, &[(-85.0, 10.0), (95.0, 10.0)]),
        small("foliage", foliage, &[(-60.0, 10.0), (30.0, 35.0)]),
        village_scene(folder)?,
    ])
}

/// A folder for the input below another one, with the materials in it.
fn input_folder(folder: &Path) -> Result<PathBuf, CommandError> {
    let input = folder.join("filters-input");
    fs::create_dir_all(&input)?;
    write_materials(&input)?;
    Ok(input)
}

/// Writes the input of a village on hills below a folder.
pub(super) fn village_scene(folder: &Path) -> Result<FilterScene, CommandError> {
    let input = input_folder(folder)?;
    let middle = DVec2::splat(0.5 * HILLS_SIZE);
    Ok(FilterScene {
        name: "village on hills",
        meshes: vec![village().write(&input.join("village.obj"))?],
        heights: vec![hills_input(folder)?],
        voxel: HILLS_SIZE / 512.0,
        tree_voxels: 512,
        middle: middle.extend(hill_height(middle)),
        extent: HILLS_SIZE,
        views: &[(-65.0, 12.0), (120.0, 35.0)],
    })
}

impl FilterScene {
    /// The input, read.
    pub(super) fn load(&self) -> Result<Inputs, CommandError> {
        let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
        let options = HeightOptions::default();
        Ok(Inputs::load(
            &self.meshes,
            &[],
            &self.heights,
            UpAxis::Z,
            options,
            &cache,
        )?)
    }
}
