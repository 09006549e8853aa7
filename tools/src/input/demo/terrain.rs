//! The shape of the demo ground: hills, a crag with a cliff, a lake, a stream, a road and level places for houses.
//!
//! Positions are world metres. Landmarks lie at fixed places of a plan 256 units wide, stretched to the terrain's size;
//! heights are not stretched.

use glam::DVec2;

use crate::noise::{Random, fractal, lerp, smoothstep};

/// Width of the plan.
const PLAN: f64 = 256.0;
/// Level of the lake, metres.
pub(super) const LAKE: f64 = 6.0;
/// Half the width of the road, metres.
const ROAD_HALF_WIDTH: f64 = 1.9;

/// A place levelled for a building.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    /// Centre.
    pub(super) at: DVec2,
    /// Direction of the ridge, radians from east.
    pub(super) angle: f64,
    /// Level radius, metres.
    pub(super) radius: f64,
    /// Level, metres.
    pub(super) level: f64,
    /// Whether the church stands here.
    pub(super) church: bool,
}

/// The ground.
pub(super) struct Terrain {
    pub(super) seed: u64,
    /// Side of the square, metres.
    pub(super) size: f64,
    /// Metres per unit of the plan.
    scale: f64,
    road: Course,
    stream: Course,
    pub(super) sites: Vec<Site>,
}

/// What lies at a place.
pub(super) struct Ground {
    /// Surface, metres; the lake's where there is water.
    pub(super) height: f64,
    /// Depth of the lake, negative on land.
    pub(super) depth: f64,
    /// Distance to the middle of the road, metres.
    pub(super) road: f64,
    /// Distance to the middle of the stream, metres.
    pub(super) stream: f64,
    /// Distance to the edge of the nearest building site, metres; negative inside.
    pub(super) site: f64,
}

impl Terrain {
    pub(super) fn new(seed: u64, size: f64) -> Terrain {
        let scale = size / PLAN;
        let plan = |points: &[(f64, f64)]| -> Vec<DVec2> {
            points.iter().map(|p| DVec2::new(p.0, p.1) * scale).collect()
        };
        let road = plan(&[
            (-8.0, 120.0),
            (36.0, 112.0),
            (76.0, 108.0),
            (112.0, 86.0),
            (146.0, 70.0),
            (188.0, 72.0),
            (222.0, 52.0),
            (264.0, 44.0),
        ]);
        let stream = plan(&[
            (139.0, 163.0),
            (122.0, 158.0),
            (108.0, 146.0),
            (112.0, 128.0),
            (96.0, 112.0),
            (88.0, 92.0),
            (72.0, 79.0),
            (58.0, 70.0),
        ]);
        let mut terrain = Terrain {
            seed,
            size,
            scale,
            road: Course::default(),
            stream: Course::default(),
            sites: Vec::new(),
        };
        terrain.road = Course::new(&road, |p| terrain.natural(p).max(LAKE + 0.8));
        terrain.stream = Course::new(&stream, |p| terrain.natural(p) - 0.9);
        terrain.sites = terrain.village();
        terrain
    }

    /// A dozen sites along the road and one on a rise above it.
    fn village(&self) -> Vec<Site> {
        let mut random = Random::new(self.seed ^ 0x51f1);
        let mut sites: Vec<Site> = Vec::new();
        let mut place = |at: DVec2, angle: f64, radius: f64, church: bool| {
            let free = sites.iter().all(|s| s.at.distance(at) > s.radius + radius + 1.0);
            if free {
                sites.push(Site {
                    at,
                    angle,
                    radius,
                    level: self.natural(at).max(LAKE + 1.2),
                    church,
                });
            }
        };
        let road = &self.road.points;
        place(DVec2::new(160.0, 98.0) * self.scale, 0.35, 13.0, true);
        for along in 0..11 {
            let t = 0.42 + 0.53 * f64::from(along) / 10.0;
            let i = ((t * (road.len() - 1) as f64) as usize).min(road.len() - 2);
            let direction = (road[i + 1].0 - road[i].0).normalize_or(DVec2::X);
            for side in [-1.0, 1.0] {
                let away = random.between(12.0, 17.0);
                let at = road[i].0 + direction.perp() * side * away + direction * random.between(-3.0, 3.0);
                let turn = if random.unit() < 0.35 {
                    std::f64::consts::FRAC_PI_2
                } else {
                    0.0
                };
                let angle = direction.to_angle() + turn + random.between(-0.12, 0.12);
                place(at, angle, random.between(6.6, 7.6), false);
            }
        }
        sites.retain(|s| s.at.min_element() > 12.0 && s.at.max_element() < self.size - 12.0);
        sites
    }

    /// The ground before road, stream and sites, the lake's bed included.
    fn natural(&self, at: DVec2) -> f64 {
        let p = at / self.scale;
        let seed = self.seed;
        let warp = DVec2::new(fractal(seed ^ 1, p / 46.0, 3), fractal(seed ^ 2, p / 46.0, 3)) * 7.0;
        let mut h = 13.0 + 4.5 * fractal(seed ^ 3, p / 80.0, 4) + 0.9 * fractal(seed ^ 4, p / 15.0, 3);
        h += 5.0 * smoothstep(90.0, 250.0, p.y);
        let knoll = (p + warp - DVec2::new(48.0, 206.0)) / DVec2::new(46.0, 38.0);
        h += 19.0 * (-knoll.length_squared() * 1.4).exp();
        let shore =
            p + warp * 1.2 + DVec2::new(fractal(seed ^ 7, p / 19.0, 3), fractal(seed ^ 8, p / 19.0, 3)) * 5.0;
        let basin = ((shore - DVec2::new(42.0, 58.0)) / DVec2::new(40.0, 36.0)).length();
        let arm = ((shore - DVec2::new(70.0, 36.0)) / DVec2::new(40.0, 22.0)).length();
        h = lerp(h, 1.2, smoothstep(1.35, 0.45, basin.min(arm + 0.1)));
        h + self.crag(p, warp)
    }

    /// The crag: a wall to the south-west, a back that slopes away to the north-east, ledges in the wall.
    fn crag(&self, p: DVec2, warp: DVec2) -> f64 {
        let q = p + warp * 0.9 - DVec2::new(174.0, 174.0);
        let facing = q
            .normalize_or_zero()
            .dot(DVec2::splat(-std::f64::consts::FRAC_1_SQRT_2));
        let wall = smoothstep(-0.25, 0.55, facing);
        let width = lerp(96.0, 13.0, wall);
        // Buttresses and gullies, and a rim that is not round.
        let rim = 22.0
            + 6.5 * fractal(self.seed ^ 10, p / 27.0, 3)
            + 2.0 * wall * fractal(self.seed ^ 11, p / 7.0, 2);
        let inside = 1.0 - ((q.length() - rim) / width).clamp(0.0, 1.0);
        let rise = 58.0 * lerp(smoothstep(0.0, 1.0, inside), inside, 0.5 * wall);
        // Rough where it is steep, smooth on the back and on top.
        let rugged =
            smoothstep(0.0, 0.3, inside) * lerp(0.4, 1.0, wall) * smoothstep(1.0, 0.8, inside).max(0.25);
        let jagged = 4.6 * fractal(self.seed ^ 5, p / 11.0, 4) * rugged;
        let (step, rough) = (8.5, rise + jagged + 1.5 * fractal(self.seed ^ 6, p / 23.0, 2));
        let ledges = ((rough / step).floor() + smoothstep(0.35, 0.95, (rough / step).fract())) * step;
        let steep = wall * smoothstep(0.02, 0.2, inside) * smoothstep(1.0, 0.85, inside);
        lerp(rise + jagged, ledges.max(0.0), 0.75 * steep)
    }

    /// Everything about a place.
    pub(super) fn ground(&self, at: DVec2) -> Ground {
        let mut h = self.natural(at);
        let (stream, bed) = self.stream.nearest(at);
        h = lerp(h.min(bed + stream * 0.4), h, smoothstep(2.5, 7.0, stream));
        let (road, level) = self.road.nearest(at);
        h = lerp(
            level,
            h,
            smoothstep(ROAD_HALF_WIDTH + 0.6, ROAD_HALF_WIDTH + 7.0, road),
        );
        let mut site = f64::INFINITY;
        for s in &self.sites {
            let edge = s.at.distance(at) - s.radius;
            h = lerp(s.level, h, smoothstep(0.0, 6.0, edge));
            site = site.min(edge);
        }
        let depth = LAKE - h;
        Ground {
            height: h.max(LAKE),
            depth,
            road,
            stream,
            site,
        }
    }

    /// Surface at a place, metres.
    pub(super) fn height(&self, at: DVec2) -> f64 {
        self.ground(at).height
    }

    /// Steepness (rise over run) at a place.
    pub(super) fn slope(&self, at: DVec2) -> f64 {
        let h = |dx: f64, dy: f64| self.height(at + DVec2::new(dx, dy));
        DVec2::new(h(0.75, 0.0) - h(-0.75, 0.0), h(0.0, 0.75) - h(0.0, -0.75)).length() / 1.5
    }

    /// The fields south of the road: position inside them along the strips' row (-0.2 to 0.2) and across, in sides of
    /// the terrain, and the distance to their edge in metres, negative inside.
    pub(super) fn field(&self, at: DVec2) -> (DVec2, f64) {
        let local = DVec2::from_angle(0.21).rotate(at / self.size - DVec2::new(0.60, 0.115));
        (
            local,
            (local.abs() - DVec2::new(0.20, 0.075)).max_element() * self.size,
        )
    }

    /// How much a place is wooded, 0..1, by position alone.
    pub(super) fn woods(&self, at: DVec2) -> f64 {
        let p = at / self.scale;
        let patches = smoothstep(-0.05, 0.45, fractal(self.seed ^ 9, at / 38.0, 3));
        let north_west = smoothstep(0.9, 0.2, p.distance(DVec2::new(52.0, 200.0)) / 110.0);
        (0.85 * patches + 0.6 * north_west).min(1.0)
    }
}

impl Ground {
    /// 1 on the road, 0 beside it.
    pub(super) fn on_road(&self) -> f64 {
        smoothstep(ROAD_HALF_WIDTH + 0.5, ROAD_HALF_WIDTH - 0.3, self.road)
    }
}

/// A smooth line through points, with a level along it.
#[derive(Default)]
struct Course {
    points: Vec<(DVec2, f64)>,
    /// Boxes around the pieces of `STEPS` segments.
    boxes: Vec<(DVec2, DVec2)>,
}

impl Course {
    /// Steps between two given points.
    const STEPS: usize = 12;

    fn new(through: &[DVec2], level: impl Fn(DVec2) -> f64) -> Course {
        let at = |i: isize| through[i.clamp(0, through.len() as isize - 1) as usize];
        let mut line = Vec::new();
        for i in 0..through.len() as isize - 1 {
            let (a, b, c, d) = (at(i - 1), at(i), at(i + 1), at(i + 2));
            for step in 0..Self::STEPS {
                let t = step as f64 / Self::STEPS as f64;
                let (t2, t3) = (t * t, t * t * t);
                let p = b * 2.0
                    + (c - a) * t
                    + (a * 2.0 - b * 5.0 + c * 4.0 - d) * t2
                    + (b * 3.0 - a - c * 3.0 + d) * t3;
                line.push(p * 0.5);
            }
        }
        line.extend(through.last());
        let raw: Vec<f64> = line.iter().map(|p| level(*p)).collect();
        let smooth = |i: usize| {
            let window = &raw[i.saturating_sub(7)..(i + 8).min(raw.len())];
            window.iter().sum::<f64>() / window.len() as f64
        };
        let points: Vec<(DVec2, f64)> = line.iter().enumerate().map(|(i, p)| (*p, smooth(i))).collect();
        let piece = |points: &[(DVec2, f64)]| {
            let start = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            points
                .iter()
                .fold(start, |(low, high), (p, _)| (low.min(*p), high.max(*p)))
        };
        let boxes = points
            .windows(Self::STEPS + 1)
            .step_by(Self::STEPS)
            .map(piece)
            .collect();
        Course { points, boxes }
    }

    /// Distance to the line and its level there.
    fn nearest(&self, at: DVec2) -> (f64, f64) {
        let mut best = (f64::INFINITY, 0.0);
        for (points, (low, high)) in self
            .points
            .windows(Self::STEPS + 1)
            .step_by(Self::STEPS)
            .zip(&self.boxes)
        {
            if at.clamp(*low, *high).distance_squared(at) >= best.0 {
                continue;
            }
            for pair in points.windows(2) {
                let [(a, level_a), (b, level_b)] = [pair[0], pair[1]];
                let t = ((at - a).dot(b - a) / (b - a).length_squared().max(1e-9)).clamp(0.0, 1.0);
                let distance = at.distance_squared(a.lerp(b, t));
                if distance < best.0 {
                    best = (distance, lerp(level_a, level_b, t));
                }
            }
        }
        (best.0.sqrt(), best.1)
    }
}
