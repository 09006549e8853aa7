//! Any bytes, sealed with right checksums, as a binary octree: no panic, and what is read is written to the same bytes.
#![no_main]

use brickfell_formats::{octree_binary, octree_xml};
use libfuzzer_sys::fuzz_target;

/// Gives the file its magic, version and checksums.
fn seal(file: &mut [u8]) {
    if file.len() < 88 {
        return;
    }
    file[..8].copy_from_slice(&octree_binary::MAGIC);
    file[8..12].copy_from_slice(&octree_binary::VERSION.to_le_bytes());
    let levels = usize::from(file[12]) + 1;
    let table_end = 88 + 16 * levels;
    if file.len() < table_end {
        return;
    }
    let mut offset = table_end;
    for entry in (88..table_end).step_by(16) {
        // Where a level ends is free, within the file; the last ends with it.
        let bytes = usize::from(file[entry]) | usize::from(file[entry + 1]) << 8;
        let end = if entry + 16 == table_end { file.len() } else { file.len().min(offset + bytes) };
        let crc = file.get(offset..end).map_or(0, crc32fast::hash);
        file[entry..entry + 8].copy_from_slice(&(offset as u64).to_le_bytes());
        file[entry + 12..entry + 16].copy_from_slice(&crc.to_le_bytes());
        offset = end;
    }
    let mut crc = crc32fast::Hasher::new();
    crc.update(&file[..56]);
    crc.update(&file[64..table_end]);
    let crc = crc.finalize();
    file[56..60].copy_from_slice(&crc.to_le_bytes());
}

fuzz_target!(|data: &[u8]| {
    let _ = octree_binary::decode(data);
    let mut file = data.to_vec();
    seal(&mut file);
    if let Ok(tree) = octree_binary::decode(&file) {
        let again = octree_binary::encode(&tree).expect("a tree that was read is valid");
        assert_eq!(octree_binary::decode(&again).as_ref(), Ok(&tree));
        let xml = octree_xml::encode(&tree).expect("valid");
        assert_eq!(octree_xml::decode(xml.as_bytes()), Ok(tree));
    }
});
