//! `brickfell check`: reads everything in a database and says what is wrong with it.
//!
//! A fault is one line, `path: place: message; suggestion`, or an object of the JSON, and makes the exit code 1. A warning is something
//! that is drawn but probably not meant. What a scene has wrong is told all at once, and the rest of it is checked all the same. Trees,
//! and the chunks of their levels, are read in parallel; the output is in the order of the scene whatever the number of threads.

pub(crate) mod bricks;
mod order;
mod seams;
mod source;
mod tree;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use brickfell_formats::FormatError;
use brickfell_formats::bricks::brick_file_name;
use brickfell_formats::scene::{Bounds, CoarseOctTree, Group, PagedOctTree, Scene};
use brickfell_pager::FolderStore;
use brickfell_runtime::terrain::SCENE_FILE;
use indicatif::{HumanBytes, HumanCount, ProgressBar};
use rayon::prelude::*;

use super::CommandError;
use super::database::{folder_bytes, open_folder, print};
use super::fault::Fault;
use super::say::bar;
use serde::Serialize;
use source::Source;
use tree::TreeReport;

/// Arguments of `check`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the database: the one that holds scene.xml
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// Print JSON: faults and warnings (path, line and column or byte, message, suggestion), trees, coarse_trees, bricks, chunks, bytes
    #[arg(long)]
    pub json: bool,
}

/// What was found out about a database.
#[derive(Debug, Default, Serialize)]
struct Report {
    faults: Vec<Fault>,
    warnings: Vec<Fault>,
    trees: usize,
    coarse_trees: usize,
    bricks: u64,
    chunks: u64,
    bytes: u64,
}

/// Runs the command.
///
/// # Errors
/// A folder or scene that cannot be read at all; everything else is a line of the output.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let (store, text) = open_folder(&args.dir)?;
    let bytes = folder_bytes(&args.dir)?;
    let bar = bar(
        bytes,
        "{bar:32} {bytes}/{total_bytes}  {bytes_per_sec}  {eta} left",
    );
    let mut report = check(&store, &args.dir, &text, &bar);
    report.bytes = bytes;
    bar.finish_and_clear();
    print(&match args.json {
        true => serde_json::to_string_pretty(&report)? + "\n",
        false => describe(&report),
    })?;
    Ok(if report.faults.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// The report for people.
fn describe(report: &Report) -> String {
    let mut text = String::new();
    for fault in &report.faults {
        let _ = writeln!(text, "{fault}");
    }
    for warning in &report.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    let _ = writeln!(
        text,
        "{} trees, {} coarse trees, {} bricks in {} chunks, {}: {}, {}",
        HumanCount(report.trees as u64),
        HumanCount(report.coarse_trees as u64),
        HumanCount(report.bricks),
        HumanCount(report.chunks),
        HumanBytes(report.bytes),
        counted(report.faults.len(), "fault"),
        counted(report.warnings.len(), "warning"),
    );
    text
}

fn counted(n: usize, what: &str) -> String {
    match n {
        0 => format!("no {what}s"),
        1 => format!("1 {what}"),
        n => format!("{} {what}s", HumanCount(n as u64)),
    }
}

fn check(store: &FolderStore, dir: &Path, text: &[u8], bar: &ProgressBar) -> Report {
    let mut report = Report::default();
    let source = &Source::new(store, dir, text);
    let (scene, faults) = match Scene::parse_usable(text) {
        Ok(read) => read,
        Err(fault) => {
            report.faults.push(Fault::new(store, SCENE_FILE, fault));
            return report;
        }
    };
    let faults = faults.into_iter().map(|e| Fault::new(store, SCENE_FILE, e));
    report.faults.extend(faults);
    let references: Vec<&PagedOctTree> = scene.trees().collect();
    let coarse: Vec<&CoarseOctTree> = scene.coarse_trees().collect();
    (report.trees, report.coarse_trees) = (references.len(), coarse.len());
    if references.is_empty() {
        report.warnings.push(source.scene("the scene has no trees"));
    }
    let all = || references.iter().copied().chain(coarse.iter().map(|c| &c.tree));
    let mut files: Vec<&str> = all().map(|t| t.tree_file.as_str()).collect();
    files.sort_unstable();
    files.dedup();
    let trees: BTreeMap<&str, TreeReport> = files
        .par_iter()
        .map(|name| (*name, tree::check(store, name, bar)))
        .collect();

    check_names(source, &files, &mut report);
    check_layouts(source, &trees, &mut report);
    check_groups(source, &scene.root, &trees, &mut report);
    let mut named = BTreeMap::new();
    for reference in all() {
        let Some(tree) = trees.get(reference.tree_file.as_str()) else {
            continue;
        };
        if named.insert(reference.tree_file.as_str(), ()).is_none() {
            report.faults.extend(tree.faults.iter().cloned());
            if tree.missing {
                report.faults.push(source.missing(&reference.tree_file));
            }
            report.bricks += tree.bricks;
            report.chunks += tree.chunks;
        }
        check_reference(source, reference, tree, &mut report);
    }
    for coarse in &coarse {
        check_voxel(source, coarse, &trees, &mut report);
    }
    order::check(source, &references, &trees, &mut report);
    report
}

/// Brick files are named after the tree file without its extension, so that part must differ.
fn check_names(source: &Source, files: &[&str], report: &mut Report) {
    let mut stems = BTreeMap::new();
    for file in files {
        if let Some(other) = stems.insert(brick_file_name(file, 0), file) {
            let what = format!("would share its brick files with {other}: only their extensions differ");
            report.faults.push(source.reference(file, what));
        }
    }
}

fn check_layouts(source: &Source, trees: &BTreeMap<&str, TreeReport>, report: &mut Report) {
    let mut with_bricks = trees
        .iter()
        .filter(|(_, t)| t.bricks > 0)
        .filter_map(|(name, t)| Some((*name, t.header?.layout)));
    let Some((first, layout)) = with_bricks.next() else {
        return;
    };
    for (name, other) in with_bricks.filter(|(_, other)| *other != layout) {
        let what = format!("sample layout {other:?}, but {first} has {layout:?}: a scene has one");
        let error = FormatError::at(13, what);
        report.faults.push(Fault::new(source.store, name, error));
    }
}

/// Groups: how they say that bricks are stored, and boxes that do not hold what is in them.
fn check_groups(source: &Source, root: &Group, trees: &BTreeMap<&str, TreeReport>, report: &mut Report) {
    let mut groups = vec![root];
    while let Some(group) = groups.pop() {
        let own = group.trees.iter().chain(group.coarse.iter().map(|c| &c.tree));
        let own = own.filter_map(|t| trees.get(t.tree_file.as_str()));
        for (file, blocks) in own.flat_map(|t| &t.files) {
            if *blocks != group.compressed {
                let (are, says) = match blocks {
                    true => ("are block-compressed", "NO"),
                    false => ("are not block-compressed", "YES"),
                };
                let what = format!("its bricks {are}, but the scene says Compressed=\"{says}\"");
                let error = FormatError::at(16, what);
                report.faults.push(Fault::new(source.store, file, error));
            }
        }
        let inside = group.trees.iter().filter_map(|t| t.bounds);
        let inside = inside.chain(group.coarse.iter().filter_map(|c| c.tree.bounds));
        let inside = inside.chain(group.groups.iter().filter_map(|g| g.bounds));
        for inner in inside {
            if let Some(outer) = group.bounds.filter(|outer| !holds(outer, &inner)) {
                let what = format!(
                    "the box of a group, {} to {}, does not hold one inside it, {} to {}",
                    outer.min, outer.max, inner.min, inner.max
                );
                report.warnings.push(source.scene(what));
            }
        }
        groups.extend(&group.groups);
    }
}

fn holds(outer: &Bounds, inner: &Bounds) -> bool {
    let slack = tolerance(&[inner.min, inner.max]);
    (outer.min - slack).cmple(inner.min).all() && (outer.max + slack).cmpge(inner.max).all()
}

/// How far a written coordinate of a box may be from the computed one, metres: decimals cut short by hand.
fn tolerance(corners: &[glam::DVec3; 2]) -> f64 {
    let [min, max] = corners;
    (max - min).max_element() * 1e-6 + min.abs().max(max.abs()).max_element() * 1e-12
}

/// What the scene says about a tree against what the tree says.
fn check_reference(source: &Source, reference: &PagedOctTree, tree: &TreeReport, report: &mut Report) {
    let Some(header) = tree.header else {
        return;
    };
    let corners = header.bounds();
    let slack = tolerance(&corners);
    let name = &reference.tree_file;
    let [min, max] = corners;
    let octree = Bounds { min, max };
    let mut drawn = reference.bounds.unwrap_or(octree);
    if !holds(&octree, &drawn) {
        let what = format!(
            "its box is {} to {}, the octree's only {min} to {max}",
            drawn.min, drawn.max
        );
        report.faults.push(source.reference(name, what));
        drawn = octree;
    }
    // As far as the corner that is farthest from the centre.
    let center = reference.center;
    let needed = (center - drawn.min)
        .abs()
        .max((drawn.max - center).abs())
        .length();
    // A per mille covers radii written with few digits.
    if needed > reference.radius * 1.001 + slack {
        let what = format!(
            "its sphere (Center, Radius {}) does not hold its box, which needs {needed:.2}",
            reference.radius
        );
        report.warnings.push(source.reference(name, what));
    }
}

/// Where a coarse tree takes over against what it has to show there.
fn check_voxel(
    source: &Source,
    coarse: &CoarseOctTree,
    trees: &BTreeMap<&str, TreeReport>,
    report: &mut Report,
) {
    let name = coarse.tree.tree_file.as_str();
    let Some(header) = trees.get(name).and_then(|tree| tree.header) else {
        return;
    };
    if (coarse.voxel - header.voxel_size).abs() > header.voxel_size * 1e-6 {
        let what = format!("Voxel is {}, the octree's {}", coarse.voxel, header.voxel_size);
        report.faults.push(source.reference(name, what));
    }
}
