// Which tiles, and which blocks of a tile, does each splat touch? Twin of cpu/intersect.rs.
//
// A thread owns the splat of one rank in order of depth: `count` counts its tiles, scan.wgsl makes
// places of the counts, `emit` writes the pairs there. Sorted stably by tile (sort.wgsl), they are
// in order of depth within a tile; `ranges` finds where each tile begins.

const SLACK: f32 = 1e-2;
const BLOCK_COLUMNS: i32 = i32(TILE_WIDTH / BLOCK_WIDTH);

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
/// Gaussians by depth.
@group(0) @binding(2) var<storage, read> order: array<u32>;
/// Tiles of each rank, later the first pair; one more at the end.
@group(0) @binding(3) var<storage, read_write> places: array<u32>;
@group(0) @binding(4) var<storage, read_write> tile_of: array<u32>;
@group(0) @binding(5) var<storage, read_write> index_of: array<u32>;
@group(0) @binding(6) var<storage, read_write> pairs: array<Pair>;
/// First pair of each Gaussian, and one past its last.
@group(0) @binding(7) var<storage, read_write> spans: array<vec2<u32>>;
/// First sorted pair of each tile, and one past the last.
@group(0) @binding(8) var<storage, read_write> offsets: array<u32>;

/// Columns of blocks (across the image) that a splat touches on the eight rows of blocks of a tile
/// row: `low[r]..high[r]`, rows 0–3 and 4–7.
struct Spans {
    low: array<vec4<i32>, 2>,
    high: array<vec4<i32>, 2>,
}

/// On the pixel rows at height dy: dx ∈ −b dy/2a ± √((b dy/2a)² − (c dy² + r)/a).
fn block_spans(splat: Splat, top: f32) -> Spans {
    let inverse_a = -1.0 / splat.a;
    let reach = splat.log2_opacity - LOG2_ALPHA_MIN;
    let columns = i32((frame.size.x + BLOCK_WIDTH - 1u) / BLOCK_WIDTH);
    var spans: Spans;
    for (var h = 0u; h < 2u; h++) {
        var low = vec4(1e9);
        var high = vec4(-1e9);
        for (var row = 0u; row < 2u; row++) {
            let dy = vec4(0.5, 2.5, 4.5, 6.5) + (f32(8u * h + row) + (top - splat.mean.y));
            let middle = dy * (0.5 * splat.b * inverse_a);
            let squared = middle * middle + (dy * dy * splat.c + reach) * inverse_a;
            let hit = squared >= vec4(0.0);
            let half = sqrt(max(squared, vec4(0.0))) + SLACK;
            let center = middle + splat.mean.x;
            low = min(low, select(vec4(1e9), center - half, hit));
            high = max(high, select(vec4(-1e9), center + half, hit));
        }
        // Rounded as in cpu/intersect.rs. Clamped again as integers: what NaN becomes is not defined.
        let scale = 1.0 / f32(BLOCK_WIDTH);
        let from_column = vec4<i32>(clamp((low + 0.499) * scale, vec4(0.0), vec4(f32(columns))));
        let to_column = vec4<i32>(clamp((high + (f32(BLOCK_WIDTH) - 0.5)) * scale, vec4(0.0), vec4(f32(columns))));
        spans.low[h] = clamp(from_column, vec4(0), vec4(columns));
        spans.high[h] = clamp(to_column, vec4(0), vec4(columns));
    }
    return spans;
}

/// The blocks of four rows of the tile whose first column of blocks is `first`, a byte a row.
fn mask_word(low: vec4<i32>, high: vec4<i32>, first: i32) -> u32 {
    let from_column = vec4<u32>(clamp(low - first, vec4(0), vec4(BLOCK_COLUMNS)));
    let to_column = vec4<u32>(clamp(high - first, vec4(0), vec4(BLOCK_COLUMNS)));
    let bits = ((vec4(1u) << to_column) - 1u) & ~((vec4(1u) << from_column) - 1u);
    return bits.x | (bits.y << 8u) | (bits.z << 16u) | (bits.w << 24u);
}

fn least(v: vec4<i32>) -> i32 {
    return min(min(v.x, v.y), min(v.z, v.w));
}

fn greatest(v: vec4<i32>) -> i32 {
    return max(max(v.x, v.y), max(v.z, v.w));
}

fn tile_row(y: f32) -> u32 {
    return min(u32(max(y, 0.0) / f32(TILE_HEIGHT)), frame.tiles.y - 1u);
}

/// Tiles that a splat touches, row by row, and their number. If asked to, writes the pairs from place
/// `first` on, but not beyond `end`.
fn touch(gaussian: u32, writes: bool, first: u32, end: u32) -> u32 {
    let splat = splats[gaussian];
    var at = first;
    if !(splat.depth > 0.0) {
        return 0u;
    }
    let last = tile_row(splat.mean.y + splat.extent.y + SLACK);
    for (var y = tile_row(splat.mean.y - splat.extent.y - SLACK); y <= last; y++) {
        let spans = block_spans(splat, f32(y * TILE_HEIGHT));
        let left = min(least(spans.low[0]), least(spans.low[1]));
        let right = max(greatest(spans.high[0]), greatest(spans.high[1]));
        if left >= right {
            continue;
        }
        for (var x = left / BLOCK_COLUMNS; x <= (right - 1) / BLOCK_COLUMNS; x++) {
            let low = mask_word(spans.low[0], spans.high[0], x * BLOCK_COLUMNS);
            let high = mask_word(spans.low[1], spans.high[1], x * BLOCK_COLUMNS);
            if (low | high) == 0u {
                continue;
            }
            if writes && at < end {
                write(at, Pair(gaussian, array(low, high), y * frame.tiles.x + u32(x)));
            }
            at++;
        }
    }
    return at - first;
}

fn write(at: u32, pair: Pair) {
    tile_of[at] = pair.tile;
    index_of[at] = at;
    pairs[at] = pair;
}

@compute @workgroup_size(256)
fn count(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < frame.gaussians {
        places[id.x] = touch(order[id.x], false, 0u, 0u);
    }
}

@compute @workgroup_size(256)
fn emit(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.gaussians {
        return;
    }
    let gaussian = order[id.x];
    let first = places[id.x];
    let end = places[id.x + 1u];
    let written = touch(gaussian, true, first, end);
    // A compiler may round this entry point otherwise than `count`: what was counted but is not
    // touched becomes a pair without blocks.
    for (var at = first + written; at < end; at++) {
        write(at, Pair(gaussian, array(0u, 0u), 0u));
    }
    spans[gaussian] = vec2(first, end);
}

@compute @workgroup_size(256)
fn ranges(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= frame.pairs {
        return;
    }
    let tile = tile_of[i];
    var begin = 0u;
    if i > 0u {
        begin = tile_of[i - 1u] + 1u;
    }
    for (var t = begin; t <= tile; t++) {
        offsets[t] = i;
    }
    if i + 1u == frame.pairs {
        for (var t = tile + 1u; t <= frame.tiles.x * frame.tiles.y; t++) {
            offsets[t] = frame.pairs;
        }
    }
}
