//! Trees whose bricks are in blocks: kept as they are, decoded, or not there where they should be.

use brickfell_formats::chunk::Encoding;
use brickfell_formats::octree::Octree;

use crate::page::{Bricks, ChunkPage};
use crate::testing::*;
use crate::{MemoryStore, PageKey, PagerConfig};

const PLENTY: u64 = 1 << 30;

/// Settles all chunks of level 2 of a tree whose bricks are in an encoding.
fn flight(encoding: Encoding, keep_blocks: bool) -> Flight {
    let store = MemoryStore::new();
    let tree: Octree = octree(2);
    for (name, bytes) in coded_objects(&tree, "0.oct", 5, encoding) {
        store.put(&name, bytes);
    }
    let config = PagerConfig {
        keep_blocks,
        ..config(PLENTY, 2)
    };
    let mut flight = Flight::new(pager(&std::sync::Arc::new(store), 1, config));
    flight.settle(&[(level(0, 2), 0.0), (chunk(0, 2, 0), 0.0)]);
    flight
}

fn page(flight: &Flight) -> &ChunkPage {
    let PageKey::Chunk { tree, level, chunk } = chunk(0, 2, 0) else {
        unreachable!()
    };
    flight.pager.chunk(tree, level, chunk).unwrap()
}

#[test]
fn blocks_stay_what_they_are_and_take_a_quarter() {
    let (kept, mut decoded) = (flight(Encoding::Blocks, true), flight(Encoding::Blocks, false));
    let (Bricks::Blocks(blocks), Bricks::Samples(samples)) = (page(&kept).bricks(), page(&decoded).bricks())
    else {
        panic!("the wrong forms")
    };
    let occupancy: Vec<_> = (0..samples.bricks()).map(|k| samples.occupancy(k)).collect();
    assert_eq!(page(&decoded).occupancy(), occupancy);
    assert_eq!(page(&kept).occupancy(), occupancy);
    let words = size_of_val(&*occupancy);
    assert!(page(&decoded).memory() >= (samples.memory() + words) as u64);
    assert!(page(&kept).memory() >= (blocks.memory() + words) as u64);
    assert_eq!(&blocks.samples(), samples);
    assert!(samples.color.iter().all(|c| c[3] == 255));
    assert_eq!(
        (page(&kept).layout(), page(&kept).layers()),
        (samples.layout, samples.layers())
    );
    let root = |flight: &Flight| {
        let state = flight.pager.tree(brickfell_culler::TreeId(0)).unwrap();
        state.root.chunk0.clone().unwrap()
    };
    assert!(root(&kept).samples().is_none() && root(&decoded).samples().is_some());
    assert!(page(&kept).memory() * 10 < page(&decoded).memory() * 4);
    let bytes = |flight: &Flight| flight.pager.stats().resident_bytes;
    assert!(bytes(&kept) < bytes(&decoded));
    assert!(
        kept.pager.stats().peak_bytes <= bytes(&kept) + (64 << 10),
        "no room for samples is asked for"
    );
    assert!(decoded.pager.drain_faults().is_empty());
}

#[test]
fn bricks_that_are_no_blocks_are_a_fault_where_blocks_are_to_be_kept() {
    let mut flight = flight(Encoding::Packed, true);
    let faults = flight.pager.drain_faults();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(
        faults[0].message,
        "memory:0.L00.brk: byte 16: its bricks are not block-compressed, which the scene says they are"
    );
}
