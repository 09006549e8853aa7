//! The Rust types that share their layout with the WGSL. Sizes are asserted here, offsets are compared with the parsed
//! shaders by a test.

use bytemuck::{Pod, Zeroable};

/// What every kernel of a frame is told; `Frame` in `frame.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Frame {
    /// Pixels of the picture.
    pub size: [u32; 2],
    /// Trees in the list, front to back.
    pub tree_count: u32,
    /// Number of the frame, never 0: the stamp that used slots get.
    pub frame: u32,
    /// Tan-space screen coordinates of pixel (0, 0)'s centre.
    pub screen_origin: [f32; 2],
    /// Step of the screen coordinates to the next pixel.
    pub screen_step: [f32; 2],
    /// Camera axis, world; w unused.
    pub forward: [f32; 4],
    /// Camera axis, world; w unused.
    pub right: [f32; 4],
    /// Camera axis, world; w unused.
    pub up: [f32; 4],
    /// Unit vector towards the sun; w: ambient light.
    pub sun: [f32; 4],
    /// Light of a surface that faces the sun.
    pub diffuse: f32,
    /// Footprint of a pixel per metre of depth, times 2^bias.
    pub footprint: f32,
    /// 1: mix the two levels around the wanted one.
    pub fade: f32,
    /// 1: bricks are blocks, which hold colours, normals and opacities against the axes apart from alpha.
    pub blocks: u32,
    /// Brick slots per axis of the brick pool; w unused.
    pub slots: [u32; 4],
    /// 1 / texels of the brick pool per axis; w unused.
    pub texel: [f32; 4],
    /// Brick slots in the pool.
    pub brick_slots: u32,
    /// Node tiles in the pool.
    pub node_tiles: u32,
    /// Requests that fit the list.
    pub request_capacity: u32,
    /// One of so many tiles of pixels may ask in a frame.
    pub request_share: u32,
    /// log2 of the voxels that a sampled segment spans along an axis.
    pub segment_shift: u32,
    /// Samples in such a segment.
    pub segment_samples: u32,
    /// 1: tiles of pixels have lists of the trees that their rays may meet.
    pub lists: u32,
    /// Share of the sky in the cone along the normal.
    pub sky_middle: f32,
    /// Texels of a brick slot per axis; w unused.
    pub slot: [u32; 4],
    /// In blocks a normal is this times what the pool has, plus `normal_zero`; w unused.
    pub normal_scale: [f32; 4],
    /// See `normal_scale`; w unused.
    pub normal_zero: [f32; 4],
    /// Cones: width per metre toward the sun and the sky, how many widths above the surface they begin, and the cosine between the
    /// normal and those of the sky's that are not along it.
    pub cones: [f32; 4],
    /// Where in the whole picture the first pixel is, and the step to the next one, in its pixels.
    pub pixels: [f32; 4],
    /// Depths at which rays end: a value is x + y / depth, or with a y of 0 the depth; z: where there is none. w unused.
    pub depth_in: [f32; 4],
}

/// A tree in the list; `Tree` in `frame.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Tree {
    /// Position of the central ray at `depth0`, in finest voxels of the tree from the corner of `cell`.
    pub base: [f32; 3],
    /// Depth along the camera's forward axis where the tree begins, metres.
    pub depth0: f32,
    /// Change of the position at `depth0` per unit of the horizontal screen coordinate.
    pub base_x: [f32; 3],
    /// 1 / finest voxel, per metre.
    pub inv_voxel: f32,
    /// Change of the position at `depth0` per unit of the vertical screen coordinate.
    pub base_y: [f32; 3],
    /// log2 of the root brick's voxel, metres.
    pub log2_root_voxel: f32,
    /// Index of the root node in the node pool.
    pub root: u32,
    /// Deepest level.
    pub depth: u32,
    /// Opacity gain.
    pub gain: f32,
    /// Texel offset of the tree's sample layout.
    pub texel_offset: f32,
    /// The finest cell of the central ray at `depth0`; it may lie outside the tree.
    pub cell: [i32; 3],
    /// Rim of constant nodes, in voxels of the node's own level.
    pub rim: u32,
    /// Low corner of what is drawn of the tree, in finest voxels.
    pub low: [i32; 3],
    /// Steps after which a ray is stopped in this tree.
    pub max_steps: u32,
    /// High corner, exclusive.
    pub high: [i32; 3],
    /// Least fractional level; above 0 where a coarse tree has just taken over.
    pub least_level: f32,
}

/// What is told where a picture goes to a window; `Present` in `present.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Present {
    /// Camera axis, world; w unused.
    pub forward: [f32; 4],
    /// Camera axis, world; w unused.
    pub right: [f32; 4],
    /// Camera axis, world; w unused.
    pub up: [f32; 4],
    /// Linear light of the sky at the horizon; w unused.
    pub horizon: [f32; 4],
    /// Linear light of the sky at the zenith; w unused.
    pub zenith: [f32; 4],
    /// Pixels of the picture that were drawn.
    pub drawn: [u32; 2],
    /// Pixels of the target.
    pub size: [u32; 2],
    /// Half of the picture's extent in screen coordinates.
    pub half: [f32; 2],
    /// 1: the target keeps what is written, which so has to be sRGB.
    pub encode: u32,
    /// Unused.
    pub pad: u32,
}

/// What the upload kernels are told; `Scatter` in `scatter.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Scatter {
    /// Node words in the upload.
    pub nodes: u32,
    /// Bricks in the upload.
    pub bricks: u32,
    /// Samples of a brick per axis.
    pub brick_side: u32,
    /// Words of a sample in the upload: 2, or 3 where bricks have opacities against the axes.
    pub words: u32,
    /// Brick slots per axis; w unused.
    pub slots: [u32; 4],
}

const _: () = assert!(size_of::<Frame>() == 272 && size_of::<Tree>() == 112 && size_of::<Scatter>() == 32);

/// Bit of a node's first word: there is no data below.
pub const TERMINAL: u32 = 1 << 31;
/// Bit of a node's first word: the node has a brick.
pub const BRICK: u32 = 1 << 30;
/// Bit of a node's first word: its brick has opacities against the axes.
pub const AXES: u32 = 1 << 29;
/// Bits of a node's first word: the tile of its children in the pool.
pub const POINTER: u32 = AXES - 1;

/// Words of the list of trees of a tile of 8×8 pixels: their number, where its rays begin, then the trees that fit.
pub const LIST_WORDS: usize = 128;

/// Words that tell where a brick shows anything: two of cells, the others of gaps between samples.
pub const OCCUPANCY_WORDS: usize = 25;

/// Words of the counters at the head of the read-back.
pub const COUNTER_WORDS: usize = 16;
/// Words of the table behind the counters, by which rays see what was asked for already.
pub const TABLE_WORDS: usize = 16_384;
/// Counter: requests without repetitions, those that did not fit the list counted too.
pub const COUNTER_REQUESTS: usize = 0;
/// Counter: rays that hit.
pub const COUNTER_HITS: usize = 1;
/// Counter: node reads of the rays that hit.
pub const COUNTER_NODES: usize = 2;
/// Counter: sample positions of the rays that hit.
pub const COUNTER_SAMPLES: usize = 3;
/// Counter: texture reads of the rays that hit.
pub const COUNTER_READS: usize = 4;
/// Counter: rays stopped by the step cap.
pub const COUNTER_CAPPED: usize = 5;
/// Counter: pixels that came out NaN or infinite.
pub const COUNTER_NOT_FINITE: usize = 6;

/// A request as the rays write it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Request {
    /// Index of the tree in the frame's list.
    pub tree: u32,
    /// Wanted level.
    pub level: u8,
    /// Node at that level.
    pub node: [u32; 3],
}

impl Request {
    /// Unpacks the first three words of a request; `None` if there is none in them.
    pub fn unpack(words: [u32; 3]) -> Option<Self> {
        let [a, b, c] = words;
        let tree = (a & 0xffff).checked_sub(1)?;
        Some(Self {
            tree,
            level: (a >> 16 & 31) as u8,
            node: [b & 0xf_ffff, b >> 20 | (c & 0xff) << 12, c >> 8 & 0xf_ffff],
        })
    }
}
