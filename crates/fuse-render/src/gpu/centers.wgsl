// From the nearest triangles of a pixel's samples to its colour, depth and id; twin of
// `Renderer::pixel` and `Renderer::center`.

@group(0) @binding(3) var<storage, read> parts: array<Part>;
/// Planes of the image: packed colour, depth (its bits), id.
@group(0) @binding(8) var<storage, read_write> image: array<u32>;
/// Triangle plus one at a sample (a layer each), 0 where there is none.
@group(0) @binding(9) var keys: texture_2d_array<u32>;

/// Depth and id at the pixel centre.
fn center(at: vec2u, key: u32) {
    let pixels = view.width * view.height;
    let index = at.y * view.width + at.x;
    if key == 0u {
        image[pixels + index] = 0u;
        image[2u * pixels + index] = 0u;
        return;
    }
    let triangle = triangles[key - 1u];
    let depth = depth_along(load(triangle.xyz), ray(vec2f(at) + 0.5));
    image[pixels + index] = bitcast<u32>(depth);
    image[2u * pixels + index] = parts[triangle.w].id;
}

@compute @workgroup_size(8, 8)
fn centers(@builtin(global_invocation_id) at: vec3u) {
    if at.x < view.width && at.y < view.height {
        center(at.xy, textureLoad(keys, at.xy, 0, 0).r);
    }
}
