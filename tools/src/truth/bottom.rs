//! How deep solid ground goes.

use glam::{DVec2, DVec3};

/// Most entries of the table of columns; a scene with more, which nobody builds, has one depth.
const MAX_TABLE: usize = 1 << 26;

/// Where solid ground ends below.
#[derive(Clone, Debug)]
pub enum Bottom {
    /// At one height, metres.
    Level(f64),
    /// At the lowest face of the boxes (least and greatest corner, world metres) over a place, and at the lowest of all
    /// where there is none. The boxes of a database's trees give its own bottom where no mesh reaches below it.
    Boxes(Vec<[DVec3; 2]>),
}

/// The bottom by columns between the boxes' sides.
pub(super) struct Floors {
    x: Vec<f64>,
    y: Vec<f64>,
    /// By (y, x) interval.
    lowest: Vec<f64>,
    all: f64,
}

impl Floors {
    pub(super) fn new(bottom: &Bottom) -> Self {
        let boxes: &[[DVec3; 2]] = match bottom {
            Bottom::Level(_) => &[],
            Bottom::Boxes(boxes) => boxes,
        };
        let all = match bottom {
            Bottom::Level(z) => *z,
            Bottom::Boxes(boxes) => boxes.iter().map(|b| b[0].z).fold(f64::INFINITY, f64::min),
        };
        let sides = |k: usize| {
            let mut sides: Vec<f64> = boxes.iter().flat_map(|b| [b[0][k], b[1][k]]).collect();
            sides.sort_by(f64::total_cmp);
            sides.dedup();
            sides
        };
        let mut floors = Self {
            x: sides(0),
            y: sides(1),
            lowest: Vec::new(),
            all,
        };
        if floors.x.len().saturating_mul(floors.y.len()) > MAX_TABLE {
            (floors.x, floors.y) = (Vec::new(), Vec::new());
            return floors;
        }
        floors.lowest = vec![f64::INFINITY; floors.x.len() * floors.y.len()];
        for [min, max] in boxes {
            let range = |sides: &[f64], k: usize| {
                sides.partition_point(|s| *s < min[k])..sides.partition_point(|s| *s < max[k])
            };
            for j in range(&floors.y, 1) {
                for i in range(&floors.x, 0) {
                    let floor = &mut floors.lowest[j * floors.x.len() + i];
                    *floor = floor.min(min.z);
                }
            }
        }
        floors
    }

    /// Interval along an axis (0 or 1) that a coordinate lies in; the bottom does not change inside of one on each axis.
    pub(super) fn interval(&self, axis: usize, at: f64) -> usize {
        [&self.x, &self.y][axis].partition_point(|s| *s <= at)
    }

    /// The bottom at a place, metres.
    pub(super) fn at(&self, place: DVec2) -> f64 {
        let (i, j) = (self.interval(0, place.x), self.interval(1, place.y));
        let floor = i
            .checked_sub(1)
            .zip(j.checked_sub(1))
            .and_then(|(i, j)| self.lowest.get(j * self.x.len() + i));
        floor.copied().filter(|z| z.is_finite()).unwrap_or(self.all)
    }
}
