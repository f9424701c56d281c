// What the stages share. Frames, units and colours are those of the CPU's files.

/// What a camera sees; made in double precision, see `view.rs`.
struct View {
    /// Two rows for each sample: clip-space x and y of a point relative to the eye.
    rows: array<vec4f, 16>,
    /// Viewing direction: its product with a point relative to the eye is the depth.
    forward: vec3f,
    near: f32,
    /// The eye in the world, and what single precision lost of it.
    eye: vec3f,
    width: u32,
    eye_low: vec3f,
    height: u32,
    /// Direction of depth 1 through the middle of the image, and its change by a pixel along x and y.
    ray: vec3f,
    ray_x: vec3f,
    ray_y: vec3f,
}

struct Vertex {
    position: vec3f,
    u: f32,
    normal: vec3f,
    v: f32,
}

/// A run of triangles with one id and one surface.
struct Part {
    base: vec3f,
    id: u32,
    metallic: f32,
    roughness: f32,
    /// Of the texture, in `levels`; none without a texture.
    first_level: u32,
    level_count: u32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> vertices: array<Vertex>;
/// Corners, then the part.
@group(0) @binding(2) var<storage, read> triangles: array<vec4u>;

/// A vertex relative to the eye, metres: exact to its own last bit when near.
fn corner(vertex: u32) -> vec3f {
    return (vertices[vertex].position - view.eye) - view.eye_low;
}
