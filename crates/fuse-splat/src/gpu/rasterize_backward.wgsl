// Gradient of the blending, front to back; twin of cpu/rasterize_backward.rs.
//
// A thread adds up its block's pixels for four pairs, then one thread a sum adds up the 64 blocks:
// every pair has its own place for nine sums, nothing is added atomically and the order of
// summation is fixed.

@group(0) @binding(5) var<storage, read> drawn: array<u32>;
/// The drawn image and the loss's gradient with respect to it, three planes each.
@group(0) @binding(6) var<storage, read> color: array<f32>;
@group(0) @binding(7) var<storage, read> gradient: array<f32>;
/// Nine sums a pair, in the unsorted order of the pairs: those of a Gaussian are neighbours.
@group(0) @binding(8) var<storage, read_write> pair_gradients: array<f32>;

const SUMS: u32 = 9u;
/// Pairs between two barriers.
const GROUP: u32 = 4u;
/// One more than there are blocks, so that threads that add up rows meet different banks.
const STRIDE: u32 = TILE_BLOCKS + 1u;

var<workgroup> sums: array<f32, GROUP * SUMS * STRIDE>;

/// State of a row of four pixels: T, R (see cpu/rasterize_backward.rs) and G.
struct Row {
    transmittance: vec4<f32>,
    remaining: vec4<f32>,
    red: vec4<f32>,
    green: vec4<f32>,
    blue: vec4<f32>,
}

/// Pixels outside the image have no gradient.
fn load_row(x: u32, y: u32) -> Row {
    let n = frame.size.x * frame.size.y;
    var row = Row(vec4(1.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    for (var k = 0u; k < BLOCK_WIDTH; k++) {
        if x + k < frame.size.x && y < frame.size.y {
            let i = y * frame.size.x + x + k;
            let g = vec3(gradient[i], gradient[n + i], gradient[2u * n + i]);
            row.red[k] = g.r;
            row.green[k] = g.g;
            row.blue[k] = g.b;
            row.remaining[k] = dot(g, vec3(color[i], color[n + i], color[2u * n + i]));
        }
    }
    return row;
}

fn total(v: vec4<f32>) -> f32 {
    return (v.x + v.y) + (v.z + v.w);
}

/// Adds the row's part of the nine sums to the thread's column and moves the row past the splat.
fn add_row(row: ptr<function, Row>, s: Drawn, dx: vec4<f32>, dy: f32, acc: ptr<function, array<f32, SUMS>>) {
    let raw = raw_alpha(exponent(s, dx, dy));
    let alpha = min(raw, vec4(ALPHA_MAX));
    let w = alpha * (*row).transmittance;
    (*row).transmittance -= w;
    let u = w * (s.red * (*row).red + s.green * (*row).green + s.blue * (*row).blue);
    (*row).remaining -= u;
    // Where α is clamped it does not depend on the exponent; where it is 0, so are u and g.
    let g = select(vec4(0.0), u - (*row).remaining * alpha / (1.0 - alpha), raw <= vec4(ALPHA_MAX));
    let gx = g * dx;
    (*acc)[0] += total(w * (*row).red);
    (*acc)[1] += total(w * (*row).green);
    (*acc)[2] += total(w * (*row).blue);
    let sum = total(g);
    let sum_x = total(gx);
    (*acc)[3] += sum;
    (*acc)[4] += sum_x;
    (*acc)[5] += sum * dy;
    (*acc)[6] += total(gx * dx);
    (*acc)[7] += sum_x * dy;
    (*acc)[8] += sum * dy * dy;
}

@compute @workgroup_size(64)
fn rasterize_backward(@builtin(local_invocation_index) block: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let tile = group.y * frame.tiles.x + group.x;
    let begin = offsets[tile];
    let end = offsets[tile + 1u];
    let count = drawn[tile * TILE_BLOCKS + block];
    let origin = group.xy * vec2(TILE_WIDTH, TILE_HEIGHT);
    let corner = block_corner(block);
    let x = vec4(0.5, 1.5, 2.5, 3.5) + f32(corner.x);
    let y = f32(corner.y) + 0.5;
    let at = origin + corner;
    var upper = load_row(at.x, at.y);
    var lower = load_row(at.x, at.y + 1u);
    for (var first = begin; first < end; first += BATCH) {
        workgroupBarrier();
        if first + block < end {
            load_pair(first + block, block, vec2<f32>(origin));
        }
        workgroupBarrier();
        let last = min(BATCH, end - first);
        for (var k = 0u; k < last; k += GROUP) {
            for (var j = 0u; j < GROUP; j++) {
                var acc: array<f32, SUMS>;
                if k + j < last && first - begin + k + j < count && touches(k + j, block) {
                    let s = batch[k + j];
                    add_row(&upper, s, x - s.mean.x, y - s.mean.y, &acc);
                    add_row(&lower, s, x - s.mean.x, y + 1.0 - s.mean.y, &acc);
                }
                for (var c = 0u; c < SUMS; c++) {
                    sums[(j * SUMS + c) * STRIDE + block] = acc[c];
                }
            }
            workgroupBarrier();
            let pair = k + block / SUMS;
            if block < GROUP * SUMS && pair < last {
                var sum = 0.0;
                for (var b = 0u; b < TILE_BLOCKS; b++) {
                    sum += sums[block * STRIDE + b];
                }
                pair_gradients[sorted[first + pair] * SUMS + block % SUMS] = sum;
            }
            workgroupBarrier();
        }
    }
}
