// What a pixel makes of the surface that its ray has noted: cones that begin there, what else is shown than the terrain; and where its ray
// ends. The state is that of cast.wgsl.

// A colour for a number, unlike those of its neighbours.
fn hue(k: u32) -> vec3<f32> {
    let h = fract(f32(k) * 0.381966);
    return clamp(abs(fract(h + vec3(0.0, 2.0 / 3.0, 1.0 / 3.0)) * 6.0 - 3.0) - 1.0, vec3(0.05), vec3(0.9));
}

// What is shown in the place of a pixel's colour.
fn shown_instead(color: vec4<f32>) -> vec4<f32> {
    let n = facing / max(length(facing), 1e-6);
    let shade = color.a * (0.4 + 0.6 * max(0.0, dot(n, frame.sun.xyz)));
    if (SHOWS == 1u) {
        return vec4(hue(seen_level) * shade, color.a);
    }
    if (SHOWS == 2u) {
        // Faces that the surface lies in are not shown.
        let edge = min(seen_local, 8.0 - seen_local);
        let near = (edge < vec3(0.25)) & (abs(n) < vec3(0.8));
        return vec4(color.rgb * select(1.0, 0.1, any(near)), color.a);
    }
    if (SHOWS == 3u) {
        let x = min(f32(node_reads + samples) / 96.0, 1.0);
        return vec4(clamp(vec3(2.0 * x - 1.0, 1.0 - abs(2.0 * x - 1.0), 1.0 - 2.0 * x), vec3(0.0), vec3(1.0)), 1.0);
    }
    if (SHOWS == 4u) {
        let grey = dot(color.rgb, vec3(0.2126, 0.7152, 0.0722));
        return vec4(select(vec3(grey), vec3(color.a, 0.2 * grey, 0.0), seen_missing), color.a);
    }
    if (SHOWS == 5u) {
        return vec4(hue(seen_tree) * shade, color.a);
    }
    return vec4((0.5 + 0.5 * n) * color.a, color.a);
}

// Begins a cone from the surface that a pixel of opacity `a` sees; returns the share of the pixel's light that comes along it.
fn begin_cone(index: u32, a: f32) -> f32 {
    let n = normalize(facing);
    depth = select(mean_depth / a, half_depth, half_depth >= 0.0);
    let size = max(frame.footprint * depth, finest);
    let sun = lit.y * frame.diffuse / a;
    let sky = lit.x * frame.sun.w / a;
    let all = 1.0 - lit.x / a + sky + sun;
    is_cone = true;
    direction = n;
    width = frame.cones.y;
    var share = sky * frame.sky_middle;
    if (index < SUN_CONES) {
        direction = frame.sun.xyz;
        width = frame.cones.x;
        share = sun;
    } else if (index > SUN_CONES) {
        // Axes that turn with the normal wherever it turns, but for straight down.
        let f = 1.0 / max(1.0 + n.z, 1e-3);
        let b = n.x * n.y * f;
        let angle = f32(index - SUN_CONES - 1u) * 1.2566371;
        let side = cos(angle) * vec3(1.0 - n.x * n.x * f, -b, -n.x) + sin(angle) * vec3(-b, 1.0 - n.y * n.y * f, -n.y);
        direction = normalize(n * frame.cones.w + side * sqrt(1.0 - frame.cones.w * frame.cones.w));
        share = sky * (1.0 - frame.sky_middle) / 5.0;
    }
    lift = n * (frame.cones.z * size);
    cone_start = size / width;
    return share / all;
}

// Where the ray of a pixel ends: depths are those of the whole picture, of which fewer pixels may be drawn.
fn end_of(pixel: vec2<u32>) -> f32 {
    let at = vec2<u32>(max(frame.pixels.xy + frame.pixels.zw * vec2<f32>(pixel) + 0.5, vec2(0.0)));
    let value = textureLoad(depth_in, min(at, textureDimensions(depth_in) - 1u), 0).x;
    let depth = select(frame.depth_in.y / (value - frame.depth_in.x), value, frame.depth_in.y == 0.0);
    return select(FAR, depth, value != frame.depth_in.z && depth < FAR);
}
