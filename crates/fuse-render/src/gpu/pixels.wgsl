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

/// Each triangle in a pixel is shaded once, at the mean of the samples it covers, and weighted with
/// their number.
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
        sum += color_at(key, vec2f(at.xy) + 0.5 + offset / n) * n;
    }
    let c = sum / f32(LANES);
    image[at.y * view.width + at.x] = srgb(c.r) | (srgb(c.g) << 8u) | (srgb(c.b) << 16u);
}
