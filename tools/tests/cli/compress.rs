//! `build --compress`: what the other commands make of it, and scenes that say the wrong thing.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use serde_json::Value;
use tempfile::TempDir;

use crate::common::{an_octree, brickfell, build_args, copy_of_database, files, replace, shared};

/// The shared database's inputs, block-compressed.
fn compressed() -> &'static Path {
    static SHARED: OnceLock<TempDir> = OnceLock::new();
    SHARED
        .get_or_init(|| {
            let dir = tempfile::tempdir().unwrap();
            let mut args = build_args(&shared().join("inputs"), &dir.path().join("db"));
            args.push("--compress".into());
            brickfell(args).success();
            dir
        })
        .path()
}

fn run(command: &str, db: &Path, more: &[&str]) -> crate::common::Run {
    let mut args = vec![command.to_string(), db.display().to_string()];
    args.extend(more.iter().map(ToString::to_string));
    brickfell(args)
}

#[test]
fn a_compressed_database_is_sound_and_says_what_it_is() {
    let db = compressed().join("db");
    assert!(
        run("check", &db, &[])
            .success()
            .ends_with("no faults, no warnings\n")
    );
    let scene = fs::read_to_string(db.join("scene.xml")).unwrap();
    assert!(scene.contains("Compressed=\"YES\"") && !scene.contains("Compressed=\"NO\""));
    let info = |db: &Path| -> Value { serde_json::from_str(run("info", db, &["--json"]).success()).unwrap() };
    let (blocks, samples) = (info(&db), info(&shared().join("db")));
    assert_eq!(
        (&blocks["compressed"], &samples["compressed"]),
        (&true.into(), &false.into())
    );
    for key in ["trees", "bricks", "voxels", "levels", "bounds"] {
        assert_eq!(blocks[key], samples[key], "{key}");
    }
    for (name, bytes) in files(&db).iter().filter(|(name, _)| name.ends_with(".brk")) {
        assert_eq!(bytes[16], 5, "{name}");
    }
    // Octrees are the same: blocks change neither what is there nor where.
    let octrees = |db: &Path| {
        let mut all = files(db);
        all.retain(|name, _| name.ends_with(".oct"));
        all
    };
    assert!(octrees(&db) == octrees(&shared().join("db")));
}

#[test]
fn the_other_encoding_is_another_database() {
    let db = copy_of_database();
    let mut args = build_args(&shared().join("inputs"), db.path());
    args.push("--compress".into());
    let run = brickfell(args);
    assert!(run.error(1).contains("built from other"), "{}", run.err);
}

#[test]
fn it_is_exported_but_not_converted() {
    let (db, dir) = (compressed().join("db"), tempfile::tempdir().unwrap());
    let to = |name: &str| dir.path().join(name).display().to_string();
    let refused = run("convert", &db, &["--out", &to("new")]);
    assert!(
        refused.error(1).contains("bricks are block-compressed"),
        "{}",
        refused.err
    );
    assert!(!dir.path().join("new").exists());
    run("convert", &db, &["--out", &to("all.ply"), "--level", "2"]).success();
    run(
        "convert",
        &shared().join("db"),
        &["--out", &to("same.ply"), "--level", "2"],
    )
    .success();
    // Points are where a voxel is mostly opaque: a few are at the verge of it.
    let points = |name: &str| -> f64 {
        let bytes = fs::read(dir.path().join(name)).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let count = text.lines().find_map(|l| l.strip_prefix("element vertex "));
        count.unwrap().parse().unwrap()
    };
    let (coded, lossless) = (points("all.ply"), points("same.ply"));
    assert!(
        (coded / lossless - 1.0).abs() < 0.01,
        "{coded} points, {lossless} without loss"
    );
}

#[test]
fn a_scene_that_says_the_wrong_thing_is_found() {
    let db = copy_of_database();
    let scene = db.path().join("scene.xml");
    let text = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, text.replace("Compressed=\"NO\"", "Compressed=\"YES\"")).unwrap();
    let check = run("check", db.path(), &[]);
    let reason = "byte 16: its bricks are not block-compressed, but the scene says Compressed=\"YES\"";
    assert_eq!(check.code, 1);
    assert!(check.out.contains(reason), "{}", check.out);
    let dir = tempfile::tempdir().unwrap();
    let picture = dir.path().join("a.png").display().to_string();
    let view = [
        "--eye",
        "-10,-10,30",
        "--target",
        "16,16,4",
        "--size",
        "16x12",
        "--gpu",
        "--out",
    ];
    let render = run("render", db.path(), &[&view[..], &[&picture]].concat());
    assert!(
        render.code != 0 && render.err.contains("not block-compressed, which the scene says"),
        "{}",
        render.err
    );

    // The other way round it is drawn, from samples.
    let db = tempfile::tempdir().unwrap();
    for (name, bytes) in files(&compressed().join("db")) {
        let path = db.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    let scene = db.path().join("scene.xml");
    let text = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, text.replace("Compressed=\"YES\"", "Compressed=\"NO\"")).unwrap();
    assert!(an_octree(db.path()).ends_with(".oct"));
    let check = run("check", db.path(), &[]);
    assert!(
        check
            .out
            .contains("byte 16: its bricks are block-compressed, but the scene says"),
        "{}",
        check.out
    );
    let view = [&view[..], &[&picture]].concat();
    run("render", db.path(), &view).success();
    // With one group of each kind the scene is drawn from samples, too.
    replace(&scene, "Compressed=\"NO\"", "Compressed=\"YES\"");
    run("render", db.path(), &view).success();
}
