//! A level of a database as a surface of voxel faces (OBJ) or as points (PLY), to be looked at in other programs.
//!
//! A voxel counts as filled if at least half of the light ends in it. Exported are filled voxels beside others that are not, with
//! the colour and normal that is stored of them. A branch that ends above the level gives voxels of its own size. Trees are taken
//! by themselves: where one ends, it has neither faces nor points towards the next.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use brickfell_formats::layout::BRICK_VOXELS;
use brickfell_formats::octree::{NodeData, Octree, octant};
use brickfell_formats::value::{decode_color, linear_to_srgb};
use brickfell_pager::FolderStore;
use glam::{DVec3, IVec3, UVec3};
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::recode::levels;
use crate::commands::database::read_octree;

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Faces of voxels.
    Surface,
    /// Middles of voxels.
    Points,
}

/// A stored sample: colour and normal.
type Sample = ([u8; 4], [i8; 4]);

/// A tree with the samples of some levels.
struct Tree {
    octree: Octree,
    /// By level, samples of all its bricks, one brick after the other; empty where they are not needed.
    samples: Vec<Vec<Sample>>,
    /// The finest level that is looked at.
    level: u8,
}

/// A filled voxel beside one that is not.
struct Voxel {
    /// Its middle, and half its side, metres.
    middle: DVec3,
    half: f64,
    /// The sides on which nothing is, as steps.
    open: Vec<IVec3>,
    rgb: [u8; 3],
    normal: [f32; 3],
}

/// Writes a level of all trees; gives the number of faces or points.
///
/// # Errors
/// One line: path, place, reason.
pub(super) fn export(
    store: &FolderStore,
    names: &[&str],
    (level, shape): (Option<u8>, Shape),
    out: &Path,
    bar: &ProgressBar,
) -> Result<u64, String> {
    let io = |e: std::io::Error| format!("{}: {e}", out.display());
    let mut voxels = Vec::new();
    for name in names {
        voxels.extend(Tree::read(store, name, level)?.surface());
        bar.inc(1);
    }
    let mut file = BufWriter::new(File::create(out).map_err(io)?);
    let written = match shape {
        Shape::Surface => write_obj(&mut file, &voxels),
        Shape::Points => write_ply(&mut file, &voxels),
    };
    let count = written.map_err(io)?;
    file.flush().map_err(io)?;
    Ok(count)
}

impl Tree {
    fn read(store: &FolderStore, name: &str, level: Option<u8>) -> Result<Self, String> {
        let octree = read_octree(store, name)?;
        let finest = (0..).zip(&octree.levels).filter(|(_, nodes)| !nodes.is_empty());
        let finest: u8 = finest.map(|(level, _)| level).max().unwrap_or(0);
        let level = level.unwrap_or(finest).min(finest);
        let mut samples = vec![Vec::new(); octree.levels.len()];
        for bricks in levels(store, name, &octree) {
            let ends = octree.levels[usize::from(bricks.level)]
                .iter()
                .any(|n| n.children().is_none() && matches!(n.data(), NodeData::Brick(_)));
            if bricks.level > level || (bricks.level < level && !ends) {
                continue;
            }
            let index = bricks.index()?;
            let chunks: Vec<_> = (0..index.header.chunks)
                .into_par_iter()
                .map(|k| bricks.decode(&index, k))
                .collect::<Result<_, _>>()?;
            let all = chunks
                .into_iter()
                .flat_map(|(_, c)| c.color.into_iter().zip(c.normal));
            samples[usize::from(bricks.level)] = all.collect();
        }
        Ok(Self {
            octree,
            samples,
            level,
        })
    }

    /// What is stored of a voxel of a level: of the node there, or of the one above in which its branch ends.
    fn sample(&self, level: u8, voxel: UVec3) -> Sample {
        let (mut node, mut at) = (0usize, 0u8);
        loop {
            let Some(n) = self.octree.levels[usize::from(at)].get(node) else {
                return Default::default();
            };
            if let (Some(tile), true) = (n.children(), at < level) {
                at += 1;
                let child = (voxel / BRICK_VOXELS) >> u32::from(level - at);
                node = tile as usize * 8 + octant(child) as usize;
                continue;
            }
            return match n.data() {
                NodeData::Constant(color) => (color, [0; 4]),
                NodeData::Brick(brick) => {
                    let layout = self.octree.header.layout;
                    let inside = (voxel >> u32::from(level - at)) % BRICK_VOXELS + layout.low_apron();
                    let side = layout.side();
                    let place = (inside.z * side + inside.y) * side + inside.x;
                    let all = &self.samples[usize::from(at)];
                    let found = all.get(brick as usize * layout.samples() + place as usize);
                    found.copied().unwrap_or_default()
                }
            };
        }
    }

    fn is_filled(&self, (color, _): Sample) -> bool {
        u32::from(color[3]) * u32::from(self.octree.header.gain) * 2 >= 255
    }

    /// All voxels that are filled beside others that are not.
    fn surface(&self) -> Vec<Voxel> {
        let mut found = Vec::new();
        for level in 0..=self.level {
            let nodes = self.octree.levels[usize::from(level)].iter();
            let ends = nodes
                .zip(self.octree.positions(level))
                .filter(|(n, _)| level == self.level || n.children().is_none());
            let at_level: Vec<Vec<Voxel>> = ends
                .collect::<Vec<_>>()
                .into_par_iter()
                .map(|(node, p)| {
                    let color = match node.data() {
                        NodeData::Constant(color) => Some(color),
                        NodeData::Brick(_) => None,
                    };
                    if color.is_some_and(|c| !self.is_filled((c, [0; 4]))) {
                        return Vec::new();
                    }
                    let all = (0..BRICK_VOXELS.pow(3)).map(|k| {
                        let n = BRICK_VOXELS;
                        p * n + UVec3::new(k % n, k / n % n, k / (n * n))
                    });
                    all.filter_map(|voxel| self.voxel(level, voxel)).collect()
                })
                .collect();
            found.extend(at_level.into_iter().flatten());
        }
        found
    }

    fn voxel(&self, level: u8, voxel: UVec3) -> Option<Voxel> {
        let sample = self.sample(level, voxel);
        if !self.is_filled(sample) {
            return None;
        }
        let side = (BRICK_VOXELS << level) as i32;
        let is_open = |step: &IVec3| {
            let beside = voxel.as_ivec3() + step;
            let inside = beside.min_element() >= 0 && beside.max_element() < side;
            inside && !self.is_filled(self.sample(level, beside.as_uvec3()))
        };
        let steps = [IVec3::X, IVec3::Y, IVec3::Z].into_iter().flat_map(|s| [-s, s]);
        let open: Vec<IVec3> = steps.filter(is_open).collect();
        if open.is_empty() {
            return None;
        }
        let header = &self.octree.header;
        let size = header.level_voxel_size(level);
        let [r, g, b, a] = decode_color(sample.0);
        let normal = sample.1.map(f32::from);
        let length = (normal[0].powi(2) + normal[1].powi(2) + normal[2].powi(2))
            .sqrt()
            .max(1.0);
        Some(Voxel {
            middle: header.origin + (voxel.as_dvec3() + header.layout.sample_offset()) * size,
            half: size / 2.0,
            open,
            rgb: [r, g, b].map(|c| linear_to_srgb((c / a.max(1.0 / 255.0)) as f32)),
            normal: [normal[0] / length, normal[1] / length, normal[2] / length],
        })
    }
}

/// Faces with colours at their corners, seen from outside counter-clockwise.
fn write_obj(file: &mut impl Write, voxels: &[Voxel]) -> std::io::Result<u64> {
    let mut faces = 0;
    for voxel in voxels {
        let [r, g, b] = voxel.rgb.map(|c| f64::from(c) / 255.0);
        for out in &voxel.open {
            let out = out.as_dvec3();
            let u = DVec3::new(out.y, out.z, out.x).abs();
            let v = out.cross(u);
            for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let p = voxel.middle + (out + u * s + v * t) * voxel.half;
                writeln!(file, "v {} {} {} {r:.3} {g:.3} {b:.3}", p.x, p.y, p.z)?;
            }
            let first = 4 * faces + 1;
            writeln!(file, "f {} {} {} {}", first, first + 1, first + 2, first + 3)?;
            faces += 1;
        }
    }
    Ok(faces)
}

fn write_ply(file: &mut impl Write, voxels: &[Voxel]) -> std::io::Result<u64> {
    write!(
        file,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        voxels.len()
    )?;
    for voxel in voxels {
        for v in voxel.middle.to_array() {
            file.write_all(&v.to_le_bytes())?;
        }
        for v in voxel.normal {
            file.write_all(&v.to_le_bytes())?;
        }
        file.write_all(&voxel.rgb)?;
    }
    Ok(voxels.len() as u64)
}
