// The picture over the sky, onto a window or another texture: one triangle over all of it.

struct Present {
    // Camera axes, world; w unused.
    forward: vec4<f32>,
    right: vec4<f32>,
    up: vec4<f32>,
    // Linear light of the sky; w unused.
    horizon: vec4<f32>,
    zenith: vec4<f32>,
    // Pixels of the picture that were drawn, and of the target.
    drawn: vec2<u32>,
    size: vec2<u32>,
    // Half of the picture's extent in screen coordinates.
    half: vec2<f32>,
    // 1: the target keeps what is written, which so has to be sRGB.
    encode: u32,
    pad0: u32,
}

@group(0) @binding(0) var<uniform> present: Present;
@group(0) @binding(1) var picture: texture_2d<f32>;

@vertex
fn whole_target(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn texel(at: vec2<i32>) -> vec4<f32> {
    return textureLoad(picture, clamp(at, vec2(0), vec2<i32>(present.drawn) - 1), 0);
}

fn srgb(x: vec3<f32>) -> vec3<f32> {
    return select(1.055 * pow(max(x, vec3(0.0)), vec3(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3(0.0031308));
}

@fragment
fn over_sky(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    // Fewer pixels than the target has are interpolated; as many are what they are.
    let at = position.xy * vec2<f32>(present.drawn) / vec2<f32>(present.size) - 0.5;
    let low = floor(at);
    let f = at - low;
    let i = vec2<i32>(low);
    let color = mix(
        mix(texel(i), texel(i + vec2(1, 0)), f.x),
        mix(texel(i + vec2(0, 1)), texel(i + vec2(1, 1)), f.x),
        f.y,
    );
    let screen = (2.0 * position.xy / vec2<f32>(present.size) - 1.0) * present.half * vec2(1.0, -1.0);
    let ray = normalize(present.forward.xyz + screen.x * present.right.xyz + screen.y * present.up.xyz);
    let rise = clamp(ray.z, 0.0, 1.0);
    let sky = mix(present.horizon.xyz, present.zenith.xyz, rise * (2.0 - rise));
    let light = color.rgb + (1.0 - color.a) * sky;
    return vec4(select(light, srgb(light), present.encode != 0u), 1.0);
}
