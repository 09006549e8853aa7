//! The inside of closed meshes, by vertical lines through the middles of columns of cells.
//!
//! A line is inside where it has come through more faces that look one way than the other. Whether it goes through a face is decided
//! edge by edge, with the same numbers for both faces at an edge, so a closed mesh has no line with a face too many or too
//! few, also where the line meets an edge or a corner. Where a mesh is open, lines do not come out again: their
//! columns stay empty. What a column gets depends on its place and the faces alone.

use glam::DVec3;

use super::cells::{Mask, NONE};
use super::lattice::{CellBox, SIDE};

/// What lies inside in a box of columns of cells.
pub(crate) struct Inside {
    lo: [i64; 2],
    width: i64,
    /// By column of cells, in rows of x: from where to where, lowest first; cell coordinates.
    columns: Vec<Vec<[f64; 2]>>,
}

/// A face on a line: the height, and whether the line goes in or out there, +1 or -1, if faces look outwards.
type Crossing = (f64, i32);

impl Inside {
    /// Over the columns of a box of cells, of all faces (cell coordinates) above, in and below it.
    pub(crate) fn new(cells: &CellBox, faces: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let (lo, hi) = ([cells.lo[0], cells.lo[1]], [cells.hi[0], cells.hi[1]]);
        let width = hi[0] - lo[0];
        let mut lines: Vec<Vec<Crossing>> = vec![Vec::new(); (width * (hi[1] - lo[1])) as usize];
        for face in faces {
            let [min, max] = [
                face[0].min(face[1]).min(face[2]),
                face[0].max(face[1]).max(face[2]),
            ];
            // Columns whose middle lies in the range.
            let range = |k: usize| {
                let first = (min[k] - 0.5).ceil() as i64;
                let last = (max[k] - 0.5).floor() as i64;
                first.max(lo[k])..(last + 1).min(hi[k])
            };
            for y in range(1) {
                for x in range(0) {
                    if let Some(crossing) = crossing(&face, x as f64 + 0.5, y as f64 + 0.5) {
                        lines[((y - lo[1]) * width + x - lo[0]) as usize].push(crossing);
                    }
                }
            }
        }
        Self {
            lo,
            width,
            columns: lines.into_iter().map(inside).collect(),
        }
    }

    fn column(&self, x: i64, y: i64) -> &[[f64; 2]] {
        let at = (y - self.lo[1]) * self.width + x - self.lo[0];
        self.columns.get(at as usize).map_or(&[], |c| c)
    }

    /// The part of a cell that is inside, 0..1.
    pub(crate) fn part(&self, [x, y, z]: [i64; 3]) -> f32 {
        let (low, high) = (z as f64, (z + 1) as f64);
        let ranges = self.column(x, y).iter();
        let parts = ranges.map(|[from, to]| (to.min(high) - from.max(low)).max(0.0));
        parts.sum::<f64>().min(1.0) as f32
    }

    /// The cells of a block that are inside as a whole.
    pub(crate) fn whole(&self, [x, y, z]: [i64; 3]) -> Mask {
        let mut mask = NONE;
        for k in 0..SIDE * SIDE {
            for [from, to] in self.column(x * SIDE + k % SIDE, y * SIDE + k / SIDE) {
                let place = |height: f64| (height as i64 - z * SIDE).clamp(0, SIDE) as usize;
                let (first, end) = (place(from.ceil()), place(to.floor()));
                mask[first..end.max(first)]
                    .iter_mut()
                    .for_each(|layer| *layer |= 1 << k);
            }
        }
        mask
    }

    /// Heights of blocks in which a cell of a column of blocks is inside as a whole, and how many such cells there are in each.
    pub(crate) fn blocks(&self, [x, y]: [i64; 2], heights: std::ops::Range<i64>) -> Vec<(i64, u32)> {
        let mut counts = std::collections::BTreeMap::new();
        for (i, j) in (0..SIDE * SIDE).map(|k| (x * SIDE + k % SIDE, y * SIDE + k / SIDE)) {
            for [from, to] in self.column(i, j) {
                let from = (from.ceil() as i64).max(heights.start * SIDE);
                let to = (to.floor() as i64).min(heights.end * SIDE);
                for block in from.div_euclid(SIDE)..(to + SIDE - 1).div_euclid(SIDE) {
                    let cells = to.min((block + 1) * SIDE) - from.max(block * SIDE);
                    if cells > 0 {
                        *counts.entry(block).or_default() += cells as u32;
                    }
                }
            }
        }
        counts.into_iter().collect()
    }
}

/// On which side of the edge from `a` to `b`, seen from above, a place is: positive on the left. Both directions of an edge give
/// the same but for the sign, and never 0.
fn side(a: DVec3, b: DVec3, x: f64, y: f64) -> f64 {
    let turned = (b.x, b.y) < (a.x, a.y);
    let (p, q) = if turned { (b, a) } else { (a, b) };
    let left = (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
    let left = if left == 0.0 { f64::MIN_POSITIVE } else { left };
    if turned { -left } else { left }
}

/// Where a vertical line goes through a face, if it does.
fn crossing(face: &[DVec3; 3], x: f64, y: f64) -> Option<Crossing> {
    let [a, b, c] = *face;
    let weights = [side(b, c, x, y), side(c, a, x, y), side(a, b, x, y)];
    let up = weights.iter().all(|w| *w > 0.0);
    if !up && !weights.iter().all(|w| *w < 0.0) {
        return None;
    }
    let sum: f64 = weights.iter().sum();
    let height = (a.z * weights[0] + b.z * weights[1] + c.z * weights[2]) / sum;
    // A face that looks up has the inside below it.
    height.is_finite().then_some((height, if up { -1 } else { 1 }))
}

/// The ranges of a line that are inside; none if it does not come out.
fn inside(mut line: Vec<Crossing>) -> Vec<[f64; 2]> {
    line.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    let mut ranges: Vec<[f64; 2]> = Vec::new();
    let (mut depth, mut from) = (0, 0.0);
    for (height, step) in line {
        let before = depth;
        depth += step;
        if before == 0 {
            from = height;
        } else if depth == 0 && height > from {
            match ranges.last_mut() {
                Some(last) if last[1] == from => last[1] = height,
                _ => ranges.push([from, height]),
            }
        }
    }
    if depth == 0 { ranges } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The faces of a box, looking outwards.
    fn faces(lo: DVec3, hi: DVec3) -> Vec<[DVec3; 3]> {
        let corner = |k: usize| {
            DVec3::new(
                [lo.x, hi.x][k & 1],
                [lo.y, hi.y][k >> 1 & 1],
                [lo.z, hi.z][k >> 2],
            )
        };
        let quads = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let halves = quads
            .iter()
            .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        halves.map(|f| f.map(corner)).collect()
    }

    const CELLS: CellBox = CellBox {
        lo: [-16; 3],
        hi: [16; 3],
    };

    fn volume(inside: &Inside) -> f64 {
        let cells = (-16..16).flat_map(|z| (-16..16).flat_map(move |y| (-16..16).map(move |x| [x, y, z])));
        cells.map(|c| f64::from(inside.part(c))).sum()
    }

    #[test]
    fn boxes_that_overlap_or_look_inwards_are_filled_once() {
        let (a, b) = (DVec3::splat(-3.5), DVec3::splat(4.5));
        let one = faces(a, b);
        let inwards = one.iter().map(|[p, q, r]| [*p, *r, *q]).collect::<Vec<_>>();
        let two: Vec<_> = one.iter().copied().chain(faces(a + 2.0, b + 2.0)).collect();
        let of = |faces: &[[DVec3; 3]]| volume(&Inside::new(&CELLS, faces.iter().copied()));
        assert_eq!((of(&one), of(&inwards)), (512.0, 512.0));
        assert_eq!(of(&two), 2.0 * 512.0 - 216.0);
    }

    #[test]
    fn lines_on_edges_and_corners_go_through_one_face() {
        // Corners, edges and diagonals on the middles of cells.
        let (lo, hi) = (DVec3::new(-2.5, -2.5, -3.0), DVec3::new(3.5, 3.5, 2.0));
        let inside = Inside::new(&CELLS, faces(lo, hi).into_iter());
        let filled = |x, y| inside.column(x, y).to_vec();
        for (x, y) in (-5..6).flat_map(|y| (-5..6).map(move |x| (x, y))) {
            let within = (-2..=2).contains(&x) && (-2..=2).contains(&y);
            let ranges = filled(x, y);
            assert!(ranges.is_empty() || ranges == [[-3.0, 2.0]], "{x} {y} {ranges:?}");
            assert!(!within || ranges.len() == 1, "{x} {y}");
        }
        // A row on the border is in on one side and out on the other: as wide as the box.
        assert_eq!((-5..6).filter(|x| !filled(*x, 0).is_empty()).count(), 6);
    }

    #[test]
    fn an_open_mesh_is_left_empty() {
        let mut open = faces(DVec3::splat(-4.0), DVec3::splat(4.0));
        open.retain(|f| !f.iter().all(|p| p.z == 4.0));
        assert_eq!(volume(&Inside::new(&CELLS, open.into_iter())), 0.0);
    }

    #[test]
    fn blocks_count_whole_cells() {
        let inside = Inside::new(
            &CELLS,
            faces(DVec3::splat(-8.0), DVec3::new(0.0, 0.0, 4.5)).into_iter(),
        );
        assert_eq!(inside.blocks([-1, -1], -2..2), [(-1, 512), (0, 64 * 4)]);
        assert_eq!(inside.blocks([-1, -1], 0..2), [(0, 64 * 4)]);
        assert_eq!(inside.blocks([0, 0], -2..2), []);
    }

    proptest! {
        /// A tetrahedron's middle lines are inside where its half spaces say so.
        #[test]
        fn tetrahedra(points in prop::array::uniform4((-14.0..14.0f64, -14.0..14.0f64, -14.0..14.0f64))) {
            let [a, b, c, d] = points.map(|(x, y, z)| DVec3::new(x, y, z));
            prop_assume!((b - a).cross(c - a).dot(d - a).abs() > 1.0);
            let d = if (b - a).cross(c - a).dot(d - a) > 0.0 { d } else { 2.0 * a - d };
            let faces = [[a, c, b], [a, b, d], [b, c, d], [c, a, d]];
            let inside = Inside::new(&CELLS, faces.into_iter());
            for (x, y) in (-16..16).flat_map(|y| (-16..16).map(move |x| (x, y))) {
                for z in -16..16 {
                    let p = DVec3::new(x as f64 + 0.5, y as f64 + 0.5, z as f64 + 0.5);
                    let out = |f: &[DVec3; 3]| {
                        let n = (f[1] - f[0]).cross(f[2] - f[0]);
                        n.dot(p - f[0]) / n.length()
                    };
                    let outside = faces.iter().map(out).fold(f64::NEG_INFINITY, f64::max);
                    let within = inside.column(x, y).iter().any(|r| r[0] <= p.z && p.z < r[1]);
                    prop_assert!(outside.abs() < 1e-6 || within == (outside < 0.0), "{p} {outside}");
                }
            }
        }
    }
}
