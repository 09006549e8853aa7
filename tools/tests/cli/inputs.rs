//! Small inputs, whole and broken: hilly ground 32 m wide with a picture, and a textured box on it.

use std::fs;
use std::path::Path;

use image::{ImageBuffer, Luma, Rgb, RgbImage};

/// Pixels of the height map per axis, half a metre each.
const PIXELS: u32 = 64;

/// Writes `heights.png`, `imagery.png` (with world files), `box.obj`, `box.mtl`, `wall.png`.
pub(crate) fn write(dir: &Path) {
    fs::create_dir_all(dir).expect("a folder");
    let heights = ImageBuffer::from_fn(PIXELS, PIXELS, |x, y| {
        let (x, y) = (f64::from(x), f64::from(y));
        Luma([(1000.0 + 400.0 * ((x * 0.15).sin() + (y * 0.11).cos())) as u16])
    });
    heights.save(dir.join("heights.png")).expect("a height map");
    fs::write(dir.join("heights.png.aux.xml"), PAM).expect("a side file");
    let imagery = RgbImage::from_fn(PIXELS, PIXELS, |x, y| {
        Rgb([40 + 2 * x as u8, 90, 30 + 2 * y as u8])
    });
    imagery.save(dir.join("imagery.png")).expect("a picture");
    for name in ["heights.pgw", "imagery.pgw"] {
        fs::write(dir.join(name), "0.5\n0\n0\n-0.5\n0.25\n31.75\n").expect("a world file");
    }
    let wall = RgbImage::from_fn(8, 8, |x, y| {
        if (x + y) % 2 == 0 {
            Rgb([200, 60, 40])
        } else {
            Rgb([90, 90, 90])
        }
    });
    wall.save(dir.join("wall.png")).expect("a texture");
    fs::write(dir.join("box.mtl"), "newmtl wall\nmap_Kd wall.png\n").expect("materials");
    fs::write(dir.join("box.obj"), box_obj()).expect("a mesh");
}

/// A code of the height map is a centimetre.
const PAM: &str = "<PAMDataset><PAMRasterBand band=\"1\"><Scale>0.01</Scale></PAMRasterBand></PAMDataset>\n";

/// A closed box from (10, 10, 5) to (14, 13, 20).
pub(crate) fn box_obj() -> String {
    let mut text = "mtllib box.mtl\nusemtl wall\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n".to_string();
    for i in 0..8 {
        let pick = |bit: i32, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        let corner = [pick(0, 10.0, 14.0), pick(1, 10.0, 13.0), pick(2, 5.0, 20.0)];
        text += &format!("v {} {} {}\n", corner[0], corner[1], corner[2]);
    }
    for face in [
        [1, 3, 4, 2],
        [5, 6, 8, 7],
        [1, 2, 6, 5],
        [3, 7, 8, 4],
        [1, 5, 7, 3],
        [2, 4, 8, 6],
    ] {
        let [a, b, c, d] = face;
        text += &format!("f {a}/1 {b}/2 {c}/3 {d}/4\n");
    }
    text
}

/// The first bytes of a PNG file that claims this size, and nothing after them.
pub(crate) fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let mut chunk = b"IHDR".to_vec();
    chunk.extend(width.to_be_bytes());
    chunk.extend(height.to_be_bytes());
    chunk.extend([16, 0, 0, 0, 0]);
    let mut file = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
    let crc = crc32(&chunk);
    file.extend(chunk);
    file.extend(crc.to_be_bytes());
    file
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())
        })
    })
}
