//! The ground: its height and its look, as a pure function of a seed, a level's voxels and a column of the world's lattice.
//!
//! Heights are octaves of value noise whose cells are whole numbers of finest voxels wide, powers of two of them. A column of
//! a coarser level has the same octaves less those that its voxels cannot show: what a filter over the column leaves of
//! them. So every chunk, level and tree that stores a column stores the same, and nothing has to be kept to make it. All positions are
//! dyadic, so cells and fractions are exact. Plain values: any thread.

use brickfell_formats::value::{
    BUILD_GAIN, SOLID_ALPHA, Stored, Value, opacity_level, opacity_of_level, srgb_to_linear,
};

/// Width of the widest cells of noise, log2 of tree sides.
const WIDEST: u32 = 2;
/// Lowest ground, and how far above it the highest may be, in tree sides from the middle of a tree's height.
const LOWEST: f64 = -0.2;
const RELIEF: f64 = 0.6;
/// What a level shows of an octave, by log2 of the cells' width in its voxels: nothing of what is narrower than two.
const SHOWN: [f32; 4] = [0.0, 0.35, 0.8, 1.0];
/// Voxels below the surface from which ground is deep: one colour everywhere, without a normal.
const DEEP_BELOW: f32 = 3.0;
/// sRGB colours: lowland, grass, rock, snow, and what is deep inside.
const LOOKS: [[f32; 3]; 4] = [
    [128.0, 116.0, 72.0],
    [86.0, 122.0, 58.0],
    [122.0, 112.0, 102.0],
    [236.0, 240.0, 244.0],
];
const DEEP: [f32; 3] = [96.0, 84.0, 70.0];

/// Heights and looks of a terrain.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    pub(super) seed: u64,
    /// Depth of its trees.
    pub(super) depth: u8,
    /// Trees per axis; outside of them is air.
    pub(super) trees: u32,
}

/// A rectangle of columns of a level: voxels are `1 << mip` finest ones wide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Patch {
    pub(super) mip: u32,
    /// Lowest column, in voxels of the level.
    pub(super) low: [i64; 2],
    /// Columns per axis.
    pub(super) side: usize,
}

/// What a column shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    /// Its surface, in voxels of the level above the world's zero; minus infinity outside of the terrain.
    pub(super) height: f32,
    /// A sample that is all ground.
    ground: Stored,
    /// Linear colour and normal, for samples that are ground in part.
    look: Value,
}

/// A well-mixed 64-bit hash (the finaliser of SplitMix64).
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Uniform in 0..1 for a corner of the lattice.
fn corner(seed: u64, x: i64, y: i64) -> f32 {
    let key = mix(seed ^ mix((x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ mix(y as u64)));
    (key >> 40) as f32 / (1u64 << 24) as f32
}

fn smooth(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

impl Field {
    /// Finest voxels of a tree's side, log2.
    fn side_log2(&self) -> u32 {
        3 + u32::from(self.depth)
    }

    /// Surfaces of the columns of a patch, x fastest, in voxels of its level.
    pub(super) fn heights(&self, patch: &Patch) -> Vec<f32> {
        let n = patch.side;
        let side = (1u64 << self.side_log2()) as f64;
        let voxel = (1u64 << patch.mip) as f64;
        // Half of the relief is the widest octave's, a quarter the next one's.
        let octaves = self.side_log2() + WIDEST;
        let mut sum = vec![0f32; n * n];
        let mut rest = 1.0;
        for octave in 0..octaves {
            let share = rest / 2.0;
            rest -= share;
            let width_log2 = octaves - octave;
            let shown = SHOWN[(width_log2.saturating_sub(patch.mip) as usize).min(SHOWN.len() - 1)];
            let strength = (share * RELIEF * side / voxel) as f32;
            // Not shown: all of it is at its mean.
            sum.iter_mut().for_each(|h| *h += strength * 0.5 * (1.0 - shown));
            if shown > 0.0 {
                self.add_octave(patch, octave, width_log2 - patch.mip, strength * shown, &mut sum);
            }
        }
        let lowest = (LOWEST * side / voxel) as f32;
        // A voxel is the terrain's if its middle is.
        let end =
            ((i64::from(self.trees) << self.side_log2() << 1) + (1i64 << patch.mip) - 1) >> (patch.mip + 1);
        for (k, h) in sum.iter_mut().enumerate() {
            let at = [patch.low[0] + (k % n) as i64, patch.low[1] + (k / n) as i64];
            let inside = at.into_iter().all(|v| (0..end).contains(&v));
            *h = if inside { *h + lowest } else { f32::NEG_INFINITY };
        }
        sum
    }

    /// Adds an octave with cells of `1 << width` voxels.
    fn add_octave(&self, patch: &Patch, octave: u32, width: u32, strength: f32, sum: &mut [f32]) {
        let n = patch.side;
        let seed = mix(self.seed.wrapping_add(u64::from(octave) << 32));
        let cell = |at: i64| at >> width;
        // Middles of voxels, so no fraction is 0.
        let fraction = |at: i64| {
            let inside = at - (cell(at) << width);
            smooth((inside as f32 + 0.5) / (1u64 << width) as f32)
        };
        let (mut below, mut above) = (Vec::new(), Vec::new());
        let row_of = |y: i64, row: &mut Vec<f32>| {
            row.clear();
            let mut at = patch.low[0];
            let end = at + n as i64;
            while at < end {
                let x = cell(at);
                let (a, b) = (corner(seed, x, y), corner(seed, x + 1, y));
                let cell_end = ((x + 1) << width).min(end);
                row.extend((at..cell_end).map(|at| lerp(a, b, fraction(at))));
                at = cell_end;
            }
        };
        let mut row = None;
        for (y, line) in (patch.low[1]..).zip(sum.chunks_exact_mut(n)) {
            if row != Some(cell(y)) {
                row = Some(cell(y));
                row_of(cell(y), &mut below);
                row_of(cell(y) + 1, &mut above);
            }
            let t = fraction(y);
            for ((h, a), b) in line.iter_mut().zip(&below).zip(&above) {
                *h += strength * lerp(*a, *b, t);
            }
        }
    }

    /// What the columns of a patch show, x fastest.
    pub(super) fn columns(&self, patch: &Patch) -> Vec<Column> {
        let n = patch.side;
        let around = Patch {
            low: patch.low.map(|v| v - 1),
            side: n + 2,
            ..*patch
        };
        let heights = self.heights(&around);
        let side = (1u64 << self.side_log2() >> patch.mip.min(self.side_log2())) as f32;
        let (lowest, relief) = (LOWEST as f32 * side, RELIEF as f32 * side);
        let mut columns = Vec::with_capacity(n * n);
        for y in 0..n {
            for x in 0..n {
                let at = (y + 1) * (n + 2) + x + 1;
                let h = heights[at];
                let slope = |a: usize, b: usize| {
                    let d = (heights[b] - heights[a]) / 2.0;
                    if d.is_finite() { d } else { 0.0 }
                };
                let (dx, dy) = (slope(at - 1, at + 1), slope(at - n - 2, at + n + 2));
                columns.push(Column::new(h, dx, dy, (h - lowest) / relief));
            }
        }
        columns
    }

    /// The sample of a column at a height, in voxels of the level above the world's zero.
    pub(super) fn sample(column: &Column, z: i64) -> Stored {
        let depth = column.height - z as f32;
        if depth <= 0.0 {
            return Stored::default();
        }
        if depth > DEEP_BELOW {
            return deep();
        }
        let alpha = opacity_of_level(opacity_level((depth.min(1.0) * f32::from(SOLID_ALPHA)) as u8));
        match alpha {
            0 => Stored::default(),
            SOLID_ALPHA => column.ground,
            _ => Value {
                alpha: f32::from(alpha) / 255.0,
                ..column.look
            }
            .store(BUILD_GAIN),
        }
    }

    /// Whether samples of a column from `low` to `high`, inclusive, may differ from air and from deep ground, by the lowest and the
    /// highest surface: (all air, all deep).
    pub(super) fn uniform(surfaces: [f32; 2], low: i64, high: i64) -> (bool, bool) {
        let [lowest, highest] = surfaces;
        (highest <= low as f32, lowest - high as f32 > DEEP_BELOW)
    }
}

/// A sample deep in the ground.
pub(super) fn deep() -> Stored {
    let rgb = DEEP.map(|c| srgb_to_linear(c as u8));
    let (alpha, normal) = (f32::from(SOLID_ALPHA) / 255.0, [0.0; 3]);
    Value { rgb, alpha, normal }.store(BUILD_GAIN)
}

impl Column {
    /// A column with this surface, these slopes (voxels a voxel), and so much of the relief below it.
    fn new(height: f32, dx: f32, dy: f32, share: f32) -> Self {
        let length = (dx * dx + dy * dy + 1.0).sqrt();
        let up = 1.0 / length;
        let place = (share * 4.0 - 0.5).clamp(0.0, 2.999);
        let (k, t) = (place as usize, place.fract());
        let steep = ((0.93 - up) * 8.0).clamp(0.0, 1.0);
        // Rounded to codes before it meets any opacity: one look, one colour.
        let rgb = [0, 1, 2].map(|c| {
            let ground = lerp(LOOKS[k][c], LOOKS[k + 1][c], t);
            srgb_to_linear(lerp(ground, LOOKS[2][c], steep) as u8)
        });
        let normal = [-dx * up, -dy * up, up].map(|c| (c * 127.0).round() / 127.0);
        let look = Value {
            rgb,
            alpha: f32::from(SOLID_ALPHA) / 255.0,
            normal,
        };
        Self {
            height,
            ground: look.store(BUILD_GAIN),
            look,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIELD: Field = Field {
        seed: 5,
        depth: 4,
        trees: 9,
    };

    #[test]
    fn a_column_is_the_same_in_every_patch() {
        let large = Patch {
            mip: 1,
            low: [-3, 60],
            side: 90,
        };
        let small = Patch {
            mip: 1,
            low: [20, 71],
            side: 7,
        };
        let (all, part) = (FIELD.heights(&large), FIELD.heights(&small));
        for y in 0..7 {
            for x in 0..7 {
                assert_eq!(part[y * 7 + x].to_bits(), all[(y + 11) * 90 + x + 23].to_bits());
            }
        }
    }

    #[test]
    fn coarse_columns_are_the_means_of_fine_ones() {
        for mip in 1..8 {
            let side = 64;
            let fine = FIELD.heights(&Patch {
                mip: mip - 1,
                low: [0, 0],
                side,
            });
            let coarse = FIELD.heights(&Patch {
                mip,
                low: [0, 0],
                side: side / 2,
            });
            let (mut squares, mut worst) = (0f64, 0f32);
            for y in 0..side / 2 {
                for x in 0..side / 2 {
                    let h = coarse[y * side / 2 + x];
                    let at = 2 * y * side + 2 * x;
                    let mean = (fine[at] + fine[at + 1] + fine[at + side] + fine[at + side + 1]) / 8.0;
                    if h.is_finite() && mean.is_finite() {
                        squares += f64::from(h - mean).powi(2);
                        worst = worst.max((h - mean).abs());
                    }
                }
            }
            let rms = (squares / (side * side / 4) as f64).sqrt();
            assert!(
                rms < 0.15 && worst < 0.75,
                "mip {mip}: {rms}, at worst {worst} voxels"
            );
        }
    }

    #[test]
    fn ground_stays_in_its_band_and_ends_with_the_terrain() {
        let side = (8i64 << 4) as f32;
        let patch = Patch {
            mip: 0,
            low: [9 * 128 - 100, -10],
            side: 120,
        };
        let heights = FIELD.heights(&patch);
        let (low, high) = (LOWEST as f32 * side, (LOWEST + RELIEF) as f32 * side);
        for (k, h) in heights.iter().enumerate() {
            let inside = k % 120 < 100 && k / 120 >= 10;
            assert_eq!(h.is_finite(), inside, "{k}");
            assert!(!inside || (low..=high).contains(h), "{h}");
        }
        let other = Field { seed: 6, ..FIELD };
        assert_ne!(other.heights(&patch), heights);
    }

    #[test]
    fn a_column_is_air_above_solid_below_and_deep_from_there_on() {
        let patch = Patch {
            mip: 0,
            low: [5, 5],
            side: 1,
        };
        let column = FIELD.columns(&patch)[0];
        let top = column.height.floor() as i64;
        assert_eq!(Field::sample(&column, top + 1), Stored::default());
        assert_eq!(Field::sample(&column, top - 1), column.ground);
        assert_eq!(Field::sample(&column, top - 4), deep());
        assert_eq!(deep().color[3], SOLID_ALPHA);
        assert_eq!(deep().normal, [0; 4]);
        assert_ne!(column.ground.normal, [0; 4]);
        let surfaces = [column.height; 2];
        assert_eq!(Field::uniform(surfaces, top + 1, top + 9), (true, false));
        assert_eq!(Field::uniform(surfaces, top - 20, top - 4), (false, true));
        assert_eq!(Field::uniform(surfaces, top - 2, top + 2), (false, false));
    }
}
