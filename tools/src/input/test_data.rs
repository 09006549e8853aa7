//! Files that several tests need: real data where it is present, and TIFF files put together by hand.

use std::path::PathBuf;

use super::block_cache::RasterCache;
use super::texture_set::TextureSet;

/// A file of the real test data (folder `BRICKFELL_DATA`, or `shared/data` beside the repository), if present.
pub(crate) fn data(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("BRICKFELL_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")),
        PathBuf::from,
    );
    let path = root.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

/// No textures yet, and room for many.
pub(crate) fn textures() -> TextureSet {
    TextureSet::new(&RasterCache::new(
        RasterCache::DEFAULT_BUDGET,
        std::env::temp_dir(),
    ))
}

/// A value of a TIFF tag.
pub(crate) enum TagValue {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
    Ascii(String),
}

/// A little-endian TIFF of one strip (or one strip per plane when `strips` has several) with the given tags added.
pub(crate) fn tiff(width: u32, height: u32, strips: &[&[u8]], tags: Vec<(u16, TagValue)>) -> Vec<u8> {
    tiff_of(width, height, strips, tags, true)
}

fn tiff_of(width: u32, height: u32, parts: &[&[u8]], tags: Vec<(u16, TagValue)>, strips: bool) -> Vec<u8> {
    let mut file = vec![b'I', b'I', 42, 0, 0, 0, 0, 0];
    let mut offsets = Vec::new();
    for part in parts {
        offsets.push(file.len() as u32);
        file.extend_from_slice(part);
    }
    let mut all = vec![
        (256, TagValue::Long(vec![width])),
        (257, TagValue::Long(vec![height])),
        (259, TagValue::Short(vec![1])),
    ];
    if strips {
        let counts = parts.iter().map(|s| s.len() as u32).collect();
        all.push((273, TagValue::Long(offsets)));
        all.push((278, TagValue::Long(vec![height])));
        all.push((279, TagValue::Long(counts)));
    }
    all.extend(tags);
    all.sort_by_key(|(tag, _)| *tag);
    let mut directory = (all.len() as u16).to_le_bytes().to_vec();
    for (tag, value) in &all {
        let (kind, count, mut bytes): (u16, usize, Vec<u8>) = match value {
            TagValue::Short(v) => (3, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            TagValue::Long(v) => (4, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            TagValue::Double(v) => (12, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            TagValue::Ascii(v) => (2, v.len() + 1, [v.as_bytes(), &[0]].concat()),
        };
        if bytes.len() > 4 {
            let at = file.len() as u32;
            file.append(&mut bytes);
            bytes = at.to_le_bytes().to_vec();
        }
        bytes.resize(4, 0);
        directory.extend(tag.to_le_bytes());
        directory.extend(kind.to_le_bytes());
        directory.extend((count as u32).to_le_bytes());
        directory.extend(bytes);
    }
    directory.extend([0; 4]);
    let at = file.len() as u32;
    file[4..8].copy_from_slice(&at.to_le_bytes());
    file.extend(directory);
    file
}

/// An 8-bit RGB + alpha TIFF with one plane per band; `extra` is its `ExtraSamples` value.
pub(crate) fn planar_tiff(width: u32, height: u32, planes: &[&[u8]], extra: u16) -> Vec<u8> {
    let bands = planes.len();
    tiff(
        width,
        height,
        planes,
        vec![
            (258, TagValue::Short(vec![8; bands])),
            (262, TagValue::Short(vec![2])),
            (277, TagValue::Short(vec![bands as u16])),
            (284, TagValue::Short(vec![2])),
            (338, TagValue::Short(vec![extra])),
        ],
    )
}

/// A one-band 32-bit float TIFF.
pub(crate) fn float_tiff(
    width: u32,
    height: u32,
    samples: &[f32],
    mut tags: Vec<(u16, TagValue)>,
) -> Vec<u8> {
    let bytes: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
    tags.extend(float_tags());
    tiff(width, height, &[&bytes], tags)
}

fn float_tags() -> [(u16, TagValue); 4] {
    [(258, 32), (262, 1), (277, 1), (339, 3)].map(|(tag, value)| (tag, TagValue::Short(vec![value])))
}

/// A one-band 32-bit float TIFF in square tiles.
pub(crate) fn tiled_float_tiff(
    width: u32,
    height: u32,
    side: u32,
    sample: impl Fn(u32, u32) -> f32,
    mut tags: Vec<(u16, TagValue)>,
) -> Vec<u8> {
    let corners =
        (0..height.div_ceil(side)).flat_map(|y| (0..width.div_ceil(side)).map(move |x| (x * side, y * side)));
    let tiles: Vec<Vec<u8>> = corners
        .map(|(x, y)| {
            let places = (y..y + side).flat_map(|r| (x..x + side).map(move |c| (c, r)));
            places
                .flat_map(|(c, r)| sample(c.min(width - 1), r.min(height - 1)).to_le_bytes())
                .collect()
        })
        .collect();
    // Offsets: tiles are written one after the other behind the header of 8 bytes.
    let bytes = side * side * 4;
    let count = tiles.len() as u32;
    tags.extend(float_tags());
    tags.push((322, TagValue::Long(vec![side])));
    tags.push((323, TagValue::Long(vec![side])));
    tags.push((324, TagValue::Long((0..count).map(|k| 8 + k * bytes).collect())));
    tags.push((325, TagValue::Long(vec![bytes; tiles.len()])));
    let parts: Vec<&[u8]> = tiles.iter().map(Vec::as_slice).collect();
    tiff_of(width, height, &parts, tags, false)
}
