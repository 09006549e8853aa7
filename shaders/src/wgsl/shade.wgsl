// Opacity of a path and light of a sample.

// Opacity across a voxel from which a value counts as opaque however short the path: a little below 1, since sums of weights
// that are 1 on paper round to either side of it.
const OPAQUE: f32 = 0.998;

// Opacity over `s` voxels of a medium with opacity `a` across one: 1 - (1 - a)^s, kept exact where a is small.
fn path_opacity(a: f32, s: f32) -> f32 {
    if (a > OPAQUE) {
        return 1.0;
    }
    if (a < 0.01) {
        let tau = s * a * (1.0 + a * (0.5 + a * (1.0 / 3.0)));
        if (tau < 0.02) {
            return tau * (1.0 - tau * (0.5 - tau * (1.0 / 6.0)));
        }
    }
    return 1.0 - exp2(s * log2(1.0 - a));
}

// Most optical depth of a voxel along an axis: with it a ray counts as opaque, and one nearly along a sheet does not before
// it has gone through.
const DEEPEST: f32 = 8.0;

// -ln(1 - a), kept exact where a is small.
fn optical_depth(a: f32) -> f32 {
    if (a < 0.01) {
        return a * (1.0 + a * (0.5 + a * (1.0 / 3.0)));
    }
    return -0.6931472 * log2(1.0 - a);
}

// Opacity over `s` voxels of a medium with opacities `a` against the axes, along a direction of length 1.
fn path_opacity_axes(a: vec3<f32>, direction: vec3<f32>, s: f32) -> f32 {
    if (min(min(a.x, a.y), a.z) > OPAQUE) {
        return 1.0;
    }
    let depths = min(vec3(optical_depth(a.x), optical_depth(a.y), optical_depth(a.z)), vec3(DEEPEST));
    let tau = s * length(depths * direction);
    if (tau < 0.02) {
        return tau * (1.0 - tau * (0.5 - tau * (1.0 / 6.0)));
    }
    return 1.0 - exp2(-1.442695 * tau);
}

// Light on a sample with premultiplied mean normal `n` and opacity `a`: unlit where there is no normal.
fn sun_light(n: vec3<f32>, a: f32) -> f32 {
    let len = length(n);
    if (len < 1e-6) {
        return 1.0;
    }
    let lit = frame.sun.w + frame.diffuse * max(0.0, dot(n, frame.sun.xyz) / len);
    return mix(1.0, lit, clamp(8.0 * len / max(a, 1e-6), 0.0, 1.0));
}
