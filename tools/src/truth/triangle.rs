//! A ray and a triangle, after S. Woop, C. Benthin, I. Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013:
//! no ray passes between two triangles that share an edge.

use glam::DVec3;

/// A direction made ready: the shear that makes it the z axis.
pub(super) struct Shear {
    axes: [usize; 3],
    x: f64,
    y: f64,
    z: f64,
}

impl Shear {
    /// `d` must not be zero.
    pub(super) fn new(d: DVec3) -> Self {
        let size = d.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        Self {
            axes,
            x: d[axes[0]] / d[z],
            y: d[axes[1]] / d[z],
            z: 1.0 / d[z],
        }
    }

    /// Depth in lengths of the direction, which may be negative, and weights of the corners (relative to the ray's start),
    /// where the ray meets the triangle from either side. A triangle seen edge-on is not met.
    pub(super) fn meet(&self, corners: &[DVec3; 3]) -> Option<(f64, [f64; 3])> {
        let [kx, ky, kz] = self.axes;
        let [a, b, c] = corners.map(|p| (p[kx] - self.x * p[kz], p[ky] - self.y * p[kz]));
        let u = c.0 * b.1 - c.1 * b.0;
        let v = a.0 * c.1 - a.1 * c.0;
        let w = b.0 * a.1 - b.1 * a.0;
        let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        let sum = u + v + w;
        if !inside || sum == 0.0 {
            return None;
        }
        let weights = [u, v, w].map(|e| e / sum);
        let depth = (0..3).map(|k| weights[k] * corners[k][kz]).sum::<f64>() * self.z;
        Some((depth, weights))
    }
}
