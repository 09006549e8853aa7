//! `new`: what it writes is sound, says how to go on, and never takes the place of anything.

use std::fs;

use crate::common::{brickfell, files, replace};
use crate::schema::validates;

#[test]
fn a_scene_to_begin_with_is_sound_and_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let (new, flight) = (dir.path().join("new"), dir.path().join("flight"));
    let [scene, out] = [&new, &flight].map(|p| p.display().to_string());
    let run = brickfell(["new", &scene]);
    assert!(
        run.success().contains(&format!("brickfell fly {scene}")),
        "{}",
        run.out
    );
    let check = brickfell(["check", &scene]);
    assert!(
        check.success().ends_with(": no faults, no warnings\n"),
        "{}",
        check.out
    );
    assert!(
        check.out.starts_with("2 trees") && !check.out.contains(" 0 bricks"),
        "{}",
        check.out
    );
    for (schema, file) in [("scene.xsd", "scene.xml"), ("octree.xsd", "tower.xml")] {
        if let Some((valid, said)) = validates(schema, &new.join(file)) {
            assert!(valid, "{said}");
        }
        let model = format!("<?xml-model href=\"{schema}\"?>");
        assert!(fs::read_to_string(new.join(file)).unwrap().contains(&model));
        assert!(new.join(schema).is_file());
    }
    brickfell([
        "fly", &scene, "--settle", "--frames", "1", "--size", "64x36", "--out", &out, "--quiet",
    ])
    .success();
    let frame = image::open(flight.join("frame_0000.png")).unwrap().to_rgb8();
    let ground = frame.pixels().filter(|p| p.0[2] < p.0[0].max(p.0[1])).count();
    assert!(ground > 64 * 36 / 20, "{ground} pixels");

    // What its comments say to try.
    replace(&new.join("scene.xml"), "MaxX=\"80\"", "MaxX=\"32\"");
    assert!(
        brickfell(["check", &scene])
            .success()
            .ends_with(": no faults, no warnings\n")
    );
}

#[test]
fn what_is_there_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().display().to_string();
    fs::write(dir.path().join("mine.txt"), "mine").unwrap();
    let run = brickfell(["new", &path]);
    assert!(
        run.error(1).contains("there is something in it already"),
        "{}",
        run.err
    );
    assert_eq!(files(dir.path()).len(), 1);
    let file = dir.path().join("mine.txt").display().to_string();
    brickfell(["new", &file]).error(1);
    assert_eq!(files(dir.path())["mine.txt"], b"mine");
}
