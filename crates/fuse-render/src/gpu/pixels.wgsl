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

/// The samples in `left` that show the same as sample `s`.
fn same(samples: ptr<function, array<u32, LANES>>, left: u32, s: u32) -> u32 {
    var found = 0u;
    for (var i = s; i < LANES; i++) {
        if samples[i] == samples[s] {
            found |= 1u << i;
        }
    }
    return found & left;
}

/// Each thing in a pixel is shaded once, at the mean of the samples that its first triangle covers, and
/// weighted with the number of samples.
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
        var covered = same(&samples, left, first);
        left &= ~covered;
        var offset = vec2f(0.0);
        for (var s = first; s < LANES; s++) {
            if ((covered >> s) & 1u) != 0u {
                offset += SAMPLES[s];
            }
        }
        let mean = vec2f(at.xy) + 0.5 + offset / f32(countOneBits(covered));
        var others = select(0u, left, key != 0u);
        while others != 0u {
            let second = firstTrailingBit(others);
            let more = same(&samples, others, second);
            others &= ~more;
            if samples[second] != 0u && alike(key, samples[second], mean) {
                covered |= more;
                left &= ~more;
            }
        }
        sum += color_at(key, mean) * f32(countOneBits(covered));
    }
    let c = sum / f32(LANES);
    image[at.y * view.width + at.x] = srgb(c.r) | (srgb(c.g) << 8u) | (srgb(c.b) << 16u);
}
