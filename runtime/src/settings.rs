//! What both renderers, the GPU ray caster and the CPU reference, are told besides the camera.

use brickfell_culler::Camera;
use glam::DVec3;

/// Width of the sun per metre of distance: it looks 0.533° wide.
pub const SUN_WIDTH: f64 = 0.0093;

/// What the picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Shows {
    /// The terrain.
    #[default]
    Picture,
    /// Colours by the level that is shown where a ray has lost half of its light.
    Levels,
    /// Lines where surfaces meet the faces of nodes.
    Nodes,
    /// Node reads and samples of each ray, from blue over green to red.
    Steps,
    /// Red where something is shown in the place of what is not loaded.
    Residency,
    /// Colours by the place of trees in the order front to back.
    Trees,
    /// Normals: east, north and up as red, green and blue.
    Normals,
}

/// How a picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// log2 offset on the pixel's footprint before a level is chosen; negative is finer.
    pub bias: f64,
    /// Part of a level, 0 to 1 (beyond is taken as that), over which a level fades into the next one: 1 mixes two levels
    /// everywhere, 0 takes the nearest alone and shows the change.
    pub fade: f64,
    /// log2 of the voxels between two samples, -3 to 3 (beyond is taken as that): 0 samples each voxel that a ray crosses
    /// once, 1 every other, -1 twice.
    pub step: i32,
    /// Unit vector towards the sun, world axes.
    pub sun: DVec3,
    /// Metres from the eye beyond which trees are not drawn.
    pub range: f64,
    /// Light that every surface gets.
    pub ambient: f64,
    /// Light that a surface facing the sun gets on top.
    pub diffuse: f64,
    /// Whether surfaces hide the sun from each other: a cone of the sun's width from each pixel.
    pub shadows: bool,
    /// Whether surfaces hide the sky, from which the ambient light comes, from each other: six wide cones from each pixel.
    pub occlusion: bool,
    /// What the picture shows; of other things than the terrain only a GPU makes pictures.
    pub shows: Shows,
    /// Milliseconds that a frame may take while the camera moves ([`crate::effort`]); `None` draws everything, as settled
    /// pictures and the reference always do.
    pub target_ms: Option<f64>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            bias: -1.0,
            fade: 0.25,
            step: 0,
            sun: sun_direction(135.0, 45.0),
            range: f64::INFINITY,
            ambient: 0.3,
            diffuse: 0.7,
            shadows: false,
            occlusion: false,
            shows: Shows::Picture,
            target_ms: None,
        }
    }
}

impl RenderSettings {
    /// [`Self::fade`] in its range.
    pub(crate) fn fade(&self) -> f64 {
        self.fade.clamp(0.0, 1.0)
    }

    /// log2 of the voxels that a sampled segment spans along an axis, and the samples in it.
    pub(crate) fn segment(&self) -> (u32, u32) {
        let step = self.step.clamp(-3, 3);
        (step.max(0) as u32, 1 << (-step).max(0))
    }

    /// Refuses, before a ray is cast, what no picture can be made of.
    ///
    /// # Errors
    /// What is wrong with the camera or the settings.
    pub fn check(&self, camera: &Camera) -> Result<(), &'static str> {
        let axes = [camera.eye, camera.forward, camera.right, camera.up];
        let pixel = camera.pixel_size();
        if !(axes.iter().all(|v| v.is_finite()) && pixel.is_finite() && pixel > 0.0) {
            return Err("the camera is not finite, or its field of view is empty");
        }
        if camera.width == 0 || camera.height == 0 {
            return Err("the camera's picture has no pixel");
        }
        if !(self.bias.is_finite() && (pixel * self.bias.exp2()).is_finite()) {
            return Err("the level bias is not finite");
        }
        if self.fade.is_nan() {
            return Err("the part of a level that fades is not a number");
        }
        if !(self.sun.is_finite() && self.ambient.is_finite() && self.diffuse.is_finite()) {
            return Err("the light is not finite");
        }
        if !self.target_ms.is_none_or(|ms| ms.is_finite() && ms > 0.0) {
            return Err("the time for a frame is not above zero");
        }
        Ok(())
    }
}

/// Unit vector towards a sun at an azimuth (degrees clockwise from north) and elevation (degrees above the horizon).
pub fn sun_direction(azimuth: f64, elevation: f64) -> DVec3 {
    let (a, e) = (azimuth.to_radians(), elevation.to_radians());
    DVec3::new(a.sin() * e.cos(), a.cos() * e.cos(), e.sin())
}
