//! Depths that rays and an application's polygons exchange, so that they hide each other.
//!
//! A depth is metres along the camera's axis, not along the ray: what a depth buffer holds, too, behind its projection. Depths go
//! both ways, each only if asked for ([`Renderer::set_depths`](crate::renderer::Renderer::set_depths)):
//!
//! - **in**: polygons were drawn first, and rays end at their depths. A segment of a ray that reaches beyond is cut there, so what
//!   has half an opacity shows half of the polygon behind it, to the metre. Rays ask for nothing that polygons hide.
//! - **out**: where each ray has lost half of its light, for polygons that are drawn afterwards.
//!
//! Only a GPU exchanges depths. Plain values: any thread.

use crate::error::RuntimeError;

/// Depth of a ray that never loses half of its light; as a depth at which a ray ends, no end.
pub const NO_DEPTH: f32 = 1e30;

/// What is exchanged.
#[derive(Clone, Debug, Default)]
pub struct Depths {
    /// Depths at which rays end, of a texture of the picture's size.
    pub until: Option<DepthTexture>,
    /// Whether depths are written, to be had from [`Renderer::depth`](crate::renderer::Renderer::depth).
    pub written: bool,
}

/// Depths that an application has drawn.
#[derive(Clone, Debug)]
pub struct DepthTexture {
    /// One sample a pixel, usable as a binding: `R32Float`, or a depth buffer of a format without stencil.
    pub view: wgpu::TextureView,
    /// What a texel says.
    pub scale: DepthScale,
}

/// How a texture's values and depths follow from each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthScale {
    /// The value is `offset + factor / depth`; or, with a factor of 0, the depth.
    offset: f32,
    factor: f32,
    /// The value where nothing was drawn.
    empty: f32,
}

impl DepthScale {
    /// Values are depths. Where nothing was drawn they are infinite, or [`NO_DEPTH`].
    pub const METRES: Self = Self {
        offset: 0.0,
        factor: 0.0,
        empty: f32::INFINITY,
    };

    /// Values of a depth buffer that polygons were drawn into with this projection: columns as `glam::Mat4::to_cols_array_2d`
    /// gives them, from view space to a clip space with depths from 0 to 1. Reversed ones, and those without a far plane, are as good
    /// as others, and keep more digits. The buffer was cleared to its farthest value (1, or 0 if reversed), which means that nothing was drawn there.
    ///
    /// # Errors
    /// If it is no perspective projection.
    pub fn of_projection(columns: &[[f32; 4]; 4]) -> Result<Self, RuntimeError> {
        let [[_, _, slope, w], [_, _, constant, w_constant]] = [columns[2], columns[3]];
        let (offset, factor) = (slope / w, constant / w.abs());
        if w_constant != 0.0 || !(offset.is_finite() && factor.is_finite() && factor != 0.0) {
            return Err(RuntimeError::Argument(
                "the depth buffer's projection is no perspective",
            ));
        }
        Ok(Self {
            offset,
            factor,
            empty: f32::from(factor < 0.0),
        })
    }

    /// The depth of a value, metres; [`NO_DEPTH`] where nothing was drawn.
    pub fn depth(self, value: f32) -> f32 {
        let depth = if self.factor == 0.0 {
            value
        } else {
            self.factor / (value - self.offset)
        };
        if value != self.empty && depth < NO_DEPTH {
            depth
        } else {
            NO_DEPTH
        }
    }

    /// The value of a depth in metres.
    pub fn value(self, depth: f32) -> f32 {
        if depth >= NO_DEPTH {
            self.empty
        } else if self.factor == 0.0 {
            depth
        } else {
            self.offset + self.factor / depth
        }
    }

    /// As kernels take it: offset, factor, the value where nothing was drawn.
    pub fn to_array(self) -> [f32; 3] {
        [self.offset, self.factor, self.empty]
    }
}

impl DepthTexture {
    /// Refuses what no rays of a picture of this size can end at.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn check(&self, [width, height]: [u32; 2]) -> Result<(), RuntimeError> {
        use wgpu::TextureFormat as F;
        let texture = self.view.texture();
        let refuse = |what| Err(RuntimeError::Argument(what));
        if (texture.width(), texture.height()) != (width, height) {
            return refuse("the depth texture has not the size of the picture");
        }
        if texture.sample_count() != 1 {
            return refuse("the depth texture has more than one sample a pixel");
        }
        if !matches!(
            texture.format(),
            F::R32Float | F::Depth16Unorm | F::Depth24Plus | F::Depth32Float
        ) {
            return refuse("the depth texture is neither R32Float nor a depth buffer without stencil");
        }
        if !texture.usage().contains(wgpu::TextureUsages::TEXTURE_BINDING) {
            return refuse("the depth texture cannot be bound");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::camera::{lh, rh};
    use glam::{Mat4, Vec3};

    #[test]
    fn values_of_projections_are_the_depths_of_what_was_drawn() {
        let (fov, aspect, near, far) = (0.8, 1.5, 0.5, 300.0);
        for (name, projection) in [
            (
                "right-handed",
                rh::proj::directx::perspective(fov, aspect, near, far),
            ),
            (
                "left-handed",
                lh::proj::directx::perspective(fov, aspect, near, far),
            ),
            ("reversed", rh::proj::directx::perspective(fov, aspect, far, near)),
            (
                "endless",
                rh::proj::directx::perspective_infinite(fov, aspect, near),
            ),
            (
                "endless, reversed",
                rh::proj::directx::perspective_infinite_reverse(fov, aspect, near),
            ),
        ] {
            let scale = DepthScale::of_projection(&projection.to_cols_array_2d()).unwrap();
            let sign = if name == "left-handed" { 1.0 } else { -1.0 };
            for depth in [0.6f32, 3.0, 40.0, 200.0] {
                let value = projection.project_point3(Vec3::new(0.3, -0.2, sign * depth)).z;
                assert!(
                    (scale.depth(value) / depth - 1.0).abs() < 1e-3,
                    "{name}: {depth} is {}",
                    scale.depth(value)
                );
                assert!((scale.value(depth) - value).abs() < 1e-6, "{name}: {depth}");
            }
            let cleared = if name.contains("reversed") { 0.0 } else { 1.0 };
            assert_eq!(scale.depth(cleared), NO_DEPTH, "{name}");
            assert_eq!(scale.value(NO_DEPTH), cleared, "{name}");
        }
        for empty in [f32::INFINITY, NO_DEPTH, f32::NAN] {
            assert_eq!(DepthScale::METRES.depth(empty), NO_DEPTH);
        }
        assert_eq!(DepthScale::METRES.depth(7.5), 7.5);
        let flat = rh::proj::directx::orthographic(-1.0, 1.0, -1.0, 1.0, 0.1, 10.0);
        for bad in [flat, Mat4::IDENTITY, Mat4::ZERO, Mat4::NAN] {
            assert!(DepthScale::of_projection(&bad.to_cols_array_2d()).is_err());
        }
    }
}
