//! A terrain in a folder, read by positioned reads: a file that is truncated under us is an error, where a mapping of
//! it would end the program.

use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::{Store, ends_early};

/// Open files kept. Loader threads read few files at a time, most of them again and again.
const OPEN_FILES: usize = 64;

/// The files below one folder.
///
/// A name that leaves the folder, by `..`, by an absolute path or through a symbolic link below it, is refused. The
/// folder itself may be a link. [`Store::len`] opens the file anew, so that a page which begins by asking for the length
/// sees a file that was replaced; pages begun before are found out by their checksums.
#[derive(Debug)]
pub struct FolderStore {
    folder: PathBuf,
    open: Mutex<OpenFiles>,
}

#[derive(Debug, Default)]
struct OpenFiles {
    files: HashMap<String, (u64, Arc<File>)>,
    clock: u64,
}

impl OpenFiles {
    fn get(&mut self, name: &str) -> Option<Arc<File>> {
        self.clock += 1;
        let (used, file) = self.files.get_mut(name)?;
        *used = self.clock;
        Some(file.clone())
    }

    /// Keeps a file in place of the one of that name; gives back what was pushed out, to be closed outside the lock.
    fn put(&mut self, name: &str, file: Arc<File>) -> [Option<(u64, Arc<File>)>; 2] {
        self.clock += 1;
        let replaced = self.files.insert(name.to_owned(), (self.clock, file));
        let mut oldest = None;
        if self.files.len() > OPEN_FILES {
            let name = self
                .files
                .iter()
                .min_by_key(|(_, (used, _))| *used)
                .map(|(name, _)| name.clone());
            oldest = name.and_then(|name| self.files.remove(&name));
        }
        [replaced, oldest]
    }
}

impl FolderStore {
    /// The store of a folder.
    ///
    /// # Errors
    /// If there is no such folder; the message names it.
    pub fn open(path: impl AsRef<Path>) -> io::Result<Self> {
        let folder = path.as_ref().to_path_buf();
        let named = |e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", folder.display()));
        if !std::fs::metadata(&folder).map_err(named)?.is_dir() {
            return Err(named(io::Error::new(
                io::ErrorKind::NotADirectory,
                "not a folder",
            )));
        }
        Ok(Self {
            folder,
            open: Mutex::default(),
        })
    }

    /// The path of a name, after the check that it lies in the folder.
    fn locate(&self, name: &str) -> io::Result<PathBuf> {
        let refuse = |what: &str| io::Error::new(io::ErrorKind::InvalidInput, what);
        if name.contains(['\\', '\0']) {
            return Err(refuse("the name may not contain a backslash or a zero"));
        }
        let mut path = self.folder.clone();
        let mut last = None;
        for component in Path::new(name).components() {
            match component {
                Component::CurDir => {}
                Component::Normal(part) => {
                    path.push(part);
                    let found = std::fs::symlink_metadata(&path)?;
                    if found.file_type().is_symlink() {
                        return Err(refuse("symbolic links inside a terrain folder are not followed"));
                    }
                    last = Some(found);
                }
                _ => return Err(refuse("the name leaves the terrain folder")),
            }
        }
        match last {
            Some(found) if found.is_file() => Ok(path),
            _ => Err(refuse("not a regular file")),
        }
    }

    fn open_file(&self, name: &str) -> io::Result<Arc<File>> {
        let file = Arc::new(File::open(self.locate(name)?)?);
        let closed = self
            .open
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .put(name, file.clone());
        drop(closed);
        Ok(file)
    }

    fn cached(&self, name: &str) -> Option<Arc<File>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).get(name)
    }
}

impl Store for FolderStore {
    fn len(&self, name: &str) -> io::Result<u64> {
        Ok(self.open_file(name)?.metadata()?.len())
    }

    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let file = match self.cached(name) {
            Some(file) => file,
            None => self.open_file(name)?,
        };
        let object = file.metadata()?.len();
        if offset.checked_add(len as u64).is_none_or(|end| end > object) {
            return Err(ends_early(offset, len, object));
        }
        let mut bytes = vec![0; len];
        read_exact_at(&file, &mut bytes, offset)?;
        Ok(bytes)
    }

    fn describe(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(n) => {
                bytes = &mut bytes[n..];
                offset += n as u64;
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, FolderStore) {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("a")).unwrap();
        std::fs::write(dir.path().join("a/b.oct"), b"0123456789").unwrap();
        let store = FolderStore::open(dir.path()).unwrap();
        (dir, store)
    }

    #[test]
    fn reads_ranges_and_refuses_ranges_past_the_end() {
        let (dir, store) = folder();
        assert_eq!(store.len("a/b.oct").unwrap(), 10);
        assert_eq!(store.read("a/b.oct", 3, 4).unwrap(), b"3456");
        for (offset, len) in [(8, 3), (11, 0), (u64::MAX, 2), (0, 1 << 40)] {
            let e = store.read("a/b.oct", offset, len).unwrap_err();
            assert_eq!(e.kind(), io::ErrorKind::UnexpectedEof);
        }
        assert_eq!(
            store.describe("a/b.oct"),
            dir.path().join("a/b.oct").display().to_string()
        );
    }

    #[test]
    fn a_file_truncated_under_an_open_handle_is_an_error() {
        let (dir, store) = folder();
        assert_eq!(store.read("a/b.oct", 0, 10).unwrap().len(), 10);
        File::options()
            .write(true)
            .open(dir.path().join("a/b.oct"))
            .unwrap()
            .set_len(4)
            .unwrap();
        assert_eq!(
            store.read("a/b.oct", 0, 10).unwrap_err().kind(),
            io::ErrorKind::UnexpectedEof
        );
        assert_eq!(store.read("a/b.oct", 0, 4).unwrap(), b"0123");
    }

    #[test]
    fn asking_for_the_length_sees_a_replaced_file() {
        let (dir, store) = folder();
        assert_eq!(store.read("a/b.oct", 0, 2).unwrap(), b"01");
        std::fs::write(dir.path().join("new"), b"abc").unwrap();
        std::fs::rename(dir.path().join("new"), dir.path().join("a/b.oct")).unwrap();
        assert_eq!(store.len("a/b.oct").unwrap(), 3);
        assert_eq!(store.read("a/b.oct", 0, 2).unwrap(), b"ab");
    }

    #[test]
    fn names_that_leave_the_folder_are_refused() {
        let (dir, store) = folder();
        let outside = tempfile::tempdir().unwrap();
        std::fs::write(outside.path().join("secret"), b"x").unwrap();
        let absolute = outside.path().join("secret").display().to_string();
        for name in [
            "",
            ".",
            "a",
            "../b.oct",
            "a/../../x",
            "a\\b.oct",
            "a/b.oct\0",
            &absolute,
        ] {
            assert!(store.len(name).is_err(), "{name:?}");
            assert!(store.read(name, 0, 1).is_err(), "{name:?}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(outside.path(), dir.path().join("link")).unwrap();
            std::os::unix::fs::symlink(&absolute, dir.path().join("file")).unwrap();
            assert!(store.len("link/secret").is_err());
            assert!(store.len("file").is_err());
        }
        assert!(FolderStore::open(dir.path().join("nowhere")).is_err());
        assert!(FolderStore::open(dir.path().join("a/b.oct")).is_err());
    }

    #[test]
    fn more_files_than_are_kept_open() {
        let (dir, store) = folder();
        for k in 0..OPEN_FILES * 2 {
            std::fs::write(dir.path().join(format!("{k}")), [k as u8]).unwrap();
        }
        for k in (0..OPEN_FILES * 2).chain(0..OPEN_FILES * 2) {
            assert_eq!(store.read(&k.to_string(), 0, 1).unwrap(), [k as u8]);
        }
        assert!(store.open.lock().unwrap().files.len() <= OPEN_FILES);
    }
}
