//! Where the rays of a tile of pixels may begin: before the first node of a tree in which one of them could meet something.
//!
//! All rays of a tile start at the eye, so what they can reach on each axis lies between two slopes. With those the tree is walked
//! front to back, coarse nodes first, until nothing nearer is left. A node counts where it is shown: alone or mixed into finer ones,
//! which is from the depth on at which the next finer level begins to fade. What is not resident counts as something, so that rays
//! come there and ask. Empty nodes on the way are stamped, though no ray comes to them. One tile is one thread's.

use brickfell_shaders::layout::{BRICK, POINTER, TERMINAL};
use glam::{DVec3, dvec3};

use super::pool::Pools;
use crate::march::View;

/// The slopes between which the rays of a tile run, world metres per metre of depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    least: DVec3,
    most: DVec3,
}

/// A node and the depths between which the beam may touch it.
#[derive(Clone, Copy)]
struct Visit {
    node: u32,
    level: u8,
    low: DVec3,
    enter: f64,
    leave: f64,
}

/// What the walk needs of a tree.
pub(super) struct Start<'a> {
    pub(super) pools: &'a Pools,
    pub(super) frame: u32,
    pub(super) view: &'a View,
    pub(super) root: u32,
    /// log2 of the voxels of a segment: rays begin where segments do.
    pub(super) step: u32,
}

impl Beam {
    /// The beam of rays between those at a tile's corners.
    pub(super) fn new(corners: [DVec3; 4]) -> Self {
        let [a, b, c, d] = corners;
        Self {
            least: a.min(b).min(c).min(d),
            most: a.max(b).max(c).max(d),
        }
    }

    /// The depths between which the beam may touch a box, from the eye on; `enter` is above `leave` if it never does.
    pub(super) fn touches(&self, low: DVec3, high: DVec3) -> (f64, f64) {
        // What runs at slope d is at a face from face / d on: the steepest is there first.
        let (mut enter, mut leave) = (0f64, f64::INFINITY);
        for k in 0..3 {
            let (low, high) = (low[k], high[k]);
            let (least, most) = (self.least[k], self.most[k]);
            if low > 0.0 {
                enter = enter.max(if most > 0.0 { low / most } else { f64::INFINITY });
            } else if low < 0.0 && most < 0.0 {
                leave = leave.min(low / most);
            }
            if high < 0.0 {
                enter = enter.max(if least < 0.0 { high / least } else { f64::INFINITY });
            } else if high > 0.0 && least > 0.0 {
                leave = leave.min(high / least);
            }
        }
        (enter, leave)
    }

    /// Depth up to which no ray of the beam meets anything in a tree; infinite if none does at all.
    pub(super) fn start(&self, tree: &Start<'_>) -> f64 {
        let view = tree.view;
        let beam = Beam {
            least: self.least * view.per_metre(),
            most: self.most * view.per_metre(),
        };
        // What is not quite reached by rounding.
        let margin = |z: f64| z * (1.0 - 1e-9);
        let mut nearest = f64::INFINITY;
        let mut stack = vec![Visit {
            node: tree.root,
            level: 0,
            low: -view.eye(),
            enter: 0.0,
            leave: f64::INFINITY,
        }];
        while let Some(visit) = stack.pop() {
            if visit.enter >= nearest {
                continue;
            }
            let [structure, data] = tree.pools.nodes[visit.node as usize];
            tree.pools.use_tile(visit.node, tree.frame);
            let (children, is_terminal) = (structure & POINTER, structure & TERMINAL != 0);
            if children == 0 && !is_terminal {
                nearest = margin(visit.enter);
                continue;
            }
            let is_clear = structure & BRICK == 0 && data >> 24 == 0;
            // Where finer ones alone are shown it does not count.
            let shown = if is_terminal {
                0.0
            } else {
                view.shown_from(visit.level, tree.step)
            };
            if !is_clear {
                let (enter, leave) = match tree.pools.brick([structure, data]) {
                    Some(brick) => {
                        let voxel = view.side(visit.level) / 8.0;
                        let [low, high] = brick.filled(tree.step).map(|p| visit.low + p * voxel);
                        beam.touches(low, high)
                    }
                    None => (visit.enter, visit.leave),
                };
                if enter.max(shown) <= leave {
                    nearest = nearest.min(margin(enter.max(shown)));
                }
            }
            if is_terminal || visit.enter >= nearest {
                continue;
            }
            let side = view.side(visit.level + 1);
            let first = stack.len();
            for octant in 0..8u32 {
                let offset = dvec3(
                    (octant & 1) as f64,
                    (octant >> 1 & 1) as f64,
                    (octant >> 2) as f64,
                );
                let low = visit.low + offset * side;
                let (enter, leave) = beam.touches(low, low + side);
                if enter <= leave && enter < nearest {
                    stack.push(Visit {
                        node: children * 8 + octant,
                        level: visit.level + 1,
                        low,
                        enter,
                        leave,
                    });
                }
            }
            // The nearest is looked at first.
            stack[first..].sort_by(|a, b| b.enter.total_cmp(&a.enter));
        }
        nearest
    }
}
