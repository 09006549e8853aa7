//! The OBJ reader against tobj, on files that tobj reads: the same triangles with the same texture coordinates, in the same
//! order.

use std::path::{Path, PathBuf};

use brickfell::input::demo::write_demo;
use brickfell::input::{Mesh, RasterCache, TextureSet, UpAxis};

/// Positions and texture coordinates of a triangle's corners.
type Corners = [([f32; 3], [f32; 2]); 3];

fn by_tobj(path: &Path) -> Vec<Corners> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ..Default::default()
    };
    let (models, _) = tobj::load_obj(path, &options).expect("tobj reads it");
    let mut triangles = Vec::new();
    for mesh in models.iter().map(|m| &m.mesh) {
        let corner = |k: usize| {
            let v = mesh.indices[k] as usize;
            let uv = mesh.texcoord_indices.get(k).map_or([0.0; 2], |t| {
                let t = *t as usize;
                [mesh.texcoords[2 * t], mesh.texcoords[2 * t + 1]]
            });
            (
                [
                    mesh.positions[3 * v],
                    mesh.positions[3 * v + 1],
                    mesh.positions[3 * v + 2],
                ],
                uv,
            )
        };
        triangles.extend(
            (0..mesh.indices.len())
                .step_by(3)
                .map(|k| [corner(k), corner(k + 1), corner(k + 2)]),
        );
    }
    triangles
}

fn by_us(path: &Path) -> Vec<Corners> {
    let cache = RasterCache::new(RasterCache::DEFAULT_BUDGET, std::env::temp_dir());
    let mesh = Mesh::load(path, UpAxis::Z, &mut TextureSet::new(&cache)).expect("we read it");
    mesh.triangles
        .iter()
        .map(|t| {
            std::array::from_fn(|c| {
                (
                    mesh.positions[t.v[c] as usize].as_vec3().to_array(),
                    t.uv[c].to_array(),
                )
            })
        })
        .collect()
}

fn compare(path: &Path) {
    let (ours, theirs) = (by_us(path), by_tobj(path));
    assert_eq!(ours.len(), theirs.len(), "{}", path.display());
    for (k, (a, b)) in ours.iter().zip(&theirs).enumerate() {
        assert_eq!(a, b, "{}: triangle {k}", path.display());
    }
}

#[test]
fn the_demos_models_read_alike() {
    let folder = tempfile::tempdir().unwrap();
    for path in write_demo(folder.path(), 3, 64.0).unwrap().meshes {
        compare(&path);
    }
}

#[test]
fn a_photogrammetric_pit_reads_alike() {
    let data = std::env::var_os("BRICKFELL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = data.join("landform_pit_obj/landform_pit.obj");
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return;
    }
    compare(&path);
}
