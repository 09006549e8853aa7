//! The hand-written example reads as its comments say.

use brickfell_formats::octree::{NodeData, Octree, decode_any, octant};
use brickfell_formats::scene::Scene;
use brickfell_formats::{octree_binary, octree_xml};
use glam::DVec3;

const SCENE: &str = include_str!("../../../examples/two_trees/scene.xml");
const WEST: &str = include_str!("../../../examples/two_trees/west.xml");
const EAST: &str = include_str!("../../../examples/two_trees/east.xml");

/// What a constant tree shows at a world point, at its finest.
fn color_at(tree: &Octree, point: DVec3) -> [u8; 4] {
    let inside = (point - tree.header.origin) / tree.header.side();
    let mut index = 0;
    for (level, nodes) in tree.levels.iter().enumerate() {
        let node = nodes[index];
        if let Some(tile) = node.children() {
            let position = (inside * f64::from(2u32 << level)).as_uvec3();
            index = (tile * 8 + octant(position)) as usize;
        } else {
            let NodeData::Constant(color) = node.data() else {
                panic!("a brick at {point}")
            };
            return color;
        }
    }
    panic!("no terminal node at {point}");
}

fn trees() -> Vec<Octree> {
    [WEST, EAST]
        .map(|text| decode_any(text.as_bytes()).expect("the example"))
        .into()
}

#[test]
fn the_scene_says_where_its_trees_are() {
    let scene = Scene::parse(SCENE.as_bytes()).unwrap();
    let files: Vec<&str> = scene.trees().map(|t| t.tree_file.as_str()).collect();
    assert_eq!(files, ["west.xml", "east.xml"]);
    let all = scene.root.bounds.unwrap();
    for (reference, tree) in scene.trees().zip(trees()) {
        let [lo, hi] = tree.header.bounds();
        let bounds = reference.bounds.unwrap();
        assert_eq!((bounds.min, bounds.max), (lo, hi));
        assert_eq!(reference.center, (lo + hi) / 2.0);
        let reach = (hi - lo).length() / 2.0;
        assert!((reach..reach + 0.01).contains(&reference.radius), "{reach}");
        assert!(all.min.cmple(lo).all() && all.max.cmpge(hi).all());
    }
}

#[test]
fn the_trees_differ_touch_and_hold_constants_only() {
    let trees = trees();
    let [west, east] = [&trees[0].header, &trees[1].header];
    assert_eq!(
        (west.depth, west.voxel_size, east.depth, east.voxel_size),
        (3, 0.5, 4, 0.125)
    );
    assert_eq!(west.bounds()[1].x, east.bounds()[0].x);
    for tree in &trees {
        assert_eq!(
            (0..=tree.header.depth).map(|l| tree.brick_count(l)).sum::<u32>(),
            0
        );
        assert!(tree.levels[3].len() > 32);
        // On the global lattice: a whole number of voxels of the root.
        let root = tree.header.origin / tree.header.level_voxel_size(0);
        assert_eq!(root, root.round());
    }
    for text in [WEST, EAST] {
        let inner = text.matches("<Node Type=\"CONST\"").count();
        assert_eq!(inner, text.matches("</Node>").count());
    }
}

#[test]
fn points_show_what_the_comments_say() {
    let trees = trees();
    let (rock, grass, air) = ([0x6f, 0x6a, 0x66, 255], [0x6a, 0x9e, 0x4a, 255], [0; 4]);
    for (x, top) in [(4.0, 24.0), (12.0, 16.0), (20.0, 8.0), (28.0, 0.0)] {
        let at = |z| color_at(&trees[0], DVec3::new(x, 20.0, z));
        assert_eq!((at(-7.9), at(top - 0.1)), (rock, grass), "x = {x}");
        if top < 24.0 {
            assert_eq!(at(top + 0.1), air, "x = {x}");
        }
    }
    let at = |x, y, z| color_at(&trees[1], DVec3::new(x, y, z));
    let brick = [0xb5, 0x54, 0x3c, 255];
    assert_eq!([at(33.0, 14.0, 1.0), at(47.0, 14.0, 1.0)], [brick; 2]);
    assert_eq!([at(40.0, 14.0, 1.0), at(33.0, 20.0, 1.0)], [air; 2]);
    assert_eq!(at(40.0, 14.0, 9.0), brick);
    assert_eq!(at(40.0, 14.0, 11.0), [0xee, 0xe2, 0xc8, 255]);
    assert_eq!(at(40.0, 16.0, -1.0), [0x08, 0x2c, 0x3b, 0x20]);
    assert_eq!(
        (at(40.0, 16.0, -3.0), at(33.0, 9.0, -0.1)),
        (rock, [0xd9, 0xc0, 0x8c, 255])
    );
}

#[test]
fn the_example_converts_to_binary_and_back() {
    for tree in trees() {
        let binary = octree_binary::encode(&tree).unwrap();
        let xml = octree_xml::encode(&decode_any(&binary).unwrap()).unwrap();
        assert_eq!(
            octree_binary::encode(&decode_any(xml.as_bytes()).unwrap()).unwrap(),
            binary
        );
    }
}
