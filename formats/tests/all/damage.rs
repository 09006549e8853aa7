//! Damaged and forged files: every one is an error, none panics or makes the reader allocate what it claims.

use crate::common::{Branch, brick_file, chunk_of, flatten};
use brickfell_formats::chunk::{Chunk, Encoding};
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::octree::{Octree, decode_any};
use brickfell_formats::scene::Scene;
use brickfell_formats::{FormatError, Place, bricks, morton, octree_binary, octree_xml};
use proptest::prelude::*;

/// Reads a brick file whole, as `check` would.
fn read_bricks(file: &[u8]) -> Result<Vec<Chunk>, FormatError> {
    let header = bricks::decode_header(file, file.len() as u64)?;
    let range = header.directory();
    let index = header.decode_directory(&file[range.start as usize..range.end as usize])?;
    let chunks = index.chunks.iter().enumerate();
    chunks
        .map(|(k, c)| index.decode_chunk(k as u32, &file[c.offset as usize..][..c.length as usize]))
        .collect()
}

fn small_bricks(encoding: Encoding) -> Vec<u8> {
    let chunks = [0, 3, 5].map(|c| {
        (
            morton::decode(c),
            chunk_of(1 << (c % 2), SampleLayout::Corner, c, true),
        )
    });
    brick_file(2, 1, encoding, &chunks)
}

fn small_octree() -> Octree {
    let leaf = |k| Branch {
        color: (k % 3 > 0).then_some([k, 2, 3, 4]),
        children: Vec::new(),
    };
    let inner = |k| Branch {
        color: Some([9, 8, 7, k]),
        children: (0..8).map(leaf).collect(),
    };
    let root = Branch {
        color: None,
        children: (0..8)
            .map(|k| if k % 4 == 0 { inner(k) } else { leaf(k) })
            .collect(),
    };
    let text = "<GigaVoxelsOctTree X='1' Y='2' Z='3' DeltaX='1' DeltaY='1' DeltaZ='1' VolumeXSize='64' VolumeYSize='64' \
        VolumeZSize='64' BrickXSize='8' BrickYSize='8' BrickZSize='8' Binary='NO' SurfaceMaxX='9' SurfaceVoxels='7'>\
        <Node Type='CONST' Color='#00000000'/></GigaVoxelsOctTree>";
    let header = octree_xml::decode(text.as_bytes()).expect("a valid tree").header;
    Octree {
        header,
        levels: flatten(&root, header.depth),
    }
}

fn every_damage_is_an_error<T>(file: &[u8], read: impl Fn(&[u8]) -> Result<T, FormatError>) {
    read(file).map(|_| ()).expect("the undamaged file");
    let mut damaged = file.to_vec();
    for bit in 0..file.len() * 8 {
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(
            read(&damaged).is_err(),
            "bit {} of byte {} flipped goes unnoticed",
            bit % 8,
            bit / 8
        );
        damaged[bit / 8] ^= 1 << (bit % 8);
    }
    for len in 0..file.len() {
        assert!(read(&file[..len]).is_err(), "cut to {len} bytes");
    }
    for more in [1, 32, 64] {
        damaged.resize(file.len() + more, 0);
        assert!(read(&damaged).is_err(), "{more} bytes appended");
    }
}

#[test]
fn every_flipped_bit_and_every_cut_of_an_octree_file_is_an_error() {
    every_damage_is_an_error(&octree_binary::encode(&small_octree()).unwrap(), decode_any);
}

#[test]
fn every_flipped_bit_and_every_cut_of_a_brick_file_is_an_error() {
    every_damage_is_an_error(&small_bricks(Encoding::Packed), read_bricks);
    let one = [(morton::decode(5), chunk_of(1, SampleLayout::Corner, 5, true))];
    every_damage_is_an_error(&brick_file(2, 1, Encoding::Blocks, &one), read_bricks);
    every_damage_is_an_error(&brick_file(0, 2, Encoding::Plain, &[]), read_bricks);
}

fn seal_octree(file: &mut [u8]) {
    let table_end = 88 + 16 * (usize::from(file[12]) + 1);
    if let Some(table) = file.get(64..table_end) {
        let mut crc = crc32fast::Hasher::new();
        crc.update(&file[..56]);
        crc.update(table);
        let crc = crc.finalize();
        file[56..60].copy_from_slice(&crc.to_le_bytes());
    }
}

fn seal_bricks(file: &mut [u8]) {
    let directory = u64::from_le_bytes(file[32..40].try_into().expect("eight bytes")) as usize;
    if let Some(directory) = file.get(directory..) {
        let crc = crc32fast::hash(directory);
        file[28..32].copy_from_slice(&crc.to_le_bytes());
    }
    let crc = crc32fast::hash(&file[..60]);
    file[60..64].copy_from_slice(&crc.to_le_bytes());
}

#[test]
fn codes_of_later_versions_are_errors() {
    let octree = octree_binary::encode(&small_octree()).unwrap();
    for (at, value, part) in [
        (0, b'X', "line 1, column"),
        (7, 1, "wrong magic"),
        (8, 1, "octree version 1 is unknown (this reads 2)"),
        (11, 1, "octree version 16777218 is unknown"),
        (12, 21, "depth 21 is above 20"),
        (13, 2, "sample layout 2 is unknown"),
        (14, 0, "opacity gain 0 is unknown"),
        (14, 3, "opacity gain 3 is unknown"),
        (15, 1, "unused bytes are not zero"),
        (47, 0xff, "voxel size"),
    ] {
        let mut file = octree.clone();
        file[at] = value;
        seal_octree(&mut file);
        let e = decode_any(&file).unwrap_err().to_string();
        assert!(e.contains(part), "{at}: {e}");
    }
    let bricks = small_bricks(Encoding::Packed);
    for (at, value, part) in [
        (0, b'X', "wrong magic"),
        (8, 2, "brick file version 2 is unknown (this reads 1)"),
        (12, 21, "level 21 is unknown"),
        (13, 2, "sample layout 2 is unknown"),
        (14, 3, "chunk size 3 is unknown"),
        (15, 15, "layer set 15 is unknown"),
        (15, 1, "layer set 1 is unknown"),
        (16, 1, "encoding 1 is unknown"),
        (16, 2, "encoding 2 is unknown"),
        (16, 4, "encoding 4 is unknown"),
        (16, 7, "encoding 7 is unknown"),
        (17, 1, "unused bytes are not zero"),
        (59, 1, "unused bytes are not zero"),
        (20, 2, "the directory ends at byte"),
        (24, 4, "4 bricks declared, 3 listed"),
        (39, 0xff, "the directory ends at byte"),
    ] {
        let mut file = bricks.clone();
        file[at] = value;
        seal_bricks(&mut file);
        let e = read_bricks(&file).unwrap_err().to_string();
        assert!(e.contains(part), "{at}: {e}");
    }
}

/// Whatever a forger with a checksum at hand writes into one byte of the header, table or directory: no panic, and no
/// allocation beyond the file (counts of 2³² entries would end the test).
#[test]
fn forged_bytes_do_not_panic_or_allocate() {
    let octree = octree_binary::encode(&small_octree()).unwrap();
    let valid = decode_any(&octree).unwrap();
    for at in 8..octree.len() {
        for value in 0..=255 {
            let mut file = octree.clone();
            file[at] = value;
            seal_octree(&mut file);
            if let Ok(tree) = decode_any(&file) {
                tree.validate().unwrap();
                assert_eq!(tree.levels, valid.levels, "byte {at} = {value}");
            }
        }
    }
    let bricks = small_bricks(Encoding::Packed);
    let directory = bricks.len() - 3 * 32;
    for at in (8..64).chain(directory..bricks.len()) {
        for value in 0..=255 {
            let mut file = bricks.clone();
            file[at] = value;
            seal_bricks(&mut file);
            if let Ok(chunks) = read_bricks(&file) {
                assert_eq!(
                    chunks.iter().map(Chunk::bricks).sum::<usize>(),
                    3,
                    "byte {at} = {value}"
                );
            }
        }
    }
}

#[test]
fn payloads_that_leave_gaps_or_are_too_long_are_errors() {
    let file = small_bricks(Encoding::Plain);
    let directory = file.len() - 3 * 32;
    // More bytes before the directory: unclaimed, or claimed by the last payload.
    let widened = |more: usize, claim: bool| {
        let mut wide = file.clone();
        wide.splice(directory..directory, vec![0; more]);
        let at = directory + more;
        wide[32..40].copy_from_slice(&(at as u64).to_le_bytes());
        let length = at + 2 * 32 + 24;
        if claim {
            let claimed =
                u32::from_le_bytes(wide[length..length + 4].try_into().expect("four bytes")) + more as u32;
            wide[length..length + 4].copy_from_slice(&claimed.to_le_bytes());
        }
        seal_bricks(&mut wide);
        read_bricks(&wide).unwrap_err().message
    };
    assert!(widened(64, false).contains("the payloads end here"));
    assert!(widened(64, true).contains("checksum of chunk 2"));
    assert!(widened(bricks::MAX_PAYLOAD as usize, true).contains("directory entry is not plausible"));
}

#[test]
fn trees_that_break_an_invariant_are_neither_written_nor_valid() {
    let good = small_octree();
    good.validate().unwrap();
    let broken = |part: &str, breaking: &dyn Fn(&mut Octree)| {
        let mut tree = good.clone();
        breaking(&mut tree);
        let e = octree_binary::encode(&tree).unwrap_err();
        assert!(e.message.contains(part), "{part}: {e}");
        assert_eq!(tree.validate(), Err(e.clone()));
        assert_eq!(octree_xml::encode(&tree), Err(e));
    };
    broken("level 1, node 4: child tile out of order", &|t| {
        t.levels[1][4].structure ^= 2
    });
    broken("level 0, node 0: brick index out of order", &|t| {
        t.levels[0][0].data = 1
    });
    broken("level 1, node 1: a terminal node has a child tile", &|t| {
        t.levels[1][1].structure |= 1
    });
    broken("level 2 has 8 nodes, 16 are referred to", &|t| {
        t.levels[2].truncate(8)
    });
    broken("level 3 has 8 nodes, 0 are referred to", &|t| {
        t.levels[3] = t.levels[2][..8].to_vec()
    });
    broken("a level is missing", &|t| t.levels.truncate(3));
    broken("has children below the deepest level", &|t| {
        t.header.depth = 1;
        t.header.surface_bounds = Default::default();
        t.levels.truncate(2);
    });
    broken("voxel size 0 is not usable", &|t| t.header.voxel_size = 0.0);
    broken("origin", &|t| t.header.origin.x = f64::NAN);
    broken("surface bounds", &|t| t.header.surface_bounds[1].x = 65);
}

#[test]
fn every_cut_of_an_xml_file_is_an_error_inside_it() {
    let octree = octree_xml::encode(&small_octree()).unwrap();
    let scene = "<?xml version=\"1.0\"?>\n<OctTreeGroup Crs=\"é &amp;\">\n <!-- one -->\n <OctTreeGroup MinX='0' MinY='0' \
        MinZ='0' MaxX='1' MaxY='1' MaxZ='1'>\n  <PagedOctTree CenterX='1' CenterY='2' CenterZ='3' Radius='4' \
        TreeFile='höhe.oct'/>\n </OctTreeGroup>\n</OctTreeGroup>";
    Scene::parse(scene.as_bytes()).unwrap();
    for len in 0..scene.len() {
        let e = Scene::parse(&scene.as_bytes()[..len]).unwrap_err();
        assert!(
            matches!(e.place, Place::Line { line: 1..=8, .. }),
            "cut to {len}: {e}"
        );
    }
    for len in 0..octree.trim_end().len() {
        octree_xml::decode(&octree.as_bytes()[..len]).unwrap_err();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn changed_xml_does_not_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0usize..12), 1..4),
        as_scene in any::<bool>(),
    ) {
        let scene = "<OctTreeGroup Version='1' Compressed='NO'>\n<PagedOctTree CenterX='1' CenterY='2' CenterZ='3' \
            Radius='4' TreeFile='a.oct'/>\n<OctTreeGroup/></OctTreeGroup>";
        let text = if as_scene { scene.to_string() } else { octree_xml::encode(&small_octree()).unwrap() };
        let mut bytes = text.into_bytes();
        let pieces: [&[u8]; 12] = [
            b"<", b">", b"/>", b"'", b"\"", b"&", b"\0", b"\xff", b"1e999", b"<Node Type='CONST'>", b"</Node>", b"",
        ];
        for (from, to, piece) in changes {
            let (a, b) = (from.index(bytes.len() + 1), to.index(bytes.len() + 1));
            let range = a.min(b)..a.max(b).min(a.min(b) + 40);
            bytes.splice(range, pieces[piece].iter().copied());
        }
        let error = if as_scene { Scene::parse(&bytes).err() } else { octree_xml::decode(&bytes).err() };
        if let Some(e) = error {
            prop_assert!(!e.to_string().contains(char::is_control), "{:?}", e.to_string());
            prop_assert!(e.place != Place::File, "{}", e);
        }
    }
}
