//! Puts the visible children of one group in front-to-back order.
//!
//! Few boxes: a topological sort over the constraints of [`precedence`], ties by distance, then by node. Many boxes:
//! split by an axis plane that cuts none of them, the eye's side first, until few are left; a plane that parts two
//! sets permits the order of all their pairs at once. If the constraints contradict each other, then in this order:
//! drop those that no ray backs; replace the groups in the knot by their children, since bounds of groups may overlap
//! where their trees do not; break the knot at its nearest tree and report that the order is not exact.
//!
//! Called by the culler on the render thread. Scratch is kept: no allocation once it has grown.

use crate::bounds::Aabb;
use crate::frustum::PlaneMask;
use crate::order::{Precedence, exact_precedence, precedence};
use glam::DVec3;
use std::cmp::Ordering;

/// A node in view, on its way into the list.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Item {
    pub(crate) bounds: Aabb,
    /// Metres from the eye to the nearest point of the box.
    pub(crate) distance: f64,
    /// Index into the scene's nodes.
    pub(crate) node: u32,
    /// Planes that children have to be tested against.
    pub(crate) mask: PlaneMask,
    /// See [`VisibleTree::beyond`](crate::VisibleTree::beyond).
    pub(crate) beyond: Option<f64>,
}

/// Up to here comparing all pairs is cheaper than looking for a plane.
const FEW: usize = 16;
/// Up to here unbacked constraints are searched for, which costs several times as much per pair.
const REFINABLE: usize = 128;
/// From here on boxes that no plane parts are sorted by distance, so that a frame stays a frame.
const TOO_MANY: usize = 2048;

/// Nearest first; total, so that equal scenes give equal lists.
pub(crate) fn by_distance(a: &Item, b: &Item) -> Ordering {
    a.distance.total_cmp(&b.distance).then(a.node.cmp(&b.node))
}

/// How two boxes are compared.
type Relation = fn(&Aabb, &Aabb, DVec3) -> Precedence;

/// The sort's scratch memory.
#[derive(Debug, Default)]
pub(crate) struct Sorter {
    /// Beginnings of the stretches still to be sorted; the last one reaches to the end of the items and is nearest.
    starts: Vec<usize>,
    /// For each item of the last stretch, how many items have to precede it.
    blockers: Vec<u32>,
    /// Items that have to precede each other in a circle.
    knot: Vec<usize>,
    /// For each item of the last stretch, whether a search has come by.
    reached: Vec<bool>,
}

impl Sorter {
    /// Moves all `items` to the end of `sorted`, nearest first. `expand` appends the visible children of a group and
    /// returns true, or returns false for a tree. Returns whether the order is exact.
    pub(crate) fn sort(
        &mut self,
        items: &mut Vec<Item>,
        eye: DVec3,
        sorted: &mut Vec<Item>,
        mut expand: impl FnMut(&Item, &mut Vec<Item>) -> bool,
    ) -> bool {
        let mut exact = true;
        self.starts.clear();
        self.starts.push(0);
        while let Some(start) = self.starts.pop() {
            let count = items.len() - start;
            if count > FEW
                && let Some(middle) = split(&mut items[start..], eye)
            {
                self.starts.push(start);
                self.starts.push(start + middle);
            } else if count > TOO_MANY {
                items[start..].sort_unstable_by(by_distance);
                sorted.extend(items.drain(start..));
                exact = false;
            } else if self.sort_few(items, start, eye, sorted, &mut expand, &mut exact) == Progress::Expanded
            {
                self.starts.push(start);
            }
        }
        exact
    }

    /// Topological sort of `items[start..]`; stops when a group had to be expanded.
    fn sort_few(
        &mut self,
        items: &mut Vec<Item>,
        start: usize,
        eye: DVec3,
        sorted: &mut Vec<Item>,
        expand: &mut impl FnMut(&Item, &mut Vec<Item>) -> bool,
        exact: &mut bool,
    ) -> Progress {
        let mut relation: Relation = precedence;
        let mut refined = false;
        self.count_blockers(&items[start..], eye, relation);
        while items.len() > start {
            let rest = &items[start..];
            let ready = (0..rest.len())
                .filter(|&i| self.blockers[i] == 0)
                .min_by(|&i, &j| by_distance(&rest[i], &rest[j]));
            let next = match ready {
                Some(next) => next,
                None if !refined && rest.len() <= REFINABLE => {
                    refined = true;
                    relation = exact_precedence;
                    self.count_blockers(rest, eye, relation);
                    continue;
                }
                None => {
                    self.find_knot(rest, eye, relation);
                    if expand_all(items, start, &mut self.knot, expand) {
                        return Progress::Expanded;
                    }
                    *exact = false;
                    let rest = &items[start..];
                    let nearest = self
                        .knot
                        .iter()
                        .copied()
                        .min_by(|&i, &j| by_distance(&rest[i], &rest[j]));
                    nearest.unwrap_or(0)
                }
            };
            let item = items.swap_remove(start + next);
            self.blockers.swap_remove(next);
            for (other, blockers) in items[start..].iter().zip(&mut self.blockers) {
                let order = relation(&item.bounds, &other.bounds, eye);
                if matches!(order, Precedence::First | Precedence::Conflict) {
                    *blockers -= 1;
                }
            }
            sorted.push(item);
        }
        Progress::Done
    }

    fn count_blockers(&mut self, rest: &[Item], eye: DVec3, relation: Relation) {
        self.blockers.clear();
        self.blockers.resize(rest.len(), 0);
        for (i, a) in rest.iter().enumerate() {
            for (j, b) in rest.iter().enumerate().skip(i + 1) {
                let order = relation(&a.bounds, &b.bounds, eye);
                self.blockers[j] += u32::from(matches!(order, Precedence::First | Precedence::Conflict));
                self.blockers[i] += u32::from(matches!(order, Precedence::Second | Precedence::Conflict));
            }
        }
    }

    /// Leaves in `knot` the indices of items that all have to precede each other, directly or in a circle, and that
    /// nothing else has to precede. Every item must be blocked, so there is such a set.
    ///
    /// Whatever is reached forward from an item is dropped as a beginning; the last beginning left is not reached from
    /// any other, so all that leads to it also follows from it.
    fn find_knot(&mut self, rest: &[Item], eye: DVec3, relation: Relation) {
        let before = |i: usize, j: usize| {
            let order = relation(&rest[i].bounds, &rest[j].bounds, eye);
            matches!(order, Precedence::First | Precedence::Conflict)
        };
        let mut beginning = 0;
        self.reached.clear();
        self.reached.resize(rest.len(), false);
        for from in 0..rest.len() {
            if !self.reached[from] {
                beginning = from;
                self.flood(from, before);
            }
        }
        self.reached.fill(false);
        self.flood(beginning, |i, j| before(j, i));
    }

    /// Leaves in `knot` the items newly reached from `from`, itself included.
    fn flood(&mut self, from: usize, leads: impl Fn(usize, usize) -> bool) {
        self.knot.clear();
        self.knot.push(from);
        self.reached[from] = true;
        let mut at = 0;
        while let Some(&item) = self.knot.get(at) {
            for other in 0..self.reached.len() {
                if !self.reached[other] && leads(item, other) {
                    self.reached[other] = true;
                    self.knot.push(other);
                }
            }
            at += 1;
        }
    }

    /// Elements that fit without another allocation.
    pub(crate) fn capacity(&self) -> usize {
        self.starts.capacity() + self.blockers.capacity() + self.knot.capacity() + self.reached.capacity()
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Progress {
    Done,
    Expanded,
}

/// Replaces the groups among `items[start + i]`, `i` in `chosen`, by their visible children.
fn expand_all(
    items: &mut Vec<Item>,
    start: usize,
    chosen: &mut [usize],
    expand: &mut impl FnMut(&Item, &mut Vec<Item>) -> bool,
) -> bool {
    // From the back, so that removing one leaves the others where they are.
    chosen.sort_unstable();
    let mut expanded = false;
    for &index in chosen.iter().rev() {
        let item = items[start + index];
        if expand(&item, items) {
            items.swap_remove(start + index);
            expanded = true;
        }
    }
    expanded
}

/// Looks for an axis plane that cuts no item, preferably near the middle, and reorders the items into a far part and
/// a near part; returns where the near part begins.
fn split(items: &mut [Item], eye: DVec3) -> Option<usize> {
    let all = items.iter().map(|item| item.bounds).reduce(|a, b| a.union(&b))?;
    let mut axes = [0, 1, 2];
    axes.sort_unstable_by(|&a, &b| all.size()[b].total_cmp(&all.size()[a]));
    let mut best: Option<(usize, usize)> = None;
    let mut sorted_axis = None;
    for axis in axes {
        sort_along(items, axis);
        sorted_axis = Some(axis);
        let mut reach = f64::NEG_INFINITY;
        for at in 1..items.len() {
            reach = reach.max(items[at - 1].bounds.max[axis]);
            let smaller = at.min(items.len() - at);
            if reach <= items[at].bounds.min[axis]
                && best.is_none_or(|(_, cut)| smaller > cut.min(items.len() - cut))
            {
                best = Some((axis, at));
            }
        }
        // Good enough to keep the number of rounds logarithmic; the other axes need not be looked at.
        if best.is_some_and(|(_, cut)| 8 * cut.min(items.len() - cut) >= items.len()) {
            break;
        }
    }
    let (axis, cut) = best?;
    if sorted_axis != Some(axis) {
        sort_along(items, axis);
    }
    if eye[axis] < items[cut].bounds.min[axis] {
        items.rotate_left(cut);
        Some(items.len() - cut)
    } else {
        Some(cut)
    }
}

fn sort_along(items: &mut [Item], axis: usize) {
    items.sort_unstable_by(|a, b| {
        a.bounds.min[axis]
            .total_cmp(&b.bounds.min[axis])
            .then(a.node.cmp(&b.node))
    });
}
