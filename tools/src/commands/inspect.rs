//! `brickfell inspect`: the scene graph as a tree of lines: groups, trees and coarse trees with their boxes, levels, bytes and bricks.
//!
//! Figures come from headers and lengths of files, so scenes of any size are looked over. What would be too many lines is summed up; the
//! JSON has every tree down to `--depth`. Terrains that are made from a seed have boxes only: nothing of them is on a disk.

mod lines;

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::process::ExitCode;

use brickfell_culler::{Aabb, Descend, GroupInfo, Statistics, TreeId, Visitor};
use brickfell_formats::bricks::{self, HEADER_BYTES, brick_file_name};
use brickfell_formats::scene::{Group, PagedOctTree};
use brickfell_pager::Store;
use brickfell_runtime::terrain::{Terrain, read_header};
use rayon::prelude::*;
use serde::Serialize;

use super::database::print;
use super::fault::Fault;
use super::info::WorldBox;
use super::say::bar;
use super::{CommandError, is_procedural, open_terrain};

/// Arguments of `inspect`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the database: the one that holds scene.xml; or `procedural:SEED?extent=METRES&voxel=METRES`
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// How deep groups are opened, 0 for the outermost alone [default: as far as a page or two can hold, all for --json]
    #[arg(long, value_name = "N")]
    pub depth: Option<usize>,
    /// Print JSON: scene (of each group bounds, children_overlap, sum, coarse_trees, trees, groups), nesting, widest, overlapping, faults
    #[arg(long)]
    pub json: bool,
}

/// A group.
#[derive(Debug, Serialize)]
struct GroupView {
    bounds: Option<WorldBox>,
    children_overlap: bool,
    sum: Sum,
    coarse_trees: Vec<TreeView>,
    trees: Vec<TreeView>,
    /// Empty where groups are not opened.
    groups: Vec<GroupView>,
}

/// What is in a group, and in the groups in it.
#[derive(Clone, Debug, Default, Serialize)]
struct Sum {
    groups: usize,
    trees: usize,
    coarse_trees: usize,
    bytes: u64,
    bricks: u64,
}

/// A tree.
#[derive(Clone, Debug, Serialize)]
struct TreeView {
    file: String,
    bounds: Option<WorldBox>,
    /// What its files say; none if they cannot be read, or are made from a seed.
    #[serde(flatten)]
    figures: Option<Figures>,
}

/// What the files of a tree say.
#[derive(Clone, Debug, Serialize)]
struct Figures {
    /// Levels, the root's included.
    levels: usize,
    /// Side of its finest voxel, metres.
    voxel_size: f64,
    /// Bytes of the octree and of all brick files.
    bytes: u64,
    /// Bricks by level, from the root.
    bricks_per_level: Vec<u64>,
    #[serde(skip)]
    bounds: WorldBox,
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Inspection<'a> {
    scene: &'a GroupView,
    nesting: usize,
    widest: usize,
    overlapping: usize,
    faults: &'a [String],
}

/// Runs the command; exit code 2 if something could not be read.
///
/// # Errors
/// A scene that cannot be read.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let (store, terrain) = open_terrain(&args.dir)?;
    let mut faults = terrain.faults.clone();
    let figures = match is_procedural(&args.dir) {
        true => HashMap::new(),
        false => all_figures(&*store, &terrain, &mut faults),
    };
    let (mut groups, mut statistics) = (Groups::default(), Statistics::default());
    terrain.graph.accept(&mut groups);
    terrain.graph.accept(&mut statistics);
    // The graph has a group around the scene's outermost.
    let mut order = groups.0.into_iter().skip(1);
    let mut scene = view(&terrain.scene.root, &mut order, &figures);
    if let Some(depth) = args.depth {
        scene.close(depth);
    }
    let Statistics {
        widest, overlapping, ..
    } = statistics;
    let nesting = statistics.nesting.saturating_sub(1);
    if args.json {
        let inspection = Inspection {
            scene: &scene,
            nesting,
            widest,
            overlapping,
            faults: &faults,
        };
        print(&(serde_json::to_string_pretty(&inspection)? + "\n"))?;
    } else {
        let name = args.dir.display().to_string();
        print(&lines::lines(&name, &scene, args.depth, nesting, &statistics))?;
        for fault in &faults {
            eprintln!("brickfell: {fault}");
        }
    }
    Ok(ExitCode::from(if faults.is_empty() { 0 } else { 2 }))
}

/// The groups of a graph, each before those in it.
#[derive(Default)]
struct Groups(Vec<GroupInfo>);

impl Visitor for Groups {
    fn enter_group(&mut self, group: &GroupInfo) -> Descend {
        self.0.push(*group);
        Descend::Yes
    }

    fn visit_tree(&mut self, _: TreeId, _: &Aabb, _: u32) {}
}

/// What the files of all trees say, by the names of their octrees.
fn all_figures<'t>(
    store: &dyn Store,
    terrain: &'t Terrain,
    faults: &mut Vec<String>,
) -> HashMap<&'t str, Figures> {
    let names: Vec<&str> = (terrain.trees.iter().chain(&terrain.coarse_trees))
        .map(String::as_str)
        .collect();
    let bar = bar(names.len() as u64, "{bar:32} {pos}/{len} trees, {eta} left");
    let read: Vec<Result<Figures, String>> = names
        .par_iter()
        .map(|name| {
            let figures = figures(store, name);
            bar.inc(1);
            figures
        })
        .collect();
    let mut all = HashMap::new();
    for (name, read) in names.into_iter().zip(read) {
        match read {
            Ok(figures) => {
                all.insert(name, figures);
            }
            // The terrain has told of trees that have no place.
            Err(fault) if !faults.contains(&fault) => faults.push(fault),
            Err(_) => {}
        }
    }
    all
}

fn figures(store: &dyn Store, name: &str) -> Result<Figures, String> {
    let header = read_header(store, name).map_err(|e| e.to_string())?;
    let mut bytes = (store.len(name)).map_err(|e| Fault::unreadable(store, name, "opened", &e))?;
    let mut bricks_per_level = Vec::new();
    for level in 0..=header.depth {
        let file = brick_file_name(name, level);
        let fail = |what: &'static str| {
            let (store, file) = (store, file.clone());
            move |e: std::io::Error| Fault::unreadable(store, &file, what, &e)
        };
        let len = match store.len(&file) {
            Err(e) if e.kind() == ErrorKind::NotFound => {
                bricks_per_level.push(0);
                continue;
            }
            len => len.map_err(fail("opened"))?,
        };
        let head = store
            .read(&file, 0, len.min(HEADER_BYTES as u64) as usize)
            .map_err(fail("read"))?;
        let header = bricks::decode_header(&head, len).map_err(|e| Fault::new(store, &file, e))?;
        bytes += len;
        bricks_per_level.push(u64::from(header.bricks));
    }
    Ok(Figures {
        levels: usize::from(header.depth) + 1,
        voxel_size: header.voxel_size,
        bytes,
        bricks_per_level,
        bounds: WorldBox::of(header.bounds()),
    })
}

/// A group as it is shown; `order` has the graph's groups in the scene's order.
fn view(
    group: &Group,
    order: &mut impl Iterator<Item = GroupInfo>,
    figures: &HashMap<&str, Figures>,
) -> GroupView {
    let info = order.next();
    let tree = |tree: &PagedOctTree| {
        let figures = figures.get(tree.tree_file.as_str());
        let bounds = tree.bounds.map(|b| WorldBox::of([b.min, b.max]));
        TreeView {
            file: tree.tree_file.clone(),
            bounds: bounds.or(figures.map(|f| f.bounds)),
            figures: figures.cloned(),
        }
    };
    let trees: Vec<TreeView> = group.trees.iter().map(tree).collect();
    let coarse_trees: Vec<TreeView> = group.coarse.iter().map(|c| tree(&c.tree)).collect();
    let groups: Vec<GroupView> = group.groups.iter().map(|g| view(g, order, figures)).collect();
    let mut sum = Sum {
        groups: groups.len(),
        trees: trees.len(),
        coarse_trees: coarse_trees.len(),
        ..Sum::default()
    };
    for figures in trees
        .iter()
        .chain(&coarse_trees)
        .filter_map(|t| t.figures.as_ref())
    {
        sum.bytes += figures.bytes;
        sum.bricks += figures.bricks_per_level.iter().sum::<u64>();
    }
    for inner in groups.iter().map(|g| &g.sum) {
        sum.groups += inner.groups;
        sum.trees += inner.trees;
        sum.coarse_trees += inner.coarse_trees;
        sum.bytes += inner.bytes;
        sum.bricks += inner.bricks;
    }
    let bounds = info.and_then(|i| i.bounds).map(|b| WorldBox::of([b.min, b.max]));
    GroupView {
        bounds,
        children_overlap: info.is_some_and(|i| !i.children_disjoint),
        sum,
        coarse_trees,
        trees,
        groups,
    }
}

impl GroupView {
    /// Takes away the groups that are so deep inside.
    fn close(&mut self, depth: usize) {
        match depth.checked_sub(1) {
            None => self.groups.clear(),
            Some(depth) => self.groups.iter_mut().for_each(|g| g.close(depth)),
        }
    }
}
