//! The output folder: the same bytes always, resumed, refused, replaced.

use super::*;

fn mesh_file(folder: &Path) -> PathBuf {
    let path = folder.join("roof.obj");
    let text = "v 0 0 0\nv 30 2 9\nv 28 25 3\nv -2 22 1\nv 40 40 40\nf 1 2 3\nf 1 3 4\nf 2 3 5\n";
    fs::write(&path, text).unwrap();
    path
}

fn args(folder: &Path, out: &str) -> BuildArgs {
    BuildArgs {
        inputs: vec![mesh_file(folder)],
        voxel: Some(0.3),
        tree_voxels: 32,
        ..BuildArgs::new(folder.join(out))
    }
}

#[test]
fn one_thread_or_two_make_the_same_bytes() {
    for filter in Filter::value_variants() {
        let folder = tempfile::tempdir().unwrap();
        let run = |threads, out| {
            let args = BuildArgs {
                threads,
                filter: *filter,
                ..args(folder.path(), out)
            };
            build(&args, &Silent).unwrap()
        };
        let (one, two) = (run(1, "one"), run(2, "two"));
        assert_eq!(one, two);
        assert!(one.trees > 10 && one.surface_voxels > 10_000, "{one:?}");
        let [a, b] = ["one", "two"].map(|out| files(&folder.path().join(out)));
        assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
        let trees_and_scene = |f: &PathBuf| f.to_string_lossy() != "build.json";
        assert!(
            a.iter()
                .all(|(name, bytes)| !trees_and_scene(name) || b[name] == *bytes),
            "{filter:?}"
        );
        // The tilted triangle's column of trees has some that it does not meet.
        assert!(a.contains_key(Path::new(EMPTY_TREES)));
    }
}

#[test]
fn a_build_that_was_cut_short_is_resumed_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let args = args(folder.path(), "db");
    let first = build(&args, &Silent).unwrap();
    let whole = files(&args.out);
    let names: Vec<PathBuf> = fs::read_dir(args.out.join(TREES))
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .collect();
    let mut kept = Vec::new();
    for (k, name) in names.iter().enumerate() {
        match k % 3 {
            0 => fs::remove_dir_all(name).unwrap(),
            1 => {
                let partial = PathBuf::from(format!("{}.partial", name.display()));
                fs::rename(name, &partial).unwrap();
                fs::write(partial.join("tree.L02.brk"), "cut").unwrap();
            }
            _ => kept.push((
                name.clone(),
                fs::metadata(name.join(TREE_FILE)).unwrap().modified().unwrap(),
            )),
        }
    }
    fs::remove_file(args.out.join(SCENE)).unwrap();
    let empty = fs::read_to_string(args.out.join(EMPTY_TREES)).unwrap();
    fs::write(args.out.join(EMPTY_TREES), &empty[..empty.len() / 2]).unwrap();
    let again = build(&args, &Silent).unwrap();
    assert_eq!(
        (again.trees, again.surface_voxels),
        (first.trees, first.surface_voxels)
    );
    let tree = |folder: &&(PathBuf, _)| !folder.0.to_string_lossy().contains("/g");
    assert_eq!(again.resumed, kept.iter().filter(tree).count());
    assert!(again.resumed < kept.len() && !args.out.join(manifest::ROOT_SAMPLES).exists());
    assert!(
        kept.iter()
            .all(|(f, t)| fs::metadata(f.join(TREE_FILE)).unwrap().modified().unwrap() == *t)
    );
    assert!(files(&args.out) == whole);
}

#[test]
fn other_arguments_are_refused_without_force() {
    let folder = tempfile::tempdir().unwrap();
    let args = args(folder.path(), "db");
    build(&args, &Silent).unwrap();
    let before = files(&args.out);
    let other = BuildArgs {
        voxel: Some(0.6),
        ..args.clone()
    };
    let error = build(&other, &Silent).unwrap_err();
    assert!(
        matches!(error, BuildError::Exists(_)) && error.to_string().contains("--force"),
        "{error}"
    );
    assert!(files(&args.out) == before);
    let note = args.out.join("trees/note.txt");
    fs::write(&note, "mine").unwrap();
    let report = build(
        &BuildArgs {
            force: true,
            ..other.clone()
        },
        &Silent,
    )
    .unwrap();
    assert_eq!(
        (report.resumed, fs::read_to_string(&note).unwrap().as_str()),
        (0, "mine")
    );
    let fresh = BuildArgs {
        out: folder.path().join("fresh"),
        ..other
    };
    build(&fresh, &Silent).unwrap();
    let mut replaced = files(&args.out);
    replaced.remove(Path::new("trees/note.txt"));
    assert!(replaced == files(&fresh.out));
}

#[test]
fn a_folder_that_is_not_ours_is_never_touched() {
    let folder = tempfile::tempdir().unwrap();
    let args = BuildArgs {
        force: true,
        ..args(folder.path(), "photos")
    };
    fs::create_dir_all(args.out.join("trees")).unwrap();
    for (name, text) in [
        ("scene.xml", "<mine/>"),
        ("build.json", "{\"format\": \"other\"}"),
    ] {
        fs::write(args.out.join(name), text).unwrap();
        let before = files(&args.out);
        assert!(matches!(build(&args, &Silent), Err(BuildError::Foreign(_))));
        assert!(files(&args.out) == before);
    }
}

#[test]
fn bad_arguments_and_inputs_are_one_line_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let good = args(folder.path(), "db");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let far = file("far.obj", "v 1e15 0 0\nv 1e15 1 0\nv 0 0 1\nf 1 2 3\n");
    let wide = file("wide.obj", "v 0 0 0\nv 1e7 0 0\nv 0 1e7 0\nf 1 2 3\n");
    let nan = file("nan.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n");
    let bad = [
        BuildArgs {
            voxel: Some(0.0),
            ..good.clone()
        },
        BuildArgs {
            voxel: Some(f64::NAN),
            ..good.clone()
        },
        BuildArgs {
            voxel: Some(-1.0),
            ..good.clone()
        },
        BuildArgs {
            tree_voxels: 100,
            ..good.clone()
        },
        BuildArgs {
            tree_voxels: 8,
            ..good.clone()
        },
        BuildArgs {
            chunk_log2: 3,
            ..good.clone()
        },
        BuildArgs {
            inputs: vec![],
            ..good.clone()
        },
        BuildArgs {
            inputs: vec![folder.path().join("missing.obj")],
            ..good.clone()
        },
        BuildArgs {
            inputs: vec![far],
            ..good.clone()
        },
        BuildArgs {
            inputs: vec![wide],
            ..good.clone()
        },
        BuildArgs {
            inputs: vec![nan],
            ..good.clone()
        },
    ];
    for args in bad {
        let message = build(&args, &Silent).unwrap_err().to_string();
        assert!(!message.is_empty() && !message.contains('\n'), "{message}");
        assert!(!args.out.exists(), "{message}");
    }
}
