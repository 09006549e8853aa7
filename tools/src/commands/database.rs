//! What commands share: opening a database without a GPU, the size of a folder, printing.
//!
//! Any thread.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use brickfell_formats::FormatError;
use brickfell_formats::octree::{self, Octree};
use brickfell_formats::octree_binary;
use brickfell_formats::scene::Scene;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::terrain::SCENE_FILE;

use super::CommandError;
use super::fault::Fault;

/// Longest XML octree that is read: they are written by hand or for tests.
const MAX_XML_BYTES: u64 = 1 << 28;

/// Opens a database's folder and reads its scene.
///
/// # Errors
/// If there is no such folder, or no readable `scene.xml` in it; the line names the file and the place in it.
pub(crate) fn open_scene(dir: &Path) -> Result<(FolderStore, Scene), CommandError> {
    let (store, bytes) = open_folder(dir)?;
    let hint = "`brickfell check` lists all that is wrong with it";
    let scene =
        Scene::parse(&bytes).map_err(|e| CommandError::new(Fault::new(&store, SCENE_FILE, e), hint))?;
    Ok((store, scene))
}

/// Opens a database's folder and reads the text of its scene.
///
/// # Errors
/// If there is no such folder, or no readable file `scene.xml` in it.
pub(crate) fn open_folder(dir: &Path) -> Result<(FolderStore, Vec<u8>), CommandError> {
    let hint = "give a folder that `brickfell build` made, or one with a hand-written scene.xml";
    let store = FolderStore::open(dir).map_err(|e| CommandError::new(e, hint))?;
    let bytes = read_whole(&store, SCENE_FILE).map_err(|e| CommandError::new(e, hint))?;
    Ok((store, bytes))
}

/// Reads an octree file, binary or XML, and checks all that it says about itself.
///
/// # Errors
/// What cannot be read, or is wrong.
pub(crate) fn read_octree(store: &dyn Store, name: &str) -> Result<Octree, Fault> {
    let len = store
        .len(name)
        .map_err(|e| Fault::unreadable(store, name, "opened", &e))?;
    let head = store
        .read(name, 0, len.min(64) as usize)
        .map_err(|e| Fault::unreadable(store, name, "read", &e))?;
    if !octree_binary::is_binary(&head) && len > MAX_XML_BYTES {
        let what = format!("an XML octree of {len} bytes is above {MAX_XML_BYTES}");
        return Err(Fault::new(store, name, FormatError::file(what)));
    }
    let bytes = read_whole(store, name)?;
    octree::decode_any(&bytes).map_err(|e| Fault::new(store, name, e))
}

fn read_whole(store: &dyn Store, name: &str) -> Result<Vec<u8>, Fault> {
    let fail = |e: io::Error| Fault::unreadable(store, name, "read", &e);
    let len = store.len(name).map_err(fail)?;
    let len = usize::try_from(len).map_err(|e| fail(io::Error::other(e)))?;
    store.read(name, 0, len).map_err(fail)
}

/// Bytes of all files below a folder. Symbolic links are not followed.
///
/// # Errors
/// A folder that cannot be read.
pub(crate) fn folder_bytes(folder: &Path) -> Result<u64, CommandError> {
    let (mut bytes, mut folders) = (0, vec![folder.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        let fail = |e: io::Error| CommandError::from(named(&folder, &e));
        for entry in fs::read_dir(&folder).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let meta = entry.metadata().map_err(|e| named(&entry.path(), &e))?;
            if meta.is_dir() {
                folders.push(entry.path());
            } else if meta.is_file() {
                bytes += meta.len();
            }
        }
    }
    Ok(bytes)
}

/// Names of files below a folder, relative to it with `/`, in no order; at most so many.
///
/// # Errors
/// A folder that cannot be read.
pub(crate) fn files_below(folder: &Path, most: usize) -> io::Result<Vec<String>> {
    let (mut files, mut folders) = (Vec::new(), vec![String::new()]);
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(folder.join(&inner))? {
            let entry = entry?;
            let name = format!("{inner}{}", entry.file_name().to_string_lossy());
            if files.len() == most {
                return Ok(files);
            }
            match entry.file_type()? {
                kind if kind.is_dir() => folders.push(name + "/"),
                kind if kind.is_file() => files.push(name),
                _ => {}
            }
        }
    }
    Ok(files)
}

fn named(path: &Path, e: &io::Error) -> io::Error {
    io::Error::new(e.kind(), format!("{}: {e}", path.display()))
}

/// Writes to standard output. A reader that has gone away, as `head` does, is no error.
///
/// # Errors
/// If standard output cannot be written.
pub(crate) fn print(text: &str) -> Result<(), CommandError> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(named(Path::new("standard output"), &e).into())
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_measured_through_all_depths() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir_all(dir.path().join("a/b")).unwrap();
        fs::write(dir.path().join("one"), [0; 10]).unwrap();
        fs::write(dir.path().join("a/b/two"), [0; 5]).unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink("/", dir.path().join("a/link")).unwrap();
        assert_eq!(folder_bytes(dir.path()).unwrap(), 15);
        let missing = folder_bytes(&dir.path().join("none")).unwrap_err();
        assert!(missing.message.contains("none"), "{missing}");
    }

    #[test]
    fn what_is_wrong_is_one_line_with_the_path() {
        let dir = tempfile::tempdir().unwrap();
        let missing = open_scene(dir.path()).unwrap_err().message;
        assert!(missing.contains("scene.xml"), "{missing}");
        fs::write(dir.path().join("scene.xml"), "<OctTreeGroup Colour=\"red\"/>").unwrap();
        let unknown = open_scene(dir.path()).unwrap_err().message;
        assert!(
            unknown.contains("scene.xml: line 1, column") && unknown.contains("Colour"),
            "{unknown}"
        );
        fs::write(dir.path().join("a.oct"), "nonsense\nin lines").unwrap();
        let store = FolderStore::open(dir.path()).unwrap();
        let octree = read_octree(&store, "a.oct").unwrap_err().to_string();
        assert!(octree.contains("a.oct: ") && !octree.contains('\n'), "{octree}");
    }
}
