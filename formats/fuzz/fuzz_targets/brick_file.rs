//! Any bytes, sealed with right checksums, as a brick file: no panic, and chunks that are read round-trip, as far as their encoding
//! has no loss.
#![no_main]

use brickfell_formats::bricks;
use brickfell_formats::chunk::{Chunk, Encoding};
use libfuzzer_sys::fuzz_target;

/// Gives the file its magic, version, known layers and encoding, and checksums, with the directory at its end.
fn seal(file: &mut [u8]) {
    let len = file.len();
    if len < bricks::HEADER_BYTES {
        return;
    }
    file[..8].copy_from_slice(&bricks::MAGIC);
    file[8..12].copy_from_slice(&bricks::VERSION.to_le_bytes());
    file[15] = if file[15] & 1 == 0 { 0b11 } else { 0b111 };
    file[16] = [0, 4, 5][usize::from(file[16]) % 3];
    file[17..20].fill(0);
    file[40..60].fill(0);
    let chunks = usize::from(file[20] % 8).min((len - bricks::HEADER_BYTES) / bricks::ENTRY_BYTES);
    let directory = len - chunks * bricks::ENTRY_BYTES;
    let (mut offset, mut count) = (bricks::HEADER_BYTES, 0);
    for k in 0..chunks {
        let entry = directory + k * bricks::ENTRY_BYTES;
        let asked = usize::from(u16::from_le_bytes([file[entry + 24], file[entry + 25]]));
        let length = if k + 1 == chunks {
            directory - offset
        } else {
            asked.min(directory - offset)
        };
        let crc = crc32fast::hash(&file[offset..offset + length]);
        file[entry + 16..entry + 24].copy_from_slice(&(offset as u64).to_le_bytes());
        file[entry + 24..entry + 28].copy_from_slice(&(length as u32).to_le_bytes());
        file[entry + 28..entry + 32].copy_from_slice(&crc.to_le_bytes());
        count += file[entry + 8..entry + 16]
            .iter()
            .map(|b| b.count_ones())
            .sum::<u32>();
        offset += length;
    }
    file[20..24].copy_from_slice(&(chunks as u32).to_le_bytes());
    file[24..28].copy_from_slice(&count.to_le_bytes());
    let crc = crc32fast::hash(&file[directory..]);
    file[28..32].copy_from_slice(&crc.to_le_bytes());
    file[32..40].copy_from_slice(&(directory as u64).to_le_bytes());
    let crc = crc32fast::hash(&file[..60]);
    file[60..64].copy_from_slice(&crc.to_le_bytes());
}

fn read(file: &[u8]) {
    let Ok(header) = bricks::decode_header(file, file.len() as u64) else {
        return;
    };
    let range = header.directory();
    let Ok(index) = header.decode_directory(&file[range.start as usize..range.end as usize]) else {
        return;
    };
    for (k, entry) in index.chunks.iter().enumerate() {
        let bytes = &file[entry.offset as usize..][..entry.length as usize];
        if let Ok(chunk) = index.decode_chunk(k as u32, bytes) {
            let again = chunk
                .encode(header.encoding)
                .expect("a chunk that was read is consistent");
            let again = decode(&index, k, &again).expect("what was written is read");
            match header.encoding {
                // Blocks lose something each time they are made, but not whether there is anything.
                Encoding::Blocks => {
                    let is_empty = |chunk: &Chunk| chunk.color.iter().map(|c| c[3] == 0).collect::<Vec<_>>();
                    assert_eq!(is_empty(&again), is_empty(&chunk));
                }
                _ => assert_eq!(again, chunk),
            }
        }
        assert_eq!(index.locate(entry.first_brick), Some((k as u32, 0)));
    }
}

fn decode(index: &bricks::BrickIndex, k: usize, bytes: &[u8]) -> Option<Chunk> {
    let mask = index.chunks.get(k)?.mask;
    let header = index.header;
    Chunk::decode(bytes, mask, header.layout, header.layers, header.encoding).ok()
}

fuzz_target!(|data: &[u8]| {
    read(data);
    let mut file = data.to_vec();
    seal(&mut file);
    read(&file);
});
