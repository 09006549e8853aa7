// Which trees the rays of a tile of 8×8 pixels may meet: one thread a tile. So a ray looks at these and not at all that are in
// view.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> trees: array<Tree>;
@group(0) @binding(2) var<storage, read_write> lists: array<u32>;

// The most that a coordinate along an axis may be, over a box.
fn most(axis: vec3<f32>, low: vec3<f32>, high: vec3<f32>) -> f32 {
    let ends = max(axis * low, axis * high);
    return ends.x + ends.y + ends.z;
}

@compute @workgroup_size(64)
fn list_trees(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = (frame.size + 7u) / 8u;
    if (id.x >= tiles.x * tiles.y) {
        return;
    }
    let tile = vec2(id.x % tiles.x, id.x / tiles.x);
    // A pixel more on each side than the centres of the tile's.
    let first = frame.screen_origin + frame.screen_step * (vec2<f32>(tile * 8u) - 1.0);
    let last = first + frame.screen_step * 9.0;
    let low = min(first, last);
    let high = max(first, last);
    // Points between its sides are on the positive side of these, seen from the eye.
    let forward = frame.forward.xyz;
    let west = frame.right.xyz - low.x * forward;
    let east = high.x * forward - frame.right.xyz;
    let south = frame.up.xyz - low.y * forward;
    let north = high.y * forward - frame.up.xyz;
    let at = id.x * LIST_WORDS;
    var count = 0u;
    for (var i = 0u; i < frame.tree_count; i++) {
        let eye = trees[i].base - forward * (trees[i].depth0 * trees[i].inv_voxel);
        let box_low = vec3<f32>(trees[i].low - trees[i].cell) - eye;
        let box_high = vec3<f32>(trees[i].high - trees[i].cell) - eye;
        let sides = min(
            min(most(west, box_low, box_high), most(east, box_low, box_high)),
            min(most(south, box_low, box_high), most(north, box_low, box_high)),
        );
        if (min(sides, most(forward, box_low, box_high)) >= 0.0) {
            count += 1u;
            if (count <= LIST_TREES) {
                lists[at + 1u + count] = i;
            }
        }
    }
    lists[at] = count;
}
