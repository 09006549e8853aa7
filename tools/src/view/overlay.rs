//! Lines over the picture: boxes of trees, and the pyramid of a camera that was frozen.

use brickfell_culler::{Aabb, Camera};
use egui::{Color32, Pos2, Stroke};
use glam::DVec3;

/// Nearest depth at which a line is drawn, metres.
const NEAR: f64 = 0.05;

/// Draws lines between world points where the camera sees them.
pub(super) struct Lines<'a> {
    painter: egui::Painter,
    camera: &'a Camera,
    /// Pixels per point.
    scale: f32,
}

impl<'a> Lines<'a> {
    pub(super) fn new(ctx: &egui::Context, camera: &'a Camera) -> Self {
        let layer = egui::LayerId::background();
        Self {
            painter: ctx.layer_painter(layer),
            camera,
            scale: ctx.pixels_per_point(),
        }
    }

    fn place(&self, point: DVec3) -> Option<Pos2> {
        let p = self.camera.project(point)?;
        // Pixel centres are whole numbers there.
        Some(Pos2::new(
            (p.x + 0.5) as f32 / self.scale,
            (p.y + 0.5) as f32 / self.scale,
        ))
    }

    /// A line, as far as it lies in front of the camera.
    fn line(&self, a: DVec3, b: DVec3, stroke: Stroke) {
        let depth = |p: DVec3| (p - self.camera.eye).dot(self.camera.forward) - NEAR;
        let (da, db) = (depth(a), depth(b));
        if da <= 0.0 && db <= 0.0 {
            return;
        }
        let cut = |from: DVec3, to: DVec3, df: f64, dt: f64| from + (to - from) * (df / (df - dt));
        let a = if da < 0.0 { cut(a, b, da, db) } else { a };
        let b = if db < 0.0 { cut(b, a, db, da) } else { b };
        if let (Some(a), Some(b)) = (self.place(a), self.place(b)) {
            self.painter.line_segment([a, b], stroke);
        }
    }

    /// The edges of a box, and a word at its middle.
    pub(super) fn cuboid(&self, bounds: &Aabb, word: &str, color: Color32) {
        let [lo, hi] = [bounds.min, bounds.max];
        let corner = |k: usize| {
            DVec3::new(
                if k & 1 == 0 { lo.x } else { hi.x },
                if k & 2 == 0 { lo.y } else { hi.y },
                if k & 4 == 0 { lo.z } else { hi.z },
            )
        };
        let stroke = Stroke::new(1.0, color);
        for k in 0..8usize {
            for bit in [1, 2, 4] {
                if k & bit == 0 {
                    self.line(corner(k), corner(k | bit), stroke);
                }
            }
        }
        if let Some(at) = self.place(bounds.center()) {
            let font = egui::FontId::proportional(11.0);
            self.painter
                .text(at, egui::Align2::CENTER_CENTER, word, font, color);
        }
    }

    /// What another camera sees, up to a depth.
    pub(super) fn pyramid(&self, other: &Camera, depth: f64, color: Color32) {
        let half = other.screen_half_extent();
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            other.eye + (other.forward + other.right * (x * half.x) + other.up * (y * half.y)) * depth
        });
        let stroke = Stroke::new(1.5, color);
        for k in 0..4 {
            self.line(other.eye, corners[k], stroke);
            self.line(corners[k], corners[(k + 1) % 4], stroke);
        }
    }
}
