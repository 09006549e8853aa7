//! MTL material libraries: the statements that a voxel's colour needs.
//!
//! Colours (`Kd`) are sRGB as programs show them. Everything about other ways of shading is skipped.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec2;

use super::error::InputError;
use super::linear::linear_of;

/// A material as the library states it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MtlMaterial {
    pub(crate) name: String,
    /// `Kd` as written, sRGB.
    pub(crate) diffuse: [f32; 3],
    /// `d`, or 1 − `Tr`.
    pub(crate) dissolve: f32,
    pub(crate) color_map: Option<MapRef>,
    pub(crate) alpha_map: Option<MapRef>,
}

/// A texture statement: the file as written and the placement options.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MapRef {
    pub(crate) file: String,
    pub(crate) scale: Vec2,
    pub(crate) offset: Vec2,
}

impl MtlMaterial {
    fn new(name: &str) -> Self {
        MtlMaterial {
            name: name.into(),
            diffuse: [0.8; 3],
            dissolve: 1.0,
            color_map: None,
            alpha_map: None,
        }
    }

    /// Linear-light colour that multiplies the texture. Some programs write a black `Kd` beside a texture and do not
    /// mean a black surface.
    pub(crate) fn color(&self) -> [f32; 4] {
        let [r, g, b] = if self.color_map.is_some() && self.diffuse == [0.0; 3] {
            [1.0; 3]
        } else {
            self.diffuse
        };
        [linear_of(r), linear_of(g), linear_of(b), self.dissolve]
    }
}

/// Reads a library. Statements that are not known are skipped.
pub(crate) fn read(path: &Path) -> Result<Vec<MtlMaterial>, InputError> {
    let bytes = fs::read(path).map_err(|e| InputError::io(path, e))?;
    let text = String::from_utf8_lossy(&bytes);
    let mut materials: Vec<MtlMaterial> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        let fault = |what: String| InputError::line(path, index + 1, what);
        if keyword == "newmtl" {
            materials.push(MtlMaterial::new(rest));
            continue;
        }
        if !matches!(keyword, "Kd" | "d" | "Tr" | "map_Kd" | "map_kd" | "map_d") {
            continue;
        }
        let material = materials
            .last_mut()
            .ok_or_else(|| fault(format!("{keyword} before the first newmtl")))?;
        match keyword {
            "Kd" => {
                let values = numbers(rest).map_err(fault)?;
                material.diffuse = match *values.as_slice() {
                    [r, g, b, ..] => [r, g, b],
                    [grey] => [grey; 3],
                    _ => return Err(fault("Kd needs three numbers".into())),
                };
            }
            "d" | "Tr" => {
                let word = rest.strip_prefix("-halo").unwrap_or(rest);
                let value = numbers(word).map_err(fault)?.first().copied();
                let value = value.ok_or_else(|| fault(format!("{keyword} needs a number")))?;
                material.dissolve = if keyword == "d" { value } else { 1.0 - value }.clamp(0.0, 1.0);
            }
            "map_d" => material.alpha_map = map(rest),
            _ => material.color_map = map(rest),
        }
    }
    Ok(materials)
}

fn numbers(text: &str) -> Result<Vec<f32>, String> {
    text.split_whitespace()
        .map(|word| match word.parse::<f32>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("'{word}' is not a finite number")),
        })
        .collect()
}

/// Splits the options from the file name, which may hold spaces. `None` without a name.
fn map(mut rest: &str) -> Option<MapRef> {
    let mut scale = Vec2::ONE;
    let mut offset = Vec2::ZERO;
    while rest.starts_with('-') {
        let (option, after) = split_word(rest);
        let arguments = match option {
            "-s" | "-o" | "-t" => 3,
            "-mm" => 2,
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-texres" | "-bm" | "-boost" | "-imfchan"
            | "-type" => 1,
            // Not an option but a file whose name starts so.
            _ => break,
        };
        rest = after;
        let mut values = Vec::new();
        for taken in 0..arguments {
            let (word, after) = split_word(rest);
            let number = word.parse::<f32>().ok().filter(|v| v.is_finite());
            // Only the first of up to three numbers is obligatory.
            if word.is_empty() || (taken > 0 && number.is_none()) {
                break;
            }
            values.extend(number);
            rest = after;
        }
        match (option, values.as_slice()) {
            ("-s", [x, y, ..]) => scale = Vec2::new(*x, *y),
            ("-s", [x]) => scale.x = *x,
            ("-o", [x, y, ..]) => offset = Vec2::new(*x, *y),
            ("-o", [x]) => offset.x = *x,
            _ => {}
        }
    }
    let file = rest.trim().trim_matches('"');
    (!file.is_empty()).then(|| MapRef {
        file: file.to_string(),
        scale,
        offset,
    })
}

fn split_word(text: &str) -> (&str, &str) {
    let text = text.trim_start();
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

impl MapRef {
    /// The texture file, if there is one: as written (with either kind of slash) beside the library, else by its
    /// bare name there, letter case aside.
    pub(crate) fn find(&self, folder: &Path) -> Option<PathBuf> {
        let name = self.file.replace('\\', "/");
        let written = folder.join(&name);
        if written.is_file() {
            return Some(written);
        }
        let bare = Path::new(&name).file_name()?;
        for folder in [written.parent()?, folder] {
            let Ok(entries) = fs::read_dir(folder) else {
                continue;
            };
            let found = entries
                .flatten()
                .find(|entry| entry.file_name().eq_ignore_ascii_case(bare));
            if let Some(path) = found.map(|entry| entry.path()).filter(|path| path.is_file()) {
                return Some(path);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_options_and_names_with_spaces() {
        let m = map("-s 1 2 1 -o 0.5 -clamp on -bm 0.3 my file.png").unwrap();
        assert_eq!(m.file, "my file.png");
        assert_eq!((m.scale, m.offset), (Vec2::new(1.0, 2.0), Vec2::new(0.5, 0.0)));
        assert_eq!(map("-mm 0 1 tex\\a b.png").unwrap().file, "tex\\a b.png");
        assert_eq!(map("-s 2 7.png").unwrap().file, "7.png");
        assert_eq!(map("-strange.png").unwrap().file, "-strange.png");
        assert_eq!(map("-s 1 1 1"), None);
        assert_eq!(map(""), None);
    }

    #[test]
    fn statements_and_faults() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mtl");
        fs::write(
            &path,
            "# c\nnewmtl my wood\r\n\tKd 1 0.5 0\nTr 0.25\nmap_Kd a.png\nillum 2\nnewmtl b\nd 0.5\n",
        )
        .unwrap();
        let materials = read(&path).unwrap();
        assert_eq!(materials.len(), 2);
        assert_eq!(
            (materials[0].name.as_str(), materials[0].dissolve),
            ("my wood", 0.75)
        );
        assert_eq!(materials[0].diffuse, [1.0, 0.5, 0.0]);
        for (text, part) in [
            ("Kd 1 1 1", "line 1"),
            ("newmtl a\nKd 1 1", "line 2"),
            ("newmtl a\nd nan", "line 2"),
        ] {
            fs::write(&path, text).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains("a.mtl") && message.contains(part), "{message}");
        }
    }

    #[test]
    fn backslashes_and_letter_case_find_the_file() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("tex")).unwrap();
        fs::write(dir.path().join("tex/Bark.PNG"), "").unwrap();
        fs::write(dir.path().join("leaf.png"), "").unwrap();
        let find = |name: &str| map(name).unwrap().find(dir.path());
        assert_eq!(find("tex\\Bark.PNG"), Some(dir.path().join("tex/Bark.PNG")));
        assert_eq!(find("tex/bark.png"), Some(dir.path().join("tex/Bark.PNG")));
        assert_eq!(find("C:\\work\\leaf.png"), Some(dir.path().join("leaf.png")));
        assert_eq!(find("none.png"), None);
    }
}
