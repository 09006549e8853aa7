//! Meshes: OBJ files with materials and textures as triangles in world metres.
//!
//! Structure of arrays, immutable once loaded, read from many threads. Z is up: files with Y up are turned on loading,
//! `(x, y, z) → (x, −z, y)`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::error::InputError;
use super::look::Corners;
use super::obj::{self, Corner, ObjFile, ObjTriangle};
use super::placements::Pose;
use super::surfaces::{Used, load_materials, read_libraries, resolve};
use super::texture::Texture;
use super::texture_set::TextureSet;

/// Which axis of a file points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpAxis {
    /// Y up: most modelling programs.
    Y,
    /// Z up: the world's own.
    Z,
}

/// A triangle, corners counter-clockwise as in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// Indices into [`Mesh::positions`] (and [`Mesh::colors`]).
    pub v: [u32; 3],
    /// Texture coordinates, v up, not bounded to 0..1; 0 where the file has none.
    pub uv: [Vec2; 3],
    /// Indices into [`Mesh::normals`], if every corner has one.
    pub n: Option<[u32; 3]>,
    /// Index into [`Mesh::materials`].
    pub material: u16,
}

/// What a surface looks like.
#[derive(Debug, Clone)]
pub struct Material {
    /// Name in the file; empty for faces without material.
    pub name: String,
    /// Straight linear-light RGBA; multiplies the texture.
    pub color: [f32; 4],
    /// Texture, if the material has one and its file is there.
    pub texture: Option<Arc<Texture>>,
    /// Whether any part of the surface is less than opaque.
    pub cutout: bool,
}

/// A triangle mesh with materials.
#[derive(Debug, Default)]
pub struct Mesh {
    /// Vertices, world metres.
    pub positions: Vec<DVec3>,
    /// Straight linear-light RGB of each vertex, multiplying material and texture; empty if the file has none.
    pub colors: Vec<[f32; 3]>,
    /// Normals in world axes, as long as in the file.
    pub normals: Vec<Vec3>,
    /// Triangles; at least one.
    pub triangles: Vec<Triangle>,
    /// Materials that triangles refer to.
    pub materials: Vec<Material>,
    /// What was missing but did not keep the mesh from loading, one line each.
    pub warnings: Vec<String>,
}

/// Materials of one mesh that a triangle can name.
const MAX_MATERIALS: usize = 1 << 16;

impl Mesh {
    /// Reads an OBJ file with its material libraries and textures. A missing library, material or texture file is a
    /// warning and leaves a plain colour.
    ///
    /// # Errors
    /// A missing file, a number that is not finite, an index out of range, no triangle at all, a damaged texture.
    pub fn load(path: &Path, up: UpAxis, textures: &mut TextureSet) -> Result<Mesh, InputError> {
        let mut triangles: Vec<ObjTriangle> = Vec::new();
        let file = obj::read(path, |_, new| {
            triangles.extend_from_slice(new);
            Ok::<_, InputError>(())
        })?;
        if triangles.is_empty() {
            return Err(InputError::EmptyMesh {
                path: path.to_path_buf(),
            });
        }
        let mut mesh = Mesh::default();
        let in_use = materials_in_use(&triangles, file.material_names.len());
        let (used, _) = file.materials(path, &in_use, textures, &mut mesh)?;

        let triangle = |(corners, material): &([Corner; 3], u32)| {
            let map = used
                .get(*material as usize)
                .and_then(|u| u.found.as_ref())
                .and_then(|m| m.color_map.as_ref());
            let (scale, offset) = map.map_or((Vec2::ONE, Vec2::ZERO), |m| (m.scale, m.offset));
            let uv = corners.map(|c| {
                c.t.and_then(|t| file.texcoords.get(t as usize))
                    .map_or(Vec2::ZERO, |t| *t)
            });
            Triangle {
                v: corners.map(|c| c.v),
                uv: uv.map(|uv| uv * scale + offset),
                n: match corners.map(|c| c.n) {
                    [Some(a), Some(b), Some(c)] => Some([a, b, c]),
                    _ => None,
                },
                material: *material as u16,
            }
        };
        mesh.triangles = triangles.par_iter().map(triangle).collect();
        mesh.positions = file.positions;
        mesh.normals = file.normals;
        mesh.colors = file.colors;
        if up == UpAxis::Y {
            mesh.positions
                .iter_mut()
                .for_each(|p| *p = DVec3::new(p.x, -p.z, p.y));
            mesh.normals
                .iter_mut()
                .for_each(|n| *n = Vec3::new(n.x, -n.z, n.y));
        }
        Ok(mesh)
    }

    /// The corners of a triangle, world metres.
    #[inline]
    pub fn corners(&self, triangle: &Triangle) -> [DVec3; 3] {
        triangle.v.map(|i| self.positions[i as usize])
    }

    /// The mesh put somewhere else; what was missing in its files is said by this one alone.
    pub fn posed(&self, pose: &Pose) -> Mesh {
        let direction = |n: &Vec3| pose.direction(n.as_dvec3()).as_vec3();
        Mesh {
            positions: self.positions.iter().map(|p| pose.position(*p)).collect(),
            colors: self.colors.clone(),
            normals: self.normals.iter().map(direction).collect(),
            triangles: self.triangles.clone(),
            materials: self.materials.clone(),
            warnings: Vec::new(),
        }
    }

    /// The box around all vertices that triangles use: least and greatest coordinates, world metres.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        self.triangles
            .iter()
            .flat_map(|t| self.corners(t))
            .fold(start, |(min, max), p| (min.min(p), max.max(p)))
    }
}

impl ObjFile {
    /// Loads the materials that are in use, with their textures. Gives the files that were read, too.
    fn materials(
        &self,
        path: &Path,
        in_use: &[bool],
        textures: &mut TextureSet,
        mesh: &mut Mesh,
    ) -> Result<(Vec<Used>, Vec<PathBuf>), InputError> {
        if self.material_names.len() > MAX_MATERIALS {
            let what = format!(
                "{} materials; the limit is {MAX_MATERIALS}",
                self.material_names.len()
            );
            return Err(InputError::unsupported(path, what));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let library = read_libraries(path, folder, &self.libraries, &mut mesh.warnings)?;
        let used = resolve(path, &self.material_names, in_use, &library, &mut mesh.warnings);
        let mut files = library.files.clone();
        mesh.materials = load_materials(&used, &library, textures, &mut mesh.warnings, &mut files)?;
        Ok((used, files))
    }
}

/// A triangle by itself, as meshes are streamed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// World metres.
    pub corners: [DVec3; 3],
    /// What it has there. Texture coordinates are those of the file, see [`Placing`].
    pub at: Corners,
    /// Number of the material in the mesh.
    pub material: u32,
}

/// How a material's texture lies on texture coordinates: `uv · scale + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// Factor.
    pub scale: Vec2,
    /// Summand.
    pub offset: Vec2,
}

impl Placing {
    /// As they are.
    pub const NONE: Self = Self {
        scale: Vec2::ONE,
        offset: Vec2::ZERO,
    };
}

/// What a mesh that was streamed has but triangles.
#[derive(Debug, Default)]
pub struct Streamed {
    /// Materials that faces refer to, and how their textures lie.
    pub materials: Vec<(Material, Placing)>,
    /// What was missing, one line each.
    pub warnings: Vec<String>,
    /// The material libraries and textures that were read.
    pub files: Vec<PathBuf>,
}

/// Reads an OBJ file face by face: `each` gets some thousands at a time, in the order of the file. In memory are the file's
/// vertices, and no more than a block of its text.
///
/// # Errors
/// Those of [`Mesh::load`], and those of `each`.
pub fn stream<E: From<InputError>>(
    path: &Path,
    up: UpAxis,
    textures: &mut TextureSet,
    mut each: impl FnMut(&[Face]) -> Result<(), E>,
) -> Result<Streamed, E> {
    let turned = |p: DVec3| match up {
        UpAxis::Z => p,
        UpAxis::Y => DVec3::new(p.x, -p.z, p.y),
    };
    let mut in_use = Vec::new();
    let mut any = false;
    let file = obj::read(path, |file, triangles| {
        any |= !triangles.is_empty();
        in_use.resize(file.material_names.len(), false);
        triangles.iter().for_each(|(_, m)| in_use[*m as usize] = true);
        let face = |(corners, material): &ObjTriangle| {
            let color = |v: u32| file.colors[v as usize];
            let normal = |n: u32| {
                turned(file.normals[n as usize].as_dvec3())
                    .as_vec3()
                    .normalize_or_zero()
            };
            let uv = |c: Corner| c.t.map_or(Vec2::ZERO, |t| file.texcoords[t as usize]);
            Face {
                corners: corners.map(|c| turned(file.positions[c.v as usize])),
                at: Corners {
                    uv: corners.map(uv),
                    colors: (!file.colors.is_empty()).then(|| corners.map(|c| color(c.v))),
                    normals: match corners.map(|c| c.n) {
                        [Some(a), Some(b), Some(c)] => Some([a, b, c].map(normal)),
                        _ => None,
                    },
                },
                material: *material,
            }
        };
        for part in triangles.chunks(1 << 16) {
            let faces: Vec<Face> = part.par_iter().map(face).collect();
            each(&faces)?;
        }
        Ok::<(), E>(())
    })?;
    if !any {
        return Err(InputError::EmptyMesh {
            path: path.to_path_buf(),
        }
        .into());
    }
    in_use.resize(file.material_names.len(), false);
    let mut mesh = Mesh::default();
    let (used, files) = file.materials(path, &in_use, textures, &mut mesh)?;
    let placing = |used: Used| {
        let map = used.found.and_then(|m| m.color_map);
        map.map_or(Placing::NONE, |m| Placing {
            scale: m.scale,
            offset: m.offset,
        })
    };
    Ok(Streamed {
        materials: mesh
            .materials
            .into_iter()
            .zip(used.into_iter().map(placing))
            .collect(),
        warnings: mesh.warnings,
        files,
    })
}

/// Which materials triangles name.
fn materials_in_use(triangles: &[ObjTriangle], names: usize) -> Vec<bool> {
    let mut in_use = vec![false; names];
    for (_, material) in triangles {
        in_use[*material as usize] = true;
    }
    in_use
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::test_data::{data, textures};
    use std::fs;

    const TRIANGLE: &str =
        "v 1 2 3\nv 2 2 3\nv 1 3 3\nvt 0 0\nvt 3 0\nvt 0 -2\nvn 0 1 0\nf 1/1/1 2/2/1 3/3/1\n";

    fn load(path: &Path, up: UpAxis) -> Result<Mesh, InputError> {
        Mesh::load(path, up, &mut textures())
    }

    fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
        let path = dir.join(name);
        fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn y_up_is_turned() {
        let dir = tempfile::tempdir().unwrap();
        let path = write(dir.path(), "a.obj", TRIANGLE);
        let mesh = load(&path, UpAxis::Y).unwrap();
        assert_eq!(mesh.positions[0], DVec3::new(1.0, -3.0, 2.0));
        assert_eq!(mesh.normals[0], Vec3::Z);
        assert_eq!(mesh.triangles[0].uv[2], Vec2::new(0.0, -2.0));
        let mesh = load(&path, UpAxis::Z).unwrap();
        assert_eq!(
            mesh.bounds(),
            (DVec3::new(1.0, 2.0, 3.0), DVec3::new(2.0, 3.0, 3.0))
        );
        assert!(mesh.warnings.is_empty() && !mesh.materials[0].cutout);
    }

    #[test]
    fn missing_library_material_and_texture_are_warnings() {
        let dir = tempfile::tempdir().unwrap();
        let path = write(
            dir.path(),
            "a.obj",
            &format!("mtllib none.mtl\nusemtl wood\n{TRIANGLE}"),
        );
        let mesh = load(&path, UpAxis::Z).unwrap();
        assert!(
            mesh.warnings[0].contains("none.mtl") && mesh.warnings[1].contains("'wood'"),
            "{:?}",
            mesh.warnings
        );
        write(dir.path(), "none.mtl", "newmtl wood\nKd 1 0 0\nmap_Kd gone.png\n");
        let mesh = load(&path, UpAxis::Z).unwrap();
        assert!(
            mesh.warnings[0].contains("'wood'") && mesh.warnings[0].contains("gone.png"),
            "{:?}",
            mesh.warnings
        );
        let wood = &mesh.materials[mesh.triangles[0].material as usize];
        assert_eq!((wood.color, wood.texture.is_none()), ([1.0, 0.0, 0.0, 1.0], true));
    }

    #[test]
    fn empty_and_damaged_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        let path = write(dir.path(), "a.obj", "v 0 0 0\n# nothing\n");
        assert!(matches!(
            load(&path, UpAxis::Z),
            Err(InputError::EmptyMesh { .. })
        ));
        let path = write(
            dir.path(),
            "a.obj",
            &format!("mtllib a.mtl\nusemtl m\n{TRIANGLE}"),
        );
        write(dir.path(), "a.mtl", "newmtl m\nmap_Kd broken.png\n");
        write(dir.path(), "broken.png", "\u{89}PNG");
        assert!(
            load(&path, UpAxis::Z)
                .unwrap_err()
                .to_string()
                .contains("broken.png")
        );
        let message = load(&dir.path().join("no.obj"), UpAxis::Z)
            .unwrap_err()
            .to_string();
        assert!(message.contains("no.obj"), "{message}");
    }

    #[test]
    fn opacity_map_and_texture_options() {
        let dir = tempfile::tempdir().unwrap();
        let path = write(
            dir.path(),
            "a.obj",
            &format!("mtllib a.mtl\nusemtl m\n{TRIANGLE}"),
        );
        write(
            dir.path(),
            "a.mtl",
            "newmtl m\nKd 0 0 0\nmap_Kd -s 2 1 1 -o 0.5 0 0 my color.png\nmap_d sub\\mask.png\n",
        );
        image::RgbImage::from_raw(2, 1, vec![255, 0, 0, 0, 255, 0])
            .unwrap()
            .save(dir.path().join("my color.png"))
            .unwrap();
        fs::create_dir(dir.path().join("sub")).unwrap();
        image::GrayImage::from_raw(2, 1, vec![0, 128])
            .unwrap()
            .save(dir.path().join("sub/mask.png"))
            .unwrap();
        let mesh = load(&path, UpAxis::Z).unwrap();
        let material = &mesh.materials[mesh.triangles[0].material as usize];
        assert!(material.cutout && material.color == [1.0; 4]);
        let texture = material.texture.as_ref().unwrap();
        assert_eq!(texture.sampler(1.0).at(Vec2::new(0.25, 0.5)).unwrap()[3], 0.0);
        let green = texture.sampler(1.0).at(Vec2::new(0.75, 0.5)).unwrap();
        assert!(
            green[1] > 0.99 && (green[3] - 128.0 / 255.0).abs() < 1e-5,
            "{green:?}"
        );
        assert_eq!(mesh.triangles[0].uv[1], Vec2::new(6.5, 0.0));
    }

    #[test]
    fn real_meshes() {
        let Some(path) = data("landform_pit_obj/landform_pit.obj") else {
            return;
        };
        let mesh = load(&path, UpAxis::Y).unwrap();
        assert_eq!(
            (mesh.triangles.len(), mesh.warnings.len()),
            (177_950, 0),
            "{:?}",
            mesh.warnings
        );
        let (min, max) = mesh.bounds();
        assert!((max.z - min.z - 64.0).abs() < 2.0, "{min} {max}");
        let Some(path) = data("flightgear_sf_obj/scene.obj") else {
            return;
        };
        let mesh = load(&path, UpAxis::Z).unwrap();
        assert_eq!(
            (mesh.triangles.len(), mesh.warnings.len()),
            (86_013, 0),
            "{:?}",
            mesh.warnings
        );
        assert!(mesh.materials.iter().any(|m| m.cutout));
    }
}
