//! World files (`.tfw`, `.pgw`, `.jgw`, `.wld`, …): six lines that place the pixels of the image beside them.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec2;

use super::error::InputError;
use super::georef::GeoTransform;

/// Largest world file that is read; a real one has some 100 bytes.
const MAX_BYTES: u64 = 64 * 1024;

/// The transform from the world file beside `image`, if there is one.
pub(crate) fn read_beside(image: &Path) -> Result<Option<GeoTransform>, InputError> {
    match candidates(image).into_iter().find(|path| path.is_file()) {
        Some(path) => read(&path).map(Some),
        None => Ok(None),
    }
}

/// Names under which programs look for the world file of an image, most usual first.
fn candidates(image: &Path) -> Vec<PathBuf> {
    let mut endings = Vec::new();
    if let Some(extension) = image.extension().and_then(|e| e.to_str()) {
        let mut chars = extension.chars();
        if let (Some(first), Some(last)) = (chars.next(), chars.next_back()) {
            endings.push(format!("{first}{last}w"));
        }
        endings.push(format!("{extension}w"));
    }
    endings.push("wld".into());
    let mut names = Vec::new();
    for ending in endings {
        for ending in [ending.to_lowercase(), ending.to_uppercase()] {
            names.push(image.with_extension(ending));
        }
    }
    for ending in ["w", ".wld"] {
        let mut full: OsString = image.as_os_str().to_owned();
        full.push(ending);
        names.push(full.into());
    }
    names
}

fn read(path: &Path) -> Result<GeoTransform, InputError> {
    let size = fs::metadata(path).map_err(|e| InputError::io(path, e))?.len();
    if size > MAX_BYTES {
        return Err(InputError::georef(
            path,
            "a world file has six numbers; this file is too long",
        ));
    }
    let bytes = fs::read(path).map_err(|e| InputError::io(path, e))?;
    let text = String::from_utf8_lossy(&bytes);
    let mut numbers = Vec::new();
    for (index, line) in text.lines().enumerate() {
        for word in line.split_whitespace() {
            match word.parse::<f64>() {
                Ok(number) if number.is_finite() => numbers.push(number),
                _ => {
                    return Err(InputError::line(
                        path,
                        index + 1,
                        format!("'{word}' is not a finite number"),
                    ));
                }
            }
        }
    }
    let &[a, d, b, e, c, f] = numbers.as_slice() else {
        return Err(InputError::georef(
            path,
            format!("a world file has six numbers, this one {}", numbers.len()),
        ));
    };
    let (column, row) = (DVec2::new(a, d), DVec2::new(b, e));
    // The last two numbers are the centre of the first pixel.
    let transform = GeoTransform {
        origin: DVec2::new(c, f) - 0.5 * (column + row),
        column,
        row,
    };
    transform.checked(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_of_the_first_pixel_becomes_its_corner() {
        let dir = tempfile::tempdir().unwrap();
        let image = dir.path().join("a.jpeg");
        for name in ["a.jgw", "a.jpegw", "a.wld", "a.JGW", "a.jpegw"] {
            let path = dir.path().join(name);
            fs::write(&path, "2.0\r\n0\r\n0\r\n-2.0\r\n1001\r\n499\r\n").unwrap();
            let transform = read_beside(&image).unwrap().unwrap();
            assert_eq!(transform.at(DVec2::ZERO), DVec2::new(1000.0, 500.0), "{name}");
            assert_eq!(transform.at(DVec2::new(1.0, 1.0)), DVec2::new(1002.0, 498.0));
            fs::remove_file(&path).unwrap();
        }
        assert_eq!(read_beside(&image).unwrap(), None);
    }

    #[test]
    fn faults_name_file_and_line() {
        let dir = tempfile::tempdir().unwrap();
        let image = dir.path().join("a.png");
        let path = dir.path().join("a.pgw");
        for (text, part) in [
            ("1\n0\nNaN\n-1\n0\n0", "a.pgw: line 3"),
            ("1\n0\n0", "six numbers"),
            ("0\n0\n0\n0\n5\n5\n", "a.pgw"),
        ] {
            fs::write(&path, text).unwrap();
            let message = read_beside(&image).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
