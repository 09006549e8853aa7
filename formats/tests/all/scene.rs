//! Scenes: what is written is read back exactly, and what is wrong in a hand-written one is named.

use brickfell_formats::Place;
use brickfell_formats::scene::{Bounds, CoarseOctTree, Group, MAX_NESTING, PagedOctTree, Scene};
use proptest::prelude::*;

fn bounds() -> impl Strategy<Value = Option<Bounds>> {
    let sorted = (crate::common::point(), crate::common::point()).prop_map(|(a, b)| Bounds {
        min: a.min(b),
        max: a.max(b),
    });
    prop::option::of(sorted)
}

prop_compose! {
    fn tree()(
        center in crate::common::point(),
        radius in crate::common::metres().prop_map(f64::abs).prop_filter("above zero", |r| *r > 0.0),
        bounds in bounds(),
        tree_file in "[^/\\\\:\\pC]{1,8}(/[a-z&<>\"' é]{3,5}){0,2}"
            .prop_filter("a name", |f| f.split('/').all(|part| part != "." && part != "..")),
    ) -> PagedOctTree {
        PagedOctTree { center, radius, bounds, tree_file }
    }
}

fn coarse() -> impl Strategy<Value = CoarseOctTree> {
    let voxel = crate::common::metres()
        .prop_map(f64::abs)
        .prop_filter("above zero", |v| *v > 0.0);
    (tree(), voxel).prop_map(|(tree, voxel)| CoarseOctTree { tree, voxel })
}

fn group() -> impl Strategy<Value = Group> {
    let flat = (
        any::<bool>(),
        prop::option::of(Just([8; 3])),
        bounds(),
        prop::collection::vec(tree(), 0..3),
        prop::collection::vec(coarse(), 0..2),
    )
        .prop_map(|(compressed, brick_size, bounds, trees, coarse)| Group {
            compressed,
            brick_size,
            bounds,
            groups: Vec::new(),
            trees,
            coarse,
        })
        .boxed();
    flat.clone().prop_recursive(4, 32, 4, move |inner| {
        (flat.clone(), prop::collection::vec(inner, 0..4))
            .prop_map(|(group, groups)| Group { groups, ..group })
    })
}

fn collect<'a>(group: &'a Group, into: &mut Vec<&'a PagedOctTree>) {
    into.extend(&group.trees);
    for group in &group.groups {
        collect(group, into);
    }
}

proptest! {
    #[test]
    fn scenes_round_trip(crs in prop::option::of("[^\\pC]{0,20}[\n\t\r]?[<&\"' ]?"), root in group()) {
        let scene = Scene { crs, root };
        let xml = scene.to_xml();
        let again = Scene::parse(xml.as_bytes()).unwrap();
        prop_assert_eq!(&again, &scene);
        prop_assert_eq!(again.to_xml(), xml);
        let mut expected = Vec::new();
        collect(&scene.root, &mut expected);
        prop_assert!(scene.trees().eq(expected));
        prop_assert!(scene.coarse_trees().eq(scene.groups().flat_map(|g| &g.coarse)));
    }
}

#[test]
fn control_characters_in_a_crs_do_not_make_the_file_unreadable() {
    let scene = Scene {
        crs: Some("a\0b\u{1}".into()),
        root: Group::default(),
    };
    assert_eq!(
        Scene::parse(scene.to_xml().as_bytes()).unwrap().crs.unwrap(),
        "a\u{fffd}b\u{fffd}"
    );
}

const TREE: &str = "<PagedOctTree CenterX='1' CenterY='2' CenterZ='3' Radius='4' TreeFile='a/b.xml'/>";

fn parse(inside: &str) -> Result<Scene, brickfell_formats::FormatError> {
    Scene::parse(format!("<OctTreeGroup>\n{inside}</OctTreeGroup>").as_bytes())
}

#[test]
fn the_least_scene_has_defaults() {
    let scene = parse(TREE).unwrap();
    assert_eq!(
        (scene.crs, scene.root.compressed, scene.root.brick_size),
        (None, false, None)
    );
    assert_eq!(scene.root.trees[0].bounds, None);
    assert_eq!(Scene::parse(b"<OctTreeGroup/>").unwrap(), Scene::default());
}

#[test]
fn faults_are_named_with_their_place() {
    let with = |from: &str, to: &str| {
        assert!(TREE.contains(from), "{from}");
        TREE.replace(from, to)
    };
    let group = |attributes: &str| format!("<OctTreeGroup {attributes}/>");
    for (inside, column, part) in [
        ("<Tree/>".into(), 1, "Tree: unknown element in OctTreeGroup"),
        (
            with("Radius='4' ", ""),
            1,
            "PagedOctTree: attribute Radius is missing",
        ),
        (
            with("PagedOctTree", "CoarseOctTree"),
            1,
            "CoarseOctTree: attribute Voxel is missing",
        ),
        (
            with("PagedOctTree", "CoarseOctTree Voxel='0'"),
            16,
            "CoarseOctTree: Voxel=\"0\" is not above zero",
        ),
        (
            with("Radius='4' ", "Radius='4' Voxel='1' "),
            62,
            "PagedOctTree: attribute Voxel is unknown",
        ),
        (
            with("CenterY='2' ", ""),
            1,
            "PagedOctTree: attribute CenterY is missing",
        ),
        (
            with("Radius", "Radios"),
            51,
            "PagedOctTree: attribute Radios is unknown",
        ),
        (
            with("Radius='4'", "CenterX='4'"),
            51,
            "PagedOctTree: attribute CenterX is given twice",
        ),
        (
            with("Radius='4'", "Radius='-4'"),
            51,
            "Radius=\"-4\" is not above zero",
        ),
        (
            with("CenterX='1'", "CenterX='NaN'"),
            15,
            "PagedOctTree: CenterX=\"NaN\" is not a finite number",
        ),
        (
            with("CenterX='1'", "CenterX='inf'"),
            15,
            "CenterX=\"inf\" is not a finite number",
        ),
        (
            with("CenterX='1'", "CenterX='1m'"),
            15,
            "CenterX=\"1m\" is not a number",
        ),
        (with("/>", " MinX='0'/>"), 1, "attribute MinY is missing"),
        (
            with("/>", " MinX='0' MinY='0' MinZ='2' MaxX='1' MaxY='1' MaxZ='1'/>"),
            99,
            "PagedOctTree: MinZ=\"2\" is above MaxZ",
        ),
        (
            with("/>", "><a/></PagedOctTree>"),
            81,
            "a: a tree has no elements inside",
        ),
        (with("/>", ">x</PagedOctTree>"), 81, "text in PagedOctTree"),
        (format!("{TREE} oak"), 83, "text in OctTreeGroup"),
        (
            group("Compressed='TRUE'"),
            15,
            "OctTreeGroup: Compressed=\"TRUE\" is unknown (known: YES, NO)",
        ),
        (group("BrickXSize='8'"), 1, "attribute BrickYSize is missing"),
        (group("BrickXSize='9'"), 15, "BrickXSize=\"9\" is not supported"),
        (group("Crs='EPSG:25832'"), 15, "attribute Crs is unknown"),
    ] {
        let e = parse(&inside).unwrap_err();
        assert_eq!(e.place, Place::Line { line: 2, column }, "{inside}: {e}");
        assert!(e.message.contains(part), "{inside}: {e}");
        assert!(!e.to_string().contains('\n'));
    }
    for (text, part) in [
        (
            "<OctTreeGroup Version='2'/>",
            "Version=\"2\" is an unknown version",
        ),
        (
            "<GigaVoxelsOctTree/>",
            "unknown root element (OctTreeGroup expected)",
        ),
        ("<PagedOctTree/>", "unknown root element (OctTreeGroup expected)"),
    ] {
        let e = Scene::parse(text.as_bytes()).unwrap_err();
        assert!(e.message.contains(part), "{e}");
    }
}

#[test]
fn mistakes_come_with_what_was_probably_meant() {
    let with = |from: &str, to: &str| TREE.replace(from, to);
    for (inside, suggestion) in [
        (with("Paged", "Pagde"), "did you mean PagedOctTree?"),
        (
            "<Tree/>".into(),
            "known: OctTreeGroup, PagedOctTree, CoarseOctTree",
        ),
        (with("Radius", "radius"), "did you mean Radius?"),
        (with("CenterY", "CentreY"), "did you mean CenterY?"),
        (with("/>", " Voxel='1'/>"), "it belongs to a CoarseOctTree"),
        (
            "<OctTreeGroup Crs='x'/>".into(),
            "it belongs to the outermost OctTreeGroup",
        ),
        (
            "<OctTreeGroup Colour='red'/>".into(),
            "known: Compressed, BrickXSize, BrickYSize, BrickZSize, MinX, MinY, MinZ, MaxX, MaxY, MaxZ",
        ),
        (with("Radius='4' ", ""), "for instance Radius=\"27.72\""),
        (with("Radius='4'", "Radius='-4'"), "for instance Radius=\"27.72\""),
        (with("'1'", "'1,5'"), "did you mean CenterX=\"1.5\"?"),
        (with("'1'", "' 15 m'"), "did you mean CenterX=\"15\"?"),
        (with("'1'", "'one'"), "for instance CenterX=\"16\""),
        (
            with("a/b.xml", ".\\a\\b.xml"),
            "did you mean TreeFile=\"a/b.xml\"?",
        ),
        (
            with("a/b.xml", "/a/b.xml"),
            "for instance TreeFile=\"trees/a.oct\"",
        ),
        ("<OctTreeGroup Compressed='yes'/>".into(), "did you mean YES?"),
        (
            "<OctTreeGroup BrickXSize='eight'/>".into(),
            "for instance BrickXSize=\"8\"",
        ),
        (
            with("/>", " MinX='3' MinY='0' MinZ='0' MaxX='1' MaxY='1' MaxZ='1'/>"),
            "did you mean MinX and MaxX the other way round?",
        ),
    ] {
        let (_, faults) =
            Scene::parse_usable(format!("<OctTreeGroup>\n{inside}</OctTreeGroup>").as_bytes()).unwrap();
        // One mistake is one fault: what is misspelt does not count as missing too.
        assert_eq!(faults.len(), 1, "{inside}: {faults:?}");
        assert_eq!(faults[0].suggestion.as_deref(), Some(suggestion), "{inside}");
        assert!(faults[0].to_string().ends_with(&format!("; {suggestion}")));
    }
    let e = Scene::parse(b"<OctreeGroup/>").unwrap_err();
    assert_eq!(e.suggestion.as_deref(), Some("did you mean OctTreeGroup?"));
}

#[test]
fn all_mistakes_are_told_in_order_and_the_rest_is_read() {
    let text = format!(
        "<OctTreeGroup Color='1'>\n<Group><OctTreeGroup>{TREE}</OctTreeGroup></Group>\n{TREE}\n<OctTreeGroup MinX='1'>\n\
         <PagedOctTree Radius='0' CenterX='x' TreeFile='' CenterY='1' CenterZ='1'/>{}</OctTreeGroup></OctTreeGroup>",
        TREE.replace("a/b.xml", "c.xml"),
    );
    let (scene, faults) = Scene::parse_usable(text.as_bytes()).unwrap();
    let lines: Vec<u32> = faults
        .iter()
        .map(|fault| match fault.place {
            Place::Line { line, .. } => line,
            _ => 0,
        })
        .collect();
    // An attribute, an element, five of a box, three of a tree.
    assert_eq!(lines, [1, 2, 4, 4, 4, 4, 4, 5, 5, 5], "{faults:?}");
    let files: Vec<&str> = scene.trees().map(|t| t.tree_file.as_str()).collect();
    assert_eq!(files, ["a/b.xml", "c.xml"]);
    assert_eq!(scene.root.groups[0].trees.len(), 1);
    assert_eq!(faults[0], Scene::parse(text.as_bytes()).unwrap_err());
}

#[test]
fn places_of_tree_files_are_those_of_faults() {
    let other = TREE.replace("a/b.xml", "höhe.xml");
    let text = format!("<OctTreeGroup>\n{TREE}<!-- é\n -->{other}\n{TREE}</OctTreeGroup>");
    let places = Scene::tree_file_places(text.as_bytes());
    assert_eq!(places.len(), 2);
    assert_eq!(places["a/b.xml"], Place::Line { line: 2, column: 62 });
    let wrong = text.replace("höhe.xml", "");
    assert_eq!(
        places["höhe.xml"],
        Scene::parse(wrong.as_bytes()).unwrap_err().place
    );
    assert!(Scene::tree_file_places(b"<a><b/>").is_empty());
}

#[test]
fn tree_files_stay_in_the_folder() {
    for (bad, escaped) in [
        ("", ""),
        ("/etc/passwd", "/etc/passwd"),
        ("..", ".."),
        ("a/../../b", "a/../../b"),
        ("a\\b", "a\\b"),
        ("C:/a", "C:/a"),
        ("file:a", "file:a"),
        ("a//b", "a//b"),
        ("./a", "./a"),
        ("a/", "a/"),
        ("a\nb", "a&#10;b"),
    ] {
        let e = parse(&TREE.replace("a/b.xml", escaped)).unwrap_err();
        assert!(e.message.contains("leaves the terrain's folder"), "{bad:?}: {e}");
        assert!(e.message.starts_with("PagedOctTree: TreeFile="), "{bad:?}: {e}");
        assert_eq!(e.place, Place::Line { line: 2, column: 62 }, "{bad:?}");
    }
    assert!(parse(&TREE.replace("a/b.xml", "a&#0;b")).is_err());
    for good in ["a", "...", "a..b/.hidden", "trees/höhe 1.oct"] {
        assert_eq!(
            parse(&TREE.replace("a/b.xml", good)).unwrap().root.trees[0].tree_file,
            good
        );
    }
}

#[test]
fn nesting_is_limited() {
    let nested = |n: usize| "<OctTreeGroup>".repeat(n) + &"</OctTreeGroup>".repeat(n);
    Scene::parse(nested(MAX_NESTING).as_bytes()).unwrap();
    let e = Scene::parse(nested(MAX_NESTING + 1).as_bytes()).unwrap_err();
    assert_eq!(
        e.place,
        Place::Line {
            line: 1,
            column: 14 * 64 + 1
        }
    );
    assert!(e.message.contains("nest deeper than 64"), "{e}");
    Scene::parse(nested(1_000_000).as_bytes()).unwrap_err();
}

#[test]
fn the_number_of_trees_is_limited() {
    let text = format!("<OctTreeGroup>{}</OctTreeGroup>", TREE.repeat((1 << 20) + 1));
    let e = Scene::parse(text.as_bytes()).unwrap_err();
    assert!(e.message.contains("at most 1048576"), "{e}");
}
