//! Outlines of triangles in finest voxels: which of a voxel's 8×8 lines along each axis a triangle stops.
//!
//! A line is stopped in the voxel that holds the point where it meets the triangle, so pieces of a surface in voxels behind one
//! another complete each other. Lines stand on an 8×8 grid that is shifted by a hash of the place in the cross-section,
//! lest a pole thinner than their distance is met along all of its length or nowhere.

use glam::DVec3;

use super::coverage::{BITS, Cover, hash};

/// Lines of a voxel per axis of a cross-section.
const LINES: usize = 8;

/// The outlines of a triangle in a cell. Corners are given from a corner of the lattice, `base`.
pub(crate) fn outline(corners: &[DVec3; 3], base: [i64; 3], cell: [i64; 3]) -> Cover {
    let local: [f64; 3] = std::array::from_fn(|k| (cell[k] - base[k]) as f64);
    Cover(std::array::from_fn(|axis| {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let [a, b, c] = corners.map(|p| (p[i] - local[i], p[j] - local[j]));
        let cross = |p: (f64, f64), q: (f64, f64), r: (f64, f64)| {
            (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0)
        };
        let area = cross(a, b, c);
        if area.abs() < 1e-12 {
            return 0;
        }
        let shift = hash(cell[i], cell[j], axis as i64);
        let [du, dv] = [shift, shift >> 32].map(|s| (s as u32 as f64 + 0.5) / 2f64.powi(32));
        let range = |lo: f64, hi: f64, d: f64| {
            let first = (lo * LINES as f64 - d).ceil().max(0.0);
            let last = (hi * LINES as f64 - d).floor().min(LINES as f64 - 1.0);
            first as i64..last as i64 + 1
        };
        let (us, vs) = ([a.0, b.0, c.0], [a.1, b.1, c.1]);
        let least = |v: [f64; 3]| v[0].min(v[1]).min(v[2]) - 1e-9;
        let most = |v: [f64; 3]| v[0].max(v[1]).max(v[2]) + 1e-9;
        let mut mask = 0;
        for v in range(least(vs), most(vs), dv) {
            for u in range(least(us), most(us), du) {
                let p = ((u as f64 + du) / LINES as f64, (v as f64 + dv) / LINES as f64);
                // Triangles with a common side both have what is on it.
                let w = [cross(b, c, p), cross(c, a, p), cross(a, b, p)].map(|w| w / area);
                if w.iter().any(|w| *w < -1e-9) {
                    continue;
                }
                let depth = w[0] * corners[0][axis] + w[1] * corners[1][axis] + w[2] * corners[2][axis];
                mask |= u64::from(depth.floor() == local[axis]) << (LINES as i64 * v + u);
            }
        }
        mask
    }))
}

/// A part of an outline: each line is left in with a probability. `key` tells apart what is to be independent.
pub(crate) fn thinned(cover: Cover, part: f32, cell: [i64; 3], key: i64) -> Cover {
    if part >= 1.0 {
        return cover;
    }
    let mut h = hash(hash(cell[0], cell[1], cell[2]) as i64, key, 0);
    Cover(cover.0.map(|mask| {
        (0..BITS).filter(|bit| mask >> bit & 1 == 1).fold(0, |thin, bit| {
            h = h
                .wrapping_mul(0x5851_f42d_4c95_7f2d)
                .wrapping_add(0x1405_7b7e_f767_814f);
            thin | u64::from(((h >> 40) as f32) < part * (1 << 24) as f32) << bit
        })
    }))
}
