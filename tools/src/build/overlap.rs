//! Which cells a triangle meets: the separating-axis test of triangle and box, arranged so that only columns of cells
//! under the triangle are visited.
//!
//! Along the axis that the triangle faces most, a column of cells is cut by its plane in at most four cells; the two
//! other axes are walked row by row, the row's end taken from the edges. Cells are half-open: a triangle in the plane
//! between two cells meets the upper one. Coordinates are taken relative to the triangle's own lowest cell, so that the
//! result does not depend on who asks; a rounding band of some 1e-15 of the triangle's size counts as met.
//!
//! A thin surface takes an octahedron in the place of the cell, up to the middles of its faces: every line through the
//! middles of cells along an axis that crosses the triangle does so in one that is met, and next to no others are (M. Schwarz
//! and H.-P. Seidel 2010, "Fast parallel surface and solid voxelization on GPUs", §4.2).

use clap::ValueEnum;
use glam::DVec3;

use super::lattice::CellBox;

/// Which voxels a triangle of a mesh leaves something in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, ValueEnum)]
pub enum Voxelise {
    /// All that it meets, each by the part of it that is covered
    #[default]
    Conservative,
    /// As few as hold a surface together along the axes, each as a whole
    Thin,
}

/// `a·p + b·q + d ≥ 0` for the low corner (p, q) of every unit square that one edge, seen along an axis, does not separate.
#[derive(Clone, Copy)]
struct Edge {
    a: f64,
    b: f64,
    d: f64,
}

impl Edge {
    #[inline]
    fn meets(&self, p: f64, q: f64) -> bool {
        self.a * p + self.b * q + self.d >= 0.0
    }
}

/// Edges seen along axis `r`, in the coordinates of the axes that follow it.
fn edges(v: &[DVec3; 3], normal: DVec3, r: usize, extent: f64, by: Voxelise) -> [Edge; 3] {
    let (p, q) = ((r + 1) % 3, (r + 2) % 3);
    let turn = if normal[r] >= 0.0 { 1.0 } else { -1.0 };
    std::array::from_fn(|k| {
        let (from, to) = (v[k], v[(k + 1) % 3]);
        let (a, b) = (-(to[q] - from[q]) * turn, (to[p] - from[p]) * turn);
        let band = 8.0 * f64::EPSILON * (a.abs() + b.abs()) * (1.0 + extent);
        // From the low corner to the farthest point of what is tested.
        let reach = match by {
            Voxelise::Conservative => a.max(0.0) + b.max(0.0),
            Voxelise::Thin => 0.5 * (a + b + a.abs().max(b.abs())),
        };
        Edge {
            a,
            b,
            d: reach - (a * from[p] + b * from[q]) + band,
        }
    })
}

/// The whole number at or below a place that is within 2^62: what the instruction set at large lacks.
#[inline]
fn floor(x: f64) -> f64 {
    let whole = x as i64 as f64;
    if whole > x { whole - 1.0 } else { whole }
}

/// The range of q that squares at `p` may have, one more on both sides.
fn row(edges: &[Edge; 3], p: f64, lo: f64, hi: f64) -> (f64, f64) {
    let (mut from, mut to) = (lo, hi);
    for e in edges {
        let rest = e.a * p + e.d;
        if e.b > 0.0 {
            from = from.max(floor(-rest / e.b) - 1.0);
        } else if e.b < 0.0 {
            to = to.min(-floor(rest / e.b) + 1.0);
        }
    }
    (from, to)
}

/// Calls with every cell of the box that the triangle (cell coordinates) meets. Triangles without area meet none.
pub(crate) fn for_each_cell(
    triangle: &[DVec3; 3],
    clip: &CellBox,
    by: Voxelise,
    mut visit: impl FnMut([i64; 3]),
) {
    let [t0, t1, t2] = *triangle;
    let base = t0.min(t1).min(t2).floor();
    let v = triangle.map(|p| p - base);
    let top = v[0].max(v[1]).max(v[2]);
    let normal = (v[1] - v[0]).cross(v[2] - v[0]);
    let size = normal.abs();
    let c = if size.x > size.y && size.x > size.z {
        0
    } else if size.y > size.z {
        1
    } else {
        2
    };
    if size[c] == 0.0 || !size[c].is_finite() {
        return;
    }
    if top.floor() == DVec3::ZERO {
        // All of it is in one cell.
        let cell = base.to_array().map(|v| v as i64);
        if (0..3).all(|k| clip.lo[k] <= cell[k] && cell[k] < clip.hi[k]) {
            visit(cell);
        }
        return;
    }
    let (a, b) = ((c + 1) % 3, (c + 2) % 3);
    let lo: [f64; 3] = std::array::from_fn(|k| (clip.lo[k] as f64 - base[k]).max(0.0));
    let hi: [f64; 3] = std::array::from_fn(|k| ((clip.hi[k] - 1) as f64 - base[k]).min(top[k].floor()));
    let extent = top.max_element();
    let [facing, along_a, along_b] = [c, a, b].map(|r| edges(&v, normal, r, extent, by));
    let slope = [-normal[a] / normal[c], -normal[b] / normal[c]];
    let band = 8.0 * f64::EPSILON * (1.0 + extent);
    // Where the plane lies over what is tested, from its height over the low corner.
    let (below, above) = match by {
        Voxelise::Conservative => (
            slope[0].min(0.0) + slope[1].min(0.0) - band,
            slope[0].max(0.0) + slope[1].max(0.0) + band,
        ),
        Voxelise::Thin => {
            let middle = 0.5 * (slope[0] + slope[1]);
            (middle - band, middle + band)
        }
    };
    let mut i = lo[a];
    while i <= hi[a] {
        let (mut j, end) = row(&facing, i, lo[b], hi[b]);
        while j <= end {
            if facing.iter().all(|e| e.meets(i, j)) {
                let plane = v[0][c] + slope[0] * (i - v[0][a]) + slope[1] * (j - v[0][b]);
                let mut k = floor(plane + below).max(lo[c]);
                let last = floor(plane + above).min(hi[c]);
                while k <= last {
                    if along_a.iter().all(|e| e.meets(j, k)) && along_b.iter().all(|e| e.meets(k, i)) {
                        let mut cell = [0; 3];
                        cell[a] = (base[a] + i) as i64;
                        cell[b] = (base[b] + j) as i64;
                        cell[c] = (base[c] + k) as i64;
                        visit(cell);
                    }
                    k += 1.0;
                }
            }
            j += 1.0;
        }
        i += 1.0;
    }
}

/// The point of a triangle nearest to `p`, as weights of its corners.
pub(crate) fn closest_point(triangle: &[DVec3; 3], p: DVec3) -> [f64; 3] {
    let [a, b, c] = *triangle;
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    /// Separation of a triangle and a cell over all 13 axes: positive if apart.
    pub(in crate::build) fn separation(v: &[DVec3; 3], cell: DVec3) -> f64 {
        let e = [v[1] - v[0], v[2] - v[1], v[0] - v[2]];
        let mut axes = vec![DVec3::X, DVec3::Y, DVec3::Z, e[0].cross(e[1])];
        axes.extend(
            e.iter()
                .flat_map(|e| [DVec3::X, DVec3::Y, DVec3::Z].map(|u| e.cross(u))),
        );
        let mut gap = f64::NEG_INFINITY;
        for axis in axes
            .into_iter()
            .filter(|a| a.length() > 1e-9)
            .map(DVec3::normalize)
        {
            let t = v.map(|p| p.dot(axis));
            let middle = (cell + 0.5).dot(axis);
            let radius = 0.5 * (axis.x.abs() + axis.y.abs() + axis.z.abs());
            let lo = t.iter().copied().fold(f64::INFINITY, f64::min) - (middle + radius);
            let hi = (middle - radius) - t.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            gap = gap.max(lo).max(hi);
        }
        gap
    }

    fn check(triangle: [DVec3; 3]) {
        let lo = triangle.iter().fold(triangle[0], |m, p| m.min(*p)).floor() - 2.0;
        let hi = triangle.iter().fold(triangle[0], |m, p| m.max(*p)).ceil() + 2.0;
        check_in(
            triangle,
            &CellBox {
                lo: lo.to_array().map(|v| v as i64),
                hi: hi.to_array().map(|v| v as i64),
            },
        );
    }

    fn check_in(triangle: [DVec3; 3], clip: &CellBox) {
        let mut met = BTreeSet::new();
        for_each_cell(&triangle, clip, Voxelise::Conservative, |c| {
            assert!(met.insert(c), "{c:?} twice")
        });
        for z in clip.lo[2]..clip.hi[2] {
            for y in clip.lo[1]..clip.hi[1] {
                for x in clip.lo[0]..clip.hi[0] {
                    let gap = separation(&triangle, DVec3::new(x as f64, y as f64, z as f64));
                    let found = met.contains(&[x, y, z]);
                    assert!(gap > -1e-7 || found, "missing {x} {y} {z}, gap {gap}");
                    assert!(gap < 1e-7 || !found, "extra {x} {y} {z}, gap {gap}");
                }
            }
        }
    }

    /// A thin surface is met along every axis by the cells in which lines through their middles cross it, and by no cell that
    /// the whole one is not.
    fn check_thin(triangle: [DVec3; 3]) {
        let lo = triangle.iter().fold(triangle[0], |m, p| m.min(*p)).floor() - 2.0;
        let hi = triangle.iter().fold(triangle[0], |m, p| m.max(*p)).ceil() + 2.0;
        let clip = CellBox {
            lo: lo.to_array().map(|v| v as i64),
            hi: hi.to_array().map(|v| v as i64),
        };
        let met = |by| {
            let mut met = BTreeSet::new();
            for_each_cell(&triangle, &clip, by, |c| assert!(met.insert(c), "{c:?} twice"));
            met
        };
        let (thin, whole) = (met(Voxelise::Thin), met(Voxelise::Conservative));
        assert!(thin.is_subset(&whole));
        let [a, b, c] = triangle;
        let normal = (b - a).cross(c - a);
        for axis in 0..3 {
            let (p, q) = ((axis + 1) % 3, (axis + 2) % 3);
            if normal[axis].abs() < 1e-6 * normal.length() {
                continue;
            }
            for j in clip.lo[p]..clip.hi[p] {
                for k in clip.lo[q]..clip.hi[q] {
                    let mut at = DVec3::ZERO;
                    (at[p], at[q]) = (j as f64 + 0.5, k as f64 + 0.5);
                    let inside = |u: DVec3, v: DVec3| (v - u).cross(at - u)[axis] * normal[axis].signum();
                    let least = inside(a, b).min(inside(b, c)).min(inside(c, a));
                    at[axis] = a[axis] - ((at - a)[p] * normal[p] + (at - a)[q] * normal[q]) / normal[axis];
                    let cell = at.floor().to_array().map(|v| v as i64);
                    let off = (at[axis] - at[axis].round()).abs();
                    if least > 1e-6 && off > 1e-6 {
                        assert!(thin.contains(&cell), "missing {cell:?} along {axis}");
                    }
                }
            }
        }
    }

    fn point(range: f64) -> impl Strategy<Value = DVec3> {
        (-range..range, -range..range, -range..range).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn lattice_point() -> impl Strategy<Value = DVec3> {
        (-6i32..6, -6i32..6, -6i32..6).prop_map(|(x, y, z)| DVec3::new(x.into(), y.into(), z.into()))
    }

    proptest! {
        #[test]
        fn cells_are_those_of_the_brute_force_test(a in point(9.0), b in point(9.0), c in point(9.0)) {
            check([a, b, c]);
        }

        #[test]
        fn thin_surfaces_hold_together(a in point(9.0), b in point(9.0), c in point(9.0)) {
            prop_assume!((b - a).cross(c - a).length() > 1e-3);
            check_thin([a, b, c]);
        }

        #[test]
        fn small_and_sliver_triangles(a in point(3.0), b in point(1.0), c in point(0.01), far in -1e7..1e7f64) {
            check([a, a + b, a + b + c]);
            let offset = DVec3::splat(far.round());
            check([a + offset, a + b + offset, a + c + offset]);
        }

        #[test]
        fn triangles_on_lattice_planes(a in lattice_point(), b in lattice_point(), c in lattice_point()) {
            if (b - a).cross(c - a).length() > 0.0 {
                check([a, b, c]);
            }
        }

        #[test]
        fn huge_triangles_through_a_window(a in point(1e6), b in point(1e6), c in point(1e6), p in point(2.0),
                                           s in 0.0..1.0f64, t in 0.0..1.0f64) {
            prop_assume!((b - a).cross(c - a).length() > 1e9);
            let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
            let middle = (a + (b - a) * s + (c - a) * t + p).floor().to_array().map(|v| v as i64);
            check_in([a, b, c], &CellBox { lo: middle.map(|v| v - 6), hi: middle.map(|v| v + 6) });
        }

        #[test]
        fn the_closest_point_is_closest(a in point(9.0), b in point(9.0), c in point(9.0), p in point(12.0),
                                        s in 0.0..1.0f64, t in 0.0..1.0f64) {
            let w = closest_point(&[a, b, c], p);
            prop_assert!(w.iter().all(|w| (-1e-9..=1.0 + 1e-9).contains(w)));
            let nearest = a * w[0] + b * w[1] + c * w[2];
            let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
            let other = a + (b - a) * s + (c - a) * t;
            prop_assert!(p.distance(nearest) <= p.distance(other) + 1e-6);
        }
    }

    #[test]
    fn a_triangle_in_a_plane_between_cells_meets_the_upper_ones() {
        let flat = [
            DVec3::new(0.5, 0.5, 3.0),
            DVec3::new(2.5, 0.5, 3.0),
            DVec3::new(0.5, 2.5, 3.0),
        ];
        let clip = CellBox {
            lo: [-9; 3],
            hi: [9; 3],
        };
        let mut heights = BTreeSet::new();
        for_each_cell(&flat, &clip, Voxelise::Conservative, |c| {
            heights.insert(c[2]);
        });
        assert_eq!(heights.into_iter().collect::<Vec<_>>(), [3]);
    }
}
