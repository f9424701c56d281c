// What both directions of the blending share: a workgroup owns a tile, a thread one of its 64
// blocks of 4×2 pixels, a row of the block in each vec4. Batches of 64 splats lie in workgroup
// memory.

const BATCH: u32 = TILE_BLOCKS;
/// Splats between two looks at whether a block is finished, as on the CPU.
const LOOK: u32 = 8u;
const TILE_BLOCK_COLUMNS: u32 = TILE_WIDTH / BLOCK_WIDTH;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
/// Pairs by tile, then by depth.
@group(0) @binding(2) var<storage, read> sorted: array<u32>;
@group(0) @binding(3) var<storage, read> pairs: array<Pair>;
@group(0) @binding(4) var<storage, read> offsets: array<u32>;

/// What the blending needs of a splat; the mean relative to the tile's corner.
struct Drawn {
    mean: vec2<f32>,
    a: f32,
    b: f32,
    c: f32,
    log2_opacity: f32,
    red: f32,
    green: f32,
    blue: f32,
    depth: f32,
    mask: array<u32, 2>,
}

var<workgroup> batch: array<Drawn, BATCH>;

/// Loads pair `index` of the sorted list into place `slot` of the batch.
fn load_pair(index: u32, slot: u32, origin: vec2<f32>) {
    let pair = pairs[sorted[index]];
    let s = splats[pair.gaussian];
    batch[slot] = Drawn(
        s.mean - origin, s.a, s.b, s.c, s.log2_opacity, s.red, s.green, s.blue, s.depth, pair.mask,
    );
}

fn touches(slot: u32, block: u32) -> bool {
    return ((batch[slot].mask[block / 32u] >> (block % 32u)) & 1u) == 1u;
}

/// Corner of a block, relative to the tile's.
fn block_corner(block: u32) -> vec2<u32> {
    return vec2(block % TILE_BLOCK_COLUMNS * BLOCK_WIDTH, block / TILE_BLOCK_COLUMNS * BLOCK_HEIGHT);
}

/// Exponent of α at the pixels of a row of a block.
fn exponent(s: Drawn, dx: vec4<f32>, dy: f32) -> vec4<f32> {
    return (s.a * dx + s.b * dy) * dx + (s.c * dy * dy + s.log2_opacity);
}

/// 2^p where it is at least 1/255, else 0; not yet clamped.
fn raw_alpha(p: vec4<f32>) -> vec4<f32> {
    return select(vec4(0.0), exp2(p), p >= vec4(LOG2_ALPHA_MIN));
}
