//! OBJ text to polygons: every statement that makes a surface, each number checked where it stands.
//!
//! Read by this module and not by a library because faults must name the line, positions need 64 bits, and corners
//! without a texture coordinate must stay so. Points, lines, curves and groups are skipped.

use std::path::Path;

use glam::{DVec3, Vec2, Vec3};

use super::error::InputError;

/// A corner of a triangle; texture coordinate and normal are optional.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Corner {
    pub(crate) v: u32,
    pub(crate) t: Option<u32>,
    pub(crate) n: Option<u32>,
}

/// The file's own statements, coordinates as written.
#[derive(Debug, Default)]
pub(crate) struct ObjFile {
    pub(crate) positions: Vec<DVec3>,
    /// Colour of each vertex as written; empty if no vertex has one, white where one has none.
    pub(crate) colors: Vec<[f32; 3]>,
    pub(crate) texcoords: Vec<Vec2>,
    pub(crate) normals: Vec<Vec3>,
    /// Triangles (polygons as fans) and the index of their name in `material_names`.
    pub(crate) triangles: Vec<([Corner; 3], u32)>,
    /// Material names in order of first use; the first is "" and stands for faces before any `usemtl`.
    pub(crate) material_names: Vec<String>,
    /// Material libraries as written.
    pub(crate) libraries: Vec<String>,
}

/// Most vertices of one file: indices are 32 bits.
const MAX_VERTICES: usize = u32::MAX as usize;

/// Reads OBJ text.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<ObjFile, InputError> {
    let mut file = ObjFile {
        material_names: vec![String::new()],
        ..ObjFile::default()
    };
    let mut material = 0;
    let mut polygon = Vec::new();
    let mut joined = String::new();
    for (index, raw) in bytes.split(|b| *b == b'\n').enumerate() {
        let line = String::from_utf8_lossy(raw);
        let line = line.trim();
        // A backslash at the end continues the statement in the next line.
        if let Some(part) = line.strip_suffix('\\') {
            joined.push_str(part);
            joined.push(' ');
            continue;
        }
        let statement = if joined.is_empty() {
            line
        } else {
            joined.push_str(line);
            joined.as_str()
        };
        let reader = LineReader {
            path,
            line: index + 1,
        };
        let (keyword, rest) = statement
            .split_once(char::is_whitespace)
            .unwrap_or((statement, ""));
        match keyword {
            "v" => reader.vertex(rest, &mut file)?,
            "vt" => file.texcoords.push(reader.texcoord(rest)?),
            "vn" => file.normals.push(reader.normal(rest)?),
            "f" => {
                polygon.clear();
                for word in rest.split_whitespace() {
                    polygon.push(reader.corner(word, &file)?);
                }
                let &[first, .., _] = polygon.as_slice() else {
                    return Err(reader.fault("a face needs at least three corners"));
                };
                if polygon.len() < 3 {
                    return Err(reader.fault("a face needs at least three corners"));
                }
                let fan = polygon
                    .windows(2)
                    .skip(1)
                    .map(|pair| ([first, pair[0], pair[1]], material));
                file.triangles.extend(fan);
            }
            "usemtl" => {
                let name = rest.trim();
                let known = file.material_names.iter().position(|n| n == name);
                material = known.unwrap_or_else(|| {
                    file.material_names.push(name.to_string());
                    file.material_names.len() - 1
                }) as u32;
            }
            "mtllib" => file.libraries.push(rest.trim().to_string()),
            _ => {}
        }
        joined.clear();
    }
    Ok(file)
}

struct LineReader<'a> {
    path: &'a Path,
    line: usize,
}

impl LineReader<'_> {
    fn fault(&self, what: impl Into<String>) -> InputError {
        InputError::line(self.path, self.line, what)
    }

    /// Up to `N` numbers; how many there were comes with them.
    fn numbers<const N: usize>(&self, text: &str) -> Result<([f64; N], usize), InputError> {
        let mut values = [0.0; N];
        let mut count = 0;
        for (value, word) in values.iter_mut().zip(text.split_whitespace()) {
            *value = word
                .parse()
                .map_err(|_| self.fault(format!("'{word}' is not a number")))?;
            count += 1;
        }
        Ok((values, count))
    }

    fn vertex(&self, rest: &str, file: &mut ObjFile) -> Result<(), InputError> {
        let (n, count) = self.numbers::<7>(rest)?;
        if count < 3 {
            return Err(self.fault("a vertex needs three coordinates"));
        }
        if n.iter().any(|x| !x.is_finite()) {
            let vertex = file.positions.len() + 1;
            return Err(InputError::VertexNotFinite {
                path: self.path.into(),
                vertex,
                line: self.line,
            });
        }
        if file.positions.len() >= MAX_VERTICES {
            return Err(self.fault("more vertices than 32-bit indices can name"));
        }
        // Six or seven numbers: a colour follows (a fourth number alone is a weight, which polygons do not use).
        if count >= 6 {
            file.colors.resize(file.positions.len(), [1.0; 3]);
            file.colors.push([n[3] as f32, n[4] as f32, n[5] as f32]);
        } else if !file.colors.is_empty() {
            file.colors.push([1.0; 3]);
        }
        file.positions.push(DVec3::new(n[0], n[1], n[2]));
        Ok(())
    }

    fn texcoord(&self, rest: &str) -> Result<Vec2, InputError> {
        let (n, count) = self.numbers::<2>(rest)?;
        let uv = Vec2::new(n[0] as f32, n[1] as f32);
        if count < 1 || !uv.is_finite() {
            return Err(self.fault("texture coordinate is not finite"));
        }
        Ok(uv)
    }

    fn normal(&self, rest: &str) -> Result<Vec3, InputError> {
        let (n, count) = self.numbers::<3>(rest)?;
        let normal = Vec3::new(n[0] as f32, n[1] as f32, n[2] as f32);
        if count < 3 || !normal.is_finite() {
            return Err(self.fault("normal is not finite"));
        }
        Ok(normal)
    }

    fn corner(&self, word: &str, file: &ObjFile) -> Result<Corner, InputError> {
        let mut parts = word.split('/');
        let v = self.index(parts.next().unwrap_or(""), "vertex", file.positions.len())?;
        let t = self.index(
            parts.next().unwrap_or(""),
            "texture coordinate",
            file.texcoords.len(),
        )?;
        let n = self.index(parts.next().unwrap_or(""), "normal", file.normals.len())?;
        match (v, parts.next()) {
            (Some(v), None) => Ok(Corner { v, t, n }),
            _ => Err(self.fault(format!("'{word}' is not a corner of a face"))),
        }
    }

    /// An index from 1, or from the end if negative; nothing for an empty text.
    fn index(&self, text: &str, kind: &'static str, count: usize) -> Result<Option<u32>, InputError> {
        if text.is_empty() {
            return Ok(None);
        }
        let index: i64 = text
            .parse()
            .map_err(|_| self.fault(format!("'{text}' is not a {kind} index")))?;
        let zero_based = if index < 0 {
            index.checked_add(count as i64)
        } else {
            index.checked_sub(1)
        };
        match zero_based {
            Some(i) if i >= 0 && (i as u64) < count as u64 => Ok(Some(i as u32)),
            _ => Err(InputError::IndexOutOfRange {
                path: self.path.into(),
                line: self.line,
                kind,
                index,
                count,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<ObjFile, InputError> {
        parse(Path::new("a.obj"), text.as_bytes())
    }

    const QUAD: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\n";

    #[test]
    fn polygons_fan_and_corners_may_differ() {
        let file = read(&format!("{QUAD}f 1/1 2 3//  4\n")).unwrap();
        assert_eq!(file.triangles.len(), 2);
        let ([a, b, _], _) = file.triangles[0];
        assert_eq!((a.v, a.t, b.t), (0, Some(0), None));
        assert_eq!(file.triangles[1].0.map(|c| c.v), [0, 2, 3]);
        let negative = read(&format!("{QUAD}f -4 -3 \\\n -2\n")).unwrap();
        assert_eq!(negative.triangles[0].0.map(|c| c.v), [0, 1, 2]);
    }

    #[test]
    fn large_coordinates_keep_their_digits() {
        let file = read("v 2600000.001 1200000.002 0\n").unwrap();
        assert_eq!(file.positions[0].x, 2600000.001);
    }

    #[test]
    fn vertex_colours() {
        let file = read("v 0 0 0\nv 0 0 0 0.5 0.25 1\nv 0 0 0 1\n").unwrap();
        assert_eq!(file.colors, [[1.0; 3], [0.5, 0.25, 1.0], [1.0; 3]]);
    }

    #[test]
    fn faults_name_the_line() {
        for (text, part) in [
            (
                "v 0 0 0\nv 0 nan 0\n",
                "a.obj: vertex 2 (line 2): coordinate is not finite",
            ),
            ("v 0 0 1e999\n", "vertex 1 (line 1)"),
            ("v 0 0\n", "a.obj: line 1: a vertex needs three coordinates"),
            ("v a 0 0\n", "'a' is not a number"),
            (
                "v 0 0 0\nf 1 1 2\n",
                "a.obj: line 2: vertex index 2 is outside 1..1",
            ),
            ("v 0 0 0\nf 1 1 0\n", "vertex index 0"),
            ("v 0 0 0\nf -2 1 1\n", "vertex index -2"),
            ("v 0 0 0\nf 1/1 1/1 1/1\n", "texture coordinate index 1"),
            ("v 0 0 0\nf 1 1\n", "three corners"),
            ("v 0 0 0\nf /1 1 1\n", "line 2"),
            ("v 0 0 0\nf 1 1 -9223372036854775808\n", "line 2"),
            ("vt inf 0\n", "line 1"),
            ("vn 0 0 nan\n", "line 1"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{message}");
        }
    }
}
