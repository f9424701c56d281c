// Shares of the lamp at the surfaces that it shines on, made once; twin of `Baked::share`.

/// Share of the lamp, and whether the point lies on a layer.
struct Baked {
    share: f32,
    known: bool,
}

/// `w`, `at`, `slope` in texels of the map, without bias.
fn baked_share(map: Map, w: f32, at: vec2f, slope: vec2f) -> Baked {
    let place = at * map.layer_scale + 0.5;
    let whole = floor(place);
    let f = place - whole;
    // Rows begin and end with an empty texel: the left neighbour's word is at `whole` itself.
    let side = i32(map.layer_side);
    let x = u32(min(i32(whole.x), side));
    let rows = vec2u(vec2i(max(i32(whole.y) - 1, 0), min(i32(whole.y), side - 1)));
    let tilt = slope / map.layer_scale;
    let on = SHADOW_ON * w * w + 0.5 * (abs(tilt.x) + abs(tilt.y));
    var sum = 0.0;
    var weights = 0.0;
    for (var layer = 0u; layer < 2u; layer++) {
        for (var j = 0u; j < 2u; j++) {
            for (var i = 0u; i < 2u; i++) {
                let word = texels[map.layers[layer] + rows[j] * (map.layer_side + 2u) + x + i];
                let d = vec2f(f32(i), f32(j)) - f;
                let off = f32(word >> 8u) * (map.layer_nearest / SHADOW_STEPS) - (w + dot(tilt, d));
                if abs(off) <= on {
                    let weight = (1.0 - abs(d.x)) * (1.0 - abs(d.y));
                    weights += weight;
                    sum += weight * f32(word & 255u);
                }
            }
        }
        if weights >= 0.999 {
            break;
        }
    }
    return Baked(sum / (255.0 * max(weights, 1e-6)), weights >= SHADOW_ENOUGH);
}
