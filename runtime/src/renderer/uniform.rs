//! A frame as the kernels are told of it, and which of its pixels are drawn. Called by the render thread.

use brickfell_culler::Camera;
use brickfell_formats::blocks::{NORMAL_SCALE, NORMAL_ZERO};
use brickfell_shaders::layout;
use glam::{DVec2, UVec2};

use super::Renderer;
use crate::caster::REQUEST_CAPACITY;
use crate::effort::Effort;
use crate::settings::RenderSettings;

/// The rays of a frame, in pixels of the whole picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Raster {
    /// Rays per row, and rows.
    pub(super) size: [u32; 2],
    /// Where the first one goes through.
    first: DVec2,
    step: DVec2,
}

impl Raster {
    /// One of `stride`² pixels; which one of a group goes round with the frames.
    pub(super) fn probe(camera: &Camera, frame: u32, stride: u32) -> Self {
        Self {
            size: [camera.width.div_ceil(stride), camera.height.div_ceil(stride)],
            first: UVec2::new(frame % stride, frame / stride % stride).as_dvec2(),
            step: DVec2::splat(f64::from(stride)),
        }
    }

    /// A picture with the same edges and, below the full scale, fewer and larger pixels.
    pub(super) fn scaled(camera: &Camera, effort: Effort) -> Self {
        let size = effort.size(camera.width, camera.height);
        let step = UVec2::new(camera.width, camera.height).as_dvec2() / UVec2::from(size).as_dvec2();
        Self {
            size,
            first: 0.5 * step - 0.5,
            step,
        }
    }
}

impl Renderer {
    pub(super) fn frame_uniform(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        tree_count: u32,
        bias: f64,
        raster: &Raster,
    ) -> layout::Frame {
        let sizes = self.memory.sizes;
        let (first, second) = (raster.first, raster.first + raster.step);
        let origin = camera.screen(first.x, first.y);
        let next = camera.screen(second.x, second.y);
        let axis = |v: glam::DVec3, w: f64| v.extend(w).as_vec4().to_array();
        let (segment_shift, segment_samples) = settings.segment();
        let texels = sizes.texels().map(|t| 1.0 / t as f32);
        let [x, y, z] = sizes.slot();
        let [normal_scale, normal_zero] =
            [NORMAL_SCALE, NORMAL_ZERO].map(|v| glam::Vec3::from(v.map(f32::from)));
        layout::Frame {
            size: raster.size,
            tree_count,
            frame: self.frame,
            screen_origin: origin.as_vec2().to_array(),
            screen_step: (next - origin).as_vec2().to_array(),
            forward: axis(camera.forward, 0.0),
            right: axis(camera.right, 0.0),
            up: axis(camera.up, 0.0),
            sun: axis(settings.sun, settings.ambient),
            diffuse: settings.diffuse as f32,
            footprint: (camera.pixel_size() * bias.exp2()) as f32,
            fade: settings.fade() as f32,
            blocks: u32::from(sizes.blocks),
            slots: [sizes.slots[0], sizes.slots[1], sizes.slots[2], 0],
            texel: [texels[0], texels[1], texels[2], 0.0],
            brick_slots: sizes.bricks(),
            node_tiles: sizes.tiles,
            request_capacity: REQUEST_CAPACITY,
            request_share: self.request_share,
            segment_shift,
            segment_samples,
            pad: [0; 2],
            slot: [x, y, z, 0],
            normal_scale: (255.0 / normal_scale).extend(0.0).to_array(),
            normal_zero: (-normal_zero / normal_scale).extend(0.0).to_array(),
        }
    }
}
