//! `convert`: nothing is lost between forms of a database, and exports lie where the terrain is.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{brickfell, build_args, copy_of_example, files, shared};

fn convert(from: &Path, out: &Path, more: &[&str]) -> String {
    let path = |p: &Path| p.display().to_string();
    let mut args = vec!["convert".to_string(), path(from), "--out".into(), path(out)];
    args.extend(more.iter().map(ToString::to_string));
    brickfell(args).success().to_string()
}

/// The files that a scene consists of.
fn database(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = files(dir);
    files.retain(|name, _| !name.ends_with(".json"));
    files
}

fn check(dir: &Path) {
    brickfell(["check", &dir.display().to_string()]).success();
}

#[test]
fn nothing_is_lost_on_the_way_to_other_forms_and_back() {
    let db = shared().join("db");
    let dir = tempfile::tempdir().unwrap();
    let [readable, back] = ["readable", "back"].map(|name| dir.path().join(name));
    convert(
        &db,
        &readable,
        &["--octrees", "xml", "--chunk", "2", "--encoding", "plain"],
    );
    check(&readable);
    let there = database(&readable);
    let octree = there.iter().find(|(name, _)| name.ends_with(".oct")).unwrap().1;
    assert!(octree.starts_with(b"<?xml") || octree.starts_with(b"<GigaVoxelsOctTree"));
    let brick = there
        .iter()
        .find(|(name, _)| name.ends_with(".L03.brk"))
        .unwrap()
        .1;
    assert_eq!((brick[14], brick[16]), (1, 0), "chunks of 2³, plain");
    convert(&readable, &back, &["--octrees", "binary", "--chunk", "4"]);
    check(&back);
    assert!(database(&back) == database(&db));
}

#[test]
fn scenes_written_by_hand_become_binary() {
    let example = copy_of_example();
    let dir = tempfile::tempdir().unwrap();
    let [binary, xml] = ["binary", "xml"].map(|name| dir.path().join(name));
    convert(example.path(), &binary, &["--octrees", "binary"]);
    check(&binary);
    convert(&binary, &xml, &["--octrees", "xml"]);
    check(&xml);
    // Once more: what is written is read as the same.
    let again = dir.path().join("again");
    convert(&xml, &again, &["--octrees", "binary"]);
    assert!(database(&again) == database(&binary));
}

/// Corners of an OBJ's faces.
fn faces(path: &Path) -> Vec<[[f64; 3]; 4]> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut corners = Vec::new();
    let mut faces = Vec::new();
    for line in text.lines() {
        let values: Vec<f64> = line.split(' ').skip(1).map(|v| v.parse().unwrap()).collect();
        match line.as_bytes()[0] {
            b'v' => {
                assert!(values[3..].iter().all(|c| (0.0..=1.0).contains(c)) && values.len() == 6);
                corners.push([values[0], values[1], values[2]]);
            }
            _ => faces.push([0, 1, 2, 3].map(|k| corners[values[k] as usize - 1])),
        }
    }
    faces
}

#[test]
fn a_surface_lies_on_the_terrain_and_faces_outwards() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("surface.obj");
    for (level, voxel) in [("3", 0.25), ("1", 1.0)] {
        let said = convert(&shared().join("db"), &out, &["--level", level]);
        let faces = faces(&out);
        assert!(
            said.contains("faces") && faces.len() > (32.0 / voxel) as usize * 32,
            "{said}"
        );
        let up = |f: &&[[f64; 3]; 4]| f.iter().all(|c| c[2] == f[0][2]);
        let top = faces
            .iter()
            .filter(up)
            .max_by(|a, b| a[0][2].total_cmp(&b[0][2]))
            .unwrap();
        let [a, b, d] = [top[0], top[1], top[3]];
        let turn = (b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0]);
        assert!((turn - voxel * voxel).abs() < 1e-9, "{top:?}");
        // The box's roof is 20 m high.
        assert!((a[2] - 20.0).abs() <= voxel, "{top:?}");
    }
}

#[test]
fn points_have_colours_and_unit_normals_or_none() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("points.ply");
    let said = convert(&shared().join("db"), &out, &[]);
    let bytes = std::fs::read(&out).unwrap();
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = String::from_utf8(bytes[..body].to_vec()).unwrap();
    let count = header
        .lines()
        .find_map(|l| l.strip_prefix("element vertex "))
        .unwrap();
    let points: Vec<&[u8]> = bytes[body..].chunks(39).collect();
    assert_eq!(points.len(), count.parse::<usize>().unwrap());
    assert!(said.contains("points") && points.len() > 128 * 128);
    for p in &points {
        let x = f64::from_le_bytes(p[..8].try_into().unwrap());
        let n = [24, 28, 32].map(|k| f32::from_le_bytes(p[k..k + 4].try_into().unwrap()));
        let length = n.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((0.0..=32.0).contains(&x) && length < 1.01, "{x} {n:?}");
    }
    let coloured = points.iter().filter(|p| p[36..] != [0; 3]).count();
    assert!(coloured * 10 > points.len() * 9);
}

#[test]
fn what_is_there_is_left_alone() {
    let db = shared().join("db");
    let db = db.display().to_string();
    let line = brickfell(["convert", &db, "--out", &db]).error(1).to_string();
    assert!(line.contains("exists"), "{line}");
    let line = brickfell(["convert", &db, "--out", "/nowhere", "--level", "2"])
        .error(1)
        .to_string();
    assert!(line.contains("a level goes into a file"), "{line}");
    let line = brickfell(["convert", &db, "--out", "/nowhere/points.ply"])
        .error(1)
        .to_string();
    assert!(line.contains("/nowhere/points.ply"), "{line}");
}

#[test]
fn an_allowed_error_makes_databases_smaller_and_they_stay_sound() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = |db: &Path| {
        let files = database(db).into_iter();
        let bricks = files.filter(|(name, _)| name.ends_with(".brk"));
        bricks.map(|(_, bytes)| bytes.len()).sum::<usize>()
    };
    let before = bytes(&shared().join("db"));
    let converted = dir.path().join("converted");
    convert(&shared().join("db"), &converted, &["--error", "8"]);
    check(&converted);
    let built = dir.path().join("built");
    let mut args = build_args(&shared().join("inputs"), &built);
    args.extend(["--error", "8"].map(String::from));
    brickfell(&args).success();
    check(&built);
    for db in [&converted, &built] {
        assert!(bytes(db) < before, "{} of {before}", bytes(db));
    }
    let line = brickfell(args.iter().map(|a| if a == "8" { "16" } else { a }))
        .error(1)
        .to_string();
    assert!(line.contains("0 to 15"), "{line}");
}
