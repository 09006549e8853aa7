//! Suite `builder`: how fast `brickfell build` is, what memory it takes, how large the database is.
//!
//! Each row is one child process of this program, at default options and `--memory 1GiB`; its time is that of the whole
//! command, reading the input included, and its peak memory what the system says about it when it ends. Both scenes are the
//! same smooth relief: as a mesh with vertex colours, as builders of octrees from meshes are measured with, and as a height map
//! under a picture with detail down to its pixels.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use brickfell_formats::octree_binary;
use brickfell_pager::{FolderStore, Store};
use brickfell_runtime::terrain::Terrain;
use glam::DVec2;
use image::{ImageBuffer, Luma, Rgb};
use serde_json::json;
use wait4::Wait4;

use super::scenes::hill_color;
use super::{Row, Settings, row};
use crate::commands::CommandError;
use crate::commands::database::folder_bytes;
use crate::noise::{cell, lerp};

/// Side of the scene, metres.
const SIZE: f64 = 102.4;
/// Lowest to highest point, metres.
const RELIEF: f64 = 30.0;
/// Cells of the noise across the scene.
const CELLS: f64 = 16.0;
/// Quads of the mesh, and pixels of the height map, across the scene.
const QUADS: u32 = 1024;
/// Pixels of the picture across the scene: 5 cm each.
const PICTURE: u32 = 2048;
const SEED: u64 = 11;
/// Errors allowed beside none, in steps, and the resolution at which they are.
const ERRORS: [u8; 4] = [1, 2, 4, 8];
const ERROR_AT: u32 = 1024;
/// The memory limit that builds are given.
const MEMORY: &str = "1GiB";

/// Height above the lowest point, metres: value noise, smooth to the second derivative.
fn height(p: DVec2) -> f64 {
    let q = p * (CELLS / SIZE);
    let base = q.floor();
    let f = q - base;
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |dx, dy| cell(SEED, base.x as i64 + dx, base.y as i64 + dy);
    let row = |dy| lerp(corner(0, dy), corner(1, dy), s.x);
    RELIEF * lerp(row(0), row(1), s.y)
}

/// Writes a file under another name and renames it when it is whole: a scene that is there is not made again.
fn once(path: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    if path.exists() {
        return Ok(());
    }
    let partial = path.with_file_name(format!(
        "partial-{}",
        path.file_name().unwrap_or_default().to_string_lossy()
    ));
    write(&partial)?;
    fs::rename(partial, path)
}

fn write_mesh(path: &Path) -> io::Result<()> {
    let mut out = BufWriter::new(File::create(path)?);
    let step = SIZE / f64::from(QUADS);
    for y in 0..=QUADS {
        for x in 0..=QUADS {
            let p = DVec2::new(f64::from(x), f64::from(y)) * step;
            let [r, g, b] = hill_color(p).map(|c| f64::from(c) / 255.0);
            let z = height(p);
            writeln!(out, "v {:.4} {:.4} {z:.5} {r:.3} {g:.3} {b:.3}", p.x, p.y)?;
        }
    }
    let row = QUADS + 1;
    for y in 0..QUADS {
        for x in 0..QUADS {
            let a = y * row + x + 1;
            writeln!(
                out,
                "f {a} {} {}\nf {a} {} {}",
                a + 1,
                a + row + 1,
                a + row + 1,
                a + row
            )?;
        }
    }
    out.flush()
}

/// Writes the height map and its picture with their world files.
fn write_heights(folder: &Path) -> io::Result<[PathBuf; 2]> {
    let [heights, picture] = ["heights.png", "picture.png"].map(|name| folder.join(name));
    let at = |x: u32, y: u32, n: u32| {
        let step = SIZE / f64::from(n);
        DVec2::new((f64::from(x) + 0.5) * step, SIZE - (f64::from(y) + 0.5) * step)
    };
    let world = |n: u32| {
        let step = SIZE / f64::from(n);
        let first = 0.5 * step;
        format!("{step}\n0\n0\n-{step}\n{first}\n{}\n", SIZE - first)
    };
    let scale = RELIEF / 65_535.0;
    let side = format!(
        "<PAMDataset><PAMRasterBand band=\"1\"><Offset>0</Offset><Scale>{scale}</Scale></PAMRasterBand></PAMDataset>\n"
    );
    once(&folder.join("heights.png.aux.xml"), |p| fs::write(p, side))?;
    once(&folder.join("heights.pgw"), |p| fs::write(p, world(QUADS)))?;
    once(&folder.join("picture.pgw"), |p| fs::write(p, world(PICTURE)))?;
    once(&heights, |p| {
        let pixels: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_fn(QUADS, QUADS, |x, y| {
            Luma([(height(at(x, y, QUADS)) / scale).round() as u16])
        });
        pixels.save(p).map_err(io::Error::other)
    })?;
    once(&picture, |p| {
        let pixels: ImageBuffer<Rgb<u8>, _> =
            ImageBuffer::from_fn(PICTURE, PICTURE, |x, y| Rgb(hill_color(at(x, y, PICTURE))));
        pixels.save(p).map_err(io::Error::other)
    })?;
    Ok([heights, picture])
}

/// Surface voxels of all trees.
fn surface(out: &Path) -> Result<u64, CommandError> {
    let store: std::sync::Arc<dyn Store> = std::sync::Arc::new(FolderStore::open(out)?);
    let mut voxels = 0;
    for name in &Terrain::open(&store)?.trees {
        let len = store.len(name)?;
        let bytes = store.read(name, 0, len as usize)?;
        voxels += octree_binary::decode_header(&bytes, len)?.header.surface_voxels;
    }
    Ok(voxels)
}

/// Builds in a process of its own: seconds and most memory.
fn measure(
    input: &[&std::ffi::OsStr],
    (voxels, error): (u32, u8),
    out: &Path,
) -> Result<(f64, u64), CommandError> {
    let program = std::env::current_exe()?;
    let mut command = Command::new(program);
    command.arg("build").args(input).arg("--out").arg(out);
    let voxel = SIZE / f64::from(voxels);
    command.args(["--voxel", &voxel.to_string(), "--memory", MEMORY]);
    command.args(["--error", &error.to_string()]);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let start = Instant::now();
    let usage = command.spawn()?.wait4()?;
    let seconds = start.elapsed().as_secs_f64();
    if !usage.status.success() {
        return Err(CommandError::new(
            format!("build ended with {}", usage.status),
            "run the same build by hand to see why",
        ));
    }
    Ok((seconds, usage.rusage.maxrss))
}

/// Suite `builder`.
///
/// # Errors
/// If a scene cannot be written or built.
pub fn rows(settings: &Settings<'_>) -> Result<Vec<Row>, CommandError> {
    let folder = settings.folder.join("builder-input");
    fs::create_dir_all(&folder)?;
    let mesh = folder.join("mesh.obj");
    once(&mesh, write_mesh)?;
    let [heights, picture] = write_heights(&folder)?;
    let scenes: [(&str, Vec<&std::ffi::OsStr>, u64); 2] = [
        ("mesh", vec![mesh.as_os_str()], 2 * u64::from(QUADS).pow(2)),
        (
            "heights",
            vec![
                "--heights".as_ref(),
                heights.as_os_str(),
                "--imagery".as_ref(),
                picture.as_os_str(),
            ],
            0,
        ),
    ];
    let resolutions: &[u32] = if settings.quick {
        &[512, 1024]
    } else {
        &[512, 1024, 2048, 4096]
    };
    let exact = resolutions.iter().map(|n| (*n, 0));
    let all: Vec<(u32, u8)> = exact.chain(ERRORS.map(|error| (ERROR_AT, error))).collect();
    let mut rows = Vec::new();
    for (scene, input, triangles) in &scenes {
        for (n, error) in &all {
            let out = settings.folder.join(format!("builder-{scene}-{n}-{error}"));
            if out.exists() {
                fs::remove_dir_all(&out)?;
            }
            let (seconds, peak) = measure(input, (*n, *error), &out)?;
            let (voxels, bytes, columns) = (surface(&out)?, folder_bytes(&out)?, u64::from(*n).pow(2));
            fs::remove_dir_all(&out)?;
            rows.push(row(json!({
                "scene": scene,
                "resolution": n,
                "error": error,
                "voxels": voxels,
                "triangles": triangles,
                "columns": columns,
                "seconds": seconds,
                "voxels_per_second": voxels as f64 / seconds,
                "peak_rss_bytes": peak,
                "bytes_per_voxel": bytes as f64 / voxels as f64,
                "bytes_per_column": bytes as f64 / columns as f64,
            }))?);
        }
    }
    Ok(rows)
}
