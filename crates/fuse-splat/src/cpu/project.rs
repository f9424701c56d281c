//! Projection: Gaussian → [`Splat`].
//!
//! t = W x + w (camera frame); mean = (fx tx/tz + cx, fy ty/tz + cy);
//! Σ' = U Uᵀ + h·1, U = J (W R) S, where h = 0.3 (`View::low_pass`), R is the rotation of the
//! quaternion, S the scales and J the Jacobian of the projection at t, with tx/tz and ty/tz clamped
//! to 1.3 times the half field of view. In the exponent of two: p = log2 o − ½ log2(e) dᵀ Σ'⁻¹ d.
//!
//! One block of eight Gaussians is a vector; blocks are independent of one another.

use std::f32::consts::LOG2_E;

use fuse_camera::simd::Level;
use rayon::prelude::*;

use crate::constants::{DC, FOV_MARGIN, LOG2_ALPHA_MIN, NEAR, OPACITY, POSITION, REST, ROTATION, SCALE};
use crate::sh;
use crate::stages::{Splat, View};
use crate::table::{Block, LANES, Table};
use fuse_camera::simd::{F32x8, Kernel, dispatch};

/// Blocks that one task projects.
const CHUNK: usize = 32;

/// Fills `splats`, one a Gaussian; those outside the view get depth 0.
pub(crate) fn project(level: Level, view: &View, degree: u32, table: &Table, splats: &mut Vec<Splat>) {
    splats.resize(table.blocks().len() * LANES, Splat::default());
    let chunks = table.blocks().par_chunks(CHUNK).zip(splats.par_chunks_mut(CHUNK * LANES));
    chunks.for_each(|(blocks, out)| dispatch(level, Project { view, degree, blocks, out }));
    // Lanes past the end hold nothing.
    splats.truncate(table.len());
}

struct Project<'a> {
    view: &'a View,
    degree: u32,
    blocks: &'a [Block],
    out: &'a mut [Splat],
}

impl Kernel for Project<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(self) {
        for (block, out) in self.blocks.iter().zip(self.out.as_chunks_mut().0) {
            project_block::<V>(self.view, self.degree, block, out);
        }
    }
}

/// What both directions of the projection need of eight Gaussians.
pub(super) struct Geometry<V> {
    /// Camera frame; z is 1 where the Gaussian is too near.
    pub t: [V; 3],
    pub inverse_z: V,
    /// Clamped tx/tz and ty/tz, and masks of the lanes in which they were not clamped.
    pub u: [V; 2],
    pub free: [V; 2],
    /// Entries (0,0) = (fx/z), (0,2), (1,1), (1,2) of J.
    pub j: [V; 4],
    /// W R.
    pub v: [[V; 3]; 3],
    /// J W R.
    pub p: [[V; 3]; 2],
    pub scale: [V; 3],
    /// J W R S.
    pub uu: [[V; 3]; 2],
    /// Upper triangle of Σ'⁻¹.
    pub conic: [V; 3],
    /// Normalised quaternion and the inverse of its length.
    pub q: [V; 4],
    pub inverse_length: V,
    /// Upper triangle of Σ'.
    pub covariance: [V; 3],
    /// In front of the near plane, and Σ' positive definite.
    pub valid: V,
}

#[inline(always)]
pub(super) fn rows<V: F32x8, const N: usize>(block: &Block, first: usize) -> [V; N] {
    let mut out = [V::zero(); N];
    for k in 0..N {
        out[k] = V::load(&block.0[first + k]);
    }
    out
}

/// m · v for a matrix of scalars.
#[inline(always)]
fn transform<V: F32x8>(m: &[[f32; 3]; 3], v: [V; 3]) -> [V; 3] {
    let s = V::splat;
    let row = |r: &[f32; 3]| s(r[2]).mul_add(v[2], s(r[1]).mul_add(v[1], s(r[0]) * v[0]));
    [row(&m[0]), row(&m[1]), row(&m[2])]
}

/// mᵀ · v for a matrix of scalars.
#[inline(always)]
pub(super) fn transform_transposed<V: F32x8>(m: &[[f32; 3]; 3], v: [V; 3]) -> [V; 3] {
    let s = V::splat;
    let column = |i: usize| s(m[2][i]).mul_add(v[2], s(m[1][i]).mul_add(v[1], s(m[0][i]) * v[0]));
    [column(0), column(1), column(2)]
}

/// Rotation matrix of a unit quaternion, as columns.
#[inline(always)]
fn rotation_columns<V: F32x8>([w, x, y, z]: [V; 4]) -> [[V; 3]; 3] {
    let (one, two) = (V::splat(1.0), V::splat(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
        [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)],
        [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)],
    ]
}

#[inline(always)]
pub(super) fn geometry<V: F32x8>(view: &View, block: &Block) -> Geometry<V> {
    let s = V::splat;
    let position: [V; 3] = rows(block, POSITION);
    let mut t = transform(&view.rotation, position);
    for i in 0..3 {
        t[i] = t[i] + s(view.translation[i]);
    }
    let near = t[2].gt(s(NEAR));
    t[2] = t[2].select(near, s(1.0));
    let inverse_z = s(1.0) / t[2];

    let limits = [FOV_MARGIN * view.width as f32 / (2.0 * view.fx), FOV_MARGIN * view.height as f32 / (2.0 * view.fy)];
    let clamp = |x: V, limit: f32| x.min(s(limit)).max(s(-limit));
    let ratio = [t[0] * inverse_z, t[1] * inverse_z];
    let u = [clamp(ratio[0], limits[0]), clamp(ratio[1], limits[1])];
    let inside = |x: V, limit: f32| s(limit).ge(x).and(x.ge(s(-limit)));
    let free = [inside(ratio[0], limits[0]), inside(ratio[1], limits[1])];
    let (jx, jy) = (s(view.fx) * inverse_z, s(view.fy) * inverse_z);
    let j = [jx, (jx * u[0]).neg(), jy, (jy * u[1]).neg()];

    let raw: [V; 4] = rows(block, ROTATION);
    let squared = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
    let inverse_length = s(1.0) / squared.max(s(1e-24)).sqrt();
    let q = [raw[0] * inverse_length, raw[1] * inverse_length, raw[2] * inverse_length, raw[3] * inverse_length];
    let columns = rotation_columns(q);
    let mut v = [[V::zero(); 3]; 3];
    let mut p = [[V::zero(); 3]; 2];
    let mut uu = [[V::zero(); 3]; 2];
    let log_scale: [V; 3] = rows(block, SCALE);
    let scale = [log_scale[0].exp(), log_scale[1].exp(), log_scale[2].exp()];
    for k in 0..3 {
        let column = transform(&view.rotation, columns[k]);
        for i in 0..3 {
            v[i][k] = column[i];
        }
        p[0][k] = j[0].mul_add(column[0], j[1] * column[2]);
        p[1][k] = j[2].mul_add(column[1], j[3] * column[2]);
        uu[0][k] = p[0][k] * scale[k];
        uu[1][k] = p[1][k] * scale[k];
    }
    let dot = |a: &[V; 3], b: &[V; 3]| a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]));
    let low_pass = s(view.low_pass);
    let covariance = [dot(&uu[0], &uu[0]) + low_pass, dot(&uu[0], &uu[1]), dot(&uu[1], &uu[1]) + low_pass];
    let determinant = covariance[0] * covariance[2] - covariance[1] * covariance[1];
    let valid = near.and(determinant.gt(V::zero()));
    let inverse = s(1.0) / determinant.select(valid, s(1.0));
    let conic = [covariance[2] * inverse, (covariance[1] * inverse).neg(), covariance[0] * inverse];
    Geometry { t, inverse_z, u, free, j, v, p, scale, uu, conic, q, inverse_length, covariance, valid }
}

/// Unit direction from the camera to the Gaussian, and the inverse distance.
#[inline(always)]
pub(super) fn direction<V: F32x8>(view: &View, block: &Block) -> ([V; 3], V) {
    let s = V::splat;
    let p: [V; 3] = rows(block, POSITION);
    let d = [p[0] - s(view.center[0]), p[1] - s(view.center[1]), p[2] - s(view.center[2])];
    let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    let inverse = s(1.0) / squared.max(s(1e-24)).sqrt();
    ([d[0] * inverse, d[1] * inverse, d[2] * inverse], inverse)
}

/// ½ + Σₖ cₖ Yₖ, not yet clamped at zero.
#[inline(always)]
pub(super) fn colors<V: F32x8>(block: &Block, degree: u32, basis: &[V; 16]) -> [V; 3] {
    let mut out = [V::zero(); 3];
    for c in 0..3 {
        let mut sum = V::load(&block.0[DC + c]).mul_add(basis[0], V::splat(0.5));
        for k in 1..sh::count(degree) {
            sum = V::load(&block.0[REST + c * 15 + k - 1]).mul_add(basis[k], sum);
        }
        out[c] = sum;
    }
    out
}

/// log2 of the opacity: −log2(1 + exp(−x)).
#[inline(always)]
pub(super) fn log2_opacity<V: F32x8>(block: &Block) -> V {
    let x = V::load(&block.0[OPACITY]);
    (V::splat(1.0) + x.neg().exp()).log2().neg()
}

#[inline(always)]
fn project_block<V: F32x8>(view: &View, degree: u32, block: &Block, out: &mut [Splat; LANES]) {
    let s = V::splat;
    let g = geometry::<V>(view, block);
    let (d, _) = direction::<V>(view, block);
    let basis = sh::basis(d[0], d[1], d[2]);
    let color = colors(block, degree, &basis);

    let mean_x = (s(view.fx) * g.t[0]).mul_add(g.inverse_z, s(view.cx));
    let mean_y = (s(view.fy) * g.t[1]).mul_add(g.inverse_z, s(view.cy));
    let opacity = log2_opacity::<V>(block);
    // The ellipse α ≥ 1/255 is dᵀ Σ'⁻¹ d ≤ 2 ln(255 o); its box has half sides √(2 ln(255 o) Σ'ᵢᵢ).
    let reach = (opacity - s(LOG2_ALPHA_MIN)) * s(2.0 * std::f32::consts::LN_2);
    let opaque = reach.gt(V::zero());
    let reach = reach.max(V::zero());
    let extent_x = (reach * g.covariance[0]).sqrt();
    let extent_y = (reach * g.covariance[2]).sqrt();
    let on_image = (mean_x + extent_x)
        .gt(V::zero())
        .and(s(view.width as f32).gt(mean_x - extent_x))
        .and((mean_y + extent_y).gt(V::zero()))
        .and(s(view.height as f32).gt(mean_y - extent_y));
    let visible = g.valid.and(opaque).and(on_image);

    let half = s(0.5) * (g.covariance[0] + g.covariance[2]);
    let gap = s(0.5) * (g.covariance[0] - g.covariance[2]);
    let largest = half + (gap * gap + g.covariance[1] * g.covariance[1]).sqrt();

    let columns = [
        mean_x,
        mean_y,
        g.conic[0] * s(-0.5 * LOG2_E),
        g.conic[1] * s(-LOG2_E),
        g.conic[2] * s(-0.5 * LOG2_E),
        opacity,
        color[0].max(V::zero()),
        color[1].max(V::zero()),
        color[2].max(V::zero()),
        g.t[2].and(visible),
        extent_x,
        extent_y,
        s(3.0) * largest.sqrt(),
    ];
    let mut values = [[0.0; LANES]; 13];
    for (column, value) in columns.iter().zip(&mut values) {
        column.store(value);
    }
    for (lane, splat) in out.iter_mut().enumerate() {
        let v = |k: usize| values[k][lane];
        *splat = Splat {
            mean: [v(0), v(1)],
            a: v(2),
            b: v(3),
            c: v(4),
            log2_opacity: v(5),
            color: [v(6), v(7), v(8)],
            depth: v(9),
            extent: [v(10), v(11)],
            radius: v(12),
        };
    }
}
