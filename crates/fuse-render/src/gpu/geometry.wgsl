// Where the ray through a pixel meets a triangle. Everything is relative to the eye or to a corner,
// so that single precision suffices.

struct Triangle {
    /// Corners relative to the eye.
    p: array<vec3f, 3>,
    /// (p1 - p0) × (p2 - p0), not unit length.
    normal: vec3f,
}

/// A surface point seen through a pixel.
struct Point {
    /// In the world, metres.
    position: vec3f,
    /// Unit, towards the viewer's side.
    normal: vec3f,
    /// Of the triangle, towards the viewer's side.
    facet: vec3f,
    /// Unit, towards the eye.
    view: vec3f,
    uv: vec2f,
    /// Change of `uv` by a pixel along x and y.
    du: vec2f,
    dv: vec2f,
}

fn load(corners: vec3u) -> Triangle {
    var t: Triangle;
    t.p = array(corner(corners.x), corner(corners.y), corner(corners.z));
    t.normal = cross(t.p[1] - t.p[0], t.p[2] - t.p[0]);
    return t;
}

/// Direction of depth 1 through image coordinates `at`.
fn ray(at: vec2f) -> vec3f {
    let offset = at - 0.5 * vec2f(f32(view.width), f32(view.height));
    return view.ray + view.ray_x * offset.x + view.ray_y * offset.y;
}

/// Depth at which `direction` meets the triangle's plane, within the triangle's own depths: a sample
/// that rounding puts beside a triangle seen edge-on must not leave it far behind.
fn depth_along(t: Triangle, direction: vec3f) -> f32 {
    let z = vec3f(dot(view.forward, t.p[0]), dot(view.forward, t.p[1]), dot(view.forward, t.p[2]));
    let low = max(min(z.x, min(z.y, z.z)), view.near);
    let high = max(z.x, max(z.y, z.z));
    let slope = dot(t.normal, direction);
    if slope == 0.0 {
        return high;
    }
    return clamp(dot(t.normal, t.p[0]) / slope, low, high);
}

fn normalize_or(v: vec3f, other: vec3f) -> vec3f {
    let squared = dot(v, v);
    return select(other, v * inverseSqrt(max(squared, 1e-38)), squared > 1e-38);
}

fn point(corners: vec3u, at: vec2f) -> Point {
    let t = load(corners);
    let direction = ray(at);
    let z = depth_along(t, direction);
    let hit = direction * z;
    let e1 = t.p[1] - t.p[0];
    let e2 = t.p[2] - t.p[0];
    // Gradients of the second and third barycentric weight over the plane.
    let scale = 1.0 / max(dot(t.normal, t.normal), 1e-38);
    let g1 = cross(e2, t.normal) * scale;
    let g2 = cross(t.normal, e1) * scale;
    let from_first = hit - t.p[0];
    let w = vec2f(dot(from_first, g1), dot(from_first, g2));
    let v0 = vertices[corners.x];
    let v1 = vertices[corners.y];
    let v2 = vertices[corners.z];
    let uv0 = vec2f(v0.u, v0.v);
    let uv1 = vec2f(v1.u, v1.v) - uv0;
    let uv2 = vec2f(v2.u, v2.v) - uv0;

    let facet = normalize_or(t.normal, vec3f(0.0, 0.0, 1.0));
    // Back faces of double-sided surfaces are lit like front faces.
    let side = select(1.0, -1.0, dot(facet, hit) > 0.0);
    let normal = v0.normal * (1.0 - w.x - w.y) + v1.normal * w.x + v2.normal * w.y;

    // The hit moves within the plane when the ray turns.
    let along = dot(t.normal, direction);
    let turn = select(0.0, 1.0 / along, along != 0.0);
    let dx = z * (view.ray_x - direction * (dot(t.normal, view.ray_x) * turn));
    let dy = z * (view.ray_y - direction * (dot(t.normal, view.ray_y) * turn));

    var p: Point;
    p.position = view.eye + (hit + view.eye_low);
    p.normal = normalize_or(normal, facet) * side;
    p.facet = facet * side;
    p.view = normalize_or(-hit, p.facet);
    p.uv = uv0 + uv1 * w.x + uv2 * w.y;
    p.du = uv1 * dot(dx, g1) + uv2 * dot(dx, g2);
    p.dv = uv1 * dot(dy, g1) + uv2 * dot(dy, g2);
    return p;
}
