// What every kernel of a frame is told. The Rust side is `layout.rs`; a test compares the two.

struct Frame {
    // Pixels of the picture.
    size: vec2<u32>,
    // Trees in the list, front to back.
    tree_count: u32,
    // Number of the frame, never 0: the stamp that used slots get.
    frame: u32,
    // Tan-space screen coordinates of pixel (0, 0)'s centre, and the step to the next pixel.
    screen_origin: vec2<f32>,
    screen_step: vec2<f32>,
    // Camera axes, world; w unused.
    forward: vec4<f32>,
    right: vec4<f32>,
    up: vec4<f32>,
    // Unit vector towards the sun; w: ambient light.
    sun: vec4<f32>,
    // Light of a surface that faces the sun.
    diffuse: f32,
    // Footprint of a pixel per metre of depth, times 2^bias.
    footprint: f32,
    // Part of a level over which it fades into the next, 0..1; 0: the nearest level alone.
    fade: f32,
    // 1: bricks are blocks, which hold colours, normals and opacities against the axes apart from alpha.
    blocks: u32,
    // Brick slots per axis of the brick pool; w unused.
    slots: vec4<u32>,
    // 1 / texels of the brick pool per axis; w unused.
    texel: vec4<f32>,
    // Brick slots and node tiles in the pools, for the compaction.
    brick_slots: u32,
    node_tiles: u32,
    // Requests that fit the list.
    request_capacity: u32,
    // One of so many tiles of pixels may ask in a frame, in turn: above 1 where the last frame asked for more than fits.
    request_share: u32,
    // log2 of the voxels that a sampled segment spans along an axis, at most 3, and the samples in it.
    segment_shift: u32,
    segment_samples: u32,
    // 1: tiles of pixels have lists of the trees that their rays may meet.
    lists: u32,
    // Share of the sky in the cone along the normal.
    sky_middle: f32,
    // Texels of a brick slot per axis; w unused.
    slot: vec4<u32>,
    // In blocks a normal is normal_scale times what the pool has, plus normal_zero; w unused.
    normal_scale: vec4<f32>,
    normal_zero: vec4<f32>,
    // Cones: width per metre toward the sun and the sky, how many widths above the surface they begin, and the cosine between the normal
    // and those of the sky's that are not along it.
    cones: vec4<f32>,
    // Where in the whole picture the first pixel is, and the step to the next one, in its pixels.
    pixels: vec4<f32>,
    // Depths at which rays end: a value is x + y / depth, or with a y of 0 the depth; z: where there is none. w unused.
    depth_in: vec4<f32>,
}

struct Tree {
    // Position of the ray with screen coordinates (sx, sy) at depth `depth0`, in finest voxels of the tree:
    // cell + base + sx * base_x + sy * base_y. What is near the eye so has small numbers, however large the tree is.
    base: vec3<f32>,
    // Depth along the camera's forward axis where the tree begins, metres.
    depth0: f32,
    base_x: vec3<f32>,
    // 1 / finest voxel, per metre.
    inv_voxel: f32,
    base_y: vec3<f32>,
    // log2 of the root brick's voxel, metres.
    log2_root_voxel: f32,
    // Index of the root node in the node pool.
    root: u32,
    // Deepest level.
    depth: u32,
    // Opacity gain.
    gain: f32,
    // Texel offset of the tree's sample layout.
    texel_offset: f32,
    // The finest cell at the base.
    cell: vec3<i32>,
    // Rim of constant nodes in voxels of a node's own level.
    rim: u32,
    // Low corner of what is drawn of the tree, in finest voxels.
    low: vec3<i32>,
    // Steps after which a ray is stopped in this tree.
    max_steps: u32,
    // High corner, exclusive.
    high: vec3<i32>,
    // Least fractional level; above 0 where a coarse tree has just taken over.
    least_level: f32,
}

// Node words: x: bit 31 terminal, bit 30 brick, bit 29 the brick has opacities against the axes, else the child tile (0: none resident); y: colour, or brick slot + 1 (0: not
// resident).
const TERMINAL: u32 = 0x80000000u;
const BRICK: u32 = 0x40000000u;
const AXES: u32 = 0x20000000u;
const POINTER: u32 = 0x1fffffffu;

// A request: x: 1 + index of the tree in the list (16 bits) | level << 16; y, z: node coordinates, 20 bits each:
// y = x | low 12 bits of y << 20, z = high 8 bits of y | z << 8.

// What a pixel reports: x: node reads (14 bits) | sample positions << 14 (14 bits) | flags; y: texture reads.
const FLAG_HIT: u32 = 1u << 28u;
const FLAG_CAPPED: u32 = 1u << 29u;
const FLAG_NOT_FINITE: u32 = 1u << 30u;

// Words at the head of the read-back, and of the table behind them by which rays see what was asked for already.
const COUNTER_WORDS: u32 = 16u;
const TABLE_WORDS: u32 = 16384u;

// Words of a tile's list: how many trees there are, which may be more than fit; the depth at which its rays begin, as f32; then the
// trees that fit, front to back.
const LIST_WORDS: u32 = 128u;
const LIST_TREES: u32 = LIST_WORDS - 2u;

// Levels that a tree may have, and a depth beyond all others.
const MAX_LEVELS: u32 = 21u;
const FAR: f32 = 1e30;

// Words that tell where a brick shows anything: two with a bit for each cell of 2³ voxels (x + 4y + 16z), then one for each place
// between 2³ neighbouring samples (x + 9y + 81z).
const OCCUPANCY_WORDS: u32 = 25u;
