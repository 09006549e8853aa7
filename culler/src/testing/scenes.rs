//! Scenes that the culler is tried on.

use super::Random;
use crate::{Aabb, GroupId, SceneBuilder, SceneGraph, TreeId};
use glam::{DVec3, dvec3};

/// Boxes on a lattice of quarters, so that stepping along a ray of whole-numbered direction is exact.
pub(crate) fn quarters(min: DVec3, size: DVec3) -> Aabb {
    let min = (min * 4.0).round() / 4.0;
    Aabb::new(min, min + (size * 4.0).round() / 4.0).unwrap()
}

pub(crate) fn regular_grid(builder: &mut SceneBuilder) {
    for id in 0..48u32 {
        let (x, y, z) = (id % 4, id / 4 % 4, id / 16);
        let min = dvec3(f64::from(x), f64::from(y), f64::from(z)) * 4.0;
        builder
            .add_tree(None, TreeId(id), quarters(min, DVec3::splat(4.0)))
            .unwrap();
    }
}

/// Columns of one to three stacked trees with their own Z offsets, heights and gaps, some smaller than their cell, in
/// cells of mixed sizes. `group` says where in the nesting a tree goes.
fn columns(
    random: &mut Random,
    builder: &mut SceneBuilder,
    mut group: impl FnMut(&mut SceneBuilder, GroupId, &mut Random) -> GroupId,
) {
    let mut next = 0;
    let mut cells = vec![(GroupId::ROOT, dvec3(-8.0, -8.0, 0.0), 16.0)];
    while let Some((parent, corner, size)) = cells.pop() {
        if size > 1.0 && (size > 8.0 || random.below(3) > 0) {
            let half = size / 2.0;
            for quadrant in 0..4 {
                let offset = dvec3(f64::from(quadrant % 2), f64::from(quadrant / 2), 0.0) * half;
                cells.push((group(builder, parent, random), corner + offset, half));
            }
            continue;
        }
        let mut z = random.point(4.0).z;
        for _ in 0..1 + random.below(3) {
            let height = 0.5 + 3.0 * random.unit();
            let side = if random.below(4) == 0 { size / 2.0 } else { size };
            let bounds = quarters(dvec3(corner.x, corner.y, z), dvec3(side, side, height));
            let parent = group(builder, parent, random);
            builder.add_tree(Some(parent), TreeId(next), bounds).unwrap();
            next += 1;
            z = bounds.max.z
                + if random.below(2) == 0 {
                    0.0
                } else {
                    random.unit().ceil()
                };
        }
    }
}

pub(crate) fn quadtree(random: &mut Random, builder: &mut SceneBuilder) {
    columns(random, builder, |builder, parent, _| {
        builder.add_group(Some(parent)).unwrap()
    });
}

pub(crate) fn flat_list(random: &mut Random, builder: &mut SceneBuilder) {
    columns(random, builder, |_, _, _| GroupId::ROOT);
}

/// The same trees, thrown into groups and groups of groups at random, so that groups overlap all over.
pub(crate) fn overlapping_groups(random: &mut Random, builder: &mut SceneBuilder) {
    let mut groups = Vec::new();
    for index in 0..12usize {
        let parent = if index < 4 {
            None
        } else {
            Some(groups[random.below(index)])
        };
        groups.push(builder.add_group(parent).unwrap());
    }
    columns(random, builder, |_, _, random| groups[random.below(12)]);
}

/// Four blades around a hole, nine times: no plane parts the boxes of one pinwheel.
pub(crate) fn pinwheels(_: &mut Random, builder: &mut SceneBuilder) {
    let blades = [
        ([0.0, 0.0], [3.0, 1.0]),
        ([3.0, 0.0], [1.0, 3.0]),
        ([1.0, 3.0], [3.0, 1.0]),
        ([0.0, 1.0], [1.0, 3.0]),
        ([1.0, 1.0], [2.0, 2.0]),
    ];
    for id in 0..45u32 {
        let (min, size) = blades[id as usize % 5];
        let wheel = id / 5;
        let origin = dvec3(f64::from(wheel % 3), f64::from(wheel / 3), 0.0) * 4.0 - 6.0;
        let bounds = quarters(origin + dvec3(min[0], min[1], 0.0), dvec3(size[0], size[1], 2.0));
        builder.add_tree(None, TreeId(id), bounds).unwrap();
    }
}

/// Three beams, each over the next: from the diagonal they hide each other in a circle.
pub(crate) fn crossed_beams() -> SceneGraph {
    let mut builder = SceneGraph::builder();
    let beams = [
        ([-4.0, 0.0, 1.0], [4.0, 1.0, 2.0]),
        ([1.0, -4.0, 0.0], [2.0, 4.0, 1.0]),
        ([0.0, 1.0, -4.0], [1.0, 2.0, 4.0]),
    ];
    for (id, (min, max)) in beams.into_iter().enumerate() {
        let bounds = Aabb::new(DVec3::from(min), DVec3::from(max)).unwrap();
        builder.add_tree(None, TreeId(id as u32), bounds).unwrap();
    }
    builder.finish()
}
