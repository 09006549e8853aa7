//! `check`: a sound database passes, and every kind of damage is one line that names the file and the place in it.

use std::fs;
use std::path::Path;

use brickfell_formats::bricks::{self, BrickFileWriter, BrickIndex, HEADER_BYTES};
use brickfell_formats::morton;

use crate::common::{
    Run, an_octree, brickfell, copy_of_database, copy_of_example, edit, files, largest_brick_file, replace,
    shared,
};

fn check(db: &Path) -> Run {
    brickfell(["check", &db.display().to_string()])
}

/// The one fault line about `file`, after the checks that it is the only one and that the exit code is 1.
fn fault(db: &Path, file: &str) -> String {
    let run = check(db);
    assert_eq!(run.code, 1, "{}{}", run.out, run.err);
    let lines: Vec<&str> = run.out.lines().collect();
    assert_eq!(lines.len(), 2, "one fault and the summary: {}", run.out);
    let path = format!("{}: ", db.join(file).display());
    let what = lines[0]
        .strip_prefix(&path)
        .unwrap_or_else(|| panic!("{} does not begin with {path}", lines[0]));
    assert!(lines[1].contains(": 1 fault, no warnings"), "{}", lines[1]);
    what.to_string()
}

#[test]
fn sound_databases_pass() {
    let run = check(&shared().join("db"));
    assert!(
        run.success().ends_with(": no faults, no warnings\n"),
        "{}",
        run.out
    );
    assert!(!run.out.contains(" 0 bricks"), "{}", run.out);
    let example = copy_of_example();
    assert!(
        check(example.path())
            .success()
            .contains("2 trees, 0 coarse trees, 0 bricks")
    );
}

#[test]
fn damaged_octrees_are_named_with_the_place() {
    let octree = an_octree(&shared().join("db"));
    let length = files(&shared().join("db"))[&octree].len();
    let spoilt = |change: &dyn Fn(&mut Vec<u8>)| {
        let db = copy_of_database();
        edit(&db.path().join(&octree), |bytes| change(bytes));
        fault(db.path(), &octree)
    };
    assert_eq!(
        spoilt(&|b| b[4] = b'X'),
        "byte 0: not a brickfell octree file (wrong magic)"
    );
    assert_eq!(
        spoilt(&|b| b[8] = 9),
        "byte 8: octree version 9 is unknown (this reads 2)"
    );
    assert!(spoilt(&|b| b[12] ^= 1).starts_with("byte "));
    for keep in [0, 10, 70, length / 2, length - 1] {
        let line = spoilt(&|b| b.truncate(keep));
        // What is too short to be anything is taken for XML.
        let place = ["byte ", "line ", "file: "].iter().any(|p| line.starts_with(p));
        assert!(place, "{keep}: {line}");
    }
    for bit in [20 * 8, 50 * 8 + 3, 57 * 8, 90 * 8, length * 4, length * 8 - 1] {
        let line = spoilt(&|b| b[bit / 8] ^= 1 << (bit % 8));
        assert!(line.starts_with("byte "), "bit {bit}: {line}");
    }
    let line = spoilt(&|b| b.push(0));
    assert!(line.starts_with("byte "), "{line}");
}

#[test]
fn damaged_brick_files_are_named_with_the_place() {
    let file = largest_brick_file(&shared().join("db"));
    let length = files(&shared().join("db"))[&file].len();
    let spoilt = |change: &dyn Fn(&mut Vec<u8>)| {
        let db = copy_of_database();
        edit(&db.path().join(&file), |bytes| change(bytes));
        fault(db.path(), &file)
    };
    assert_eq!(
        spoilt(&|b| b[0] = 0),
        "byte 0: not a brickfell brick file (wrong magic)"
    );
    assert_eq!(
        spoilt(&|b| b[8] = 2),
        "byte 8: brick file version 2 is unknown (this reads 1)"
    );
    for keep in [0, 63, length / 2, length - 1] {
        assert!(spoilt(&|b| b.truncate(keep)).starts_with("byte "), "{keep}");
    }
    for bit in [12 * 8, 24 * 8, 61 * 8, 64 * 8, length * 4, length * 8 - 1] {
        let line = spoilt(&|b| b[bit / 8] ^= 1 << (bit % 8));
        assert!(line.starts_with("byte "), "bit {bit}: {line}");
    }
}

#[test]
fn files_that_are_missing_or_swapped_are_named() {
    let db = copy_of_database();
    let file = largest_brick_file(db.path());
    fs::remove_file(db.path().join(&file)).unwrap();
    assert!(fault(db.path(), &file).starts_with("file: cannot be opened: "));
    let coarser = file.replace("L03", "L02");
    fs::copy(db.path().join(&coarser), db.path().join(&file)).unwrap();
    assert_eq!(
        fault(db.path(), &file),
        "byte 12: it is of level 2, its name says 3"
    );

    let db = copy_of_database();
    let octree = an_octree(db.path());
    fs::remove_file(db.path().join(&octree)).unwrap();
    let line = fault(db.path(), "scene.xml");
    assert!(
        line.starts_with("line ")
            && line.contains(&format!(
                "TreeFile=\"{octree}\": there is no such file; did you mean trees/"
            )),
        "{line}"
    );
    fs::create_dir(db.path().join(&octree)).unwrap();
    fault(db.path(), &octree);
}

/// Header and directory of a whole brick file.
fn index(bytes: &[u8]) -> BrickIndex {
    let header = bricks::decode_header(bytes, bytes.len() as u64).unwrap();
    let directory = header.directory();
    header
        .decode_directory(&bytes[directory.start as usize..directory.end as usize])
        .unwrap()
}

/// Writes a brick file anew, with sound checksums, after a change to one of its chunks.
fn rewrite(bytes: &mut Vec<u8>, changed: u32, change: impl Fn(&mut brickfell_formats::chunk::Chunk)) {
    let index = index(bytes);
    let header = index.header;
    let mut writer = BrickFileWriter::new(header.level, header.layout, header.chunk_log2, header.encoding)
        .with_layers(header.layers);
    let mut out = vec![0; HEADER_BYTES];
    for (k, entry) in (0..).zip(&index.chunks) {
        let payload = &bytes[entry.offset as usize..][..entry.length as usize];
        let mut chunk = index.decode_chunk(k, payload).unwrap();
        if k == changed {
            change(&mut chunk);
        }
        let payload = chunk.encode(header.encoding).unwrap();
        writer
            .push(morton::decode(entry.morton), chunk.mask, &payload)
            .unwrap();
        out.extend(payload);
    }
    let (directory, header) = writer.finish();
    out.extend(directory);
    out[..HEADER_BYTES].copy_from_slice(&header);
    *bytes = out;
}

#[test]
fn bricks_of_another_tree_are_found_by_their_places() {
    let db = copy_of_database();
    let file = largest_brick_file(db.path());
    edit(&db.path().join(&file), |bytes| {
        // A chunk's bricks move one place on, where there is room: all counts and checksums are right.
        let moved = index(bytes)
            .chunks
            .iter()
            .position(|c| c.mask >> 63 == 0)
            .unwrap();
        rewrite(bytes, moved as u32, |chunk| {
            chunk.mask <<= 1;
            chunk.color.fill([0; 4]);
            chunk.normal.fill([0; 4]);
            chunk.opacity.fill([0; 4]);
        });
    });
    let line = fault(db.path(), &file);
    assert!(
        line.starts_with("byte ") && line.contains("chunk ") && line.contains("level 3"),
        "{line}"
    );
}

#[test]
fn a_seam_between_chunks_is_found_though_all_checksums_are_right() {
    let db = copy_of_database();
    let file = largest_brick_file(db.path());
    edit(&db.path().join(&file), |bytes| {
        let chunks = index(bytes).chunks.len() as u32;
        assert!(chunks > 1, "the test needs neighbouring chunks");
        rewrite(bytes, 0, |_| {});
    });
    check(db.path()).success();
    edit(&db.path().join(&file), |bytes| {
        rewrite(bytes, 0, |chunk| {
            for color in &mut chunk.color {
                color[1] ^= 1;
            }
        });
    });
    let line = fault(db.path(), &file);
    assert!(line.contains("disagree about samples that they share"), "{line}");
}

#[test]
fn scenes_that_cannot_be_read_name_line_and_column() {
    for (old, new, expected) in [
        ("Compressed=", "Colour=\"red\" Compressed=", "Colour"),
        ("TreeFile=\"trees/", "TreeFile=\"../trees/", "TreeFile"),
        ("TreeFile=\"trees/", "TreeFile=\"/etc/trees/", "TreeFile"),
        ("Version=\"1\"", "Version=\"7\"", "Version"),
        ("Radius=\"", "Radius=\"-", "Radius"),
        ("</OctTreeGroup>", "", ""),
    ] {
        let db = copy_of_database();
        let path = db.path().join("scene.xml");
        replace(&path, old, new);
        let run = check(db.path());
        assert_eq!((run.code, run.err.as_str()), (1, ""), "{}", run.out);
        let line = run.out.lines().next().unwrap();
        let place = line.strip_prefix(&format!("{}: line ", path.display()));
        assert!(place.is_some_and(|p| p.contains(", column ")), "{line}");
        assert!(line.contains(expected), "{line}");
        // Who does not list faults names the first.
        let run = brickfell(["info", &db.path().display().to_string()]);
        assert_eq!(run.error(1), line);
    }
    let db = copy_of_database();
    fs::remove_file(db.path().join("scene.xml")).unwrap();
    assert!(check(db.path()).error(1).contains("scene.xml: "));
    assert!(check(&db.path().join("nowhere")).error(1).contains("nowhere"));
}

#[test]
fn everything_that_is_wrong_in_a_scene_is_told_at_once() {
    let example = copy_of_example();
    let scene = example.path().join("scene.xml");
    replace(&scene, "TreeFile=\"west.xml\"", "TreeFile=\"wset.xml\"");
    replace(
        &scene,
        "<PagedOctTree CenterX=\"40\"",
        "<Tree/>\n<PagedOctTree CentreX=\"40\"",
    );
    replace(&scene, "Compressed=\"NO\"", "Compressed=\"no\"");
    let run = check(example.path());
    let lines: Vec<&str> = run.out.lines().collect();
    let expected = [
        "line 6, column 27: OctTreeGroup: Compressed=\"no\" is unknown (known: YES, NO); did you mean NO?",
        "line 11, column 3: Tree: unknown element in OctTreeGroup; known: OctTreeGroup, PagedOctTree, CoarseOctTree",
        "line 12, column 15: PagedOctTree: attribute CentreX is unknown; did you mean CenterX?",
        "line 9, column 70: TreeFile=\"wset.xml\": there is no such file; did you mean west.xml?",
    ];
    assert_eq!(lines.len(), expected.len() + 1, "{}", run.out);
    for (line, expected) in lines.iter().zip(expected) {
        assert_eq!(*line, format!("{}: {expected}", scene.display()));
    }

    let run = brickfell(["check", &example.path().display().to_string(), "--json"]);
    assert_eq!(run.code, 1);
    let json: serde_json::Value = serde_json::from_str(&run.out).unwrap();
    let faults = json["faults"].as_array().unwrap();
    assert_eq!(faults.len(), 4);
    let expected = serde_json::json!({
        "path": scene.display().to_string(), "line": 12, "column": 15,
        "message": "PagedOctTree: attribute CentreX is unknown", "suggestion": "did you mean CenterX?",
    });
    assert_eq!(faults[2], expected);
    assert_eq!((&json["trees"], &json["bricks"]), (&1.into(), &0.into()));
    let db = copy_of_database();
    let octree = an_octree(db.path());
    edit(&db.path().join(&octree), |b| b[8] = 9);
    let run = brickfell(["check", &db.path().display().to_string(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!(json["faults"][0]["byte"], 8, "{json}");
}

#[test]
fn tree_files_are_looked_for_elsewhere_in_the_folder() {
    let example = copy_of_example();
    fs::create_dir(example.path().join("somewhere")).unwrap();
    fs::rename(
        example.path().join("west.xml"),
        example.path().join("somewhere/west.xml"),
    )
    .unwrap();
    let line = fault(example.path(), "scene.xml");
    assert!(line.ends_with("; did you mean somewhere/west.xml?"), "{line}");
}

#[test]
fn hand_written_octrees_are_checked_too() {
    let example = copy_of_example();
    replace(
        &example.path().join("east.xml"),
        "<Node Type",
        "<Node Taste=\"sweet\" Type",
    );
    let line = fault(example.path(), "east.xml");
    assert!(line.starts_with("line ") && line.contains("Taste"), "{line}");
}

#[test]
fn a_box_that_is_not_the_trees_is_a_fault() {
    let example = copy_of_example();
    replace(
        &example.path().join("scene.xml"),
        "MaxX=\"48\" MaxY=\"24\"",
        "MaxX=\"48\" MaxY=\"25\"",
    );
    let line = fault(example.path(), "scene.xml");
    assert!(line.contains("east.xml"), "{line}");
}

#[cfg(unix)]
#[test]
fn links_out_of_the_folder_are_not_followed() {
    let example = copy_of_example();
    let outside = tempfile::tempdir().unwrap();
    fs::rename(example.path().join("east.xml"), outside.path().join("east.xml")).unwrap();
    std::os::unix::fs::symlink(outside.path().join("east.xml"), example.path().join("east.xml")).unwrap();
    let line = fault(example.path(), "east.xml");
    assert!(line.contains("symbolic link"), "{line}");
}

#[test]
fn overlapping_trees_are_a_warning() {
    let example = copy_of_example();
    let scene = example.path().join("scene.xml");
    let text = fs::read_to_string(&scene).unwrap();
    let east = text.find("<PagedOctTree CenterX=\"40\"").unwrap();
    let end = text[east..].find("/>").unwrap() + east + 2;
    fs::write(
        &scene,
        format!("{}{}{}", &text[..end], &text[east..end], &text[end..]),
    )
    .unwrap();
    let run = check(example.path());
    let warning = run.success().lines().find_map(|l| l.strip_prefix("warning: "));
    assert!(
        warning.is_some_and(
            |w| w.contains("line 11, column 70") && w.contains("its box and that of east.xml overlap")
        ),
        "{}",
        run.out
    );
    assert!(run.out.ends_with(": no faults, 1 warning\n"), "{}", run.out);
}
