//! What surfaces hide from each other: a wall on level ground.

use brickfell_culler::Camera;
use brickfell_formats::layout::SampleLayout;
use brickfell_formats::value::Stored;
use glam::{DVec3, dvec3};

use super::Reference;
use super::testing::*;
use crate::settings::RenderSettings;

const DEPTH: u8 = 3;
/// Height of the ground, the wall's west and east side, and its height, metres.
const GROUND: f64 = 16.0;
const WALL: [f64; 2] = [24.0, 40.0];
const TOP: f64 = 32.0;

/// White ground with a white wall from south to north, in voxels of 1 m.
fn wall() -> Reference {
    let mut store = Store::default();
    let head = header(DVec3::ZERO, 1.0, DEPTH, SampleLayout::Centre, 1);
    let kind = |level: u8, _| {
        if level < DEPTH {
            Kind::Brick
        } else {
            Kind::BrickLeaf
        }
    };
    store.add("t.oct", head, kind, |level, p| {
        let p = (p.as_dvec3() + 0.5) * f64::from(1 << (DEPTH - level));
        let [is_ground, is_wall] = [p.z < GROUND, WALL[0] < p.x && p.x < WALL[1] && p.z < TOP];
        let side = if p.x < 0.5 * (WALL[0] + WALL[1]) {
            -127
        } else {
            127
        };
        Stored {
            color: if is_ground || is_wall { [255; 4] } else { [0; 4] },
            normal: if is_ground || p.z > TOP - 2.0 {
                [0, 0, 127, 0]
            } else {
                [side, 0, 0, 0]
            },
        }
    });
    store.open(&["t.oct"])
}

/// What is seen of the place below a point.
fn from_above(reference: &Reference, x: f64, settings: &RenderSettings) -> f64 {
    let camera = Camera::look_at(dvec3(x, 32.0, 60.0), dvec3(x, 32.0, 0.0), 1.0, 1, 1).unwrap();
    let rgba = reference.cast(&camera, settings, 0.0, 0.0).unwrap();
    assert!(rgba[3] > 0.999, "{x}: {rgba:?}");
    rgba[0]
}

#[test]
fn a_wall_throws_its_shadow_as_far_as_the_sun_says() {
    let reference = wall();
    let sun = dvec3(1.0, 0.0, 1.0).normalize();
    let plain = RenderSettings {
        sun,
        ..RenderSettings::default()
    };
    let shadows = RenderSettings {
        shadows: true,
        ..plain
    };
    // As long as the wall is high.
    let end = WALL[0] - (TOP - GROUND);
    for (x, is_lit) in [
        (3.3, true),
        (end - 3.0, true),
        (end + 3.0, false),
        (16.0, false),
        (22.0, false),
        (32.0, true),
        (43.0, true),
        (60.0, true),
    ] {
        let seen = from_above(&reference, x, &shadows);
        let expected = if is_lit {
            from_above(&reference, x, &plain)
        } else {
            plain.ambient
        };
        assert!((seen - expected).abs() < 0.02, "at {x}: {seen}, not {expected}");
    }
}

#[test]
fn a_wall_hides_its_part_of_the_sky() {
    let reference = wall();
    let sky = RenderSettings {
        ambient: 1.0,
        diffuse: 0.0,
        occlusion: true,
        ..RenderSettings::default()
    };
    for x in [2.0f64, 8.0, 16.0, 21.0] {
        // Of an endless wall, by cosine: half of what the angle up to its top leaves.
        let (away, up) = (WALL[0] - x, TOP - GROUND);
        let expected = 0.5 + 0.5 * away / away.hypot(up);
        let seen = from_above(&reference, x, &sky);
        // Each of the outer cones has 0.15 of it.
        assert!((seen - expected).abs() < 0.1, "at {x}: {seen}, not {expected}");
    }
}

#[test]
fn what_has_no_normal_is_in_no_shadow() {
    let mut store = Store::default();
    let head = header(DVec3::ZERO, 1.0, DEPTH, SampleLayout::Centre, 1);
    let kind = |level: u8, p: glam::UVec3| match level {
        DEPTH => Kind::Leaf(if p.z < 2 || p.z > 4 && p.x < 4 {
            [255; 4]
        } else {
            [0; 4]
        }),
        _ => Kind::Inner([255; 4]),
    };
    store.add("t.oct", head, kind, |_, _| Stored::default());
    let reference = store.open(&["t.oct"]);
    let settings = RenderSettings {
        shadows: true,
        occlusion: true,
        ..RenderSettings::default()
    };
    assert!((from_above(&reference, 40.0, &settings) - 1.0).abs() < 1e-3);
}
