//! `inspect`: the tree of lines and the JSON say what the files and the scene say.

use std::fs;

use serde_json::Value;

use crate::common::{brickfell, copy_of_database, copy_of_example, files, largest_brick_file, shared};

const TERRAIN: &str = "procedural:2?extent=1km&voxel=2";

fn inspect(dir: &std::path::Path, more: &[&str]) -> String {
    let dir = dir.display().to_string();
    let run = brickfell(["inspect", &dir].iter().chain(more));
    run.success().to_string()
}

#[test]
fn groups_trees_and_coarse_trees_are_lines_that_nest() {
    let example = copy_of_example();
    let text = inspect(example.path(), &[]);
    let lines: Vec<&str> = text.lines().collect();
    let east = files(example.path())["east.xml"].len() as f64 / 1024.0;
    assert!(
        lines[0].starts_with(&format!(
            "{}: (0, 0, -8) to (48, 32, 24) m: 2 trees, ",
            example.path().display()
        )),
        "{text}"
    );
    assert_eq!(
        lines[2],
        format!(
            "└─ tree east.xml (32, 8, -4) to (48, 24, 12) m: voxel 0.125 m, 5 levels, {east:.2} KiB, no bricks"
        )
    );
    assert_eq!(
        lines[3],
        "1 group nested 1 deep, up to 2 children; 0 of 2 trees empty; children overlap in 0 groups"
    );

    let text = inspect(&shared().join("db"), &[]);
    assert!(text.contains("├─ coarse trees/g"), "{text}");
    assert_eq!(text.matches("─ tree trees/").count(), 8, "{text}");
}

#[test]
fn figures_are_those_of_the_files() {
    let db = shared().join("db");
    let json: Value = serde_json::from_str(&inspect(&db, &["--json"])).unwrap();
    let mut groups = vec![&json["scene"]];
    let (mut bytes, mut bricks) = (0, 0);
    let array = |v: &Value| v.as_array().unwrap().clone();
    let mut trees = Vec::new();
    while let Some(group) = groups.pop() {
        for tree in array(&group["trees"])
            .into_iter()
            .chain(array(&group["coarse_trees"]))
        {
            bytes += tree["bytes"].as_u64().unwrap();
            bricks += array(&tree["bricks_per_level"])
                .iter()
                .map(|b| b.as_u64().unwrap())
                .sum::<u64>();
            trees.push(tree);
        }
        groups.extend(group["groups"].as_array().unwrap());
    }
    let files = files(&db);
    let all = files.iter().filter(|(name, _)| name.starts_with("trees/"));
    assert_eq!(bytes, all.map(|(_, b)| b.len() as u64).sum::<u64>());
    let brk = files.iter().filter(|(name, _)| name.ends_with(".brk"));
    let counts = brk.map(|(_, b)| u64::from(u32::from_le_bytes([b[24], b[25], b[26], b[27]])));
    assert_eq!(bricks, counts.sum::<u64>());
    let sum = &json["scene"]["sum"];
    assert_eq!(
        (sum["bytes"].as_u64(), sum["bricks"].as_u64()),
        (Some(bytes), Some(bricks))
    );
    let finest = trees
        .iter()
        .find(|t| t["file"].as_str().unwrap().starts_with("trees/x"))
        .unwrap();
    assert_eq!(
        (&finest["voxel_size"], &finest["levels"]),
        (&0.25.into(), &4.into())
    );
}

#[test]
fn large_scenes_are_summed_up() {
    let all = brickfell(["inspect", TERRAIN]);
    let lines: Vec<&str> = all.success().lines().collect();
    assert!(
        lines[0].contains(": 64 trees, 21 coarse trees in 20 more groups"),
        "{}",
        lines[0]
    );
    assert!(lines.len() < 202, "{}", all.out);
    let last = lines[lines.len() - 1];
    assert!(
        last.starts_with("21 groups nested 3 deep, up to 4 children; 0 of 64 trees empty"),
        "{last}"
    );
    assert_eq!(all.out.matches("─ tree ").count(), 64, "{}", all.out);

    let one = brickfell(["inspect", TERRAIN, "--depth", "1"]);
    let groups = one.success().matches("─ group ").count();
    assert!(
        (2..=4).contains(&groups) && !one.out.contains("─ tree "),
        "{}",
        one.out
    );
    let one = brickfell(["inspect", TERRAIN, "--depth", "1", "--json"]);
    let json: Value = serde_json::from_str(one.success()).unwrap();
    let width = |group: &Value| {
        let corner = |end: &str| group["bounds"][end][0].as_f64().unwrap();
        corner("max") - corner("min")
    };
    assert_eq!(width(&json["scene"]), 1024.0);
    for group in json["scene"]["groups"].as_array().unwrap() {
        assert_eq!(
            (width(group), &group["sum"]["trees"]),
            (512.0, &16.into()),
            "{group}"
        );
    }
    let none = brickfell(["inspect", TERRAIN, "--depth", "0", "--json"]);
    let json: Value = serde_json::from_str(none.success()).unwrap();
    assert_eq!(
        (&json["scene"]["groups"], &json["scene"]["sum"]["trees"]),
        (&Value::Array(vec![]), &64.into())
    );
}

#[test]
fn what_cannot_be_read_is_named_and_the_rest_is_shown() {
    let db = copy_of_database();
    let brick = largest_brick_file(db.path());
    fs::write(db.path().join(&brick), "short").unwrap();
    let run = brickfell(["inspect", &db.path().display().to_string()]);
    let line = run.error(2);
    assert!(line.contains(&brick), "{line}");
    assert_eq!(run.out.matches("─ tree trees/").count(), 8, "{}", run.out);
    let line = brickfell(["inspect", "/nowhere/at/all"]).error(1).to_string();
    assert!(line.contains("/nowhere/at/all"), "{line}");
}
