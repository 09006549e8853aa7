//! `build`, `demo` and the program as a whole: bad input, and what becomes of an output folder that is not empty.

use std::fs;
use std::path::Path;

use crate::common::{brickfell, build_args, files, shared};
use crate::inputs;

/// Builds in a fresh folder after `spoil` changed the inputs and perhaps the arguments; gives the error line, after the
/// checks that it names `file` and that nothing was written.
fn refused(file: &str, spoil: impl FnOnce(&Path, &mut Vec<String>)) -> String {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("inputs"), dir.path().join("db"));
    inputs::write(&input);
    let mut args = build_args(&input, &out);
    spoil(&input, &mut args);
    let run = brickfell(&args);
    let line = run.error(1).to_string();
    assert!(line.contains(file), "{line} does not name {file}");
    assert!(!out.exists(), "{line}: something was written");
    line
}

fn set(args: &mut [String], option: &str, value: &str) {
    let place = args.iter().position(|a| a == option).expect("the option");
    args[place + 1] = value.to_string();
}

#[test]
fn inputs_that_are_missing_or_no_files_are_named() {
    for file in ["box.obj", "heights.png", "imagery.png"] {
        let line = refused(file, |dir, _| fs::remove_file(dir.join(file)).unwrap());
        assert!(line.contains("No such file"), "{line}");
        refused(file, |dir, _| {
            fs::remove_file(dir.join(file)).unwrap();
            fs::create_dir(dir.join(file)).unwrap();
        });
    }
}

#[test]
fn a_mesh_with_nan_or_nothing_in_it_is_refused() {
    for number in ["nan", "NaN", "inf", "1e999", "twelve"] {
        let line = refused("box.obj", |dir, _| {
            let text = inputs::box_obj().replace("v 14 10 5\n", &format!("v 14 {number} 5\n"));
            fs::write(dir.join("box.obj"), text).unwrap();
        });
        assert!(line.contains("line 8"), "{number}: {line}");
    }
    for text in ["", "# nothing\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"] {
        let line = refused("box.obj", |dir, _| fs::write(dir.join("box.obj"), text).unwrap());
        assert!(line.contains("no triangles"), "{line}");
    }
    let line = refused("box.obj", |dir, _| {
        fs::write(dir.join("box.obj"), inputs::box_obj() + "f 1 2 9\n").unwrap();
    });
    assert!(line.contains("line 21") && line.contains('9'), "{line}");
}

#[test]
fn images_shorter_or_larger_than_they_should_be_are_refused() {
    for file in ["heights.png", "imagery.png", "wall.png"] {
        for keep in [0, 20, 40, 60] {
            refused(file, |dir, _| {
                let bytes = fs::read(dir.join(file)).unwrap();
                fs::write(dir.join(file), &bytes[..keep * bytes.len() / 100]).unwrap();
            });
        }
        for (width, height) in [(0, 64), (4_000_000_000, 4_000_000_000), (60_000, 60_000)] {
            refused(file, |dir, _| {
                fs::write(dir.join(file), inputs::png_claiming(width, height)).unwrap();
            });
        }
    }
    // A picture of somewhere else.
    let line = refused("imagery.png", |dir, _| {
        fs::write(dir.join("imagery.pgw"), "0.5\n0\n0\n-0.5\n9000\n9000\n").unwrap();
    });
    assert!(line.contains("does not overlap"), "{line}");
    let line = refused("heights.pgw", |dir, _| {
        fs::write(dir.join("heights.pgw"), "0.5\n0\nzero\n-0.5\n0.25\n31.75\n").unwrap();
    });
    assert!(line.contains("zero"), "{line}");
}

#[test]
fn arguments_out_of_range_are_refused() {
    for voxel in ["0", "-1", "nan", "inf", "1e-300"] {
        let line = refused("voxel", |_, args| set(args, "--voxel", voxel));
        assert!(line.contains("positive length"), "{voxel}: {line}");
    }
    for tree in ["0", "8", "100", "16384"] {
        refused(tree, |_, args| set(args, "--tree", tree));
    }
    assert_eq!(
        brickfell(["build", "--out", "never-written"]).error(1),
        "no input: name OBJ files or height maps"
    );
    let run = brickfell([
        "build",
        "--imagery",
        "a.png",
        "--heights",
        "b.png",
        "--out",
        "never-written",
    ]);
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(
        run.err.contains("a.png belongs to the --heights before it"),
        "{}",
        run.err
    );
    assert!(!Path::new("never-written").exists());
}

#[test]
fn a_folder_of_something_else_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("trees")).unwrap();
    fs::write(dir.path().join("trees/oak.txt"), "mine").unwrap();
    let before = files(dir.path());
    for force in [false, true] {
        let mut args = build_args(&shared().join("inputs"), dir.path());
        args.extend(force.then(|| "--force".to_string()));
        let line = brickfell(args).error(1).to_string();
        assert!(line.contains(&dir.path().display().to_string()), "{line}");
        assert_eq!(files(dir.path()), before);
    }
    let file = dir.path().join("trees/oak.txt");
    let line = brickfell(build_args(&shared().join("inputs"), &file))
        .error(1)
        .to_string();
    assert!(line.contains("oak.txt"), "{line}");
    assert_eq!(files(dir.path()), before);
}

#[test]
fn a_database_is_resumed_refused_or_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("inputs"), dir.path().join("db"));
    inputs::write(&input);
    let args = build_args(&input, &out);
    let first = brickfell(&args);
    assert!(!first.success().contains("earlier run"), "{}", first.out);
    let whole = files(&out);
    assert!(whole.len() > 8 && whole.contains_key("scene.xml"));

    // As if it had been killed: scene, coarse trees and a tree are not there, another tree is half written.
    let folders = fs::read_dir(out.join("trees"))
        .unwrap()
        .map(|e| e.unwrap().path());
    let (coarse, trees): (Vec<_>, Vec<_>) = folders.partition(|f| {
        f.file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with('g'))
    });
    assert!(!coarse.is_empty());
    coarse
        .iter()
        .for_each(|folder| fs::remove_dir_all(folder).unwrap());
    fs::remove_file(out.join("scene.xml")).unwrap();
    fs::remove_dir_all(&trees[0]).unwrap();
    let mut partial = trees[1].clone().into_os_string();
    partial.push(".partial");
    fs::rename(&trees[1], &partial).unwrap();
    let resumed = brickfell(&args);
    let text = format!("{} of them from an earlier run", trees.len() - 2);
    assert!(resumed.success().contains(&text), "{}", resumed.out);
    assert!(files(&out) == whole, "a resumed database differs");
    assert!(brickfell(&args).success().contains("from an earlier run"));
    assert!(files(&out) == whole);

    let mut other = args.clone();
    set(&mut other, "--voxel", "0.5");
    let line = brickfell(&other).error(1).to_string();
    assert!(
        line.contains(&out.display().to_string()) && line.contains("--force"),
        "{line}"
    );
    assert!(files(&out) == whole, "a refused build wrote something");
    other.push("--force".into());
    assert!(brickfell(&other).success().contains("voxels of 0.5 m"));
    assert!(files(&out) != whole);
    brickfell(["check", &out.display().to_string()]).success();

    // An input that changed makes it another database.
    brickfell(args.iter().chain([&"--force".to_string()])).success();
    fs::write(input.join("box.obj"), inputs::box_obj().replace("v 10 ", "v 11 ")).unwrap();
    assert!(brickfell(&args).error(1).contains("--force"));
    assert!(files(&out) == whole);
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let dir = tempfile::tempdir().unwrap();
    let mut args = build_args(&shared().join("inputs"), &dir.path().join("db"));
    args.extend(["--threads".into(), "1".into()]);
    brickfell(args).success();
    assert!(files(&dir.path().join("db")) == files(&shared().join("db")));
}

#[test]
fn the_demo_is_written_and_sizes_that_cannot_be_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo").display().to_string();
    let run = brickfell(["demo", "--size", "48", "--seed", "3", "--out", &out]);
    assert!(run.success().contains("next: brickfell build "), "{}", run.out);
    let written = files(&dir.path().join("demo"));
    for name in ["heights.png", "imagery.png", "trees.obj"] {
        assert!(written.contains_key(name), "{name}");
    }
    let other = dir.path().join("other").display().to_string();
    for size in ["0", "-5", "nan", "1e9"] {
        brickfell(["demo", "--size", size, "--out", &other]).error(1);
    }
    assert!(!dir.path().join("other").exists());
}

#[test]
fn help_names_every_command_and_wrong_usage_exits_with_2() {
    let help = brickfell(["--help"]);
    for command in [
        "build", "fly", "render", "convert", "info", "check", "bench", "demo",
    ] {
        assert!(help.success().contains(&format!("\n  {command} ")), "{command}");
        brickfell([command, "--help"]).success();
    }
    for args in [&["fly"][..], &["info"], &["build", "a.obj"], &["dance"], &[]] {
        let run = brickfell(args);
        assert_eq!((run.code, run.out.as_str()), (2, ""), "{args:?}");
    }
}
