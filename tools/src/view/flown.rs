//! What outlasts a device: where the camera is, what is held down, what was asked for. A plain value of the window's thread.

use std::collections::HashSet;
use std::time::Instant;

use brickfell_culler::Camera;
use brickfell_runtime::renderer::FrameReport;
use brickfell_runtime::settings::Shows;
use glam::{DVec2, DVec3};
use winit::keyboard::KeyCode;

use super::hud::Hud;
use super::rig::Rig;
use super::scene::Scene;
use super::tape::Tape;
use crate::commands::CommandError;
use crate::commands::fly::no_tree;
use crate::commands::view::Args;
use crate::flight::Flight;

/// The mouse over the picture.
#[derive(Default)]
pub(super) struct Mouse {
    pub(super) at: DVec2,
    pub(super) dragging: bool,
    /// Moved since the last frame while dragging, pixels.
    pub(super) moved: DVec2,
    pub(super) wheel: f64,
    pub(super) clicked: Option<(Instant, DVec2)>,
}

/// What outlasts a device: where the camera is and what was asked for.
pub(super) struct Flown {
    pub(super) rig: Rig,
    pub(super) hud: Hud,
    pub(super) tape: Tape,
    pub(super) down: HashSet<KeyCode>,
    pub(super) mouse: Mouse,
    pub(super) shows: Shows,
    pub(super) boxes: bool,
    pub(super) frozen: Option<Camera>,
    pub(super) shot: bool,
    pub(super) quiet: u32,
    pub(super) last: Instant,
    pub(super) camera: Option<Camera>,
    pub(super) report: FrameReport,
}

impl Flown {
    /// At the begin of a path that was named, or with all of the terrain in sight.
    ///
    /// # Errors
    /// If the path cannot be read, or there is nothing to look at.
    pub(super) fn new(args: &Args, scene: &Scene) -> Result<Self, CommandError> {
        let path = args.path.as_deref().map(Flight::load).transpose()?;
        let bounds = scene.bounds().ok_or_else(|| no_tree(&args.dir))?;
        let orbit = Flight::orbit(&bounds, 1.0);
        let (eye, target) = path.as_ref().unwrap_or(&orbit).at(0.0);
        Ok(Self {
            rig: Rig::new(eye, target),
            hud: Hud::default(),
            tape: Tape::new(path),
            down: HashSet::new(),
            mouse: Mouse::default(),
            shows: Shows::Picture,
            boxes: false,
            frozen: None,
            shot: false,
            quiet: 0,
            last: Instant::now(),
            camera: None,
            report: FrameReport::default(),
        })
    }

    /// A camera that can always be made.
    pub(super) fn first(width: u32, height: u32) -> Camera {
        Camera {
            eye: DVec3::ZERO,
            forward: DVec3::Y,
            right: DVec3::X,
            up: DVec3::Z,
            fov_y: 1.0,
            width,
            height,
        }
    }
}
