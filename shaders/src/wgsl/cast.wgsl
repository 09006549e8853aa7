// The ray caster: one thread a pixel, all trees of the list in one dispatch, front to back.
//
// The rules of a ray are written down in docs/raycasting.md; the CPU reference follows the same rules with other code.
// Positions inside a tree are in finest voxels, from a cell near the eye; the cell a ray is in is an integer, so planes are
// crossed exactly.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> trees: array<Tree>;
@group(0) @binding(2) var<storage, read> nodes: array<vec2<u32>>;
@group(0) @binding(3) var brick_color: texture_3d<f32>;
@group(0) @binding(4) var brick_normal: texture_3d<f32>;
@group(0) @binding(5) var linear_sampler: sampler;
@group(0) @binding(6) var<storage, read_write> brick_stamps: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> tile_stamps: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> feedback: array<vec2<u32>>;
@group(0) @binding(9) var output: texture_storage_2d<rgba32float, write>;
// The counters, of which the first counts requests, then the table of what was asked for.
@group(0) @binding(10) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(11) var<storage, read_write> requests: array<vec4<u32>>;

@group(0) @binding(12) var brick_opacity: texture_3d<f32>;
// Where the brick in each slot shows anything.
@group(0) @binding(13) var<storage, read> occupancy: array<u32>;
// The trees that the rays of each tile may meet.
@group(0) @binding(14) var<storage, read> lists: array<u32>;
// Where rays end, and where they have lost half of their light; both only if that is asked for.
@group(0) @binding(15) var depth_in: texture_2d<f32>;
@group(0) @binding(16) var depth_out: texture_storage_2d<r32float, write>;

// Requests that one ray may make.
const MAX_REQUESTS: u32 = 16u;
const SATURATED: f32 = 1.0 / 1024.0;

// Cones toward the sun, 1 or none, and toward the sky, 6 or none, that begin where a pixel's ray has lost half of its light, to find
// what hides these lights (runtime/src/march/light.rs has the rules).
override SUN_CONES: u32 = 0u;
override SKY_CONES: u32 = 0u;
// What is shown instead of the terrain: 0 nothing, else as `Shows` in runtime/src/settings.rs counts.
override SHOWS: u32 = 0u;
// 1: rays end at depths; depths are written.
override ENDS: u32 = 0u;
override DEPTHS: u32 = 0u;

// What the rays of a pixel have in common: screen coordinates, and the direction, world metres per metre of depth.
var<private> screen: vec2<f32>;
var<private> sight: vec3<f32>;
// The ray: for a cone, where it begins beside the place in sight at `depth`, and what its depth is there.
var<private> is_cone: bool;
var<private> depth: f32;
var<private> lift: vec3<f32>;
var<private> cone_start: f32;
// Direction per unit of its depth, and its width.
var<private> direction: vec3<f32>;
var<private> width: f32;

// The surface that a pixel's ray sees, if that is asked for: sums over what is lit, and of depths, by what each adds to the opacity, the
// depth where half of the light is lost (below 0 until it is), and the finest voxel there.
var<private> facing: vec3<f32>;
var<private> lit: vec2<f32>;
var<private> mean_depth: f32;
var<private> half_depth: f32;
var<private> finest: f32;
// The node there: tree in the list, level, the place in it, and whether it stands in for what is not there.
var<private> seen_tree: u32;
var<private> seen_level: u32;
var<private> seen_local: vec3<f32>;
var<private> seen_missing: bool;

// A ray's state across trees.
// Its direction, of length 1.
var<private> heading: vec3<f32>;
// Depth before which it meets nothing, and where it ends.
var<private> start: f32;
var<private> end: f32;
var<private> rgb: vec3<f32>;
var<private> transmittance: f32;
var<private> requests_left: u32;
var<private> node_reads: u32;
var<private> samples: u32;
var<private> texture_reads: u32;
var<private> capped: bool;

// Premultiplied colour and opacity.
struct Light {
    rgb: vec3<f32>,
    a: f32,
    // The unit normal times what is lit; opacity of what is lit, and that times the cosine between normal and sun.
    facing: vec3<f32>,
    lit: vec2<f32>,
}

// Notes what light that is about to be added, `dz` metres from depth `z` on, has of the surface that is seen.
// Returns whether half of the light was still there.
fn note(light: Light, z: f32, dz: f32, voxel: f32) -> bool {
    facing += transmittance * light.facing;
    lit += transmittance * light.lit;
    if (half_depth >= 0.0) {
        return false;
    }
    finest = voxel;
    mean_depth += transmittance * light.a * (z + 0.5 * dz);
    let after = transmittance * (1.0 - light.a);
    if (after <= 0.5) {
        half_depth = z + dz * log2(2.0 * transmittance) / log2(transmittance / max(after, 1e-30));
    }
    return true;
}

fn composite(light: Light) {
    rgb += transmittance * light.rgb;
    transmittance *= 1.0 - light.a;
    if (transmittance < SATURATED) {
        rgb /= 1.0 - transmittance;
        transmittance = 0.0;
    }
}

// What a node shows of itself along a path. `local`: position in its brick, voxels from the low corner, rounded; `s`: length of the
// path in voxels of the node's level.
fn convert(word: vec2<u32>, local: vec3<f32>, texel_offset: f32, gain: f32, s: f32) -> Light {
    var stored: vec4<f32>;
    var normal = vec3(0.0);
    var opacities = vec3(0.0);
    let axes = (word.x & AXES) != 0u;
    if ((word.x & BRICK) == 0u) {
        let code = unpack4x8unorm(word.y);
        let low = code.rgb / 12.92;
        let high = pow((code.rgb + 0.055) / 1.055, vec3(2.4));
        stored = vec4(select(high, low, code.rgb <= vec3(0.04045)), code.a);
    } else {
        let slot = word.y - 1u;
        let cell = vec3(slot % frame.slots.x, slot / frame.slots.x % frame.slots.y, slot / (frame.slots.x * frame.slots.y));
        let uvw = (vec3<f32>(cell * frame.slot.xyz) + (local + texel_offset)) * frame.texel.xyz;
        stored = textureSampleLevel(brick_color, linear_sampler, uvw, 0.0);
        texture_reads += 1u;
        if (stored.a > 0.0) {
            texture_reads += 1u;
            normal = textureSampleLevel(brick_normal, linear_sampler, uvw, 0.0).xyz;
            if (axes) {
                texture_reads += 1u;
                opacities = textureSampleLevel(brick_opacity, linear_sampler, uvw, 0.0).xyz;
            }
            if (frame.blocks != 0u) {
                stored = vec4(stored.rgb * stored.a, stored.a);
                normal = (normal * frame.normal_scale.xyz + frame.normal_zero.xyz) * min(1.0, 2.0 * stored.a);
                opacities *= stored.a;
            }
        }
    }
    if (stored.a <= 0.0) {
        return Light(vec3(0.0), 0.0, vec3(0.0), vec2(0.0));
    }
    let opacity = min(1.0, gain * stored.a);
    var a: f32;
    if (axes) {
        a = path_opacity_axes(min(vec3(1.0), gain * opacities), heading, s, normal, opacity);
    } else {
        a = path_opacity(opacity, s);
    }
    let share = lit_share(normal, opacity);
    return Light(stored.rgb * (a / stored.a * light_of(share)), a, normal * (a * share.x / max(length(normal), 1e-6)), a * share);
}

// The node shows something of its own: a constant, or a brick that is resident.
fn has_data(word: vec2<u32>) -> bool {
    return (word.x & BRICK) == 0u || word.y != 0u;
}

fn read_node(index: u32) -> vec2<u32> {
    node_reads += 1u;
    return nodes[index];
}

fn stamp(index: u32, word: vec2<u32>) {
    atomicStore(&tile_stamps[index >> 3u], frame.frame);
    if ((word.x & BRICK) != 0u && word.y != 0u) {
        atomicStore(&brick_stamps[word.y - 1u], frame.frame);
    }
}

// Which cells of a node that shows something show anything.
fn shown_cells(word: vec2<u32>) -> vec2<u32> {
    if ((word.x & BRICK) != 0u) {
        let at = (word.y - 1u) * OCCUPANCY_WORDS;
        return vec2(occupancy[at], occupancy[at + 1u]);
    }
    return select(vec2(0u), vec2(0xffffffffu), word.y >> 24u != 0u);
}

// A place in a brick (voxels from its low corner), rounded: a brick gives the same bits in every slot.
fn rounded(local: vec3<f32>) -> vec3<f32> {
    return floor(clamp(local, vec3(0.0), vec3(8.0)) * 256.0 + 0.5) / 256.0;
}

// Whether a node that shows something does so at a place in it.
fn shows(word: vec2<u32>, local: vec3<f32>, texel_offset: f32) -> bool {
    if ((word.x & BRICK) == 0u) {
        return word.y >> 24u != 0u;
    }
    let gap = vec3<u32>(local + (texel_offset - 0.5));
    let bit = gap.x + 9u * gap.y + 81u * gap.z;
    return (occupancy[(word.y - 1u) * OCCUPANCY_WORDS + 2u + (bit >> 5u)] >> (bit & 31u) & 1u) != 0u;
}

fn octant(cell: vec3<i32>, shift: u32) -> u32 {
    let bits = vec3<u32>(cell >> vec3(shift)) & vec3(1u);
    return bits.x | bits.y << 1u | bits.z << 2u;
}

// Asks for a node, unless another ray has. The table remembers one request per entry, so a request may stand in the list more
// than once, but seldom does.
fn ask(tree_index: u32, level: u32, cell: vec3<i32>, shift: u32) {
    if (requests_left == 0u) {
        return;
    }
    requests_left -= 1u;
    let p = vec3<u32>(cell >> vec3(shift));
    let request = vec3((tree_index + 1u) | level << 16u, p.x | p.y << 20u, p.y >> 12u | p.z << 8u);
    var hash = request.x * 0x9e3779b1u ^ request.y * 0x85ebca77u ^ request.z * 0xc2b2ae3du;
    hash = (hash ^ hash >> 15u) * 0x2c1b3c6du;
    hash = (hash ^ hash >> 13u) | 1u;
    if (atomicExchange(&counters[COUNTER_WORDS + (hash >> 1u) % TABLE_WORDS], hash) != hash) {
        let slot = atomicAdd(&counters[0], 1u);
        if (slot < frame.request_capacity) {
            requests[slot] = vec4(request, 0u);
        }
    }
}

fn march(tree_index: u32, path_length: f32) {
    let tree = trees[tree_index];
    var origin = tree.base + screen.x * tree.base_x + screen.y * tree.base_y;
    var depth0 = tree.depth0;
    var first = start - depth0;
    if (is_cone) {
        origin += (sight * (depth - depth0) + lift) * tree.inv_voxel;
        depth0 = cone_start;
        first = 0.0;
    }
    let d = direction * tree.inv_voxel;
    let parallel = d == vec3(0.0);
    let positive = d > vec3(0.0);
    let inv = 1.0 / select(d, vec3(1.0), parallel);

    // Half-open slabs; depths are relative to the tree's.
    let box_low = vec3<f32>(tree.low - tree.cell);
    let box_high = vec3<f32>(tree.high - tree.cell);
    if (any(parallel & ((origin < box_low) | (origin >= box_high)))) {
        return;
    }
    let t_low = (box_low - origin) * inv;
    let t_high = (box_high - origin) * inv;
    let t_in = select(min(t_low, t_high), vec3(-FAR), parallel);
    let t_out = select(max(t_low, t_high), vec3(FAR), parallel);
    let enter = max(max(t_in.x, t_in.y), t_in.z);
    var t = max(enter, first);
    var leave = min(min(t_out.x, t_out.y), t_out.z);
    if (ENDS > 0u && !is_cone) {
        leave = min(leave, end - depth0);
    }
    if (!(t < leave)) {
        return;
    }

    // The entry plane's cell is exact, the others are where the point lies.
    var cell = clamp(tree.cell + vec3<i32>(floor(origin + d * t)), tree.low, tree.high - 1);
    cell = select(cell, select(tree.high - 1, tree.low, positive), (t_in == vec3(t)) & !parallel);

    var stack: array<u32, MAX_LEVELS>;
    stack[0] = tree.root;
    var stacked = 0u;       // deepest level on the stack that holds the current cell
    var reached = 0u;       // deepest level of the last descent
    var level = 0u;         // of the node in hand
    var word = vec2(0u);    // of the node in hand
    var parent = vec2(0u);  // of its parent
    var wanted = MAX_LEVELS; // level asked for at the last descent
    var fading = false;     // whether it was to be mixed with its parent
    var alone = true;       // the node is used without its parent
    var shown = vec2(0u);   // cells of the node, and of its parent if that is used, that show anything
    var parent_shown = vec2(0u);
    var missing = false;    // the node stands in for what is not there
    var t_change = FAR;     // where the pair of levels in hand gives way to another
    var parts = frame.segment_samples; // of the segment, from here on
    var fine = 0u;          // level wanted where the segment begins, and its share
    var weight = 1.0;
    let deepest = f32(tree.depth);
    let log2_footprint = tree.log2_root_voxel - log2(width);

    // The segment in hand; at first one without length, from which the ray goes on to where it is.
    var t_next = t;
    var low = cell;
    var size = 1i;
    var crossed = vec3(false);
    var closed = false;
    var node_low = vec3(0);
    var voxel_shift = 0u;
    var local = vec3(0.0);          // its middle in the node, and in the parent
    var parent_local = vec3(0.0);
    parts = 1u;
    var step = 0u;
    loop {
        // On to the next segment that shows something, in a loop of its own: rays of a group that run in step wait for each
        // other before they read textures, and not at every segment of one of them.
        loop {
            if (step >= tree.max_steps * frame.segment_samples) {
                capped = true;
                return;
            }
            step += 1u;
            parts = select(parts - 1u, frame.segment_samples, parts == 1u);

            // Into the next cell.
            if (t_next >= leave) {
                return;
            }
            t = t_next;
            let old = cell;
            // Never back: a plane that was crossed may still be ahead by rounding, and in a box of several voxels two of them could
            // be crossed in turn for ever.
            let there = clamp(tree.cell + vec3<i32>(floor(origin + d * t)), low, low + vec3(size - 1));
            let inside = select(min(there, old), max(there, old), positive);
            cell = select(inside, select(low - 1, low + size, positive), crossed);
            if (any(cell < tree.low) || any(cell >= tree.high)) {
                return;
            }
            let differs = (cell.x ^ old.x) | (cell.y ^ old.y) | (cell.z ^ old.z);
            let shared_levels = tree.depth + 3u - select(firstLeadingBit(u32(differs)) + 1u, 0u, differs == 0);
            stacked = min(stacked, shared_levels);

            // The wanted level where a segment begins, fractional, and the two levels around it.
            if (parts == frame.segment_samples) {
                let lambda = clamp(log2_footprint - log2(max(depth0 + t, 1e-30)), tree.least_level, deepest);
                let coarser = floor(lambda);
                weight = clamp((lambda - coarser - 0.5) / max(frame.fade, 1e-6) + 0.5, 0.0, 1.0);
                fine = u32(coarser) + u32(weight > 0.0);
                weight = select(weight, 1.0, weight == 0.0);
            }

            if (fine != wanted || (weight < 1.0) != fading || stacked < reached) {
                // Descend from the common ancestor.
                wanted = fine;
                fading = weight < 1.0;
                level = min(stacked, fine);
                word = read_node(stack[level]);
                while (level < fine && (word.x & POINTER) != 0u) {
                    level += 1u;
                    let index = (word.x & POINTER) * 8u + octant(cell, tree.depth + 3u - level);
                    stack[level] = index;
                    word = read_node(index);
                }
                stacked = level;
                reached = level;
                alone = level < fine || level == 0u || !fading;
                missing = (level < fine && (word.x & TERMINAL) == 0u) || !has_data(word);
                if (missing) {
                    ask(tree_index, fine, cell, tree.depth + 3u - fine);
                    alone = true;
                    while (level > 0u && !has_data(word)) {
                        level -= 1u;
                        word = read_node(stack[level]);
                    }
                    if (!has_data(word)) {
                        return;
                    }
                }
                stamp(stack[level], word);
                if (!alone) {
                    parent = read_node(stack[level - 1u]);
                    stamp(stack[level - 1u], parent);
                    if (!has_data(parent)) {
                        // Tiles come ahead of bricks: a constant node may be here before the brick it is mixed with.
                        ask(tree_index, fine, cell, tree.depth + 3u - fine);
                        alone = true;
                    }
                }
                shown = shown_cells(word);
                parent_shown = vec2(0u);
                if (!alone) {
                    parent_shown = shown_cells(parent);
                }
                // Just past that depth, so that rounding cannot bring the same pair back.
                let change = exp2(log2_footprint - f32(level) + 0.5 + select(0.5, -0.5, alone) * frame.fade);
                t_change = change * 1.000004 - depth0;
            }

            // The box of the segment, in finest voxels: one voxel of the node's level (2^segment_shift of them), or where the
            // value is constant more.
            voxel_shift = tree.depth - level;
            let node_shift = voxel_shift + 3u;
            node_low = (cell >> vec3(node_shift)) << vec3(node_shift);
            let is_constant = (word.x & BRICK) == 0u;
            let segment_shift = voxel_shift + frame.segment_shift;
            low = (cell >> vec3(segment_shift)) << vec3(segment_shift);
            size = 1i << segment_shift;
            closed = false;
            if (is_constant) {
                if (alone) {
                    closed = true;
                } else if ((parent.x & BRICK) == 0u) {
                    closed = (word.y | parent.y) >> 24u == 0u;
                } else {
                    let rim = i32(tree.rim) << voxel_shift;
                    let inner = cell - node_low;
                    if (all(inner >= vec3(rim)) && all(inner < vec3((8i << voxel_shift) - rim))) {
                        low = node_low + rim;
                        size = (8i << voxel_shift) - 2i * rim;
                        closed = true;
                    }
                }
                if (closed && (alone || (parent.x & BRICK) == 0u)) {
                    low = node_low;
                    size = 8i << voxel_shift;
                }
            }

            var clear = closed && word.y >> 24u == 0u;
            if (!closed && frame.segment_shift < 2u) {
                // A cell that shows nothing is passed in one step, as is the block of 2³ of them that is one cell of the parent; but voxel by
                // voxel where another pair of levels takes over on the way.
                let inner = vec3<u32>(cell - node_low) >> vec3(u32(voxel_shift));
                let in_cells = inner >> vec3(1u);
                let half = inner >> vec3(2u);
                let in_parent = ((vec3<u32>(cell) >> vec3(node_shift)) & vec3(1u)) * 2u + half;
                clear = ((select(shown.x, shown.y, half.z == 1u) >> (in_cells.x + in_cells.y * 4u + (in_cells.z & 1u) * 16u)
                    | select(parent_shown.x, parent_shown.y, in_parent.z > 1u) >> (in_parent.x + in_parent.y * 4u + (in_parent.z & 1u) * 16u)) & 1u) == 0u;
                if (clear) {
                    let block = select(shown.x, shown.y, half.z == 1u) & 0x00330033u << (half.x * 2u + half.y * 8u);
                    let shift = voxel_shift + select(1u, 2u, block == 0u);
                    let steps = select(abs(inv), vec3(FAR), parallel);
                    let reach = f32(1i << shift) * min(min(steps.x, steps.y), steps.z);
                    if (t_change <= t || t_change > t + reach) {
                        low = (cell >> vec3(shift)) << vec3(shift);
                        size = 1i << shift;
                    }
                }
            }

            let plane = select(low, low + size, positive);
            let t_plane = select((vec3<f32>(plane - tree.cell) - origin) * inv, vec3(FAR), parallel);
            let t_cell = min(min(t_plane.x, t_plane.y), t_plane.z);
            t_next = max(min(t_cell, leave), t);
            crossed = (t_plane == vec3(t_cell)) & !parallel;
            if (closed) {
                // A closed form holds until another pair of levels is mixed.
                if (t_change > t && t_change < t_next) {
                    t_next = t_change;
                    crossed = vec3(false);
                }
            }

            parts = select(parts, 1u, closed || clear);
            if (parts > 1u) {
                t_next = t + (t_next - t) / f32(parts);
                crossed = vec3(false);
            }
            if (t_next > t && !clear) {
                let p = origin + d * (0.5 * (t + t_next));
                let scale = exp2(-f32(voxel_shift));
                local = rounded((p - vec3<f32>(node_low - tree.cell)) * scale);
                var any_shown = shows(word, local, tree.texel_offset);
                if (!(alone || closed)) {
                    let corner = (node_low >> vec3(voxel_shift + 4u)) << vec3(voxel_shift + 4u);
                    parent_local = rounded((p - vec3<f32>(corner - tree.cell)) * (0.5 * scale));
                    any_shown |= shows(parent, parent_local, tree.texel_offset);
                }
                if (any_shown) {
                    break;
                }
            }
        }

        // Node and parent in a loop, so that the code that reads bricks stands in the kernel once: on lavapipe the
        // same kernel with two copies of it takes half as long again.
        let reads = texture_reads;
        let place = local;
        var s = (t_next - t) * path_length * tree.inv_voxel * exp2(-f32(voxel_shift));
        var drawn = word;
        var share = select(weight, 1.0, alone || closed);
        var light = Light(vec3(0.0), 0.0, vec3(0.0), vec2(0.0));
        for (var k = 0u; k < 2u; k++) {
            let one = convert(drawn, local, tree.texel_offset, tree.gain, s);
            light.rgb += share * one.rgb;
            light.a += share * one.a;
            light.facing += share * one.facing;
            light.lit += share * one.lit;
            if (alone || closed) {
                break;
            }
            s *= 0.5;
            local = parent_local;
            drawn = parent;
            share = 1.0 - weight;
        }
        samples += u32(texture_reads != reads);
        if (light.a > 0.0) {
            if (SUN_CONES + SKY_CONES + SHOWS + DEPTHS > 0u && !is_cone) {
                if (note(light, depth0 + t, t_next - t, 1.0 / tree.inv_voxel)) {
                    seen_tree = tree_index;
                    seen_level = level;
                    seen_local = place;
                    seen_missing = missing;
                }
            }
            composite(light);
        }
        if (transmittance == 0.0) {
            return;
        }
    }
}

@compute @workgroup_size(8, 8)
fn cast_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= frame.size)) {
        return;
    }
    screen = frame.screen_origin + frame.screen_step * vec2<f32>(id.xy);
    sight = frame.forward.xyz + screen.x * frame.right.xyz + screen.y * frame.up.xyz;
    // Which tiles may ask goes round, so that a full list does not starve the same ones for ever.
    let tile = id.x / 8u + id.y / 8u * 61u;
    requests_left = select(0u, MAX_REQUESTS, (tile + frame.frame) % frame.request_share == 0u);
    // The trees that rays of its tile may meet, or all where there are more than a list holds.
    let list = (id.y / 8u * ((frame.size.x + 7u) / 8u) + id.x / 8u) * LIST_WORDS;
    start = bitcast<f32>(lists[list + 1u]);
    let is_listed = frame.lists != 0u && lists[list] <= LIST_TREES;
    half_depth = -1.0;
    if (ENDS > 0u) {
        end = end_of(id.xy);
    }
    var color = vec4(0.0);
    var kept = 1.0;
    for (var k = 0u; k <= SUN_CONES + SKY_CONES; k++) {
        direction = sight;
        width = frame.footprint;
        var share = 0.0;
        if (k > 0u) {
            share = begin_cone(k - 1u, color.a);
            if (share <= 0.0) {
                continue;
            }
        }
        let path_length = length(direction);
        heading = direction / path_length;
        rgb = vec3(0.0);
        transmittance = 1.0;
        let listed = is_listed && k == 0u;
        var count = frame.tree_count;
        if (listed) {
            count = lists[list];
        }
        for (var i = 0u; i < count; i++) {
            var tree = i;
            if (listed) {
                tree = lists[list + 2u + i];
            }
            march(tree, path_length);
            if (transmittance == 0.0) {
                break;
            }
        }
        if (k == 0u) {
            color = vec4(rgb, 1.0 - transmittance);
            if (SUN_CONES + SKY_CONES == 0u || dot(facing, facing) < 1e-12) {
                break;
            }
        } else {
            kept -= share * (1.0 - transmittance);
        }
    }
    color = vec4(color.rgb * kept, color.a);
    var flags = select(0u, FLAG_HIT, color.a > 0.0) | select(0u, FLAG_CAPPED, capped);
    // Not-a-number is not below anything.
    if (!all(abs(color) < vec4(1e6))) {
        color = vec4(0.0);
        flags |= FLAG_NOT_FINITE;
    }
    if (SHOWS > 0u) {
        color = shown_instead(color);
    }
    textureStore(output, id.xy, color);
    if (DEPTHS > 0u) {
        textureStore(depth_out, id.xy, vec4(select(FAR, half_depth, half_depth >= 0.0)));
    }
    feedback[id.y * frame.size.x + id.x] =
        vec2(min(node_reads, 16383u) | min(samples, 16383u) << 14u | flags, texture_reads);
}
