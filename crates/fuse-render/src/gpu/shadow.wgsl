// Soft shadow of the key light; twin of `Shadow::visibility`, from the CPU's maps.

/// Extreme inverse depths of all levels of all maps: nearest to the lamp, then farthest.
@group(0) @binding(6) var<storage, read> extremes: array<f32>;

/// A point that asks for its light.
struct Receiver {
    /// Inverse depth, bias included.
    w: f32,
    at: vec2f,
    /// Change of `w` along the surface, per texel.
    slope: vec2f,
}

/// Sums over a disc of the map: weight, that of blockers, their inverse depth times weight.
struct Disc {
    weight: f32,
    blocked: f32,
    depth: f32,
}

fn extremes_at(level: vec4u, x: i32, y: i32) -> vec2f {
    let last = i32(level.y) - 1;
    let at = u32(clamp(y, 0, last)) * level.y + u32(clamp(x, 0, last));
    return vec2f(extremes[level.x + at], extremes[level.w + at]);
}

/// Reach of blockers at inverse depth `blocker`, texels.
fn reach_of(map: Map, blocker: f32, w: f32) -> f32 {
    return map.focal * map.radius * max(blocker - w, 0.0);
}

/// Extremes over a square that holds the disc.
fn extremes_within(map: Map, at: vec2f, reach: f32) -> vec2f {
    var level = 0u;
    while level + 1u < map.level_count && f32(1u << level) <= 2.0 * reach {
        level++;
    }
    let scale = 1.0 / f32(1u << level);
    let low = vec2i(floor((at - reach) * scale));
    let high = vec2i(floor((at + reach) * scale));
    let table = levels[map.first_level + level];
    var out = extremes_at(table, low.x, low.y);
    for (var y = low.y; y <= high.y; y++) {
        for (var x = low.x; x <= high.x; x++) {
            let e = extremes_at(table, x, y);
            out = vec2f(max(out.x, e.x), min(out.y, e.y));
        }
    }
    return out;
}

/// Sums over the texels of a disc, at the level where it is at most MAX_DISC wide.
fn disc_sums(map: Map, r: Receiver, full_radius: f32) -> Disc {
    var level = 0u;
    var scale = 1.0;
    while full_radius * scale > MAX_DISC && level + 1u < map.level_count {
        level++;
        scale *= 0.5;
    }
    let radius = full_radius * scale + 0.5;
    let at = r.at * scale - 0.5;
    let slope = r.slope / scale;
    let low = vec2i(ceil(at - radius));
    let high = vec2i(floor(at + radius));
    // Half of the change of the receiver's own depth over a block, which must not block it.
    let tilt = 0.5 * (abs(slope.x) + abs(slope.y)) * (1.0 - scale);
    let table = levels[map.first_level + level];
    var disc = Disc(0.0, 0.0, 0.0);
    for (var y = low.y; y <= high.y; y++) {
        for (var x = low.x; x <= high.x; x++) {
            let d = vec2f(f32(x), f32(y)) - at;
            let weight = clamp(radius - length(d), 0.0, 1.0);
            let e = extremes_at(table, x, y);
            let plane = r.w + dot(slope, d) + tilt;
            // A block of texels that is blocked in part counts half.
            let blocked = weight * 0.5 * (select(0.0, 1.0, e.x > plane) + select(0.0, 1.0, e.y > plane));
            disc.weight += weight;
            disc.blocked += blocked;
            disc.depth += blocked * e.x;
        }
    }
    return disc;
}

fn lit_share(map: Map, r: Receiver) -> f32 {
    let top = extremes[levels[map.first_level + map.level_count - 1u].x];
    var reach = reach_of(map, top, r.w);
    // Twice: a smaller region has a farther nearest blocker, hence a smaller reach.
    for (var i = 0; i < 2; i++) {
        let e = extremes_within(map, r.at, reach + 1.0);
        let tilt = length(r.slope) * (reach + 1.0);
        if e.x <= r.w - tilt {
            return 1.0;
        }
        if e.y > r.w + tilt {
            return 0.0;
        }
        reach = min(reach, reach_of(map, e.x, r.w));
    }
    reach = max(reach, 1.0);
    let search = disc_sums(map, r, reach);
    if search.blocked <= 0.0 {
        return 1.0;
    }
    let penumbra = clamp(reach_of(map, search.depth / search.blocked, r.w), 1.0, reach);
    let disc = disc_sums(map, r, penumbra);
    return 1.0 - disc.blocked / disc.weight;
}

/// Share of the lamp that `position` on a surface with this normal sees, in [0, 1].
fn visibility(position: vec3f, normal: vec3f) -> f32 {
    let d = position - light.position;
    let z = -d.z;
    if z <= SHADOW_NEAREST {
        return 1.0;
    }
    let w = 1.0 / z;
    for (var i = 0u; i < light.map_count; i++) {
        let map = light.maps[i];
        let at = vec2f(d.x, -d.y) * (w * map.focal) + map.center;
        let side = f32(levels[map.first_level].y);
        if any(at < vec2f(0.0)) || any(at >= vec2f(side)) {
            continue;
        }
        // Plane of the receiver: 1/z is linear over the map. Camera frame of the map.
        let n = vec3f(normal.x, -normal.y, -normal.z);
        let distance = n.x * d.x - n.y * d.y + n.z * z;
        var slope = n.xy / (min(distance, -1e-3) * map.focal);
        // Steeper planes than this see the lamp at a grazing angle.
        let steepest = SHADOW_STEEPEST * w / map.focal;
        let steep = length(slope);
        if steep > steepest {
            slope *= steepest / steep;
        }
        let baked = baked_share(map, w, at, slope);
        if baked.known {
            return baked.share;
        }
        return lit_share(map, Receiver(w + SHADOW_BIAS * w * w, at, slope));
    }
    return 1.0;
}
