//! What is open while the window is: device, surface, renderer, camera; what events do to them, and a frame.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use brickfell_culler::{Camera, VisibleTree};
use brickfell_pager::Store;
use brickfell_runtime::Device;
use brickfell_runtime::error::RuntimeError;
use brickfell_runtime::gpu::Gpu;
use brickfell_runtime::present::Presenter;
use brickfell_runtime::renderer::{FrameReport, Renderer, RendererConfig};
use brickfell_runtime::settings::{RenderSettings, Shows, sun_direction};
use brickfell_runtime::terrain::{SCENE_FILE, Terrain};
use brickfell_runtime::window::WindowSurface;
use egui::Color32;
use glam::{DVec2, DVec3, dvec2};
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Fullscreen, Window};

use super::Woken;
use super::hud::{Hud, Seen};
use super::keep::Kept;
use super::keys::{Action, action};
use super::overlay::Lines;
use super::probe::{Answer, Probe, Question};
use super::rig::{Rig, Wish};
use super::tape::Tape;
use crate::commands::fly::{data_bounds, no_tree};
use crate::commands::view::Args;
use crate::commands::{CommandError, open_terrain};
use crate::flight::Flight;
use crate::picture_file::over_sky;

/// Vertical radians that the picture turns when the mouse is dragged over all of its height.
const DRAG: f64 = 1.6;
/// Time and pixels between the clicks of a double-click.
const CLICK: (Duration, f64) = (Duration::from_millis(400), 5.0);
/// How often a scene is looked at for changes.
const WATCH: Duration = Duration::from_millis(500);
/// Frames in a row without anything to load or to move after which the window rests.
const QUIET: u32 = 8;

/// A terrain that is flown over.
struct Scene {
    store: Arc<dyn Store>,
    renderer: Renderer,
    probe: Probe,
    /// When the scene file was written, and when that was looked at.
    written: Option<SystemTime>,
    looked: Instant,
}

/// The mouse over the picture.
#[derive(Default)]
struct Mouse {
    at: DVec2,
    dragging: bool,
    /// Moved since the last frame while dragging, pixels.
    moved: DVec2,
    wheel: f64,
    clicked: Option<(Instant, DVec2)>,
}

/// Everything that is open.
pub(super) struct Live {
    pub(super) window: Arc<Window>,
    pub(super) kept: Kept,
    args: Args,
    wake: EventLoopProxy<Woken>,
    gpu: Arc<Gpu>,
    device: Device,
    surface: WindowSurface,
    presenter: Presenter,
    input: egui_winit::State,
    painter: egui_wgpu::Renderer,
    scene: Scene,
    flown: Flown,
}

/// What outlasts a device: where the camera is and what was asked for.
struct Flown {
    rig: Rig,
    hud: Hud,
    tape: Tape,
    down: HashSet<KeyCode>,
    mouse: Mouse,
    shows: Shows,
    boxes: bool,
    frozen: Option<Camera>,
    shot: bool,
    quiet: u32,
    last: Instant,
    camera: Option<Camera>,
    report: FrameReport,
}

fn written(args: &Args) -> Option<SystemTime> {
    std::fs::metadata(args.dir.join(SCENE_FILE)).ok()?.modified().ok()
}

fn open_scene(
    args: &Args,
    kept: &Kept,
    device: &Device,
    wake: &EventLoopProxy<Woken>,
) -> Result<Scene, CommandError> {
    let written = written(args);
    let (store, terrain) = open_terrain(&args.dir)?;
    let scene = terrain.scene.clone();
    let top = terrain.graph.bounds().map_or(0.0, |b| b.max.z);
    let renderer = open_renderer(&store, terrain, kept, device)?;
    let wake = wake.clone();
    let probe = Probe::new(Arc::clone(&store), scene, top, move || {
        // A window that is gone needs no answer.
        let _ = wake.send_event(Woken);
    });
    Ok(Scene {
        store,
        renderer,
        probe,
        written,
        looked: Instant::now(),
    })
}

fn open_renderer(
    store: &Arc<dyn Store>,
    terrain: Terrain,
    kept: &Kept,
    device: &Device,
) -> Result<Renderer, RuntimeError> {
    let config = RendererConfig {
        ram_budget: kept.ram_bytes(),
        gpu_budget: kept.gpu_bytes(),
        ..RendererConfig::default()
    };
    Renderer::new(device.clone(), Arc::clone(store), terrain, config)
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
        let (gpu, mut surface) = Gpu::open_window(Arc::clone(&window))?;
        surface.resize(window.inner_size().into());
        let device = if args.cpu || (gpu.is_software() && !args.gpu) {
            if !args.cpu {
                eprintln!(
                    "note: {} is software; the CPU draws (--gpu: it does not)",
                    gpu.info.name
                );
            }
            Device::Cpu
        } else {
            Arc::clone(&gpu).into()
        };
        let scene = open_scene(args, &kept, &device, &wake)?;
        let flown = match flown {
            Some(flown) => flown,
            None => Flown::new(args, &scene)?,
        };
        let format = surface.format();
        Ok(Self {
            input: egui_winit::State::new(
                egui::Context::default(),
                egui::ViewportId::ROOT,
                &window,
                Some(window.scale_factor() as f32),
                window.theme(),
                Some(gpu.device.limits().max_texture_dimension_2d as usize),
            ),
            painter: egui_wgpu::Renderer::new(&gpu.device, format, egui_wgpu::RendererOptions::default()),
            presenter: Presenter::new(&gpu, format),
            args: args.clone(),
            window,
            kept,
            wake,
            gpu,
            device,
            surface,
            scene,
            flown,
        })
    }

    /// What outlasts a device; all that is on it goes, so that another surface may have the window.
    fn into_parts(self) -> (Arc<Window>, Flown) {
        (self.window, self.flown)
    }

    /// Takes an event; true if the window is to be closed.
    pub(super) fn handle(&mut self, event: &WindowEvent) -> bool {
        let taken = self.input.on_window_event(&self.window, event);
        if taken.repaint {
            self.window.request_redraw();
        }
        let is_typing = self.flown.hud.going.is_some() || self.input.egui_ctx().text_edit_focused();
        let mouse = &mut self.flown.mouse;
        match event {
            WindowEvent::Resized(size) => {
                self.surface.resize((*size).into());
                if size.width > 0 && size.height > 0 && self.window.fullscreen().is_none() {
                    self.kept.size = (*size).into();
                }
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
                        self.window.request_redraw();
                        return self.act(action);
                    }
                    _ => {}
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                let at = dvec2(position.x, position.y);
                if mouse.dragging {
                    mouse.moved += at - mouse.at;
                    self.window.request_redraw();
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
                self.window.request_redraw();
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
                let is_full = self.window.fullscreen().is_some();
                self.window
                    .set_fullscreen((!is_full).then_some(Fullscreen::Borderless(None)));
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
        let size: [u32; 2] = self.window.inner_size().into();
        if size.contains(&0) {
            return Ok(false);
        }
        self.surface.resize(size);
        self.watch();
        let now = Instant::now();
        let dt = (now - std::mem::replace(&mut self.flown.last, now)).as_secs_f64();
        let camera = self.move_camera(dt, size);
        let settings = self.settings();
        // Once more if the surface was out of date.
        let texture = match self.surface.acquire(&self.gpu)? {
            None => self.surface.acquire(&self.gpu)?,
            some => some,
        };
        let Some(texture) = texture else {
            return Ok(false);
        };
        let renderer = &mut self.scene.renderer;
        renderer.cull_from(self.flown.frozen);
        let report = renderer.frame(&camera, &settings)?;
        let (shapes, repaint) = self.lay_out(&camera, size);
        self.paint(&texture, size, &camera, shapes);
        self.window.pre_present_notify();
        self.gpu.queue.present(texture);
        self.gpu.check()?;

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

    /// Opens a scene whose file has changed; the old one stays where the new one is not sound.
    fn watch(&mut self) {
        if self.scene.looked.elapsed() < WATCH {
            return;
        }
        self.scene.looked = Instant::now();
        let written = written(&self.args);
        if written == self.scene.written || written.is_none() {
            return;
        }
        self.scene.written = written;
        self.reopen("the scene has changed");
    }

    fn reopen(&mut self, why: &str) {
        self.flown.quiet = 0;
        match open_scene(&self.args, &self.kept, &self.device, &self.wake) {
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
        let input = self.input.take_egui_input(&self.window);
        let ctx = self.input.egui_ctx().clone();
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
        let output = ctx.run_ui(input, |ui| {
            let ctx = ui.ctx().clone();
            if flown.boxes || flown.frozen.is_some() {
                let lines = Lines::new(&ctx, camera);
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
            asked = Some(hud.show(&ctx, &seen, kept));
        });
        self.input
            .handle_platform_output(&self.window, output.platform_output.clone());
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

    /// The picture, and what was laid out over it.
    fn paint(
        &mut self,
        texture: &wgpu::SurfaceTexture,
        size: [u32; 2],
        camera: &Camera,
        mut output: egui::FullOutput,
    ) {
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let ctx = self.input.egui_ctx();
        let jobs = ctx.tessellate(output.shapes, output.pixels_per_point);
        for (id, deltas) in &output.textures_delta.set {
            for delta in deltas {
                self.painter.update_texture(device, queue, *id, delta);
            }
        }
        let screen = egui_wgpu::ScreenDescriptor {
            size_in_pixels: size,
            pixels_per_point: output.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&Default::default());
        let more = (self.painter).update_buffers(device, queue, &mut encoder, &jobs, &screen);
        let view = texture.texture.create_view(&Default::default());
        if let Some(picture) = self.scene.renderer.output() {
            (self.presenter).draw(&self.gpu, &mut encoder, (&view, size), picture, camera);
        }
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("figures"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Load,
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            self.painter.render(&mut pass.forget_lifetime(), &jobs, &screen);
        }
        queue.submit(more.into_iter().chain([encoder.finish()]));
        for id in &output.textures_delta.free {
            self.painter.free_texture(id);
        }
        output.textures_delta.clear();
    }
}

impl Flown {
    fn new(args: &Args, scene: &Scene) -> Result<Self, CommandError> {
        let path = args.path.as_deref().map(Flight::load).transpose()?;
        let terrain = scene.renderer.terrain();
        let bounds = data_bounds(scene.store.as_ref(), &terrain.trees).or(terrain.graph.bounds());
        let orbit = Flight::orbit(&bounds.ok_or_else(|| no_tree(&args.dir))?, 1.0);
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
    fn first(width: u32, height: u32) -> Camera {
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
