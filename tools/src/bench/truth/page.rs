//! The page of suite `truth`: plot, pictures and tables in one HTML file that needs nothing else.

use std::fmt::Write;
use std::io;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::{Entry, Shown, plot};
use crate::metrics::heat;
use crate::picture_file::Image;

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1180px;margin:2em auto;padding:0 1em}\
    table{border-collapse:collapse;margin:1em 0;font-size:13px}td,th{padding:3px 9px;text-align:right;border-bottom:1px solid #ddd}\
    td:nth-child(-n+4),th:nth-child(-n+4){text-align:left}tr.front td{background:#fff0ee}\
    figure{display:inline-block;margin:0 8px 12px 0}figcaption{font-size:12px;color:#555}\
    img{image-rendering:pixelated;width:340px;display:block}svg{max-width:100%;height:auto}";

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// A picture inside the page.
fn figure(image: &Image, caption: &str) -> io::Result<String> {
    let mut png = Vec::new();
    image.write(&mut png)?;
    Ok(format!(
        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>\n",
        STANDARD.encode(png)
    ))
}

fn table(entries: &[Entry]) -> String {
    let mut html = String::from(
        "<table><tr><th>scene<th>view<th>setting<th>backend<th>size<th>ms<th>Mpx/s<th>MB in pools<th>PSNR dB<th>sRGB dB<th>inside dB\
         <th>FLIP<th>worst<th>&gt; 2/255 %<th>holes<th>least alpha<th>thick<th>noise dB<th>nodes/ray<th>samples/ray</tr>\n",
    );
    let fronts: Vec<(&Entry, bool)> = (plot::scenes(entries).iter())
        .flat_map(|scene| plot::front(entries, scene))
        .collect();
    for e in entries {
        let on_front = fronts.iter().any(|(other, on)| *on && std::ptr::eq(*other, e));
        let alpha = e.alpha_min_where_opaque.map_or("–".into(), |a| format!("{a:.4}"));
        let inside = e.psnr_inside_db.map_or("–".into(), |db| format!("{db:.2}"));
        // Writing to a String cannot fail.
        let _ = writeln!(
            html,
            "<tr{}><td>{}<td>{}<td>{}<td>{}<td>{}×{}<td>{:.1}<td>{:.3}<td>{:.1}<td>{:.2}<td>{:.2}<td>{inside}<td>{:.4}<td>{}<td>{:.2}\
             <td>{}<td>{alpha}<td>{}<td>{:.1}<td>{:.1}<td>{:.1}</tr>",
            if on_front { " class=front" } else { "" },
            escaped(&e.scene),
            escaped(&e.view),
            escaped(&e.setting),
            escaped(&e.backend),
            e.width,
            e.height,
            e.ms_median,
            e.mpx_per_second,
            e.bytes as f64 * 1e-6,
            e.psnr_db,
            e.psnr_srgb_db,
            e.flip,
            e.worst,
            e.percent_over_2,
            e.holes,
            e.thick,
            e.truth_floor_db,
            e.nodes_per_ray,
            e.samples_per_ray,
        );
    }
    html + "</table>\n"
}

/// The page.
pub(super) fn html(entries: &[Entry], shown: &[Shown], plot: &str) -> io::Result<String> {
    let mut html = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>brickfell: time against error</title><style>{STYLE}</style>\n\
         <h1>Time against error</h1>\n<p>Settled pictures of the ray caster against the truth: many rays a pixel through the input \
         that the databases were built from. PSNR in linear light over the sky, at most 99 dB; FLIP at 67 pixels per degree; \
         <i>noise</i>: the PSNR that the truth's own noise would give; <i>least alpha</i>: where the truth is opaque all around. \
         The front (red): no other setting is both faster and closer.</p>\n{plot}\n{}<h2>Pictures</h2>\n",
        table(entries)
    );
    for s in shown {
        let _ = write!(
            html,
            "<h3>{}, {}</h3>\n<div>",
            escaped(&s.scene),
            escaped(&s.view)
        );
        html += &figure(&Image::from(&s.picture), "brickfell")?;
        html += &figure(&Image::from(&s.truth), "truth")?;
        let difference = Image {
            width: s.picture.width,
            height: s.picture.height,
            rgb: s.flip.iter().copied().flat_map(heat).collect(),
        };
        html += &figure(&difference, "FLIP")?;
        html += "</div>\n";
    }
    Ok(html + "</html>\n")
}
