//! Height maps of several formats and systems, through the program.

use std::fs;
use std::path::Path;

use crate::common::brickfell;

const SIDE: u32 = 33;

/// Metres.
fn height(column: u32, row: u32) -> i32 {
    50 + ((column * 5 + row * 3) % 23) as i32
}

fn build(heights: &Path, more: &[&str], out: &Path) -> String {
    let path = |p: &Path| p.display().to_string();
    let mut args = vec!["build".into(), "--heights".into(), path(heights)];
    args.extend(more.iter().map(|a| a.to_string()));
    args.extend(["--tree".into(), "64".into(), "--out".into(), path(out)]);
    let run = brickfell(args);
    run.success();
    run.err
}

/// Names and bytes of the trees.
fn trees(out: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for tree in fs::read_dir(out.join("trees")).unwrap().flatten() {
        for file in fs::read_dir(tree.path()).unwrap().flatten() {
            let name = format!("{:?}/{:?}", tree.file_name(), file.file_name());
            all.push((name, fs::read(file.path()).unwrap()));
        }
    }
    all.sort();
    assert!(!all.is_empty());
    all
}

#[test]
fn one_terrain_in_three_formats_builds_the_same_trees() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let grey = image::ImageBuffer::from_fn(SIDE, SIDE, |c, r| image::Luma([height(c, r) as u16]));
    grey.save(dir.join("grey.png")).unwrap();
    let rgb = image::RgbImage::from_fn(SIDE, SIDE, |c, r| {
        let code = (height(c, r) + 32_768) as u32;
        image::Rgb([(code >> 8) as u8, code as u8, 0])
    });
    rgb.save(dir.join("rgb.png")).unwrap();
    for name in ["grey.pgw", "rgb.pgw"] {
        fs::write(
            dir.join(name),
            format!("2\n0\n0\n-2\n101\n{}\n", 200 + 2 * SIDE - 1),
        )
        .unwrap();
    }
    let mut text = format!("ncols {SIDE}\nnrows {SIDE}\nxllcorner 100\nyllcorner 200\ncellsize 2\n");
    for row in 0..SIDE {
        let line: Vec<String> = (0..SIDE).map(|c| height(c, row).to_string()).collect();
        text += &(line.join(" ") + "\n");
    }
    fs::write(dir.join("text.asc"), text).unwrap();
    build(&dir.join("grey.png"), &[], &dir.join("grey"));
    build(&dir.join("text.asc"), &[], &dir.join("text"));
    build(
        &dir.join("rgb.png"),
        &["--terrain-rgb", "terrarium"],
        &dir.join("rgb"),
    );
    let grey = trees(&dir.join("grey"));
    assert!(grey == trees(&dir.join("text")) && grey == trees(&dir.join("rgb")));
    let refused = brickfell([
        "build".into(),
        "--heights".into(),
        dir.join("rgb.png").into_os_string(),
        "--out".into(),
        dir.join("none").into_os_string(),
    ]);
    assert!(refused.error(1).contains("--terrain-rgb"));
    assert!(!dir.join("none").exists());
}

#[test]
fn degrees_are_placed_around_their_middle_and_guessed_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let tile = dir.join("N46W122.hgt");
    let heights = (0..SIDE).flat_map(|r| (0..SIDE).map(move |c| height(c, r) as i16));
    fs::write(&tile, heights.flat_map(i16::to_be_bytes).collect::<Vec<u8>>()).unwrap();
    let out = dir.join("tile");
    assert!(!build(&tile, &["--voxel", "2000"], &out).contains("warning"));
    let scene = fs::read_to_string(out.join("scene.xml")).unwrap();
    assert!(scene.contains("+lon_0=-121.5 +lat_0=46.5"), "{scene}");

    let mut text = String::from("ncols 20\nnrows 20\nxllcorner -119.8\nyllcorner 34.4\ncellsize 0.0001\n");
    text += &"5 ".repeat(400);
    let grid = dir.join("grid.asc");
    fs::write(&grid, text).unwrap();
    let warned = build(&grid, &[], &dir.join("grid"));
    assert!(
        warned.contains("warning") && warned.contains("degrees"),
        "{warned}"
    );
}
