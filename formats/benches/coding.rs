//! What ways of coding chunks cost: bytes and time, on the bricks of a database.
//!
//! `cargo bench -p brickfell-formats -- DIR [WAY]` reads one chunk in eight of all brick files under DIR and prints a table,
//! of one way if it is named. Where WAY is `breakdown`, what the parts of packed payloads take, by level, of one chunk in five;
//! where it is `parents`, what residuals to the coarser level would take.
//! Rates are megabytes of samples in memory per second of one thread.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use brickfell_formats::bricks::{BrickIndex, HEADER_BYTES, decode_header};
use brickfell_formats::chunk::{Chunk, Encoding, brick_positions};
use brickfell_formats::{Costs, Part};

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

fn index(bytes: &[u8]) -> Outcome<BrickIndex> {
    let header = decode_header(&bytes[..HEADER_BYTES.min(bytes.len())], bytes.len() as u64)?;
    let directory = header.directory();
    Ok(header.decode_directory(&bytes[directory.start as usize..directory.end as usize])?)
}

fn chunks(folder: &Path) -> Outcome<Vec<Chunk>> {
    let (mut files, mut chunks) = (Vec::new(), Vec::new());
    brick_files(folder, &mut files)?;
    files.sort();
    for file in files {
        let bytes = fs::read(file)?;
        let index = index(&bytes)?;
        for (k, entry) in index.chunks.iter().enumerate().step_by(STRIDE) {
            let payload = &bytes[entry.offset as usize..][..entry.length as usize];
            chunks.push(index.decode_chunk(k as u32, payload)?);
        }
    }
    Ok(chunks)
}

/// Every so many chunks are taken apart: of all files in one row, so that coarse levels count for what they are.
const BREAKDOWN_STRIDE: usize = 5;

/// Prints what the parts of packed payloads take, by level.
fn breakdown(folder: &Path) -> Outcome<()> {
    let (mut files, mut number) = (Vec::new(), 0);
    brick_files(folder, &mut files)?;
    files.sort();
    let mut levels = BTreeMap::new();
    for file in files {
        let bytes = fs::read(file)?;
        let index = index(&bytes)?;
        for (k, entry) in index.chunks.iter().enumerate() {
            number += 1;
            if number % BREAKDOWN_STRIDE != 0 {
                continue;
            }
            let payload = &bytes[entry.offset as usize..][..entry.length as usize];
            let costs = index
                .decode_chunk(k as u32, payload)?
                .costs()
                .ok_or("a chunk that cannot be coded")?;
            let level: &mut (u32, Costs) = levels.entry(index.header.level).or_default();
            level.0 += 1;
            for k in 0..Part::ALL.len() {
                level.1.bits[k] += costs.bits[k];
                level.1.symbols[k] += costs.symbols[k];
            }
        }
    }
    let names = levels
        .keys()
        .map(|level| format!(" {level} |"))
        .collect::<String>();
    println!("bytes by level (0 is the root), bits of a symbol\n\n| part |{names} all | bits |");
    println!("|---|{}", "---|".repeat(levels.len() + 2));
    for part in Part::ALL {
        let of = |costs: &Costs| (costs.bits[part as usize], costs.symbols[part as usize]);
        let cells: String = levels.values().map(|(_, costs)| bytes(of(costs).0)).collect();
        let (bits, symbols) = levels
            .values()
            .map(|l| of(&l.1))
            .fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        println!(
            "| {part:?} |{cells}{} {:.2} |",
            bytes(bits),
            bits / symbols.max(1) as f64
        );
    }
    let sums: Vec<f64> = levels.values().map(|l| l.1.bits.iter().sum()).collect();
    let cells: String = sums.iter().map(|bits| bytes(*bits)).collect();
    println!("| all |{cells}{} |", bytes(sums.iter().sum()));
    let chunks: String = levels.values().map(|l| format!(" {} |", l.0)).collect();
    println!(
        "| chunks |{chunks} {} |",
        levels.values().map(|l| l.0).sum::<u32>()
    );
    Ok(())
}

/// Components of a sample: colour, normal, opacities.
const COMPONENTS: usize = 10;

fn components(chunk: &Chunk, at: usize) -> [u8; COMPONENTS] {
    let opacity = chunk.opacity.get(at).copied().unwrap_or_default();
    let [normal, opacity] = [chunk.normal[at].map(i8::cast_unsigned), opacity];
    let all = chunk.color[at].into_iter().chain(normal.into_iter().take(3));
    let mut all = all.chain(opacity.into_iter().take(3));
    std::array::from_fn(|_| all.next().unwrap_or_default())
}

/// Compares residuals to the interpolated samples of the coarser level with differences down the columns, both behind zstd: of
/// bricks' own samples, without aprons, which is in favour of the former.
fn parents(folder: &Path) -> Outcome<()> {
    let (mut files, mut all) = (Vec::new(), [const { Vec::new() }; 2]);
    brick_files(folder, &mut files)?;
    for file in &files {
        let bytes = fs::read(file)?;
        let fine = index(&bytes)?;
        let Some(level) = fine.header.level.checked_sub(1) else {
            continue;
        };
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let coarser =
            file.with_file_name(name.replace(&format!("L{:02}", level + 1), &format!("L{level:02}")));
        if !coarser.exists() {
            continue;
        }
        let coarse_bytes = fs::read(coarser)?;
        let coarse = index(&coarse_bytes)?;
        let mut bricks = BTreeMap::new();
        let mut decoded = Vec::new();
        for (k, entry) in coarse.chunks.iter().enumerate() {
            decoded.push(coarse.decode_chunk(
                k as u32,
                &coarse_bytes[entry.offset as usize..][..entry.length as usize],
            )?);
            for (brick, p) in brick_positions(entry.mask).enumerate() {
                bricks.insert((coarse.chunk_corner(entry) + p).to_array(), (k, brick));
            }
        }
        let layout = fine.header.layout;
        let side = layout.side() as usize;
        let (first, zero) = if side == 10 { (1, 0.5) } else { (0, 0.0) };
        for (k, entry) in fine.chunks.iter().enumerate().step_by(STRIDE) {
            let payload = &bytes[entry.offset as usize..][..entry.length as usize];
            let chunk = fine.decode_chunk(k as u32, payload)?;
            let mut planes = [const { [const { Vec::new() }; COMPONENTS] }; 2];
            for (brick, p) in brick_positions(entry.mask).enumerate() {
                let at = fine.chunk_corner(entry) + p;
                let Some((parent, number)) = bricks.get(&(at / 2).to_array()) else {
                    continue;
                };
                let place = |[x, y, z]: [usize; 3]| (z * side + y) * side + x;
                let coarse_at =
                    |p: [usize; 3]| components(&decoded[*parent], number * layout.samples() + place(p));
                for (x, y, down) in (0..512).map(|n| (n / 8 % 8, n / 64, n % 8)) {
                    let own = [x + first, y + first, 7 - down + first];
                    let value = components(&chunk, brick * layout.samples() + place(own));
                    let above = components(
                        &chunk,
                        brick * layout.samples() + place([own[0], own[1], (own[2] + 1).min(side - 1)]),
                    );
                    let place_of: [f32; 3] = std::array::from_fn(|a| {
                        (at.to_array()[a] % 2 * 4) as f32 + (own[a] as f32 - zero) / 2.0 + zero
                    });
                    let mut sum = [0.0f32; COMPONENTS];
                    for corner in 0..8 {
                        let step: [usize; 3] = std::array::from_fn(|a| corner >> a & 1);
                        let share: f32 = (0..3)
                            .map(|a| {
                                if step[a] == 1 {
                                    place_of[a].fract()
                                } else {
                                    1.0 - place_of[a].fract()
                                }
                            })
                            .product();
                        if share > 0.0 {
                            let near = coarse_at(std::array::from_fn(|a| place_of[a] as usize + step[a]));
                            (0..COMPONENTS).for_each(|c| {
                                let v = if (4..7).contains(&c) {
                                    f32::from(near[c].cast_signed())
                                } else {
                                    f32::from(near[c])
                                };
                                sum[c] += share * v;
                            });
                        }
                    }
                    for c in 0..COMPONENTS {
                        let expected = sum[c].round() as i32 as u8;
                        planes[0][c].push(value[c].wrapping_sub(expected));
                        planes[1][c].push(value[c].wrapping_sub(above[c]));
                    }
                }
            }
            for (all, planes) in all.iter_mut().zip(planes) {
                all.push(planes.concat());
            }
        }
    }
    println!("| own samples of bricks | bytes behind zstd 19 |\n|---|---|");
    for (name, all) in ["residuals to the parent", "differences"].iter().zip(&all) {
        let bytes = all
            .iter()
            .map(|planes| Ok(zstd::bulk::compress(planes, 19)?.len()));
        println!("| {name} | {} |", bytes.sum::<Outcome<usize>>()?);
    }
    Ok(())
}

fn bytes(bits: f64) -> String {
    format!(" {:.0} |", bits / 8.0)
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
    if only.as_deref() == Some("breakdown") {
        return breakdown(Path::new(&folder));
    }
    if only.as_deref() == Some("parents") {
        return parents(Path::new(&folder));
    }
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
