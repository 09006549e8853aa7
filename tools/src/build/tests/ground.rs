//! Ground over rectangles of columns.

use std::time::Instant;

use super::super::ground::GroundGrid;
use super::super::lattice::CellBox;
use super::*;

/// Time of a column of a tree with margins, on one thread. Not a test of anything: run it with `--ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn time_of_a_column() {
    let n = 1200;
    let heights = |x: f64, y: f64| (x * 0.05).sin() * 8.0 + (y * 0.03).cos() * 9.0;
    let ground = painted(layer(n, 1.0, DVec2::ZERO, heights), |c, r| {
        [c as u8, r as u8, (c ^ r) as u8]
    });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for (name, voxel) in [("one pixel", 1.0), ("0.37 pixels", 0.37), ("4 pixels", 4.0)] {
        let lattice = Lattice {
            voxel,
            depth: 5,
            layout: DEFAULT_LAYOUT,
        };
        let area = CellBox {
            lo: [3, 3, 0],
            hi: [275, 275, 1],
        };
        let best = (0..20).map(|_| {
            let start = Instant::now();
            let grid = pool.install(|| GroundGrid::new(&ground, &lattice, &area));
            assert!(grid.unwrap().is_some());
            start.elapsed().as_nanos() as f64 / (272.0 * 272.0)
        });
        println!(
            "voxel of {name}: {:.0} ns a column",
            best.fold(f64::INFINITY, f64::min)
        );
    }
}
