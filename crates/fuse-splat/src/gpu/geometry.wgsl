// What both directions of the projection compute of one Gaussian; formulas in cpu/project.rs.

// Not a uniform, as elsewhere: Mesa's lavapipe compiles a stage anew for every dispatch if a loop ends
// at a uniform (the degree of the harmonics).
@group(0) @binding(0) var<storage, read> frame: Frame;
/// 59 numbers a Gaussian, in blocks of eight.
@group(0) @binding(1) var<storage, read> table: array<f32>;

struct Geometry {
    /// Camera frame; z is 1 where the Gaussian is too near.
    t: vec3<f32>,
    inverse_z: f32,
    /// Clamped tx/tz and ty/tz, and 1 where they were not clamped.
    u: vec2<f32>,
    free: vec2<f32>,
    /// Entries (0,0) = (fx/z), (0,2), (1,1), (1,2) of J.
    j: vec4<f32>,
    /// W R, columns.
    v: mat3x3<f32>,
    /// Rows of J W R and of U = J W R S.
    p0: vec3<f32>,
    p1: vec3<f32>,
    u0: vec3<f32>,
    u1: vec3<f32>,
    scale: vec3<f32>,
    /// Upper triangles of Σ'⁻¹ and of Σ'.
    conic: vec3<f32>,
    covariance: vec3<f32>,
    /// Normalised quaternion w, x, y, z, and the inverse of its length.
    q: vec4<f32>,
    inverse_length: f32,
    /// In front of the near plane, and Σ' positive definite.
    valid: bool,
}

fn rows3(i: u32, row: u32) -> vec3<f32> {
    return vec3(table[place(i, row)], table[place(i, row + 1u)], table[place(i, row + 2u)]);
}

/// `exp`, argument clamped as on the CPU.
fn exp_clamped(x: f32) -> f32 {
    return exp(clamp(x, -87.0, 87.0));
}

/// W v.
fn to_camera(v: vec3<f32>) -> vec3<f32> {
    return vec3(dot(frame.camera[0].xyz, v), dot(frame.camera[1].xyz, v), dot(frame.camera[2].xyz, v));
}

/// Wᵀ v.
fn to_world(v: vec3<f32>) -> vec3<f32> {
    return frame.camera[0].xyz * v.x + frame.camera[1].xyz * v.y + frame.camera[2].xyz * v.z;
}

fn geometry(i: u32) -> Geometry {
    var g: Geometry;
    g.t = to_camera(rows3(i, POSITION)) + vec3(frame.camera[0].w, frame.camera[1].w, frame.camera[2].w);
    let in_front = g.t.z > NEAR;
    g.t.z = select(1.0, g.t.z, in_front);
    g.inverse_z = 1.0 / g.t.z;

    let limit = FOV_MARGIN * vec2<f32>(frame.size) / (2.0 * frame.focal);
    let ratio = g.t.xy * g.inverse_z;
    g.u = clamp(ratio, -limit, limit);
    g.free = select(vec2(0.0), vec2(1.0), (ratio <= limit) & (ratio >= -limit));
    let j = frame.focal * g.inverse_z;
    g.j = vec4(j.x, -j.x * g.u.x, j.y, -j.y * g.u.y);

    let raw = vec4(rows3(i, ROTATION), table[place(i, ROTATION + 3u)]);
    g.inverse_length = 1.0 / sqrt(max(dot(raw, raw), 1e-24));
    g.q = raw * g.inverse_length;
    let w = g.q.x;
    let x = g.q.y;
    let y = g.q.z;
    let z = g.q.w;
    g.v = mat3x3(
        to_camera(vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))),
        to_camera(vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))),
        to_camera(vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))),
    );
    let log_scale = rows3(i, SCALE);
    g.scale = vec3(exp_clamped(log_scale.x), exp_clamped(log_scale.y), exp_clamped(log_scale.z));
    let rows = transpose(g.v);
    g.p0 = g.j.x * rows[0] + g.j.y * rows[2];
    g.p1 = g.j.z * rows[1] + g.j.w * rows[2];
    g.u0 = g.p0 * g.scale;
    g.u1 = g.p1 * g.scale;
    g.covariance = vec3(dot(g.u0, g.u0) + frame.low_pass, dot(g.u0, g.u1), dot(g.u1, g.u1) + frame.low_pass);
    let determinant = g.covariance.x * g.covariance.z - g.covariance.y * g.covariance.y;
    g.valid = in_front && determinant > 0.0;
    let inverse = 1.0 / select(1.0, determinant, g.valid);
    g.conic = vec3(g.covariance.z, -g.covariance.y, g.covariance.x) * inverse;
    return g;
}

/// Unit direction from the camera to the Gaussian, and the inverse distance.
fn direction(i: u32) -> vec4<f32> {
    let d = rows3(i, POSITION) - frame.center;
    let inverse = 1.0 / sqrt(max(dot(d, d), 1e-24));
    return vec4(d * inverse, inverse);
}

/// Number of harmonics in use.
fn sh_count() -> u32 {
    return (frame.degree + 1u) * (frame.degree + 1u);
}

/// ½ + Σₖ cₖ Yₖ, not yet clamped at zero.
fn colors(i: u32, basis: array<f32, 16>) -> vec3<f32> {
    var y = basis;
    var sum = rows3(i, DC) * y[0] + 0.5;
    for (var k = 1u; k < sh_count(); k++) {
        let row = REST + k - 1u;
        let c = vec3(
            table[place(i, row)],
            table[place(i, row + REST_PER_CHANNEL)],
            table[place(i, row + 2u * REST_PER_CHANNEL)],
        );
        sum += c * y[k];
    }
    return sum;
}
