//! Resolving requests, and the queue.

use std::sync::Arc;
use std::time::Duration;

use brickfell_formats::layout::SampleLayout;
use brickfell_pager::{Pager, PagerConfig, Store as _};
use glam::DVec3;

use super::*;
use crate::testing::{Kind, Store, grey, header};

/// A tree of depth 3, all bricks but for a constant octant, with levels up to `last` in RAM.
fn active(last: u8) -> ActiveTree {
    let mut store = Store::default();
    let kind = |level: u8, p: UVec3| match level > 0 && p.min_element() >> (level - 1) > 0 {
        true => Kind::Leaf([9; 4]),
        false => Kind::Brick,
    };
    let header = header(DVec3::ZERO, 1.0, 3, SampleLayout::Corner, 1);
    store.add("tree", header, kind, |level, _| grey(level, 90));
    assert!(store.0.len("tree").unwrap() > 0);
    let mut pager = Pager::new(Arc::new(store.0), vec!["tree".into()], PagerConfig::default());
    let key = match last {
        0 => PageKey::Root(TreeId(0)),
        level => PageKey::Level {
            tree: TreeId(0),
            level,
        },
    };
    let mut frame = 0;
    while pager.tree(TreeId(0)).and_then(|t| t.level(last)).is_none() {
        frame += 1;
        assert!(frame < 1000, "the tree does not load");
        pager.request(key, 0.0);
        pager.submit();
        pager.wait_for_progress(Duration::from_secs(5));
        pager.merge(frame);
    }
    ActiveTree {
        tree: TreeId(0),
        state: Arc::clone(pager.tree(TreeId(0)).unwrap()),
    }
}

fn request(tree: u32, level: u8, node: [u32; 3]) -> Request {
    Request { tree, level, node }
}

/// The chain of nodes whose bricks are wanted.
fn chain(list: &NodeList) -> Vec<(u8, u32)> {
    list.nodes
        .iter()
        .filter(|n| n.brick)
        .map(|n| (n.level, n.node))
        .collect()
}

#[test]
fn a_request_brings_its_whole_chain() {
    let tree = active(3);
    let list = resolve(7, &[request(0, 3, [1, 2, 3])], std::slice::from_ref(&tree));
    let path: Vec<_> = tree.state.find(3, UVec3::new(1, 2, 3)).path().collect();
    assert_eq!((list.frame, path.len()), (7, 4));
    assert_eq!(chain(&list), path);
    assert!(list.pages.is_empty());
}

#[test]
fn each_node_is_listed_once_and_after_its_parent() {
    let tree = active(3);
    let requests: Vec<_> = (0..600)
        .map(|k| {
            request(
                0,
                1 + (k % 3) as u8,
                [k % 2, k / 2 % 2, k / 4 % 2].map(|c| c * (k % 3)),
            )
        })
        .collect();
    let list = resolve(1, &requests, std::slice::from_ref(&tree));
    let mut seen = std::collections::HashSet::new();
    for node in &list.nodes {
        assert!(seen.insert((node.level, node.node)), "{node:?} twice");
        // Its parent's tile has been listed: every node of a tile becomes resident with the first.
        let parent_listed = seen
            .iter()
            .any(|(level, n)| level + 1 == node.level && n / 8 == node.parent / 8);
        assert!(node.level == 0 || parent_listed, "{node:?} before its parent");
        if let Some(above) = node.level.checked_sub(1) {
            let parent = tree.state.level(above).unwrap().nodes[node.parent as usize];
            assert_eq!(parent.children(), Some(node.node / 8), "{node:?}");
        }
    }
}

#[test]
fn tiles_near_a_request_come_along_without_their_bricks() {
    let tree = active(3);
    let list = resolve(1, &[request(0, 3, [0, 0, 0])], std::slice::from_ref(&tree));
    let tiles: Vec<_> = list
        .nodes
        .iter()
        .filter(|n| !n.brick)
        .map(|n| (n.level, n.node % 8))
        .collect();
    // Below the node at level 1: eight tiles at level 3, of which the request's own is in the chain.
    assert_eq!(tiles.len(), 7);
    assert!(tiles.iter().all(|t| *t == (3, 0)), "{tiles:?}");
}

#[test]
fn a_chain_stops_where_the_data_ends() {
    let list = resolve(1, &[request(0, 3, [7, 7, 7])], &[active(3)]);
    assert_eq!(chain(&list), [(0, 0), (1, 7)]);
    assert!(list.pages.is_empty());
}

#[test]
fn a_level_that_is_not_in_ram_is_asked_for_once() {
    let tree = active(1);
    assert!(tree.state.level(2).is_none());
    let requests = [
        request(0, 3, [0, 1, 2]),
        request(0, 2, [0, 0, 1]),
        request(0, 3, [7, 7, 7]),
    ];
    let list = resolve(1, &requests, &[tree]);
    assert_eq!(
        list.pages,
        [(
            PageKey::Level {
                tree: TreeId(0),
                level: 2
            },
            0
        )]
    );
    // Nodes that cannot be looked up yet are not said to have bricks.
    assert!(list.nodes.iter().all(|n| n.level < 2 || !n.brick));
}

#[test]
fn requests_that_name_nothing_are_passed_over() {
    let tree = active(3);
    let list = resolve(
        1,
        &[
            request(5, 1, [0; 3]),
            request(0, 2, [4, 0, 0]),
            request(0, 31, [0; 3]),
        ],
        &[tree],
    );
    assert!(list.nodes.is_empty() && list.pages.is_empty(), "{list:?}");
}

#[test]
fn the_newest_jobs_are_kept_and_the_newest_list_wins() {
    let shared = Arc::new(Shared::default());
    let mut processors = NodeListProcessors {
        shared: Arc::clone(&shared),
        threads: Vec::new(),
    };
    for frame in 1..=6 {
        processors.submit(frame, Vec::new(), Arc::from([]));
    }
    let waiting: Vec<_> = shared.lock().jobs.iter().map(|j| j.frame).collect();
    assert_eq!(waiting, [3, 4, 5, 6]);
    let worker = Arc::clone(&shared);
    processors.threads.push(std::thread::spawn(move || work(&worker)));
    processors.wait_idle();
    assert_eq!(processors.take().map(|l| l.frame), Some(6));
    assert!(processors.take().is_none());
}

#[test]
fn dropping_them_ends_the_threads() {
    let processors = NodeListProcessors::new(3).unwrap();
    processors.submit(1, Vec::new(), Arc::from([]));
    processors.wait_idle();
    let shared = Arc::downgrade(&processors.shared);
    drop(processors);
    assert!(shared.upgrade().is_none());
}
