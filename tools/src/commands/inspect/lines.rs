//! The scene graph as lines for people.
//!
//! ```text
//! db: 5 trees, 2 coarse trees in 3 groups, 1.2 MiB
//! └─ group (0, 0, 2) to (64, 32, 20) m: 5 trees, 1 coarse tree, 1.2 MiB
//!    ├─ coarse trees/g1.oct (0, 0, 2) to (64, 32, 20) m: 0.5 m, 30 KiB, bricks 1 8 20
//!    ├─ tree trees/a.oct …
//!    └─ group …
//! ```

use brickfell_culler::Statistics;
use indicatif::{HumanBytes, HumanCount};

use super::{Figures, GroupView, Sum, TreeView};
use crate::commands::info::WorldBox;

/// Lines that a scene takes at most unless a depth is given.
const MOST_LINES: usize = 200;
/// Trees of a group that are listed one by one.
const LISTED_TREES: usize = 16;

/// All lines.
pub(super) fn lines(
    name: &str,
    scene: &GroupView,
    depth: Option<usize>,
    nesting: usize,
    statistics: &Statistics,
) -> String {
    let depth = depth.unwrap_or_else(|| {
        let fits = |depth: &usize| count(scene, *depth) <= MOST_LINES;
        (1..nesting).take_while(fits).last().unwrap_or(0).max(1)
    });
    let mut text = format!("{name}: {}\n", group(scene));
    below(&mut text, scene, depth, "");
    let Statistics {
        widest,
        empty,
        overlapping,
        ..
    } = statistics;
    text + &format!(
        "{} nested {nesting} deep, up to {widest} children; {empty} of {} trees empty; children overlap in \
         {overlapping} groups\n",
        counted(scene.sum.groups + 1, "group"),
        statistics.trees
    )
}

/// Lines of a group opened so deep, its own not counted.
fn count(group: &GroupView, depth: usize) -> usize {
    let trees = group.trees.len().min(LISTED_TREES + 1) + group.coarse_trees.len().min(LISTED_TREES + 1);
    let Some(deeper) = depth.checked_sub(1) else {
        return trees;
    };
    let inner = group.groups.iter().map(|g| 1 + count(g, deeper));
    trees + inner.sum::<usize>()
}

/// Writes what is in a group.
fn below(text: &mut String, of: &GroupView, depth: usize, indent: &str) {
    let mut lines: Vec<(String, Option<&GroupView>)> = Vec::new();
    for (kind, trees) in [("coarse", &of.coarse_trees), ("tree", &of.trees)] {
        let listed = trees.iter().take(LISTED_TREES);
        lines.extend(listed.map(|t| (tree(kind, t), None)));
        let mut rest = Sum::default();
        for tree in trees.iter().skip(LISTED_TREES) {
            rest.trees += 1;
            if let Some(figures) = &tree.figures {
                rest.bytes += figures.bytes;
                rest.bricks += figures.bricks_per_level.iter().sum::<u64>();
            }
        }
        if rest.trees > 0 {
            lines.push((format!("… and {} more", sum(&rest)), None));
        }
    }
    if depth > 0 {
        let opened = of.groups.iter().map(|g| (format!("group {}", group(g)), Some(g)));
        lines.extend(opened);
    }
    let last = lines.len().saturating_sub(1);
    for (k, (line, inner)) in lines.into_iter().enumerate() {
        let (branch, trunk) = if k == last {
            ("└─ ", "   ")
        } else {
            ("├─ ", "│  ")
        };
        text.push_str(&format!("{indent}{branch}{line}\n"));
        if let Some(inner) = inner {
            below(text, inner, depth - 1, &format!("{indent}{trunk}"));
        }
    }
}

fn group(group: &GroupView) -> String {
    let overlap = if group.children_overlap {
        ", children overlap"
    } else {
        ""
    };
    format!("{}: {}{overlap}", extent(group.bounds.as_ref()), sum(&group.sum))
}

fn counted(n: usize, noun: &str) -> String {
    let plural = if n == 1 { "" } else { "s" };
    format!("{} {noun}{plural}", HumanCount(n as u64))
}

fn sum(sum: &Sum) -> String {
    let mut text = counted(sum.trees, "tree");
    if sum.coarse_trees > 0 {
        text += &format!(", {}", counted(sum.coarse_trees, "coarse tree"));
    }
    if sum.groups > 0 {
        text += &format!(" in {}", counted(sum.groups, "more group"));
    }
    if sum.bytes > 0 {
        text += &format!(
            ", {}, {}",
            HumanBytes(sum.bytes),
            counted(sum.bricks as usize, "brick")
        );
    }
    text
}

fn tree(kind: &str, tree: &TreeView) -> String {
    let mut text = format!("{kind} {} {}", tree.file, extent(tree.bounds.as_ref()));
    if let Some(figures) = &tree.figures {
        text += &of_files(figures);
    }
    text
}

fn of_files(figures: &Figures) -> String {
    let bricks: Vec<String> = figures.bricks_per_level.iter().map(u64::to_string).collect();
    let bricks = match figures.bricks_per_level.iter().sum() {
        0u64 => "no bricks".to_string(),
        _ => format!("bricks {}", bricks.join(" ")),
    };
    format!(
        ": voxel {} m, {}, {}, {bricks}",
        figures.voxel_size,
        counted(figures.levels, "level"),
        HumanBytes(figures.bytes),
    )
}

fn extent(bounds: Option<&WorldBox>) -> String {
    let point = |p: [f64; 3]| p.map(|v| v.to_string()).join(", ");
    bounds.map_or("nowhere".into(), |b| {
        format!("({}) to ({}) m", point(b.min), point(b.max))
    })
}
