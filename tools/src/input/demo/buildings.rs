//! A village: houses with windows and tiled gable roofs, and a church.

use glam::{DVec2, DVec3};

use super::model::Model;
use super::terrain::{Site, Terrain};
use crate::noise::Random;

/// How deep walls reach into the ground, metres.
const SUNK: f64 = 0.8;
/// Side of the pictures of wall and roof in the world, metres.
const WALL_TILE: f64 = 3.0;
const ROOF_TILE: f64 = 2.0;

/// The library that goes with the model.
pub(super) const LIBRARY: &str = "newmtl brick\nKd 1.0 0.72 0.60\nmap_Kd wall.png\n\n\
newmtl plaster\nKd 1.0 1.0 1.0\nmap_Kd wall.png\n\n\
newmtl ochre\nKd 1.0 0.93 0.78\nmap_Kd wall.png\n\n\
newmtl tiles\nKd 1.0 1.0 1.0\nmap_Kd roof.png\n\n\
newmtl slate\nKd 0.55 0.95 1.0\nmap_Kd roof.png\n\n\
newmtl wood\nKd 0.33 0.22 0.14\n\n\
newmtl stone\nKd 0.62 0.60 0.56\n";

/// A box standing on the ground, in its own frame: x along the ridge.
struct Frame {
    origin: DVec3,
    x: DVec3,
    y: DVec3,
}

impl Frame {
    fn new(site: &Site) -> Frame {
        let d = DVec2::from_angle(site.angle);
        Frame {
            origin: site.at.extend(site.level),
            x: DVec3::new(d.x, d.y, 0.0),
            y: DVec3::new(-d.y, d.x, 0.0),
        }
    }

    fn at(&self, x: f64, y: f64, z: f64) -> DVec3 {
        self.origin + self.x * x + self.y * y + DVec3::Z * z
    }
}

/// Builds on every site of the terrain.
pub(super) fn build(terrain: &Terrain) -> Model {
    let mut random = Random::new(terrain.seed ^ 0xb01d);
    let mut model = Model::default();
    for site in &terrain.sites {
        let frame = Frame::new(site);
        if site.church {
            church(&mut model, &frame);
            continue;
        }
        let (length, width) = (random.between(9.0, 12.6), random.between(6.6, 8.0));
        let storeys = if random.unit() < 0.55 { 2.0 } else { 1.0 };
        let wall = ["brick", "plaster", "ochre"][(random.unit() * 3.0) as usize % 3];
        house(
            &mut model,
            &frame,
            DVec2::new(length, width) * 0.5,
            storeys * WALL_TILE,
            wall,
            "tiles",
        );
        let door = length * 0.5 * random.between(-0.3, 0.3);
        block(
            &mut model,
            &frame,
            "wood",
            DVec2::new(door, -width * 0.5 - 0.1),
            DVec2::new(0.6, 0.25),
            (-0.5, 2.3),
        );
        let stack = length * random.between(0.15, 0.35);
        let ridge = storeys * WALL_TILE + width * 0.5 * 0.85;
        block(
            &mut model,
            &frame,
            "brick",
            DVec2::new(stack, 0.6),
            DVec2::splat(0.45),
            (ridge - 1.5, ridge + 1.1),
        );
    }
    model
}

/// Four walls; a whole number of bays to a side, so that no window is cut at a corner.
fn walls(model: &mut Model, frame: &Frame, half: DVec2, height: f64, material: &'static str) {
    let corners = [
        (-half.x, -half.y),
        (half.x, -half.y),
        (half.x, half.y),
        (-half.x, half.y),
    ];
    for i in 0..4 {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        let length = (b.0 - a.0).hypot(b.1 - a.1);
        let u = (length / WALL_TILE).round().max(1.0);
        let (v0, v1) = (-SUNK / WALL_TILE, height / WALL_TILE);
        model.flat(
            material,
            &[
                (frame.at(a.0, a.1, -SUNK), DVec2::new(0.0, v0)),
                (frame.at(b.0, b.1, -SUNK), DVec2::new(u, v0)),
                (frame.at(b.0, b.1, height), DVec2::new(u, v1)),
                (frame.at(a.0, a.1, height), DVec2::new(0.0, v1)),
            ],
        );
    }
}

/// A house with its ridge along x: walls, gables, a roof with eaves and an underside.
fn house(model: &mut Model, frame: &Frame, half: DVec2, height: f64, wall: &'static str, roof: &'static str) {
    walls(model, frame, half, height, wall);
    let pitch = 0.85;
    let ridge = height + half.y * pitch;
    // Gables show plain brick: the picture's strip between two windows.
    for side in [-1.0, 1.0] {
        let p = |y: f64, z: f64| {
            (
                frame.at(side * half.x, side * y, z),
                DVec2::new(0.04 + 0.004 * y, z / WALL_TILE),
            )
        };
        model.flat(wall, &[p(-half.y, height), p(half.y, height), p(0.0, ridge)]);
    }
    let (eave, end) = (0.55, half.x + 0.5);
    let low = DVec2::new(half.y + eave, height - eave * pitch);
    let run = DVec2::new(low.x, ridge - low.y).length() / ROOF_TILE;
    for side in [-1.0, 1.0] {
        let (u0, u1) = (-end / ROOF_TILE, end / ROOF_TILE);
        for lift in [0.0, 0.25] {
            model.flat(
                roof,
                &[
                    (
                        frame.at(side * end, -side * low.x, low.y + lift),
                        DVec2::new(u1, 0.0),
                    ),
                    (frame.at(side * end, 0.0, ridge + lift), DVec2::new(u1, run)),
                    (frame.at(-side * end, 0.0, ridge + lift), DVec2::new(u0, run)),
                    (
                        frame.at(-side * end, -side * low.x, low.y + lift),
                        DVec2::new(u0, 0.0),
                    ),
                ],
            );
        }
    }
}

/// A plain box between two heights.
fn block(
    model: &mut Model,
    frame: &Frame,
    material: &'static str,
    at: DVec2,
    half: DVec2,
    (low, high): (f64, f64),
) {
    let corner = |i: usize, z: f64| {
        let (sx, sy) = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][i % 4];
        frame.at(at.x + sx * half.x, at.y + sy * half.y, z)
    };
    // A corner of the wall picture that is brick all over.
    let uv = |x: f64, z: f64| DVec2::new(0.03 + 0.1 * x, 0.12 + 0.02 * (z - low));
    for i in 0..4 {
        model.flat(
            material,
            &[
                (corner(i, low), uv(0.0, low)),
                (corner(i + 1, low), uv(1.0, low)),
                (corner(i + 1, high), uv(1.0, high)),
                (corner(i, high), uv(0.0, high)),
            ],
        );
    }
    let top: [(DVec3, DVec2); 4] = std::array::from_fn(|i| (corner(i, high), uv(0.5, low)));
    model.flat(material, &top);
}

/// A nave under slate and a square tower with a spire.
fn church(model: &mut Model, frame: &Frame) {
    house(model, frame, DVec2::new(9.0, 4.6), 6.0, "plaster", "slate");
    let tower = Frame {
        origin: frame.at(-10.5, 0.0, 0.0),
        x: frame.x,
        y: frame.y,
    };
    walls(model, &tower, DVec2::splat(2.6), 15.0, "plaster");
    block(
        model,
        &tower,
        "stone",
        DVec2::ZERO,
        DVec2::splat(2.85),
        (14.8, 15.4),
    );
    let tip = tower.at(0.0, 0.0, 25.0);
    let foot: [DVec3; 4] =
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| tower.at(x * 2.75, y * 2.75, 15.4));
    for i in 0..4 {
        let uv = [DVec2::ZERO, DVec2::new(2.75, 0.0), DVec2::new(1.375, 5.0)];
        model.flat(
            "slate",
            &[(foot[i], uv[0]), (foot[(i + 1) % 4], uv[1]), (tip, uv[2])],
        );
    }
    block(
        model,
        frame,
        "wood",
        DVec2::new(3.0, -4.7),
        DVec2::new(0.9, 0.25),
        (-0.5, 2.8),
    );
}
