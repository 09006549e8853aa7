//! `info`: its keys, and that its figures are those of the files.

use std::fs;

use serde_json::Value;

use crate::common::{
    an_octree, brickfell, copy_of_database, copy_of_example, files, largest_brick_file, shared,
};

fn info(db: &std::path::Path) -> Value {
    let run = brickfell(["info", &db.display().to_string(), "--json"]);
    serde_json::from_str(run.success()).expect("JSON")
}

#[test]
fn the_figures_are_those_of_the_files() {
    let db = shared().join("db");
    let info = info(&db);
    let mut keys: Vec<&str> = info.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    let expected = [
        "bounds",
        "bricks",
        "bytes",
        "bytes_per_level",
        "bytes_per_voxel",
        "coarse_bytes",
        "coarse_trees",
        "compressed",
        "crs",
        "levels",
        "trees",
        "voxel_size",
        "voxels",
    ];
    assert_eq!(keys, expected);
    let number = |key: &str| info[key].as_u64().unwrap();
    let files = files(&db);
    // Folders of coarse trees begin with a g.
    let coarse = |name: &str| name.contains("trees/g");
    let ending =
        |end: &'static str| (files.iter()).filter(move |(name, _)| name.ends_with(end) && !coarse(name));
    assert_eq!(number("trees"), ending(".oct").count() as u64);
    let coarse_files = || files.iter().filter(|(name, _)| coarse(name));
    assert_eq!(
        (number("coarse_trees"), number("coarse_bytes")),
        (
            coarse_files().filter(|(name, _)| name.ends_with(".oct")).count() as u64,
            coarse_files().map(|(_, bytes)| bytes.len() as u64).sum()
        )
    );
    assert_eq!(number("levels"), 4, "8 · 2³ voxels");
    assert_eq!(
        number("bytes"),
        files.values().map(|b| b.len() as u64).sum::<u64>()
    );
    let bricks = ending(".brk").map(|(_, b)| u64::from(u32::from_le_bytes([b[24], b[25], b[26], b[27]])));
    assert_eq!(number("bricks"), bricks.sum::<u64>());
    let per_level: Vec<u64> = info["bytes_per_level"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_u64().unwrap())
        .collect();
    let of_trees = ending(".brk").chain(ending(".oct")).map(|(_, b)| b.len() as u64);
    assert_eq!(
        (per_level.len(), per_level.iter().sum::<u64>()),
        (4, of_trees.sum())
    );
    let finest: u64 = ending(".L03.brk").map(|(_, b)| b.len() as u64).sum();
    assert!(per_level[3] >= finest && per_level[3] < finest + finest / 2);

    // The ground has 128 × 128 columns of 0.25 m; slopes and the box add to them.
    assert!(
        (16_384..60_000).contains(&number("voxels")),
        "{}",
        number("voxels")
    );
    let ratio = number("bytes") as f64 / number("voxels") as f64;
    assert!((info["bytes_per_voxel"].as_f64().unwrap() - ratio).abs() < 1e-9);
    assert_eq!(info["voxel_size"], 0.25);
    assert!(info["crs"].is_null());
    let corner = |key: &str| -> Vec<f64> {
        let values = info["bounds"][key].as_array().unwrap();
        values.iter().map(|v| v.as_f64().unwrap()).collect()
    };
    // Ground from 2 to 18 m high over 0 to 32 m, the box up to 20 m; a voxel of tolerance for surfaces on lattice planes.
    for (value, expected) in corner("min")
        .into_iter()
        .chain(corner("max"))
        .zip([0.0, 0.0, 2.0, 32.0, 32.0, 20.0])
    {
        assert!((value - expected).abs() <= 0.5, "{value} for {expected}");
    }
    let text = brickfell(["info", &db.display().to_string()]);
    assert!(text.success().contains("voxel size      0.25 m"), "{}", text.out);
}

#[test]
fn hand_written_scenes_have_figures_too() {
    let example = copy_of_example();
    let info = info(example.path());
    assert_eq!(
        (info["trees"].as_u64(), info["voxels"].as_u64()),
        (Some(2), Some(0))
    );
    assert!(info["bytes_per_voxel"].is_null());
    assert_eq!(info["bounds"]["max"][2], 24.0);
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let line = brickfell(["info", "/nowhere/at/all"]).error(1).to_string();
    assert!(line.contains("/nowhere/at/all"), "{line}");
    let db = copy_of_database();
    let brick = largest_brick_file(db.path());
    fs::remove_file(db.path().join(&brick)).unwrap();
    let line = brickfell(["info", &db.path().display().to_string()])
        .error(1)
        .to_string();
    assert!(line.contains(&brick), "{line}");
    let octree = an_octree(db.path());
    fs::write(db.path().join(&octree), "not an octree").unwrap();
    let line = brickfell(["info", &db.path().display().to_string()])
        .error(1)
        .to_string();
    assert!(line.contains(&octree) || line.contains(&brick), "{line}");
}
