//! Suite `culler`: what culling and ordering cost, with few and with all trees of a terrain in view.
//!
//! Terrains are squares of cubes, nested as the builder nests them, without coarse trees: everything in view is listed and put
//! into visibility order. The camera stands above the middle and turns a little from frame to frame. One thread, no device.

use std::time::Instant;

use brickfell_culler::{Aabb, Camera, Culler, GroupId, SceneError, SceneGraph, TreeId};
use glam::dvec3;
use serde_json::json;

use super::{Row, Settings, row};
use crate::commands::CommandError;

/// Side of a tree, metres.
const SIDE: f64 = 64.0;
/// Frames flown before those that are measured, so that the culler's memory has grown.
const WARM: u64 = 100;

/// A view, and the trees of the terrains it is tried on, per axis.
struct Case {
    view: &'static str,
    /// Of the eye, metres above the ground.
    height: f64,
    /// Of the picture, degrees.
    fov: f64,
    /// Downwards, metres a metre.
    slope: f64,
    sides: &'static [u32],
}

const CASES: [Case; 2] = [
    Case {
        view: "near",
        height: 260.0,
        fov: 60.0,
        slope: 1.5,
        sides: &[32, 64, 128, 256, 512],
    },
    Case {
        view: "far",
        height: 1950.0,
        fov: 75.0,
        slope: 1.6,
        sides: &[256, 512],
    },
];

/// A quadtree of groups over `side`² trees, a power of two, around the origin.
fn quadtree(side: u32) -> Result<SceneGraph, SceneError> {
    let mut builder = SceneGraph::builder();
    let half = f64::from(side) * SIDE / 2.0;
    let mut open = vec![(GroupId::ROOT, dvec3(-half, -half, 0.0), side)];
    let mut next = 0;
    while let Some((group, low, side)) = open.pop() {
        if side == 1 {
            let unplaced = |source| SceneError::Bounds {
                tree: TreeId(next),
                parent: group,
                source,
            };
            let bounds = Aabb::new(low, low + SIDE).map_err(unplaced)?;
            builder.add_tree(Some(group), TreeId(next), bounds)?;
            next += 1;
            continue;
        }
        for quadrant in 0..4u32 {
            let offset = dvec3(f64::from(quadrant % 2), f64::from(quadrant / 2), 0.0);
            let inner = builder.add_group(Some(group))?;
            open.push((inner, low + offset * f64::from(side / 2) * SIDE, side / 2));
        }
    }
    Ok(builder.finish())
}

/// Suite `culler`.
///
/// # Errors
/// If a terrain cannot be laid out.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let frames = if settings.quick { 300 } else { 2000 };
    let mut rows = Vec::new();
    for case in CASES {
        for side in case.sides {
            let scene = quadtree(*side)?;
            let mut culler = Culler::new();
            let mut times = Vec::new();
            let (mut visible, mut allocations, mut exact) = (0, 0, true);
            for frame in 0..WARM + frames {
                let angle = 0.7 + (frame % 100) as f64 * 1e-3;
                let eye = dvec3(7.0, 11.0, case.height);
                let target = eye + dvec3(angle.cos(), angle.sin(), -case.slope);
                let camera = Camera::look_at(eye, target, case.fov, 640, 360)?;
                let before = culler.capacity();
                let start = Instant::now();
                let result = culler.cull(&scene, &camera, frame);
                let micros = start.elapsed().as_secs_f64() * 1e6;
                if frame >= WARM {
                    visible = visible.max(result.visible.len());
                    exact &= result.order_exact;
                    times.push(micros);
                    allocations += usize::from(culler.capacity() != before);
                }
            }
            times.sort_by(f64::total_cmp);
            rows.push(row(json!({
                "view": case.view,
                "trees_total": scene.len(),
                "trees_visible": visible,
                "micros_median": times[times.len() / 2],
                "allocations": allocations,
                "order_exact": exact,
            }))?);
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quadtree_covers_its_square_without_gaps() {
        let scene = quadtree(8).unwrap();
        assert_eq!((scene.len(), scene.group_count()), (64, 85));
        let bounds = scene.bounds().unwrap();
        assert_eq!(
            (bounds.min, bounds.max),
            (dvec3(-256.0, -256.0, 0.0), dvec3(256.0, 256.0, 64.0))
        );
        let area: f64 = scene.trees().map(|(_, b)| b.size().x * b.size().y).sum();
        assert_eq!(area, 512.0 * 512.0);
        assert!(brickfell_culler::overlapping_pairs(&scene).is_empty());
        assert_eq!(scene.trees().next().unwrap().1.size(), glam::DVec3::splat(SIDE));
    }
}
