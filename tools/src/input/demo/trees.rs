//! Hundreds of trees: trunks of bark and clusters of alpha-cut leaf cards.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::model::Model;
use super::terrain::Terrain;
use super::textures::Leaves;
use crate::noise::Random;

/// Distance between places where a tree may stand, metres.
const SPACING: f64 = 4.2;

/// The library that goes with the model.
pub(super) const LIBRARY: &str = "newmtl bark\nKd 1.0 1.0 1.0\nmap_Kd bark.png\n\n\
newmtl birch\nKd 2.0 2.1 2.2\nmap_Kd bark.png\n\n\
newmtl leaves\nKd 1.0 1.0 1.0\nmap_Kd leaf.png\nmap_d leaf.png\n";

/// Plants the terrain.
pub(super) fn plant(terrain: &Terrain) -> (Model, usize) {
    let mut random = Random::new(terrain.seed ^ 0x7ee5);
    let mut model = Model::default();
    let mut count = 0;
    let cells = (terrain.size / SPACING) as i64;
    for j in 0..cells {
        for i in 0..cells {
            let jitter = DVec2::new(random.unit(), random.unit());
            let at = (DVec2::new(i as f64, j as f64) + jitter) * SPACING;
            let (chance, kind) = (random.unit(), random.unit());
            let ground = terrain.ground(at);
            let edge = at.min_element().min(terrain.size - at.max_element());
            let open = ground.depth < -0.5
                && ground.road > 4.5
                && ground.stream > 2.6
                && ground.site > 2.0
                && terrain.field(at).1 > 1.5;
            // Forest where the woods are, single trees and bushes elsewhere.
            let woods = terrain.woods(at);
            if edge < 6.5 || !open || ground.height > 60.0 || chance > 0.05 + 0.6 * woods * woods {
                continue;
            }
            if terrain.slope(at) > 0.75 {
                continue;
            }
            let foot = DVec3::new(at.x, at.y, ground.height - 0.4);
            let high = (ground.height - 26.0) / 30.0;
            if chance < 0.018 || kind < 0.10 {
                bush(&mut model, foot, &mut random);
            } else if kind < 0.45 + 0.5 * high.max(0.0) {
                conifer(&mut model, foot, &mut random);
            } else if kind < 0.85 {
                broadleaf(&mut model, foot, &mut random);
            } else {
                birch(&mut model, foot, &mut random);
            }
            count += 1;
        }
    }
    (model, count)
}

/// A tapering prism of six sides; bark repeats round and up.
fn trunk(model: &mut Model, material: &'static str, foot: DVec3, top: DVec3, radii: (f64, f64)) {
    let ring = |center: DVec3, radius: f64, k: u32| {
        let d = DVec2::from_angle(f64::from(k) / 6.0 * TAU);
        (
            center + DVec3::new(d.x, d.y, 0.0) * radius,
            DVec3::new(d.x, d.y, 0.0),
        )
    };
    let length = (top - foot).length() / 1.5;
    for k in 0..6 {
        let ((a, na), (b, nb)) = (ring(foot, radii.0, k), ring(foot, radii.0, k + 1));
        let ((d, _), (c, _)) = (ring(top, radii.1, k), ring(top, radii.1, k + 1));
        let (u0, u1) = (f64::from(k) / 3.0, f64::from(k + 1) / 3.0);
        let uv = [
            DVec2::new(u0, 0.0),
            DVec2::new(u1, 0.0),
            DVec2::new(u1, length),
            DVec2::new(u0, length),
        ];
        let normal = (na + nb).normalize_or(DVec3::Z);
        model.polygon(
            material,
            normal,
            &[(a, uv[0]), (b, uv[1]), (c, uv[2]), (d, uv[3])],
        );
    }
}

/// A leaf card: a square of `side` around `center` in the plane of two axes. All of it faces `outwards`, which makes a
/// crown shade like a ball and not like a pile of cards.
fn card(model: &mut Model, leaves: Leaves, center: DVec3, axes: (DVec3, DVec3), outwards: DVec3) {
    let [u, v] = leaves.corner();
    let uv = |x: f64, y: f64| DVec2::new(u + 0.5 * x, v + 0.5 * y);
    let (x, y) = (axes.0 * 0.5, axes.1 * 0.5);
    let corners = [
        (center - x - y, uv(0.0, 0.0)),
        (center + x - y, uv(1.0, 0.0)),
        (center + x + y, uv(1.0, 1.0)),
        (center - x + y, uv(0.0, 1.0)),
    ];
    model.polygon("leaves", outwards, &corners);
}

fn direction(random: &mut Random) -> DVec3 {
    let z = random.between(-0.55, 1.0);
    let flat = DVec2::from_angle(random.between(0.0, TAU)) * (1.0 - z * z).sqrt();
    DVec3::new(flat.x, flat.y, z)
}

/// Cards over an ellipsoid, each at right angles to its radius give or take.
fn crown(model: &mut Model, leaves: Leaves, center: DVec3, radii: DVec3, cards: u32, random: &mut Random) {
    for _ in 0..cards {
        let out = direction(random);
        let at = center + out * radii * random.between(0.45, 0.85);
        let tilted = (out + direction(random) * 0.7).normalize_or(DVec3::Z);
        let (a, b) = tilted.any_orthonormal_pair();
        let (sin, cos) = random.between(0.0, TAU).sin_cos();
        let side = radii.max_element() * random.between(0.95, 1.3);
        card(
            model,
            leaves,
            at,
            ((a * cos + b * sin) * side, (b * cos - a * sin) * side),
            out,
        );
    }
}

fn broadleaf(model: &mut Model, foot: DVec3, random: &mut Random) {
    let height = random.between(7.0, 12.5);
    let lean = DVec3::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5), 0.0);
    let top = foot + DVec3::Z * height * 0.62 + lean;
    trunk(model, "bark", foot, top, (0.032 * height, 0.016 * height));
    let spread = height * random.between(0.26, 0.34);
    let center = foot + DVec3::Z * (height * 0.68) + lean;
    crown(
        model,
        Leaves::Broad,
        center,
        DVec3::new(spread, spread, height * 0.30),
        16,
        random,
    );
    for _ in 0..3 {
        let d = DVec2::from_angle(random.between(0.0, TAU)) * spread * 0.6;
        let bough = center + DVec3::new(d.x, d.y, random.between(-0.16, 0.05) * height);
        trunk(
            model,
            "bark",
            foot + DVec3::Z * height * 0.36,
            bough,
            (0.013 * height, 0.006 * height),
        );
        crown(
            model,
            Leaves::Broad,
            bough,
            DVec3::splat(spread * 0.55),
            4,
            random,
        );
    }
}

fn birch(model: &mut Model, foot: DVec3, random: &mut Random) {
    let height = random.between(8.0, 13.0);
    let lean = DVec3::new(random.between(-0.8, 0.8), random.between(-0.8, 0.8), 0.0);
    trunk(
        model,
        "birch",
        foot,
        foot + DVec3::Z * height * 0.85 + lean,
        (0.018 * height, 0.007 * height),
    );
    for k in 0..3 {
        let up = 0.48 + 0.2 * f64::from(k);
        let radius = height * (0.21 - 0.04 * f64::from(k));
        let center = foot + DVec3::Z * height * up + lean * up;
        crown(
            model,
            Leaves::Light,
            center,
            DVec3::new(radius, radius, radius * 1.25),
            6,
            random,
        );
    }
}

fn conifer(model: &mut Model, foot: DVec3, random: &mut Random) {
    let height = random.between(8.0, 16.0);
    trunk(
        model,
        "bark",
        foot,
        foot + DVec3::Z * height * 0.94,
        (0.026 * height, 0.004 * height),
    );
    let layers = (height * 0.62) as u32;
    let start = random.between(0.0, TAU);
    for layer in 0..layers {
        let t = f64::from(layer) / f64::from(layers);
        let reach = height * 0.235 * (1.0 - t).powf(0.85) + 0.35;
        let z = height * (0.16 + 0.80 * t);
        for k in 0..6 {
            let angle = start + f64::from(layer) * 0.9 + f64::from(k) / 6.0 * TAU + random.between(-0.2, 0.2);
            let flat = DVec2::from_angle(angle);
            // Boughs droop; the card's u axis runs along the bough, away from the trunk.
            let along =
                DVec3::new(flat.x, flat.y, -0.42).normalize_or(DVec3::X) * reach * random.between(0.9, 1.15);
            let across = DVec3::new(-flat.y, flat.x, 0.0) * reach * 0.95;
            let center = foot + DVec3::new(0.0, 0.0, z + 0.2 * reach) + along * 0.5;
            let outwards = DVec3::new(flat.x, flat.y, 0.55).normalize_or(DVec3::Z);
            card(model, Leaves::Needles, center, (along, across), outwards);
        }
    }
    for k in 0..2 {
        let flat = DVec2::from_angle(start + f64::from(k) * TAU / 4.0) * 0.9;
        let center = foot + DVec3::Z * (height * 0.96);
        card(
            model,
            Leaves::Needles,
            center,
            (DVec3::Z * 1.6, DVec3::new(flat.x, flat.y, 0.0)),
            DVec3::Z,
        );
    }
}

fn bush(model: &mut Model, foot: DVec3, random: &mut Random) {
    let size = random.between(0.8, 1.5);
    crown(
        model,
        Leaves::Bush,
        foot + DVec3::Z * (0.4 + size * 0.45),
        DVec3::splat(size * 0.8),
        7,
        random,
    );
}
