// Mip-mapped, anisotropically filtered textures in linear light; twin of texture.rs.

/// Four 16-bit channels a texel.
@group(0) @binding(4) var<storage, read> texels: array<vec2u>;
/// First texel, width, height, 0; for the shadow's levels first block, side, side, 0.
@group(0) @binding(5) var<storage, read> levels: array<vec4u>;

fn texel(at: u32) -> vec3f {
    let packed = texels[at];
    return vec3f(f32(packed.x & 0xffffu), f32(packed.x >> 16u), f32(packed.y & 0xffffu));
}

/// The two texels around coordinate `t` of a repeating axis.
struct Neighbours {
    a: u32,
    b: u32,
    /// Weight of the second.
    f: f32,
}

fn wrap(t: f32, size: u32) -> Neighbours {
    let x = fract(t) * f32(size) + 0.5;
    let high = u32(x);
    // Texel centres are at halves: the lower neighbour is one before `high`, around the seam.
    let b = select(high, 0u, high >= size);
    let a = select(min(high - 1u, size - 1u), size - 1u, high == 0u);
    return Neighbours(a, b, x - f32(high));
}

fn bilinear(level: vec4u, uv: vec2f) -> vec3f {
    let x = wrap(uv.x, level.y);
    let y = wrap(uv.y, level.z);
    let top = level.x + y.a * level.y;
    let bottom = level.x + y.b * level.y;
    return mix(mix(texel(top + x.a), texel(top + x.b), x.f), mix(texel(bottom + x.a), texel(bottom + x.b), x.f), y.f);
}

fn trilinear(first: u32, count: u32, uv: vec2f, level: f32) -> vec3f {
    let low = min(u32(level), count - 1u);
    let fine = bilinear(levels[first + low], uv);
    let t = level - f32(low);
    if low == count - 1u || t < 1.0 / 64.0 {
        return fine;
    }
    return mix(fine, bilinear(levels[first + low + 1u], uv), t);
}

/// log2 of a number ≥ 1 as on the CPU, within 0.01.
fn fast_log2(v: f32) -> f32 {
    let bits = bitcast<u32>(v);
    let exponent = f32(bits >> 23u) - 127.0;
    let m = bitcast<f32>((bits & 0x007fffffu) | 0x3f800000u);
    return exponent + (m - 1.0) * (1.346607 - 0.346607 * m);
}

/// Colour at `uv`, averaged over the parallelogram of the screen-space derivatives.
fn sample_texture(first: u32, count: u32, uv: vec2f, du: vec2f, dv: vec2f) -> vec3f {
    let size = vec2f(levels[first].yz);
    let a = length(du * size);
    let b = length(dv * size);
    let long = max(a, b);
    let short = min(a, b);
    let axis = select(dv, du, a >= b);
    let taps = max(floor(min(min(long / max(short, 1e-6), MAX_TAPS), max(long, 1.0)) + 0.5), 1.0);
    let level = fast_log2(max(long / taps, 1.0));
    var sum = vec3f(0.0);
    for (var k = 0.0; k < taps; k += 1.0) {
        sum += trilinear(first, count, uv + axis * ((k + 0.5) / taps - 0.5), level);
    }
    return sum * (1.0 / (taps * 65535.0));
}
