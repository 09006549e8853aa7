//! The aerial picture of the demo ground: what grows or lies where, by height, steepness and water.

use glam::DVec2;
use image::{Rgb, RgbImage};
use rayon::prelude::*;

use super::terrain::{Ground, Terrain};
use crate::noise::{fractal, noise, smoothstep};

/// sRGB 0..1.
type Color = [f64; 3];

const GRASS: Color = [0.36, 0.44, 0.19];
const MEADOW: Color = [0.47, 0.51, 0.25];
const DRY: Color = [0.57, 0.53, 0.33];
const FOREST_FLOOR: Color = [0.24, 0.27, 0.13];
const ROCK: Color = [0.47, 0.44, 0.40];
const ROCK_WARM: Color = [0.55, 0.47, 0.38];
const ROCK_DARK: Color = [0.29, 0.28, 0.27];
const SCREE: Color = [0.53, 0.50, 0.45];
const SAND: Color = [0.76, 0.69, 0.51];
const WET_SAND: Color = [0.52, 0.46, 0.34];
const SHALLOW: Color = [0.26, 0.44, 0.42];
const DEEP: Color = [0.07, 0.17, 0.24];
const SNOW: Color = [0.93, 0.95, 0.98];
const DIRT: Color = [0.62, 0.53, 0.40];
const RUT: Color = [0.49, 0.41, 0.31];
const YARD: Color = [0.55, 0.51, 0.40];

fn mix(a: Color, b: Color, t: f64) -> Color {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t.clamp(0.0, 1.0))
}

/// Paints `pixels × pixels` over the terrain, row 0 in the north.
pub(super) fn imagery(terrain: &Terrain, pixels: u32) -> RgbImage {
    let step = terrain.size / f64::from(pixels);
    let n = pixels as usize;
    let at = |column: usize, row: usize| {
        DVec2::new(
            (column as f64 + 0.5) * step,
            terrain.size - (row as f64 + 0.5) * step,
        )
    };
    let grounds: Vec<Ground> = (0..n * n)
        .into_par_iter()
        .map(|i| terrain.ground(at(i % n, i / n)))
        .collect();
    let mut bytes = vec![0u8; n * n * 3];
    bytes.par_chunks_exact_mut(3).enumerate().for_each(|(i, pixel)| {
        let (column, row) = (i % n, i / n);
        let h = |c: usize, r: usize| grounds[r.min(n - 1) * n + c.min(n - 1)].height;
        let east_west = h(column + 1, row) - h(column.saturating_sub(1), row);
        let north_south = h(column, row.saturating_sub(1)) - h(column, row + 1);
        let slope = DVec2::new(east_west, north_south).length() / (2.0 * step);
        // Hollows are darker than crests, as dirt and moisture make them.
        let reach = (1.5 / step).ceil() as usize;
        let around = h(column + reach, row)
            + h(column.saturating_sub(reach), row)
            + h(column, row + reach)
            + h(column, row.saturating_sub(reach));
        let hollow = ((around * 0.25 - h(column, row)) * 0.35).clamp(-0.12, 0.22);
        let color = color(terrain, at(column, row), &grounds[i], slope);
        for (byte, channel) in pixel.iter_mut().zip(color) {
            *byte = (channel * (1.0 - hollow)).mul_add(255.0, 0.5).clamp(0.0, 255.0) as u8;
        }
    });
    RgbImage::from_raw(pixels, pixels, bytes).unwrap_or_else(|| RgbImage::from_pixel(1, 1, Rgb([0; 3])))
}

fn color(terrain: &Terrain, at: DVec2, ground: &Ground, slope: f64) -> Color {
    let seed = terrain.seed;
    let broad = fractal(seed ^ 21, at / 30.0, 4);
    let medium = fractal(seed ^ 22, at / 5.0, 4);
    let fine = noise(seed ^ 23, at / 0.45) * 0.6 + noise(seed ^ 24, at / 0.9) * 0.6;
    if ground.depth > 0.0 {
        return water(terrain, at, ground.depth);
    }
    let mut c = mix(GRASS, MEADOW, smoothstep(-0.5, 0.6, broad + 0.4 * medium));
    c = mix(c, DRY, smoothstep(0.15, 0.8, -broad + 0.5 * medium) * 0.65);
    c = mix(c, DRY, smoothstep(24.0, 62.0, ground.height + 6.0 * medium) * 0.7);
    let tufts = 1.0 + 0.10 * fine + 0.06 * medium;
    c = c.map(|v| v * tufts);
    let woods = terrain.woods(at) * smoothstep(0.9, 0.5, slope) * smoothstep(60.0, 48.0, ground.height);
    c = mix(c, FOREST_FLOOR, woods * (0.75 + 0.2 * medium));
    c = field(terrain, at, ground, c);

    let stones = mix(SCREE, ROCK, 0.5 + 0.5 * fine);
    c = mix(
        c,
        stones,
        smoothstep(0.55, 0.85, slope + 0.22 * medium + 0.05 * fine),
    );
    c = mix(
        c,
        rock(terrain, at, ground.height, fine),
        smoothstep(0.95, 1.35, slope + 0.2 * medium),
    );
    let snow_line = 68.0 + 5.0 * broad + 3.0 * medium;
    let lies = smoothstep(1.3, 0.75, slope) * smoothstep(snow_line, snow_line + 3.0, ground.height);
    c = mix(c, SNOW.map(|v| v * (1.0 + 0.02 * fine)), lies);

    let above = -ground.depth;
    let beach = 1.3 + 0.5 * medium;
    c = mix(
        c,
        SAND.map(|v| v * (1.0 + 0.06 * fine)),
        smoothstep(beach, beach * 0.55, above) * smoothstep(0.8, 0.4, slope),
    );
    c = mix(c, WET_SAND, smoothstep(0.28, 0.05, above));
    stream(terrain, at, ground, &mut c, fine);
    let worn = ground.site + 1.5 + 3.2 * fractal(seed ^ 25, at / 6.5, 3) + 0.8 * medium;
    c = mix(
        c,
        YARD.map(|v| v * (1.0 + 0.1 * fine + 0.05 * medium)),
        smoothstep(1.5, -2.5, worn) * 0.8,
    );
    let verge = smoothstep(4.2, 2.2, ground.road + 0.7 * medium) * 0.6;
    c = mix(c, DRY, verge);
    let ruts = smoothstep(0.45, 0.2, (ground.road - 0.85).abs());
    let crown = smoothstep(0.4, 0.1, ground.road + 0.3 * medium) * 0.5;
    let mut road = mix(DIRT, RUT, ruts * 0.8);
    road = mix(road, GRASS, crown).map(|v| v * (1.0 + 0.09 * fine + 0.05 * medium));
    mix(c, road, ground.on_road())
}

/// Strata, cracks and lichen of the wall.
fn rock(terrain: &Terrain, at: DVec2, height: f64, fine: f64) -> Color {
    let seed = terrain.seed;
    let bend = 2.0 * fractal(seed ^ 31, at / 25.0, 2);
    let layers = noise(seed ^ 32, DVec2::new((height + bend) / 1.7, at.x / 60.0))
        + 0.6 * noise(seed ^ 33, DVec2::new((height + bend) / 0.6, at.y / 40.0));
    let cracks = smoothstep(0.16, 0.02, fractal(seed ^ 34, at / 4.0, 3).abs());
    let mut c = mix(ROCK, ROCK_WARM, 0.5 + 0.8 * layers);
    c = mix(c, ROCK_DARK, smoothstep(0.1, 0.7, -layers) * 0.5);
    c = mix(c, ROCK_DARK, cracks * 0.55);
    c.map(|v| v * (1.0 + 0.09 * fine))
}

fn water(terrain: &Terrain, at: DVec2, depth: f64) -> Color {
    let seed = terrain.seed;
    let ripple = noise(
        seed ^ 41,
        DVec2::new(at.x / 2.6 + at.y / 5.0, at.y / 0.9 - at.x / 6.0),
    );
    let clouds = fractal(seed ^ 42, at / 18.0, 3);
    let mut c = mix(SHALLOW, DEEP, 1.0 - (-depth / 1.1).exp());
    c = mix(WET_SAND, c, smoothstep(0.0, 0.45, depth + 0.08 * ripple));
    c = c.map(|v| v * (1.0 + 0.07 * ripple + 0.08 * clouds));
    let foam = smoothstep(0.10, 0.03, (depth - 0.09 - 0.05 * clouds).abs());
    mix(c, [0.82, 0.84, 0.80], foam * 0.55)
}

fn stream(terrain: &Terrain, at: DVec2, ground: &Ground, c: &mut Color, fine: f64) {
    let wide = 1.15 + 0.45 * noise(terrain.seed ^ 51, at / 7.0);
    *c = mix(
        *c,
        [0.56, 0.54, 0.50].map(|v| v * (1.0 + 0.16 * fine)),
        smoothstep(wide + 1.5, wide + 0.2, ground.stream),
    );
    let ripples = 1.0 + 0.14 * noise(terrain.seed ^ 52, at / 0.7);
    *c = mix(
        *c,
        [0.22, 0.36, 0.38].map(|v| v * ripples),
        smoothstep(wide + 0.35, wide - 0.3, ground.stream),
    );
}

/// Ploughed and sown strips south of the road.
fn field(terrain: &Terrain, at: DVec2, ground: &Ground, c: Color) -> Color {
    let (local, edge) = terrain.field(at);
    let edge = edge + 0.6 * noise(terrain.seed ^ 61, at / 6.0);
    let strip = ((local.x / 0.4 + 0.5) * 5.0).floor();
    let tone = crate::noise::cell(terrain.seed ^ 62, strip as i64, 0);
    let crop = if tone < 0.35 {
        mix([0.42, 0.33, 0.23], [0.50, 0.40, 0.28], tone * 3.0)
    } else {
        mix([0.66, 0.60, 0.31], [0.35, 0.47, 0.18], (tone - 0.35) * 1.5)
    };
    let furrow = (local.x * terrain.size * std::f64::consts::TAU / 1.6).sin();
    let uneven = 0.05 * fractal(terrain.seed ^ 63, at / 9.0, 3);
    let crop = crop.map(|v| v * (1.0 + 0.07 * furrow + uneven));
    let clear = smoothstep(3.0, 6.0, ground.road) * smoothstep(0.0, 2.0, ground.site);
    mix(c, crop, smoothstep(0.4, -0.4, edge) * clear)
}
