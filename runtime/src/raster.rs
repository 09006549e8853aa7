//! Which pixels of a picture are drawn. Called by the render thread.

use brickfell_culler::Camera;
use glam::{DVec2, DVec4, UVec2};

use crate::effort::Effort;

/// The rays of a frame, in pixels of the whole picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raster {
    /// Rays per row, and rows.
    pub(crate) size: [u32; 2],
    /// Where the first one goes through.
    first: DVec2,
    step: DVec2,
}

impl Raster {
    /// One of `stride`² pixels; which one of a group goes round with the frames.
    pub(crate) fn probe(camera: &Camera, frame: u32, stride: u32) -> Self {
        Self {
            size: [camera.width.div_ceil(stride), camera.height.div_ceil(stride)],
            first: UVec2::new(frame % stride, frame / stride % stride).as_dvec2(),
            step: DVec2::splat(f64::from(stride)),
        }
    }

    /// A picture with the same edges and, below the full scale, fewer and larger pixels.
    pub(crate) fn scaled(camera: &Camera, effort: Effort) -> Self {
        let size = effort.size(camera.width, camera.height);
        let step = UVec2::new(camera.width, camera.height).as_dvec2() / UVec2::from(size).as_dvec2();
        Self {
            size,
            first: 0.5 * step - 0.5,
            step,
        }
    }

    /// Where in the whole picture the first pixel is, and the step to the next one, in its pixels.
    pub(crate) fn pixels(&self) -> DVec4 {
        DVec4::from((self.first, self.step))
    }

    /// Screen coordinates of the rays of a column and of a row.
    pub(crate) fn screen(&self, camera: &Camera, column: u32, row: u32) -> DVec2 {
        let pixel = self.first + self.step * UVec2::new(column, row).as_dvec2();
        camera.screen(pixel.x, pixel.y)
    }
}
