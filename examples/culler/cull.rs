//! Culls a scene without a GPU: which trees a camera sees, front to back; which throw shadows into its picture; which it may see next.
//!
//! `cargo run -p brickfell-culler --example cull`

use std::error::Error;

use brickfell_culler::{Aabb, Camera, CullResult, Culler, SceneGraph, TreeId, VisibleTree};
use glam::{DVec3, dvec3};

/// The tree that stands on the others.
const TOWER: TreeId = TreeId(16);

/// A square of 4 × 4 trees of ground, in four groups, and a tower on the south-east of it.
fn scene() -> Result<SceneGraph, Box<dyn Error>> {
    let mut builder = SceneGraph::builder();
    for quarter in 0..4 {
        let group = builder.add_group(None)?;
        for k in 0..4 {
            let (x, y) = (quarter % 2 * 2 + k % 2, quarter / 2 * 2 + k / 2);
            let low = dvec3(f64::from(x), f64::from(y), 0.0) * 100.0;
            // Ids are the caller's, who finds his own data by them.
            builder.add_tree(Some(group), TreeId(quarter * 4 + k), Aabb::new(low, low + 100.0)?)?;
        }
    }
    let foot = dvec3(350.0, 20.0, 100.0);
    builder.add_tree(None, TOWER, Aabb::new(foot, foot + dvec3(20.0, 20.0, 200.0))?)?;
    Ok(builder.finish())
}

fn print(what: &str, trees: &[VisibleTree]) {
    println!("{what}:");
    for seen in trees {
        let (low, high) = (seen.bounds.min, seen.bounds.max);
        println!(
            "  tree {:2}, {:3.0} m away, {low} to {high}",
            seen.tree.0, seen.distance
        );
    }
}

fn in_view(seen: &CullResult, tree: TreeId) -> bool {
    seen.visible.iter().any(|seen| seen.tree == tree)
}

fn main() -> Result<(), Box<dyn Error>> {
    let scene = scene()?;

    // From the middle of the southern edge to the north-west: the tower is behind the camera's right shoulder.
    let eye = dvec3(200.0, -20.0, 150.0);
    let camera = Camera::look_at(eye, eye + dvec3(-1.0, 1.0, -0.4), 35.0, 640, 480)?;

    // One culler for all frames: it keeps its memory, and remembers in which frame a tree was last seen.
    let mut culler = Culler::new();
    let seen = culler.cull(&scene, &camera, 1);
    print("in view, front to back", &seen.visible);
    println!(
        "  {} groups looked into, {} left out, in exact order: {}",
        seen.groups_visited, seen.groups_culled, seen.order_exact
    );
    assert!(!seen.visible.is_empty() && seen.order_exact && !in_view(seen, TOWER));

    // What throws shadows into the picture is in view, too: now the sun is in the east.
    culler.set_shadows(Some(DVec3::new(1.0, 0.0, 0.8).normalize()));
    let seen = culler.cull(&scene, &camera, 2);
    print("with what throws shadows", &seen.visible);
    assert!(in_view(seen, TOWER), "the tower throws a shadow");
    culler.set_shadows(None);

    // What is near may be seen in one of the next frames.
    culler.set_prefetch_margin(160.0);
    let seen = culler.cull(&scene, &camera, 3);
    print("soon, nearest first", &seen.soon_visible);
    assert!(seen.soon_visible.iter().any(|seen| seen.tree == TOWER));

    println!(
        "the tower was last in view in frame {:?}",
        culler.last_access(TOWER)
    );
    Ok(())
}

#[test]
fn runs() -> Result<(), Box<dyn Error>> {
    main()
}
