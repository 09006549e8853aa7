//! What the window shows besides the picture: figures, times of the last frames, sliders, the table of keys, questions and words.
//!
//! Drawn with egui by the window's thread, from values of the frame before.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use brickfell_pager::PagerStats;
use brickfell_runtime::caster::Feedback;
use brickfell_runtime::renderer::FrameReport;
use egui::{Color32, Context, Pos2, Rect, RichText, Slider, Ui, Vec2};
use glam::DVec3;

use super::keep::Kept;
use super::keys::{BINDINGS, MOUSE};
use crate::commands::view_args::parse_point;

/// Frames in the graph.
const FRAMES: usize = 120;
/// Height of all figures and sliders, where the window is as high.
const TALL: f32 = 560.0;
/// How long words stay.
const STAY: Duration = Duration::from_secs(6);
/// Stages of a frame and their colours in the graph.
const STAGES: [(&str, Color32); 5] = [
    ("cull, merge", Color32::from_rgb(120, 170, 255)),
    ("upload", Color32::from_rgb(255, 190, 90)),
    ("submit", Color32::from_rgb(190, 130, 230)),
    ("cast", Color32::from_rgb(120, 210, 120)),
    ("other", Color32::from_rgb(120, 120, 120)),
];

/// What a frame shows of itself.
pub(super) struct Seen<'a> {
    pub(super) report: &'a FrameReport,
    pub(super) feedback: &'a Feedback,
    pub(super) pager: PagerStats,
    pub(super) device: &'a str,
    pub(super) brick_slots: u32,
    pub(super) pixels: [u32; 2],
    pub(super) eye: DVec3,
    pub(super) height: Option<f64>,
    pub(super) mode: &'static str,
    pub(super) faults: &'a [String],
    pub(super) state: &'a str,
}

/// What the user asked for in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Asked {
    /// To go there.
    pub(super) go_to: Option<DVec3>,
    /// Budgets have changed: the renderer is to be opened anew.
    pub(super) budgets: bool,
}

/// The texts and graphs over the picture.
#[derive(Debug, Default)]
pub(super) struct Hud {
    pub(super) help: bool,
    /// What is typed where coordinates are asked for, while they are.
    pub(super) going: Option<String>,
    going_fault: Option<String>,
    words: Option<(String, Instant)>,
    frames: VecDeque<[f64; STAGES.len()]>,
    /// When the pager's and the uploads' counters were what.
    rates: VecDeque<(Instant, u64, u64)>,
    uploaded: u64,
}

impl Hud {
    /// Says something for a while.
    pub(super) fn say(&mut self, words: impl Into<String>) {
        self.words = Some((words.into(), Instant::now()));
    }

    /// Notes what a frame took, `whole_ms` from the one before.
    pub(super) fn note(
        &mut self,
        report: &FrameReport,
        feedback: &Feedback,
        pager: &PagerStats,
        whole_ms: f64,
    ) {
        let cast = feedback.gpu_ms[1];
        let parts = [
            report.cull_ms + report.merge_ms,
            report.upload_ms,
            // The CPU casts while it submits.
            if report.submit_ms > cast {
                report.submit_ms - cast
            } else {
                report.submit_ms
            },
            cast,
        ];
        let other = (whole_ms - parts.iter().sum::<f64>()).max(0.0);
        self.frames
            .push_back([parts[0], parts[1], parts[2], parts[3], other]);
        self.uploaded += report.bytes_uploaded;
        let now = Instant::now();
        self.rates.push_back((now, pager.bytes_read, self.uploaded));
        while self.frames.len() > FRAMES {
            self.frames.pop_front();
        }
        while self.rates.len() > 2 && now - self.rates[0].0 > Duration::from_secs(1) {
            self.rates.pop_front();
        }
    }

    /// Bytes read and uploaded in a second.
    fn rates(&self) -> [f64; 2] {
        let (Some(first), Some(last)) = (self.rates.front(), self.rates.back()) else {
            return [0.0; 2];
        };
        let seconds = (last.0 - first.0).as_secs_f64().max(1e-3);
        [last.1.saturating_sub(first.1), last.2.saturating_sub(first.2)].map(|bytes| bytes as f64 / seconds)
    }

    /// Lays everything out.
    pub(super) fn show(&mut self, ctx: &Context, seen: &Seen<'_>, kept: &mut Kept) -> Asked {
        let mut asked = Asked::default();
        if kept.hud {
            egui::Window::new("brickfell")
                .default_pos([10.0, 10.0])
                .default_width(270.0)
                .default_height(TALL)
                .resizable(false)
                .vscroll(true)
                .show(ctx, |ui| {
                    self.graph(ui);
                    self.figures(ui, seen, kept);
                    asked.budgets = sliders(ui, kept);
                });
        }
        if self.help {
            egui::Window::new("Keys")
                .default_pos([300.0, 10.0])
                .default_height(TALL)
                .vscroll(true)
                .show(ctx, |ui| {
                    egui::Grid::new("keys").striped(true).show(ui, |ui| {
                        let keys = BINDINGS.iter().map(|b| (b.label, b.about));
                        for (label, about) in keys.chain(MOUSE.iter().copied()) {
                            ui.strong(label);
                            ui.label(about);
                            ui.end_row();
                        }
                    });
                });
        }
        asked.go_to = self.going(ctx);
        let said = self.words.as_ref().filter(|(_, when)| when.elapsed() < STAY);
        let words = [said.map_or("", |(words, _)| words), seen.state];
        let words: Vec<&str> = words.into_iter().filter(|w| !w.is_empty()).collect();
        if !words.is_empty() {
            egui::Area::new(egui::Id::unique("words"))
                .anchor(egui::Align2::CENTER_BOTTOM, [0.0, -16.0])
                .show(ctx, |ui| {
                    egui::Frame::popup(ui.style())
                        .show(ui, |ui| ui.add(egui::Label::new(words.join("\n")).extend()));
                });
        }
        asked
    }

    fn going(&mut self, ctx: &Context) -> Option<DVec3> {
        let text = self.going.as_mut()?;
        let (mut go, mut close) = (None, false);
        egui::Window::new("Go to")
            .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
            .show(ctx, |ui| {
                ui.label("X,Y,Z in world metres");
                let field = ui.text_edit_singleline(text);
                field.request_focus();
                if let Some(fault) = &self.going_fault {
                    ui.colored_label(Color32::LIGHT_RED, fault);
                }
                if ui.input(|i| i.key_pressed(egui::Key::Enter)) {
                    match parse_point(text) {
                        Ok(point) => go = Some(point),
                        Err(fault) => self.going_fault = Some(fault),
                    }
                }
                close = ui.input(|i| i.key_pressed(egui::Key::Escape));
            });
        if go.is_some() || close {
            (self.going, self.going_fault) = (None, None);
        }
        go
    }

    fn graph(&self, ui: &mut Ui) {
        let (rect, _) = ui.allocate_exact_size(Vec2::new(250.0, 60.0), egui::Sense::hover());
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
        let most = self
            .frames
            .iter()
            .map(|f| f.iter().sum::<f64>())
            .fold(20.0, f64::max);
        let width = rect.width() / FRAMES as f32;
        for (k, frame) in self.frames.iter().enumerate() {
            let x = rect.left() + width * (FRAMES - self.frames.len() + k) as f32;
            let mut y = rect.bottom();
            for (part, (_, color)) in frame.iter().zip(STAGES) {
                let height = (part / most) as f32 * rect.height();
                let bar = Rect::from_min_max(Pos2::new(x, y - height), Pos2::new(x + width, y));
                painter.rect_filled(bar, 0.0, color);
                y -= height;
            }
        }
        let label = format!("{most:.0} ms");
        let corner = rect.left_top() + Vec2::new(3.0, 2.0);
        painter.text(
            corner,
            egui::Align2::LEFT_TOP,
            label,
            egui::FontId::proportional(10.0),
            Color32::WHITE,
        );
        ui.horizontal_wrapped(|ui| {
            for (name, color) in STAGES {
                ui.label(RichText::new(name).color(color).small());
            }
        });
    }

    fn figures(&self, ui: &mut Ui, seen: &Seen<'_>, kept: &Kept) {
        let [read, uploaded] = self.rates();
        let whole = self.frames.back().map_or(0.0, |f| f.iter().sum());
        let rays = f64::from(seen.pixels[0]) * f64::from(seen.pixels[1]) * seen.report.scale.powi(2);
        let cast = seen.feedback.gpu_ms[1].max(1e-3);
        let (p, r) = (&seen.pager, seen.report);
        let mega = |bytes: f64| format!("{:.1} MB", bytes * 1e-6);
        let height = seen.height.map_or("?".into(), |h| format!("{h:.1} m"));
        let rows = [
            (
                "frame",
                format!("{whole:.1} ms, {}×{}", seen.pixels[0], seen.pixels[1]),
            ),
            ("rays", format!("{:.2} M/s", rays / cast * 1e-3)),
            (
                "trees",
                format!("{} active of {} in view", r.trees_active, r.trees_visible),
            ),
            ("levels", format!("bias {:+.2}, scale {:.2}", r.bias, r.scale)),
            (
                "pool",
                format!(
                    "{} of {} bricks, {} of GPU",
                    r.bricks_resident,
                    seen.brick_slots,
                    mega(kept.gpu_bytes() as f64)
                ),
            ),
            (
                "RAM",
                format!(
                    "{} of {}",
                    mega(p.resident_bytes as f64),
                    mega(kept.ram_bytes() as f64)
                ),
            ),
            (
                "requests",
                format!(
                    "{} queued, {} loading, {} failed, {} to come",
                    p.queued, p.loading, p.failed, r.pending
                ),
            ),
            ("read, sent", format!("{}/s, {}/s", mega(read), mega(uploaded))),
            (
                "eye",
                format!("{:.1}, {:.1}, {:.1}", seen.eye.x, seen.eye.y, seen.eye.z),
            ),
            ("over ground", format!("{height}, {}", seen.mode)),
        ];
        egui::Grid::new("figures").show(ui, |ui| {
            for (name, value) in rows {
                ui.label(RichText::new(name).small());
                ui.label(RichText::new(value).small());
                ui.end_row();
            }
        });
        ui.label(RichText::new(seen.device).small());
        if let Some(fault) = seen.faults.last() {
            let text = format!("{} faults; last: {fault}", seen.faults.len());
            ui.label(RichText::new(text).small().color(Color32::LIGHT_RED));
        }
    }
}

/// The sliders; true if a budget was changed.
fn sliders(ui: &mut Ui, kept: &mut Kept) -> bool {
    ui.separator();
    ui.add(Slider::new(&mut kept.bias, -3.0..=4.0).text("bias"));
    ui.add(Slider::new(&mut kept.sun[0], 0.0..=360.0).text("sun azimuth"));
    ui.add(Slider::new(&mut kept.sun[1], 0.0..=90.0).text("sun elevation"));
    ui.add(
        Slider::new(&mut kept.range_km, 0.1..=1000.0)
            .logarithmic(true)
            .text("view range, km"),
    );
    ui.add(Slider::new(&mut kept.target_ms, 0.0..=200.0).text("frame target, ms"));
    ui.horizontal(|ui| {
        ui.checkbox(&mut kept.shadows, "shadows");
        ui.checkbox(&mut kept.occlusion, "occlusion");
    });
    let ram = ui.add(
        Slider::new(&mut kept.ram_mib, 64..=16384)
            .logarithmic(true)
            .text("RAM, MiB"),
    );
    let gpu = ui.add(
        Slider::new(&mut kept.gpu_mib, 32..=16384)
            .logarithmic(true)
            .text("GPU, MiB"),
    );
    [ram, gpu]
        .iter()
        .any(|slider| slider.drag_stopped() || slider.lost_focus())
}
