//! A model under construction: vertices, texture coordinates, normals and faces by material, written as OBJ.

use std::fmt::Write;

use glam::{DVec2, DVec3};

/// Faces of one material.
struct Group {
    material: &'static str,
    faces: String,
}

/// An OBJ file in the making; Z up, world metres.
#[derive(Default)]
pub(super) struct Model {
    vertices: String,
    texcoords: String,
    normals: String,
    groups: Vec<Group>,
    vertex_count: usize,
    normal_count: usize,
}

impl Model {
    /// Adds a polygon, counter-clockwise seen from outside; each corner has a position and a texture coordinate.
    pub(super) fn polygon(&mut self, material: &'static str, normal: DVec3, corners: &[(DVec3, DVec2)]) {
        self.normal_count += 1;
        // Writing to a String cannot fail.
        let _ = writeln!(self.normals, "vn {:.3} {:.3} {:.3}", normal.x, normal.y, normal.z);
        let mut face = String::from("f");
        for (p, uv) in corners {
            self.vertex_count += 1;
            let _ = writeln!(self.vertices, "v {:.3} {:.3} {:.3}", p.x, p.y, p.z);
            let _ = writeln!(self.texcoords, "vt {:.4} {:.4}", uv.x, uv.y);
            let _ = write!(face, " {0}/{0}/{1}", self.vertex_count, self.normal_count);
        }
        face.push('\n');
        match self.groups.iter_mut().find(|g| g.material == material) {
            Some(group) => group.faces.push_str(&face),
            None => self.groups.push(Group {
                material,
                faces: face,
            }),
        }
    }

    /// A flat polygon whose normal follows from its first three corners.
    pub(super) fn flat(&mut self, material: &'static str, corners: &[(DVec3, DVec2)]) {
        let normal = match corners {
            [a, b, c, ..] => (b.0 - a.0).cross(c.0 - a.0).normalize_or(DVec3::Z),
            _ => return,
        };
        self.polygon(material, normal, corners);
    }

    /// The text of the file, naming `library` for its materials.
    pub(super) fn text(&self, library: &str) -> String {
        let mut text = format!(
            "mtllib {library}\n{}{}{}",
            self.vertices, self.texcoords, self.normals
        );
        for group in &self.groups {
            let _ = write!(text, "usemtl {}\n{}", group.material, group.faces);
        }
        text
    }
}
