//! Octree files: the two forms say the same, and what is wrong in them is found.

use brickfell_formats::octree::{Node, NodeData, Octree, decode_any};
use brickfell_formats::{Place, octree_binary, octree_xml};
use proptest::prelude::*;

proptest! {
    #[test]
    fn binary_and_xml_convert_without_loss(tree in crate::common::octree()) {
        tree.validate().unwrap();
        let binary = octree_binary::encode(&tree).unwrap();
        prop_assert_eq!(&octree_binary::decode(&binary).unwrap(), &tree);
        let xml = octree_xml::encode(&tree).unwrap();
        let again = octree_xml::decode(xml.as_bytes()).unwrap();
        // Bit for bit: == on doubles would let -0 pass for 0.
        prop_assert_eq!(octree_binary::encode(&again).unwrap(), binary.clone());
        prop_assert_eq!(octree_xml::encode(&again).unwrap(), xml.clone());
        prop_assert_eq!(&decode_any(&binary).unwrap(), &tree);
        prop_assert_eq!(&decode_any(xml.as_bytes()).unwrap(), &tree);
    }

    #[test]
    fn a_prefix_of_the_binary_file_is_the_coarse_tree(tree in crate::common::octree()) {
        let binary = octree_binary::encode(&tree).unwrap();
        let head = &binary[..binary.len().min(octree_binary::prefix_len())];
        let index = octree_binary::decode_header(head, binary.len() as u64).unwrap();
        prop_assert_eq!(index.levels.len(), tree.levels.len());
        for (level, entry) in index.levels.iter().enumerate() {
            let bytes = &binary[entry.offset as usize..][..entry.bytes as usize];
            prop_assert_eq!(&index.decode_level(level as u8, bytes).unwrap(), &tree.levels[level]);
        }
    }

    #[test]
    fn levels_are_in_morton_order(tree in crate::common::octree()) {
        for level in 0..=tree.header.depth {
            let codes: Vec<u64> =
                tree.positions(level).into_iter().map(brickfell_formats::morton::encode).collect();
            prop_assert_eq!(codes.len(), tree.levels[usize::from(level)].len());
            prop_assert!(codes.is_sorted_by(|a, b| a < b));
        }
    }
}

const ROOT: &str = "X='0' Y='0' Z='-4' DeltaX='0.5' DeltaY='0.5' DeltaZ='0.5' VolumeXSize='8' VolumeYSize='8' \
    VolumeZSize='8' BrickXSize='8' BrickYSize='8' BrickZSize='8'";

/// A tree of depth 1 around some nodes.
fn document(nodes: &str) -> String {
    format!("<GigaVoxelsOctTree {ROOT} Binary='YES'>\n{nodes}\n</GigaVoxelsOctTree>")
}

fn decode(nodes: &str) -> Octree {
    octree_xml::decode(document(nodes).as_bytes()).expect("a valid tree")
}

const LEAF: &str = "<Node Type='LEAF-CONST' Color='#80400080'/>";

#[test]
fn defaults_are_those_of_a_hand_written_tree() {
    let tree = decode(LEAF);
    let h = tree.header;
    assert_eq!((h.depth, h.gain, h.surface_voxels), (1, 1, 0));
    assert_eq!(h.layout, brickfell_formats::layout::SampleLayout::Centre);
    assert_eq!((h.origin.z, h.voxel_size, h.side()), (-4.0, 0.5, 8.0));
    assert_eq!(tree.levels, [vec![Node::constant([0x80, 0x40, 0, 0x80])], vec![]]);
}

#[test]
fn a_missing_inner_colour_is_the_linear_mean_of_the_children() {
    let four = |c: &str| format!("<Node Type='CONST' Color='{c}'/>").repeat(4);
    let tree = decode(&format!(
        "<Node Type='CONST'>{}{}</Node>",
        four("#ffffffff"),
        four("#00000000")
    ));
    // Half the light of 255 is code 188, half the alpha is 128.
    assert_eq!(
        tree.levels[0],
        [Node::new(Some(0), NodeData::Constant([188, 188, 188, 128]))]
    );
    let given = format!("<Node Type='CONST' Color='#01020304'>{}</Node>", LEAF.repeat(8));
    assert_eq!(
        decode(&given).levels[0][0].data(),
        NodeData::Constant([1, 2, 3, 4])
    );
    let same = decode(&format!("<Node Type='CONST'>{}</Node>", LEAF.repeat(8)));
    assert_eq!(same.levels[0][0].data(), same.levels[1][0].data());
}

#[test]
fn bricks_are_numbered_in_their_level() {
    let child = |k| format!("<Node Type='NON-CONST' Brick='{k}'/>");
    let nodes: String = (0..8).map(child).collect();
    let tree = decode(&format!("<Node Type='NON-CONST' Brick='0'>{nodes}</Node>"));
    assert_eq!((tree.brick_count(0), tree.brick_count(1)), (1, 8));
}

#[test]
fn faults_in_nodes_are_named_with_their_place() {
    let eight = LEAF.repeat(8);
    for (nodes, column, part) in [
        (String::new(), 0, "GigaVoxelsOctTree: has no Node"),
        (format!("{LEAF}{LEAF}"), 44, "a second root node"),
        ("<Leaf/>".into(), 1, "Leaf: unknown element (Node expected)"),
        ("<Node/>".into(), 1, "Node: attribute Type is missing"),
        (
            "<Node Type='SOLID'/>".into(),
            7,
            "Node: Type=\"SOLID\" is unknown (known: CONST, NON-CONST, LEAF-CONST)",
        ),
        (
            "<Node Type='LEAF-CONST'/>".into(),
            1,
            "Node: attribute Color is missing",
        ),
        (
            "<Node Type='CONST'/>".into(),
            1,
            "Node: attribute Color is missing",
        ),
        (
            "<Node Type='CONST' Color='red'/>".into(),
            20,
            "Node: Color=\"red\" is not a colour",
        ),
        (
            "<Node Type='CONST' Color='#+1234567'/>".into(),
            20,
            "is not a colour",
        ),
        (
            "<Node Type='CONST' Colour='#00000000'/>".into(),
            20,
            "Node: attribute Colour is unknown",
        ),
        (
            "<Node Type='CONST' Type='CONST'/>".into(),
            20,
            "Node: attribute Type is given twice",
        ),
        (
            "<Node Type='CONST' Color='#00000000' Brick='0'/>".into(),
            38,
            "Brick=\"0\" stands on a constant",
        ),
        (
            "<Node Type='NON-CONST'/>".into(),
            1,
            "Node: attribute Brick is missing",
        ),
        (
            "<Node Type='NON-CONST' Brick='1'/>".into(),
            24,
            "Brick=\"1\" is out of order, the next brick of level 0 is 0",
        ),
        (
            "<Node Type='NON-CONST' Brick='0' Color='#00000000'/>".into(),
            34,
            "stands on a NON-CONST node",
        ),
        (format!("<Node Type='CONST'>{LEAF}</Node>"), 1, "has 1 children"),
        (
            format!("<Node Type='CONST'>{eight}{LEAF}</Node>"),
            364,
            "a ninth child",
        ),
        (
            format!("<Node Type='LEAF-CONST' Color='#00000000'>{eight}</Node>"),
            43,
            "LEAF-CONST, which has no children",
        ),
        (
            format!("<Node Type='CONST'><Node Type='CONST'>{eight}</Node></Node>"),
            39,
            "below the deepest level, 1",
        ),
        (
            "<Node Type='CONST' Color='#00000000'>x</Node>".into(),
            38,
            "text in Node",
        ),
    ] {
        let e = octree_xml::decode(document(&nodes).as_bytes()).unwrap_err();
        let place = if column == 0 {
            Place::Line { line: 1, column: 1 }
        } else {
            Place::Line { line: 2, column }
        };
        assert_eq!(e.place, place, "{nodes}: {e}");
        assert!(e.message.contains(part), "{nodes}: {e}");
        assert!(!e.to_string().contains('\n'));
    }
}

#[test]
fn a_colour_cannot_be_the_mean_of_bricks() {
    let nodes = format!(
        "<Node Type='CONST'>{}<Node Type='NON-CONST' Brick='0'/></Node>",
        LEAF.repeat(7)
    );
    let e = octree_xml::decode(document(&nodes).as_bytes()).unwrap_err();
    assert!(
        e.message.contains("cannot be the mean of NON-CONST children"),
        "{e}"
    );
}

#[test]
fn faults_in_the_header_are_named() {
    let text = document(LEAF);
    octree_xml::decode(text.as_bytes()).unwrap();
    for (from, to, part) in [
        ("GigaVoxelsOctTree", "OctTree", "unknown root element"),
        (
            "X='0'",
            "X='NaN'",
            "GigaVoxelsOctTree: X=\"NaN\" is not a finite number",
        ),
        ("X='0' ", "", "attribute X is missing"),
        ("Z='-4'", "Z='1e16'", "Z=\"1e16\" is beyond"),
        (
            "DeltaY='0.5'",
            "DeltaY='0.25'",
            "DeltaY=\"0.25\" differs from DeltaX",
        ),
        ("DeltaX='0.5'", "DeltaX='0'", "DeltaX=\"0\" is not above zero"),
        (
            "VolumeZSize='8'",
            "VolumeZSize='4'",
            "VolumeZSize=\"4\" differs from VolumeXSize",
        ),
        (
            "BrickYSize='8'",
            "BrickYSize='16'",
            "BrickYSize=\"16\" is not supported",
        ),
        (
            "Binary='YES'",
            "Binary='yes'",
            "Binary=\"yes\" is unknown (known: YES, NO)",
        ),
        (" Binary='YES'", "", "attribute Binary is missing"),
        (
            "Binary='YES'",
            "Binary='YES' Version='2'",
            "Version=\"2\" is an unknown version",
        ),
        (
            "Binary='YES'",
            "Binary='YES' Layout='EDGE'",
            "Layout=\"EDGE\" is unknown",
        ),
        ("Binary='YES'", "Binary='YES' Gain='3'", "Gain=\"3\" is unknown"),
        (
            "Binary='YES'",
            "Binary='YES' SurfaceMaxX='17'",
            "surface bounds do not lie in the tree",
        ),
        (
            "Binary='YES'",
            "Binary='YES' Depth='1'",
            "attribute Depth is unknown",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let e = octree_xml::decode(text.replace(from, to).as_bytes()).unwrap_err();
        assert!(e.message.contains(part), "{from} -> {to}: {e}");
        assert!(matches!(e.place, Place::Line { line: 1, .. }), "{e}");
    }
    for bad in ["6", "2", "16777216"] {
        let volume = |axis| {
            (
                format!("Volume{axis}Size='8'"),
                format!("Volume{axis}Size='{bad}'"),
            )
        };
        let sized = ["X", "Y", "Z"]
            .into_iter()
            .map(volume)
            .fold(text.clone(), |t, (from, to)| t.replace(&from, &to));
        let e = octree_xml::decode(sized.as_bytes()).unwrap_err();
        assert!(e.message.contains("is not 8·2^depth times DeltaX"), "{bad}: {e}");
    }
    let brick = document("<Node Type='NON-CONST' Brick='0'/>").replace("'YES'", "'NO'");
    let e = octree_xml::decode(brick.as_bytes()).unwrap_err();
    assert!(
        e.message.contains("Binary=\"NO\", which has no brick files"),
        "{e}"
    );
}
