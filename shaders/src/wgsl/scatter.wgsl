// Uploads: all node words and bricks of a frame arrive in one buffer each and are put in their places.

struct Scatter {
    // Node words, bricks in the buffers.
    nodes: u32,
    bricks: u32,
    // Samples of a brick per axis.
    brick_side: u32,
    // Words of a sample: 2, or 3 where bricks have opacities against the axes.
    words: u32,
    // Brick slots per axis; w unused.
    slots: vec4<u32>,
}

@group(0) @binding(0) var<uniform> scatter: Scatter;
// Index, then the two words.
@group(0) @binding(1) var<storage, read> node_updates: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> nodes: array<vec2<u32>>;
// Slot of each brick, then for each brick its colours, then its normals, then its opacities if there are any.
@group(0) @binding(3) var<storage, read> brick_slots: array<u32>;
@group(0) @binding(4) var<storage, read> brick_data: array<u32>;
@group(0) @binding(5) var color_pool: texture_storage_3d<rgba8unorm, write>;
@group(0) @binding(6) var normal_pool: texture_storage_3d<rgba8snorm, write>;
@group(0) @binding(7) var opacity_pool: texture_storage_3d<rgba8unorm, write>;

// For each brick its slot, then its words.
@group(0) @binding(8) var<storage, read> occupancy_updates: array<u32>;
@group(0) @binding(9) var<storage, read_write> occupancy: array<u32>;

// As in frame.wgsl.
const OCCUPANCY_WORDS: u32 = 25u;

@compute @workgroup_size(64)
fn scatter_nodes(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < scatter.nodes) {
        let update = node_updates[id.x];
        nodes[update.x] = update.yz;
    }
}

// x: word, y: brick.
@compute @workgroup_size(32)
fn scatter_occupancy(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < OCCUPANCY_WORDS && id.y < scatter.bricks) {
        let at = id.y * (OCCUPANCY_WORDS + 1u);
        occupancy[occupancy_updates[at] * OCCUPANCY_WORDS + id.x] = occupancy_updates[at + 1u + id.x];
    }
}

// x: sample, y: brick.
@compute @workgroup_size(64)
fn scatter_bricks(@builtin(global_invocation_id) id: vec3<u32>) {
    let side = scatter.brick_side;
    let count = side * side * side;
    if (id.x >= count || id.y >= scatter.bricks) {
        return;
    }
    let slot = brick_slots[id.y];
    let cell = vec3(slot % scatter.slots.x, slot / scatter.slots.x % scatter.slots.y, slot / (scatter.slots.x * scatter.slots.y));
    let p = cell * side + vec3(id.x % side, id.x / side % side, id.x / (side * side));
    let at = id.y * scatter.words * count + id.x;
    textureStore(color_pool, p, unpack4x8unorm(brick_data[at]));
    textureStore(normal_pool, p, unpack4x8snorm(brick_data[at + count]));
    if (scatter.words > 2u) {
        textureStore(opacity_pool, p, unpack4x8unorm(brick_data[at + 2u * count]));
    }
}
