//! Tests of whole builds: what they share, and one module a topic.

mod exact;
mod filters;
mod folder;
mod memory;
mod opacity;
mod seams;

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use glam::{DVec2, DVec3, UVec3, Vec2};

use brickfell_formats::octree::{NodeData, Octree};
use brickfell_formats::scene::Scene;
use brickfell_formats::value::SOLID_ALPHA;
use brickfell_formats::{bricks, octree_binary};

use super::lattice::Lattice;
use super::nodes::node_cube;
use super::*;
use crate::input::Inputs;
use crate::input::georef::Placement;
use crate::input::{GeoTransform, Georef, HeightMap, Imagery, Material, Mesh, Raster, Texture, Triangle};

/// A stored sample: colour, normal, and opacities against the axes (the alpha where they are not told apart).
pub(crate) type Value = ([u8; 4], [i8; 3], [u8; 3]);

/// A height map of n × n pixels of a size with its low corner at a point; `height` is asked at pixel centres (metres).
pub(crate) fn layer(n: u32, pixel: f64, corner: DVec2, height: impl Fn(f64, f64) -> f64) -> Layer {
    let transform = GeoTransform::north_up(corner, pixel, n);
    let georef = Georef {
        transform,
        crs: None,
        linear_unit_metres: 1.0,
        vertical_unit_metres: None,
        geographic: false,
    };
    let center = |c: u32, r: u32| transform.at(DVec2::new(f64::from(c) + 0.5, f64::from(r) + 0.5));
    let data = (0..n).flat_map(|r| (0..n).map(move |c| (c, r))).map(|(c, r)| {
        let p = center(c, r);
        height(p.x, p.y) as f32
    });
    let map = HeightMap::new(Path::new("test"), (n, n), data.collect(), georef).unwrap();
    Layer { map, imagery: None }
}

/// Lays a picture over a layer, one pixel a height.
pub(crate) fn painted(mut layer: Layer, color: impl Fn(u32, u32) -> [u8; 3]) -> Layer {
    let (width, height) = (layer.map.width, layer.map.height);
    let pixels = (0..height)
        .flat_map(|r| (0..width).map(move |c| (c, r)))
        .map(|(c, r)| {
            let [r, g, b] = color(c, r);
            [r, g, b, 255]
        });
    let raster = Raster {
        width,
        height,
        pixels: pixels.collect(),
    };
    layer.imagery =
        Some(Imagery::place(Path::new("test"), raster, Placement::default(), &layer.map).unwrap());
    layer
}

/// A parallelogram with texture coordinates 0..1 along its edges.
pub(crate) fn sheet(corner: DVec3, u: DVec3, v: DVec3, texture: Option<Raster>) -> Mesh {
    let texture = texture.map(|t| std::sync::Arc::new(Texture::of(t)));
    let cutout = texture.as_ref().is_some_and(|t| t.has_alpha());
    let uv = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    let triangle = |v: [u32; 3]| Triangle {
        v,
        uv: v.map(|i| uv[i as usize]),
        n: None,
        material: 0,
    };
    Mesh {
        positions: vec![corner, corner + u, corner + u + v, corner + v],
        triangles: vec![triangle([0, 1, 2]), triangle([0, 2, 3])],
        materials: vec![Material {
            name: String::new(),
            color: [1.0, 0.5, 0.25, 1.0],
            texture,
            cutout,
        }],
        ..Mesh::default()
    }
}

/// Builds into a folder.
pub(crate) fn build_into(
    out: &Path,
    inputs: &Inputs,
    voxel: f64,
    tree: u32,
    layout: SampleLayout,
) -> BuildReport {
    build_filtered(out, inputs, voxel, tree, layout, Filter::default())
}

/// The faces of meshes.
pub(crate) fn bins(inputs: &Inputs, lattice: Lattice) -> Bins {
    let mut bins = Bins::new(lattice, Path::new(""), usize::MAX);
    for mesh in &inputs.meshes {
        bins.add_mesh(mesh).unwrap();
    }
    bins
}

/// Builds into a folder with a filter.
pub(crate) fn build_filtered(
    out: &Path,
    inputs: &Inputs,
    voxel: f64,
    tree: u32,
    layout: SampleLayout,
    filter: Filter,
) -> BuildReport {
    let args = BuildArgs {
        tree_voxels: tree,
        layout,
        filter,
        ..BuildArgs::new(out)
    };
    let lattice = Lattice {
        voxel,
        depth: (tree / 8).ilog2() as u8,
        layout,
    };
    build_from(
        &args,
        lattice,
        &inputs.layers,
        &bins(inputs, lattice),
        Default::default(),
        &Silent,
    )
    .unwrap()
}

/// A database as it lies on disk: every stored sample by mip and place on the lattice, constants expanded. Nothing is
/// kept of empty constants.
pub(crate) struct Db {
    pub(crate) lattice: Lattice,
    pub(crate) samples: HashMap<(u8, [i64; 3]), Value>,
    pub(crate) surface_voxels: u64,
    pub(crate) constants: usize,
    pub(crate) trees: usize,
}

impl Db {
    /// Reads a folder; samples that are stored several times must agree.
    pub(crate) fn read(out: &Path, lattice: Lattice) -> Self {
        let scene = Scene::parse(&fs::read(out.join(SCENE)).unwrap()).unwrap();
        let mut db = Db {
            lattice,
            samples: HashMap::new(),
            surface_voxels: 0,
            constants: 0,
            trees: 0,
        };
        for tree in scene.trees() {
            let path = out.join(&tree.tree_file);
            let octree = octree_binary::decode(&fs::read(&path).unwrap()).unwrap();
            let ([min, max], drawn) = (octree.header.bounds(), tree.bounds.unwrap());
            assert!(
                drawn.min.cmpge(min).all() && drawn.max.cmple(max).all() && drawn.min.cmplt(drawn.max).all()
            );
            db.trees += 1;
            db.surface_voxels += octree.header.surface_voxels;
            db.add(&octree, &path);
        }
        db
    }

    fn add(&mut self, tree: &Octree, path: &Path) {
        let origin = (tree.header.origin / self.lattice.voxel)
            .round()
            .to_array()
            .map(|v| v as i64);
        let place = lattice::TreePlace { origin };
        for level in 0..=self.lattice.depth {
            let mut file = Vec::new();
            let name = path.with_file_name(bricks::brick_file_name("tree.oct", level));
            let index = (tree.brick_count(level) > 0).then(|| {
                file = fs::read(name).unwrap();
                let header = bricks::decode_header(&file, file.len() as u64).unwrap();
                let range = header.directory();
                header
                    .decode_directory(&file[range.start as usize..range.end as usize])
                    .unwrap()
            });
            for (node, p) in tree.levels[usize::from(level)].iter().zip(tree.positions(level)) {
                match node.data() {
                    NodeData::Brick(brick) => {
                        let index = index.as_ref().unwrap();
                        let (chunk, k) = index.locate(brick).unwrap();
                        let entry = index.chunks[chunk as usize];
                        let payload = &file[entry.offset as usize..][..entry.length as usize];
                        let chunk = index.decode_chunk(chunk, payload).unwrap();
                        let (color, normal) = (chunk.brick_color(k as usize), chunk.brick_normal(k as usize));
                        let opacity = chunk.brick_opacity(k as usize);
                        let values = (0..color.len()).map(|i| {
                            let ([.., a], [nx, ny, nz, _]) = (color[i], normal[i]);
                            let axes = opacity.map_or([a; 3], |o| [o[i][0], o[i][1], o[i][2]]);
                            assert_eq!(axes.iter().max(), Some(&a));
                            (color[i], [nx, ny, nz], axes)
                        });
                        self.put(place, level, p, values.collect());
                    }
                    NodeData::Constant(color) => {
                        assert!(node.children().is_none());
                        self.constants += 1;
                        if color == [0; 4] {
                            continue;
                        }
                        for finer in level..=self.lattice.depth {
                            let n = 1 << (finer - level);
                            for k in 0..n * n * n {
                                let child = p * n + UVec3::new(k % n, k / n % n, k / n / n);
                                let samples = self.lattice.layout.samples();
                                self.put(place, finer, child, vec![(color, [0; 3], [color[3]; 3]); samples]);
                            }
                        }
                    }
                }
            }
        }
    }

    fn put(&mut self, place: lattice::TreePlace, level: u8, node: UVec3, values: Vec<Value>) {
        let (base, side) = node_cube(&self.lattice, place, level, node);
        let mut values = values.into_iter();
        for z in 0..side {
            for y in 0..side {
                for x in 0..side {
                    let key = (
                        self.lattice.depth - level,
                        [base[0] + x, base[1] + y, base[2] + z],
                    );
                    let value = values.next().unwrap();
                    let old = *self.samples.entry(key).or_insert(value);
                    assert!(
                        same(old, value),
                        "{key:?}: {old:?} {value:?} in {place:?} level {level} {node}"
                    );
                }
            }
        }
    }

    /// The sample at a place; nothing where there is no tree.
    pub(crate) fn at(&self, mip: u8, cell: [i64; 3]) -> Value {
        self.samples.get(&(mip, cell)).copied().unwrap_or_default()
    }
}

/// Whether stored samples are the same, or both are solid ground and one is of a constant node, which has the mean colour of
/// the hints that bricks store, and no normal.
pub(crate) fn same(a: Value, b: Value) -> bool {
    let solid = a.0[3] == SOLID_ALPHA && b.0[3] == SOLID_ALPHA;
    a == b || solid && (a.1 == [0; 3] || b.1 == [0; 3])
}

/// Files of a folder and below by relative path.
pub(crate) fn files(out: &Path) -> std::collections::BTreeMap<PathBuf, Vec<u8>> {
    let mut found = std::collections::BTreeMap::new();
    let mut folders = vec![out.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else {
                found.insert(
                    entry.path().strip_prefix(out).unwrap().to_path_buf(),
                    fs::read(entry.path()).unwrap(),
                );
            }
        }
    }
    found
}

/// Both layouts with every filter.
pub(crate) fn layouts_and_filters() -> impl Iterator<Item = (SampleLayout, Filter)> {
    let layouts = [SampleLayout::Centre, SampleLayout::Corner];
    layouts
        .into_iter()
        .flat_map(|l| Filter::value_variants().iter().map(move |f| (l, *f)))
}

/// A number in 0..256 that looks random.
pub(crate) fn noise(a: u32, b: u32) -> u8 {
    let mut h = a.wrapping_mul(0x9e37_79b9) ^ b.wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    (h >> 24) as u8
}

/// Hills with a hole at (10, 4), a picture, a tilted sheet and a cut-out one, around (8, 8), 23.5 m wide and 10 m high,
/// all of it moved by `by`.
pub(crate) fn hills(by: DVec2) -> Inputs {
    let hole = |x: f64, y: f64| (x - 10.0).abs() < 1.5 && (y - 4.0).abs() < 1.0;
    let height = move |x: f64, y: f64| {
        let (x, y) = (x - by.x, y - by.y);
        if hole(x, y) {
            f64::NAN
        } else {
            4.0 + 2.0 * (x * 0.7).sin() + 1.5 * (y * 0.9 + x * 0.3).cos()
        }
    };
    let ground = layer(47, 0.5, by - DVec2::new(3.7, 3.9), height);
    let ground = painted(ground, |c, r| [noise(c, r), noise(r + 99, c), 120]);
    let at = |x: f64, y: f64, z: f64| DVec3::new(by.x + x, by.y + y, z);
    let holes = Raster {
        width: 8,
        height: 8,
        pixels: (0..64)
            .map(|k| [200, noise(k, 1), 40, if noise(k, 2) > 128 { 255 } else { 0 }])
            .collect(),
    };
    let tilted = sheet(
        at(1.0, 1.0, 2.0),
        DVec3::new(9.0, 1.0, 5.0),
        DVec3::new(-1.0, 7.0, 2.0),
        None,
    );
    let leaves = sheet(
        at(3.0, 12.0, 3.0),
        DVec3::new(14.0, 0.3, 0.0),
        DVec3::new(0.0, 0.5, 8.0),
        Some(holes),
    );
    Inputs {
        layers: vec![ground],
        meshes: vec![tilted, leaves],
    }
}
