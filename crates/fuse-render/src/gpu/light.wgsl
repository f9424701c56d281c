// The scene's light and what was prepared for it; made once, see `upload.rs`.

/// One shadow map.
struct Map {
    /// Texel of the point straight below the lamp.
    @align(16) center: vec2f,
    focal: f32,
    /// Of the lamp, metres.
    radius: f32,
    first_level: u32,
    level_count: u32,
    /// First words of the two layers in `texels`, and texels along their side.
    layers: vec2u,
    layer_side: u32,
    /// Layer texels for each texel of the map.
    layer_scale: f32,
    /// Inverse depth that the largest fixed-point value stands for.
    layer_nearest: f32,
}

struct Light {
    position: vec3f,
    radius: f32,
    intensity: vec3f,
    exposure: f32,
    sky: vec3f,
    box_count: u32,
    ground: vec3f,
    map_count: u32,
    /// Display-linear.
    background: vec3f,
    /// Whether there is a grid of ambient occlusion.
    occlusion: u32,
    /// Of that grid.
    low: vec3f,
    cell: f32,
    high: vec3f,
    size: vec3u,
    maps: array<Map, SHADOW_MAPS>,
}

struct SoftBox {
    direction: vec3f,
    sharpness: f32,
    color: vec3f,
}

@group(0) @binding(11) var<uniform> light: Light;
@group(0) @binding(7) var<storage, read> soft_boxes: array<SoftBox>;
