//! The pools of the CPU caster: the same node words as on a GPU, and bricks decoded once, ready to be filtered.
//!
//! A sample is eight numbers of 16 bits: premultiplied linear colour, alpha, the normal, and one spare, so that a trilinear read
//! is eight loads of 16 bytes, each widened and added to eight sums at once. Masks tell in which voxels there may be
//! something, and between which eight samples there is; where there is nothing no sample is read:
//!
//! ```text
//! brick   occupied  8 x 64 bits        by voxel
//!         gaps      9 x 9 x 9 bits     by the first of eight samples (`formats::occupancy`)
//!         samples  [i16; 8] each   r g b a nx ny nz 0     of 32640: an alpha or opacity of n/255 is 128 n, exact
//!         axes     [i16; 4] each   x y z 0                the same; where the brick has opacities against the axes
//! ```
//! Written between frames by the render thread, read by all threads of a cast.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicU32, Ordering};

use brickfell_formats::blocks::{Between, NORMAL_SCALE, NORMAL_ZERO};
use brickfell_formats::chunk::Layers;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::occupancy::{GAP_WORDS, GAPS};
use brickfell_formats::value::{decode_normal, srgb_to_linear_f64};
use brickfell_pager::{Bricks, ChunkPage};
use brickfell_shaders::layout::BRICK;
use glam::{DVec3, Vec4};

use crate::march::{Brick, Mask, Triple, Value};

/// What a sample's numbers are parts of.
const UNIT: f64 = 32_640.0;

/// Codes of bytes as parts of [`UNIT`].
struct Codes {
    linear: [i16; 256],
    normal: [i16; 256],
    /// Of a normal in blocks, by component.
    straight: [[i16; 256]; 3],
}

static CODES: LazyLock<Codes> = LazyLock::new(|| {
    let parts = |x: f64| (x * UNIT).round() as i16;
    Codes {
        linear: std::array::from_fn(|c| parts(srgb_to_linear_f64(c as u8))),
        normal: std::array::from_fn(|c| parts(decode_normal([c as u8 as i8, 0, 0, 0])[0])),
        straight: std::array::from_fn(|k| {
            let (zero, scale) = (f64::from(NORMAL_ZERO[k]), f64::from(NORMAL_SCALE[k]));
            std::array::from_fn(|c| parts(((c as f64 - zero) / scale).clamp(-1.0, 1.0)))
        }),
    }
});

fn opacity(code: u8) -> i16 {
    i16::from(code) << 7
}

/// A brick that can be filtered.
#[derive(Debug)]
pub(super) struct Packed {
    occupied: Mask,
    gaps: [u32; GAP_WORDS],
    /// The box of the occupied voxels, high corner exclusive; nothing is in it if there are none.
    filled: [[u8; 3]; 2],
    samples: Box<[[i16; 8]]>,
    axes: Box<[[i16; 4]]>,
    side: usize,
    /// Added to a position, in 256ths of a voxel, to count from the first sample.
    offset: i32,
    /// Looks are to be multiplied with alpha once they are filtered.
    blocks: bool,
}

impl Packed {
    /// Decodes a brick of a chunk.
    pub(super) fn new(chunk: &ChunkPage, brick: u32) -> Self {
        let (codes, k) = (&*CODES, brick as usize);
        let layout = chunk.layout();
        let (mut axes, mut samples) = (Vec::new(), Vec::with_capacity(layout.samples()));
        let mut sample = |[r, g, b, a]: [u8; 4], [x, y, z]: [i16; 3]| {
            let [r, g, b] = [r, g, b].map(|c| codes.linear[usize::from(c)]);
            samples.push([r, g, b, opacity(a), x, y, z, 0]);
        };
        match chunk.bricks() {
            Bricks::Samples(chunk) => {
                for (color, [x, y, z, _]) in chunk.brick_color(k).iter().zip(chunk.brick_normal(k)) {
                    sample(*color, [*x, *y, *z].map(|c| codes.normal[usize::from(c as u8)]));
                }
                let stored = chunk.brick_opacity(k).unwrap_or_default().iter();
                axes.extend(stored.map(|[x, y, z, _]| [opacity(*x), opacity(*y), opacity(*z), 0]));
            }
            Bricks::Blocks(chunk) => {
                let texels = chunk.texels(k, Between::default());
                for (color, normal) in texels.color.iter().zip(&texels.normal) {
                    sample(
                        *color,
                        [0, 1, 2].map(|k| codes.straight[k][usize::from(normal[k])]),
                    );
                }
                let shares = texels.share.iter();
                axes.extend(shares.map(|[x, y, z]| [opacity(*x), opacity(*y), opacity(*z), 0]));
            }
        }
        let occupied = occupied(&samples, layout);
        Self {
            occupied,
            filled: filled(&occupied),
            gaps: chunk.occupancy()[k].gaps,
            samples: samples.into(),
            axes: axes.into(),
            side: layout.side() as usize,
            offset: ((layout.texel_offset() - 0.5) * 256.0) as i32,
            blocks: chunk.samples().is_none(),
        }
    }

    /// Low and high corner of what is occupied, in voxels, out to whole segments of 2^`step` voxels.
    pub(super) fn filled(&self, step: u32) -> [DVec3; 2] {
        let [low, high] = self.filled.map(|p| p.map(u32::from));
        let (low, high) = (
            low.map(|v| v >> step << step),
            high.map(|v| v.next_multiple_of(1 << step)),
        );
        [low, high].map(|p| DVec3::from(p.map(f64::from)))
    }

    /// Bytes of a brick in memory.
    pub(super) fn bytes(layout: SampleLayout, layers: Layers) -> u64 {
        let sample = match layers {
            Layers::Plain => size_of::<[i16; 8]>(),
            Layers::Axes => size_of::<[i16; 8]>() + size_of::<[i16; 4]>(),
        };
        (size_of::<Self>() + layout.samples() * sample) as u64
    }
}

#[inline(always)]
fn four([x, y, z, w]: [i16; 4]) -> Vec4 {
    Vec4::new(f32::from(x), f32::from(y), f32::from(z), f32::from(w))
}

/// The voxels that read a sample with an alpha.
fn occupied(samples: &[[i16; 8]], layout: SampleLayout) -> Mask {
    let side = layout.side() as usize;
    // Voxel i reads samples i to i + reach.
    let reach = side - 8;
    let mut mask = [0u64; 8];
    for (k, _) in samples.iter().enumerate().filter(|(_, s)| s[3] != 0) {
        let at = [k % side, k / side % side, k / (side * side)];
        let [x, y, z] = at.map(|i| i.saturating_sub(reach)..=i.min(7));
        let row = x.fold(0u64, |row, x| row | 1 << x);
        let layer = y.fold(0u64, |layer, y| layer | row << (8 * y));
        for z in z {
            mask[z] |= layer;
        }
    }
    mask
}

/// The box of the voxels in a mask.
fn filled(mask: &Mask) -> [[u8; 3]; 2] {
    let (mut low, mut high) = ([8u8; 3], [0u8; 3]);
    for (z, layer) in mask.iter().enumerate() {
        for voxel in (0..64u8).filter(|v| layer >> v & 1 == 1) {
            let at = [voxel % 8, voxel / 8, z as u8];
            for k in 0..3 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k] + 1);
            }
        }
    }
    [low, high]
}

impl Brick<f32> for &Packed {
    #[inline(always)]
    fn occupied(&self) -> &Mask {
        &self.occupied
    }

    #[inline(always)]
    fn value(&self, local: Triple<f32>, reads: &mut u64) -> Value<f32> {
        let last = self.side as i32 - 2;
        let (mut base, mut part) = ([0usize; 3], [0f32; 3]);
        for k in 0..3 {
            let inside = if local[k] > 0.0 { local[k] } else { 0.0 };
            let inside = if inside < 8.0 { inside } else { 8.0 };
            let texel = (inside * 256.0 + 0.5) as i32 + self.offset;
            let first = (texel >> 8).min(last);
            base[k] = first as usize;
            part[k] = (texel - (first << 8)) as f32 * (1.0 / 256.0);
        }
        *reads += 1;
        let gap = (base[2] * GAPS + base[1]) * GAPS + base[0];
        if self.gaps[gap / 32] >> (gap % 32) & 1 == 0 {
            return Value::default();
        }
        let row = self.side;
        let layer = row * row;
        let first = base[2] * layer + base[1] * row + base[0];
        let corners = [
            first,
            first + 1,
            first + row,
            first + row + 1,
            first + layer,
            first + layer + 1,
            first + layer + row,
            first + layer + row + 1,
        ];
        const SCALE: f32 = (1.0 / UNIT) as f32;
        let [x, y, z] = part;
        let (lower, upper) = ((1.0 - z) * SCALE, z * SCALE);
        let sides = [(1.0 - y) * lower, y * lower, (1.0 - y) * upper, y * upper];
        let weights: [f32; 8] = [
            sides[0] * (1.0 - x),
            sides[0] * x,
            sides[1] * (1.0 - x),
            sides[1] * x,
            sides[2] * (1.0 - x),
            sides[2] * x,
            sides[3] * (1.0 - x),
            sides[3] * x,
        ];
        // As vectors of four, which the compiler does not find by itself here.
        let (mut color, mut normal) = (Vec4::ZERO, Vec4::ZERO);
        for (corner, weight) in corners.into_iter().zip(weights) {
            let [r, g, b, a, x, y, z, w] = self.samples[corner];
            color += four([r, g, b, a]) * weight;
            normal += four([x, y, z, w]) * weight;
        }
        let ([r, g, b, alpha], [nx, ny, nz, _]) = (color.to_array(), normal.to_array());
        if alpha <= 0.0 {
            return Value::default();
        }
        *reads += 1;
        let mut value = Value {
            rgb: [r, g, b],
            alpha,
            normal: [nx, ny, nz],
            axes: None,
        };
        if !self.axes.is_empty() {
            *reads += 1;
            let mut axes = Vec4::ZERO;
            for (corner, weight) in corners.into_iter().zip(weights) {
                axes += four(self.axes[corner]) * weight;
            }
            value.axes = Some([axes.x, axes.y, axes.z]);
        }
        if self.blocks {
            let fade = (2.0 * alpha).min(1.0);
            value.rgb = value.rgb.map(|c| c * alpha);
            value.normal = value.normal.map(|c| c * fade);
            value.axes = value.axes.map(|axes| axes.map(|c| c * alpha));
        }
        value
    }
}

/// Node pool, brick pool, usage stamps.
#[derive(Debug)]
pub(super) struct Pools {
    /// Node words; tile t is at 8 t.
    pub(super) nodes: Vec<[u32; 2]>,
    /// Bricks by slot.
    pub(super) bricks: Vec<Option<Packed>>,
    brick_stamps: Vec<AtomicU32>,
    tile_stamps: Vec<AtomicU32>,
}

/// Writes a stamp that is not there yet: what all threads write is seldom worth a write.
#[inline(always)]
fn stamp(stamps: &[AtomicU32], at: usize, frame: u32) {
    if let Some(stamp) = stamps.get(at)
        && stamp.load(Ordering::Relaxed) != frame
    {
        stamp.store(frame, Ordering::Relaxed);
    }
}

/// One bit for each stamp of a frame.
fn stamped(stamps: &[AtomicU32], frame: u32) -> Vec<u32> {
    let word = |stamps: &[AtomicU32]| {
        let bits = stamps.iter().enumerate();
        bits.fold(0, |word, (k, s)| {
            word | u32::from(s.load(Ordering::Relaxed) == frame) << k
        })
    };
    stamps.chunks(32).map(word).collect()
}

impl Pools {
    /// Empty pools.
    pub(super) fn new(bricks: u32, tiles: u32) -> Self {
        let stamps = |count: u32| (0..count).map(|_| AtomicU32::new(0)).collect();
        Self {
            nodes: vec![[0; 2]; tiles as usize * 8],
            bricks: (0..bricks).map(|_| None).collect(),
            brick_stamps: stamps(bricks),
            tile_stamps: stamps(tiles),
        }
    }

    /// The brick that a node's words name, if it is there.
    #[inline(always)]
    pub(super) fn brick(&self, [structure, data]: [u32; 2]) -> Option<&Packed> {
        let slot = data.checked_sub(1).filter(|_| structure & BRICK != 0)?;
        self.bricks.get(slot as usize)?.as_ref()
    }

    /// Notes that a node's tile was used.
    #[inline(always)]
    pub(super) fn use_tile(&self, node: u32, frame: u32) {
        stamp(&self.tile_stamps, node as usize >> 3, frame);
    }

    /// Notes that a brick was used.
    #[inline(always)]
    pub(super) fn use_brick(&self, slot: u32, frame: u32) {
        stamp(&self.brick_stamps, slot as usize, frame);
    }

    /// Bits of the brick slots and of the node tiles that were used in a frame.
    pub(super) fn used(&self, frame: u32) -> [Vec<u32>; 2] {
        [&self.brick_stamps, &self.tile_stamps].map(|stamps| stamped(stamps, frame))
    }
}
