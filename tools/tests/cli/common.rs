//! Running the program, and a small database that is built once.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use tempfile::TempDir;

/// What a run of the program gave.
pub(crate) struct Run {
    /// Exit code.
    pub(crate) code: i32,
    /// Standard output.
    pub(crate) out: String,
    /// Standard error.
    pub(crate) err: String,
}

/// Runs the program.
pub(crate) fn brickfell<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Run {
    run(Command::new(env!("CARGO_BIN_EXE_brickfell")).args(args))
}

/// Runs a prepared command.
pub(crate) fn run(command: &mut Command) -> Run {
    let output = command.output().expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is UTF-8");
    let run = Run {
        code: output.status.code().expect("the program ends by itself"),
        out: text(output.stdout),
        err: text(output.stderr),
    };
    assert!(!run.err.contains("panicked"), "{}", run.err);
    run
}

impl Run {
    /// The one error line, after the check that there is exactly one and that the exit code is `code`.
    pub(crate) fn error(&self, code: i32) -> &str {
        assert_eq!(self.code, code, "{}{}", self.out, self.err);
        let mut lines = self.err.lines().filter_map(|l| l.strip_prefix("brickfell: "));
        let line = lines
            .next()
            .unwrap_or_else(|| panic!("no error line in {}", self.err));
        assert_eq!(lines.next(), None, "more than one line: {}", self.err);
        line
    }

    /// Standard output of a run that had to succeed.
    pub(crate) fn success(&self) -> &str {
        assert_eq!(self.code, 0, "{}{}", self.out, self.err);
        &self.out
    }
}

/// Arguments that build a database of `inputs` in `out`: four trees with two chunks per axis at the finest level.
pub(crate) fn build_args(inputs: &Path, out: &Path) -> Vec<String> {
    let path = |p: PathBuf| p.display().to_string();
    let mut args = vec!["build".to_string(), path(inputs.join("box.obj"))];
    args.extend(["--heights".into(), path(inputs.join("heights.png"))]);
    args.extend(["--imagery".into(), path(inputs.join("imagery.png"))]);
    args.extend(["--voxel", "0.25", "--tree", "64", "--out"].map(String::from));
    args.push(path(out.to_path_buf()));
    args
}

/// Inputs (folder `inputs`) and their database (folder `db`), made once.
pub(crate) fn shared() -> &'static Path {
    static SHARED: OnceLock<TempDir> = OnceLock::new();
    SHARED
        .get_or_init(|| {
            let dir = tempfile::tempdir().expect("a temporary folder");
            crate::inputs::write(&dir.path().join("inputs"));
            brickfell(build_args(&dir.path().join("inputs"), &dir.path().join("db"))).success();
            dir
        })
        .path()
}

/// A copy of the shared database, to be damaged.
pub(crate) fn copy_of_database() -> TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files(&shared().join("db")) {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().expect("a file has a folder")).expect("a folder");
        fs::write(path, bytes).expect("a file");
    }
    dir
}

/// A copy of the hand-written example.
pub(crate) fn copy_of_example() -> TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/two_trees")) {
        fs::write(dir.path().join(name), bytes).expect("a file");
    }
    dir
}

/// All files below a folder with their contents, by relative name with `/`.
pub(crate) fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let (mut found, mut folders) = (BTreeMap::new(), vec![folder.to_path_buf()]);
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(&inner).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("below the folder");
                let name = name.to_string_lossy().replace('\\', "/");
                found.insert(name, fs::read(&path).expect("a file"));
            }
        }
    }
    found
}

/// The octree files of a database, relative to it, in order of their names.
pub(crate) fn octrees(db: &Path) -> Vec<String> {
    files(db).into_keys().filter(|n| n.ends_with(".oct")).collect()
}

/// The first of them.
pub(crate) fn an_octree(db: &Path) -> String {
    octrees(db).into_iter().next().expect("an octree")
}

/// The brick file with the most bytes, relative to the database.
pub(crate) fn largest_brick_file(db: &Path) -> String {
    let bricks = files(db).into_iter().filter(|(n, _)| n.ends_with(".brk"));
    bricks
        .max_by_key(|(_, bytes)| bytes.len())
        .expect("a brick file")
        .0
}

/// Changes a file's bytes.
pub(crate) fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).expect("the file");
    change(&mut bytes);
    fs::write(path, bytes).expect("the file");
}

/// Replaces a piece of a text file that must be there.
pub(crate) fn replace(path: &Path, old: &str, new: &str) {
    let text = fs::read_to_string(path).expect("the file");
    assert!(text.contains(old), "{} has no {old}", path.display());
    fs::write(path, text.replacen(old, new, 1)).expect("the file");
}
