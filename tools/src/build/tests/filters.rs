//! What each filter promises about the opacity of open surfaces.

use super::super::blocks::{BlockColumn, Blocks, Slot};
use super::super::cells::{Cell, Draft, in_block};
use super::super::filter::{Level, Target};
use super::super::lattice::{CellBox, SIDE};
use super::super::sample::{Look, Sample};
use super::*;

/// Levels above the finest that are looked at.
const MIPS: u8 = 5;
/// Finest cells per axis that are filled, from 0; a margin of as many lies around them.
const N: i64 = 128;

/// A finest level of opaque skin where `filled`.
fn finest(filled: impl Fn([i64; 3]) -> f32) -> Level {
    let blocks = CellBox {
        lo: [-N / SIDE; 3],
        hi: [2 * N / SIDE; 3],
    };
    let columns = super::super::blocks::block_columns(&blocks)
        .into_iter()
        .map(|(x, y)| {
            let slots = (0..N / SIDE).filter_map(|z| {
                let mut draft = Draft::default();
                for k in 0..512 {
                    let cell = [SIDE * x + k % 8, SIDE * y + k / 8 % 8, SIDE * z + k / 64];
                    let skin = if cell.iter().all(|c| (0..N).contains(c)) {
                        filled(cell)
                    } else {
                        0.0
                    };
                    if skin > 0.0 {
                        let look = Look {
                            skin,
                            weight: skin.min(1.0),
                            ..Look::default()
                        };
                        draft.put(in_block(cell[0], cell[1], cell[2]), Sample::new(&look));
                    }
                }
                draft.take().map(|cells| (z, Slot::Mixed(cells)))
            });
            BlockColumn {
                solid: 0..0,
                slots: slots.collect(),
            }
        });
    Level::finest(Blocks::new(&blocks, columns.collect()), None)
}

/// Levels 0 to `MIPS`.
fn pyramid(filter: Filter, layout: SampleLayout, filled: impl Fn([i64; 3]) -> f32) -> Vec<Level> {
    let mut levels = vec![finest(filled)];
    for mip in 1..=MIPS {
        let cells = CellBox {
            lo: [-(N >> mip); 3],
            hi: [(2 * N) >> mip; 3],
        };
        let coarser = levels[levels.len() - 1].coarser(filter, &Target { layout, mip, cells });
        levels.push(coarser);
    }
    levels
}

/// The skin of a cell: for filters that go by coverage the largest, or against the axis if there is one.
fn skin(level: &Level, filter: Filter, axis: usize, [x, y, z]: [i64; 3]) -> f64 {
    if let Some(skins) = level.skins(filter, true) {
        return f64::from(skins.at([x, y, z])[axis]);
    }
    match level.samples.at([x, y, z]) {
        Cell::Held(sample) => f64::from(sample.skin()),
        _ => 0.0,
    }
}

/// What a ray along z lets through of a stack of skins, read at steps of a voxel between them; the mean over phases.
pub(super) fn through(skins: &[f64]) -> f64 {
    let phases = 64;
    let at = |k: i64| {
        usize::try_from(k)
            .ok()
            .and_then(|k| skins.get(k))
            .copied()
            .unwrap_or(0.0)
    };
    let total: f64 = (0..phases)
        .map(|p| {
            let t = (f64::from(p) + 0.5) / f64::from(phases);
            (-1..skins.len() as i64)
                .map(|k| 1.0 - (at(k) * (1.0 - t) + at(k + 1) * t).min(1.0))
                .product::<f64>()
        })
        .sum();
    total / f64::from(phases)
}

/// Mean part of light that a level stops over the finest cells 0..N of a cross-section, rays along an axis.
fn stopped(level: &Level, filter: Filter, mip: u8, axis: usize) -> f64 {
    let n = N >> mip;
    let total: f64 = (0..n * n)
        .map(|k| {
            let stack = (0..n).map(|depth| {
                let mut cell = [depth; 3];
                (cell[(axis + 1) % 3], cell[(axis + 2) % 3]) = (k % n, k / n);
                skin(level, filter, axis, cell)
            });
            1.0 - through(&stack.collect::<Vec<_>>())
        })
        .sum();
    total / (n * n) as f64
}

const OPAQUE: f32 = 2.0;

/// What the levels from a mip on stop along an axis.
fn stopped_from(
    first: u8,
    filter: Filter,
    axis: usize,
    filled: impl Fn([i64; 3]) -> bool,
) -> impl Iterator<Item = (u8, f64)> {
    let levels = pyramid(
        filter,
        SampleLayout::Centre,
        |c| if filled(c) { OPAQUE } else { 0.0 },
    );
    (first..=MIPS).map(move |mip| (mip, stopped(&levels[usize::from(mip)], filter, mip, axis)))
}

#[test]
fn a_flat_skin_is_opaque_at_every_level_and_phase() {
    for filter in [Filter::Double, Filter::Coverage, Filter::Axes] {
        for at in [0, 7, 21] {
            for axis in 0..3 {
                for (mip, got) in stopped_from(0, filter, axis, |c| c[axis] == at) {
                    assert!(got > 0.9999, "{filter:?} mip {mip}: {got}");
                }
            }
        }
    }
}

#[test]
fn specks_stop_what_their_cross_section_covers() {
    // One cell of 8×8×8.
    let speck = |c: [i64; 3]| c[0] % 8 == 3 && c[1] % 8 == 5 && c[2] == 3;
    for (mip, got) in stopped_from(3, Filter::Axes, 2, speck) {
        assert!((0.85..1.15).contains(&(got * 64.0)), "mip {mip}: {got}");
    }
    for (mip, got) in stopped_from(3, Filter::Coverage, 2, speck) {
        // The largest of three dithered axes is more than their mean.
        let most = if mip == 3 { 1.02 } else { 1.6 };
        assert!((0.95..most).contains(&(got * 64.0)), "mip {mip}: {got}");
    }
    // Means fade by eight a level instead of four.
    let (_, mean) = stopped_from(3, Filter::Mean, 2, speck).next().unwrap();
    assert!(mean * 64.0 < 0.5);
}

#[test]
fn a_wall_seen_edge_on_is_as_thin_as_it_is() {
    // A cell thick, eight deep along y, which is a voxel of level 3 and a part of those above.
    let wall = |c: [i64; 3]| c[0] == 21 && c[1] < 8;
    for (mip, got) in stopped_from(3, Filter::Axes, 1, wall) {
        // Above level 3 masks are dithered.
        assert!((0.85..1.15).contains(&(got * N as f64)), "mip {mip}: {got}");
    }
    for (mip, got) in stopped_from(3, Filter::Axes, 0, wall) {
        assert!((0.9..1.9).contains(&(got * 16.0)), "face-on, mip {mip}: {got}");
    }
    for filter in [Filter::Double, Filter::Coverage] {
        let (_, got) = stopped_from(5, filter, 1, wall).next().unwrap();
        assert!(got * N as f64 > 5.0, "{filter:?}: {got}");
    }
}

#[test]
fn scattered_leaves_let_through_what_they_leave_open() {
    // Leaves of one finest cell in a layer eight deep, each at a random height: what is open is the same at all levels.
    for part in [32, 96, 160] {
        let leaf = |c: [i64; 3]| {
            noise(c[0] as u32, c[1] as u32) < part && c[2] == i64::from(noise(c[1] as u32, c[0] as u32) % 8)
        };
        let truth = f64::from(part) / 256.0;
        // From the side, leaves of neighbouring voxels make up for each other, dense ones as a surface does, and the largest of
        // the axes is taken.
        for (filter, bound) in [(Filter::Coverage, 0.4), (Filter::Axes, 0.08)] {
            for (mip, got) in stopped_from(3, filter, 2, leaf) {
                assert!(
                    (got - truth).abs() < bound,
                    "{filter:?} {part}/256 at mip {mip}: {got}"
                );
            }
        }
    }
}

#[test]
fn mean_and_pow_are_what_they_are_called() {
    let stored = |filter, filled: fn([i64; 3]) -> f32| -> Vec<f64> {
        let levels = pyramid(filter, SampleLayout::Centre, filled);
        levels.iter().map(|l| skin(l, filter, 0, [0; 3]) / 2.0).collect()
    };
    let plane = |c: [i64; 3]| if c[2] == 0 { OPAQUE } else { 0.0 };
    let mean = stored(Filter::Mean, plane);
    let pow = stored(Filter::Pow, plane);
    for mip in 0..mean.len() {
        assert!((mean[mip] - 0.5f64.powi(mip as i32)).abs() < 1e-3, "{mean:?}");
        let below = match mip {
            0 => 1.0,
            1 => 0.5,
            _ => pow[mip - 2] / 4.0,
        };
        assert!((pow[mip] - f64::powf(below, 1.0 - below)).abs() < 1e-3, "{pow:?}");
    }
}
