//! Bricks in blocks: what is promised of their samples, and any bytes in their place.

use crate::common::{add_opacity, brick_file, chunk, chunk_of};
use brickfell_formats::blocks::{
    BlockChunk, COLOR_BYTES, NORMAL_SCALE, NORMAL_ZERO, PLAIN_BYTES, SLICE_BLOCKS, brick_bytes,
};
use brickfell_formats::bricks;
use brickfell_formats::chunk::{Chunk, Encoding, Layers};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::{BUILD_GAIN, SOLID_ALPHA, Value, linear_to_srgb, srgb_to_linear};
use glam::UVec3;
use proptest::prelude::*;

fn coded(chunk: &Chunk) -> Chunk {
    let payload = chunk.encode(Encoding::Blocks).expect("a valid chunk");
    let (mask, layout, layers) = (chunk.mask, chunk.layout, chunk.layers());
    Chunk::decode(&payload, mask, layout, layers, Encoding::Blocks).expect("a payload that was just written")
}

/// A surface as builders store it: nothing above it, skin, then ground, in colours along a line.
fn ground(layout: SampleLayout, colors: [[f32; 3]; 2], normal: [f32; 3]) -> Chunk {
    let mut chunk = chunk_of(1, layout, 0, true);
    let side = layout.side() as usize;
    for at in 0..layout.samples() {
        let [x, y, z] = [at % side, at / side % side, at / side / side];
        let alpha = [1.0, 1.0, 132.0 / 255.0, 0.0][(z + y / 4).clamp(3, 6) - 3];
        let part = x as f32 / (side - 1) as f32;
        let rgb = std::array::from_fn(|k| {
            // Even in codes, as the line between end points is.
            let code = colors[0][k] * (1.0 - part) + colors[1][k] * part;
            srgb_to_linear((code * 255.0) as u8)
        });
        let stored = Value { rgb, alpha, normal }.store(BUILD_GAIN);
        (chunk.color[at], chunk.normal[at]) = (stored.color, stored.normal);
    }
    chunk
}

fn unit() -> impl Strategy<Value = [f32; 3]> {
    [-1f32..1.0, -1f32..1.0, -1f32..1.0].prop_map(|v| {
        let length = v.iter().map(|c| c * c).sum::<f32>().sqrt().max(1e-3);
        v.map(|c| c / length)
    })
}

proptest! {
    #[test]
    fn nothing_and_opaque_stay_what_they_are(chunk in chunk(1), axes in any::<bool>()) {
        let mut chunk = chunk;
        if axes {
            add_opacity(&mut chunk);
        }
        let back = coded(&chunk);
        prop_assert_eq!((back.mask, back.layers(), back.color.len()), (chunk.mask, chunk.layers(), chunk.color.len()));
        for (k, (was, is)) in chunk.color.iter().zip(&back.color).enumerate() {
            prop_assert_eq!(was[3] == 0, is[3] == 0, "sample {}", k);
            prop_assert!(was[3] < 128 || is[3] >= was[3].min(SOLID_ALPHA), "sample {}: {} became {}", k, was[3], is[3]);
            if is[3] == 0 {
                prop_assert_eq!((*is, back.normal[k]), ([0; 4], [0; 4]));
                prop_assert!(!axes || back.opacity[k] == [0; 4]);
            }
        }
    }

    /// Straight colours lie on a line and alphas are those of ground: the loss is that of end points and of the steps between.
    #[test]
    fn a_surface_keeps_its_looks(
        colors in [[0.05f32..1.0, 0.05f32..1.0, 0.05f32..1.0], [0.05f32..1.0, 0.05f32..1.0, 0.05f32..1.0]],
        normal in unit(), centre in any::<bool>(),
    ) {
        let layout = if centre { SampleLayout::Centre } else { SampleLayout::Corner };
        let chunk = ground(layout, colors, normal);
        let back = coded(&chunk);
        // Over 4 of 9 or 10 samples a block has a third of the range, in steps of a third of that.
        let range = (0..3).map(|k| (colors[0][k] - colors[1][k]).abs()).fold(0f32, f32::max);
        let bound = 255.0 * range / 3.0 / 6.0 + 7.0;
        for (k, (was, is)) in chunk.color.iter().zip(&back.color).enumerate() {
            prop_assert_eq!(was[3], is[3], "sample {}", k);
            for c in (0..3).filter(|_| was[3] > 0) {
                let straight = |v: [u8; 4]| f32::from(linear_to_srgb(srgb_to_linear(v[c]) * 255.0 / f32::from(v[3])));
                let off = (straight(*was) - straight(*is)).abs();
                prop_assert!(off <= bound, "sample {}: {:?} became {:?}, bound {}", k, was, is, bound);
                let turned = chunk.normal[k][c].abs_diff(back.normal[k][c]);
                prop_assert!(turned <= 5, "sample {}: {:?} became {:?}", k, chunk.normal[k], back.normal[k]);
            }
        }
    }

    #[test]
    fn opacities_against_the_axes_that_agree_are_those_of_the_alpha(chunk in chunk(0)) {
        let mut chunk = chunk;
        chunk.opacity = chunk.color.iter().map(|[.., a]| [*a, *a, *a, 0]).collect();
        let back = coded(&chunk);
        for (color, opacity) in back.color.iter().zip(&back.opacity) {
            prop_assert_eq!(*opacity, [color[3], color[3], color[3], 0]);
        }
    }

    #[test]
    fn any_bytes_are_read_and_other_lengths_refused(
        seed in any::<u64>(), mask in 1u64..256, axes in any::<bool>(), centre in any::<bool>(), more in 1usize..64,
    ) {
        let layers = if axes { Layers::Axes } else { Layers::Plain };
        let layout = if centre { SampleLayout::Centre } else { SampleLayout::Corner };
        let length = mask.count_ones() as usize * brick_bytes(layout, layers);
        let mut state = seed;
        let mut bytes: Vec<u8> = std::iter::repeat_with(|| {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(seed | 1);
            (state >> 56) as u8
        }).take(length).collect();
        let chunk = Chunk::decode(&bytes, mask, layout, layers, Encoding::Blocks).unwrap();
        prop_assert_eq!(chunk.color.len(), mask.count_ones() as usize * layout.samples());
        // What was read can be written again.
        prop_assert_eq!(chunk.encode(Encoding::Blocks).unwrap().len(), length);
        bytes.resize(length + more, 0);
        prop_assert!(BlockChunk::new(bytes.clone(), mask, layout, layers).is_err());
        bytes.truncate(length - more);
        prop_assert!(BlockChunk::new(bytes, mask, layout, layers).is_err());
    }
}

/// Where the document says that the sample at (x, y, z) of the second brick is.
#[test]
fn blocks_are_where_the_document_says() {
    for (layout, layers) in [
        (SampleLayout::Corner, Layers::Plain),
        (SampleLayout::Centre, Layers::Axes),
    ] {
        let side = layout.side() as usize;
        for at in [[0, 0, 0], [5, 1, 3], [8, 8, 8], [side - 1, 2, side - 1]] {
            let [x, y, z] = at;
            let samples = layout.samples();
            let mut chunk = chunk_of(0b101, layout, 0, true);
            chunk.color.fill([0; 4]);
            chunk.normal.fill([0; 4]);
            if layers == Layers::Axes {
                chunk.opacity = vec![[0; 4]; 2 * samples];
            }
            let sample = samples + (z * side + y) * side + x;
            chunk.color[sample] = [255, 255, 255, 255];
            chunk.normal[sample] = [0, 0, 127, 0];
            let payload = chunk.encode(Encoding::Blocks).unwrap();
            assert_eq!(payload.len(), 2 * brick_bytes(layout, layers));
            let block = z * SLICE_BLOCKS + y / 4 * 3 + x / 4;
            let brick = brick_bytes(layout, layers);
            let colors = side * SLICE_BLOCKS * COLOR_BYTES;
            let alphas: Vec<usize> = (0..side * SLICE_BLOCKS)
                .filter(|b| payload[brick + b * COLOR_BYTES..][..8] != [0; 8])
                .collect();
            assert_eq!(alphas, [block], "{at:?}");
            let texel = (y % 4) * 4 + x % 4;
            let color = &payload[brick + block * COLOR_BYTES..][..COLOR_BYTES];
            // The larger end point has index 0.
            let indices = color[2..8]
                .iter()
                .rev()
                .fold(0u64, |bits, b| bits << 8 | u64::from(*b));
            assert_eq!(color[0], 255);
            assert_eq!(indices >> (3 * texel) & 7, 0, "{at:?}");
            let normal = &payload[brick + colors + block * PLAIN_BYTES..][..PLAIN_BYTES];
            // Straight up: x and y are 0 exactly, z is 1.
            assert_eq!([NORMAL_ZERO, NORMAL_SCALE], [[132, 130, 132], [123, 125, 123]]);
            assert_eq!(normal[..4], [0x1f, 0x84, 0x1f, 0x84], "{at:?}");
        }
    }
}

#[test]
fn files_give_their_blocks_or_their_samples() {
    let chunk = chunk_of(0b11, SampleLayout::Centre, 3, true);
    let read = |encoding| {
        let file = brick_file(2, 1, encoding, &[(UVec3::ONE, chunk.clone())]);
        let header = bricks::decode_header(&file, file.len() as u64).unwrap();
        let range = header.directory();
        let index = header
            .decode_directory(&file[range.start as usize..range.end as usize])
            .unwrap();
        let entry = index.chunks[0];
        (
            index,
            file[entry.offset as usize..][..entry.length as usize].to_vec(),
        )
    };
    let (index, payload) = read(Encoding::Blocks);
    let blocks = index.block_chunk(0, payload.clone()).unwrap();
    assert_eq!(blocks.bytes(), payload);
    assert_eq!(blocks.memory(), payload.len() + size_of::<BlockChunk>());
    assert_eq!(blocks.samples(), index.decode_chunk(0, &payload).unwrap());
    let parts: Vec<usize> = blocks.brick(1).iter().map(|part| part.len()).collect();
    assert_eq!(parts, [90 * 16, 90 * 8, 0]);
    assert_eq!(blocks.brick(2), [&[] as &[u8]; 3]);
    let mut damaged = payload;
    damaged[7] ^= 1;
    assert!(
        index
            .block_chunk(0, damaged)
            .unwrap_err()
            .message
            .contains("checksum")
    );
    let (index, payload) = read(Encoding::Packed);
    let e = index.block_chunk(0, payload).unwrap_err().to_string();
    assert_eq!(e, "byte 16: bricks are not block-compressed");
}
