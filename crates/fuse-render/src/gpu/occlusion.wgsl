// Ambient occlusion from the grid; twin of `Occlusion::at`.

/// `o0`, `o1` as in occlusion.rs, in [0, 1] and offset by 128 / 255.
@group(0) @binding(10) var cells: texture_3d<f32>;

fn occlusion_cell(at: vec3i) -> vec4f {
    // Rows begin and end with a copy of their first and last cell.
    return textureLoad(cells, clamp(at, vec3i(0), vec3i(light.size) - 1) + vec3i(1, 0, 0), 0);
}

fn occlusion_trilinear(at: vec3f) -> vec4f {
    let base = floor(at);
    let f = at - base;
    let low = vec3i(base);
    var planes: array<vec4f, 2>;
    for (var dz = 0; dz < 2; dz++) {
        let a = mix(occlusion_cell(low + vec3i(0, 0, dz)), occlusion_cell(low + vec3i(1, 0, dz)), f.x);
        let b = mix(occlusion_cell(low + vec3i(0, 1, dz)), occlusion_cell(low + vec3i(1, 1, dz)), f.x);
        planes[dz] = mix(a, b, f.y);
    }
    return mix(planes[0], planes[1], f.z) - vec4f(0.0, vec3f(128.0 / 255.0));
}

/// Blocked shares (of the cosine hemisphere around the normal, along `direction`).
fn occluded(position: vec3f, normal: vec3f, direction: vec3f) -> vec2f {
    if light.occlusion == 0u {
        return vec2f(0.0);
    }
    let p = position + normal * light.cell;
    let inside = min(p - light.low, light.high - p);
    let border = min(inside.x, min(inside.y, inside.z));
    if border <= 0.0 {
        return vec2f(0.0);
    }
    let o = occlusion_trilinear((p - light.low) / light.cell - 0.5);
    let shares = 0.5 * o.x + vec2f(dot(normal, o.yzw), 1.5 * dot(direction, o.yzw));
    return clamp(OCCLUSION_GAIN * shares, vec2f(0.0), vec2f(1.0)) * min(border / OCCLUSION_FADE, 1.0);
}
