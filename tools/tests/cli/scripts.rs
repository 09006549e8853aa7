//! What scripts rely on: `--quiet`, `--json`, exit codes, completions and manual pages.

use serde_json::Value;

use crate::common::{brickfell, build_args, copy_of_example, files, shared};

/// The program's commands, as its help lists them.
fn commands() -> Vec<String> {
    let help = brickfell(["--help"]).success().to_string();
    let list = help
        .split("Commands:\n")
        .nth(1)
        .unwrap()
        .split("\n\n")
        .next()
        .unwrap();
    let names = list
        .lines()
        .map(|l| l.split_whitespace().next().unwrap().to_string());
    names.filter(|n| n != "help").collect()
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    let commands = commands();
    assert!(
        commands.len() > 12 && commands.contains(&"slice".to_string()),
        "{commands:?}"
    );
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let run = brickfell(["completions", shell]);
        for command in &commands {
            assert!(run.success().contains(command), "{shell} has no {command}");
        }
    }
    let dir = tempfile::tempdir().unwrap();
    brickfell(["man", "--out", &dir.path().display().to_string()]).success();
    let pages = files(dir.path());
    let program = String::from_utf8(pages["brickfell.1"].clone()).unwrap();
    for command in &commands {
        assert!(
            program.contains(&format!("brickfell\\-{command}(1)")),
            "{command} in {program}"
        );
        let page = String::from_utf8_lossy(&pages[&format!("brickfell-{command}.1")]).to_string();
        assert!(
            page.contains(".SH SYNOPSIS") && page.contains("Examples:"),
            "{page}"
        );
    }
    assert_eq!(brickfell(["completions", "csh"]).code, 2);
    brickfell(["man", "--out", "/dev/null/pages"]).error(1);
}

#[test]
fn every_command_ends_its_help_with_examples() {
    for command in commands() {
        let help = brickfell([&command, "--help"]).success().to_string();
        let examples = help
            .split("Examples:\n")
            .nth(1)
            .unwrap_or_else(|| panic!("{command}: {help}"));
        assert!(examples.contains(&format!("brickfell {command}")), "{help}");
        assert!(help.contains("--quiet"), "{help}");
    }
}

#[test]
fn results_are_json_where_that_is_asked_for_and_nothing_else_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let json = |args: &[String]| -> Value {
        let run = brickfell(args.iter().chain(&["--json".to_string(), "--quiet".to_string()]));
        assert_eq!(run.err, "", "{args:?}");
        serde_json::from_str(run.success()).unwrap_or_else(|e| panic!("{args:?}: {e}: {}", run.out))
    };
    let line = |text: &str| -> Vec<String> { text.split(' ').map(String::from).collect() };
    let built = json(&build_args(&shared().join("inputs"), &dir.path().join("db")));
    assert_eq!(
        (&built["trees"], &built["voxel"], &built["resumed"]),
        (&8.into(), &0.25.into(), &0.into())
    );
    let db = path("db");
    let checked = json(&line(&format!("check {db}")));
    assert_eq!(
        (&checked["trees"], &checked["faults"]),
        (&8.into(), &Value::Array(vec![]))
    );
    assert_eq!(json(&line(&format!("info {db}")))["trees"], 8);
    assert_eq!(json(&line(&format!("inspect {db}")))["scene"]["sum"]["trees"], 8);
    let (flight, trace) = (path("flight"), path("trace.json"));
    let flown = json(&line(&format!(
        "fly {db} --cpu --settle --frames 2 --size 32x18 --out {flight} --trace {trace}"
    )));
    assert_eq!((&flown["frames"], &flown["holes"]), (&2.into(), &0.into()));
    let stats = json(&line(&format!("stats {trace}")));
    assert_eq!(
        (&stats["frames"], &stats["faults"]),
        (&2.into(), &Value::Array(vec![]))
    );
    assert!(stats["stages_ms"]["cull"]["p50"].is_f64(), "{stats}");
    let frames = [0, 1].map(|k| format!("{flight}/frame_000{k}.png"));
    let same = json(&line(&format!("compare {} {}", frames[0], frames[0])));
    let other = json(&line(&format!("compare {} {}", frames[0], frames[1])));
    assert_eq!((&same["rmse"], &same["psnr"]), (&0.0.into(), &99.0.into()));
    assert!(other["flip"].as_f64().unwrap() > 0.0 && other["worst"]["steps"].as_u64().unwrap() > 0);
    let bench = json(&line(&format!("bench culler --quick --out {}", path("results"))));
    assert!(!bench["suites"]["culler"]["rows"].as_array().unwrap().is_empty());
}

#[test]
fn exit_codes_are_those_of_the_help() {
    let help = brickfell(["--help"]).success().to_string();
    for line in [
        "  0  done",
        "  1  an error, or faults that check found",
        "  2  wrong usage; or fly, render or inspect",
    ] {
        assert!(help.contains(line), "{help}");
    }
    let example = copy_of_example();
    let dir = example.path().display().to_string();
    let out = example.path().join("out").display().to_string();
    let picture = example.path().join("out.png").display().to_string();
    let fly = [
        "fly", &dir, "--cpu", "--settle", "--frames", "1", "--size", "16x9", "--out", &out,
    ];
    let render = [
        "render",
        &dir,
        "--cpu",
        "--size",
        "16x9",
        "--eye",
        "20,-60,40",
        "--target",
        "20,16,0",
        "--out",
        &picture,
    ];
    for (args, sound, damaged) in [
        (&["check", &dir][..], 0, 1),
        (&["info", &dir], 0, 1),
        (&["inspect", &dir], 0, 2),
        (&fly, 0, 2),
        (&render, 0, 2),
    ] {
        assert_eq!(brickfell(args).code, sound, "{args:?}");
        std::fs::write(example.path().join("aside"), "no octree").unwrap();
        let swap = || {
            let [a, b, c] = ["east.xml", "aside", "between"].map(|n| example.path().join(n));
            std::fs::rename(&a, &c)
                .and_then(|()| std::fs::rename(&b, &a))
                .and_then(|()| std::fs::rename(&c, &b))
                .unwrap();
        };
        swap();
        assert_eq!(brickfell(args).code, damaged, "{args:?}");
        swap();
    }
    assert_eq!(brickfell(["slice"]).code, 2);
    assert_eq!(brickfell(["info", "/nowhere"]).code, 1);
}
