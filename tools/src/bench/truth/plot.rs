//! The plot of suite `truth`: time against error, a panel a scene, with the front drawn.
//!
//! The front is what nothing beats in both: no other setting is as fast and as right. Pictures of other sizes are left out, the
//! truth of another size is another task.

use plotters::prelude::*;

use super::Entry;
use crate::commands::CommandError;

const PANEL: (u32, u32) = (560, 440);
const FONT: &str = "sans-serif";

/// The entries of a scene's swept view that compete, and whether each is on the front.
pub(super) fn front<'a>(entries: &'a [Entry], scene: &str) -> Vec<(&'a Entry, bool)> {
    let of_scene = || entries.iter().filter(|e| e.scene == scene);
    // The swept view's rows are the last ones.
    let Some(last) = of_scene().next_back() else {
        return Vec::new();
    };
    let all: Vec<&Entry> = of_scene()
        .filter(|e| e.view == last.view && e.width == last.width && e.backend == last.backend)
        .collect();
    let beaten = |e: &Entry| {
        all.iter().any(|o| {
            o.ms_median <= e.ms_median
                && o.psnr_db >= e.psnr_db
                && (o.ms_median < e.ms_median || o.psnr_db > e.psnr_db)
        })
    };
    let mut all: Vec<(&Entry, bool)> = all.iter().map(|e| (*e, !beaten(e))).collect();
    all.sort_by(|a, b| a.0.ms_median.total_cmp(&b.0.ms_median));
    all
}

/// Scenes in their order.
pub(super) fn scenes(entries: &[Entry]) -> Vec<&str> {
    let mut names: Vec<&str> = entries.iter().map(|e| e.scene.as_str()).collect();
    names.dedup();
    names
}

/// The plot as SVG.
pub(super) fn svg(entries: &[Entry]) -> Result<String, CommandError> {
    let scenes = scenes(entries);
    let mut svg = String::new();
    draw(entries, &scenes, &mut svg).map_err(|e| {
        CommandError::new(
            format!("the plot cannot be drawn: {e}"),
            "the figures are in bench.csv",
        )
    })?;
    Ok(svg)
}

fn draw(entries: &[Entry], scenes: &[&str], svg: &mut String) -> Result<(), Box<dyn std::error::Error>> {
    let size = (PANEL.0 * scenes.len().max(1) as u32, PANEL.1);
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    root.fill(&WHITE).map_err(|e| e.to_string())?;
    for (panel, scene) in root.split_evenly((1, scenes.len().max(1))).iter().zip(scenes) {
        let points = front(entries, scene);
        let range = |value: &dyn Fn(&Entry) -> f64| {
            let values = || points.iter().map(|(e, _)| value(e));
            (
                values().fold(f64::INFINITY, f64::min),
                values().fold(f64::NEG_INFINITY, f64::max),
            )
        };
        let (fast, slow) = range(&|e| e.ms_median);
        let (worst, best) = range(&|e| e.psnr_db);
        let mut chart = ChartBuilder::on(panel)
            .caption(*scene, (FONT, 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.9 * fast..1.25 * slow, worst - 0.6..best + 0.6)
            .map_err(|e| e.to_string())?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("time of a picture, ms (median)")
            .y_desc("PSNR against the truth, dB")
            .label_style((FONT, 12))
            .draw()
            .map_err(|e| e.to_string())?;
        let best = points
            .iter()
            .filter(|p| p.1)
            .map(|(e, _)| (e.ms_median, e.psnr_db));
        chart
            .draw_series(LineSeries::new(best, RED.stroke_width(2)))
            .map_err(|e| e.to_string())?;
        for (entry, on_front) in &points {
            let at = (entry.ms_median, entry.psnr_db);
            let color = if *on_front { RED } else { BLACK };
            let size = if entry.setting == "default" { 6 } else { 3 };
            chart
                .draw_series([Circle::new(at, size, color.filled())])
                .map_err(|e| e.to_string())?;
            let label = EmptyElement::at(at) + Text::new(entry.setting.clone(), (7, -5), (FONT, 11));
            chart.draw_series([label]).map_err(|e| e.to_string())?;
        }
    }
    root.present().map_err(|e| e.to_string())?;
    Ok(())
}
