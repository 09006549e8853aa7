// Compaction of a frame's feedback: sums of the rays' counters, and one bit for each slot that was used. With the list of
// requests, which the rays keep free of repetitions themselves, the result is one small buffer for the read-back.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> feedback: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> brick_stamps: array<u32>;
@group(0) @binding(3) var<storage, read_write> tile_stamps: array<u32>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> used: array<u32>;

// Pixels that one thread sums.
const SPAN: u32 = 64u;

@compute @workgroup_size(64)
fn compact_pixels(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixels = frame.size.x * frame.size.y;
    let first = id.x * SPAN;
    if (first >= pixels) {
        return;
    }
    var hits = 0u;
    var nodes = 0u;
    var samples = 0u;
    var reads = 0u;
    var capped = 0u;
    var not_finite = 0u;
    for (var k = first; k < min(first + SPAN, pixels); k++) {
        let report = feedback[k];
        if ((report.x & FLAG_HIT) != 0u) {
            hits += 1u;
            nodes += report.x & 0x3fffu;
            samples += report.x >> 14u & 0x3fffu;
            reads += report.y;
        }
        capped += report.x >> 29u & 1u;
        not_finite += report.x >> 30u & 1u;
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
