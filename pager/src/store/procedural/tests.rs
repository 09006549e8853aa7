//! Every file of a small terrain decodes, and what is stored twice is stored alike.

use std::collections::HashMap;

use brickfell_formats::bricks::{self, brick_file_name};
use brickfell_formats::layout::{BRICK_VOXELS, SampleLayout};
use brickfell_formats::octree::NodeData;
use brickfell_formats::octree_binary;
use brickfell_formats::scene::Scene;
use brickfell_formats::value::{SOLID_ALPHA, Stored};
use glam::{DVec3, I64Vec3, IVec3};
use proptest::prelude::*;

use super::*;

fn terrain(extent: f64, voxel: f64, depth: u8) -> ProceduralStore {
    ProceduralStore::new(ProceduralConfig {
        seed: 3,
        extent,
        voxel,
        depth: Some(depth),
        ..ProceduralConfig::default()
    })
    .unwrap()
}

fn whole(store: &ProceduralStore, name: &str) -> Vec<u8> {
    let len = store.len(name).unwrap();
    store.read(name, 0, len as usize).unwrap()
}

fn scene(store: &ProceduralStore) -> Scene {
    Scene::parse(&whole(store, SCENE_FILE)).unwrap()
}

/// Samples by voxel of the world's lattice at each width of voxels, from everything that stores them; and the constant nodes:
/// their voxels' low and high corners and colours.
#[derive(Default)]
struct Samples {
    stored: HashMap<(u64, I64Vec3), Stored>,
    constants: Vec<(u64, I64Vec3, I64Vec3, [u8; 4])>,
    bricks: usize,
}

impl Samples {
    /// Reads a tree with all its files; panics where two of all the trees disagree.
    fn add(&mut self, store: &ProceduralStore, name: &str) {
        let tree = octree_binary::decode(&whole(store, name)).unwrap();
        for level in 0..=tree.header.depth {
            let nodes = &tree.levels[usize::from(level)];
            let voxel = tree.header.level_voxel_size(level);
            let origin = (tree.header.origin / voxel).round().as_i64vec3();
            assert_eq!(origin.as_dvec3() * voxel, tree.header.origin, "on the lattice");
            let key = voxel.to_bits();
            let file_name = brick_file_name(name, level);
            if tree.brick_count(level) == 0 {
                continue;
            }
            let file = whole(store, &file_name);
            let header = bricks::decode_header(&file, file.len() as u64).unwrap();
            let range = header.directory();
            let index = header
                .decode_directory(&file[range.start as usize..range.end as usize])
                .unwrap();
            assert_eq!(header.bricks, tree.brick_count(level), "{file_name}");
            let chunks: Vec<_> = (0..)
                .zip(&index.chunks)
                .map(|(k, c)| {
                    let payload = &file[c.offset as usize..(c.offset + u64::from(c.length)) as usize];
                    index.decode_chunk(k, payload).unwrap()
                })
                .collect();
            for (node, p) in nodes.iter().zip(tree.positions(level)) {
                let low = origin + p.as_i64vec3() * i64::from(BRICK_VOXELS);
                let brick = match node.data() {
                    NodeData::Constant(color) => {
                        let high = low + i64::from(BRICK_VOXELS);
                        self.constants.push((key, low, high, color));
                        continue;
                    }
                    NodeData::Brick(brick) => brick,
                };
                self.bricks += 1;
                let (chunk, local) = index.locate(brick).unwrap();
                let chunk = &chunks[chunk as usize];
                let (color, normal) = (
                    chunk.brick_color(local as usize),
                    chunk.brick_normal(local as usize),
                );
                let side = SampleLayout::Centre.side() as i32;
                for k in 0..side.pow(3) {
                    let at = IVec3::new(k % side, k / side % side, k / side / side) - 1;
                    let sample = Stored {
                        color: color[k as usize],
                        normal: normal[k as usize],
                    };
                    let before = self.stored.insert((key, low + at.as_i64vec3()), sample);
                    assert!(before.is_none_or(|b| b == sample), "{file_name}: {p} {at}");
                }
            }
        }
    }
}

#[test]
fn what_is_stored_twice_is_stored_alike_in_chunks_levels_and_trees() {
    let store = terrain(300.0, 1.0, 3);
    let scene = scene(&store);
    let trees: Vec<&str> = scene.trees().map(|t| t.tree_file.as_str()).collect();
    let coarse: Vec<&str> = scene.coarse_trees().map(|t| t.tree.tree_file.as_str()).collect();
    assert_eq!(
        (trees.len(), coarse.len()),
        (25, 9 + 4 + 1),
        "5 × 5 trees of 64 m"
    );
    let mut samples = Samples::default();
    for name in trees.iter().chain(&coarse) {
        samples.add(&store, name);
    }
    assert!(samples.bricks > 3000, "{}", samples.bricks);
    // A constant node has the value of the samples that bricks beside it store of it.
    let mut compared = 0;
    for (key, low, high, color) in &samples.constants {
        for x in low.x..high.x {
            for y in low.y..high.y {
                for z in [low.z, high.z - 1] {
                    if let Some(sample) = samples.stored.get(&(*key, I64Vec3::new(x, y, z))) {
                        assert_eq!((sample.color, sample.normal), (*color, [0; 4]));
                        compared += 1;
                    }
                }
            }
        }
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn ground_is_solid_below_its_surface_at_every_level() {
    let store = terrain(500.0, 1.0, 3);
    let scene = scene(&store);
    let mut samples = Samples::default();
    let coarse = scene.coarse_trees().map(|c| &c.tree);
    for tree in scene.trees().take(9).chain(coarse) {
        samples.add(&store, &tree.tree_file);
    }
    let mut columns: HashMap<(u64, i64, i64), Vec<(i64, u8)>> = HashMap::new();
    for ((key, at), sample) in &samples.stored {
        columns
            .entry((*key, at.x, at.y))
            .or_default()
            .push((at.z, sample.color[3]));
    }
    let mut surfaces = 0;
    for mut column in columns.into_values() {
        column.sort_unstable();
        // From the top: air, at most one sample in part, then solid all the way.
        let from_top: Vec<u8> = column.iter().rev().map(|c| c.1).collect();
        let air = from_top.iter().take_while(|a| **a == 0).count();
        let below = &from_top[air..];
        assert!(below.iter().skip(1).all(|a| *a == SOLID_ALPHA), "{from_top:?}");
        surfaces += usize::from(air > 0 && below.len() > 3);
    }
    assert!(surfaces > 5000, "{surfaces}");
}

#[test]
fn nobody_stands_out_where_groups_are_opened() {
    // The deeper level of a coarse tree has the voxels of the coarsest level of what is in its group, and is said to.
    let store = terrain(700.0, 1.0, 3);
    let scene = scene(&store);
    for group in scene.groups() {
        let coarse = &group.coarse[0];
        let header = |name: &str| {
            let bytes = whole(&store, name);
            octree_binary::decode_header(&bytes, bytes.len() as u64)
                .unwrap()
                .header
        };
        let own = header(&coarse.tree.tree_file);
        assert_eq!(own.voxel_size, coarse.voxel);
        let inside = group
            .trees
            .iter()
            .chain(group.groups.iter().map(|g| &g.coarse[0].tree));
        for tree in inside {
            let header = header(&tree.tree_file);
            assert_eq!(header.level_voxel_size(0), coarse.voxel, "{}", tree.tree_file);
            let [min, max] = header.bounds();
            let bounds = tree.bounds.unwrap();
            assert_eq!((bounds.min, bounds.max), (min, max));
            assert!(own.bounds()[0].cmple(min).all() && own.bounds()[1].cmpge(max).all());
        }
    }
}

#[test]
fn a_name_that_is_not_in_the_scene_is_no_file() {
    let store = terrain(300.0, 1.0, 3);
    for name in [
        "trees/x5_y0.oct",
        "trees/x05_y0.oct",
        "trees/g4_x0_y0.oct",
        "trees/g0_x0_y0.oct",
        "trees/x0_y0.L04.brk",
        "trees/x0_y0.L3.brk",
        "trees/g1_x0_y0.L02.brk",
        "x0_y0.oct",
        "trees/x-1_y0.oct",
        "",
    ] {
        assert_eq!(
            store.len(name).unwrap_err().kind(),
            io::ErrorKind::NotFound,
            "{name}"
        );
    }
    let len = store.len("trees/x4_y4.oct").unwrap();
    assert!(store.read("trees/x4_y4.oct", len - 3, 4).is_err());
    assert!(store.read("trees/x4_y4.oct", u64::MAX, 4).is_err());
}

#[test]
fn addresses_are_read_or_refused() {
    let parse = |text: &str| ProceduralConfig::parse(text);
    let config = parse("7?extent=100km&voxel=0.5m&depth=5").unwrap();
    assert_eq!(
        (config.seed, config.extent, config.voxel, config.depth),
        (7, 1e5, 0.5, Some(5))
    );
    assert_eq!(
        parse("7").unwrap(),
        ProceduralConfig {
            seed: 7,
            ..Default::default()
        }
    );
    for bad in [
        "",
        "x",
        "7?extent",
        "7?extent=far",
        "7?colour=red",
        "-1",
        "7?depth=300",
    ] {
        assert!(parse(bad).is_err(), "{bad}");
    }
    let new = |text: &str| ProceduralStore::new(parse(text).unwrap()).map(|s| (s.trees(), s.tree_side()));
    assert_eq!(new("1?extent=100km"), Ok((196, 512.0)));
    assert_eq!(new("1?extent=10km"), Ok((157, 64.0)));
    assert!(matches!(new("1?extent=NaN"), Err(ProceduralError::Length { .. })));
    assert!(matches!(new("1?voxel=0"), Err(ProceduralError::Length { .. })));
    assert_eq!(new("1?depth=2"), Err(ProceduralError::Depth(2)));
    assert!(matches!(new("1?extent=100000km"), Err(ProceduralError::Trees(_))));
}

#[test]
fn the_highest_ground_is_above_all_of_it() {
    let store = terrain(2000.0, 1.0, 4);
    let mut samples = Samples::default();
    samples.add(&store, "trees/x3_y2.oct");
    let finest = samples
        .stored
        .iter()
        .filter(|((key, _), s)| *key == 1f64.to_bits() && s.color[3] > 0)
        .map(|((_, at), _)| at.z)
        .max()
        .unwrap();
    let middle = DVec3::new(3.5, 2.5, 0.0) * store.tree_side();
    let highest = store.highest_ground(middle.x, middle.y, 64.0).unwrap();
    assert!((highest - finest as f64).abs() < 16.0, "{highest} {finest}");
    assert_eq!(store.highest_ground(-500.0, 0.0, 10.0), None);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    /// Any range of any file is what is there of the whole, whoever made it and whatever was forgotten meanwhile.
    #[test]
    fn ranges_are_parts_of_the_whole(x in 0u32..2, y in 0u32..2, file in 0usize..5, from in 0.0f64..1.0, part in 0.0f64..1.0) {
        let names = ["oct", "L00.brk", "L01.brk", "L02.brk", "L03.brk"];
        let name = format!("trees/x{x}_y{y}.{}", names[file]);
        let all = whole(&terrain(128.0, 1.0, 3), &name);
        let forgetful = ProceduralStore::new(ProceduralConfig {
            seed: 3,
            extent: 128.0,
            depth: Some(3),
            cache_bytes: 0,
            ..ProceduralConfig::default()
        })
        .unwrap();
        prop_assert_eq!(forgetful.len(&name).unwrap(), all.len() as u64);
        let from = (from * all.len() as f64) as usize;
        let len = (part * (all.len() - from) as f64) as usize;
        let read = forgetful.read(&name, from as u64, len).unwrap();
        prop_assert_eq!(&read[..], &all[from..from + len]);
    }
}
