//! What a face looks like in a cell.

use glam::{DVec2, DVec3, Vec3};

use super::faces::Binned;
use super::filter::{Cover, Outlines};
use super::overlap::closest_point;
use crate::input::{Corners, InputError, Material, Placing, Sampler};

/// Skin of opaque surfaces: over-saturated, so that interpolation does not see through.
const OPAQUE_SKIN: f32 = 2.0;

/// What one face shows in one cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub(crate) skin: f32,
    pub(crate) alpha: f32,
    /// Straight linear light.
    pub(crate) rgb: [f32; 3],
    /// Unit length.
    pub(crate) normal: [f32; 3],
}

/// A face ready to be looked at.
#[derive(Debug)]
pub(crate) struct Shader<'a> {
    at: Corners,
    material: &'a Material,
    base: DVec3,
    local: [DVec3; 3],
    face: Vec3,
    texture: Option<Sampler<'a>>,
    outlines: Option<Outlines>,
}

impl<'a> Shader<'a> {
    /// Makes a face ready, for outlines too if `covers`. `corners` are in cell coordinates.
    pub(crate) fn new(
        binned: &Binned,
        corners: &[DVec3; 3],
        materials: &'a [(Material, Placing)],
        covers: bool,
    ) -> Option<Self> {
        let (material, placing) = materials.get(binned.face.material as usize)?;
        let mut at = binned.face.at;
        at.uv = at.uv.map(|uv| uv * placing.scale + placing.offset);
        let base = corners[0].floor();
        let local = corners.map(|p| p - base);
        let face = (local[1] - local[0]).cross(local[2] - local[0]);
        let texture = material.texture.as_ref().map(|t| {
            let (w, h) = t.size();
            let [a, b] = [at.uv[1] - at.uv[0], at.uv[2] - at.uv[0]]
                .map(|d| d.as_dvec2() * DVec2::new(f64::from(w), f64::from(h)));
            // Texels that a voxel spans.
            t.sampler((a.perp_dot(b).abs() / face.length().max(f64::MIN_POSITIVE)).sqrt() as f32)
        });
        Some(Self {
            at,
            material,
            base,
            local,
            face: face.normalize_or_zero().as_vec3(),
            texture,
            outlines: covers.then(|| Outlines::new(&local, base.to_array().map(|b| b as i64))),
        })
    }

    /// What it covers of a cell, if that was asked for.
    #[inline]
    pub(crate) fn outline(&self, cell: [i64; 3]) -> Option<Cover> {
        self.outlines.as_ref().map(|o| o.cover(cell))
    }

    /// The look in a cell, taken at the triangle's nearest point to the cell's middle; `None` where it is clear.
    ///
    /// # Errors
    /// If a part of the texture cannot be read.
    #[inline]
    pub(crate) fn facet(&mut self, cell: [i64; 3]) -> Result<Option<Facet>, InputError> {
        let middle = DVec3::from_array(cell.map(|c| c as f64)) - self.base + 0.5;
        let w = closest_point(&self.local, middle).map(|w| w as f32);
        let look = self.at.look(self.material, self.texture.as_mut(), w, self.face)?;
        Ok(look.map(|look| {
            let skin = if self.material.cutout {
                look.alpha
            } else {
                OPAQUE_SKIN
            };
            Facet {
                skin,
                alpha: look.alpha,
                rgb: look.rgb,
                normal: look.normal.to_array(),
            }
        }))
    }
}
