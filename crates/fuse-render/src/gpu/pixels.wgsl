/// Display-linear colour of a triangle at image coordinates.
fn color_at(key: u32, at: vec2f) -> vec3f {
    if key == 0u {
        return light.background;
    }
    let triangle = triangles[key - 1u];
    let part = parts[triangle.w];
    let p = point(triangle.xyz, at);
    var base = part.base;
    if part.level_count > 0u {
        base *= sample_texture(part.first_level, part.level_count, p.uv, p.du, p.dv);
    }
    return display(reflected(p, base, part.metallic, part.roughness));
}

/// Whether a triangle goes on another one, so that both look the same at image coordinates `at`.
fn alike(key: u32, other: u32, at: vec2f) -> bool {
    let one = triangles[key - 1u];
    let two = triangles[other - 1u];
    if one.w != two.w {
        return false;
    }
    let direction = ray(at);
    let a = load(one.xyz);
    let b = load(two.xyz);
    let w = vec2f(dot(a.normal, direction) / dot(a.normal, a.p[0]), dot(b.normal, direction) / dot(b.normal, b.p[0]));
    let up = vec3f(0.0, 0.0, 1.0);
    return dot(normalize_or(a.normal, up), normalize_or(b.normal, up)) >= ALIKE && abs(w.x - w.y) <= NEARBY * w.x;
}

/// Each triangle in a pixel is shaded once, at the mean of the samples it covers, and weighted with
/// their number; or the one at the centre, there and for all, where all others go on it.
@compute @workgroup_size(8, 8)
fn pixels(@builtin(global_invocation_id) at: vec3u) {
    if at.x >= view.width || at.y >= view.height {
        return;
    }
    var samples: array<u32, LANES>;
    for (var s = 0u; s < LANES; s++) {
        samples[s] = textureLoad(keys, at.xy, s, 0).r;
    }
    center(at.xy, samples[0]);
    var sum = vec3f(0.0);
    var left = (1u << LANES) - 1u;
    while left != 0u {
        let first = firstTrailingBit(left);
        let key = samples[first];
        var n = 0.0;
        var offset = vec2f(0.0);
        for (var s = first; s < LANES; s++) {
            if ((left >> s) & 1u) != 0u && samples[s] == key {
                n += 1.0;
                offset += SAMPLES[s];
                left &= ~(1u << s);
            }
        }
        let middle = vec2f(at.xy) + 0.5;
        var place = middle + offset / n;
        if first == 0u && key != 0u {
            var all = true;
            for (var s = 1u; s < LANES && all; s++) {
                all = samples[s] == key || (samples[s] != 0u && samples[s] == samples[s - 1u])
                    || (samples[s] != 0u && alike(key, samples[s], middle));
            }
            if all {
                n = f32(LANES);
                place = middle;
                left = 0u;
            }
        }
        sum += color_at(key, place) * n;
    }
    let c = sum / f32(LANES);
    image[at.y * view.width + at.x] = srgb(c.r) | (srgb(c.g) << 8u) | (srgb(c.b) << 16u);
}
