//! `slice`: pixels are what the database has at their places.

use std::path::Path;

use image::RgbaImage;

use crate::common::{brickfell, copy_of_example, shared};

const ROCK: [u8; 4] = [0x6f, 0x6a, 0x66, 255];
const SOIL: [u8; 4] = [0xc2, 0x96, 0x58, 255];
const GRASS: [u8; 4] = [0x6a, 0x9e, 0x4a, 255];
const SANDSTONE: [u8; 4] = [0xee, 0xe2, 0xc8, 255];

fn slice(db: &Path, more: &[&str]) -> (RgbaImage, String) {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("slice.png");
    let [db, file] = [db, &out].map(|p| p.display().to_string());
    let run = brickfell(["slice", &db, "--out", &file].iter().chain(more));
    (image::open(&out).unwrap().to_rgba8(), run.success().to_string())
}

#[test]
fn cuts_show_what_the_example_says() {
    let example = copy_of_example();
    let (image, said) = slice(example.path(), &["--axis", "y", "--at", "20", "--voxel", "0.5"]);
    assert_eq!(image.dimensions(), (96, 64));
    for part in [
        "96 × 64 pixels of 0.5 m, cut at y = 20 m, levels 2 to 3 of 2 trees",
        "z from -8 to 24 m up",
    ] {
        assert!(said.contains(part), "{said}");
    }
    let at = |x: f64, z: f64| image.get_pixel((x * 2.0) as u32, ((24.0 - z) * 2.0) as u32).0;
    for (x, top) in [(4.0, 24.0), (12.0, 16.0), (20.0, 8.0), (28.0, 0.0)] {
        assert_eq!((at(x, -7.9), at(x, top - 0.1)), (ROCK, GRASS), "x = {x}");
        if top < 23.0 {
            assert_eq!(at(x, top + 0.6)[3], 0, "x = {x}");
        }
    }
    // No tree is there.
    assert_eq!(at(40.0, 20.0)[3], 0);
    let (x, _) = slice(example.path(), &["--axis", "x", "--at", "4", "--level", "3"]);
    assert_eq!(
        (x.dimensions(), x.get_pixel(40, 0).0, x.get_pixel(40, 63).0),
        ((64, 64), GRASS, ROCK)
    );
    let (z, _) = slice(
        example.path(),
        &["--axis", "z", "--at", "12", "--level", "3", "--checker"],
    );
    let at = |x: u32| z.get_pixel(x * 2, 23).0;
    assert!(z.pixels().all(|p| p.0[3] == 255), "a checkerboard is opaque");
    assert_eq!(at(4), SOIL);
    assert_eq!(at(20)[0], at(20)[2], "air, over grey");
}

#[test]
fn maps_show_what_is_on_top_and_single_trees_alone() {
    let example = copy_of_example();
    let (map, said) = slice(example.path(), &["--top", "--voxel", "0.5"]);
    assert_eq!(map.dimensions(), (96, 64));
    assert!(said.contains("map from above"), "{said}");
    let at = |x: f64, y: f64| map.get_pixel((x * 2.0) as u32, ((32.0 - y) * 2.0) as u32).0;
    for x in [4.0, 12.0, 20.0, 28.0] {
        assert_eq!(at(x, 20.0), GRASS, "x = {x}");
    }
    // The top of the arch.
    assert_eq!(at(40.0, 14.0)[3], 255);
    assert_eq!(at(40.0, 30.0)[3], 0);
    let (tree, said) = slice(example.path(), &["--top", "--tree", "east.xml"]);
    assert_eq!(tree.dimensions(), (128, 128));
    assert!(said.contains("level 4 of 1 tree;"), "{said}");
    assert_eq!(tree.get_pixel(64, 80).0, SANDSTONE);
}

#[test]
fn maps_of_bricks_are_opaque_and_coloured_at_every_level() {
    let db = shared().join("db");
    for (level, side) in [("3", 128), ("1", 32), ("0", 16)] {
        let (map, _) = slice(&db, &["--top", "--level", level]);
        assert_eq!(map.dimensions(), (side, side));
        let inner = |k: u32| (1..side - 1).contains(&k);
        let inside = map.enumerate_pixels().filter(|(x, y, _)| inner(*x) && inner(*y));
        for (x, y, pixel) in inside {
            assert!(pixel.0[3] > 250, "level {level}, ({x}, {y}): {pixel:?}");
        }
        let colours: std::collections::BTreeSet<[u8; 4]> = map.pixels().map(|p| p.0).collect();
        assert!(colours.len() > 8, "level {level}: {} colours", colours.len());
    }
    // Ground from 2 m up: all of it solid below, and only the box, on 20 m, above 18 m.
    let solid = |at: &str| {
        let (cut, _) = slice(&db, &["--axis", "z", "--at", at, "--level", "3"]);
        cut.pixels().filter(|p| p.0[3] > 250).count() as f64 / f64::from(cut.width() * cut.height())
    };
    let (low, high) = (solid("1.9"), solid("19.4"));
    assert!(low > 0.99 && high > 0.0 && high < 0.2, "{low} {high}");
}

#[test]
fn what_makes_no_picture_is_refused() {
    let example = copy_of_example();
    let dir = example.path().display().to_string();
    let out = example.path().join("out.png");
    let file = out.display().to_string();
    let fails = |more: &[&str], code: i32| {
        let run = brickfell(["slice", &dir, "--out", &file].iter().chain(more));
        assert_eq!(run.code, code, "{}{}", run.out, run.err);
        assert!(!out.exists());
        run.err
    };
    assert!(fails(&["--axis", "z", "--at", "24"], 1).contains("the scene is from -8 to 24"));
    assert!(fails(&["--axis", "z", "--at", "NaN"], 1).contains("no tree is at z = NaN"));
    assert!(fails(&["--top", "--tree", "eats.xml"], 1).contains("did you mean east.xml?"));
    assert!(fails(&["--top", "--voxel", "0.00001"], 1).contains("is too large"));
    assert!(fails(&["--top", "--voxel", "-1"], 1).contains("side above 0"));
    for usage in [
        &["--axis", "x"][..],
        &["--at", "1"],
        &["--top", "--axis", "x", "--at", "1"],
        &[],
    ] {
        fails(usage, 2);
    }
    let run = brickfell(["slice", &dir, "--top", "--out", "/nowhere/out.png"]);
    assert!(run.error(1).contains("/nowhere/out.png"), "{}", run.err);
}
