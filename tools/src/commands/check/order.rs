//! Trees that no order of drawing is right for: those that overlap, and those that hide each other in a circle.
//!
//! Overlaps are found exactly. Whether trees hide each other in a circle depends on where one stands, so it is tried from
//! places all around and inside; a scene in which nothing is found may still have a place from which there is no order.

use std::collections::BTreeMap;

use brickfell_culler::{Aabb, Camera, Culler, SceneGraph, TreeId, overlapping_pairs};
use brickfell_formats::scene::PagedOctTree;
use glam::DVec3;

use super::Report;
use super::source::Source;
use super::tree::TreeReport;

/// Most pairs of overlapping trees that are listed one by one.
const LISTED_PAIRS: usize = 20;
/// Trees from whose middle is looked out at most.
const INSIDE: usize = 64;

/// Notes a warning for each pair of trees that overlap, or one for a place from which trees have no order.
pub(super) fn check(
    source: &Source,
    references: &[&PagedOctTree],
    trees: &BTreeMap<&str, TreeReport>,
    report: &mut Report,
) {
    let mut builder = SceneGraph::builder();
    let added = builder.add_group(None).and_then(|group| {
        for (id, reference) in (0..).zip(references) {
            let header = trees.get(reference.tree_file.as_str()).and_then(|t| t.header);
            let drawn = reference.bounds.map(|b| [b.min, b.max]);
            let bounds = header.and_then(|h| {
                let [min, max] = drawn.unwrap_or(h.bounds());
                Aabb::new(min, max).ok()
            });
            if let Some(bounds) = bounds {
                builder.add_tree(Some(group), TreeId(id), bounds)?;
            }
        }
        Ok(())
    });
    if let Err(e) = added {
        report.faults.push(source.scene(e.to_string()));
        return;
    }
    let graph = builder.finish();
    let pairs = overlapping_pairs(&graph);
    let name = |id: TreeId| references.get(id.0 as usize).map_or("", |t| t.tree_file.as_str());
    for (a, b) in pairs.iter().take(LISTED_PAIRS) {
        let what = format!(
            "its box and that of {} overlap: no order of drawing is right for them",
            name(*b)
        );
        report.warnings.push(source.reference(name(*a), what));
    }
    if pairs.len() > LISTED_PAIRS {
        let more = pairs.len() - LISTED_PAIRS;
        report
            .warnings
            .push(source.scene(format!("{more} more pairs of trees overlap")));
    }
    if pairs.is_empty()
        && let Some(eye) = circle(&graph)
    {
        report.warnings.push(source.scene(format!(
            "seen from {eye}, trees hide each other in a circle: no order of drawing is right for them"
        )));
    }
}

/// A place from which the trees of a scene have no order, if one of those tried is.
fn circle(graph: &SceneGraph) -> Option<DVec3> {
    let bounds = graph.bounds()?;
    let (center, size) = (bounds.center(), bounds.size());
    let around = (0..27).map(|k| {
        center + size * (DVec3::new(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9)) - 1.0)
    });
    let inside = graph
        .trees()
        .step_by(graph.len().div_ceil(INSIDE).max(1))
        .map(|(_, tree)| tree.center());
    let mut culler = Culler::new();
    // Six views of more than a right angle see everything.
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    around.chain(inside).find(|eye| {
        axes.iter().flat_map(|axis| [*axis, -*axis]).any(|axis| {
            Camera::look_at(*eye, *eye + axis * size.max_element().max(1.0), 100.0, 64, 64)
                .is_ok_and(|camera| !culler.cull(graph, &camera, 0).order_exact)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(boxes: &[([f64; 3], [f64; 3])]) -> SceneGraph {
        let mut builder = SceneGraph::builder();
        for (id, (min, max)) in (0..).zip(boxes) {
            let bounds = Aabb::new(DVec3::from(*min), DVec3::from(*max)).unwrap();
            builder.add_tree(None, TreeId(id), bounds).unwrap();
        }
        builder.finish()
    }

    #[test]
    fn three_crossed_beams_are_found_and_a_stack_is_not() {
        let beams = [
            ([-4.0, 0.0, 1.0], [4.0, 1.0, 2.0]),
            ([1.0, -4.0, 0.0], [2.0, 4.0, 1.0]),
            ([0.0, 1.0, -4.0], [1.0, 2.0, 4.0]),
        ];
        assert!(circle(&scene(&beams)).is_some());
        assert_eq!(circle(&scene(&beams[..2])), None);
        assert_eq!(circle(&scene(&[])), None);
    }
}
