// Where the rays of a tile of 8×8 pixels may begin: before the first place, of whichever tree, in which one of them could meet
// something. One thread a tile.
//
// All rays of a tile start at the eye, so what they can reach on each axis lies between two lines. With those the trees are walked
// front to back, coarse nodes first, until nothing nearer is left. A node counts where it is shown: alone or mixed into finer
// ones, which is from the depth on at which the next finer level begins to fade. What is not resident counts as something, so that
// rays come there and ask. What rays would have used on the way is stamped, though none comes to it.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> trees: array<Tree>;
@group(0) @binding(2) var<storage, read> nodes: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> occupancy: array<u32>;
@group(0) @binding(4) var<storage, read_write> brick_stamps: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> tile_stamps: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> lists: array<u32>;

// Nodes after which a walk goes no deeper.
const MAX_VISITS: u32 = 2048u;

// The beam in a tree: at a depth behind the tree's, rays are between `least` and `most`, each with its change by depth (never 0).
var<private> least: vec3<f32>;
var<private> least_slope: vec3<f32>;
var<private> most: vec3<f32>;
var<private> most_slope: vec3<f32>;

// The depths between which the beam may touch a box; the first is above the second if it never does.
fn touches(low: vec3<f32>, high: vec3<f32>) -> vec2<f32> {
    let at_low = (low - most) / most_slope;
    let at_high = (high - least) / least_slope;
    let rises = most_slope > vec3(0.0);
    let falls = least_slope < vec3(0.0);
    let enter = max(select(vec3(0.0), at_low, rises), select(vec3(0.0), at_high, falls));
    let leave = min(select(at_low, vec3(FAR), rises), select(at_high, vec3(FAR), falls));
    return vec2(max(max(max(enter.x, enter.y), enter.z), 0.0), min(min(leave.x, leave.y), leave.z));
}

// The first depth of a span in which a node that is shown shows anything. `corner`: its low corner in finest voxels, from the
// tree's cell; `voxel_shift`: log2 of its voxel.
fn first_shown(word: vec2<u32>, corner: vec3<i32>, voxel_shift: u32, span: vec2<f32>) -> f32 {
    if ((word.x & BRICK) == 0u) {
        return select(FAR, span.x, word.y >> 24u != 0u);
    }
    // Segments of more than a cell sample beside it.
    if (word.y == 0u || frame.segment_shift > 1u) {
        return span.x;
    }
    let at = (word.y - 1u) * OCCUPANCY_WORDS;
    var first = FAR;
    for (var half = 0u; half < 2u; half++) {
        var cells = occupancy[at + half];
        while (cells != 0u) {
            let bit = firstTrailingBit(cells) + 32u * half;
            cells &= cells - 1u;
            let low = corner + vec3<i32>(vec3(bit & 3u, bit >> 2u & 3u, bit >> 4u) << vec3(voxel_shift + 1u));
            let cell = touches(vec3<f32>(low), vec3<f32>(low + (2i << voxel_shift)));
            let enter = max(cell.x, span.x);
            if (enter <= min(cell.y, span.y)) {
                first = min(first, enter);
            }
        }
    }
    return first;
}

// The depth, behind the tree's, up to which no ray of the beam meets anything in it; `nearest` if that is not nearer.
fn walk(tree: Tree, so_far: f32) -> f32 {
    var nearest = so_far;
    let log2_footprint = tree.log2_root_voxel - log2(frame.footprint);
    // Octants come in the order in which the middle of the beam meets them, so places are counted against its direction.
    let flip = select(vec3(0i), vec3((8i << tree.depth) - 1i), least_slope + most_slope < vec3(0.0));
    var tiles: array<u32, MAX_LEVELS>;
    var index = tree.root;
    var level = 0u;
    var place = vec3(0i);
    for (var visits = 0u; ; visits++) {
        let shift = tree.depth + 3u - level;
        let corner = ((place ^ flip) >> vec3(shift)) << vec3(shift);
        let low = max(corner, tree.low);
        let high = min(corner + (1i << shift), tree.high);
        let span = touches(vec3<f32>(low - tree.cell), vec3<f32>(high - tree.cell));
        var down = 0u;
        if (all(low < high) && span.x <= span.y && span.x < nearest) {
            let word = nodes[index];
            // Where rays want finer nodes and where this one is shown, mixed into finer ones or alone; both where the next level
            // fades. Segments go on with the levels that they began with.
            var wanted_to = -FAR;
            var shown_from = 0.0;
            if ((word.x & TERMINAL) == 0u && level < tree.depth) {
                let next = f32(level) + 0.5;
                let gone = next - 0.5 * frame.fade;
                let fades = next + 0.5 * frame.fade;
                wanted_to = select(exp2(log2_footprint - gone) * 1.0001 - tree.depth0, FAR, tree.least_level >= gone);
                let segment = f32(2u << (shift - 3u + frame.segment_shift)) / tree.inv_voxel;
                shown_from = select(exp2(log2_footprint - fades) * 0.9999 - tree.depth0 - segment, FAR, tree.least_level > fades);
            }
            let wanted = span.x <= wanted_to;
            let children = word.x & POINTER;
            if (wanted && (children == 0u || visits > MAX_VISITS)) {
                nearest = span.x;
            } else {
                let shown = vec2(max(span.x, shown_from), span.y);
                if (shown.x <= shown.y) {
                    atomicStore(&tile_stamps[index >> 3u], frame.frame);
                    if ((word.x & BRICK) != 0u && word.y != 0u) {
                        atomicStore(&brick_stamps[word.y - 1u], frame.frame);
                    }
                    if (shown.x < nearest) {
                        nearest = min(nearest, first_shown(word, corner - tree.cell, shift - 3u, shown));
                    }
                }
                down = select(0u, children, wanted && span.x < nearest);
            }
        }
        // On to the first child, or to the next node of the deepest level that has one.
        var next = 0u;
        if (down != 0u) {
            level += 1u;
            tiles[level] = down;
        } else {
            level -= firstTrailingBit(~u32((place.x & place.y & place.z) >> shift));
            if (level == 0u) {
                return nearest;
            }
            let bits = vec3<u32>(place >> vec3(tree.depth + 3u - level)) & vec3(1u);
            next = (bits.x | bits.y << 1u | bits.z << 2u) + 1u;
        }
        let to = tree.depth + 3u - level;
        place = ((place >> vec3(to + 1u)) << vec3(to + 1u)) | vec3<i32>((vec3(next) >> vec3(0u, 1u, 2u) & vec3(1u)) << vec3(to));
        let octant = (place ^ flip) >> vec3(to) & vec3(1i);
        index = tiles[level] * 8u + u32(octant.x | octant.y << 1u | octant.z << 2u);
    }
    return nearest;
}

@compute @workgroup_size(64)
fn start_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    let across = (frame.size + 7u) / 8u;
    if (id.x >= across.x * across.y) {
        return;
    }
    // A sixteenth of a pixel more on each side than the centres of the tile's, for what is rounded.
    let tile = vec2(id.x % across.x, id.x / across.x);
    let first = frame.screen_origin + frame.screen_step * (vec2<f32>(tile * 8u) - 0.0625);
    let last = first + frame.screen_step * 7.125;
    let at = id.x * LIST_WORDS;
    let listed = frame.lists != 0u && lists[at] <= LIST_TREES;
    let count = select(frame.tree_count, lists[at], listed);
    var nearest = FAR;
    for (var i = 0u; i < count; i++) {
        var tree_index = i;
        if (listed) {
            tree_index = lists[at + 2u + i];
        }
        let tree = trees[tree_index];
        let right = frame.right.xyz;
        let up = frame.up.xyz;
        least = tree.base + min(first.x * tree.base_x, last.x * tree.base_x) + min(first.y * tree.base_y, last.y * tree.base_y);
        most = tree.base + max(first.x * tree.base_x, last.x * tree.base_x) + max(first.y * tree.base_y, last.y * tree.base_y);
        least_slope = (frame.forward.xyz + min(first.x * right, last.x * right) + min(first.y * up, last.y * up)) * tree.inv_voxel;
        most_slope = (frame.forward.xyz + max(first.x * right, last.x * right) + max(first.y * up, last.y * up)) * tree.inv_voxel;
        // Never 0, and outwards.
        least_slope = select(least_slope, vec3(-1e-20), abs(least_slope) < vec3(1e-20));
        most_slope = select(most_slope, vec3(1e-20), abs(most_slope) < vec3(1e-20));
        nearest = min(nearest, walk(tree, nearest - tree.depth0) + tree.depth0);
    }
    // Somewhat before, for what is rounded.
    lists[at + 1u] = bitcast<u32>(nearest * (1.0 - 4e-6));
}
