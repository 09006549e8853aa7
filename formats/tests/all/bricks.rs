//! Brick files and chunk payloads: round trips, and the limits of what is accepted.

use crate::common::{brick_file, chunk_of};
use brickfell_formats::bricks::{self, BrickFileWriter, BrickIndex, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, ChunkBox, Encoding, Layers, brick_positions};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::steps::Steps;
use brickfell_formats::value::Codes;
use brickfell_formats::{FormatError, morton};
use glam::{USizeVec3, UVec3};
use proptest::prelude::*;

fn index(file: &[u8]) -> Result<BrickIndex, FormatError> {
    let header = bricks::decode_header(file, file.len() as u64)?;
    let directory = header.directory();
    header.decode_directory(&file[directory.start as usize..directory.end as usize])
}

fn payload<'a>(file: &'a [u8], index: &BrickIndex, chunk: usize) -> &'a [u8] {
    let entry = &index.chunks[chunk];
    &file[entry.offset as usize..][..entry.length as usize]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn chunks_round_trip(mut chunk in crate::common::chunk(2), encoding in crate::common::encoding(), axes in any::<bool>()) {
        if axes {
            crate::common::add_opacity(&mut chunk);
        }
        let bytes = chunk.encode(encoding).unwrap();
        let decode = |bytes: &[u8], c: &Chunk| Chunk::decode(bytes, c.mask, c.layout, c.layers(), encoding);
        prop_assert_eq!(&decode(&bytes, &chunk).unwrap(), &chunk);
        for cut in [0, 1, bytes.len() / 2, bytes.len() - 1] {
            prop_assert!(decode(&bytes[..cut], &chunk).is_err());
        }
    }

    /// Whether samples are set one by one or in runs, whatever is said of places that no brick has.
    #[test]
    fn a_box_is_coded_as_its_bricks_are(mut chunk in crate::common::chunk(2), encoding in crate::common::encoding(), axes in any::<bool>()) {
        if axes {
            crate::common::add_opacity(&mut chunk);
        }
        let new = || ChunkBox::new(chunk.mask, chunk.layout, chunk.layers(), 0);
        let [mut single, mut runs] = [new(), new()];
        let (size, corner, side) = (single.size().as_usizevec3(), single.corner(), chunk.layout.side() as usize);
        let noise = ([9, 8, 7, 6], [5, 4, 3, 0], [2, 1, 6, 0]);
        let mut samples = vec![noise; size.element_product()];
        for (k, brick) in brick_positions(chunk.mask).enumerate() {
            let first = (brick - corner).as_usizevec3() * 8;
            for (n, color) in chunk.brick_color(k).iter().enumerate() {
                let place = first + USizeVec3::new(n % side, n / side % side, n / side / side);
                let opacity = chunk.brick_opacity(k).map_or([0; 4], |o| o[n]);
                samples[(place.y * size.x + place.x) * size.z + place.z] = (*color, chunk.brick_normal(k)[n], opacity);
            }
        }
        for (k, column) in samples.chunks(size.z).enumerate() {
            let at = [k % size.x, k / size.x];
            let mut z = 0;
            for run in column.chunk_by(|a, b| a == b) {
                let (color, normal, opacity) = run[0];
                runs.set_run(at, z..z + run.len(), color, normal, opacity);
                for _ in run {
                    if color != [0; 4] || normal != [0; 4] || opacity != [0; 4] {
                        single.set([at[0], at[1], z], color, normal, opacity);
                    }
                    z += 1;
                }
            }
        }
        let expected = chunk.encode(encoding).unwrap();
        prop_assert!(single.encode(encoding) == expected);
        prop_assert!(runs.encode(encoding) == expected);
    }

    #[test]
    fn files_round_trip_and_every_brick_is_found(
        chunk_log2 in 0u8..=2,
        encoding in crate::common::encoding(),
        codes in prop::collection::btree_set(0u64..512, 0..6),
        masks in prop::collection::vec(any::<u64>(), 6),
        flat in any::<bool>(),
        axes in any::<bool>(),
    ) {
        // Level 3 + k has 8³ chunks of 2^k bricks.
        let places = u64::MAX >> (64 - (1u32 << (3 * chunk_log2)));
        let chunks: Vec<(UVec3, Chunk)> = codes.iter().zip(masks).map(|(code, mask)| {
            let mask = if mask & places == 0 { 1 } else { mask & places };
            let mut chunk = chunk_of(mask, SampleLayout::Corner, *code, flat);
            if axes {
                crate::common::add_opacity(&mut chunk);
            }
            (morton::decode(*code), chunk)
        }).collect();
        let file = brick_file(3 + chunk_log2, chunk_log2, encoding, &chunks);
        let index = index(&file).unwrap();
        prop_assert_eq!(index.chunks.len(), chunks.len());
        let mut brick = 0;
        for (k, (position, chunk)) in chunks.iter().enumerate() {
            prop_assert_eq!(&index.decode_chunk(k as u32, payload(&file, &index, k)).unwrap(), chunk);
            prop_assert_eq!(index.chunk_corner(&index.chunks[k]), *position << u32::from(chunk_log2));
            for local in 0..chunk.bricks() as u32 {
                prop_assert_eq!(index.locate(brick), Some((k as u32, local)));
                brick += 1;
            }
        }
        prop_assert_eq!(index.header.bricks, brick);
        prop_assert_eq!(index.locate(brick), None);
        prop_assert_eq!(index.locate(u32::MAX), None);
    }
}

#[test]
fn bricks_of_a_level_are_numbered_in_morton_order() {
    let chunks: Vec<_> = [1u64, 4]
        .map(|c| (morton::decode(c), chunk_of(0x8421, SampleLayout::Corner, 1, true)))
        .into();
    let file = brick_file(4, 2, Encoding::Packed, &chunks);
    let index = index(&file).unwrap();
    let mut last = None;
    for entry in &index.chunks {
        for p in brick_positions(entry.mask) {
            let code = morton::encode(index.chunk_corner(entry) + p);
            assert!(last.is_none_or(|l| l < code));
            last = Some(code);
        }
    }
}

#[test]
fn the_region_covers_the_present_bricks_only() {
    for (mask, samples) in [
        (1u64, 9 * 9 * 9),
        (0b11, 17 * 9 * 9),
        (1 << 63, 9 * 9 * 9),
        (u64::MAX, 33 * 33 * 33),
    ] {
        let chunk = chunk_of(mask, SampleLayout::Corner, 7, false);
        assert_eq!(
            chunk.encode(Encoding::Plain).unwrap().len(),
            samples * 7,
            "{mask:#x}"
        );
    }
    let full = chunk_of(u64::MAX, SampleLayout::Centre, 7, false);
    let noise = full.encode(Encoding::Packed).unwrap().len();
    assert!(
        noise as u32 <= bricks::MAX_PAYLOAD,
        "incompressible chunk of {noise} bytes"
    );
}

#[test]
fn ground_takes_its_surface() {
    // Solid columns of one noisy colour: eleven bytes for the six of a colour and a normal, since nothing is learned.
    let mut chunk = chunk_of(u64::MAX, SampleLayout::Corner, 3, true);
    for [r, g, b, a] in chunk.color.iter_mut().filter(|c| **c != [0; 4]) {
        [*r, *g, *b] = [*r, *g, *b].map(|c| c / 2);
        *a = 132;
    }
    let packed = chunk.encode(Encoding::Packed).unwrap().len();
    assert!(packed < 33 * 33 * 11, "{packed}");
    // And if all columns have the same, nearly nothing.
    let mut flat = chunk_of(u64::MAX, SampleLayout::Corner, 3, true);
    for (color, normal) in flat.color.iter_mut().zip(&mut flat.normal) {
        if *color != [0; 4] {
            (*color, *normal) = ([93, 60, 41, 132], [0, 0, 127, 0]);
        }
    }
    let packed = flat.encode(Encoding::Packed).unwrap().len();
    assert!(packed < 600, "{packed}");
}

/// Solid looks as the surfaces around it let expect, so only these are told.
#[test]
fn solid_follows_its_surfaces() {
    use brickfell_formats::value::{BUILD_GAIN, Value, srgb_to_linear};
    let packed = |solid_follows: bool| {
        let mut chunk = chunk_of(u64::MAX, SampleLayout::Corner, 3, false);
        let side = SampleLayout::Corner.side() as usize;
        let all = chunk.color.iter_mut().zip(&mut chunk.normal).enumerate();
        for (n, (color, normal)) in all {
            let (brick, k) = (n / side.pow(3), n % side.pow(3));
            let corner = brickfell_formats::morton::decode(brick as u64) * 8;
            let at = |axis: usize| k / side.pow(axis as u32) % side;
            let [x, y, z] = [0, 1, 2].map(|a| corner[a] as usize + at(a));
            // A plain at 12 with one partial sample, and a noisy picture on it.
            let noise = ((x * 31 + y * 17 + (x * y) % 7 * 57) % 97) as f32 / 97.0;
            let depth = if solid_follows { 12 - z.min(12) } else { 0 };
            let rgb = match depth {
                0 | 1 => [noise, 0.5, 0.25],
                _ => [srgb_to_linear(120); 3],
            };
            let alpha = match z {
                13.. => 0.0,
                12 => 0.25,
                _ => 132.0 / 255.0,
            };
            let stored = Value {
                rgb,
                alpha,
                normal: [0.0, 0.0, 1.0],
            }
            .store(BUILD_GAIN);
            (*color, *normal) = (stored.color, stored.normal);
        }
        let bytes = chunk.encode(Encoding::Packed).unwrap();
        let again = Chunk::decode(&bytes, chunk.mask, chunk.layout, chunk.layers(), Encoding::Packed);
        assert_eq!(again.as_ref(), Ok(&chunk));
        bytes.len()
    };
    let (follows, own) = (packed(true), packed(false));
    assert!(follows * 3 < own * 2, "{follows} {own}");
}

/// What a builder stores of one colour at any opacity is no news to the coder.
#[test]
fn colours_follow_their_opacity() {
    use brickfell_formats::value::{BUILD_GAIN, Value};
    let mut chunk = chunk_of(u64::MAX, SampleLayout::Centre, 9, false);
    let noise = chunk.encode(Encoding::Packed).unwrap().len();
    for (color, normal) in chunk.color.iter_mut().zip(&mut chunk.normal) {
        let value = Value {
            rgb: [0.2, 0.4, 0.6],
            alpha: f32::from(color[3]) / 255.0,
            normal: [0.0, 0.6, 0.8],
        };
        let stored = value.store(BUILD_GAIN);
        (*color, *normal) = (stored.color, stored.normal);
    }
    let packed = chunk.encode(Encoding::Packed).unwrap().len();
    assert!(packed * 3 < noise, "{packed} of {noise}");
}

#[test]
fn chunks_that_do_not_agree_with_themselves_are_refused() {
    let mut chunk = chunk_of(0b11, SampleLayout::Corner, 3, false);
    chunk.color[8][0] ^= 1;
    assert!(
        chunk
            .encode(Encoding::Packed)
            .unwrap_err()
            .message
            .contains("disagree")
    );
    chunk.color.pop();
    assert!(
        chunk
            .encode(Encoding::Packed)
            .unwrap_err()
            .message
            .contains("do not match its mask")
    );
}

#[test]
fn a_payload_must_decode_to_its_size_and_no_more() {
    let chunk = chunk_of(1, SampleLayout::Corner, 3, false);
    let plain = chunk.encode(Encoding::Plain).unwrap();
    let packed = chunk.encode(Encoding::Packed).unwrap();
    let decode = |bytes: &[u8], mask, encoding| {
        Chunk::decode(bytes, mask, SampleLayout::Corner, Layers::Plain, encoding)
    };
    assert!(decode(&plain, 0b11, Encoding::Plain).is_err());
    assert!(decode(&packed, 0b11, Encoding::Packed).is_err());
    let longer = [&packed[..], &[0]].concat();
    let e = decode(&longer, 1, Encoding::Packed).unwrap_err();
    assert!(e.message.contains("do not end where the payload does"), "{e}");
}

#[test]
fn the_writer_refuses_what_the_reader_would() {
    let payload = [0u8; 16];
    let push = |level, log2, position: [u32; 3], mask| {
        BrickFileWriter::new(level, SampleLayout::Corner, log2, Encoding::Plain).push(
            position.into(),
            mask,
            &payload,
        )
    };
    push(2, 1, [1, 1, 1], 0xff).unwrap();
    push(0, 2, [0, 0, 0], 1).unwrap();
    for (level, log2, position, mask) in [
        (2, 1, [1, 1, 1], 0),
        (2, 1, [2, 0, 0], 1),
        (2, 1, [0, 0, 0], 0x100),
        (0, 2, [0, 0, 0], 2),
        (1, 2, [0, 0, 0], 0x100),
        (1, 2, [1, 0, 0], 1),
        (20, 0, [1 << 20, 0, 0], 1),
        (20, 0, [1 << 21, 0, 0], 1),
        (255, 0, [0, 0, 0], 1),
    ] {
        let e = push(level, log2, position, mask).unwrap_err();
        assert!(
            e.message.contains("empty or outside"),
            "{level} {log2} {position:?} {mask:#x}: {e}"
        );
    }
    let mut writer = BrickFileWriter::new(3, SampleLayout::Corner, 2, Encoding::Plain);
    writer.push(UVec3::X, 1, &payload).unwrap();
    assert!(
        writer
            .push(UVec3::X, 1, &payload)
            .unwrap_err()
            .message
            .contains("Morton order")
    );
    assert!(
        writer
            .push(UVec3::ZERO, 1, &payload)
            .unwrap_err()
            .message
            .contains("Morton order")
    );
    let long = vec![0; bricks::MAX_PAYLOAD as usize + 1];
    assert!(
        writer
            .push(UVec3::Y, 1, &long)
            .unwrap_err()
            .message
            .contains("above 524288")
    );
}

#[test]
fn brick_files_stand_beside_their_tree() {
    for (tree, file) in [
        ("a.oct", "a.L03.brk"),
        ("x.y/a", "x.y/a.L03.brk"),
        ("x.y/a.b.xml", "x.y/a.b.L03.brk"),
        (".oct", ".oct.L03.brk"),
        ("x/.oct", "x/.oct.L03.brk"),
    ] {
        assert_eq!(brick_file_name(tree, 3), file);
    }
    assert_eq!(brick_file_name("a.oct", 12), "a.L12.brk");
    assert_eq!(HEADER_BYTES, 64);
}

proptest! {
    /// Whatever error is allowed, what is coded is what there is; and in steps nothing is off by more, in any chunk alike.
    #[test]
    fn steps_are_told_exactly(mut chunk in crate::common::chunk(2), error in 0..=Steps::MOST) {
        let decode = |chunk: &Chunk, bytes: &[u8]| {
            Chunk::decode(bytes, chunk.mask, chunk.layout, chunk.layers(), Encoding::Packed).unwrap()
        };
        let bytes = chunk.encode_in_steps(Encoding::Packed, error).unwrap();
        prop_assert!(decode(&chunk, &bytes) == chunk);
        let before = chunk.clone();
        chunk.in_steps(error);
        for (a, b) in before.color.iter().zip(&chunk.color) {
            let most = (0..4).map(|k| a[k].abs_diff(b[k])).max();
            prop_assert!(a[3] == b[3] && most <= Some(error + 1), "{a:?} {b:?}");
        }
        let bytes = chunk.encode_in_steps(Encoding::Packed, error).unwrap();
        prop_assert!(decode(&chunk, &bytes) == chunk);
        let again = chunk.clone();
        chunk.in_steps(error);
        prop_assert!(again == chunk, "steps stay where they are");
    }
}

/// Rough ground in noisy colours: a layer that is partly filled on solid.
#[test]
fn steps_take_fewer_bytes_the_wider_they_are() {
    let sizes = [0, 1, 2, 4, 8].map(|error| {
        let mut chunk = chunk_of(1, SampleLayout::Centre, 5, false);
        for (k, (color, normal)) in chunk.color.iter_mut().zip(&mut chunk.normal).enumerate() {
            let [r, g, b, _] = *color;
            let codes = Codes {
                rgb: [100 + r / 8, 110 + g / 8, 90 + b / 8],
                normal: [(r / 4) as i8 - 30, (g / 4) as i8 - 30, 100],
            };
            let stored = codes
                .in_steps(Steps::within(error))
                .store([132, 60, 0][(k / 100 / 4).min(2)]);
            (*color, *normal) = (stored.color, stored.normal);
        }
        chunk.encode_in_steps(Encoding::Packed, error).unwrap().len()
    });
    assert!(sizes.windows(2).all(|s| s[1] < s[0]), "{sizes:?}");
}
