//! OBJ text to polygons: every statement that makes a surface, each number checked where it stands.
//!
//! Read by this module and not by a library because faults must name the line, positions need 64 bits, corners without a texture
//! coordinate must stay so, and files may be larger than memory: a file is read block by block, the parts of a block are parsed
//! in parallel, and triangles are handed on with each block. What stays in memory are the vertices, which later faces may
//! name. Points, lines, curves and groups are skipped.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::error::InputError;
use super::linear::linear_of;

/// A corner of a triangle; texture coordinate and normal are optional.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Corner {
    pub(crate) v: u32,
    pub(crate) t: Option<u32>,
    pub(crate) n: Option<u32>,
}

/// A triangle: its corners, and the index of its material's name.
pub(crate) type ObjTriangle = ([Corner; 3], u32);

/// The file's own statements so far, coordinates as written.
#[derive(Debug, Default)]
pub(crate) struct ObjFile {
    pub(crate) positions: Vec<DVec3>,
    /// Colour of each vertex, straight linear light; empty if no vertex has one, white where one has none.
    pub(crate) colors: Vec<[f32; 3]>,
    pub(crate) texcoords: Vec<Vec2>,
    pub(crate) normals: Vec<Vec3>,
    /// Material names in order of first use; the first is "" and stands for faces before any `usemtl`.
    pub(crate) material_names: Vec<String>,
    /// Material libraries as written.
    pub(crate) libraries: Vec<String>,
}

/// Most vertices of one file: indices are 32 bits.
const MAX_VERTICES: usize = u32::MAX as usize;
/// Bytes that are read at a time.
const BLOCK: usize = 1 << 23;
/// Bytes that are parsed by one thread at a time.
const PART: usize = 1 << 19;

/// Reads an OBJ file. `each` is called in the order of the file, with all that was read so far and the triangles that are new
/// (polygons as fans).
///
/// # Errors
/// A file that cannot be read, the first fault in it, an error of `each`.
pub(crate) fn read<E: From<InputError>>(
    path: &Path,
    each: impl FnMut(&ObjFile, &[ObjTriangle]) -> Result<(), E>,
) -> Result<ObjFile, E> {
    let file = File::open(path).map_err(|e| InputError::io(path, e))?;
    parse(path, file, BLOCK, PART, each)
}

/// Reads OBJ text, `block` bytes at a time in parts of `part`.
fn parse<E: From<InputError>>(
    path: &Path,
    mut text: impl Read,
    block: usize,
    part: usize,
    mut each: impl FnMut(&ObjFile, &[ObjTriangle]) -> Result<(), E>,
) -> Result<ObjFile, E> {
    let mut file = ObjFile {
        material_names: vec![String::new()],
        ..ObjFile::default()
    };
    let (mut material, mut lines) = (0u32, 0usize);
    let mut buffer: Vec<u8> = Vec::new();
    loop {
        let held = buffer.len();
        let more = (&mut text)
            .take(block as u64)
            .read_to_end(&mut buffer)
            .map_err(|e| InputError::io(path, e))?;
        let last = more == 0;
        let end = if last {
            buffer.len()
        } else {
            statement_end(&buffer, held)
        };
        let mut parts = Vec::new();
        let mut rest = &buffer[..end];
        while !rest.is_empty() {
            let cut = if rest.len() <= part {
                rest.len()
            } else {
                part + first_statement_end(&rest[part..])
            };
            let (now, later) = rest.split_at(cut);
            parts.push(now);
            rest = later;
        }
        let parts: Vec<Part> = parts.into_par_iter().map(Part::parse).collect();
        // Where the counts and lines of each part begin, and its material.
        let mut starts = Vec::with_capacity(parts.len());
        for part in &parts {
            starts.push((file.counts(), lines, material));
            if let Some(material_of_part) = part.append_to(&mut file) {
                material = material_of_part;
            }
            lines += part.lines;
            if let Some((line, fault)) = &part.fault {
                let (counts, lines, _) = starts[starts.len() - 1];
                // Faces before the fault may have one, too.
                for (part, start) in parts.iter().zip(&starts) {
                    part.triangles(path, start, &file)?;
                }
                return Err(fault.error(path, lines + line, counts[0]).into());
            }
        }
        if file.positions.len() > MAX_VERTICES {
            return Err(InputError::unsupported(path, "more vertices than 32-bit indices can name").into());
        }
        let triangles: Vec<Result<Vec<ObjTriangle>, InputError>> = parts
            .par_iter()
            .zip(&starts)
            .map(|(part, start)| part.triangles(path, start, &file))
            .collect();
        for triangles in triangles {
            each(&file, &triangles?)?;
        }
        buffer.drain(..end);
        if last {
            return Ok(file);
        }
    }
}

/// The end of the last statement in a text, of which the first bytes are known to hold none.
fn statement_end(text: &[u8], known: usize) -> usize {
    let ends = (known..text.len()).rev().filter(|k| text[*k] == b'\n');
    ends.map(|k| k + 1)
        .find(|end| !continues(&text[..*end]))
        .unwrap_or(0)
}

/// The end of the first statement in a text that ends with one.
fn first_statement_end(text: &[u8]) -> usize {
    let ends = (0..text.len()).filter(|k| text[*k] == b'\n');
    ends.map(|k| k + 1)
        .find(|end| !continues(&text[..*end]))
        .unwrap_or(text.len())
}

/// Whether a line's last character, blanks aside, is the backslash that continues it.
fn continues(line: &[u8]) -> bool {
    line.trim_ascii_end().last() == Some(&b'\\')
        && line.ends_with(b"\n")
        && !line[line.trim_ascii_end().len()..]
            .iter()
            .rev()
            .skip(1)
            .any(|b| *b == b'\n')
}

/// What is wrong with a statement, as far as its part knows.
#[derive(Debug)]
enum Fault {
    Text(String),
    /// The vertex with this number in its part.
    NotFinite(usize),
}

impl Fault {
    fn error(&self, path: &Path, line: usize, vertices: usize) -> InputError {
        match self {
            Self::Text(what) => InputError::line(path, line, what.clone()),
            Self::NotFinite(number) => InputError::VertexNotFinite {
                path: path.into(),
                vertex: vertices + number,
                line,
            },
        }
    }
}

impl From<String> for Fault {
    fn from(what: String) -> Self {
        Self::Text(what)
    }
}

impl From<&str> for Fault {
    fn from(what: &str) -> Self {
        Self::Text(what.into())
    }
}

/// A corner as written: indices of vertex, texture coordinate and normal, [`NONE`] where there is none.
type Written = [i64; 3];

/// A face: its line in the part, what there was of each kind before it in the part, its corners.
#[derive(Debug)]
struct Face {
    line: u32,
    counts: [u32; 3],
    corners: std::ops::Range<usize>,
    /// Number of the name, among those of the part; `None` before the first.
    material: Option<u32>,
}

/// The statements of a part of a file.
#[derive(Debug, Default)]
struct Part {
    lines: usize,
    positions: Vec<DVec3>,
    colors: Vec<[f32; 3]>,
    texcoords: Vec<Vec2>,
    normals: Vec<Vec3>,
    faces: Vec<Face>,
    corners: Vec<Written>,
    /// All `usemtl`, in their order.
    names: Vec<String>,
    libraries: Vec<String>,
    fault: Option<(usize, Fault)>,
}

impl ObjFile {
    fn counts(&self) -> [usize; 3] {
        [self.positions.len(), self.texcoords.len(), self.normals.len()]
    }
}

impl Part {
    /// Parses up to the first fault.
    fn parse(text: &[u8]) -> Self {
        let mut part = Self::default();
        let mut joined = String::new();
        let mut raw_lines = text.split(|b| *b == b'\n').peekable();
        while let Some(raw) = raw_lines.next() {
            // What follows the last line's end is no line, unless there is something.
            if raw.is_empty() && raw_lines.peek().is_none() {
                break;
            }
            part.lines += 1;
            let line = String::from_utf8_lossy(raw);
            let line = line.trim();
            // A backslash at the end continues the statement in the next line.
            if let Some(first) = line.strip_suffix('\\') {
                joined.push_str(first);
                joined.push(' ');
                continue;
            }
            let result = if joined.is_empty() {
                part.statement(line)
            } else {
                joined.push_str(line);
                let result = part.statement(&joined);
                joined.clear();
                result
            };
            if let Err(fault) = result {
                part.fault = Some((part.lines, fault));
                break;
            }
        }
        part
    }

    fn statement(&mut self, statement: &str) -> Result<(), Fault> {
        let (keyword, rest) = statement
            .split_once(char::is_whitespace)
            .unwrap_or((statement, ""));
        match keyword {
            "v" => self.vertex(rest)?,
            "vt" => self.texcoords.push(texcoord(rest)?),
            "vn" => self.normals.push(normal(rest)?),
            "f" => {
                let first = self.corners.len();
                for word in rest.split_ascii_whitespace() {
                    self.corners.push(corner(word)?);
                }
                if self.corners.len() - first < 3 {
                    return Err("a face needs at least three corners".into());
                }
                self.faces.push(Face {
                    line: self.lines as u32,
                    counts: [self.positions.len(), self.texcoords.len(), self.normals.len()]
                        .map(|n| n as u32),
                    corners: first..self.corners.len(),
                    material: (self.names.len() as u32).checked_sub(1),
                });
            }
            "usemtl" => self.names.push(rest.trim().to_string()),
            "mtllib" => self.libraries.push(rest.trim().to_string()),
            _ => {}
        }
        Ok(())
    }

    fn vertex(&mut self, rest: &str) -> Result<(), Fault> {
        let (n, count) = numbers::<7>(rest)?;
        if count < 3 {
            return Err("a vertex needs three coordinates".into());
        }
        if n.iter().any(|x| !x.is_finite()) {
            return Err(Fault::NotFinite(self.positions.len() + 1));
        }
        // Six or seven numbers: a colour follows (a fourth number alone is a weight, which polygons do not use).
        if count >= 6 {
            self.colors.resize(self.positions.len(), [1.0; 3]);
            self.colors.push([n[3], n[4], n[5]].map(|c| linear_of(c as f32)));
        } else if !self.colors.is_empty() {
            self.colors.push([1.0; 3]);
        }
        self.positions.push(DVec3::new(n[0], n[1], n[2]));
        Ok(())
    }

    /// Adds all but the faces to the file. Gives the number of the last material name, if there is one.
    fn append_to(&self, file: &mut ObjFile) -> Option<u32> {
        if !self.colors.is_empty() {
            file.colors.resize(file.positions.len(), [1.0; 3]);
            file.colors.extend_from_slice(&self.colors);
        }
        file.positions.extend_from_slice(&self.positions);
        if !file.colors.is_empty() {
            file.colors.resize(file.positions.len(), [1.0; 3]);
        }
        file.texcoords.extend_from_slice(&self.texcoords);
        file.normals.extend_from_slice(&self.normals);
        file.libraries.extend(self.libraries.iter().cloned());
        let numbers = self.names.iter().map(|name| file.material_number(name));
        numbers.last()
    }

    /// The triangles, their indices resolved.
    fn triangles(
        &self,
        path: &Path,
        (before, lines, material): &([usize; 3], usize, u32),
        file: &ObjFile,
    ) -> Result<Vec<ObjTriangle>, InputError> {
        const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];
        let names: Vec<u32> = self.names.iter().map(|n| file.known_material(n)).collect();
        let mut triangles = Vec::with_capacity(self.corners.len());
        for face in &self.faces {
            let material = face.material.map_or(*material, |k| names[k as usize]);
            let resolve = |kind: usize, index: i64| {
                let count = before[kind] + face.counts[kind] as usize;
                let zero_based = if index < 0 {
                    index.checked_add(count as i64)
                } else {
                    index.checked_sub(1)
                };
                match zero_based {
                    Some(i) if i >= 0 && (i as u64) < count as u64 => Ok(i as u32),
                    _ => Err(InputError::IndexOutOfRange {
                        path: path.into(),
                        line: lines + face.line as usize,
                        kind: KINDS[kind],
                        index,
                        count,
                    }),
                }
            };
            let optional = |kind: usize, index: i64| match index {
                NONE => Ok(None),
                index => resolve(kind, index).map(Some),
            };
            let corner = |[v, t, n]: &Written| {
                Ok(Corner {
                    v: resolve(0, *v)?,
                    t: optional(1, *t)?,
                    n: optional(2, *n)?,
                })
            };
            let corners = &self.corners[face.corners.clone()];
            let first = corner(&corners[0])?;
            let mut second = corner(&corners[1])?;
            for written in &corners[2..] {
                let third = corner(written)?;
                triangles.push(([first, second, third], material));
                second = third;
            }
        }
        Ok(triangles)
    }
}

impl ObjFile {
    fn known_material(&self, name: &str) -> u32 {
        self.material_names.iter().position(|n| n == name).unwrap_or(0) as u32
    }

    fn material_number(&mut self, name: &str) -> u32 {
        let known = self.material_names.iter().position(|n| n == name);
        known.unwrap_or_else(|| {
            self.material_names.push(name.to_string());
            self.material_names.len() - 1
        }) as u32
    }
}

/// Up to `N` numbers; how many there were comes with them.
fn numbers<const N: usize>(text: &str) -> Result<([f64; N], usize), Fault> {
    let mut values = [0.0; N];
    let mut count = 0;
    for (value, word) in values.iter_mut().zip(text.split_ascii_whitespace()) {
        *value = word.parse().map_err(|_| format!("'{word}' is not a number"))?;
        count += 1;
    }
    Ok((values, count))
}

fn texcoord(rest: &str) -> Result<Vec2, Fault> {
    let (n, count) = numbers::<2>(rest)?;
    let uv = Vec2::new(n[0] as f32, n[1] as f32);
    if count < 1 || !uv.is_finite() {
        return Err("texture coordinate is not finite".into());
    }
    Ok(uv)
}

fn normal(rest: &str) -> Result<Vec3, Fault> {
    let (n, count) = numbers::<3>(rest)?;
    let normal = Vec3::new(n[0] as f32, n[1] as f32, n[2] as f32);
    if count < 3 || !normal.is_finite() {
        return Err("normal is not finite".into());
    }
    Ok(normal)
}

/// No index; 0 is what is written for one that is wrong.
const NONE: i64 = i64::MIN;

fn corner(word: &str) -> Result<Written, Fault> {
    let mut indices = [NONE; 3];
    let mut parts = word.split('/');
    for (index, kind) in indices.iter_mut().zip(["vertex", "texture coordinate", "normal"]) {
        let text = parts.next().unwrap_or("");
        if !text.is_empty() {
            // The least of all is as far out of range as the one above it.
            let parsed: i64 = text
                .parse()
                .map_err(|_| format!("'{text}' is not a {kind} index"))?;
            *index = parsed.max(NONE + 1);
        }
    }
    if indices[0] == NONE || parts.next().is_some() {
        return Err(format!("'{word}' is not a corner of a face").into());
    }
    Ok(indices)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Whole {
        file: ObjFile,
        triangles: Vec<ObjTriangle>,
    }

    fn in_blocks(text: &str, block: usize, part: usize) -> Result<Whole, InputError> {
        let mut triangles = Vec::new();
        let file = parse(Path::new("a.obj"), text.as_bytes(), block, part, |_, new| {
            triangles.extend_from_slice(new);
            Ok::<_, InputError>(())
        })?;
        Ok(Whole { file, triangles })
    }

    fn read(text: &str) -> Result<Whole, InputError> {
        in_blocks(text, BLOCK, PART)
    }

    #[test]
    fn blocks_do_not_show() {
        let text = format!(
            "mtllib a.mtl\n{QUAD}f 1 2 3\nusemtl b\nv 5 5 5 1 0 1\n# rest\nf -1 \\\n 2 \\\r\n3 4\nvn 0 0 1\nusemtl c\nf 1//1 2//-1 5\nusemtl b\nf 5 4 3"
        );
        let whole = read(&text).unwrap();
        assert_eq!((whole.triangles.len(), whole.file.material_names.len()), (5, 3));
        let faulty = format!("{text}\nf 1 2 9\nv nan 0 0\n");
        for block in 1..text.len() + 2 {
            for part in [1, 7, 40] {
                let cut = in_blocks(&text, block, part).unwrap();
                assert_eq!(cut.triangles, whole.triangles, "{block} {part}");
                assert_eq!(cut.file.colors, whole.file.colors);
                assert_eq!(cut.file.libraries, whole.file.libraries);
                let [a, b] =
                    [in_blocks(&faulty, block, part), read(&faulty)].map(|r| r.err().unwrap().to_string());
                assert_eq!(a, b);
            }
        }
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
        assert_eq!(file.file.positions[0].x, 2600000.001);
    }

    #[test]
    fn vertex_colours() {
        let file = read("v 0 0 0\nv 0 0 0 0.5 0.25 1\nv 0 0 0 1\n").unwrap();
        assert_eq!(
            file.file.colors,
            [[1.0; 3], [0.5, 0.25, 1.0].map(linear_of), [1.0; 3]]
        );
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
            let message = read(text).err().unwrap().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{message}");
        }
    }
}
