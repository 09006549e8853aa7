//! The schemas of the documentation: what is in the repository and what the program writes validates, where `xmllint` is there to say so.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::{brickfell, copy_of_example, octrees, replace, shared};

fn docs(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name)
}

/// What `xmllint` says of a file: whether it validates, and its words. `None` where there is no such program.
pub(crate) fn validates(schema: &str, file: &Path) -> Option<(bool, String)> {
    let mut xmllint = Command::new("xmllint");
    xmllint
        .args(["--noout", "--nonet", "--schema"])
        .arg(docs(schema))
        .arg(file);
    match xmllint.output() {
        Err(e) if e.kind() == ErrorKind::NotFound => {
            eprintln!("skipped: there is no xmllint (package libxml2-utils)");
            None
        }
        output => {
            let output = output.unwrap();
            Some((
                output.status.success(),
                String::from_utf8_lossy(&output.stderr).into(),
            ))
        }
    }
}

fn assert_valid(schema: &str, file: &Path) {
    if let Some((valid, said)) = validates(schema, file) {
        assert!(valid, "{said}");
    }
}

#[test]
fn scenes_of_the_repository_and_of_the_builder_validate() {
    let example = copy_of_example();
    assert_valid("scene.xsd", &example.path().join("scene.xml"));
    for tree in ["west.xml", "east.xml"] {
        assert_valid("octree.xsd", &example.path().join(tree));
    }
    let db = shared().join("db");
    assert_valid("scene.xsd", &db.join("scene.xml"));
    let dir = tempfile::tempdir().unwrap();
    let readable = dir.path().join("readable");
    let [from, to] = [&db, &readable].map(|p| p.display().to_string());
    brickfell(["convert", &from, "--out", &to, "--octrees", "xml"]).success();
    for tree in octrees(&readable) {
        assert_valid("octree.xsd", &readable.join(tree));
    }
}

#[test]
fn what_the_program_refuses_does_not_validate() {
    for (old, new) in [
        ("Compressed=", "Colour=\"red\" Compressed="),
        ("Compressed=\"NO\"", "Compressed=\"no\""),
        ("PagedOctTree", "PagedOctree"),
        ("TreeFile=\"west", "TreeFile=\"../west"),
        ("TreeFile=\"west", "TreeFile=\"/west"),
        ("TreeFile=\"west.xml\"", ""),
        ("Version=\"1\"", "Version=\"7\""),
        ("Radius=\"", "Radius=\"-"),
        ("CenterX=\"16\"", "CenterX=\"1,6\""),
        ("CenterX=\"16\"", "CenterX=\"NaN\""),
        ("BrickXSize=\"8\"", "BrickXSize=\"9\""),
    ] {
        let example = copy_of_example();
        let scene = example.path().join("scene.xml");
        replace(&scene, old, new);
        let run = brickfell(["check", &example.path().display().to_string()]);
        assert_eq!(run.code, 1, "{new}");
        if let Some((valid, _)) = validates("scene.xsd", &scene) {
            assert!(!valid, "{new}");
        }
    }
}
