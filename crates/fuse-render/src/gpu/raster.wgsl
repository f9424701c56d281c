// Which triangle is nearest at one sample of every pixel, by the rasteriser of the GPU; the instance
// is the sample. Depth is near / z: 1 at the near plane, 0 at infinity.

struct Projected {
    @builtin(position) position: vec4f,
    /// Triangle plus one.
    @location(0) @interpolate(flat) key: u32,
}

@vertex
fn transform(@builtin(vertex_index) index: u32, @builtin(instance_index) sample: u32) -> Projected {
    let p = corner(triangles[index / 3u][index % 3u]);
    let x = dot(view.rows[2u * sample].xyz, p);
    let y = dot(view.rows[2u * sample + 1u].xyz, p);
    return Projected(vec4f(x, y, view.near, dot(view.forward, p)), index / 3u + 1u);
}

@fragment
fn raster(in: Projected) -> @location(0) u32 {
    return in.key;
}
