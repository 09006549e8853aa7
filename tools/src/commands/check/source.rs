//! The scene that is checked: its text, and where in it each tree is named.
//!
//! Any thread.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use brickfell_formats::scene::Scene;
use brickfell_formats::{FormatError, Place, nearest};
use brickfell_pager::FolderStore;
use brickfell_runtime::terrain::SCENE_FILE;

use crate::commands::database::files_below;
use crate::commands::fault::Fault;

/// Files of the folder that are looked through for one with a name like that of a missing one.
const MOST_FILES: usize = 100_000;

/// A database's folder and the text of its scene.
pub(super) struct Source<'a> {
    /// The folder.
    pub(super) store: &'a FolderStore,
    dir: &'a Path,
    text: &'a [u8],
    places: OnceLock<BTreeMap<String, Place>>,
    files: OnceLock<Vec<String>>,
}

impl<'a> Source<'a> {
    pub(super) fn new(store: &'a FolderStore, dir: &'a Path, text: &'a [u8]) -> Self {
        Self {
            store,
            dir,
            text,
            places: OnceLock::new(),
            files: OnceLock::new(),
        }
    }

    /// A fault of the scene as a whole.
    pub(super) fn scene(&self, message: impl Into<String>) -> Fault {
        Fault::new(self.store, SCENE_FILE, FormatError::file(message))
    }

    /// A fault of the scene where it names a tree file.
    pub(super) fn reference(&self, file: &str, message: impl std::fmt::Display) -> Fault {
        Fault::new(self.store, SCENE_FILE, self.named(file, message))
    }

    /// A tree file that is not there, and those that are and have a name like it.
    pub(super) fn missing(&self, file: &str) -> Fault {
        let error = self.named(file, "there is no such file");
        let files = self.files.get_or_init(|| {
            let all = files_below(self.dir, MOST_FILES).unwrap_or_default();
            let other = |name: &String| name != SCENE_FILE && !name.ends_with(".brk");
            all.into_iter().filter(other).collect()
        });
        let last = |name: &str| name.rfind('/').map_or(name, |k| &name[k + 1..]).to_string();
        let mut elsewhere = files.iter().map(String::as_str);
        let meant = elsewhere.find(|name| last(name) == last(file));
        let meant = meant.or_else(|| nearest(file, files.iter().map(String::as_str)));
        let suggestion = meant.map(|name| format!("did you mean {name}?"));
        Fault::new(self.store, SCENE_FILE, error.suggest(suggestion))
    }

    fn named(&self, file: &str, message: impl std::fmt::Display) -> FormatError {
        let places = self.places.get_or_init(|| Scene::tree_file_places(self.text));
        FormatError {
            place: places.get(file).copied().unwrap_or(Place::File),
            ..FormatError::file(format!("TreeFile=\"{file}\": {message}"))
        }
    }
}
