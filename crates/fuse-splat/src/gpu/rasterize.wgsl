// Blending, nearest first → colour, transmittance, depth; twin of cpu/rasterize.rs.

/// Red, green, blue planes.
@group(0) @binding(5) var<storage, read_write> color: array<f32>;
@group(0) @binding(6) var<storage, read_write> transmittance: array<f32>;
/// Σ wᵢ zᵢ, metres.
@group(0) @binding(7) var<storage, read_write> depth: array<f32>;
/// How many of its tile's pairs each block drew before it was finished.
@group(0) @binding(8) var<storage, read_write> drawn: array<u32>;

/// State of a row of four pixels.
struct Row {
    transmittance: vec4<f32>,
    red: vec4<f32>,
    green: vec4<f32>,
    blue: vec4<f32>,
    depth: vec4<f32>,
}

fn blend(row: Row, s: Drawn, dx: vec4<f32>, dy: f32) -> Row {
    let alpha = min(raw_alpha(exponent(s, dx, dy)), vec4(ALPHA_MAX));
    let w = alpha * row.transmittance;
    return Row(
        row.transmittance - w,
        row.red + w * s.red,
        row.green + w * s.green,
        row.blue + w * s.blue,
        row.depth + w * s.depth,
    );
}

fn store(row: Row, x: u32, y: u32) {
    let n = frame.size.x * frame.size.y;
    if y >= frame.size.y {
        return;
    }
    for (var k = 0u; k < BLOCK_WIDTH; k++) {
        if x + k < frame.size.x {
            let i = y * frame.size.x + x + k;
            let t = row.transmittance[k];
            color[i] = row.red[k] + t * frame.background.r;
            color[n + i] = row.green[k] + t * frame.background.g;
            color[2u * n + i] = row.blue[k] + t * frame.background.b;
            transmittance[i] = t;
            depth[i] = row.depth[k];
        }
    }
}

fn finished(row: Row) -> bool {
    return all(row.transmittance < vec4(TRANSMITTANCE_MIN));
}

var<workgroup> blocks_alive: atomic<u32>;

@compute @workgroup_size(64)
fn rasterize(@builtin(local_invocation_index) block: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let tile = group.y * frame.tiles.x + group.x;
    let begin = offsets[tile];
    let end = offsets[tile + 1u];
    let origin = group.xy * vec2(TILE_WIDTH, TILE_HEIGHT);
    let corner = block_corner(block);
    let x = vec4(0.5, 1.5, 2.5, 3.5) + f32(corner.x);
    let y = f32(corner.y) + 0.5;
    let nothing = vec4(0.0);
    var upper = Row(vec4(1.0), nothing, nothing, nothing, nothing);
    var lower = upper;
    var alive = true;
    var count = end - begin;
    for (var first = begin; first < end; first += BATCH) {
        if block == 0u {
            atomicStore(&blocks_alive, 0u);
        }
        workgroupBarrier();
        if alive {
            atomicStore(&blocks_alive, 1u);
        }
        if first + block < end {
            load_pair(first + block, block, vec2<f32>(origin));
        }
        // Nothing is left to draw once no block is alive.
        if workgroupUniformLoad(&blocks_alive) == 0u {
            break;
        }
        let last = min(BATCH, end - first);
        for (var k = 0u; k < last && alive; k++) {
            let drawn_before = first - begin + k;
            if drawn_before % LOOK == 0u && drawn_before > 0u && finished(upper) && finished(lower) {
                alive = false;
                count = drawn_before;
                break;
            }
            if touches(k, block) {
                let s = batch[k];
                upper = blend(upper, s, x - s.mean.x, y - s.mean.y);
                lower = blend(lower, s, x - s.mean.x, y + 1.0 - s.mean.y);
            }
        }
        workgroupBarrier();
    }
    drawn[tile * TILE_BLOCKS + block] = count;
    let at = origin + corner;
    store(upper, at.x, at.y);
    store(lower, at.x, at.y + 1u);
}
