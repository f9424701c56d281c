// Stable radix sort of (key, value), four bits a pass; twin of cpu/sort.rs.
//
// A pass: `count` makes a histogram of each block of 1024 keys, digit-major; scan.wgsl turns it
// into first places; `scatter` ranks the keys within their block and moves them. By depth first,
// with ties in order of index; later the pairs by tile, which keeps the order of depth.

const RADIX: u32 = 16u;
const THREADS: u32 = 256u;
/// Keys of a thread, neighbours in the list.
const EACH: u32 = 4u;
const BLOCK: u32 = THREADS * EACH;
/// Words that hold sixteen counters of 16 bits.
const WORDS: u32 = 8u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
/// Lowest bit of the digit.
@group(0) @binding(2) var<uniform> shift: vec4<u32>;
@group(0) @binding(3) var<storage, read_write> keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> histogram: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> values_out: array<u32>;

/// Bits of positive floats are ordered as the floats are; what is not visible comes last.
@compute @workgroup_size(256)
fn depth_keys(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.gaussians {
        return;
    }
    let depth = splats[id.x].depth;
    keys[id.x] = select(0xffffffffu, bitcast<u32>(depth), depth > 0.0);
    values[id.x] = id.x;
}

fn digit(key: u32) -> u32 {
    return (key >> shift.x) % RADIX;
}

var<workgroup> counters: array<atomic<u32>, RADIX>;

@compute @workgroup_size(256)
fn count(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(num_workgroups) blocks: vec3<u32>,
) {
    if thread < RADIX {
        atomicStore(&counters[thread], 0u);
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        let i = block.x * BLOCK + k * THREADS + thread;
        if i < arrayLength(&keys) {
            atomicAdd(&counters[digit(keys[i])], 1u);
        }
    }
    workgroupBarrier();
    if thread < RADIX {
        histogram[thread * blocks.x + block.x] = atomicLoad(&counters[thread]);
    }
}

/// Two counters a word; a column a thread.
var<workgroup> ranks: array<array<u32, THREADS>, WORDS>;

@compute @workgroup_size(256)
fn scatter(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(num_workgroups) blocks: vec3<u32>,
) {
    let first = block.x * BLOCK + thread * EACH;
    let own = min(EACH, max(arrayLength(&keys), first) - first);
    var counts: array<u32, WORDS>;
    for (var k = 0u; k < own; k++) {
        let d = digit(keys[first + k]);
        counts[d / 2u] += 1u << (16u * (d % 2u));
    }
    for (var w = 0u; w < WORDS; w++) {
        ranks[w][thread] = counts[w];
    }
    for (var step = 1u; step < THREADS; step *= 2u) {
        workgroupBarrier();
        var left: array<u32, WORDS>;
        if thread >= step {
            for (var w = 0u; w < WORDS; w++) {
                left[w] = ranks[w][thread - step];
            }
        }
        workgroupBarrier();
        for (var w = 0u; w < WORDS; w++) {
            ranks[w][thread] += left[w];
        }
    }
    workgroupBarrier();
    for (var w = 0u; w < WORDS; w++) {
        counts[w] = ranks[w][thread] - counts[w];
    }
    for (var k = 0u; k < own; k++) {
        let key = keys[first + k];
        let d = digit(key);
        let bits = 16u * (d % 2u);
        let to = histogram[d * blocks.x + block.x] + ((counts[d / 2u] >> bits) & 0xffffu);
        counts[d / 2u] += 1u << bits;
        keys_out[to] = key;
        values_out[to] = values[first + k];
    }
}
