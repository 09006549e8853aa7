//! Lights that surfaces hide from each other: the sun, and the sky that ambient light comes from.
//!
//! Where a pixel's ray has lost half of its light, a little above the surface there, cones begin: one toward the sun, as wide as
//! it looks, and six that share the sky over the surface by cosine (seed 000 §8). A cone is a ray whose footprint grows with
//! the distance, and so are the camera's: it is marched as a ray of an eye so far behind its start that the footprint at the start is
//! the pixel's, or the finest voxel if that is more. What light is left at its end is seen; the rest is taken from the pixel.
//!
//! There is no colour and no light in between: a pixel has one start, and half transparent ones in front of others are in their shadow.
//! Plain values: any thread.

use glam::DVec3;

use super::real::Real;
use super::shade::Surface;
use super::view::Lens;
use super::walk::Ray;
use crate::settings::{RenderSettings, SUN_WIDTH};

/// Width of the voxels in which the sky's cones are sampled, per metre. The cones are 1.15 wide; in voxels as large as that a surface
/// would hide the sky from itself (docs/performance.md has what other widths give).
pub(crate) const SKY_WIDTH: f64 = 0.4;
/// How far above the surface cones begin, in widths: beyond what the surface itself is blurred to.
pub(crate) const LIFT: f64 = 1.5;

/// Cosine of the angle between the surface's normal and the axes of all cones of the sky but the first, which is along the normal: the
/// mean, by cosine, of the sky beyond 30°.
pub(crate) const SKY_TILT: f64 = 0.6;
/// Share of the sky in the first cone: sin² 30°. The other five have the rest.
pub(crate) const SKY_MIDDLE: f64 = 0.25;

/// Lights that can be hidden.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lights {
    /// Lenses of the cones toward the sun and the sky, of those that are asked for.
    lenses: [Option<Lens>; 2],
    footprint: f64,
    sun: DVec3,
    ambient: f64,
    diffuse: f64,
}

/// A ray that gathers what hides a light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone<T> {
    /// 0 toward the sun, 1 toward the sky.
    pub(crate) light: usize,
    /// The ray, from the eye behind its start.
    pub(crate) ray: Ray<T>,
    /// Its depth at the start.
    pub(crate) start: f64,
}

impl Lights {
    /// The lights of a picture through a lens, `None` if all of them shine through everything.
    pub(crate) fn new(settings: &RenderSettings, lens: &Lens) -> Option<Self> {
        let widths = [(settings.shadows, SUN_WIDTH), (settings.occlusion, SKY_WIDTH)];
        let lenses = widths.map(|(wanted, footprint)| wanted.then_some(Lens { footprint, ..*lens }));
        (settings.shadows || settings.occlusion).then_some(Self {
            lenses,
            footprint: lens.footprint,
            sun: settings.sun,
            ambient: settings.ambient,
            diffuse: settings.diffuse,
        })
    }

    /// Lenses of the cones toward the sun and the sky.
    pub(crate) fn lenses(&self) -> &[Option<Lens>; 2] {
        &self.lenses
    }

    /// The share of its light that a pixel keeps, whose ray sees a surface along a direction (world metres per metre of depth).
    /// `gather` returns what light is left at a cone's end.
    ///
    /// # Errors
    /// Those of `gather`.
    #[inline(always)]
    pub(crate) fn kept<T: Real, E>(
        &self,
        surface: &Surface,
        direction: DVec3,
        mut gather: impl FnMut(&Cone<T>) -> Result<f64, E>,
    ) -> Result<f64, E> {
        let [lit, sunlit] = surface.lit;
        let Some(normal) = surface.facing.try_normalize() else {
            return Ok(1.0);
        };
        let (sun, sky) = (sunlit * self.diffuse, lit * self.ambient);
        let all = 1.0 - lit + sky + sun;
        let width = (self.footprint * surface.depth).max(surface.finest);
        let from = direction * surface.depth + normal * (LIFT * width);
        let mut hidden = 0.0;
        for k in 0..7 {
            let (light, toward, share) = match k {
                0 => (0, self.sun, sun),
                1 => (1, normal, sky * SKY_MIDDLE),
                _ => (1, tilted(normal, k - 2), sky * ((1.0 - SKY_MIDDLE) / 5.0)),
            };
            let Some(lens) = self.lenses[light].filter(|_| share > 0.0) else {
                continue;
            };
            let start = width / lens.footprint;
            let cone = Cone {
                light,
                ray: Ray::new(from - toward * start, toward),
                start,
            };
            hidden += share * (1.0 - gather(&cone)?);
        }
        Ok(if hidden > 0.0 { 1.0 - hidden / all } else { 1.0 })
    }
}

/// The axis of one of the five cones around a normal.
fn tilted(n: DVec3, k: u32) -> DVec3 {
    // Axes that turn with the normal wherever it turns, but for straight down.
    let f = 1.0 / (1.0 + n.z).max(1e-3);
    let b = n.x * n.y * f;
    let (u, v) = (
        DVec3::new(1.0 - n.x * n.x * f, -b, -n.x),
        DVec3::new(-b, 1.0 - n.y * n.y * f, -n.y),
    );
    let (sin, cos) = (f64::from(k) * (std::f64::consts::TAU / 5.0)).sin_cos();
    (n * SKY_TILT + (u * cos + v * sin) * (1.0 - SKY_TILT * SKY_TILT).sqrt()).normalize()
}
