//! `build.json`: what a database is made from, so that a build can be resumed or refused.
//!
//! It is written before anything else and never changes. A folder is ours if it has one; an equal one means that the
//! trees already there are those that this build would make.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::Serialize;

use super::error::BuildError;

/// Name of the manifest in the output folder.
pub(crate) const MANIFEST: &str = "build.json";
/// Names of trees that turned out empty, one a line.
pub(crate) const EMPTY_TREES: &str = "empty_trees.txt";
/// The folder of trees.
pub(crate) const TREES: &str = "trees";
/// What a build leaves for itself while it is under way.
pub(crate) const SCRATCH: &str = "scratch";
/// The scene.
pub(crate) const SCENE: &str = "scene.xml";

const FORMAT: &str = "brickfell-build";
/// Raised whenever the builder makes other bytes from the same input.
const VERSION: u32 = 3;

/// What a database is made from.
#[derive(Debug, Serialize)]
pub(crate) struct Manifest {
    format: &'static str,
    version: u32,
    /// Voxel size in metres and everything else that decides the bytes.
    pub(crate) arguments: Arguments,
    inputs: Vec<InputFile>,
}

/// Arguments after defaults are filled in.
#[derive(Debug, Serialize)]
pub(crate) struct Arguments {
    pub(crate) voxel: f64,
    pub(crate) tree_voxels: u32,
    pub(crate) up: String,
    pub(crate) height_unit: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) terrain_rgb: Option<String>,
    pub(crate) layout: String,
    pub(crate) encoding: String,
    pub(crate) chunk_log2: u8,
    pub(crate) filter: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) voxelise: Option<String>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(crate) solid: bool,
    pub(crate) error: u8,
}

#[derive(Debug, Serialize)]
struct InputFile {
    role: &'static str,
    path: PathBuf,
    bytes: u64,
    /// Seconds and nanoseconds since 1970.
    modified: (u64, u32),
}

impl Manifest {
    /// Of arguments and input files (with what they are used for).
    ///
    /// # Errors
    /// If a file's size and time cannot be read.
    pub(crate) fn new(arguments: Arguments, inputs: &[(&'static str, &Path)]) -> Result<Self, BuildError> {
        let inputs = inputs.iter().map(|(role, path)| {
            let meta = fs::metadata(path).map_err(BuildError::io(path))?;
            let time = meta
                .modified()
                .ok()
                .and_then(|t| t.duration_since(UNIX_EPOCH).ok())
                .unwrap_or_default();
            Ok(InputFile {
                role,
                path: path.to_path_buf(),
                bytes: meta.len(),
                modified: (time.as_secs(), time.subsec_nanos()),
            })
        });
        let inputs = inputs.collect::<Result<_, BuildError>>()?;
        Ok(Self {
            format: FORMAT,
            version: VERSION,
            arguments,
            inputs,
        })
    }

    fn text(&self, path: &Path) -> Result<String, BuildError> {
        let text = serde_json::to_string_pretty(self).map_err(|e| BuildError::io(path)(e.into()))?;
        Ok(text + "\n")
    }
}

/// Makes the output folder ready and writes the manifest; what an equal manifest has finished stays.
///
/// # Errors
/// The folder is not ours, or (without `force`) made from something else.
pub(crate) fn claim(out: &Path, manifest: &Manifest, force: bool) -> Result<(), BuildError> {
    let path = out.join(MANIFEST);
    let text = manifest.text(&path)?;
    match fs::read(&path) {
        Ok(old) if old == text.as_bytes() && !force => return Ok(()),
        Ok(old) if is_ours(&old) => {
            if !force {
                return Err(BuildError::Exists(out.to_path_buf()));
            }
            remove_ours(out)?;
        }
        Ok(_) => return Err(BuildError::Foreign(out.to_path_buf())),
        Err(_) => {
            if !is_free(out)? {
                return Err(BuildError::Foreign(out.to_path_buf()));
            }
        }
    }
    let trees = out.join(TREES);
    fs::create_dir_all(&trees).map_err(BuildError::io(&trees))?;
    write_whole(&path, text.as_bytes())
}

/// Whether a build may write to the folder: it is not there, is ours, or has nothing in it but what a build makes before its manifest.
///
/// # Errors
/// If it cannot be read.
pub(crate) fn is_free(out: &Path) -> Result<bool, BuildError> {
    if !out.exists() || fs::read(out.join(MANIFEST)).is_ok_and(|old| is_ours(&old)) {
        return Ok(true);
    }
    let mut entries = fs::read_dir(out).map_err(BuildError::io(out))?.flatten();
    let is_empty = |folder: &Path| fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    Ok(entries.all(|entry| {
        let name = entry.file_name();
        name == SCRATCH || name == partial_name(MANIFEST.as_ref()) || name == TREES && is_empty(&entry.path())
    }))
}

fn is_ours(manifest: &[u8]) -> bool {
    serde_json::from_slice::<serde_json::Value>(manifest)
        .is_ok_and(|v| v.get("format").and_then(|f| f.as_str()) == Some(FORMAT))
}

/// Removes what a build writes, and nothing else.
fn remove_ours(out: &Path) -> Result<(), BuildError> {
    let trees = out.join(TREES);
    if let Ok(entries) = fs::read_dir(&trees) {
        for entry in entries
            .flatten()
            .filter(|e| is_tree_name(&e.file_name().to_string_lossy()))
        {
            remove_tree(&entry.path())?;
        }
    }
    let _ = fs::remove_dir(&trees);
    // Bins may be this run's own.
    remove_scratch_files(out, &["tile_", "root_"])?;
    for name in [SCENE, EMPTY_TREES, MANIFEST] {
        let path = out.join(name);
        if path.exists() {
            fs::remove_file(&path).map_err(BuildError::io(&path))?;
        }
    }
    Ok(())
}

/// Removes a tree's folder, as far as it holds files of a tree.
///
/// # Errors
/// If a file cannot be removed.
pub(crate) fn remove_tree(folder: &Path) -> Result<(), BuildError> {
    for entry in fs::read_dir(folder).map_err(BuildError::io(folder))?.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with("tree.") && (name.ends_with(".oct") || name.ends_with(".brk")) {
            fs::remove_file(entry.path()).map_err(BuildError::io(&entry.path()))?;
        }
    }
    let _ = fs::remove_dir(folder);
    Ok(())
}

/// Removes what builds leave for themselves.
///
/// # Errors
/// If a file cannot be removed.
pub(crate) fn remove_scratch(out: &Path) -> Result<(), BuildError> {
    remove_scratch_files(out, &["tile_", "bin_", "root_"])
}

fn remove_scratch_files(out: &Path, starts: &[&str]) -> Result<(), BuildError> {
    let scratch = out.join(SCRATCH);
    if let Ok(entries) = fs::read_dir(&scratch) {
        for entry in entries.flatten() {
            let name = entry.file_name();
            if starts
                .iter()
                .any(|start| name.to_string_lossy().starts_with(*start))
            {
                fs::remove_file(entry.path()).map_err(BuildError::io(&entry.path()))?;
            }
        }
        let _ = fs::remove_dir(&scratch);
    }
    Ok(())
}

/// Of a tree or of a coarse tree.
fn is_tree_name(name: &str) -> bool {
    let name = name.strip_suffix(PARTIAL).unwrap_or(name);
    let name = match name.strip_prefix('g').and_then(|rest| rest.split_once('_')) {
        Some((height, rest)) if height.parse::<u8>().is_ok() => rest,
        _ => name,
    };
    let parts: Vec<&str> = name.split('_').collect();
    parts.len() == 3
        && parts.iter().zip(["x", "y", "z"]).all(|(part, axis)| {
            part.strip_prefix(axis)
                .is_some_and(|number| number.parse::<i64>().is_ok())
        })
}

/// Ending of a folder whose tree is being written.
pub(crate) const PARTIAL: &str = ".partial";

/// What a file is called while it is being written.
fn partial_name(name: &OsStr) -> OsString {
    let mut partial = name.to_os_string();
    partial.push(PARTIAL);
    partial
}

/// Writes a file under another name and renames it into place.
///
/// # Errors
/// If that fails.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), BuildError> {
    let partial = PathBuf::from(partial_name(path.as_os_str()));
    let write = || {
        let mut file = fs::File::create(&partial)?;
        std::io::Write::write_all(&mut file, bytes)?;
        file.sync_data()
    };
    write().map_err(BuildError::io(&partial))?;
    fs::rename(&partial, path).map_err(BuildError::io(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_build_made_before_its_manifest_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        assert!(is_free(out).unwrap());
        // As a build that was killed leaves it.
        fs::create_dir(out.join(TREES)).unwrap();
        fs::write(out.join(partial_name(MANIFEST.as_ref())), "{").unwrap();
        assert!(is_free(out).unwrap());
        fs::write(out.join(TREES).join("oak"), "").unwrap();
        assert!(!is_free(out).unwrap());
    }

    #[test]
    fn names_of_trees() {
        assert!(is_tree_name("x-1_y20_z3") && is_tree_name("x0_y0_z0.partial"));
        assert!(is_tree_name("g12_x-1_y20_z3") && !is_tree_name("g_x1_y2_z3"));
        assert!(!is_tree_name("x1_y2") && !is_tree_name("x_y_z") && !is_tree_name("photos"));
    }
}
