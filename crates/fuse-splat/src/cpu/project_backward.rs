//! Gradient of the projection, back to the 59 parameters, and what is done with it at once.
//!
//! A task owns blocks of eight Gaussians: it gathers each Gaussian's sums over its tiles in the
//! fixed order of its entries, applies the chain rule of `project.rs` backwards (derivatives of
//! the same intermediate values, recomputed), and hands the 59 derivatives to a sink: Adam when
//! training, a table when asked for the gradient itself.

use fuse_camera::simd::Level;
use rayon::prelude::*;

use super::adam::Step;
use super::intersect::{CHUNK, Chunk};
use super::project::{self, Geometry};
use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, REST, ROTATION, SCALE};
use crate::sh;
use crate::stages::{Density, PairGradient, Splat, View};
use crate::table::{Block, LANES, Table};
use fuse_camera::simd::{F32x8, Kernel, dispatch};

/// What the rasteriser's backward pass left, and how to find it.
#[derive(Clone, Copy)]
pub(crate) struct Gathered<'a> {
    pub view: &'a View,
    pub degree: u32,
    pub splats: &'a [Splat],
    pub chunks: &'a [Chunk],
    pub gradients: &'a [PairGradient],
}

/// One Adam step on all Gaussians; adds to the density statistics.
pub(crate) fn step(
    level: Level,
    from: Gathered<'_>,
    step: &Step,
    parameters: &mut Table,
    moments: &mut [Table; 2],
    density: &mut Density,
) {
    let [first, second] = moments;
    let (blocks, gaussians) = (CHUNK / LANES, CHUNK);
    parameters
        .blocks_mut()
        .par_chunks_mut(blocks)
        .zip(first.blocks_mut().par_chunks_mut(blocks))
        .zip(second.blocks_mut().par_chunks_mut(blocks))
        .zip(density.gradient.par_chunks_mut(gaussians))
        .zip(density.count.par_chunks_mut(gaussians))
        .zip(density.radius.par_chunks_mut(gaussians))
        .enumerate()
        .for_each(|(chunk, (((((x, m), v), gradient), count), radius))| {
            let sink = AdamSink { step, x, m, v };
            dispatch(level, Chained { from, chunk, sink, density: Some([gradient, count, radius]) });
        });
}

/// The gradient itself, for every Gaussian.
pub(crate) fn gradient(level: Level, from: Gathered<'_>, parameters: &Table) -> Table {
    let mut out = Table::zeros(parameters.len());
    let blocks = CHUNK / LANES;
    out.blocks_mut().par_chunks_mut(blocks).zip(parameters.blocks().par_chunks(blocks)).enumerate().for_each(
        |(chunk, (out, x))| dispatch(level, Chained { from, chunk, sink: TableSink { x, out }, density: None }),
    );
    out
}

/// Where the derivatives of a block go.
trait Sink {
    fn blocks(&self) -> usize;
    fn parameters(&self, block: usize) -> &Block;
    fn take<V: F32x8>(&mut self, block: usize, gradient: &[V; PARAMETERS]);
}

struct AdamSink<'a> {
    step: &'a Step,
    x: &'a mut [Block],
    m: &'a mut [Block],
    v: &'a mut [Block],
}

impl Sink for AdamSink<'_> {
    #[inline(always)]
    fn blocks(&self) -> usize {
        self.x.len()
    }
    #[inline(always)]
    fn parameters(&self, block: usize) -> &Block {
        &self.x[block]
    }
    #[inline(always)]
    fn take<V: F32x8>(&mut self, block: usize, gradient: &[V; PARAMETERS]) {
        self.step.apply(gradient, &mut self.x[block], &mut self.m[block], &mut self.v[block]);
    }
}

struct TableSink<'a> {
    x: &'a [Block],
    out: &'a mut [Block],
}

impl Sink for TableSink<'_> {
    #[inline(always)]
    fn blocks(&self) -> usize {
        self.x.len()
    }
    #[inline(always)]
    fn parameters(&self, block: usize) -> &Block {
        &self.x[block]
    }
    #[inline(always)]
    fn take<V: F32x8>(&mut self, block: usize, gradient: &[V; PARAMETERS]) {
        for (row, g) in gradient.iter().enumerate() {
            g.store(&mut self.out[block].0[row]);
        }
    }
}

struct Chained<'a, S> {
    from: Gathered<'a>,
    /// Which [`Chunk`].
    chunk: usize,
    sink: S,
    density: Option<[&'a mut [f32]; 3]>,
}

impl<S: Sink> Kernel for Chained<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(mut self) {
        let view = self.from.view;
        let splats = &self.from.splats[self.chunk * CHUNK..];
        for block in 0..self.sink.blocks() {
            let mut sums = [[0.0; LANES]; 9];
            let mut visible = [0.0; LANES];
            let first = block * LANES;
            for lane in 0..LANES.min(splats.len() - first) {
                if splats[first + lane].depth > 0.0 {
                    visible[lane] = f32::from_bits(u32::MAX);
                    gather(&self.from, self.chunk, first + lane, lane, &mut sums);
                }
            }
            let mut s = [V::zero(); 9];
            for (v, sum) in s.iter_mut().zip(&sums) {
                *v = V::load(sum);
            }
            let (gradient, mean) = chain(&self.from, self.sink.parameters(block), &s, V::load(&visible));
            self.sink.take(block, &gradient);
            let (mx, my) = (mean[0].to_array(), mean[1].to_array());
            if let Some([gradient, count, radius]) = &mut self.density {
                for lane in 0..LANES.min(gradient.len() - first) {
                    let i = first + lane;
                    if splats[i].depth > 0.0 {
                        let (x, y) = (mx[lane] * 0.5 * view.width as f32, my[lane] * 0.5 * view.height as f32);
                        gradient[i] += (x * x + y * y).sqrt();
                        count[i] += 1.0;
                        radius[i] = radius[i].max(splats[i].radius);
                    }
                }
            }
        }
    }
}

/// Adds up one Gaussian's pairs, in the order of its entries.
#[inline(always)]
fn gather(from: &Gathered<'_>, chunk: usize, local: usize, lane: usize, sums: &mut [[f32; LANES]; 9]) {
    let Chunk { entries, starts } = &from.chunks[chunk];
    let mut total = [0.0; 9];
    for entry in &entries[starts[local] as usize..starts[local + 1] as usize] {
        for (t, g) in total.iter_mut().zip(&from.gradients[entry.slot as usize]) {
            *t += g;
        }
    }
    for (sum, t) in sums.iter_mut().zip(total) {
        sum[lane] = t;
    }
}

/// From the nine sums (see [`PairGradient`]) to the 59 parameters, and to the projected mean
/// (per pixel).
#[inline(always)]
fn chain<V: F32x8>(from: &Gathered<'_>, block: &Block, sums: &[V; 9], visible: V) -> ([V; PARAMETERS], [V; 2]) {
    let s = V::splat;
    let view = from.view;
    let mut out = [V::zero(); PARAMETERS];
    let g = project::geometry::<V>(view, block);

    // α = 2^p: dL/dp = ln 2 · α dL/dα; −½ log2 e · ln 2 = −½.
    let (sx, sy) = (sums[4], sums[5]);
    let [ka, kb, kc] = g.conic;
    let mean = [ka.mul_add(sx, kb * sy), kb.mul_add(sx, kc * sy)];
    let conic = [s(-0.5) * sums[6], sums[7].neg(), s(-0.5) * sums[8]];

    let x = V::load(&block.0[OPACITY]);
    out[OPACITY] = sums[3] / (s(1.0) + x.exp());

    let mut position = color_gradient(from, block, sums, &mut out);
    let t = geometry_gradient(&g, [s(view.fx), s(view.fy)], &conic, &mean, &view.rotation, &mut out);
    let world = project::transform_transposed(&view.rotation, t);
    for i in 0..3 {
        position[i] = position[i] + world[i];
        out[POSITION + i] = position[i];
    }
    for v in &mut out {
        *v = v.and(visible);
    }
    (out, mean)
}

/// Fills the harmonics' rows; returns the derivative with respect to the position through the
/// direction.
#[inline(always)]
fn color_gradient<V: F32x8>(from: &Gathered<'_>, block: &Block, sums: &[V; 9], out: &mut [V; PARAMETERS]) -> [V; 3] {
    let ([x, y, z], inverse) = project::direction::<V>(from.view, block);
    let basis = sh::basis(x, y, z);
    let color = project::colors(block, from.degree, &basis);
    let count = sh::count(from.degree);
    let mut weights = [V::zero(); 15];
    for c in 0..3 {
        // Below zero the colour is clamped.
        let d = sums[c].and(color[c].gt(V::zero()));
        out[DC + c] = d * basis[0];
        for k in 1..count {
            let row = REST + c * 15 + k - 1;
            out[row] = d * basis[k];
            weights[k - 1] = V::load(&block.0[row]).mul_add(d, weights[k - 1]);
        }
    }
    if count == 1 {
        return [V::zero(); 3];
    }
    let d = sh::direction_gradient(x, y, z, &weights);
    // d = v/|v|: dL/dv = (dL/dd − d (d · dL/dd)) / |v|.
    let along = x * d[0] + y * d[1] + z * d[2];
    [(d[0] - x * along) * inverse, (d[1] - y * along) * inverse, (d[2] - z * along) * inverse]
}

/// Fills the rows of scale and rotation; returns the derivative with respect to t.
#[inline(always)]
fn geometry_gradient<V: F32x8>(
    g: &Geometry<V>,
    focal: [V; 2],
    conic: &[V; 3],
    mean: &[V; 2],
    view_rotation: &[[f32; 3]; 3],
    out: &mut [V; PARAMETERS],
) -> [V; 3] {
    let s = V::splat;
    let [ka, kb, kc] = g.conic;
    let [da, db, dc] = *conic;
    // K = Σ'⁻¹: dL/dΣ' = −K (dL/dK) K.
    let ca = (ka * ka * da + ka * kb * db + kb * kb * dc).neg();
    let cb = (s(2.0) * kb * (ka * da + kc * dc) + (ka * kc + kb * kb) * db).neg();
    let cc = (kb * kb * da + kb * kc * db + kc * kc * dc).neg();

    let mut dj = [V::zero(); 4];
    let mut rotation = [[V::zero(); 3]; 3]; // columns of dL/dR
    for k in 0..3 {
        // Σ' = U Uᵀ.
        let u0 = s(2.0) * ca * g.uu[0][k] + cb * g.uu[1][k];
        let u1 = cb * g.uu[0][k] + s(2.0) * cc * g.uu[1][k];
        // U = P S.
        out[SCALE + k] = (u0 * g.p[0][k] + u1 * g.p[1][k]) * g.scale[k];
        let (p0, p1) = (u0 * g.scale[k], u1 * g.scale[k]);
        // P = J V.
        dj[0] = p0.mul_add(g.v[0][k], dj[0]);
        dj[1] = p0.mul_add(g.v[2][k], dj[1]);
        dj[2] = p1.mul_add(g.v[1][k], dj[2]);
        dj[3] = p1.mul_add(g.v[2][k], dj[3]);
        // V = W R.
        let column = [g.j[0] * p0, g.j[2] * p1, g.j[1].mul_add(p0, g.j[3] * p1)];
        rotation[k] = project::transform_transposed(view_rotation, column);
    }
    quaternion_gradient(g, &rotation, out);

    let iz = g.inverse_z;
    let mut t = [V::zero(); 3];
    for (i, (diagonal, side)) in [(dj[0], dj[1]), (dj[2], dj[3])].into_iter().enumerate() {
        let f = focal[i] * iz;
        // Jᵢᵢ = f/z, Jᵢ₂ = −f u/z, u = t/z unless clamped.
        let u = (f * side).neg().and(g.free[i]);
        let ratio = g.t[i] * iz;
        t[i] = (u + focal[i] * mean[i]) * iz;
        t[2] = t[2] + (f * (g.u[i] * side - diagonal) - (u + focal[i] * mean[i]) * ratio) * iz;
    }
    t
}

/// Derivative of the rotation matrix with respect to the quaternion, and of its normalisation.
#[inline(always)]
fn quaternion_gradient<V: F32x8>(g: &Geometry<V>, columns: &[[V; 3]; 3], out: &mut [V; PARAMETERS]) {
    let s = V::splat;
    let r = |i: usize, j: usize| columns[j][i];
    let [w, x, y, z] = g.q;
    let (two, four) = (s(2.0), s(4.0));
    let d = [
        two * (z * (r(1, 0) - r(0, 1)) + y * (r(0, 2) - r(2, 0)) + x * (r(2, 1) - r(1, 2))),
        two * (y * (r(0, 1) + r(1, 0)) + z * (r(0, 2) + r(2, 0)) + w * (r(2, 1) - r(1, 2)))
            - four * x * (r(1, 1) + r(2, 2)),
        two * (x * (r(0, 1) + r(1, 0)) + z * (r(1, 2) + r(2, 1)) + w * (r(0, 2) - r(2, 0)))
            - four * y * (r(0, 0) + r(2, 2)),
        two * (x * (r(0, 2) + r(2, 0)) + y * (r(1, 2) + r(2, 1)) + w * (r(1, 0) - r(0, 1)))
            - four * z * (r(0, 0) + r(1, 1)),
    ];
    let along = w * d[0] + x * d[1] + y * d[2] + z * d[3];
    for i in 0..4 {
        out[ROTATION + i] = (d[i] - g.q[i] * along) * g.inverse_length;
    }
}
