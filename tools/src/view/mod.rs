//! The window of `brickfell view`: the same frames as `fly`, flown by keys and mouse.
//!
//! | module | what |
//! |---|---|
//! | `live` | what is open: a frame, and what events do |
//! | `flown` | where the camera is, what was asked for |
//! | `screen` | the window, its device, and what is painted |
//! | `scene` | the terrain, its renderer and probe |
//! | `rig` | how the camera moves |
//! | `keys` | what keys do |
//! | `hud`, `overlay` | figures, sliders and help; lines over the picture |
//! | `probe` | where the ground is, found by a thread of its own |
//! | `tape` | camera paths that are recorded and flown |
//! | `keep` | settings from one run to the next |
//!
//! All of it on the thread of the event loop, which must be the program's first, but for the probe.

mod flown;
mod hud;
mod keep;
mod keys;
mod live;
mod overlay;
mod probe;
mod rig;
mod scene;
mod screen;
mod tape;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::WindowId;

use crate::commands::CommandError;
use crate::commands::say::note;
use crate::commands::view::Args;
use keep::Kept;
use live::Live;

/// Losses of the device or the window's surface within [`LOSS_SPAN`] after which it is given up.
const LOSSES: usize = 3;
/// See [`LOSSES`].
const LOSS_SPAN: Duration = Duration::from_secs(30);
/// How often a window in which nothing moves looks for what has changed.
const IDLE: Duration = Duration::from_millis(200);

/// Something that happened outside of the window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Woken;

/// The program's state around the window.
struct App<'a> {
    args: &'a Args,
    kept: Kept,
    live: Option<Live>,
    losses: Vec<Instant>,
    wake: winit::event_loop::EventLoopProxy<Woken>,
    end: Result<(), CommandError>,
}

/// Opens the window and runs until it is closed.
///
/// # Errors
/// If there is no display, no device, or no terrain; if the device is lost again and again.
pub fn run(args: &Args) -> Result<(), CommandError> {
    let no_display = |e: &dyn std::fmt::Display| {
        CommandError::new(
            format!("no window can be opened: {e}"),
            "a display is needed; without one `brickfell fly` and `brickfell render` draw to files",
        )
    };
    let event_loop = EventLoop::<Woken>::with_user_event()
        .build()
        .map_err(|e| no_display(&e))?;
    let mut app = App {
        args,
        kept: Kept::load().with(args),
        live: None,
        losses: Vec::new(),
        wake: event_loop.create_proxy(),
        end: Ok(()),
    };
    event_loop.run_app(&mut app).map_err(|e| no_display(&e))?;
    if let Some(live) = app.live.take() {
        app.kept = live.kept;
    }
    if let Err(e) = app.kept.save() {
        note(format_args!("the window's settings are not kept: {e}"));
    }
    app.end
}

impl App<'_> {
    /// Opens everything, again after a loss.
    fn open(&mut self, event_loop: &ActiveEventLoop) {
        let before = self.live.take();
        match Live::open(
            event_loop,
            self.args,
            self.kept.clone(),
            self.wake.clone(),
            before,
        ) {
            Ok(live) => self.live = Some(live),
            Err(e) => self.finish(event_loop, Err(e)),
        }
    }

    fn finish(&mut self, event_loop: &ActiveEventLoop, end: Result<(), CommandError>) {
        self.end = end;
        event_loop.exit();
    }
}

impl ApplicationHandler<Woken> for App<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.live.is_none() {
            self.open(event_loop);
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, _: Woken) {
        if let Some(live) = &self.live {
            live.wake();
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(live) = &mut self.live else { return };
        if event == WindowEvent::CloseRequested || live.handle(&event) {
            event_loop.exit();
            return;
        }
        if event != WindowEvent::RedrawRequested {
            return;
        }
        match live.frame() {
            Ok(true) => {
                live.wake();
                event_loop.set_control_flow(ControlFlow::Wait);
            }
            Ok(false) => event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + IDLE)),
            Err(e) => {
                let now = Instant::now();
                self.losses.retain(|at| now - *at < LOSS_SPAN);
                self.losses.push(now);
                self.kept = live.kept.clone();
                if self.losses.len() > LOSSES {
                    self.finish(event_loop, Err(e.into()));
                } else {
                    note(format_args!("{e}; opening the device again"));
                    self.open(event_loop);
                }
            }
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let is_due = matches!(event_loop.control_flow(), ControlFlow::WaitUntil(at) if at <= Instant::now());
        if let Some(live) = self.live.as_ref().filter(|_| is_due) {
            live.wake();
        }
    }
}

/// The first file of a numbered row that is not there yet: `stem-0001.ending`.
fn free_file(folder: &std::path::Path, stem: &str, ending: &str) -> PathBuf {
    (1..)
        .map(|k| folder.join(format!("{stem}-{k:04}.{ending}")))
        .find(|file| !file.exists())
        .unwrap_or_default()
}
