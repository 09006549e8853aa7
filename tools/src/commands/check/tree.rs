//! One tree: its octree file and the brick files that belong to it.
//!
//! Called on any thread, one tree at a time each.

use std::io::ErrorKind;

use brickfell_formats::bricks::brick_file_name;
use brickfell_formats::morton;
use brickfell_formats::octree::{BRICK, TreeHeader, child_positions};
use brickfell_pager::Store;
use glam::UVec3;
use indicatif::ProgressBar;

use super::bricks::{Level, check_level};
use crate::commands::database::read_octree;
use crate::commands::fault::Fault;

/// What was found out about a tree.
#[derive(Debug, Default)]
pub(super) struct TreeReport {
    /// The header, if the octree file can be read.
    pub(super) header: Option<TreeHeader>,
    /// Whether there is no octree file. What to say of that depends on who names it.
    pub(super) missing: bool,
    /// What is wrong, in the order of the files.
    pub(super) faults: Vec<Fault>,
    /// Bricks that the octree refers to.
    pub(super) bricks: u64,
    /// Chunks that were decoded.
    pub(super) chunks: u64,
    /// The brick files that can be read, and whether they are in blocks.
    pub(super) files: Vec<(String, bool)>,
}

/// Reads everything that belongs to the tree in an octree file.
pub(super) fn check(store: &dyn Store, name: &str, bar: &ProgressBar) -> TreeReport {
    let mut report = TreeReport::default();
    if let Err(e) = store.len(name)
        && e.kind() == ErrorKind::NotFound
    {
        report.missing = true;
        return report;
    }
    let octree = match read_octree(store, name) {
        Ok(octree) => octree,
        Err(fault) => {
            report.faults.push(fault);
            return report;
        }
    };
    bar.inc(store.len(name).unwrap_or(0));
    if let Err(e) = octree.validate() {
        report.faults.push(Fault::new(store, name, e));
        return report;
    }
    report.header = Some(octree.header);
    let mut positions = vec![UVec3::ZERO];
    for (level, nodes) in (0..).zip(&octree.levels) {
        let with_brick = nodes
            .iter()
            .zip(&positions)
            .filter(|(n, _)| n.structure & BRICK != 0);
        let bricks: Vec<u64> = with_brick.map(|(_, p)| morton::encode(*p)).collect();
        if !bricks.is_empty() {
            report.bricks += bricks.len() as u64;
            let level = Level {
                store,
                file: brick_file_name(name, level),
                level,
                layout: octree.header.layout,
                bricks,
            };
            let checked = check_level(&level, bar);
            report.chunks += checked.chunks;
            report.faults.extend(checked.faults);
            report
                .files
                .extend(checked.blocks.map(|blocks| (level.file, blocks)));
        }
        positions = child_positions(nodes, &positions);
    }
    report
}
