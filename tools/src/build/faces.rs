//! Faces as bytes, as bins hold them.
//!
//! Faces that follow each other mostly share corners, and what a corner has takes 24 to 56 bytes. So a corner that is one of the
//! last few is named by its place among them; all bits are kept. Bytes of several writers may be put one behind the other: each
//! begins with a face that needs nothing before it.

use glam::{DVec3, Vec2, Vec3};

use super::spill::{Reader, Writer};
use crate::input::{Corners, Face};

/// A face in the order of the input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Binned {
    /// Its number through all meshes.
    pub(crate) number: u64,
    pub(crate) face: Face,
}

// What a face has at its corners, and what is as before.
const COLORS: u8 = 1;
const NORMALS: u8 = 2;
const UV: u8 = 4;
/// The number is the next one, and the material the last face's.
const FOLLOWS: u8 = 8;
/// Nothing before it counts.
const FIRST: u8 = 16;

/// Corners that are remembered.
const RECENT: usize = 8;
/// Stands for a corner that is not among them.
const NEW: u8 = RECENT as u8;

/// All that a face has at a corner.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    position: DVec3,
    color: [f32; 3],
    normal: Vec3,
    uv: Vec2,
}

impl Corner {
    /// Whether all bits are the same.
    fn is(&self, other: &Self) -> bool {
        let bits = |c: &Self| {
            (
                c.position.to_array().map(f64::to_bits),
                c.color.map(f32::to_bits),
                c.normal.to_array().map(f32::to_bits),
                c.uv.to_array().map(f32::to_bits),
            )
        };
        self.position.x.to_bits() == other.position.x.to_bits() && bits(self) == bits(other)
    }
}

/// What is known before a face.
#[derive(Clone, Copy, Debug, Default)]
struct Before {
    /// The last corners, in turn.
    recent: [Corner; RECENT],
    next: usize,
    number: u64,
    material: u32,
    any: bool,
}

impl Before {
    fn remember(&mut self, corner: Corner) {
        self.recent[self.next] = corner;
        self.next = (self.next + 1) % RECENT;
    }
}

/// Writes faces.
#[derive(Debug, Default)]
pub(crate) struct FaceWriter {
    out: Writer,
    before: Before,
}

impl FaceWriter {
    /// Adds a face.
    pub(crate) fn put(&mut self, Binned { number, face }: &Binned) {
        let (at, before, out) = (&face.at, &mut self.before, &mut self.out);
        let follows = before.any && *number == before.number + 1 && face.material == before.material;
        let flags = [
            (at.colors.is_some(), COLORS),
            (at.normals.is_some(), NORMALS),
            (
                at.uv.iter().any(|uv| uv.to_array().map(f32::to_bits) != [0; 2]),
                UV,
            ),
            (follows, FOLLOWS),
            (!before.any, FIRST),
        ];
        let flags = flags
            .iter()
            .fold(0, |flags, (set, bit)| if *set { flags | bit } else { flags });
        out.put(&flags);
        if !follows {
            out.put(number);
            out.put(&face.material);
        }
        for k in 0..3 {
            let corner = Corner {
                position: face.corners[k],
                color: at.colors.map_or([0.0; 3], |c| c[k]),
                normal: at.normals.map_or(Vec3::ZERO, |n| n[k]),
                uv: at.uv[k],
            };
            if let Some(known) = before.recent.iter().position(|c| c.is(&corner)) {
                out.put(&(known as u8));
                continue;
            }
            out.put(&NEW);
            out.put(&corner.position.to_array());
            if flags & COLORS != 0 {
                out.put(&corner.color);
            }
            if flags & NORMALS != 0 {
                out.put(&corner.normal.to_array());
            }
            if flags & UV != 0 {
                out.put(&corner.uv.to_array());
            }
            before.remember(corner);
        }
        (before.number, before.material, before.any) = (*number, face.material, true);
    }

    /// What has been written.
    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.out.0
    }
}

/// Reads faces, however their bytes are cut into pieces.
#[derive(Debug, Default)]
pub(crate) struct FaceReader {
    before: Before,
}

impl FaceReader {
    /// The next face; `None`, and nothing has changed, where it is not whole.
    pub(crate) fn get(&mut self, bytes: &mut &[u8]) -> Option<Binned> {
        let mut reader = Reader(bytes);
        let flags = reader.get::<u8>()?;
        if bytes.len() < length(flags, bytes)? {
            return None;
        }
        if flags & FIRST != 0 {
            self.before = Before::default();
        }
        let before = &mut self.before;
        if flags & FOLLOWS == 0 {
            (before.number, before.material) = (reader.get()?, reader.get()?);
        } else {
            before.number = before.number.wrapping_add(1);
        }
        let mut corners = [Corner::default(); 3];
        for corner in &mut corners {
            let place = reader.get::<u8>()?;
            if place != NEW {
                *corner = *before.recent.get(usize::from(place))?;
                continue;
            }
            corner.position = DVec3::from_array(reader.get()?);
            if flags & COLORS != 0 {
                corner.color = reader.get()?;
            }
            if flags & NORMALS != 0 {
                corner.normal = Vec3::from_array(reader.get()?);
            }
            if flags & UV != 0 {
                corner.uv = Vec2::from_array(reader.get()?);
            }
            before.remember(*corner);
        }
        *bytes = reader.0;
        Some(Binned {
            number: before.number,
            face: Face {
                corners: corners.map(|c| c.position),
                at: Corners {
                    uv: corners.map(|c| c.uv),
                    colors: (flags & COLORS != 0).then(|| corners.map(|c| c.color)),
                    normals: (flags & NORMALS != 0).then(|| corners.map(|c| c.normal)),
                },
                material: before.material,
            },
        })
    }
}

/// Bytes of the face that some bytes begin with; `None` where that cannot be told.
fn length(flags: u8, bytes: &[u8]) -> Option<usize> {
    let part = |flag, bytes| if flags & flag == 0 { 0 } else { bytes };
    let corner = size_of::<[f64; 3]>() + part(COLORS, 12) + part(NORMALS, 12) + part(UV, 8);
    let mut length = 1;
    if flags & FOLLOWS == 0 {
        length += size_of::<u64>() + size_of::<u32>();
    }
    for _ in 0..3 {
        length += if *bytes.get(length)? == NEW { 1 + corner } else { 1 };
    }
    Some(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A face over few places and looks, so that corners come again, with some that have less than others.
    fn face() -> impl Strategy<Value = (u8, [u8; 3], u32)> {
        (0..8u8, [0..12u8, 0..12u8, 0..12u8], 0..3u32)
    }

    fn binned(number: u64, (has, corners, material): (u8, [u8; 3], u32)) -> Binned {
        let float = |k: u8| f32::from(k) * if k == 3 { f32::NAN } else { 0.1 };
        let at = Corners {
            uv: corners.map(|k| {
                if has & 1 == 0 {
                    Vec2::ZERO
                } else {
                    Vec2::new(float(k), -0.0)
                }
            }),
            colors: (has & 2 != 0).then(|| corners.map(|k| [float(k), 0.0, -0.0])),
            normals: (has & 4 != 0).then(|| corners.map(|k| Vec3::new(0.0, float(k), 1.0))),
        };
        Binned {
            number,
            face: Face {
                corners: corners.map(|k| DVec3::new(f64::from(k) / 3.0, -0.0, 1e9)),
                at,
                material,
            },
        }
    }

    proptest! {
        #[test]
        fn faces_round_trip(faces in prop::collection::vec(face(), 1..60), gap in 1..3u64, cut in 1..40usize, piece in 1..300usize) {
            let faces: Vec<Binned> = (0..).map(|k| gap * k).zip(faces).map(|(n, f)| binned(n, f)).collect();
            let mut bytes = Vec::new();
            for part in faces.chunks(cut) {
                let mut writer = FaceWriter::default();
                part.iter().for_each(|face| writer.put(face));
                bytes.extend(writer.into_bytes());
            }
            let (mut reader, mut held, mut read) = (FaceReader::default(), Vec::new(), Vec::new());
            for piece in bytes.chunks(piece) {
                held.extend_from_slice(piece);
                let mut rest = &held[..];
                while let Some(face) = reader.get(&mut rest) {
                    read.push(face);
                }
                held = rest.to_vec();
            }
            prop_assert!(held.is_empty());
            prop_assert_eq!(format!("{read:?}"), format!("{faces:?}"));
        }
    }

    #[test]
    fn neighbours_share_corners() {
        let mut writer = FaceWriter::default();
        for k in 0..100u8 {
            writer.put(&binned(u64::from(k), (2, [k, k + 1, k + 2], 0)));
        }
        let each = writer.into_bytes().len() / 100;
        assert!(each < 24 + 12 + 8, "{each} bytes");
    }
}
