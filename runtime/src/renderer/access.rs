//! What a renderer is asked and told between frames: pictures, depths, figures. Called by the render thread.

use brickfell_culler::{Camera, VisibleTree};
use brickfell_pager::PagerStats;

use super::Renderer;
use crate::caster::Feedback;
use crate::depth::Depths;
use crate::error::RuntimeError;
use crate::memory::PoolSizes;
use crate::picture::Picture;
use crate::present::Output;
use crate::terrain::Terrain;
use crate::texture_pool::TexturePoolManager;

impl Renderer {
    /// The last picture, in linear light; waits for the device.
    ///
    /// # Errors
    /// If nothing was drawn yet or the device failed.
    pub fn read_picture(&self) -> Result<Picture, RuntimeError> {
        self.backend.read_picture()
    }

    /// From now on another camera than the one that draws decides which trees are drawn, so that they can be looked at from outside;
    /// `None` ends that.
    pub fn cull_from(&mut self, camera: Option<Camera>) {
        self.frozen = camera;
    }

    /// From now on rays end at the depths of polygons, or say where they have lost half of their light; the default ends both. What is
    /// wrong with a depth texture is told by the next frame, and that only a GPU does this. A texture is read when a frame is
    /// drawn: what fills it has to be submitted to the same queue before.
    pub fn set_depths(&mut self, depths: Depths) {
        self.depths = depths;
    }

    /// Depths of the last picture on the device, if they were asked for: an `R32Float` texture of which so many columns and
    /// rows were drawn, with metres along the camera's axis, [`NO_DEPTH`](crate::depth::NO_DEPTH) where rays kept more than half of their light.
    pub fn depth(&self) -> Option<(&wgpu::TextureView, [u32; 2])> {
        self.backend.depth()
    }

    /// The same as values, a row after the other, and how many columns and rows; waits for the device.
    ///
    /// # Errors
    /// If none were asked for or the device failed.
    pub fn read_depths(&self) -> Result<(Vec<f32>, [u32; 2]), RuntimeError> {
        self.backend.read_depths()
    }

    /// The trees in view of the last frame, front to back.
    pub fn visible(&self) -> &[VisibleTree] {
        &self.culler.result().visible
    }

    /// Where the last picture is, to be shown; `None` if nothing was drawn yet.
    pub fn output(&self) -> Option<Output<'_>> {
        self.backend.output()
    }

    /// What the rays of the newest frame that was read back reported.
    pub fn feedback(&self) -> &Feedback {
        &self.feedback
    }

    /// The pager's counters.
    pub fn pager_stats(&self) -> PagerStats {
        self.pager.stats()
    }

    /// Bytes of a brick in the pool.
    pub fn brick_bytes(&self) -> u64 {
        self.backend.brick_bytes()
    }

    /// Brick slots of the pool.
    pub fn brick_slots(&self) -> u32 {
        self.backend.sizes().bricks()
    }

    /// Sizes of the pools.
    pub fn pool_sizes(&self) -> PoolSizes {
        self.backend.sizes()
    }

    /// What is in the pools.
    pub fn pool(&self) -> &TexturePoolManager {
        &self.pool
    }

    /// Whether bricks that are block-compressed on disk are not so on the device, because it cannot read them or is not to.
    pub fn decodes_blocks(&self) -> bool {
        self.terrain.compressed && !self.backend.sizes().blocks
    }

    /// Bytes held on the device.
    pub fn gpu_bytes(&self) -> u64 {
        self.backend.bytes()
    }

    /// Everything that could not be read so far, one line each.
    pub fn faults(&self) -> &[String] {
        &self.faults
    }

    /// The terrain that is drawn.
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }

    /// Waits until the device has drawn what it was given. Never called by a frame that runs in real time.
    ///
    /// # Errors
    /// If the device failed.
    pub fn wait(&self) -> Result<(), RuntimeError> {
        self.backend.wait()
    }

    /// Name and kind of the device, for reports.
    pub fn device(&self) -> String {
        self.backend.describe()
    }

    /// How the device is reached: `vulkan`, `metal`, `dx12`, or `cpu`.
    pub fn backend(&self) -> String {
        self.backend.name()
    }
}
