//! Pages through a store of one's own: ground that is made when it is read. Asks for what a camera that walks over it would need, reads
//! samples of what has come, and shows how the budget is kept.
//!
//! `cargo run -p brickfell-pager --example own_store`

use std::collections::HashMap;
use std::error::Error;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use brickfell_culler::TreeId;
use brickfell_formats::bricks::{BrickFileWriter, HEADER_BYTES, brick_file_name};
use brickfell_formats::chunk::{Chunk, Encoding, brick_positions};
use brickfell_formats::layout::SampleLayout::{self, Corner};
use brickfell_formats::octree::{Node, NodeData, Octree, TreeHeader, child_positions};
use brickfell_formats::{FormatError, morton, octree_binary};
use brickfell_pager::{PageKey, Pager, PagerConfig, Store};
use glam::{DVec3, UVec3};

const LAYOUT: SampleLayout = Corner;
/// Levels below the root: 8 · 2⁴ voxels of a metre per axis.
const DEPTH: u8 = 4;
/// Bricks of a chunk per axis, log2.
const CHUNK_LOG2: u8 = 1;

/// One tree, `hill.oct`, each of whose files is made when it is first asked for. Loader threads call a store, several at once.
#[derive(Default)]
struct Hills {
    files: Mutex<HashMap<String, Arc<Vec<u8>>>>,
}

/// Height of the ground, metres.
fn height(x: f64, y: f64) -> f64 {
    40.0 + 14.0 * (x * 0.05).sin() + 9.0 * (y * 0.07).cos()
}

/// Side of a voxel of a level, metres.
fn voxel(level: u8) -> f64 {
    f64::from(1u32 << (DEPTH - level))
}

/// Whether the ground passes through a node of a level, so that it needs a brick.
fn on_surface(level: u8, node: UVec3) -> bool {
    let side = 8.0 * voxel(level);
    let low = node.as_dvec3() * side;
    let mut heights = (0..9).flat_map(|i| (0..9).map(move |j| (i, j))).map(|(i, j)| {
        let [u, v] = [i, j].map(|k| f64::from(k) / 8.0 * side);
        height(low.x + u, low.y + v) - low.z
    });
    // With what interpolation and the slope between the places looked at add.
    heights.any(|h| -2.0 * voxel(level) < h && h < side + 2.0 * voxel(level))
}

fn octree() -> Octree {
    let mut positions = vec![UVec3::ZERO];
    let mut levels = Vec::new();
    for level in 0..=DEPTH {
        let (mut tiles, mut bricks) = (0, 0);
        let nodes: Vec<Node> = (positions.iter())
            .map(|p| {
                if !on_surface(level, *p) {
                    // Nothing above the ground, and what is below it no ray can see.
                    return Node::constant([0; 4]);
                }
                let children = (level < DEPTH).then_some(tiles);
                tiles += 1;
                bricks += 1;
                Node::new(children, NodeData::Brick(bricks - 1))
            })
            .collect();
        positions = child_positions(&nodes, &positions);
        levels.push(nodes);
    }
    let header = TreeHeader {
        origin: DVec3::ZERO,
        voxel_size: voxel(DEPTH),
        depth: DEPTH,
        layout: LAYOUT,
        gain: 1,
        surface_voxels: 0,
        surface_bounds: [UVec3::ZERO; 2],
    };
    Octree { header, levels }
}

/// The samples of a brick: green ground below the height, nothing above.
fn push_samples(chunk: &mut Chunk, level: u8, brick: UVec3) {
    let side = LAYOUT.side();
    for k in 0..side.pow(3) {
        let sample = brick * 8 + UVec3::new(k % side, k / side % side, k / side / side);
        let p = sample.as_dvec3() * voxel(level);
        let below = (height(p.x, p.y) - p.z) / voxel(level);
        let alpha = ((below + 0.5).clamp(0.0, 1.0) * 255.0) as u8;
        // Colours are premultiplied, normals too; this one is flat ground's.
        chunk.color.push([alpha / 4, alpha / 2, alpha / 8, alpha]);
        chunk.normal.push([0, 0, (alpha / 2) as i8, 0]);
    }
}

/// The brick file of a level: chunks in Morton order, then their directory.
fn brick_file(level: u8) -> Result<Vec<u8>, FormatError> {
    let tree = octree();
    let has_brick = |node: &Node| matches!(node.data(), NodeData::Brick(_));
    let nodes = &tree.levels[usize::from(level)];
    let bricks: Vec<UVec3> = (tree.positions(level).into_iter().zip(nodes))
        .filter(|(_, node)| has_brick(node))
        .map(|(p, _)| p)
        .collect();
    let mut writer = BrickFileWriter::new(level, LAYOUT, CHUNK_LOG2, Encoding::Packed);
    let mut file = vec![0; HEADER_BYTES];
    for bricks in bricks.chunk_by(|a, b| *a >> u32::from(CHUNK_LOG2) == *b >> u32::from(CHUNK_LOG2)) {
        let corner = (bricks[0] >> u32::from(CHUNK_LOG2)) << u32::from(CHUNK_LOG2);
        let mut chunk = Chunk {
            mask: bricks.iter().map(|p| 1 << morton::encode(*p - corner)).sum(),
            layout: LAYOUT,
            color: Vec::new(),
            normal: Vec::new(),
            opacity: Vec::new(),
        };
        for p in brick_positions(chunk.mask) {
            push_samples(&mut chunk, level, corner + p);
        }
        let payload = chunk.encode(Encoding::Packed)?;
        writer.push(corner >> u32::from(CHUNK_LOG2), chunk.mask, &payload)?;
        file.extend_from_slice(&payload);
    }
    let (directory, header) = writer.finish();
    file.extend_from_slice(&directory);
    file[..HEADER_BYTES].copy_from_slice(&header);
    Ok(file)
}

impl Hills {
    fn file(&self, name: &str) -> io::Result<Arc<Vec<u8>>> {
        let mut files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = files.get(name) {
            return Ok(Arc::clone(file));
        }
        let level = (0..=DEPTH).find(|level| brick_file_name("hill.oct", *level) == name);
        let made = match level {
            Some(level) => brick_file(level),
            None if name == "hill.oct" => octree_binary::encode(&octree()),
            None => return Err(io::Error::new(io::ErrorKind::NotFound, "there is only hill.oct")),
        };
        let file = Arc::new(made.map_err(io::Error::other)?);
        files.insert(name.to_owned(), Arc::clone(&file));
        Ok(file)
    }
}

impl Store for Hills {
    fn len(&self, name: &str) -> io::Result<u64> {
        Ok(self.file(name)?.len() as u64)
    }

    fn read(&self, name: &str, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let file = self.file(name)?;
        let range = offset as usize..(offset as usize).saturating_add(len);
        let bytes = file.get(range).ok_or(io::ErrorKind::UnexpectedEof)?;
        Ok(bytes.to_vec())
    }

    fn describe(&self, name: &str) -> String {
        format!("made hills: {name}")
    }
}

/// The finest brick at a place that is there: its level, and how many of its samples are opaque.
fn look(pager: &Pager, tree: TreeId, place: DVec3) -> Option<(u8, usize)> {
    let state = pager.tree(tree)?;
    let node = (place / (8.0 * voxel(DEPTH))).as_uvec3();
    // The way to the node as far as levels are there; on it the finest brick that is there, too.
    let found = state.find(DEPTH, node);
    let mut path = found.path().rev();
    path.find_map(|(level, index)| {
        let page = state.level(level)?;
        let NodeData::Brick(brick) = page.nodes.get(index as usize)?.data() else {
            return None;
        };
        let (chunk, in_chunk) = page.bricks.as_ref()?.locate(brick)?;
        let chunk = pager.chunk(tree, level, chunk)?;
        let colors = chunk.samples()?.brick_color(in_chunk as usize);
        Some((level, colors.iter().filter(|c| c[3] == 255).count()))
    })
}

/// Asks for all of what lies on the way to a place.
fn ask(pager: &mut Pager, tree: TreeId, place: DVec3) {
    let node = (place / (8.0 * voxel(DEPTH))).as_uvec3();
    pager.request(PageKey::Level { tree, level: DEPTH }, 0.0);
    let Some(state) = pager.tree(tree).cloned() else {
        return;
    };
    for (level, index) in state.find(DEPTH, node).path() {
        let page = state.level(level);
        let node = page.and_then(|page| Some((page.nodes.get(index as usize)?, page.bricks.as_ref()?)));
        if let Some((NodeData::Brick(brick), bricks)) = node.map(|(node, bricks)| (node.data(), bricks))
            && let Some((chunk, _)) = bricks.locate(brick)
        {
            // Coarse before fine; what is there is touched, and stays.
            pager.request(PageKey::Chunk { tree, level, chunk }, f64::from(level));
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let config = PagerConfig {
        budget_bytes: 384 << 10,
        ..PagerConfig::default()
    };
    let mut pager = Pager::new(Arc::new(Hills::default()), vec!["hill.oct".into()], config);
    let tree = TreeId(0);
    let mut frame = 0;
    for step in 0..8 {
        let (x, y) = (8.0 + 16.0 * f64::from(step), 60.0);
        let place = DVec3::new(x, y, height(x, y));
        // A render loop draws what is there in each of these frames. This one has nothing to draw, and waits.
        loop {
            frame += 1;
            pager.merge(frame);
            ask(&mut pager, tree, place);
            pager.submit();
            let faults = pager.drain_faults();
            if let Some(fault) = faults.first() {
                return Err(fault.message.clone().into());
            }
            let there = look(&pager, tree, place);
            if pager.is_idle() && there.is_some_and(|(level, _)| level == DEPTH) {
                break;
            }
            pager.wait_for_progress(Duration::from_millis(100));
        }
        let stats = pager.stats();
        let (level, opaque) = look(&pager, tree, place).unwrap_or_default();
        println!(
            "at x = {x:3}, frame {frame:2}: level {level}, {opaque} of {} samples opaque; {} kB of {} in RAM, {} loads, {} evicted",
            LAYOUT.samples(),
            stats.used_bytes >> 10,
            config.budget_bytes >> 10,
            stats.loads,
            stats.evicted
        );
        assert!(stats.peak_bytes <= config.budget_bytes, "the budget is kept");
    }
    assert!(pager.stats().evicted > 0, "what was passed by has left");
    assert!(pager.over_budget() <= 1.0, "all that is wanted fits");
    Ok(())
}

#[test]
fn runs() -> Result<(), Box<dyn Error>> {
    main()
}
