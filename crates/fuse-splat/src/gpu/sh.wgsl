// Real spherical harmonics to degree 3; twin of sh.rs.

const C1: f32 = 0.48860251;
const C2: array<f32, 3> = array(1.0925484, 0.31539157, 0.5462742);
const C3: array<f32, 5> = array(0.5900436, 2.8906114, 0.4570458, 0.37317634, 1.4453057);

/// Y₀ … Y₁₅ at a unit vector.
fn sh_basis(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let difference = xx - yy;
    let four = 4.0 * zz - xx - yy;
    return array(
        SH_C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        -C2[0] * y * z,
        C2[1] * (2.0 * zz - xx - yy),
        -C2[0] * x * z,
        C2[2] * difference,
        -C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        -C3[2] * y * four,
        C3[3] * z * (2.0 * zz - 3.0 * (xx + yy)),
        -C3[2] * x * four,
        C3[4] * z * difference,
        -C3[0] * x * (xx - 3.0 * yy),
    );
}

/// Σₖ wₖ ∂Yₖ/∂d for k ≥ 1; `w[k]` belongs to Yₖ.
fn sh_direction_gradient(d: vec3<f32>, w: array<f32, 16>) -> vec3<f32> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let xy = x * y;
    let yz = y * z;
    let xz = x * z;
    let dx = -C1 * w[3] + C2[0] * w[4] * y - 2.0 * C2[1] * w[6] * x - C2[0] * w[7] * z + 2.0 * C2[2] * w[8] * x
        - 6.0 * C3[0] * w[9] * xy
        + C3[1] * w[10] * yz
        + 2.0 * C3[2] * w[11] * xy
        - 6.0 * C3[3] * w[12] * xz
        - C3[2] * w[13] * (4.0 * zz - 3.0 * xx - yy)
        + 2.0 * C3[4] * w[14] * xz
        - 3.0 * C3[0] * w[15] * (xx - yy);
    let dy = -C1 * w[1] + C2[0] * w[4] * x - C2[0] * w[5] * z - 2.0 * C2[1] * w[6] * y - 2.0 * C2[2] * w[8] * y
        - 3.0 * C3[0] * w[9] * (xx - yy)
        + C3[1] * w[10] * xz
        - C3[2] * w[11] * (4.0 * zz - xx - 3.0 * yy)
        - 6.0 * C3[3] * w[12] * yz
        + 2.0 * C3[2] * w[13] * xy
        - 2.0 * C3[4] * w[14] * yz
        + 6.0 * C3[0] * w[15] * xy;
    let dz = C1 * w[2] - C2[0] * w[5] * y + 4.0 * C2[1] * w[6] * z - C2[0] * w[7] * x + C3[1] * w[10] * xy
        - 8.0 * C3[2] * w[11] * yz
        + 3.0 * C3[3] * w[12] * (2.0 * zz - xx - yy)
        - 8.0 * C3[2] * w[13] * xz
        + C3[4] * w[14] * (xx - yy);
    return vec3(dx, dy, dz);
}
