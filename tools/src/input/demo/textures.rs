//! Pictures for the demo's models: a leaf atlas with cut-out alpha, bark, a wall with a window, roof tiles.

use glam::DVec2;
use image::{Rgba, RgbaImage};

use crate::noise::{Random, cell, fractal, noise, smoothstep};

/// Side of a quadrant of the leaf atlas, texels.
const QUADRANT: f64 = 128.0;

/// The four pictures of the leaf atlas, as (column, row) from the lower left.
#[derive(Debug, Clone, Copy)]
pub(super) enum Leaves {
    Broad = 0,
    Needles = 1,
    Light = 2,
    Bush = 3,
}

impl Leaves {
    /// Texture coordinates of the lower left corner; a quadrant is ½ wide.
    pub(super) fn corner(self) -> [f64; 2] {
        let i = self as u32;
        [f64::from(i % 2) * 0.5, f64::from(i / 2) * 0.5]
    }
}

fn put(image: &mut RgbaImage, x: f64, y: f64, color: [f64; 3]) {
    let (w, h) = image.dimensions();
    if x >= 0.0 && y >= 0.0 && x < f64::from(w) && y < f64::from(h) {
        let byte = |v: f64| (v * 255.0).clamp(0.0, 255.0) as u8;
        image.put_pixel(
            x as u32,
            y as u32,
            Rgba([byte(color[0]), byte(color[1]), byte(color[2]), 255]),
        );
    }
}

/// One leaf: an ellipse with a lighter rib, inside the box from `low` to `high`.
fn leaf(image: &mut RgbaImage, at: DVec2, axis: DVec2, width: f64, color: [f64; 3], bounds: (DVec2, DVec2)) {
    let reach = axis.length().max(width).ceil() as i32;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let d = DVec2::new(f64::from(dx), f64::from(dy));
            let along = d.dot(axis) / axis.length_squared();
            let across = d.dot(axis.perp()) / axis.length() / width;
            let p = (at + d).floor();
            let inside = p.cmpge(bounds.0).all() && p.cmplt(bounds.1).all();
            if inside && along * along + across * across < 1.0 {
                let rib = if across.abs() < 0.22 { 1.18 } else { 1.0 };
                let shade = rib * (0.88 + 0.14 * across);
                put(image, p.x, p.y, color.map(|v| v * shade));
            }
        }
    }
}

/// Leaf clusters on a transparent ground, four to a picture.
pub(super) fn leaves(seed: u64) -> RgbaImage {
    let mut image = RgbaImage::new(2 * QUADRANT as u32, 2 * QUADRANT as u32);
    let mut random = Random::new(seed ^ 0x1eaf);
    for kind in [Leaves::Broad, Leaves::Needles, Leaves::Light, Leaves::Bush] {
        let [u, v] = kind.corner();
        let low = DVec2::new(u * 2.0 * QUADRANT, (0.5 - v) * 2.0 * QUADRANT);
        let bounds = (low + 2.0, low + QUADRANT - 2.0);
        let middle = low + QUADRANT * 0.5;
        match kind {
            Leaves::Needles => needles(&mut image, low, bounds, &mut random),
            Leaves::Broad => cluster(
                &mut image,
                middle,
                210,
                (8.0, 4.6),
                [0.25, 0.40, 0.13],
                bounds,
                &mut random,
            ),
            Leaves::Light => cluster(
                &mut image,
                middle,
                190,
                (6.5, 3.8),
                [0.44, 0.52, 0.19],
                bounds,
                &mut random,
            ),
            Leaves::Bush => cluster(
                &mut image,
                middle,
                230,
                (7.0, 4.6),
                [0.31, 0.39, 0.18],
                bounds,
                &mut random,
            ),
        }
    }
    image
}

fn cluster(
    image: &mut RgbaImage,
    middle: DVec2,
    count: u32,
    size: (f64, f64),
    color: [f64; 3],
    bounds: (DVec2, DVec2),
    random: &mut Random,
) {
    for i in 0..count {
        let ring = (f64::from(i) / f64::from(count)).powf(1.3);
        let out = DVec2::from_angle(random.between(0.0, std::f64::consts::TAU));
        // From the rim inwards, so that inner leaves lie on top.
        let at = middle + out * (1.0 - ring * 0.95) * random.between(0.7, 1.0) * QUADRANT * 0.47;
        let direction = DVec2::from_angle(random.between(0.0, std::f64::consts::TAU)) + out * 0.5;
        let scale = random.between(0.75, 1.2);
        let tone = random.between(0.62, 1.12) * (0.75 + 0.35 * ring);
        let yellow = random.between(0.9, 1.2);
        let color = [color[0] * tone * yellow, color[1] * tone, color[2] * tone];
        leaf(
            image,
            at,
            direction.normalize_or(DVec2::X) * size.0 * scale,
            size.1 * scale,
            color,
            bounds,
        );
    }
}

/// A bough of a conifer: stem along u, needles to both sides, wide at the stem's foot (u = 0) and pointed at u = ½.
fn needles(image: &mut RgbaImage, low: DVec2, bounds: (DVec2, DVec2), random: &mut Random) {
    let middle = low.y + QUADRANT * 0.5;
    for i in 0..260 {
        let t = f64::from(i) / 260.0;
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let spread = (1.0 - t).powf(0.7) * QUADRANT * 0.44 + 4.0;
        let reach = random.between(0.1, 1.0) * spread;
        let at = DVec2::new(
            low.x + 4.0 + t * (QUADRANT - 14.0) + reach * 0.25,
            middle + side * reach,
        );
        let tone = random.between(0.6, 1.15) * (0.8 + 0.4 * reach / QUADRANT);
        let color = [0.15 * tone, 0.27 * tone, 0.15 * tone];
        leaf(image, at, DVec2::new(0.75, side * 0.6) * 8.5, 2.7, color, bounds);
    }
    for x in 2..(QUADRANT as u32 - 6) {
        for y in -1..=1 {
            put(
                image,
                low.x + f64::from(x),
                middle + f64::from(y),
                [0.27, 0.20, 0.13],
            );
        }
    }
}

/// Bark: ridges along v; repeats in both directions.
pub(super) fn bark(seed: u64) -> RgbaImage {
    let (w, h) = (64u32, 128u32);
    RgbaImage::from_fn(w, h, |x, y| {
        let angle = f64::from(x) / f64::from(w) * std::f64::consts::TAU;
        let turn = f64::from(y) / f64::from(h) * std::f64::consts::TAU;
        // Circles in noise space close on themselves: no seams.
        let round = DVec2::from_angle(angle) * 2.2 + DVec2::from_angle(turn) * 0.5;
        let ridges = fractal(seed ^ 71, round * 1.6, 3);
        let grain = cell(seed ^ 72, i64::from(x), i64::from(y)) - 0.5;
        let tone = 0.75 + 0.45 * ridges + 0.16 * grain;
        let byte = |v: f64| (v * tone * 255.0).clamp(0.0, 255.0) as u8;
        Rgba([byte(0.42), byte(0.33), byte(0.24), 255])
    })
}

/// One bay of a wall, 3 m × 3 m: brick, a window with frame, cross-bar, sill and shutters.
pub(super) fn wall(seed: u64) -> RgbaImage {
    let side = 192u32;
    let metre = f64::from(side) / 3.0;
    RgbaImage::from_fn(side, side, |px, py| {
        let (x, y) = (f64::from(px) / metre, f64::from(side - 1 - py) / metre);
        let grain = cell(seed ^ 81, i64::from(px), i64::from(py)) - 0.5;
        let from_middle = DVec2::new((x - 1.5).abs(), (y - 1.6).abs());
        let in_box = |half_x: f64, half_y: f64| from_middle.x < half_x && from_middle.y < half_y;
        let color = if in_box(0.5, 0.68) {
            let bar = from_middle.x < 0.05 || (y - 1.75).abs() < 0.045;
            let gloss = 0.5 + 0.5 * noise(seed ^ 82, DVec2::new(x * 2.0 + y, y * 2.0));
            if bar {
                [0.90, 0.89, 0.85]
            } else {
                [0.12 + 0.10 * gloss, 0.17 + 0.13 * gloss, 0.23 + 0.16 * gloss]
            }
        } else if in_box(0.58, 0.76) {
            [0.92, 0.90, 0.86]
        } else if in_box(0.95, 0.70) {
            let slat = if (y * 14.0).fract() < 0.3 { 0.72 } else { 1.0 };
            [0.22 * slat, 0.36 * slat, 0.30 * slat]
        } else if (y - 0.80).abs() < 0.06 && from_middle.x < 0.75 {
            [0.70, 0.68, 0.64]
        } else if y < 0.22 {
            let tone = 0.47 + 0.1 * fractal(seed ^ 83, DVec2::new(x * 5.0, y * 8.0), 2);
            [tone, tone * 0.98, tone * 0.94]
        } else {
            brick(seed, x, y)
        };
        let byte = |v: f64| ((v * (1.0 + 0.10 * grain)) * 255.0).clamp(0.0, 255.0) as u8;
        Rgba([byte(color[0]), byte(color[1]), byte(color[2]), 255])
    })
}

/// Bricks of 0.25 m × 0.125 m, whole numbers of them to a bay.
fn brick(seed: u64, x: f64, y: f64) -> [f64; 3] {
    let row = (y / 0.125).floor();
    let along = x / 0.25 + if row as i64 % 2 == 0 { 0.5 } else { 0.0 };
    let mortar = (along.fract() - 0.5).abs() > 0.46 || ((y / 0.125).fract() - 0.5).abs() > 0.42;
    if mortar {
        return [0.74, 0.71, 0.66];
    }
    let tone = 0.85 + 0.3 * cell(seed ^ 84, along.floor() as i64 % 12, row as i64);
    [0.78 * tone, 0.70 * tone, 0.60 * tone]
}

/// Roof tiles, 2 m × 2 m: eight courses, each shading the one below.
pub(super) fn roof(seed: u64) -> RgbaImage {
    let side = 128u32;
    RgbaImage::from_fn(side, side, |px, py| {
        let (x, y) = (
            f64::from(px) / f64::from(side) * 8.0,
            f64::from(side - 1 - py) / f64::from(side) * 8.0,
        );
        let course = y.floor();
        let across = x + if course as i64 % 2 == 0 { 0.5 } else { 0.0 };
        let tone = 0.72 + 0.36 * cell(seed ^ 91, across.floor() as i64 % 8, course as i64);
        let rounded = 1.0 - 0.35 * (2.0 * across.fract() - 1.0).powi(2);
        let lap = 0.62 + 0.38 * smoothstep(0.0, 0.3, 1.0 - y.fract()) * smoothstep(-0.1, 0.25, y.fract());
        let moss = smoothstep(0.25, 0.7, noise(seed ^ 92, DVec2::new(x * 0.7, y * 0.7))) * 0.35;
        let grain = 1.0 + 0.12 * (cell(seed ^ 93, i64::from(px), i64::from(py)) - 0.5);
        let light = tone * rounded * lap * grain;
        let byte = |v: f64, green: f64| ((v + (green - v) * moss) * light * 255.0).clamp(0.0, 255.0) as u8;
        Rgba([byte(0.66, 0.36), byte(0.33, 0.37), byte(0.23, 0.22), 255])
    })
}
