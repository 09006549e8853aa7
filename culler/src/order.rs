//! Which of two boxes must be drawn first, and which boxes of a scene have no order because they overlap.
//!
//! Let `A` end on an axis before `B` begins, `A.max <= B.min`. Along any ray the coordinate on that axis only grows or
//! only falls. A ray that starts at `eye <= B.min` and later enters `B` is growing and never comes back to `A`, so `A`
//! may be drawn first. A ray that starts at `eye >= A.max` and later enters `A` is falling and never reaches `B`, so
//! `B` may be drawn first. One axis that permits an order is enough. If only one of the two orders is permitted it is
//! a constraint, if both are, the boxes cannot hide each other, and if none is, they overlap. What is left is an eye
//! in the lower face of a box: boxes are half-open, so it is in that box, and that box comes first.
//!
//! This errs on the safe side: some constraints between boxes far apart could be dropped because no ray meets both.
//! [`never_aligned`] finds those exactly; it is slower and only asked when the constraints contradict each other.
//! Functions of values: any thread.

use crate::bounds::Aabb;
use crate::scene::{SceneGraph, TreeId};
use glam::{DVec2, DVec3, dvec2};

/// The order that two boxes need in a front-to-back list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precedence {
    /// The first box may hide the second and must precede it.
    First,
    /// The second box may hide the first and must precede it.
    Second,
    /// Neither can hide the other.
    Free,
    /// The boxes overlap: no order is right for all rays.
    Conflict,
}

/// The order that the half-open boxes `a` and `b` need for rays from `eye`.
#[inline]
pub fn precedence(a: &Aabb, b: &Aabb, eye: DVec3) -> Precedence {
    let a_below = a.max.cmple(b.min);
    let b_below = b.max.cmple(a.min);
    let a_first = (a_below & eye.cmple(b.min)) | (b_below & eye.cmpge(b.max));
    let b_first = (b_below & eye.cmple(a.min)) | (a_below & eye.cmpge(a.max));
    match (a_first.any(), b_first.any()) {
        (true, false) => Precedence::First,
        (false, true) => Precedence::Second,
        (true, true) if a.contains(eye) => Precedence::First,
        (true, true) if b.contains(eye) => Precedence::Second,
        (true, true) => Precedence::Free,
        (false, false) => Precedence::Conflict,
    }
}

/// [`precedence`], with the constraints dropped between boxes that no ray from `eye` can meet both of.
pub fn exact_precedence(a: &Aabb, b: &Aabb, eye: DVec3) -> Precedence {
    let order = precedence(a, b, eye);
    if matches!(order, Precedence::First | Precedence::Second) && never_aligned(a, b, eye) {
        return Precedence::Free;
    }
    order
}

/// Whether no ray from `eye` meets both half-open boxes. Two boxes seen from a point are two convex cones; if they are
/// disjoint, a plane through the eye along an edge of one of them parts them, and edges are parallel to the axes. So
/// it is enough to look along each axis and compare the two rectangles' angles. Too close to call counts as aligned,
/// and the box that holds the eye is met by every ray.
pub fn never_aligned(a: &Aabb, b: &Aabb, eye: DVec3) -> bool {
    if a.contains(eye) || b.contains(eye) {
        return false;
    }
    [(0, 1), (1, 2), (2, 0)].into_iter().any(|(u, v)| {
        let corners = |bounds: &Aabb| {
            let low = dvec2(bounds.min[u] - eye[u], bounds.min[v] - eye[v]);
            let high = dvec2(bounds.max[u] - eye[u], bounds.max[v] - eye[v]);
            [low, dvec2(high.x, low.y), high, dvec2(low.x, high.y)]
        };
        let (a, b) = (corners(a), corners(b));
        parted_by_edge(&a, &b) || parted_by_edge(&b, &a)
    })
}

/// Whether a line from the origin through a corner of `a` has all of `a` on one side and `b` strictly on the other.
fn parted_by_edge(a: &[DVec2; 4], b: &[DVec2; 4]) -> bool {
    const MARGIN: f64 = 1e-12;
    a.iter().any(|corner| {
        let normal = corner.perp();
        let sides = a.map(|p| normal.dot(p));
        let clear = |sign: f64| {
            b.iter()
                .all(|p| sign * normal.dot(*p) > MARGIN * normal.abs().element_sum() * p.abs().element_sum())
        };
        (sides.iter().all(|&s| s >= 0.0) && clear(-1.0)) || (sides.iter().all(|&s| s <= 0.0) && clear(1.0))
    })
}

/// All pairs of trees whose half-open boxes share a point, smaller id first, sorted. No drawing order is right for
/// them. Trees that merely touch, and boxes of zero volume, are no pair.
pub fn overlapping_pairs(scene: &SceneGraph) -> Vec<(TreeId, TreeId)> {
    let (ids, boxes): (Vec<TreeId>, Vec<Aabb>) = scene.trees().unzip();
    let mut pairs = Vec::new();
    sweep_overlaps(&boxes, |i, j| {
        pairs.push((ids[i].min(ids[j]), ids[i].max(ids[j])));
        true
    });
    pairs.sort_unstable();
    pairs
}

/// Sweep and prune: calls `found` with the indices of each overlapping pair until it returns false.
///
/// Sweeps along the axis on which the boxes are shortest relative to their common extent, and keeps the boxes that
/// the sweep is inside of.
pub(crate) fn sweep_overlaps(boxes: &[Aabb], mut found: impl FnMut(usize, usize) -> bool) {
    let Some(all) = boxes.iter().copied().reduce(|a, b| a.union(&b)) else {
        return;
    };
    let total = boxes.iter().fold(DVec3::ZERO, |sum, b| sum + b.size());
    let crowding = total / all.size().max(DVec3::splat(f64::MIN_POSITIVE));
    let axis = crowding.min_position();
    let mut order: Vec<usize> = (0..boxes.len()).filter(|&i| !boxes[i].is_empty()).collect();
    order.sort_by(|&i, &j| boxes[i].min[axis].total_cmp(&boxes[j].min[axis]));
    let mut active: Vec<usize> = Vec::new();
    for &next in &order {
        active.retain(|&other| boxes[other].max[axis] > boxes[next].min[axis]);
        for &other in &active {
            if boxes[other].overlaps(&boxes[next]) && !found(other, next) {
                return;
            }
        }
        active.push(next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Random, ray_span};
    use glam::dvec3;

    fn bounds(min: [f64; 3], max: [f64; 3]) -> Aabb {
        Aabb::new(DVec3::from(min), DVec3::from(max)).unwrap()
    }

    #[test]
    fn order_along_one_axis_depends_on_the_side_of_the_eye() {
        let low = bounds([0.0; 3], [1.0; 3]);
        let high = bounds([2.0, 0.0, 0.0], [3.0, 1.0, 1.0]);
        let at = |x: f64| precedence(&low, &high, dvec3(x, 0.5, 0.5));
        assert_eq!(at(-1.0), Precedence::First);
        assert_eq!(at(0.5), Precedence::First);
        assert_eq!(at(1.0), Precedence::Free);
        assert_eq!(at(1.5), Precedence::Free);
        // The lower face belongs to the high box: whoever stands in it looks out of that box.
        assert_eq!(at(2.0), Precedence::Second);
        assert_eq!(at(9.0), Precedence::Second);
        assert_eq!(
            precedence(&low, &bounds([0.5; 3], [2.0; 3]), DVec3::ZERO),
            Precedence::Conflict
        );
    }

    #[test]
    fn the_box_that_holds_the_eye_comes_first() {
        let unit = bounds([0.0; 3], [1.0; 3]);
        let aside = bounds([-2.0, 0.0, 0.0], [-1.0, 1.0, 1.0]);
        let in_lower_face = dvec3(0.0, 0.5, 0.5);
        assert_eq!(precedence(&unit, &aside, in_lower_face), Precedence::First);
        assert_eq!(precedence(&aside, &unit, in_lower_face), Precedence::Second);
        assert_eq!(exact_precedence(&unit, &aside, in_lower_face), Precedence::First);
        // The upper face is not the box's own.
        let beyond = bounds([2.0, 0.0, 0.0], [3.0, 1.0, 1.0]);
        assert_eq!(precedence(&unit, &beyond, dvec3(1.0, 0.5, 0.5)), Precedence::Free);
    }

    /// Against rays aimed at points of both boxes: no ray may contradict the order, and with an exact test nearly
    /// every constraint has a ray to show for it.
    #[test]
    fn precedence_agrees_with_rays() {
        let mut random = Random::new(2);
        let (mut constraints, mut needless, mut needless_exact) = (0, 0, 0);
        for _ in 0..8_000 {
            let low = random.point(10.0);
            let a = Aabb::new(low, low + random.size(0.5, 6.0)).unwrap();
            let low = random.point(10.0);
            let b = Aabb::new(low, low + random.size(0.5, 6.0)).unwrap();
            let eye = random.point(15.0);
            let order = precedence(&a, &b, eye);
            assert_eq!(order == Precedence::Conflict, a.overlaps(&b));
            if order == Precedence::Conflict {
                continue;
            }
            let exact = exact_precedence(&a, &b, eye);
            let mut shown = false;
            for ray in 0..300 {
                let aim = if ray % 2 == 0 { &a } else { &b };
                let (x, y, z) = (random.unit(), random.unit(), random.unit());
                let direction = aim.min + aim.size() * dvec3(x, y, z) - eye;
                if let (Some(in_a), Some(in_b)) = (ray_span(&a, eye, direction), ray_span(&b, eye, direction))
                {
                    shown = true;
                    let met = if in_a.0 < in_b.0 {
                        Precedence::First
                    } else {
                        Precedence::Second
                    };
                    assert_eq!(order, met, "{a:?} {b:?} from {eye} along {direction}");
                    assert_eq!(exact, met, "exact: {a:?} {b:?} from {eye} along {direction}");
                }
            }
            if order != Precedence::Free {
                constraints += 1;
                needless += u32::from(!shown);
                needless_exact += u32::from(!shown && exact != Precedence::Free);
            }
        }
        assert!(constraints > 2_000, "{constraints}");
        assert!(
            needless > constraints / 20,
            "the cheap test is coarser: {needless} of {constraints}"
        );
        assert!(
            needless_exact < constraints / 20,
            "{needless_exact} of {constraints}"
        );
    }

    #[test]
    fn overlapping_pairs_match_all_against_all() {
        let mut random = Random::new(3);
        for round in 0..20 {
            let mut builder = SceneGraph::builder();
            let mut boxes = Vec::new();
            for id in 0..80 {
                let low = (random.point(10.0) * 2.0).floor();
                // On a grid, so that touching faces abound; every tenth box has no volume.
                let size = if id % 10 == 9 {
                    dvec3(3.0, 0.0, 3.0)
                } else {
                    random.size(1.0, 8.0).floor()
                };
                let bounds = Aabb::new(low, low + size).unwrap();
                let parent = if id % 3 == round % 3 {
                    Some(builder.add_group(None).unwrap())
                } else {
                    None
                };
                builder.add_tree(parent, TreeId(id), bounds).unwrap();
                boxes.push(bounds);
            }
            let mut expected = Vec::new();
            for i in 0..boxes.len() {
                for j in i + 1..boxes.len() {
                    if boxes[i].overlaps(&boxes[j]) {
                        expected.push((TreeId(i as u32), TreeId(j as u32)));
                    }
                }
            }
            assert!(!expected.is_empty());
            assert_eq!(overlapping_pairs(&builder.finish()), expected);
        }
    }
}
