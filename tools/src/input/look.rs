//! What a mesh shows at a point of a triangle: material, texture, vertex colours, normal. Any thread.

use glam::{Vec2, Vec3};

use super::error::InputError;
use super::mesh::{Material, Mesh, Triangle};
use super::texture::Sampler;

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

/// What a triangle has at its corners, beside their places.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corners {
    /// Texture coordinates.
    pub uv: [Vec2; 3],
    /// Straight linear light; nothing where the mesh has none.
    pub colors: Option<[[f32; 3]; 3]>,
    /// Unit length or zero; nothing where a corner has none.
    pub normals: Option<[Vec3; 3]>,
}

impl Corners {
    /// The look at a point given by weights of the corners; `None` where it is clear.
    ///
    /// The normal is interpolated between the corners', as long as they have a direction, and `face` elsewhere.
    /// `texture` is the material's.
    ///
    /// # Errors
    /// If a part of the texture cannot be read.
    #[inline]
    pub fn look(
        &self,
        material: &Material,
        texture: Option<&mut Sampler>,
        w: [f32; 3],
        face: Vec3,
    ) -> Result<Option<Look>, InputError> {
        let [mut r, mut g, mut b, mut alpha] = material.color;
        if let Some(texture) = texture {
            let uv = (0..3).fold(Vec2::ZERO, |uv, k| uv + self.uv[k] * w[k]);
            let [tr, tg, tb, ta] = texture.at(uv)?;
            (r, g, b, alpha) = (r * tr, g * tg, b * tb, alpha * ta);
        }
        if alpha <= CLEAR {
            return Ok(None);
        }
        if let Some(colors) = &self.colors {
            let mut c = [0.0f32; 3];
            for (color, w) in colors.iter().zip(w) {
                (0..3).for_each(|k| c[k] += color[k] * w);
            }
            (r, g, b) = (r * c[0], g * c[1], b * c[2]);
        }
        let smooth = self
            .normals
            .map(|n| n.iter().zip(w).fold(Vec3::ZERO, |sum, (n, w)| sum + *n * w));
        let normal = smooth
            .map(Vec3::normalize_or_zero)
            .filter(|n| *n != Vec3::ZERO)
            .unwrap_or(face);
        Ok(Some(Look {
            alpha,
            rgb: [r, g, b],
            normal,
        }))
    }
}

impl Mesh {
    /// What a triangle has at its corners.
    pub fn at_corners(&self, triangle: &Triangle) -> Corners {
        let color = |v: u32| self.colors.get(v as usize).copied().unwrap_or([1.0; 3]);
        let normal = |n: u32| {
            let normal = self.normals.get(n as usize);
            normal.map_or(Vec3::ZERO, |n| n.normalize_or_zero())
        };
        Corners {
            uv: triangle.uv,
            colors: (!self.colors.is_empty()).then(|| triangle.v.map(color)),
            normals: triangle.n.map(|n| n.map(normal)),
        }
    }

    /// The look of a triangle at a point given by weights of its corners; see [`Corners::look`]. The point stands for
    /// `footprint_texels`, see [`super::Texture::sampler`].
    ///
    /// # Errors
    /// Those of [`Corners::look`].
    pub fn look(
        &self,
        triangle: &Triangle,
        w: [f32; 3],
        face: Vec3,
        footprint_texels: f32,
    ) -> Result<Option<Look>, InputError> {
        let Some(material) = self.materials.get(usize::from(triangle.material)) else {
            return Ok(None);
        };
        let mut texture = material.texture.as_ref().map(|t| t.sampler(footprint_texels));
        self.at_corners(triangle)
            .look(material, texture.as_mut(), w, face)
    }
}
