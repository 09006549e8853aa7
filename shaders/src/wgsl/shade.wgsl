// Opacity of a path and light of a sample.

// The most opacity across a voxel. A voxel of it ends the ray (SATURATED), but the opacity of a short path stays continuous
// in the value: were 1 opaque however short, rays that touch the edge of a voxel would show or miss it by a rounding.
const MOST_OPAQUE: f32 = 1.0 - 1.0 / 2048.0;

// Optical depth -ln(1 - a), kept exact where a is small.
fn optical_depth(a: f32) -> f32 {
    if (a < 0.01) {
        return a * (1.0 + a * (0.5 + a * (1.0 / 3.0)));
    }
    return -0.6931472 * log2(1.0 - min(a, MOST_OPAQUE));
}

// Opacity 1 - exp(-depth), kept exact where it is small.
fn opacity_of(depth: f32) -> f32 {
    if (depth < 0.02) {
        return depth * (1.0 - depth * (0.5 - depth * (1.0 / 6.0)));
    }
    return 1.0 - exp2(-1.442695 * depth);
}

// Opacity over `s` voxels of a medium with opacity `a` across one: 1 - (1 - a)^s.
fn path_opacity(a: f32, s: f32) -> f32 {
    return opacity_of(s * optical_depth(a));
}

// Opacity over `s` voxels of a medium with opacities `a` against the axes, along a direction of length 1. `n`: its premultiplied
// mean normal, `opacity` what that was multiplied by: the longer it is, the more the medium is a sheet, which a ray meets
// by the cosine between.
fn path_opacity_axes(a: vec3<f32>, direction: vec3<f32>, s: f32, n: vec3<f32>, opacity: f32) -> f32 {
    let depths = vec3(optical_depth(a.x), optical_depth(a.y), optical_depth(a.z));
    let len = max(length(n), 1e-6);
    let along = depths * direction;
    let facing = length(depths) * dot(direction, n) / len;
    let flat = clamp(2.0 * len / max(opacity, 1e-6), 0.0, 1.0);
    return opacity_of(s * sqrt(mix(dot(along, along), facing * facing, flat)));
}

// How much is lit of a sample with premultiplied mean normal `n` and opacity `a`, and that times the cosine between normal and sun:
// nothing where there is no normal.
fn lit_share(n: vec3<f32>, a: f32) -> vec2<f32> {
    let len = length(n);
    if (len < 1e-6) {
        return vec2(0.0);
    }
    let share = clamp(8.0 * len / max(a, 1e-6), 0.0, 1.0);
    return vec2(share, share * max(0.0, dot(n, frame.sun.xyz) / len));
}

// What is seen of the albedo.
fn light_of(lit: vec2<f32>) -> f32 {
    return 1.0 + lit.x * (frame.sun.w - 1.0) + lit.y * frame.diffuse;
}
