//! The tables against the schemas of the documentation, and what is near to what.

use std::collections::BTreeMap;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::*;
use crate::octree_xml;
use crate::scene::Scene;

const SCENE_XSD: &str = include_str!("../../../docs/scene.xsd");
const OCTREE_XSD: &str = include_str!("../../../docs/octree.xsd");

/// Of a type of the schema: attributes and whether they are required, and elements inside.
#[derive(Debug, Default, PartialEq)]
struct Type {
    attributes: BTreeMap<String, bool>,
    inside: Vec<String>,
}

/// The types of a schema by their names. A type that extends another, and one that names groups of attributes, has what these have.
fn types(xsd: &str) -> BTreeMap<String, Type> {
    let get =
        |tag: &BytesStart, name: &str| tag.try_get_attribute(name).unwrap().map(|a| a.value.to_string());
    let mut types: BTreeMap<String, Type> = BTreeMap::new();
    let mut bases: Vec<(String, String)> = Vec::new();
    let (mut reader, mut current) = (Reader::from_str(xsd), String::new());
    loop {
        let event = reader.read_event().unwrap();
        let (Event::Start(tag) | Event::Empty(tag)) = &event else {
            if event == Event::Eof {
                break;
            }
            continue;
        };
        let current_type = types.entry(current.clone()).or_default();
        match tag.name().into_inner() {
            "xs:complexType" | "xs:attributeGroup" if get(tag, "name").is_some() => {
                current = get(tag, "name").unwrap();
            }
            "xs:extension" => bases.push((current.clone(), get(tag, "base").unwrap())),
            "xs:attributeGroup" => bases.push((current.clone(), get(tag, "ref").unwrap())),
            "xs:attribute" => {
                let required = get(tag, "use").as_deref() == Some("required");
                let name = get(tag, "name").unwrap();
                assert_eq!(current_type.attributes.insert(name, required), None);
            }
            "xs:element" if !current.is_empty() => current_type.inside.push(get(tag, "name").unwrap()),
            _ => {}
        }
    }
    // Bases stand before what uses them, so theirs are complete.
    for (name, base) in bases {
        let base = types.get(&base).unwrap_or_else(|| panic!("no type {base}"));
        let (attributes, inside) = (base.attributes.clone(), base.inside.clone());
        let this = types.get_mut(&name).unwrap();
        this.attributes.extend(attributes);
        this.inside.extend(inside);
    }
    types
}

fn assert_same(xsd: &str, type_name: &str, kind: &Kind) {
    let types = types(xsd);
    let expected = Type {
        attributes: kind.words().map(|w| (w.name.to_string(), w.needed)).collect(),
        inside: kind.inside.iter().map(ToString::to_string).collect(),
    };
    assert_eq!(types.get(type_name), Some(&expected), "{type_name}");
}

#[test]
fn schemas_have_exactly_the_words_that_are_read() {
    for (name, kind) in [
        ("RootGroup", &ROOT),
        ("Group", &GROUP),
        ("Tree", &TREE),
        ("CoarseTree", &COARSE),
    ] {
        assert_same(SCENE_XSD, name, kind);
    }
    assert_same(OCTREE_XSD, "OctTree", &OCTREE);
    assert_same(OCTREE_XSD, "Node", &NODE);
}

/// An element with all its attributes but one.
fn element(kind: &Kind, without: Option<&str>) -> String {
    let words = kind.words().filter(|w| Some(w.name) != without);
    let all: Vec<String> = words.map(|w| format!("{}=\"{}\"", w.name, w.example)).collect();
    format!("<{} {}/>", kind.name, all.join(" "))
}

#[test]
fn scenes_need_exactly_the_words_that_are_needed() {
    for kind in SCENE {
        let parse = |text: String| {
            let inner = kind.words().all(|w| w.name != "Crs");
            let text = if inner {
                format!("<OctTreeGroup>{text}</OctTreeGroup>")
            } else {
                text
            };
            Scene::parse_usable(text.as_bytes()).unwrap().1
        };
        assert_eq!(parse(element(kind, None)), [], "{}", kind.name);
        for word in kind.words() {
            let faults = parse(element(kind, Some(word.name)));
            // Of a group of three or six, all or none are there.
            let together = [MIN, MAX, BRICK_SIZE].concat().contains(&word.name);
            assert_eq!(
                faults.len(),
                usize::from(word.needed || together),
                "{}: {faults:?}",
                word.name
            );
            for fault in faults {
                assert_eq!(fault.suggestion, example(word.name));
            }
        }
    }
}

#[test]
fn octrees_need_exactly_the_words_that_are_needed() {
    let node = "<Node Type=\"LEAF-CONST\" Color=\"#00000000\"/>";
    let whole = |root: String| root.replace("/>", &format!(">{node}</GigaVoxelsOctTree>"));
    octree_xml::decode(whole(element(&OCTREE, None)).as_bytes()).unwrap();
    for word in OCTREE.words() {
        let read = octree_xml::decode(whole(element(&OCTREE, Some(word.name))).as_bytes());
        assert_eq!(read.is_err(), word.needed, "{}", word.name);
    }
}

#[test]
fn near_words_are_found_and_far_ones_are_not() {
    let known = ["Radius", "TreeFile", "MinX", "MinY", "CenterX"];
    for (word, expected) in [
        ("Radios", Some("Radius")),
        ("radius", Some("Radius")),
        ("TreeFlie", Some("TreeFile")),
        ("Treefile", Some("TreeFile")),
        ("CentreX", Some("CenterX")),
        ("MinY", Some("MinY")),
        ("MniX", Some("MinX")),
        ("Colour", None),
        ("x", None),
        ("", None),
    ] {
        assert_eq!(nearest(word, known), expected, "{word}");
    }
    assert_eq!(nearest(&"long".repeat(100_000), known), None);
}
