//! `brickfell new`: a folder with a scene to begin with, commented, that flies as it is.
//!
//! ```text
//! scene.xml               which trees there are, with comments about what to try
//! tower.xml               a small octree written by hand, to be edited
//! trees/…                 a piece of the demo terrain, made by the builder
//! scene.xsd, octree.xsd   schemas, for editors
//! ```

use std::fmt::Write;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use brickfell_formats::scene::{Bounds, PagedOctTree, Scene};
use brickfell_pager::FolderStore;
use brickfell_runtime::terrain::SCENE_FILE;
use glam::{DVec2, DVec3};

use super::CommandError;
use super::database::{files_below, open_scene, print};
use super::say::spinner;
use crate::build::{BuildArgs, Silent, build};
use crate::input::demo::{demo_height, write_demo};

/// The demo terrain that the ground is made of: its seed, its side, metres, its voxel, metres, and the voxels per axis of a tree.
const SEED: u64 = 1;
const SIDE: f64 = 64.0;
const VOXEL: f64 = 0.5;
const TREE_VOXELS: u32 = 256;
/// Side of the tower's tree, metres, its floor, and the voxel of its root, on whose multiples trees begin.
const TOWER: f64 = 16.0;
const FLOOR: f64 = 4.0;
const LATTICE: f64 = 2.0;
/// Files below the ground's folder.
const MOST_FILES: usize = 1000;

const SCHEMAS: [(&str, &str); 2] = [
    ("scene.xsd", include_str!("../../../docs/scene.xsd")),
    ("octree.xsd", include_str!("../../../docs/octree.xsd")),
];

/// Arguments of `new`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to make; if it is there already it must be empty
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A folder with something in it, a place that cannot be written to.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let dir = &args.dir;
    refuse_to_overwrite(dir)?;
    let working = spinner("making a piece of ground");
    let scratch = tempfile::tempdir()?;
    let (_, ground) = build_ground(scratch.path())?;
    let built = scratch.path().join("db");
    let fail = |path: &Path, e: io::Error| {
        CommandError::new(format!("{}: {e}", path.display()), "may you write there?")
    };
    fs::create_dir_all(dir).map_err(|e| fail(dir, e))?;
    for name in files_below(&built, MOST_FILES)? {
        // Of the builder's folder only what a scene refers to: what is here is not to be built again.
        if let Some((folder, _)) = name.rsplit_once('/') {
            fs::create_dir_all(dir.join(folder)).map_err(|e| fail(dir, e))?;
            fs::copy(built.join(&name), dir.join(&name)).map_err(|e| fail(&dir.join(&name), e))?;
        }
    }
    let middle = SIDE / 2.0;
    let level = demo_height(SEED, SIDE, DVec2::new(0.0, middle));
    let low = DVec3::new(
        -TOWER,
        middle - TOWER / 2.0,
        ((level - FLOOR) / LATTICE).round() * LATTICE,
    );
    let texts = [
        ("tower.xml", tower_xml(low)),
        (SCENE_FILE, scene_xml(&ground, low)),
    ];
    let schemas = SCHEMAS.map(|(name, text)| (name, text.to_string()));
    for (name, text) in schemas.into_iter().chain(texts) {
        fs::write(dir.join(name), text).map_err(|e| fail(&dir.join(name), e))?;
    }
    working.finish_and_clear();
    let shown = dir.display();
    print(&format!(
        "a scene to begin with: {}\nnext: brickfell fly {shown} --settle --out flight, or brickfell view {shown}\n\
         then edit it, and let brickfell check {shown} look over it\n",
        dir.join(SCENE_FILE).display()
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn refuse_to_overwrite(dir: &Path) -> Result<(), CommandError> {
    let hint = "give a folder that does not exist";
    let fail = |e: &dyn std::fmt::Display| CommandError::new(format!("{}: {e}", dir.display()), hint);
    match fs::read_dir(dir) {
        Ok(mut entries) => match entries.next() {
            Some(_) => Err(fail(&"there is something in it already")),
            None => Ok(()),
        },
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(fail(&e)),
    }
}

/// Builds the ground in a scratch folder.
fn build_ground(scratch: &Path) -> Result<(FolderStore, Scene), CommandError> {
    let demo = write_demo(&scratch.join("input"), SEED, SIDE)?;
    let args = BuildArgs {
        heights: vec![demo.layer()],
        inputs: demo.meshes,
        up: demo.up,
        voxel: Some(VOXEL),
        tree_voxels: TREE_VOXELS,
        ..BuildArgs::new(scratch.join("db"))
    };
    build(&args, &Silent)?;
    open_scene(&args.out)
}

/// Attributes of a tree, on two lines.
fn tree_attributes(tree: &PagedOctTree, bounds: Bounds) -> String {
    let [c, lo, hi] = [tree.center, bounds.min, bounds.max];
    format!(
        "CenterX=\"{}\" CenterY=\"{}\" CenterZ=\"{}\" Radius=\"{:.2}\" TreeFile=\"{}\"\n                \
         MinX=\"{}\" MinY=\"{}\" MinZ=\"{}\" MaxX=\"{}\" MaxY=\"{}\" MaxZ=\"{}\"",
        c.x,
        c.y,
        c.z,
        // Rounded up, so that the sphere holds the box.
        tree.radius + 0.005,
        tree.tree_file,
        lo.x,
        lo.y,
        lo.z,
        hi.x,
        hi.y,
        hi.z,
    )
}

fn scene_xml(ground: &Scene, low: DVec3) -> String {
    let mut trees = String::new();
    for tree in ground.trees() {
        if let Some(bounds) = tree.bounds {
            // Writing to a string cannot fail.
            let _ = writeln!(trees, "  <PagedOctTree {}/>", tree_attributes(tree, bounds));
        }
    }
    let bounds = Bounds {
        min: low,
        max: low + DVec3::splat(TOWER),
    };
    let tower = PagedOctTree {
        center: (bounds.min + bounds.max) * 0.5,
        radius: (bounds.max - bounds.min).length() * 0.5,
        bounds: Some(bounds),
        tree_file: "tower.xml".into(),
    };
    let tower = tree_attributes(&tower, bounds);
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<?xml-model href="scene.xsd"?>
<!--
  A scene to begin with. It says which trees (sparse voxel octrees) there are and where.
  World: metres, x east, y north, z up.

    brickfell view DIR       fly through it in a window
    brickfell inspect DIR    what is in it
    brickfell check DIR      what is wrong with it: file, line, column, and what was probably meant

  Every element and attribute: docs/formats.md of brickfell, or scene.xsd beside this file.
-->
<OctTreeGroup Version="1" Compressed="NO" BrickXSize="8" BrickYSize="8" BrickZSize="8">

  <!-- Ground with trees on it, made by `brickfell build` of height map, picture and models that `brickfell demo` writes.
       Center and Radius are a sphere around the box Min to Max, and the box is the part of the tree that is drawn.
       Try: MaxX="32" draws the western half of it. -->
{trees}
  <!-- A tower written by hand: open tower.xml and change a Color. Boxes of trees may touch but not overlap.
       Try: move it up, by adding 10 to Z, MinZ and MaxZ: in tower.xml Z, here CenterZ, MinZ and MaxZ. -->
  <PagedOctTree {tower}/>

  <!-- Your own: `brickfell build` makes a folder with trees. Copy its folder trees into another one here and the PagedOctTree
       elements of its scene.xml into this file; an OctTreeGroup around some of them lets them be left out together where
       none of them is in view. -->
</OctTreeGroup>
"#
    )
}

fn tower_xml(low: DVec3) -> String {
    let DVec3 { x, y, z } = low;
    let side = TOWER;
    let floor = |tower: &str| {
        let ground = "      <Node Type=\"LEAF-CONST\" Color=\"#6a9e4aff\"/>\n".repeat(4);
        let air = "      <Node Type=\"LEAF-CONST\" Color=\"#00000000\"/>\n".repeat(if tower.is_empty() {
            4
        } else {
            3
        });
        format!("    <Node Type=\"CONST\">\n{ground}{air}{tower}    </Node>\n")
    };
    let quarter = floor("");
    let with_tower =
        floor("      <Node Type=\"LEAF-CONST\" Color=\"#b5543cff\"/> <!-- the tower's foot: brick -->\n");
    format!(
        r##"<?xml version="1.0" encoding="UTF-8"?>
<?xml-model href="octree.xsd"?>
<!--
  A cube of {side} m, halved twice: nodes of {side}, 8 and 4 m. A node has no or eight nodes inside, low before high, x first, then y, then z:
  (low, low, low) (high, low, low) (low, high, low) (high, high, low) and the same again above.
  LEAF-CONST is a cube of one colour, #rrggbbaa: 00000000 is air, and colours that end in ff are opaque.
  CONST is a cube with eight inside; from afar it has their mean colour.
-->
<GigaVoxelsOctTree Version="1" X="{x}" Y="{y}" Z="{z}" DeltaX="0.5" DeltaY="0.5" DeltaZ="0.5"
                   VolumeXSize="{side}" VolumeYSize="{side}" VolumeZSize="{side}"
                   BrickXSize="8" BrickYSize="8" BrickZSize="8" Binary="NO">
  <Node Type="CONST">
    <!-- The lower four of 8 m: grass below, air above. -->
{with_tower}{quarter}{quarter}{quarter}    <!-- The upper four: the rest of the tower, and air. -->
    <Node Type="CONST">
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#b5543cff"/> <!-- brick -->
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#00000000"/>
      <Node Type="LEAF-CONST" Color="#eee2c8ff"/> <!-- the top: sandstone -->
    </Node>
    <Node Type="LEAF-CONST" Color="#00000000"/>
    <Node Type="LEAF-CONST" Color="#00000000"/>
    <Node Type="LEAF-CONST" Color="#00000000"/>
  </Node>
</GigaVoxelsOctTree>
"##
    )
}
