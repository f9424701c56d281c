//! Real spherical harmonics to degree 3, in the original's order and signs.
//!
//! colour = max(0, ½ + Σₖ cₖ Yₖ(d)), d the unit direction from the camera to the Gaussian.

use crate::constants::SH_C0;
use fuse_camera::simd::F32x8;

const C1: f32 = 0.488_602_51;
const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
const C3: [f32; 5] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_34, 1.445_305_7];

/// Number of harmonics up to `degree`.
pub(crate) const fn count(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// Y₀ … Y₁₅ at the unit vector `(x, y, z)`.
#[inline(always)]
pub(crate) fn basis<V: F32x8>(x: V, y: V, z: V) -> [V; 16] {
    let s = V::splat;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let difference = xx - yy;
    let four = s(4.0) * zz - xx - yy;
    [
        s(SH_C0),
        s(-C1) * y,
        s(C1) * z,
        s(-C1) * x,
        s(C2[0]) * x * y,
        s(-C2[0]) * y * z,
        s(C2[1]) * (s(2.0) * zz - xx - yy),
        s(-C2[0]) * x * z,
        s(C2[2]) * difference,
        s(-C3[0]) * y * (s(3.0) * xx - yy),
        s(C3[1]) * x * y * z,
        s(-C3[2]) * y * four,
        s(C3[3]) * z * (s(2.0) * zz - s(3.0) * (xx + yy)),
        s(-C3[2]) * x * four,
        s(C3[4]) * z * difference,
        s(-C3[0]) * x * (xx - s(3.0) * yy),
    ]
}

/// Σₖ wₖ ∂Yₖ/∂(x, y, z) for k ≥ 1 (the constant has none); `w[k - 1]` belongs to Yₖ.
#[inline(always)]
pub(crate) fn direction_gradient<V: F32x8>(x: V, y: V, z: V, w: &[V; 15]) -> [V; 3] {
    let s = V::splat;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    let k = |i: usize, c: f32| w[i - 1] * s(c);
    let dx = k(3, -C1) + k(4, C2[0]) * y - k(6, 2.0 * C2[1]) * x - k(7, C2[0]) * z + k(8, 2.0 * C2[2]) * x
        - k(9, 6.0 * C3[0]) * xy
        + k(10, C3[1]) * yz
        + k(11, 2.0 * C3[2]) * xy
        - k(12, 6.0 * C3[3]) * xz
        - k(13, C3[2]) * (s(4.0) * zz - s(3.0) * xx - yy)
        + k(14, 2.0 * C3[4]) * xz
        - k(15, 3.0 * C3[0]) * (xx - yy);
    let dy = k(1, -C1) + k(4, C2[0]) * x
        - k(5, C2[0]) * z
        - k(6, 2.0 * C2[1]) * y
        - k(8, 2.0 * C2[2]) * y
        - k(9, 3.0 * C3[0]) * (xx - yy)
        + k(10, C3[1]) * xz
        - k(11, C3[2]) * (s(4.0) * zz - xx - s(3.0) * yy)
        - k(12, 6.0 * C3[3]) * yz
        + k(13, 2.0 * C3[2]) * xy
        - k(14, 2.0 * C3[4]) * yz
        + k(15, 6.0 * C3[0]) * xy;
    let dz = k(2, C1) - k(5, C2[0]) * y + k(6, 4.0 * C2[1]) * z - k(7, C2[0]) * x + k(10, C3[1]) * xy
        - k(11, 8.0 * C3[2]) * yz
        + k(12, 3.0 * C3[3]) * (s(2.0) * zz - xx - yy)
        - k(13, 8.0 * C3[2]) * xz
        + k(14, C3[4]) * (xx - yy);
    [dx, dy, dz]
}
