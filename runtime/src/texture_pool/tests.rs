//! The pools' directory under random and chosen flights.

mod flight;

use std::sync::Arc;

use brickfell_formats::bricks::brick_file_name;
use brickfell_pager::Fault;
use glam::UVec3;

use super::*;
use flight::{DEPTH, Flight, TREES};

fn sizes(slots: [u32; 3], tiles: u32) -> PoolSizes {
    PoolSizes {
        layers: Default::default(),
        layout: brickfell_formats::layout::SampleLayout::Corner,
        blocks: false,
        slots,
        tiles,
    }
}

#[test]
fn a_flight_at_random_keeps_every_invariant() {
    for seed in 1..=4 {
        let mut flight = Flight::new(seed, sizes([6, 5, 3], 60));
        for _ in 0..250 {
            // Stretches of looking at one thing, so that something grows old.
            let visible = 1 + flight.frame / 10 % TREES;
            let count = [0, 3, 12][(flight.frame / 4 % 3) as usize];
            let wants = flight.random_wants(count, visible);
            let limit = [1, 5, 1000][flight.random.below(3) as usize];
            flight.fly(visible, &wants, limit);
        }
        assert!(
            flight.uploads > 200 && flight.evictions > 100,
            "seed {seed}: {} uploads",
            flight.uploads
        );
    }
}

#[test]
fn a_working_set_of_many_pools_stays_pending_and_harms_nothing() {
    let mut flight = Flight::new(9, sizes([3, 3, 3], 40));
    let all: Vec<_> = (0..512)
        .map(|k| (k % TREES, DEPTH, [k % 8, k / 8 % 8, k / 64]))
        .collect();
    for _ in 0..30 {
        flight.fly(TREES, &all, usize::MAX);
    }
    assert!(flight.pending > 3 * 27, "{} pending", flight.pending);
    assert_eq!(flight.pool.bricks_resident(), 27, "the pool is put to use");
}

#[test]
fn everything_becomes_resident_where_there_is_room() {
    let mut flight = Flight::new(3, sizes([12, 12, 12], 3000));
    let all: Vec<_> = (0..512).map(|k| (0, DEPTH, [k % 8, k / 8 % 8, k / 64])).collect();
    let mut frames = 0;
    loop {
        flight.fly(1, &all, usize::MAX);
        frames += 1;
        // What is sent in a frame is pending in it.
        if flight.trees.len() == 1 && flight.pending == 0 {
            break;
        }
        assert!(frames < 60, "{} pending", flight.pending);
    }
    assert_eq!(flight.evictions, 0);
    let state = Arc::clone(flight.pager.tree(TreeId(0)).unwrap());
    for level in 0..=DEPTH {
        for (index, node) in state.level(level).unwrap().nodes.iter().enumerate() {
            let pool_node = flight.pool.pool_node(TreeId(0), level, index as u32).unwrap();
            let [structure, data] = flight.pool.peek(pool_node);
            match node.data() {
                NodeData::Constant(color) => assert_eq!(data, u32::from_le_bytes(color)),
                NodeData::Brick(_) => {
                    assert!(structure & BRICK != 0 && data != 0, "level {level}, node {index}")
                }
            }
            assert_eq!(structure & TERMINAL != 0, node.children().is_none());
        }
    }
    // And at rest nothing moves.
    let uploads = flight.uploads;
    flight.fly(1, &all, usize::MAX);
    assert_eq!(flight.uploads, uploads);
}

#[test]
fn the_limit_lets_one_brick_pass_at_least() {
    let mut flight = Flight::new(5, sizes([4, 4, 4], 100));
    let wants = [(0, 2, [0, 0, 0]), (0, 2, [3, 3, 3])];
    let mut sent = Vec::new();
    for _ in 0..12 {
        let before = flight.uploads;
        flight.fly(1, &wants, 0);
        sent.push(flight.uploads - before);
    }
    assert!(sent.iter().all(|s| *s <= 1) && flight.pending == 0, "{sent:?}");
}

#[test]
fn an_entry_of_a_read_back_that_no_longer_exists_is_passed_over() {
    let mut pool = TexturePoolManager::new(sizes([2, 2, 2], 9));
    pool.touch(&Feedback {
        frame: 5,
        used_bricks: vec![u32::MAX; 9],
        used_tiles: vec![u32::MAX; 9],
        ..Feedback::default()
    });
    assert!(pool.slots.iter().all(|s| s.last_used == 0) && pool.tiles.iter().all(|t| t.last_used == 0));
}

#[test]
fn use_of_a_brick_keeps_those_above_it_though_its_tile_was_wanted_later() {
    let mut flight = Flight::new(5, sizes([3, 3, 1], 200));
    flight.rays = Some(Vec::new());
    let find = |flight: &Flight, node: [u32; 3]| -> Vec<(u8, u32)> {
        let state = flight.pager.tree(TreeId(0)).unwrap();
        state.find(3, UVec3::from_array(node)).path().collect()
    };
    // Two nodes with a common ancestor two levels up, bricks all the way: wanting one brings the other's tile along.
    let candidates: Vec<_> = (0..512).map(|k| [k % 8, k / 8 % 8, k / 64]).collect();
    while flight.pager.tree(TreeId(0)).is_none_or(|t| t.level(3).is_none()) {
        flight.fly(1, &candidates.iter().map(|c| (0, 3, *c)).collect::<Vec<_>>(), 0);
        assert!(flight.frame < 100);
    }
    let bricks = |flight: &Flight, path: &[(u8, u32)]| {
        let state = flight.pager.tree(TreeId(0)).unwrap();
        path.len() == 4
            && path.iter().all(|(l, n)| {
                matches!(
                    state.level(*l).unwrap().nodes[*n as usize].data(),
                    NodeData::Brick(_)
                )
            })
    };
    let paths: Vec<_> = candidates.iter().map(|c| (*c, find(&flight, *c))).collect();
    let pairs = paths.iter().flat_map(|a| paths.iter().map(move |b| (a, b)));
    let ((used, path), (wanted, _)) = pairs
        .into_iter()
        .find(|(a, b)| bricks(&flight, &a.1) && bricks(&flight, &b.1) && a.1[1] == b.1[1] && a.1[2] != b.1[2])
        .unwrap();
    let both = [(0, 3, *used), (0, 3, *wanted)];
    for _ in 0..10 {
        flight.fly(1, &both, 100);
    }
    assert_eq!(flight.pending, 0);
    let (level, node) = path[3];
    flight.rays = Some(vec![(TreeId(0), level, node)]);
    for frame in 0..20 {
        // The other tree's bricks take every slot that they can get.
        let mut wants = vec![(0, 3, *wanted)];
        wants.extend((0..8).map(|k| (1, 2, [k % 4, (k + frame) % 4, k / 2 % 4])));
        flight.fly(2, &wants, 100);
    }
    assert!(flight.evictions > 0 || flight.pending > 0);
}

#[test]
fn roots_in_view_stay_though_no_ray_uses_them() {
    let mut flight = Flight::new(6, sizes([2, 2, 2], 14));
    flight.rays = Some(Vec::new());
    for frame in 0..60u32 {
        let wants: Vec<_> = (0..6)
            .map(|k| (1, 3, [(k + frame) % 8, k % 8, (frame / 8 + k) % 8]))
            .collect();
        flight.fly(2, &wants, 100);
    }
    // The flight checks each frame that both roots are there.
    assert!(
        flight.roots.len() == 2 && flight.evictions > 20,
        "{} evictions",
        flight.evictions
    );
}

#[test]
fn frames_that_replace_bricks_allocate_nothing_once_they_have_been_flown() {
    let mut flight = Flight::new(6, sizes([4, 2, 2], 60));
    flight.rays = Some(Vec::new());
    let held = |flight: &Flight| {
        let (batch, pool) = (&flight.batch, &flight.pool);
        let kept = [
            batch.nodes.capacity(),
            batch.bricks.capacity(),
            pool.dirty.capacity(),
            pool.bricks.capacity(),
        ];
        (pool.memory(), kept)
    };
    let (mut before, mut evictions) = (None, 0);
    for frame in 0..64 * 4 {
        // The same in every 64 frames, by which time all of it is in RAM.
        let wants: Vec<_> = (0..6)
            .map(|k| (1, 3, [(k + frame) % 8, k % 8, (frame / 8 + k) % 8]))
            .collect();
        flight.fly(2, &wants, 100);
        match frame / 64 {
            0 | 1 => (before, evictions) = (Some(held(&flight)), flight.evictions),
            _ => assert_eq!(Some(held(&flight)), before, "frame {frame}"),
        }
    }
    let (_, kept) = held(&flight);
    assert!(kept.iter().all(|c| *c > 0), "given away: {kept:?}");
    assert!(
        flight.evictions > evictions + 50,
        "{} evictions",
        flight.evictions
    );
}

#[test]
fn a_brick_waits_for_the_one_above_it() {
    let mut flight = Flight::new(7, sizes([8, 8, 8], 1000));
    let all: Vec<_> = (0..512).map(|k| (0, 3, [k % 8, k / 8 % 8, k / 64])).collect();
    while flight.pager.tree(TreeId(0)).is_none_or(|t| t.level(3).is_none()) {
        flight.frame += 1;
        flight.pager.merge(u64::from(flight.frame));
        flight.pager.request(
            PageKey::Level {
                tree: TreeId(0),
                level: 3,
            },
            0.0,
        );
        flight.pager.submit();
        flight.pager.wait_for_progress(std::time::Duration::from_secs(1));
        assert!(flight.frame < 100);
    }
    // The nodes are there, no brick is yet. Those of level 2 do not arrive, those of level 3 do.
    let slow = brick_file_name("tree0", 2);
    flight.store.inject(&slow, Fault::Hang);
    for _ in 0..20 {
        flight.fly(1, &all, 1000);
    }
    let waiting = flight.uploads;
    flight.store.clear_faults(&slow);
    for _ in 0..20 {
        flight.fly(1, &all, 1000);
    }
    assert!(
        flight.uploads > waiting + 100,
        "{waiting}, then {}",
        flight.uploads
    );
    assert_eq!(flight.pending, 0);
}
