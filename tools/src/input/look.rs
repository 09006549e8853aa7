//! What a mesh shows at a point of a triangle: material, texture, vertex colours, normal. Any thread.

use glam::{Vec2, Vec3};

use super::mesh::{Mesh, Triangle};

/// Opacity up to which a texel shows nothing: half a step of the stored alpha.
const CLEAR: f32 = 0.5 / 255.0;

/// What a surface shows at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Opacity, above 0; of a material that is not cut out always 1.
    pub alpha: f32,
    /// Straight linear light.
    pub rgb: [f32; 3],
    /// The mesh's normal, unit length.
    pub normal: Vec3,
}

impl Mesh {
    /// The look of a triangle at a point given by weights of its corners; `None` where it is clear.
    ///
    /// The normal is interpolated between the file's, as long as they have a direction, and `face` elsewhere.
    /// `footprint_texels` is how many texels the point stands for, see [`super::Texture::sample`].
    pub fn look(&self, triangle: &Triangle, w: [f32; 3], face: Vec3, footprint_texels: f32) -> Option<Look> {
        let material = self.materials.get(usize::from(triangle.material))?;
        let [mut r, mut g, mut b, mut alpha] = material.color;
        if let Some(texture) = &material.texture {
            let uv = (0..3).fold(Vec2::ZERO, |uv, k| uv + triangle.uv[k] * w[k]);
            let [tr, tg, tb, ta] = texture.sample(uv, footprint_texels);
            (r, g, b, alpha) = (r * tr, g * tg, b * tb, alpha * ta);
        }
        if alpha <= CLEAR {
            return None;
        }
        if !self.colors.is_empty() {
            let mut c = [0.0f32; 3];
            for (v, w) in triangle.v.iter().zip(w) {
                let color = self.colors.get(*v as usize).copied().unwrap_or([1.0; 3]);
                (0..3).for_each(|k| c[k] += color[k] * w);
            }
            (r, g, b) = (r * c[0], g * c[1], b * c[2]);
        }
        let smooth = triangle.n.map(|n| {
            n.iter().zip(w).fold(Vec3::ZERO, |sum, (n, w)| {
                sum + self
                    .normals
                    .get(*n as usize)
                    .map_or(Vec3::ZERO, |n| n.normalize_or_zero())
                    * w
            })
        });
        let normal = smooth
            .map(Vec3::normalize_or_zero)
            .filter(|n| *n != Vec3::ZERO)
            .unwrap_or(face);
        Some(Look {
            alpha,
            rgb: [r, g, b],
            normal,
        })
    }
}
