// Gradient of the projection, back to the 59 parameters; twin of cpu/project_backward.rs.
//
// A thread owns a Gaussian: it adds up its pairs in their fixed order, applies the chain rule of
// geometry.wgsl backwards and adds to the statistics of densification.

@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> spans: array<vec2<u32>>;
/// Nine sums a pair.
@group(0) @binding(4) var<storage, read> pair_gradients: array<f32>;
/// As the table.
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;
/// Sum of gradients, count and largest radius, one list after the other; see `Density`.
@group(0) @binding(6) var<storage, read_write> density: array<f32>;

const SUMS: u32 = 9u;

fn set_rows3(i: u32, row: u32, v: vec3<f32>) {
    gradient[place(i, row)] = v.x;
    gradient[place(i, row + 1u)] = v.y;
    gradient[place(i, row + 2u)] = v.z;
}

/// Fills the harmonics' rows; returns the derivative with respect to the position through the
/// direction.
fn color_gradient(i: u32, d_color: vec3<f32>) -> vec3<f32> {
    let d = direction(i);
    var basis = sh_basis(d.xyz);
    // Below zero the colour is clamped.
    let own = select(vec3(0.0), d_color, colors(i, basis) > vec3(0.0));
    set_rows3(i, DC, own * basis[0]);
    var weights: array<f32, 16>;
    for (var k = 1u; k < 16u; k++) {
        let used = k < sh_count();
        for (var c = 0u; c < 3u; c++) {
            let at = place(i, REST + c * REST_PER_CHANNEL + k - 1u);
            gradient[at] = select(0.0, own[c] * basis[k], used);
            weights[k] += select(0.0, table[at] * own[c], used);
        }
    }
    let slope = sh_direction_gradient(d.xyz, weights);
    // d = v/|v|: dL/dv = (dL/dd − d (d · dL/dd)) / |v|.
    return (slope - d.xyz * dot(d.xyz, slope)) * d.w;
}

/// Derivative of the rotation matrix (its columns' derivatives given) with respect to the
/// quaternion, and of its normalisation.
fn quaternion_gradient(g: Geometry, r: mat3x3<f32>) -> vec4<f32> {
    let w = g.q.x;
    let x = g.q.y;
    let y = g.q.z;
    let z = g.q.w;
    // r[j][i] is row i, column j.
    let d = vec4(
        2.0 * (z * (r[0][1] - r[1][0]) + y * (r[2][0] - r[0][2]) + x * (r[1][2] - r[2][1])),
        2.0 * (y * (r[1][0] + r[0][1]) + z * (r[2][0] + r[0][2]) + w * (r[1][2] - r[2][1]))
            - 4.0 * x * (r[1][1] + r[2][2]),
        2.0 * (x * (r[1][0] + r[0][1]) + z * (r[2][1] + r[1][2]) + w * (r[2][0] - r[0][2]))
            - 4.0 * y * (r[0][0] + r[2][2]),
        2.0 * (x * (r[2][0] + r[0][2]) + y * (r[2][1] + r[1][2]) + w * (r[0][1] - r[1][0]))
            - 4.0 * z * (r[0][0] + r[1][1]),
    );
    return (d - g.q * dot(g.q, d)) * g.inverse_length;
}

/// Fills the rows of scale and rotation; returns the derivative with respect to t.
fn geometry_gradient(i: u32, g: Geometry, conic: vec3<f32>, mean: vec2<f32>) -> vec3<f32> {
    let ka = g.conic.x;
    let kb = g.conic.y;
    let kc = g.conic.z;
    // K = Σ'⁻¹: dL/dΣ' = −K (dL/dK) K.
    let ca = -(ka * ka * conic.x + ka * kb * conic.y + kb * kb * conic.z);
    let cb = -(2.0 * kb * (ka * conic.x + kc * conic.z) + (ka * kc + kb * kb) * conic.y);
    let cc = -(kb * kb * conic.x + kb * kc * conic.y + kc * kc * conic.z);
    // Σ' = U Uᵀ.
    let u0 = 2.0 * ca * g.u0 + cb * g.u1;
    let u1 = cb * g.u0 + 2.0 * cc * g.u1;
    // U = P S.
    set_rows3(i, SCALE, (u0 * g.p0 + u1 * g.p1) * g.scale);
    let p0 = u0 * g.scale;
    let p1 = u1 * g.scale;
    // P = J V.
    let rows = transpose(g.v);
    let dj = vec4(dot(p0, rows[0]), dot(p0, rows[2]), dot(p1, rows[1]), dot(p1, rows[2]));
    // V = W R.
    let along = g.j.y * p0 + g.j.w * p1;
    let r = mat3x3(
        to_world(vec3(g.j.x * p0.x, g.j.z * p1.x, along.x)),
        to_world(vec3(g.j.x * p0.y, g.j.z * p1.y, along.y)),
        to_world(vec3(g.j.x * p0.z, g.j.z * p1.z, along.z)),
    );
    let q = quaternion_gradient(g, r);
    set_rows3(i, ROTATION, q.xyz);
    gradient[place(i, ROTATION + 3u)] = q.w;

    // Jᵢᵢ = f/z, Jᵢ₂ = −f u/z, u = t/z unless clamped.
    let f = frame.focal * g.inverse_z;
    let u = -f * dj.yw * g.free + frame.focal * mean;
    let z = (f * (g.u * dj.yw - dj.xz) - u * g.t.xy * g.inverse_z) * g.inverse_z;
    return vec3(u * g.inverse_z, z.x + z.y);
}

@compute @workgroup_size(256)
fn project_backward(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= frame.gaussians {
        return;
    }
    if !(splats[i].depth > 0.0) {
        for (var row = 0u; row < PARAMETERS; row++) {
            gradient[place(i, row)] = 0.0;
        }
        return;
    }
    var sums: array<f32, SUMS>;
    for (var pair = spans[i].x; pair < spans[i].y; pair++) {
        for (var c = 0u; c < SUMS; c++) {
            sums[c] += pair_gradients[pair * SUMS + c];
        }
    }
    let g = geometry(i);
    // α = 2^p: dL/dp = ln 2 · α dL/dα; −½ log2 e · ln 2 = −½.
    let mean = vec2(g.conic.x * sums[4] + g.conic.y * sums[5], g.conic.y * sums[4] + g.conic.z * sums[5]);
    let conic = vec3(-0.5 * sums[6], -sums[7], -0.5 * sums[8]);
    gradient[place(i, OPACITY)] = sums[3] / (1.0 + exp_clamped(table[place(i, OPACITY)]));
    let through_color = color_gradient(i, vec3(sums[0], sums[1], sums[2]));
    let through_mean = to_world(geometry_gradient(i, g, conic, mean));
    set_rows3(i, POSITION, through_color + through_mean);

    let n = frame.gaussians;
    density[i] += length(mean * 0.5 * vec2<f32>(frame.size));
    density[n + i] += 1.0;
    density[2u * n + i] = max(density[2u * n + i], splats[i].radius);
}
