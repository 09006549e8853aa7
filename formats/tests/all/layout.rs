//! The bytes are where `docs/formats.md` says. A change here is a change of the format.

use crate::common::{brick_file, chunk_of};
use brickfell_formats::chunk::{Chunk, Encoding, brick_positions};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::decode_any;
use brickfell_formats::octree_binary;
use glam::UVec3;

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

#[test]
fn octree_file() {
    let mut text = "<GigaVoxelsOctTree X='-1.5' Y='2' Z='3' DeltaX='0.5' DeltaY='0.5' DeltaZ='0.5' VolumeXSize='8' \
        VolumeYSize='8' VolumeZSize='8' BrickXSize='8' BrickYSize='8' BrickZSize='8' Binary='YES' Layout='CORNER' Gain='2' \
        SurfaceVoxels='7' SurfaceMinX='1' SurfaceMaxX='2' SurfaceMaxY='3' SurfaceMaxZ='4'>\
        <Node Type='NON-CONST' Brick='0'><Node Type='NON-CONST' Brick='0'/>"
        .to_string();
    text.push_str(&"<Node Type='LEAF-CONST' Color='#01020304'/>".repeat(6));
    text.push_str("<Node Type='NON-CONST' Brick='1'/></Node></GigaVoxelsOctTree>");
    let file = octree_binary::encode(&decode_any(text.as_bytes()).unwrap()).unwrap();
    assert_eq!(&file[..16], b"BRKFOCT\0\x02\0\0\0\x01\0\x02\0");
    let doubles = [16, 24, 32, 40].map(|at| f64::from_bits(u64_at(&file, at)));
    assert_eq!(doubles, [-1.5, 2.0, 3.0, 0.5]);
    assert_eq!(u64_at(&file, 48), 7);
    assert_eq!(
        [64, 68, 72, 76, 80, 84].map(|at| u32_at(&file, at)),
        [1, 0, 0, 2, 3, 4]
    );
    assert_eq!((u64_at(&file, 88), u32_at(&file, 96)), (120, 1));
    assert_eq!((u64_at(&file, 104), u32_at(&file, 112)), (128, 8));
    assert_eq!(u32_at(&file, 100), crc32fast::hash(&file[120..128]));
    assert_eq!(u32_at(&file, 116), crc32fast::hash(&file[128..]));
    // Packed nodes: the states of the coder, and whatever symbols leave.
    assert_eq!((file.len(), crc32fast::hash(&file)), (140, 2_611_959_561));
}

#[test]
fn brick_file_of_two_chunks() {
    let chunk = |mask| chunk_of(mask, SampleLayout::Centre, 1, false);
    let file = brick_file(
        3,
        1,
        Encoding::Plain,
        &[(UVec3::X, chunk(1)), (UVec3::Y, chunk(0x81))],
    );
    assert_eq!(&file[..20], b"BRKFBRK\0\x01\0\0\0\x03\x01\x01\x03\0\0\0\0");
    let (one, two) = (7 * 10 * 10 * 10, 7 * 18 * 18 * 18);
    let directory = 64 + one + two;
    assert_eq!(
        (u32_at(&file, 20), u32_at(&file, 24), u64_at(&file, 32)),
        (2, 3, directory as u64)
    );
    assert_eq!(u32_at(&file, 28), crc32fast::hash(&file[directory..]));
    assert_eq!(u32_at(&file, 60), crc32fast::hash(&file[..60]));
    assert_eq!(file.len(), directory + 64);
    let entry = directory + 32;
    assert_eq!(
        [0, 8, 16].map(|at| u64_at(&file, entry + at)),
        [2, 0x81, 64 + one as u64]
    );
    assert_eq!(u32_at(&file, entry + 24), two as u32);
    assert_eq!(
        u32_at(&file, entry + 28),
        crc32fast::hash(&file[64 + one..directory])
    );
}

/// Decodes a plain payload by the words of the document, with nothing shared with the code.
fn by_the_document(bytes: &[u8], lo: UVec3, size: UVec3, chunk: &Chunk) {
    let plane = (size.x * size.y * size.z) as usize;
    assert_eq!(bytes.len(), plane * 7);
    let value = |component: usize, p: UVec3| {
        let column = component * plane + ((p.y * size.x + p.x) * size.z) as usize;
        let depth = (size.z - 1 - p.z) as usize;
        bytes[column..=column + depth]
            .iter()
            .fold(0u8, |sum, d| sum.wrapping_add(*d))
    };
    let side = chunk.layout.side();
    for (k, brick) in brick_positions(chunk.mask).enumerate() {
        for i in 0..chunk.layout.samples() as u32 {
            let p = (brick - lo) * 8 + UVec3::new(i % side, i / side % side, i / (side * side));
            let (color, normal) = (
                chunk.brick_color(k)[i as usize],
                chunk.brick_normal(k)[i as usize],
            );
            let stored: [u8; 7] = std::array::from_fn(|c| value(c, p));
            let expected = [
                color[0],
                color[1],
                color[2],
                color[3],
                normal[0] as u8,
                normal[1] as u8,
                normal[2] as u8,
            ];
            assert_eq!(stored, expected, "brick {k}, sample {i}");
        }
    }
}

#[test]
fn chunk_payload() {
    // The bricks (1,1,0), (2,1,0) and (1,2,0) of the picture in the document.
    let bit = |x, y, z| 1u64 << brickfell_formats::morton::encode(UVec3::new(x, y, z));
    let mask = bit(1, 1, 0) | bit(2, 1, 0) | bit(1, 2, 0);
    for (layout, apron) in [(SampleLayout::Corner, 1), (SampleLayout::Centre, 2)] {
        let chunk = chunk_of(mask, layout, 5, false);
        let size = UVec3::new(16 + apron, 16 + apron, 8 + apron);
        let plain = chunk.encode(Encoding::Plain).unwrap();
        by_the_document(&plain, UVec3::new(1, 1, 0), size, &chunk);
    }
}

/// Packed payloads have no layout that a document could spell out: what is written once must be what is written for good, as
/// files depend on every estimate of the model.
#[test]
fn packed_payloads_are_those_of_earlier_builds() {
    let sums = [false, true].map(|axes| {
        [SampleLayout::Corner, SampleLayout::Centre].map(|layout| {
            let mut chunk = chunk_of(0x8000_1003, layout, 5, true);
            for color in &mut chunk.color {
                color[3] = [0, 132, 90, 255][usize::from(color[0] % 4)];
            }
            if axes {
                crate::common::add_opacity(&mut chunk);
            }
            crc32fast::hash(&chunk.encode(Encoding::Packed).unwrap())
        })
    });
    assert_eq!(
        sums,
        [[2_948_932_888, 1_201_628_316], [770_341_509, 3_639_535_337]]
    );
}
