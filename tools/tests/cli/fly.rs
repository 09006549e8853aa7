//! `fly` and `render`: what they leave, and that damage is reported while the rest is still drawn. They draw: without a
//! Vulkan adapter they fail.

use std::fs;
use std::path::Path;
use std::process::Command;

use brickfell_formats::bricks::brick_file_name;
use serde_json::Value;

use crate::common::{
    Run, brickfell, copy_of_database, copy_of_example, edit, files, octrees, replace, run, shared,
};

const FRAMES: usize = 2;

fn fly(db: &Path, out: &Path) -> Run {
    let (db, out) = (db.display().to_string(), out.display().to_string());
    brickfell([
        "fly", &db, "--gpu", "--settle", "--frames", "2", "--size", "48x32", "--out", &out,
    ])
}

fn report(out: &Path) -> Value {
    let text = fs::read(out.join("report.json")).expect("a report");
    serde_json::from_slice(&text).expect("JSON")
}

/// Different colours in a frame: a picture of nothing but sky has few.
fn colors(out: &Path, frame: usize) -> usize {
    let image = image::open(out.join(format!("frame_{frame:04}.png")))
        .expect("a frame")
        .to_rgb8();
    assert_eq!(image.dimensions(), (48, 32));
    let below = image.rows().skip(16).flatten().map(|p| p.0);
    below.collect::<std::collections::BTreeSet<_>>().len()
}

/// A way to spoil a file.
type Damage = (&'static str, fn(&Path));

/// Wrong magic, unknown version, cut short, a flipped bit, missing.
const DAMAGES: [Damage; 5] = [
    ("wrong magic", |p| edit(p, |b| b[5] ^= 0xff)),
    ("version 9", |p| edit(p, |b| b[8] = 9)),
    ("", |p| edit(p, |b| b.truncate(b.len() / 2))),
    ("checksum", |p| edit(p, |b| b[68] ^= 1)),
    ("cannot be", |p| fs::remove_file(p).expect("the file")),
];

/// Spoils a different file in each way, flies, and checks: exit code 2, every frame there with most of the terrain in it,
/// each spoilt file listed once with what is wrong, and nothing else listed.
fn flies_over_damage(of_tree: impl Fn(&str) -> String) {
    let db = copy_of_database();
    let trees = octrees(db.path());
    // A group one of whose coarse trees was given up has no use for the others, so of those only one is sure to be read.
    let mut coarse = trees.iter().filter(|t| t.starts_with("trees/g"));
    let mut spoilt: Vec<String> = coarse.next().into_iter().map(|t| of_tree(t)).collect();
    let others = trees.iter().filter(|t| !t.starts_with("trees/g"));
    spoilt.extend(others.map(|t| of_tree(t)).take(DAMAGES.len() - spoilt.len()));
    assert_eq!(spoilt.len(), DAMAGES.len(), "{trees:?}");
    for (file, (_, damage)) in spoilt.iter().zip(DAMAGES) {
        damage(&db.path().join(file));
    }
    let out = tempfile::tempdir().unwrap();
    let run = fly(db.path(), out.path());
    assert_eq!(run.code, 2, "{}{}", run.out, run.err);
    let report = report(out.path());
    let faults: Vec<&str> = report["summary"]["faults"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect();
    for (file, (what, _)) in spoilt.iter().zip(DAMAGES) {
        let path = format!("{}: ", db.path().join(file).display());
        let about: Vec<&&str> = faults.iter().filter(|f| f.starts_with(&path)).collect();
        assert_eq!(about.len(), 1, "{path} in {faults:?}");
        assert!(
            about[0].contains(what) && !about[0].contains('\n'),
            "{}",
            about[0]
        );
        assert!(run.err.contains(*about[0]), "{}", run.err);
    }
    assert_eq!(faults.len(), spoilt.len(), "{faults:?}");
    assert_eq!(report["summary"]["frames"], FRAMES);
    for frame in 0..FRAMES {
        assert!(colors(out.path(), frame) > 20, "frame {frame} is empty");
    }
}

#[test]
fn a_settled_flight_leaves_frames_overview_and_report() {
    let out = tempfile::tempdir().unwrap();
    fs::write(out.path().join("frame_0099.png"), "of an earlier flight").unwrap();
    fs::write(out.path().join("notes.txt"), "mine").unwrap();
    fly(&shared().join("db"), out.path()).success();
    let names: Vec<String> = files(out.path()).into_keys().collect();
    assert_eq!(
        names,
        [
            "frame_0000.png",
            "frame_0001.png",
            "notes.txt",
            "overview.png",
            "report.json"
        ]
    );
    let report = report(out.path());
    let summary = &report["summary"];
    for key in [
        "frames",
        "seconds",
        "fps_median",
        "rays_per_second",
        "trees_total",
        "trees_active_max",
        "bricks_resident_max",
        "brick_slots",
        "ram_bytes_peak",
        "cache_bytes_peak",
        "gpu_bytes",
        "bytes_read",
        "bytes_uploaded",
        "uploads",
        "requests_last_frame",
        "holes",
        "nodes_per_ray",
        "samples_per_ray",
    ] {
        assert!(summary[key].is_number(), "{key}: {}", summary[key]);
    }
    for key in ["p50", "p95", "p99", "max"] {
        assert!(summary["frame_ms"][key].as_f64().unwrap() > 0.0, "{key}");
    }
    assert!(!summary["adapter"].as_str().unwrap().is_empty());
    assert_eq!(summary["faults"], Value::Array(Vec::new()));
    assert_eq!(
        (&summary["holes"], &summary["requests_last_frame"]),
        (&0.into(), &0.into())
    );
    assert_eq!(report["frames"].as_array().unwrap().len(), FRAMES);
    for frame in 0..FRAMES {
        assert!(colors(out.path(), frame) > 20, "frame {frame} is empty");
    }
}

#[test]
fn the_hand_written_example_flies() {
    let example = copy_of_example();
    let out = tempfile::tempdir().unwrap();
    fly(example.path(), out.path()).success();
    assert_eq!(report(out.path())["summary"]["trees_total"], 2);
}

#[test]
fn damaged_octrees_are_listed_and_the_rest_flies() {
    flies_over_damage(str::to_string);
}

#[test]
fn damaged_brick_files_are_listed_and_the_rest_flies() {
    // Coarse levels are needed whatever the camera.
    flies_over_damage(|tree| brick_file_name(tree, 0));
}

#[test]
fn a_hand_written_octree_with_an_unknown_attribute_is_listed_and_the_rest_flies() {
    let example = copy_of_example();
    replace(
        &example.path().join("east.xml"),
        "<Node Type",
        "<Node Taste=\"sweet\" Type",
    );
    let out = tempfile::tempdir().unwrap();
    let run = fly(example.path(), out.path());
    assert_eq!(run.code, 2, "{}{}", run.out, run.err);
    let report = report(out.path());
    let fault = report["summary"]["faults"][0].as_str().unwrap();
    assert!(
        fault.contains("east.xml: line ") && fault.contains("Taste"),
        "{fault}"
    );
}

#[cfg(unix)]
#[test]
fn a_tree_file_outside_the_folder_is_not_read() {
    let example = copy_of_example();
    let outside = tempfile::tempdir().unwrap();
    fs::rename(example.path().join("east.xml"), outside.path().join("east.xml")).unwrap();
    std::os::unix::fs::symlink(outside.path().join("east.xml"), example.path().join("east.xml")).unwrap();
    let out = tempfile::tempdir().unwrap();
    assert_eq!(fly(example.path(), out.path()).code, 2);
    assert!(
        report(out.path())["summary"]["faults"][0]
            .as_str()
            .unwrap()
            .contains("east.xml")
    );
}

#[test]
fn a_fault_in_one_element_of_the_scene_is_listed_and_the_rest_flies() {
    let example = copy_of_example();
    let out = example.path().join("flight");
    let scene = example.path().join("scene.xml");
    for (old, new) in [
        ("TreeFile=\"east.xml\"", "TreeFile=\"../east.xml\""),
        ("TreeFile=\"east.xml\"", "TreeFile=\"east.xml\" Colour=\"red\""),
        ("Compressed=\"NO\"", "Compressed=\"NO\" Colour=\"red\""),
    ] {
        replace(&scene, old, new);
        let run = fly(example.path(), &out);
        assert!(run.error(2).contains("scene.xml: line "), "{}", run.err);
        let summary = &report(&out)["summary"];
        assert_eq!(summary["faults"].as_array().unwrap().len(), 1);
        assert_ne!(summary["trees_active_max"], 0);
        replace(&scene, new, old);
    }
}

#[test]
fn a_scene_that_cannot_be_read_is_one_line_and_leaves_nothing() {
    let example = copy_of_example();
    let out = example.path().join("flight");
    let scene = example.path().join("scene.xml");
    replace(&scene, "</OctTreeGroup>", "</OctTreeGrope>");
    let run = fly(example.path(), &out);
    assert!(run.error(1).contains("scene.xml: line "), "{}", run.err);
    assert!(!out.exists());
    let run = fly(&example.path().join("nowhere"), &out);
    assert!(run.error(1).contains("nowhere") && !out.exists(), "{}", run.err);
}

#[test]
fn pictures_are_drawn_by_gpu_cpu_and_reference() {
    let dir = tempfile::tempdir().unwrap();
    let db = shared().join("db").display().to_string();
    let mut pictures = Vec::new();
    for by in ["--gpu", "--cpu", "--reference"] {
        let file = dir.path().join(format!("{by}.png"));
        let path = file.display().to_string();
        let mut args = vec![
            "render",
            &db,
            "--eye",
            "16,-30,40",
            "--target",
            "16,16,8",
            "--size",
            "40x30",
            "--out",
            &path,
        ];
        args.push(by);
        brickfell(args).success();
        let picture = image::open(&file).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (40, 30));
        pictures.push(picture);
    }
    let pairs = pictures[1].iter().zip(pictures[2].iter());
    let apart = pairs.filter(|(c, r)| c.abs_diff(**r) > 1).count();
    assert!(apart <= 3, "{apart} components");
    let file = dir.path().join("none.png").display().to_string();
    for (eye, fov) in [
        ("nan,0,0", "60"),
        ("0,0", "60"),
        ("0,0,50", "0"),
        ("0,0,50", "180"),
    ] {
        let run = brickfell([
            "render", &db, "--eye", eye, "--target", "1,1,0", "--fov", fov, "--out", &file,
        ]);
        assert_ne!(run.code, 0, "{eye} {fov}");
        assert!(!Path::new(&file).exists());
    }
}

#[test]
fn without_an_adapter_the_cpu_draws_unless_a_gpu_is_asked_for() {
    let out = tempfile::tempdir().unwrap();
    let db = shared().join("db");
    let hidden = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_brickfell"));
        // The Vulkan loader looks for drivers nowhere else then.
        command
            .args(args)
            .env("VK_ICD_FILENAMES", "/nowhere.json")
            .env("VK_DRIVER_FILES", "/nowhere.json");
        run(&mut command)
    };
    let (db, file) = (db.display().to_string(), out.path().join("a.png"));
    let path = file.display().to_string();
    let args = [
        "render",
        &db,
        "--eye",
        "16,-30,40",
        "--target",
        "16,16,8",
        "--out",
        &path,
    ];
    for args in [&[&args[..], &["--gpu"]].concat()[..], &["adapter"]] {
        let run = hidden(args);
        assert!(run.error(1).contains("adapter"), "{}", run.err);
        assert!(run.err.contains("mesa-vulkan-drivers"), "{}", run.err);
    }
    assert!(!file.exists());
    let run = hidden(&args);
    run.success();
    assert!(run.err.contains("the CPU draws"), "{}", run.err);
    assert!(file.exists());
}

#[test]
fn the_cpu_flies_settled_and_in_real_time() {
    let db = shared().join("db").display().to_string();
    for settle in [true, false] {
        let out = tempfile::tempdir().unwrap();
        let folder = out.path().display().to_string();
        let mut args = vec![
            "fly", &db, "--cpu", "--frames", "2", "--size", "48x32", "--out", &folder,
        ];
        args.extend(settle.then_some("--settle"));
        let run = brickfell(args);
        run.success();
        let summary = &report(out.path())["summary"];
        assert!(
            summary["adapter"].as_str().unwrap().starts_with("CPU"),
            "{summary}"
        );
        assert_eq!(summary["rays_capped"], 0);
        if settle {
            assert_eq!(
                (&summary["holes"], &summary["requests_last_frame"]),
                (&0.into(), &0.into())
            );
            assert!((0..2).all(|frame| colors(out.path(), frame) > 20));
        }
    }
}

#[cfg(unix)]
#[test]
fn a_video_is_made_where_there_is_a_program_for_it() {
    use std::os::unix::fs::PermissionsExt;
    let (out, programs) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let fly = || {
        run(Command::new(env!("CARGO_BIN_EXE_brickfell"))
            .args([
                "fly", "--cpu", "--settle", "--frames", "2", "--size", "48x32", "--video", "--out",
            ])
            .args([out.path(), &shared().join("db")])
            .env("PATH", programs.path()))
    };
    // None, one that fails, one that does what it is asked for: to write its last argument from the frames.
    let made = out.path().join("flight.mp4");
    let none = fly();
    assert!(
        none.success().contains("2 frames") && none.err.contains("no video"),
        "{}",
        none.err
    );
    let program = programs.path().join("ffmpeg");
    let write = |text: &str| {
        fs::write(&program, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    };
    write("echo no room >&2; exit 1");
    assert!(fly().error(1).contains("no room") && !made.exists());
    write("for last; do :; done; echo \"$@\" > \"$last\"");
    assert!(fly().success().contains("flight.mp4"));
    assert!(fs::read_to_string(&made).unwrap().contains("frame_%04d.png"));
    // It is the flight's own: the next one replaces it.
    fly().success();
}
