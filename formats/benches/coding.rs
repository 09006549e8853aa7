//! What ways of coding chunks cost: bytes and time, on the bricks of a database.
//!
//! `cargo bench -p brickfell-formats -- DIR [WAY]` reads one chunk in eight of all brick files under DIR and prints a table,
//! of one way if it is named.
//! Rates are megabytes of samples in memory per second of one thread.

use std::error::Error;
use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use brickfell_formats::bricks::{HEADER_BYTES, decode_header};
use brickfell_formats::chunk::{Chunk, Encoding};

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Seconds that this thread has had a core, so that what else runs does not count.
fn busy() -> Outcome<f64> {
    let all = fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds = all.split(' ').next().unwrap_or_default();
    Ok(nanoseconds.parse::<f64>()? * 1e-9)
}

/// Every so many chunks of a file are read.
const STRIDE: usize = 8;

fn brick_files(folder: &Path, found: &mut Vec<PathBuf>) -> Outcome<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            brick_files(&path, found)?;
        } else if path.extension().is_some_and(|e| e == "brk") {
            found.push(path);
        }
    }
    Ok(())
}

fn chunks(folder: &Path) -> Outcome<Vec<Chunk>> {
    let (mut files, mut chunks) = (Vec::new(), Vec::new());
    brick_files(folder, &mut files)?;
    files.sort();
    for file in files {
        let bytes = fs::read(file)?;
        let header = decode_header(&bytes[..HEADER_BYTES.min(bytes.len())], bytes.len() as u64)?;
        let directory = header.directory();
        let index = header.decode_directory(&bytes[directory.start as usize..directory.end as usize])?;
        for (k, entry) in index.chunks.iter().enumerate().step_by(STRIDE) {
            let payload = &bytes[entry.offset as usize..][..entry.length as usize];
            chunks.push(index.decode_chunk(k as u32, payload)?);
        }
    }
    Ok(chunks)
}

/// A way to code chunks.
struct Way {
    name: &'static str,
    encode: fn(&Chunk) -> Outcome<Vec<u8>>,
    decode: fn(&Chunk, &[u8]) -> Outcome<Chunk>,
}

fn plain(chunk: &Chunk) -> Outcome<Vec<u8>> {
    Ok(chunk.encode(Encoding::Plain)?)
}

fn unpack(like: &Chunk, bytes: &[u8], encoding: Encoding) -> Outcome<Chunk> {
    Ok(Chunk::decode(
        bytes,
        like.mask,
        like.layout,
        like.layers(),
        encoding,
    )?)
}

/// More than any chunk has without compression.
const MOST: usize = 1 << 20;

const WAYS: [Way; 5] = [
    Way {
        name: "differences",
        encode: plain,
        decode: |c, b| unpack(c, b, Encoding::Plain),
    },
    Way {
        name: "differences, lz4",
        encode: |c| Ok(lz4_flex::compress_prepend_size(&plain(c)?)),
        decode: |c, b| unpack(c, &lz4_flex::decompress_size_prepended(b)?, Encoding::Plain),
    },
    Way {
        name: "differences, zstd 3",
        encode: |c| Ok(zstd::bulk::compress(&plain(c)?, 3)?),
        decode: |c, b| unpack(c, &zstd::bulk::decompress(b, MOST)?, Encoding::Plain),
    },
    Way {
        name: "differences, zstd 19",
        encode: |c| Ok(zstd::bulk::compress(&plain(c)?, 19)?),
        decode: |c, b| unpack(c, &zstd::bulk::decompress(b, MOST)?, Encoding::Plain),
    },
    Way {
        name: "packed",
        encode: |c| Ok(c.encode(Encoding::Packed)?),
        decode: |c, b| unpack(c, b, Encoding::Packed),
    },
];

fn main() -> Outcome<()> {
    // Cargo adds flags of its own.
    let mut arguments = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let (Some(folder), only) = (arguments.next(), arguments.next()) else {
        println!("give the folder of a database: cargo bench -p brickfell-formats -- DIR [WAY]");
        return Ok(());
    };
    let chunks = chunks(Path::new(&folder))?;
    let memory: usize = chunks.iter().map(Chunk::memory).sum();
    println!("{} chunks, {memory} bytes in memory", chunks.len());
    println!("| way | bytes | encode MB/s | decode MB/s |\n|---|---|---|---|");
    for way in WAYS.iter().filter(|w| only.as_ref().is_none_or(|o| w.name == o)) {
        let start = busy()?;
        let coded: Vec<Vec<u8>> = chunks.iter().map(way.encode).collect::<Result<_, _>>()?;
        let encode = busy()? - start;
        let start = busy()?;
        for (chunk, bytes) in chunks.iter().zip(&coded) {
            black_box((way.decode)(chunk, bytes)?);
        }
        let decode = busy()? - start;
        for (chunk, bytes) in chunks.iter().zip(&coded) {
            assert!(
                (way.decode)(chunk, bytes)? == *chunk,
                "{}: samples differ",
                way.name
            );
        }
        let bytes: usize = coded.iter().map(Vec::len).sum();
        let rate = |seconds: f64| memory as f64 / 1e6 / seconds;
        println!(
            "| {} | {bytes} | {:.0} | {:.0} |",
            way.name,
            rate(encode),
            rate(decode)
        );
    }
    Ok(())
}
