//! Paging from outside: terrains that are made as they are read, traces, what `check` and `info` say of a scene graph. Some draw:
//! without a Vulkan adapter they fail.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::brickfell;

const TERRAIN: &str = "procedural:5?extent=600m&voxel=1&depth=3";

#[test]
fn a_terrain_of_a_seed_is_flown_twice_alike_and_its_trace_is_summed_up() {
    let dir = tempfile::tempdir().unwrap();
    let fly = |name: &str| {
        let out = dir.path().join(name).display().to_string();
        let trace = format!("{out}.json");
        let run = brickfell([
            "fly", TERRAIN, "--gpu", "--settle", "--frames", "2", "--size", "48x32", "--out", &out,
            "--trace", &trace,
        ]);
        run.success();
        let frame = |k: usize| fs::read(format!("{out}/frame_{k:04}.png")).unwrap();
        ([frame(0), frame(1)], trace)
    };
    let ((first, trace), (second, _)) = (fly("a"), fly("b"));
    assert!(first == second, "a seed is one terrain");
    let report: Value = serde_json::from_slice(&fs::read(dir.path().join("a/report.json")).unwrap()).unwrap();
    assert_eq!(report["summary"]["holes"], 0);
    assert_eq!(report["summary"]["trees_total"], 100);

    let text = fs::read_to_string(&trace).unwrap();
    let events: Value = serde_json::from_str(&text).unwrap();
    let events = events["traceEvents"].as_array().unwrap();
    let loaded: u64 = events
        .iter()
        .filter(|e| e["name"] == "pages")
        .map(|e| e["args"]["loaded"].as_u64().unwrap())
        .sum();
    let stats = brickfell(["stats", &trace]);
    let text = stats.success();
    assert!(text.starts_with("2 frames in "), "{text}");
    assert!(
        loaded > 20 && text.contains(&format!("{loaded} loaded")),
        "{loaded}: {text}"
    );
}

#[test]
fn terrains_that_cannot_be_made_are_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out").display().to_string();
    for (terrain, what) in [
        ("procedural:", "a terrain is SEED"),
        ("procedural:1?colour=red", "`colour=red`"),
        ("procedural:1?voxel=0", "a voxel of 0 m is not usable"),
        ("procedural:1?extent=1e9&voxel=0.1", "not usable"),
        ("procedural:1?extent=1000km&voxel=0.1", "too many"),
    ] {
        let run = brickfell(["fly", terrain, "--out", &out]);
        let error = run.error(1);
        assert!(error.starts_with(terrain) && error.contains(what), "{error}");
    }
}

#[test]
fn what_is_no_trace_is_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("t.json");
    let file_name = file.display().to_string();
    for (content, what) in [
        ("", "EOF"),
        ("{\"traceEvents\":[", "EOF"),
        ("{\"traceEvents\":3}", "invalid type"),
        ("{\"traceEvents\":[]}", "it has no frame"),
    ] {
        fs::write(&file, content).unwrap();
        let run = brickfell(["stats", &file_name]);
        let error = run.error(1);
        assert!(error.starts_with(&file_name) && error.contains(what), "{error}");
    }
    fs::remove_file(&file).unwrap();
    assert!(brickfell(["stats", &file_name]).error(1).contains("No such file"));
}

/// A scene of trees of 4 m with constant nodes only, at these corners and of these sides.
fn scene(dir: &Path, boxes: &[[f64; 3]]) {
    let mut scene = "<OctTreeGroup Version=\"1\">\n".to_owned();
    for (k, [x, y, z]) in boxes.iter().enumerate() {
        let octree = format!(
            "<GigaVoxelsOctTree X=\"{x}\" Y=\"{y}\" Z=\"{z}\" DeltaX=\"0.5\" DeltaY=\"0.5\" DeltaZ=\"0.5\" VolumeXSize=\"4\" \
             VolumeYSize=\"4\" VolumeZSize=\"4\" BrickXSize=\"8\" BrickYSize=\"8\" BrickZSize=\"8\" Binary=\"NO\">\
             <Node Type=\"LEAF-CONST\" Color=\"#6a9e4aff\"/></GigaVoxelsOctTree>"
        );
        fs::write(dir.join(format!("{k}.xml")), octree).unwrap();
        scene += &format!(
            "<PagedOctTree CenterX=\"{}\" CenterY=\"{}\" CenterZ=\"{}\" Radius=\"4\" TreeFile=\"{k}.xml\"/>\n",
            x + 2.0,
            y + 2.0,
            z + 2.0
        );
    }
    fs::write(dir.join("scene.xml"), scene + "</OctTreeGroup>\n").unwrap();
}

#[test]
fn trees_that_hide_each_other_in_a_circle_are_a_warning_and_are_drawn() {
    let dir = tempfile::tempdir().unwrap();
    // Each of the three is before the next on one axis and behind it on another.
    let circle = [[0.0, 3.0, 4.0], [4.0, 0.0, 3.0], [3.0, 4.0, 0.0]];
    scene(dir.path(), &circle);
    let db = dir.path().display().to_string();
    let check = brickfell(["check", &db]);
    let text = check.success();
    assert!(
        text.contains("scene.xml: file: seen from") && text.contains("in a circle"),
        "{text}"
    );
    let out = dir.path().join("picture.png").display().to_string();
    brickfell([
        "render",
        "--gpu",
        &db,
        "--eye",
        "-20,-20,-20",
        "--target",
        "4,4,4",
        "--size",
        "48x32",
        "--out",
        &out,
    ])
    .success();
    let image = image::open(&out).unwrap().to_rgb8();
    assert!(image.pixels().any(|p| p.0[1] > p.0[2]), "green, not sky");

    scene(dir.path(), &[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [8.0, 0.0, 1.0]]);
    let check = brickfell(["check", &db]);
    assert!(
        check.success().contains("no faults, no warnings"),
        "{}",
        check.out
    );
}
