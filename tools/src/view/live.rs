//! What is open while the window is: device, surface, renderer, camera; what events do to them, and a frame.

use std::sync::Arc;
use std::time::{Duration, Instant};

use brickfell_culler::{Camera, VisibleTree};
use brickfell_runtime::Device;
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::settings::{RenderSettings, Shows, sun_direction};
use egui::Color32;
use glam::{DVec2, DVec3, dvec2};
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoopProxy};
use winit::keyboard::PhysicalKey;
use winit::window::{Fullscreen, Window};

use super::Woken;
use super::flown::Flown;
use super::hud::Seen;
use super::keep::Kept;
use super::keys::{Action, action};
use super::overlay::Lines;
use super::probe::{Answer, Question};
use super::rig::Wish;
use super::scene::Scene;
use super::screen::Screen;
use crate::commands::CommandError;
use crate::commands::say::note;
use crate::commands::view::Args;
use crate::picture_file::over_sky;

/// Vertical radians that the picture turns when the mouse is dragged over all of its height.
const DRAG: f64 = 1.6;
/// Time and pixels between the clicks of a double-click.
const CLICK: (Duration, f64) = (Duration::from_millis(400), 5.0);
/// Frames in a row without anything to load or to move after which the window rests.
const QUIET: u32 = 8;

/// Everything that is open.
pub(super) struct Live {
    pub(super) kept: Kept,
    args: Args,
    wake: EventLoopProxy<Woken>,
    screen: Screen,
    /// What draws the terrain.
    device: Device,
    scene: Scene,
    flown: Flown,
}

impl Live {
    /// Opens window, device and terrain; after a loss with the window and the camera of before.
    pub(super) fn open(
        event_loop: &ActiveEventLoop,
        args: &Args,
        kept: Kept,
        wake: EventLoopProxy<Woken>,
        before: Option<Live>,
    ) -> Result<Self, CommandError> {
        let title = format!("brickfell – {}", args.dir.display());
        let (old_window, flown) = before.map(Live::into_parts).unzip();
        let window = match old_window {
            Some(window) => window,
            None => {
                let [width, height] = kept.size;
                let attributes = Window::default_attributes()
                    .with_title(title)
                    .with_inner_size(PhysicalSize::new(width, height));
                Arc::new(event_loop.create_window(attributes)?)
            }
        };
        let screen = Screen::open(window)?;
        let gpu = &screen.gpu;
        let device = if args.cpu || (gpu.is_software() && !args.gpu) {
            if !args.cpu {
                note(format_args!(
                    "{} is software; the CPU draws (--gpu: it does not)",
                    gpu.info.name
                ));
            }
            Device::Cpu
        } else {
            Arc::clone(gpu).into()
        };
        let scene = Scene::open(args, &kept, &device, &wake)?;
        let flown = match flown {
            Some(flown) => flown,
            None => Flown::new(args, &scene)?,
        };
        Ok(Self {
            args: args.clone(),
            kept,
            wake,
            screen,
            device,
            scene,
            flown,
        })
    }

    /// What outlasts a device; all that is on it goes, so that another surface may have the window.
    fn into_parts(self) -> (Arc<Window>, Flown) {
        (self.screen.window, self.flown)
    }

    /// Asks for a frame.
    pub(super) fn wake(&self) {
        self.screen.window.request_redraw();
    }

    /// Takes an event; true if the window is to be closed.
    pub(super) fn handle(&mut self, event: &WindowEvent) -> bool {
        let Screen { window, input, .. } = &mut self.screen;
        let taken = input.on_window_event(window, event);
        if taken.repaint {
            window.request_redraw();
        }
        let is_typing = self.flown.hud.going.is_some() || input.egui_ctx().text_edit_focused();
        let mouse = &mut self.flown.mouse;
        match event {
            WindowEvent::Resized(size)
                if size.width > 0 && size.height > 0 && window.fullscreen().is_none() =>
            {
                self.kept.size = (*size).into();
            }
            WindowEvent::Focused(false) => {
                self.flown.down.clear();
                mouse.dragging = false;
            }
            WindowEvent::KeyboardInput { event, .. } if !is_typing => {
                let PhysicalKey::Code(key) = event.physical_key else {
                    return false;
                };
                match (event.state, action(key)) {
                    (ElementState::Released, _) => {
                        self.flown.down.remove(&key);
                    }
                    (ElementState::Pressed, Some(action)) if !event.repeat => {
                        self.flown.down.insert(key);
                        window.request_redraw();
                        return self.act(action);
                    }
                    _ => {}
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                let at = dvec2(position.x, position.y);
                if mouse.dragging {
                    mouse.moved += at - mouse.at;
                    window.request_redraw();
                }
                mouse.at = at;
            }
            WindowEvent::MouseInput {
                state,
                button: MouseButton::Left,
                ..
            } => {
                mouse.dragging = *state == ElementState::Pressed && !taken.consumed;
                if mouse.dragging {
                    let before = mouse.clicked.replace((Instant::now(), mouse.at));
                    let is_second = before.is_some_and(|(when, at)| {
                        when.elapsed() < CLICK.0 && at.distance(mouse.at) < CLICK.1
                    });
                    if let Some(camera) = self.flown.camera.filter(|_| is_second) {
                        let direction = camera.ray(mouse.at.x - 0.5, mouse.at.y - 0.5);
                        self.scene.probe.ask(Question::Point(camera.eye, direction));
                        mouse.clicked = None;
                    }
                }
            }
            WindowEvent::MouseWheel { delta, .. } if !taken.consumed => {
                mouse.wheel += match delta {
                    MouseScrollDelta::LineDelta(_, y) => f64::from(*y),
                    MouseScrollDelta::PixelDelta(p) => p.y / 50.0,
                };
                window.request_redraw();
            }
            _ => {}
        }
        false
    }

    /// Does what a key asks for once; true if the window is to be closed.
    fn act(&mut self, action: Action) -> bool {
        let Flown {
            rig,
            hud,
            tape,
            shows,
            boxes,
            frozen,
            camera,
            ..
        } = &mut self.flown;
        if action.moves() {
            tape.stop();
        }
        match action {
            Action::Go(_) | Action::Fast => {}
            Action::NextMode => {
                rig.set_mode(rig.mode().next());
                hud.say(rig.mode().name());
            }
            Action::Mode(mode) => {
                rig.set_mode(mode);
                hud.say(mode.name());
            }
            Action::Home => rig.go_home(),
            Action::GoTo => hud.going = Some(String::new()),
            Action::Help => hud.help = !hud.help,
            Action::Hud => self.kept.hud = !self.kept.hud,
            Action::Show(_) if matches!(self.device, Device::Cpu) => {
                hud.say("the CPU shows the terrain alone; start with --gpu for this");
            }
            Action::Show(what) => *shows = if *shows == what { Shows::Picture } else { what },
            Action::Boxes => *boxes = !*boxes,
            Action::Freeze => {
                *frozen = frozen.is_none().then_some(*camera).flatten();
                hud.say(if frozen.is_some() {
                    "frozen"
                } else {
                    "no longer frozen"
                });
            }
            Action::Shadows => self.kept.shadows = !self.kept.shadows,
            Action::Occlusion => self.kept.occlusion = !self.kept.occlusion,
            Action::Screenshot => (self.flown.shot, self.flown.quiet) = (true, 0),
            Action::Record if !tape.is_recording() => tape.record(),
            Action::Record => match tape.finish(&self.args.shots) {
                Ok(file) => hud.say(format!("camera path in {}; P flies it", file.display())),
                Err(e) => hud.say(e.to_string()),
            },
            Action::Play => {
                if !tape.play() {
                    hud.say("there is no path: R records one, --path names one");
                }
            }
            Action::Fullscreen => {
                let window = &self.screen.window;
                let is_full = window.fullscreen().is_some();
                window.set_fullscreen((!is_full).then_some(Fullscreen::Borderless(None)));
            }
            Action::Quit => return true,
        }
        self.flown.quiet = 0;
        false
    }

    /// Draws a frame; false if nothing moves and nothing is to come.
    ///
    /// # Errors
    /// If device or surface are lost.
    pub(super) fn frame(&mut self) -> Result<bool, RuntimeError> {
        let size = self.screen.size();
        if size.contains(&0) {
            return Ok(false);
        }
        if self.scene.has_changed(&self.args) {
            self.reopen("the scene has changed");
        }
        let now = Instant::now();
        let dt = (now - std::mem::replace(&mut self.flown.last, now)).as_secs_f64();
        let camera = self.move_camera(dt, size);
        let settings = self.settings();
        let Some(texture) = self.screen.acquire()? else {
            return Ok(false);
        };
        let renderer = &mut self.scene.renderer;
        renderer.cull_from(self.flown.frozen);
        let report = renderer.frame(&camera, &settings)?;
        let (shapes, repaint) = self.lay_out(&camera, size);
        let picture = (self.scene.renderer.output(), &camera);
        self.screen.paint(texture, picture, shapes)?;

        let flown = &mut self.flown;
        let renderer = &self.scene.renderer;
        (flown.hud).note(&report, renderer.feedback(), &renderer.pager_stats(), dt * 1e3);
        let loads = report.pending + report.uploads + report.trees_waiting > 0
            || renderer.feedback().request_count > 0
            || report.scale < 1.0;
        let moves = flown.camera.replace(camera) != Some(camera);
        flown.quiet = if loads || moves { 0 } else { flown.quiet + 1 };
        flown.report = report;
        if flown.shot && flown.quiet > QUIET / 2 {
            flown.shot = false;
            let words = self.screenshot(&camera);
            self.flown.hud.say(words);
        }
        let flown = &self.flown;
        let awake = flown.shot || flown.tape.is_playing() || flown.rig.travels() || !flown.down.is_empty();
        Ok(awake || repaint || flown.quiet < QUIET)
    }

    fn screenshot(&self, camera: &Camera) -> String {
        let picture = match self.scene.renderer.read_picture() {
            Ok(picture) => picture,
            Err(e) => return e.to_string(),
        };
        let file = super::free_file(&self.args.shots, "brickfell", "png");
        match over_sky(&picture, camera).save(&file) {
            Ok(()) => format!("screenshot in {}", file.display()),
            Err(e) => format!("{}: {e}", file.display()),
        }
    }

    /// Opens the terrain again; the old one stays where the new one is not sound.
    fn reopen(&mut self, why: &str) {
        self.flown.quiet = 0;
        match Scene::open(&self.args, &self.kept, &self.device, &self.wake) {
            Ok(scene) => {
                self.scene = scene;
                self.flown.hud.say(why);
            }
            Err(e) => self.flown.hud.say(format!("{why}, but the old one stays: {e}")),
        }
    }

    /// Moves the camera by what keys and mouse ask for.
    fn move_camera(&mut self, dt: f64, [width, height]: [u32; 2]) -> Camera {
        let Flown {
            rig,
            tape,
            down,
            mouse,
            ..
        } = &mut self.flown;
        for answer in self.scene.probe.answers() {
            match answer {
                Answer::Ground(place, ground) => rig.answer(place, ground),
                Answer::Point(Some(point)) => rig.approach(point),
                Answer::Point(None) => {}
            }
        }
        let mut wish = Wish {
            turn: std::mem::take(&mut mouse.moved) * dvec2(1.0, -1.0) * (DRAG / f64::from(height)),
            wheel: std::mem::take(&mut mouse.wheel),
            ..Wish::default()
        };
        for key in down.iter() {
            match action(*key) {
                Some(Action::Go(go)) => wish.go += DVec3::from(go.map(f64::from)),
                Some(Action::Fast) => wish.fast = true,
                _ => {}
            }
        }
        if wish.turn != DVec2::ZERO || wish.wheel != 0.0 {
            tape.stop();
        }
        let before = rig.view();
        let place = rig.advance(&wish, dt);
        if let Some((eye, target)) = tape.advance(dt, rig.view()) {
            rig.look(eye, target);
        }
        if rig.travels() || rig.view() != before || rig.height().is_none() {
            self.scene.probe.ask(Question::Ground(place));
        }
        let (eye, target) = rig.view();
        let camera = Camera::look_at(eye, target, self.args.fov, width, height);
        // What makes no camera (an eye beyond numbers) leaves the last one.
        camera
            .ok()
            .or(self.flown.camera)
            .unwrap_or_else(|| Flown::first(width, height))
    }

    fn settings(&self) -> RenderSettings {
        let kept = &self.kept;
        let is_timed = kept.target_ms >= 1.0 && !self.flown.shot;
        RenderSettings {
            bias: kept.bias,
            sun: sun_direction(kept.sun[0], kept.sun[1]),
            range: kept.range_km * 1e3,
            shadows: kept.shadows,
            occlusion: kept.occlusion,
            shows: self.flown.shows,
            target_ms: is_timed.then_some(kept.target_ms),
            ..RenderSettings::default()
        }
    }

    /// Figures, sliders and lines; and whether they are to be drawn again at once.
    fn lay_out(&mut self, camera: &Camera, pixels: [u32; 2]) -> (egui::FullOutput, bool) {
        let renderer = &self.scene.renderer;
        let flown = &mut self.flown;
        let state = [
            (flown.shot, "screenshot as soon as nothing is loading"),
            (flown.tape.is_recording(), "recording"),
            (flown.frozen.is_some(), "frozen: F goes on"),
        ];
        let state: Vec<&str> = state
            .iter()
            .filter(|(is, _)| *is)
            .map(|(_, word)| *word)
            .collect();
        let device = renderer.device();
        let seen = Seen {
            report: &flown.report,
            feedback: renderer.feedback(),
            pager: renderer.pager_stats(),
            device: &device,
            brick_slots: renderer.brick_slots(),
            pixels,
            eye: camera.eye,
            height: flown.rig.height(),
            mode: flown.rig.mode().name(),
            faults: renderer.faults(),
            state: &state.join("\n"),
        };
        let (mut asked, kept, hud) = (None, &mut self.kept, &mut flown.hud);
        let output = self.screen.lay_out(|ctx| {
            if flown.boxes || flown.frozen.is_some() {
                let lines = Lines::new(ctx, camera);
                for (k, tree) in renderer.visible().iter().enumerate() {
                    let color = if tree.beyond.is_some() {
                        Color32::YELLOW
                    } else {
                        Color32::LIGHT_BLUE
                    };
                    lines.cuboid(&tree.bounds, &format!("{}", k + 1), color);
                }
                if let Some(frozen) = &flown.frozen {
                    let reach = |t: &VisibleTree| t.bounds.center().distance(frozen.eye);
                    let depth = renderer.visible().iter().map(reach).fold(1.0, f64::max);
                    lines.pyramid(frozen, depth, Color32::RED);
                }
            }
            asked = Some(hud.show(ctx, &seen, kept));
        });
        let asked = asked.unwrap_or_default();
        if let Some(place) = asked.go_to {
            self.flown.rig.go_to(place);
        }
        if asked.budgets {
            self.reopen("opened with other budgets");
        }
        let delays = output.viewport_output.values().map(|v| v.repaint_delay);
        let repaint = delays.min().is_some_and(|d| d.is_zero());
        (output, repaint)
    }
}
