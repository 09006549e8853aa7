//! The output folder: the same bytes always, resumed, refused, replaced.

use std::sync::atomic::{AtomicU64, Ordering};

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
    assert!(again.resumed < kept.len() && !args.out.join(manifest::SCRATCH).exists());
    assert!(
        kept.iter()
            .all(|(f, t)| fs::metadata(f.join(TREE_FILE)).unwrap().modified().unwrap() == *t)
    );
    assert!(files(&args.out) == whole);
}

#[test]
fn a_missing_coarse_tree_is_made_again_of_the_trees_in_it_and_beside_it() {
    struct Tiles(AtomicU64);
    impl Progress for Tiles {
        fn start(&self, _: u64, _: u64) {}
        fn tiles(&self, tiles: u64, _: u64) {
            self.0.fetch_add(tiles, Ordering::Relaxed);
        }
        fn finish(&self) {}
    }
    let folder = tempfile::tempdir().unwrap();
    let args = BuildArgs {
        tree_voxels: 16,
        ..args(folder.path(), "db")
    };
    let (first, again) = [(); 2].map(|()| Tiles(AtomicU64::new(0))).into();
    let report = build(&args, &first).unwrap();
    let whole = files(&args.out);
    let trees = fs::read_dir(args.out.join(TREES)).unwrap().flatten();
    let lost: Vec<PathBuf> = (trees.map(|e| e.path()))
        .filter(|path| path.to_string_lossy().contains("/g1_x0_y0_"))
        .collect();
    assert!(!lost.is_empty());
    lost.iter().for_each(|path| fs::remove_dir_all(path).unwrap());
    assert_eq!(
        build(&args, &again).unwrap(),
        BuildReport {
            resumed: report.trees,
            ..report
        }
    );
    let (first, again) = (first.0.into_inner(), again.0.into_inner());
    assert!(0 < again && 2 * again < first, "{again} of {first}");
    assert!(files(&args.out) == whole);
}

#[test]
fn tiles_that_an_earlier_run_left_are_used_and_damaged_ones_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let whole = args(folder.path(), "whole");
    build(&whole, &Silent).unwrap();
    // A file where a tree's folder is to be: the build stops there, its tiles stay.
    let cut = BuildArgs {
        out: folder.path().join("cut"),
        ..whole.clone()
    };
    let name = fs::read_dir(whole.out.join(TREES))
        .unwrap()
        .flatten()
        .next()
        .unwrap();
    let blocked = cut
        .out
        .join(TREES)
        .join(name.file_name())
        .with_added_extension("partial");
    fs::create_dir_all(cut.out.join(TREES)).unwrap();
    fs::copy(whole.out.join("build.json"), cut.out.join("build.json")).unwrap();
    fs::write(&blocked, "no folder").unwrap();
    assert!(build(&cut, &Silent).is_err());
    let scratch = cut.out.join("scratch");
    let tiles: Vec<PathBuf> = fs::read_dir(&scratch)
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .collect();
    assert!(tiles.len() > 3);
    for (k, tile) in tiles.iter().enumerate() {
        let bytes = fs::read(tile).unwrap();
        match k % 3 {
            0 => fs::write(tile, &bytes[..bytes.len() - 1]).unwrap(),
            1 => fs::rename(tile, tile.with_added_extension("partial")).unwrap(),
            _ => {}
        }
    }
    fs::remove_file(&blocked).unwrap();
    build(&cut, &Silent).unwrap();
    assert!(files(&cut.out) == files(&whole.out));
}

#[test]
fn faces_that_do_not_fit_in_memory_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let roomy = args(folder.path(), "roomy");
    build(&roomy, &Silent).unwrap();
    let tight = BuildArgs {
        memory: 64,
        out: folder.path().join("tight"),
        ..roomy.clone()
    };
    build(&tight, &Silent).unwrap();
    assert!(files(&tight.out) == files(&roomy.out));
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
fn a_texture_that_has_changed_is_another_input() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write(
        "a.obj",
        "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 9 0 0\nv 0 9 1\nvt 0 0\nf 1/1 2/1 3/1\n",
    );
    write("a.mtl", "newmtl m\nmap_Kd a.png\n");
    let paint = |color| {
        let picture = image::RgbImage::from_pixel(2, 2, image::Rgb(color));
        picture.save(folder.path().join("a.png")).unwrap();
    };
    paint([255, 0, 0]);
    let args = BuildArgs {
        inputs: vec![folder.path().join("a.obj")],
        voxel: Some(0.5),
        tree_voxels: 32,
        ..BuildArgs::new(folder.path().join("db"))
    };
    build(&args, &Silent).unwrap();
    assert!(build(&args, &Silent).is_ok());
    paint([0, 255, 0]);
    assert!(matches!(build(&args, &Silent), Err(BuildError::Exists(_))));
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

#[test]
fn placed_models_are_as_if_written_where_they_stand() {
    let folder = tempfile::tempdir().unwrap();
    let hut = |scale: f64, x: f64, y: f64, z: f64| {
        let corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 1.0], [4.0, 3.0, 2.5], [0.0, 3.0, 0.5]];
        let vertices =
            corners.map(|[a, b, c]| format!("v {} {} {}\n", a * scale + x, b * scale + y, c * scale + z));
        vertices.concat()
    };
    let faces = |first: usize| {
        format!(
            "f {first} {} {}\nf {first} {} {}\n",
            first + 1,
            first + 2,
            first + 2,
            first + 3
        )
    };
    let write = |name: &str, text: String| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let all = hut(1.0, 2.0, 3.0, 4.0) + &hut(2.0, 16.0, -8.0, 6.5) + &hut(1.0, 9.0, 9.0, 4.0);
    let written = BuildArgs {
        inputs: vec![write("all.obj", all + &faces(1) + &faces(5) + &faces(9))],
        voxel: Some(0.25),
        tree_voxels: 32,
        ..BuildArgs::new(folder.path().join("written"))
    };
    write("hut.obj", hut(1.0, 0.0, 0.0, 0.0) + &faces(1));
    let list = "hut.obj, 2, 3, 4\nhut.obj, 16, -8, 6.5, 0, 2\nhut.obj, 9, 9, 4, 0\n";
    let placed = BuildArgs {
        inputs: vec![],
        placements: vec![write("list.csv", list.into())],
        out: folder.path().join("placed"),
        ..written.clone()
    };
    let reports = [&written, &placed].map(|args| build(args, &Silent).unwrap());
    assert_eq!(reports[0], reports[1]);
    let [a, b] = [&written, &placed].map(|args| {
        let mut files = files(&args.out);
        files.remove(Path::new("build.json"));
        files
    });
    assert!(a == b && a.len() > 10);
    // The list and the models in it are inputs like others.
    write("hut.obj", hut(1.5, 0.0, 0.0, 0.0) + &faces(1));
    assert!(matches!(build(&placed, &Silent), Err(BuildError::Exists(_))));
}

#[test]
fn thin_surfaces_have_fewer_voxels_and_stay_opaque() {
    let folder = tempfile::tempdir().unwrap();
    let run = |voxelise, out| {
        let args = BuildArgs {
            voxelise,
            ..args(folder.path(), out)
        };
        build(&args, &Silent).unwrap().surface_voxels
    };
    let (whole, thin) = (run(Voxelise::Conservative, "whole"), run(Voxelise::Thin, "thin"));
    assert!(thin < whole * 8 / 10, "{thin} of {whole}");
    let other = BuildArgs {
        voxelise: Voxelise::Thin,
        ..args(folder.path(), "whole")
    };
    assert!(matches!(build(&other, &Silent), Err(BuildError::Exists(_))));
}

#[test]
fn the_inside_of_closed_meshes_is_solid_at_every_level() {
    let folder = tempfile::tempdir().unwrap();
    // A box from 1 to 15 m on each axis, over several trees.
    let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2].map(|b| [1.0, 15.0][b]);
    let vertices = (0..8).map(corner).map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let quads = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"];
    let text = vertices
        .chain(quads.map(|q| format!("f {q}\n")))
        .collect::<String>();
    fs::write(folder.path().join("box.obj"), text).unwrap();
    let lattice = Lattice {
        voxel: 0.5,
        depth: 1,
        layout: SampleLayout::Centre,
    };
    let run = |solid, out: &str| {
        let args = BuildArgs {
            inputs: vec![folder.path().join("box.obj")],
            voxel: Some(lattice.voxel),
            tree_voxels: 16,
            solid,
            ..BuildArgs::new(folder.path().join(out))
        };
        let report = build(&args, &Silent).unwrap();
        (Db::read(&args.out, lattice), report.surface_voxels)
    };
    let ((hollow, shell), (full, met)) = (run(false, "hollow"), run(true, "full"));
    assert_eq!(shell, met, "what is inside is no surface");
    for mip in 0..=1 {
        let cells = |from: i64, to: i64| {
            let range = from >> mip..to >> mip;
            let all = range.clone().flat_map(move |z| {
                let range = range.clone();
                range
                    .clone()
                    .flat_map(move |y| range.clone().map(move |x| [x, y, z]))
            });
            all.collect::<Vec<_>>()
        };
        for cell in cells(4, 28) {
            assert_eq!(hollow.at(mip, cell), Default::default(), "{mip} {cell:?}");
            assert_eq!(full.at(mip, cell).0[3], SOLID_ALPHA, "{mip} {cell:?}");
        }
        for cell in cells(-8, 40) {
            let near = cell.iter().all(|c| (0..32 >> mip).contains(c));
            assert!(near || full.at(mip, cell) == Default::default(), "{mip} {cell:?}");
        }
    }
}
