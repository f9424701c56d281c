// Number of pixels whose key is not 0.

@group(0) @binding(9) var keys: texture_2d_array<u32>;
@group(0) @binding(12) var<storage, read_write> total: atomic<u32>;

@compute @workgroup_size(8, 8)
fn count(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(keys)) {
        return;
    }
    if textureLoad(keys, at.xy, 0, 0).r != 0u {
        atomicAdd(&total, 1u);
    }
}
