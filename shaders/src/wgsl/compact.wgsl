// Compaction of a frame's feedback: requests without repetitions inside a tile of pixels, sums of the counters, and one
// bit for each slot that was used. The result is one small buffer for the read-back.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> feedback: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> brick_stamps: array<u32>;
@group(0) @binding(3) var<storage, read_write> tile_stamps: array<u32>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>, 16>;
@group(0) @binding(5) var<storage, read_write> requests: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> used: array<u32>;

// Pixels per axis that one thread looks at.
const TILE: u32 = 8u;
// Requests that a thread remembers to recognise repetitions.
const MEMORY: u32 = 4u;

@compute @workgroup_size(64)
fn compact_pixels(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = (frame.size + TILE - 1u) / TILE;
    let count = tiles.x * tiles.y;
    if (id.x >= count) {
        return;
    }
    // The start rotates, so that a full list does not starve the same tiles for ever.
    let tile = (id.x + frame.frame * 1021u) % count;
    let low = vec2(tile % tiles.x, tile / tiles.x) * TILE;
    let high = min(low + TILE, frame.size);
    var memory: array<vec3<u32>, MEMORY>;
    var oldest = 0u;
    var hits = 0u;
    var nodes = 0u;
    var samples = 0u;
    var reads = 0u;
    var capped = 0u;
    var not_finite = 0u;
    for (var y = low.y; y < high.y; y++) {
        for (var x = low.x; x < high.x; x++) {
            let report = feedback[y * frame.size.x + x];
            if ((report.w & FLAG_HIT) != 0u) {
                hits += 1u;
                nodes += report.w & 0x3fffu;
                samples += report.w >> 14u & 0x3fffu;
                reads += report.x >> 21u;
            }
            capped += report.w >> 29u & 1u;
            not_finite += report.w >> 30u & 1u;
            let request = vec3(report.x & 0x1fffffu, report.yz);
            if (request.x == 0u) {
                continue;
            }
            var known = false;
            for (var k = 0u; k < MEMORY; k++) {
                known = known || all(memory[k] == request);
            }
            if (!known) {
                memory[oldest] = request;
                oldest = (oldest + 1u) % MEMORY;
                let slot = atomicAdd(&counters[0], 1u);
                if (slot < frame.request_capacity) {
                    requests[slot] = vec4(request, 0u);
                }
            }
        }
    }
    atomicAdd(&counters[1], hits);
    atomicAdd(&counters[2], nodes);
    atomicAdd(&counters[3], samples);
    atomicAdd(&counters[4], reads);
    atomicAdd(&counters[5], capped);
    atomicAdd(&counters[6], not_finite);
}

// One thread a word: first the words of the brick slots, then those of the node tiles.
@compute @workgroup_size(64)
fn compact_usage(@builtin(global_invocation_id) id: vec3<u32>) {
    let brick_words = (frame.brick_slots + 31u) / 32u;
    let tile_words = (frame.node_tiles + 31u) / 32u;
    if (id.x >= brick_words + tile_words) {
        return;
    }
    var bits = 0u;
    if (id.x < brick_words) {
        for (var k = 0u; k < 32u; k++) {
            let slot = id.x * 32u + k;
            if (slot < frame.brick_slots && brick_stamps[slot] == frame.frame) {
                bits |= 1u << k;
            }
        }
    } else {
        for (var k = 0u; k < 32u; k++) {
            let tile = (id.x - brick_words) * 32u + k;
            if (tile < frame.node_tiles && tile_stamps[tile] == frame.frame) {
                bits |= 1u << k;
            }
        }
    }
    used[id.x] = bits;
}
