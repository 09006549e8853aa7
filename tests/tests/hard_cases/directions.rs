//! Directions: every pattern of signs, rays in planes, rays along faces.

use std::collections::BTreeSet;

use brickfell_tests::trees::sample;

use super::*;

/// Thin constants and bricks of all sizes in a tree of 64 m, and a finer, smaller one that shares the face x = 64.
fn thin_trees(layout: SampleLayout) -> Stage {
    let west = header(DVec3::ZERO, 1.0, 3, layout, 1);
    let east = header(DVec3::new(64.0, 8.0, -8.0), 0.5, 3, layout, 1);
    let mut maker = Maker::new();
    for tree in [west, east] {
        let grey = |alpha: u8| [alpha / 2, alpha / 3, alpha, alpha];
        let kind = move |level: u8, p: UVec3| {
            let h = hash([i32::from(level), p.x as i32, p.y as i32, p.z as i32]);
            match h % 8 {
                0 | 1 if level > 0 => Kind::Leaf(grey((h >> 8) as u8 % 30)),
                2 if level > 0 => Kind::Leaf([0; 4]),
                _ => Kind::Brick,
            }
        };
        maker = maker.tree(tree, kind, move |level, p| {
            let wave = (p.as_dvec3() * DVec3::new(0.3, 0.4, 0.5))
                .map(f64::sin)
                .element_sum();
            sample(grey((8.0 + 2.0 * wave + f64::from(level)) as u8))
        });
    }
    Stage::new(maker)
}

/// Nine rays in directions of which each component is -1, 0 or 1; zeros have the sign of `zero`.
fn fan(eye: DVec3, forward: DVec3, zero: f64) -> Camera {
    let signed = |v: DVec3| DVec3::select(v.cmpeq(DVec3::ZERO), DVec3::splat(zero), v);
    let up = DVec3::new(forward.z.abs(), forward.x.abs(), forward.y.abs());
    Camera {
        eye,
        forward: signed(forward),
        right: signed(forward.cross(up)),
        up: signed(up),
        // A pixel is as wide as it is far away.
        fov_y: 2.0 * 1.5f64.atan(),
        width: 3,
        height: 3,
    }
}

#[test]
fn all_sign_patterns_from_faces_edges_and_corners() {
    exactly(
        "directions::all_sign_patterns_from_faces_edges_and_corners",
        || {
            // Outside; in faces of trees, bricks and voxels; in a voxel. All three alike: corners; two: edges.
            let places = [-9.0, 0.0, 8.0, 19.0, 19.5, 64.0];
            let forwards = DVec3::AXES.into_iter().flat_map(|a| [a, -a]);
            let mut stage = thin_trees(Centre);
            let mut patterns = BTreeSet::new();
            for (k, forward) in forwards.cycle().take(6 * 216).enumerate() {
                let eye = k / 6;
                let eye = DVec3::new(places[eye % 6], places[eye / 6 % 6], places[eye / 36]);
                let zero = if hash([k as i32]) & 1 == 0 { 0.0 } else { -0.0 };
                let camera = fan(eye, forward, zero);
                // The finest level alone, or levels mixed on the way.
                let settings = biased(if hash([k as i32]) & 2 == 0 { -20.0 } else { -4.3 });
                let what = format!("{eye} along {forward} with {zero:?}");
                let both = stage.check(&what, &camera, &settings, SMOOTH);
                assert!(alpha_apart(&both) < 1e-3, "{what}: {both:?}");
                for (k, pixel) in both.gpu.pixels.iter().enumerate() {
                    if pixel[3] > 0.0 {
                        let ray = camera.ray((k % 3) as f64, (k / 3) as f64);
                        patterns.insert(ray.to_array().map(|c| c.round() as i32));
                    }
                }
            }
            assert_eq!(patterns.len(), 26, "{patterns:?}");
        },
    );
}

#[test]
fn rays_along_the_axes_from_faces_edges_and_corners() {
    exactly(
        "directions::rays_along_the_axes_from_faces_edges_and_corners",
        || {
            let mut stage = Stage::new(neighbours());
            let eyes = [
                DVec3::new(0.0, 8.0, 1.0),   // in the face that the trees share
                DVec3::new(0.0, 4.0, -3.0),  // a corner of one, in a face of the other
                DVec3::new(-16.0, 0.0, 0.0), // a corner
                DVec3::new(-8.0, 8.0, 8.0),  // a corner of eight bricks
                DVec3::new(2.0, 6.0, -1.0),  // inside a brick, on voxel planes
                DVec3::new(8.0, 12.0, 5.0),  // the high corner
                DVec3::new(0.0, -30.0, 1.0), // outside, in the plane of the shared face
                DVec3::new(-40.0, 4.0, 4.0), // outside, in the plane of a face
            ];
            let axes = [DVec3::X, DVec3::Y, DVec3::Z];
            let mut hits = 0;
            for eye in eyes {
                for axis in axes.into_iter().flat_map(|a| [a, -a]) {
                    let camera = look(eye, axis, 17, 17);
                    let flip = |v: DVec3| DVec3::select(v.cmpeq(DVec3::ZERO), -v, v);
                    // The same directions with the zeros' signs turned.
                    let turned = Camera {
                        forward: flip(camera.forward),
                        right: flip(camera.right),
                        up: flip(camera.up),
                        ..camera
                    };
                    let what = format!("{eye} along {axis}");
                    let both = stage.close(&what, &camera);
                    stage.close(&format!("{what}, zeros turned"), &turned);
                    let pixel = both.gpu.pixels[both.gpu.pixels.len() / 2];
                    hits += u32::from(pixel[3] > 0.5);
                }
            }
            assert!(hits > 8, "{hits} of the rays along axes hit");
        },
    );
}
#[test]
fn debug_it() {
    let mut stage = thin_trees(Centre);
    for bias in [-20.0, -6.0, -5.0,-4.5, -4.4,-4.35,-4.3,-4.29, -4.25, -4.2,-4.1,-4.0] {
        let camera = fan(DVec3::new(19.5, 8.0, -9.0), DVec3::Y, -0.0);
        let (p, f) = settled(&mut stage.renderer, &camera, &biased(bias));
        let r = stage.world.reference(&camera, &biased(bias));
        println!("DBG {bias} {:?} {:?} {}", p.pixels[2][3], r.pixels[2][3], f.bias);
    }
}
