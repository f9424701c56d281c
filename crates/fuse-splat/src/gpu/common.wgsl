// What the stages share. Constants (NEAR, TILE_WIDTH, …) come from constants.rs, see shaders.rs.

/// A view and the settings of one iteration; twin of `View` in stages.rs.
struct Frame {
    /// Rows of camera-from-world, the translation last.
    camera: array<vec4<f32>, 3>,
    /// Camera centre in the world.
    center: vec3<f32>,
    degree: u32,
    background: vec3<f32>,
    lambda: f32,
    focal: vec2<f32>,
    principal: vec2<f32>,
    /// Pixels.
    size: vec2<u32>,
    tiles: vec2<u32>,
    gaussians: u32,
    pairs: u32,
    /// Where the loss of this iteration goes.
    slot: u32,
    /// Added to the projected covariance's diagonal, square pixels.
    low_pass: f32,
}

/// A Gaussian on the image plane, 64 bytes; see `Splat` in stages.rs.
struct Splat {
    mean: vec2<f32>,
    a: f32,
    b: f32,
    c: f32,
    log2_opacity: f32,
    red: f32,
    green: f32,
    blue: f32,
    depth: f32,
    extent: vec2<f32>,
    radius: f32,
    padding_0: f32,
    padding_1: f32,
    padding_2: f32,
}

/// One Gaussian on one tile; 16 bytes. Bit `b` of the mask, low word first, is block `b`.
struct Pair {
    gaussian: u32,
    mask: array<u32, 2>,
    tile: u32,
}

/// Place of row `row` of Gaussian `i` in a table of blocks of eight (table.rs).
fn place(i: u32, row: u32) -> u32 {
    return (i / LANES) * (LANES * PARAMETERS) + row * LANES + i % LANES;
}
