//! Triangles of all meshes on the lattice, and what they look like at a cell.

use glam::{DVec3, Vec3};

use super::filter::{Cover, outline};
use super::lattice::Lattice;
use super::overlap::closest_point;
use crate::input::{Material, Mesh, Triangle};

/// Skin of opaque surfaces: over-saturated, so that interpolation does not see through.
const OPAQUE_SKIN: f32 = 2.0;

/// All triangles, numbered through the meshes in order.
#[derive(Debug)]
pub(crate) struct Surfaces<'a> {
    meshes: &'a [Mesh],
    /// Number of the first triangle of each mesh.
    first: Vec<usize>,
    lattice: Lattice,
}

/// What one triangle shows in one cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub(crate) skin: f32,
    pub(crate) alpha: f32,
    /// Straight linear light.
    pub(crate) rgb: [f32; 3],
    /// Unit length.
    pub(crate) normal: [f32; 3],
}

impl<'a> Surfaces<'a> {
    pub(crate) fn new(meshes: &'a [Mesh], lattice: Lattice) -> Self {
        let first = meshes
            .iter()
            .scan(0, |next, mesh| {
                let first = *next;
                *next += mesh.triangles.len();
                Some(first)
            })
            .collect();
        Self {
            meshes,
            first,
            lattice,
        }
    }

    /// Number of triangles.
    pub(crate) fn len(&self) -> usize {
        self.meshes.iter().map(|m| m.triangles.len()).sum()
    }

    fn find(&self, number: usize) -> Option<(&'a Mesh, &'a Triangle)> {
        let mesh = self.first.partition_point(|f| *f <= number).checked_sub(1)?;
        let triangle = self.meshes[mesh].triangles.get(number - self.first[mesh])?;
        Some((&self.meshes[mesh], triangle))
    }

    /// Corners of a triangle, cell coordinates.
    pub(crate) fn corners(&self, number: usize) -> Option<[DVec3; 3]> {
        let (mesh, triangle) = self.find(number)?;
        Some(mesh.corners(triangle).map(|p| self.lattice.cells_of(p)))
    }

    /// A triangle made ready for [`Shader::facet`].
    pub(crate) fn shader(&self, number: usize) -> Option<Shader<'a>> {
        let (mesh, triangle) = self.find(number)?;
        let material = mesh.materials.get(usize::from(triangle.material))?;
        let corners = mesh.corners(triangle).map(|p| self.lattice.cells_of(p));
        let base = corners[0].floor();
        let local = corners.map(|p| p - base);
        let face = (local[1] - local[0]).cross(local[2] - local[0]);
        let texels = material.texture.as_ref().map_or(0.0, |t| {
            let (w, h) = t.size();
            let [a, b] = [triangle.uv[1] - triangle.uv[0], triangle.uv[2] - triangle.uv[0]]
                .map(|d| d.as_dvec2() * glam::DVec2::new(f64::from(w), f64::from(h)));
            (a.perp_dot(b).abs() / face.length().max(f64::MIN_POSITIVE)).sqrt() as f32
        });
        Some(Shader {
            mesh,
            triangle,
            material,
            base,
            local,
            face: face.normalize_or_zero().as_vec3(),
            texels,
        })
    }
}

/// A triangle ready to be looked at.
#[derive(Debug)]
pub(crate) struct Shader<'a> {
    mesh: &'a Mesh,
    triangle: &'a Triangle,
    material: &'a Material,
    base: DVec3,
    local: [DVec3; 3],
    face: Vec3,
    /// Texels that a voxel spans.
    texels: f32,
}

impl Shader<'_> {
    /// What it covers of a cell.
    pub(crate) fn outline(&self, cell: [i64; 3]) -> Cover {
        outline(&self.local, self.base.to_array().map(|b| b as i64), cell)
    }

    /// The look in a cell, taken at the triangle's nearest point to the cell's middle; `None` where it is clear.
    pub(crate) fn facet(&self, cell: [i64; 3]) -> Option<Facet> {
        let middle = DVec3::from_array(cell.map(|c| c as f64)) - self.base + 0.5;
        let w = closest_point(&self.local, middle).map(|w| w as f32);
        let look = self.mesh.look(self.triangle, w, self.face, self.texels)?;
        let skin = if self.material.cutout {
            look.alpha
        } else {
            OPAQUE_SKIN
        };
        Some(Facet {
            skin,
            alpha: look.alpha,
            rgb: look.rgb,
            normal: look.normal.to_array(),
        })
    }
}
