// Mip-mapped, anisotropically filtered textures in linear light; twin of texture.rs.

/// Three 10-bit square roots a texel, in squares as in texture.rs; then the layers of shadow/baked.rs, which
/// share the buffer because a stage has eight at most.
@group(0) @binding(4) var<storage, read> texels: array<u32>;
/// First word, width, height, squares of a row; for the shadow's levels first of the nearest, side, side,
/// first of the farthest.
@group(0) @binding(5) var<storage, read> levels: array<vec4u>;

fn texel(level: vec4u, x: u32, y: u32) -> vec3f {
    let square = y / TEXEL_SQUARE * level.w + x / TEXEL_SQUARE;
    let packed = texels[level.x + (square * TEXEL_SQUARE + y % TEXEL_SQUARE) * TEXEL_ROW + x % TEXEL_SQUARE];
    let root = vec3f(vec3u(packed >> 20u, (packed >> 10u) & 1023u, packed & 1023u));
    return root * root;
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
    let above = mix(texel(level, x.a, y.a), texel(level, x.b, y.a), x.f);
    let below = mix(texel(level, x.a, y.b), texel(level, x.b, y.b), x.f);
    return mix(above, below, y.f);
}

/// log2 of numbers ≥ 1 as on the CPU, within 0.01.
fn log2_of(v: f32) -> f32 {
    let split = frexp(v);
    // The mantissa is moved from [½, 1) to [√½, √2).
    let low = split.fract < 0.70710678;
    let x = select(split.fract, 2.0 * split.fract, low) - 1.0;
    return f32(select(split.exp, split.exp - 1, low)) + x * (1.442695 - x * (0.721348 - x * 0.42));
}

fn trilinear(first: u32, count: u32, uv: vec2f, level: f32) -> vec3f {
    let low = min(u32(level), count - 1u);
    let fine = bilinear(levels[first + low], uv);
    // One level alone serves near its own scale.
    let t = clamp((level - f32(low) - LEVEL_ALONE) / (1.0 - 2.0 * LEVEL_ALONE), 0.0, 1.0);
    if low == count - 1u || t <= 0.0 {
        return fine;
    }
    return mix(fine, bilinear(levels[first + low + 1u], uv), t);
}

/// Colour at `uv`, averaged over the parallelogram of the screen-space derivatives.
fn sample_texture(first: u32, count: u32, uv: vec2f, du: vec2f, dv: vec2f) -> vec3f {
    let size = vec2f(levels[first].yz);
    let a = length(du * size);
    let b = length(dv * size);
    let long = max(a, b);
    let short = min(a, b);
    let axis = select(dv, du, a >= b);
    let wanted = min(long / max(short, 1e-6), max(long, 1.0)) / TAP_ASPECT;
    let taps = clamp(floor(wanted + 0.5), 1.0, MAX_TAPS);
    let level = log2_of(max(max(short, long / (TAP_STRETCH * taps)), 1.0));
    var sum = vec3f(0.0);
    for (var k = 0.0; k < taps; k += 1.0) {
        sum += trilinear(first, count, uv + axis * ((k + 0.5) / taps - 0.5), level);
    }
    return sum * (1.0 / (taps * TEXEL_ONE * TEXEL_ONE));
}
