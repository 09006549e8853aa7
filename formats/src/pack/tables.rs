//! What is stored of a look, and the looks of which something is stored.
//!
//! A look is a sample without its opacity: a straight colour in the sRGB encoding and a normal over 127. What is stored of it at an
//! alpha is what [`Value::store`] says, component by component, so two tables tell it.

use std::sync::LazyLock;

use crate::steps::{COLOR_ZERO, NORMAL_ZERO, Steps};
use crate::value::{BUILD_GAIN, Value, srgb_decode, srgb_to_linear};

/// Red, green, blue, and the normal's x, y, z as unsigned bytes (see [`flip`]); or what is stored of them.
pub(super) type Look = [u8; 6];

/// The code of nothing, by component.
pub(super) const ZERO: [u8; 6] = [
    COLOR_ZERO,
    COLOR_ZERO,
    COLOR_ZERO,
    NORMAL_ZERO,
    NORMAL_ZERO,
    NORMAL_ZERO,
];

/// Values of a byte.
const CODES: usize = 256;

/// A function of bytes, and the first and last byte that it takes to each; the first is above the last where there is none.
struct Table {
    forth: Vec<u8>,
    back: Vec<[u8; 2]>,
}

/// By component (colour, normal) and alpha.
static TABLES: LazyLock<[Table; 2]> = LazyLock::new(|| {
    let value = |alpha: u8, look: u8| {
        Value {
            rgb: [srgb_to_linear(look); 3],
            alpha: f32::from(alpha) / 255.0,
            normal: [f32::from(flip(look) as i8) / 127.0; 3],
        }
        .store(BUILD_GAIN)
    };
    [
        Table::new(|alpha, look| value(alpha, look).color[0]),
        Table::new(|alpha, look| flip(value(alpha, look).normal[0] as u8)),
    ]
});

/// Signed bytes as unsigned ones in the same order, and back.
pub(super) fn flip(v: u8) -> u8 {
    v ^ 0x80
}

impl Table {
    fn new(function: impl Fn(u8, u8) -> u8) -> Self {
        let mut forth = Vec::with_capacity(CODES * CODES);
        let mut back = vec![[255, 0]; CODES * CODES];
        for alpha in 0..=255u8 {
            for look in 0..=255u8 {
                let stored = function(alpha, look);
                forth.push(stored);
                let range: &mut [u8; 2] = &mut back[row(alpha) + usize::from(stored)];
                *range = [range[0].min(look), range[1].max(look)];
            }
        }
        Self { forth, back }
    }
}

fn row(alpha: u8) -> usize {
    usize::from(alpha) * CODES
}

/// Linear light of the codes of a colour, 1 as 2^24, and the least light of each code.
static LIGHT: LazyLock<[[u32; CODES]; 2]> = LazyLock::new(|| {
    let light = |code: f64| (srgb_decode(code / 255.0) * f64::from(1u32 << 24)).round() as u32;
    [
        std::array::from_fn(|code| light(code as f64)),
        std::array::from_fn(|code| light((code as f64 - 0.5).max(0.0))),
    ]
});

/// Linear light of a colour's code, 1 as 2^24.
#[inline]
pub(super) fn light(code: u8) -> u32 {
    LIGHT[0][usize::from(code)]
}

/// The code that is nearest, by its light, to so much.
#[inline]
pub(super) fn code(light: u32) -> u8 {
    (LIGHT[1].partition_point(|least| *least <= light).max(1) - 1) as u8
}

/// What is stored of a look.
#[inline]
pub(super) fn stored(alpha: u8, look: &Look) -> Look {
    let tables = &*TABLES;
    let [color, normal] = [0, 1].map(|k| &tables[k].forth[row(alpha)..][..CODES]);
    std::array::from_fn(|k| (if k < 3 { color } else { normal })[usize::from(look[k])])
}

/// First and last look of which a sample is stored, by component; all looks where it is of none.
pub(super) fn looks(alpha: u8, stored: &Look) -> [[u8; 2]; 6] {
    let tables = &*TABLES;
    std::array::from_fn(
        |k| match tables[k / 3].back[row(alpha) + usize::from(stored[k])] {
            [first, last] if first <= last => [first, last],
            _ => [0, 255],
        },
    )
}

/// The nearest look in steps.
#[inline]
pub(super) fn in_steps(look: &Look, steps: Steps) -> Look {
    if steps.step() == 1 {
        return *look;
    }
    std::array::from_fn(|k| steps.nearest(ZERO[k], look[k]))
}

/// Whether a component has a step in a range of looks.
#[inline]
pub(super) fn has_step(steps: Steps, k: usize, range: [u8; 2]) -> bool {
    let [first, last] = steps.in_range(ZERO[k], range);
    first <= last
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Files depend on the tables, which come of floating point: they must be the same on every machine.
    #[test]
    fn tables_are_those_that_files_were_written_with() {
        let all: Vec<u8> = TABLES.iter().flat_map(|t| t.forth.iter().copied()).collect();
        assert_eq!(crc32fast::hash(&all), 698_833_117);
    }

    #[test]
    fn all_that_is_stored_of_a_look_has_looks_around_it() {
        for (component, table) in [0, 3].map(|k| (k, &TABLES[k / 3])) {
            for alpha in 0..=255u8 {
                for look in 0..=255u8 {
                    let stored = [table.forth[row(alpha) + usize::from(look)]; 6];
                    let [first, last] = looks(alpha, &stored)[component];
                    assert!(first <= look && look <= last);
                }
            }
        }
    }
}
