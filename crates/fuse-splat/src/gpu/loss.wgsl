// (1 − λ) L1 + λ (1 − SSIM) and its gradient; formulas in cpu/loss.rs.
//
// A workgroup owns 16×16 pixels of one channel. `slopes` blurs x, y, x², y², x y in workgroup
// memory and leaves the derivatives of SSIM with respect to B x, B x², B x y; `gradient` blurs
// those; `total` adds up what the workgroups left.

const SIDE: u32 = 16u;
const HALF: u32 = SSIM_WINDOW / 2u;
/// Side of the pixels that a workgroup's windows see.
const WIDE: u32 = SIDE + 2u * HALF;
const THREADS: u32 = 256u;

@group(0) @binding(0) var<uniform> frame: Frame;
/// Red, green, blue planes.
@group(0) @binding(1) var<storage, read> image: array<f32>;
/// The true image, a byte a channel, red lowest.
@group(0) @binding(2) var<storage, read> truth: array<u32>;
/// Three slopes of three channels, planes.
@group(0) @binding(3) var<storage, read_write> slope_planes: array<f32>;
@group(0) @binding(4) var<storage, read_write> gradient_planes: array<f32>;
/// Σ s of each workgroup, then Σ |x − y| of each.
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;
/// The loss of each iteration.
@group(0) @binding(6) var<storage, read_write> losses: array<f32>;

var<workgroup> reduced: array<f32, THREADS>;

/// The sum over the workgroup's threads, in a fixed order; for thread 0.
fn workgroup_sum(value: f32, thread: u32) -> f32 {
    reduced[thread] = value;
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            reduced[thread] += reduced[thread + half];
        }
    }
    return reduced[0];
}

fn inside(p: vec2<i32>) -> bool {
    return all(p >= vec2(0)) && all(p < vec2<i32>(frame.size));
}

fn pixel_index(p: vec2<i32>) -> u32 {
    return u32(p.y) * frame.size.x + u32(p.x);
}

fn true_value(i: u32, channel: u32) -> f32 {
    return f32((truth[i] >> (8u * channel)) & 255u) * (1.0 / 255.0);
}

var<workgroup> patch_x: array<f32, WIDE * WIDE>;
var<workgroup> patch_y: array<f32, WIDE * WIDE>;
/// Blurs along the rows: x, y, x², y², and x y.
var<workgroup> along: array<vec4<f32>, WIDE * SIDE>;
var<workgroup> along_xy: array<f32, WIDE * SIDE>;

/// x, y, x², y² of a pixel of the patch.
fn moments(i: u32) -> vec4<f32> {
    let x = patch_x[i];
    let y = patch_y[i];
    return vec4(x, y, x * x, y * y);
}

fn product(i: u32) -> f32 {
    return patch_x[i] * patch_y[i];
}

// The windows are written out and folded (they are symmetric): as loops, their weights would lie in
// memory. `c` is the centre.

fn window_moments(c: u32) -> vec4<f32> {
    return W0 * moments(c)
        + W1 * (moments(c - 1u) + moments(c + 1u))
        + W2 * (moments(c - 2u) + moments(c + 2u))
        + W3 * (moments(c - 3u) + moments(c + 3u))
        + W4 * (moments(c - 4u) + moments(c + 4u))
        + W5 * (moments(c - 5u) + moments(c + 5u));
}

fn window_product(c: u32) -> f32 {
    return W0 * product(c)
        + W1 * (product(c - 1u) + product(c + 1u))
        + W2 * (product(c - 2u) + product(c + 2u))
        + W3 * (product(c - 3u) + product(c + 3u))
        + W4 * (product(c - 4u) + product(c + 4u))
        + W5 * (product(c - 5u) + product(c + 5u));
}

fn window_along(c: u32) -> vec4<f32> {
    return W0 * along[c]
        + W1 * (along[c - SIDE] + along[c + SIDE])
        + W2 * (along[c - 2u * SIDE] + along[c + 2u * SIDE])
        + W3 * (along[c - 3u * SIDE] + along[c + 3u * SIDE])
        + W4 * (along[c - 4u * SIDE] + along[c + 4u * SIDE])
        + W5 * (along[c - 5u * SIDE] + along[c + 5u * SIDE]);
}

fn window_along_xy(c: u32) -> f32 {
    return W0 * along_xy[c]
        + W1 * (along_xy[c - SIDE] + along_xy[c + SIDE])
        + W2 * (along_xy[c - 2u * SIDE] + along_xy[c + 2u * SIDE])
        + W3 * (along_xy[c - 3u * SIDE] + along_xy[c + 3u * SIDE])
        + W4 * (along_xy[c - 4u * SIDE] + along_xy[c + 4u * SIDE])
        + W5 * (along_xy[c - 5u * SIDE] + along_xy[c + 5u * SIDE]);
}

@compute @workgroup_size(16, 16)
fn slopes(
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let channel = group.z;
    let n = frame.size.x * frame.size.y;
    let corner = vec2<i32>(group.xy * SIDE) - i32(HALF);
    for (var i = thread; i < WIDE * WIDE; i += THREADS) {
        let p = corner + vec2<i32>(vec2(i % WIDE, i / WIDE));
        var x = 0.0;
        var y = 0.0;
        if inside(p) {
            x = image[channel * n + pixel_index(p)];
            y = true_value(pixel_index(p), channel);
        }
        patch_x[i] = x;
        patch_y[i] = y;
    }
    workgroupBarrier();
    for (var i = thread; i < WIDE * SIDE; i += THREADS) {
        let center = i / SIDE * WIDE + i % SIDE + HALF;
        along[i] = window_moments(center);
        along_xy[i] = window_product(center);
    }
    workgroupBarrier();
    let center = (local.y + HALF) * SIDE + local.x;
    let blurred = window_along(center);
    let xy = window_along_xy(center);
    // SSIM and its derivatives with respect to B x, B x² and B xy.
    let mx = blurred.x;
    let my = blurred.y;
    let a1 = 2.0 * mx * my + SSIM_C1;
    let a2 = 2.0 * (xy - mx * my) + SSIM_C2;
    let b1 = mx * mx + my * my + SSIM_C1;
    let b2 = (blurred.z - mx * mx) + (blurred.w - my * my) + SSIM_C2;
    let inverse = 1.0 / (b1 * b2);
    let value = a1 * a2 * inverse;
    let d_xx = -value * b1 * inverse;
    let d_xy = 2.0 * a1 * inverse;
    let direct = 2.0 * (my * a2 - value * mx * b2) * inverse;
    let d_mean = direct - my * d_xy - 2.0 * mx * d_xx;

    let p = vec2<i32>(group.xy * SIDE + local.xy);
    var own = 0.0;
    if inside(p) {
        own = value;
        let at = channel * n + pixel_index(p);
        slope_planes[at] = d_mean;
        slope_planes[3u * n + at] = d_xx;
        slope_planes[6u * n + at] = d_xy;
    }
    let sum = workgroup_sum(own, thread);
    if thread == 0u {
        partials[(channel * groups.y + group.y) * groups.x + group.x] = sum;
    }
}

var<workgroup> slope_patch: array<f32, 3u * WIDE * WIDE>;
var<workgroup> slope_along: array<f32, 3u * WIDE * SIDE>;

fn window_patch(c: u32) -> f32 {
    return W0 * slope_patch[c]
        + W1 * (slope_patch[c - 1u] + slope_patch[c + 1u])
        + W2 * (slope_patch[c - 2u] + slope_patch[c + 2u])
        + W3 * (slope_patch[c - 3u] + slope_patch[c + 3u])
        + W4 * (slope_patch[c - 4u] + slope_patch[c + 4u])
        + W5 * (slope_patch[c - 5u] + slope_patch[c + 5u]);
}

fn window_slope(c: u32) -> f32 {
    return W0 * slope_along[c]
        + W1 * (slope_along[c - SIDE] + slope_along[c + SIDE])
        + W2 * (slope_along[c - 2u * SIDE] + slope_along[c + 2u * SIDE])
        + W3 * (slope_along[c - 3u * SIDE] + slope_along[c + 3u * SIDE])
        + W4 * (slope_along[c - 4u * SIDE] + slope_along[c + 4u * SIDE])
        + W5 * (slope_along[c - 5u * SIDE] + slope_along[c + 5u * SIDE]);
}

@compute @workgroup_size(16, 16)
fn gradient(
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let channel = group.z;
    let n = frame.size.x * frame.size.y;
    let corner = vec2<i32>(group.xy * SIDE) - i32(HALF);
    for (var i = thread; i < WIDE * WIDE; i += THREADS) {
        let p = corner + vec2<i32>(vec2(i % WIDE, i / WIDE));
        for (var s = 0u; s < 3u; s++) {
            var slope = 0.0;
            if inside(p) {
                slope = slope_planes[(3u * s + channel) * n + pixel_index(p)];
            }
            slope_patch[s * WIDE * WIDE + i] = slope;
        }
    }
    workgroupBarrier();
    for (var i = thread; i < WIDE * SIDE; i += THREADS) {
        let center = i / SIDE * WIDE + i % SIDE + HALF;
        for (var s = 0u; s < 3u; s++) {
            slope_along[s * WIDE * SIDE + i] = window_patch(s * WIDE * WIDE + center);
        }
    }
    workgroupBarrier();
    let center = (local.y + HALF) * SIDE + local.x;
    let d_mean = window_slope(center);
    let d_xx = window_slope(WIDE * SIDE + center);
    let d_xy = window_slope(2u * WIDE * SIDE + center);
    let p = vec2<i32>(group.xy * SIDE + local.xy);
    let scale = 1.0 / f32(3u * n);
    var own = 0.0;
    if inside(p) {
        let at = channel * n + pixel_index(p);
        let x = image[at];
        let y = true_value(pixel_index(p), channel);
        own = abs(x - y);
        let ssim = d_mean + 2.0 * x * d_xx + y * d_xy;
        gradient_planes[at] = (1.0 - frame.lambda) * scale * sign(x - y) - frame.lambda * scale * ssim;
    }
    let sum = workgroup_sum(own, thread);
    if thread == 0u {
        let count = groups.x * groups.y * groups.z;
        partials[count + (channel * groups.y + group.y) * groups.x + group.x] = sum;
    }
}

@compute @workgroup_size(256)
fn total(@builtin(local_invocation_index) thread: u32) {
    let groups = (frame.size + SIDE - 1u) / SIDE;
    let count = groups.x * groups.y * 3u;
    var ssim = 0.0;
    var l1 = 0.0;
    for (var i = thread; i < count; i += THREADS) {
        ssim += partials[i];
        l1 += partials[count + i];
    }
    let all_ssim = workgroup_sum(ssim, thread);
    workgroupBarrier();
    let all_l1 = workgroup_sum(l1, thread);
    if thread == 0u {
        let n = f32(3u * frame.size.x * frame.size.y);
        losses[frame.slot] = (1.0 - frame.lambda) * all_l1 / n + frame.lambda * (1.0 - all_ssim / n);
    }
}
