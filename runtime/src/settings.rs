//! What both renderers, the GPU ray caster and the CPU reference, are told besides the camera.

use glam::DVec3;

/// How a picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// log2 offset on the pixel's footprint before a level is chosen; negative is finer.
    pub bias: f64,
    /// Mix the two levels around the wanted one; off: the nearest level alone.
    pub mix_levels: bool,
    /// log2 of the voxels between two samples, -3 to 3 (beyond is taken as that): 0 samples each voxel that a ray crosses
    /// once, 1 every other, -1 twice.
    pub step: i32,
    /// Unit vector towards the sun, world axes.
    pub sun: DVec3,
    /// Light that every surface gets.
    pub ambient: f64,
    /// Light that a surface facing the sun gets on top.
    pub diffuse: f64,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            bias: -0.5,
            mix_levels: true,
            step: 0,
            sun: sun_direction(135.0, 45.0),
            ambient: 0.3,
            diffuse: 0.7,
        }
    }
}

impl RenderSettings {
    /// log2 of the voxels that a sampled segment spans along an axis, and the samples in it.
    pub(crate) fn segment(&self) -> (u32, u32) {
        let step = self.step.clamp(-3, 3);
        (step.max(0) as u32, 1 << (-step).max(0))
    }
}

/// Unit vector towards a sun at an azimuth (degrees clockwise from north) and elevation (degrees above the horizon).
pub fn sun_direction(azimuth: f64, elevation: f64) -> DVec3 {
    let (a, e) = (azimuth.to_radians(), elevation.to_radians());
    DVec3::new(a.sin() * e.cos(), a.cos() * e.cos(), e.sin())
}
