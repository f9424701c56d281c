// Metal-rough shading of one surface point; twin of shade.rs.

/// Ambient irradiance over π on a surface with this normal.
fn irradiance(n: vec3f) -> vec3f {
    var sum = mix(light.ground, light.sky, 0.5 + 0.5 * n.z);
    for (var i = 0u; i < light.box_count; i++) {
        let b = soft_boxes[i];
        // The patch's solid angle is 2π/s (1 - 1/(1 + 2s)) ≈ 2π/s; the cosine is wrapped.
        let c = max(0.5 + 0.5 * dot(n, b.direction), 0.0);
        sum += b.color * (2.0 / (1.0 + b.sharpness) * c * c);
    }
    return sum;
}

/// Ambient radiance from a direction, blurred as a surface of this roughness sees it.
fn surroundings(d: vec3f, roughness: f32) -> vec3f {
    let t = clamp(0.5 + d.z / (0.3 + 1.7 * roughness), 0.0, 1.0);
    var sum = mix(light.ground, light.sky, t * t * (3.0 - 2.0 * t));
    // Walls are brighter than floor and ceiling, which see the lamp at a steeper angle.
    let level = 1.0 - d.z * d.z;
    sum += light.sky * (0.7 * level * level);
    let a = roughness * roughness;
    for (var i = 0u; i < light.box_count; i++) {
        let b = soft_boxes[i];
        let s = b.sharpness / (1.0 + b.sharpness * a);
        let lobe = 1.0 / (1.0 + s * (1.0 - dot(d, b.direction)));
        sum += b.color * (lobe * lobe * (1.0 + s) / (1.0 + b.sharpness));
    }
    return sum;
}

/// Split-sum environment reflectance, with the CPU's (1 - nv)⁵.
fn environment_brdf(f0: vec3f, roughness: f32, nv: f32) -> vec3f {
    let r = vec4f(1.0 - roughness, 0.0425 - 0.0275 * roughness, 1.04 - 0.572 * roughness, 0.022 * roughness - 0.04);
    let e = 1.0 - nv;
    let a004 = min(r.x * r.x, e * e * e * e * e) * r.x + r.y;
    return f0 * (-1.04 * a004 + r.z) + (1.04 * a004 + r.w);
}

/// Light from the key lamp: Lambert and GGX, the lamp's size widening the highlight.
fn key_light(p: Point, diffuse: vec3f, f0: vec3f, nv: f32, roughness: f32) -> vec3f {
    let to_light = light.position - p.position;
    let distance2 = max(dot(to_light, to_light), 1e-4);
    let distance = sqrt(distance2);
    let l = to_light / distance;
    let nl = dot(p.normal, l);
    if nl <= 0.0 || dot(p.facet, l) <= 0.0 {
        return vec3f(0.0);
    }
    let visible = visibility(p.position, p.facet);
    if visible <= 0.0 {
        return vec3f(0.0);
    }
    let h = normalize_or(l + p.view, p.normal);
    let nh = clamp(dot(p.normal, h), 0.0, 1.0);
    let vh = clamp(dot(p.view, h), 0.0, 1.0);
    let alpha = roughness * roughness;
    let wide = min(alpha + 0.5 * light.radius / distance, 1.0);
    let a2 = wide * wide;
    // nh² (a2 - 1) + 1, without the cancellation near the peak.
    let d = nh * nh * a2 + (1.0 - nh) * (1.0 + nh);
    // GGX times π, since `intensity` is over π.
    let distribution = a2 / max(d * d, 1e-8);
    let k = alpha * 0.5;
    let geometric = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
    let f = (1.0 - vh) * (1.0 - vh);
    let fresnel = f0 + (1.0 - f0) * (f * f * (1.0 - vh));
    return (diffuse + fresnel * (distribution * geometric)) * light.intensity * (visible * nl / distance2);
}

/// Radiance towards the viewer.
fn reflected(p: Point, base: vec3f, metallic: f32, roughness: f32) -> vec3f {
    let f0 = mix(vec3f(0.04), base, metallic);
    let diffuse = base * (1.0 - metallic);
    let facing = dot(p.normal, p.view);
    let nv = max(facing, 1e-3);
    let reflection = p.normal * (2.0 * facing) - p.view;
    let hidden = occluded(p.position, p.normal, reflection);
    return diffuse * irradiance(p.normal) * (1.0 - hidden.x)
        + environment_brdf(f0, roughness, nv) * surroundings(reflection, roughness) * (1.0 - hidden.y)
        + key_light(p, diffuse, f0, nv, roughness);
}

/// Exposure and tone curve: neutral below 0.76, smooth shoulder above, in [0, 1].
fn display(radiance: vec3f) -> vec3f {
    let c = radiance * light.exposure;
    let peak = max(c.x, max(c.y, c.z));
    if peak < TONE_START {
        return max(c, vec3f(0.0));
    }
    let d = 1.0 - TONE_START;
    let new_peak = 1.0 - d * d / (peak + d - TONE_START);
    let g = 1.0 - 1.0 / (TONE_DESATURATION * (peak - new_peak) + 1.0);
    return clamp(mix(c * (new_peak / peak), vec3f(new_peak), g), vec3f(0.0), vec3f(1.0));
}

/// Linear [0, 1] to an sRGB byte, by way of the steps of the CPU's table.
fn srgb(linear: f32) -> u32 {
    let v = min(floor(max(linear, 0.0) * SRGB_STEPS + 0.5), SRGB_STEPS) / SRGB_STEPS;
    let s = select(1.055 * pow(v, 1.0 / 2.4) - 0.055, 12.92 * v, v <= 0.0031308);
    return u32(s * 255.0 + 0.5);
}
