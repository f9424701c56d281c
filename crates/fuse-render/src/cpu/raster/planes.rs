//! The linear functions of a triangle at a block, and at its pixels and samples.

// Lanes run side by side through several arrays: indices say that better than zipped iterators.
#![allow(clippy::needless_range_loop)]

use fuse_camera::simd::F32x8;

use super::super::transform::Setup;
use super::{BLOCK, LANES, SAMPLES};

/// Linear functions of one triangle at one block: value at the block's corner, and gradients.
#[derive(Clone, Copy)]
pub struct Planes {
    value: [f32; 4],
    pub du: [f32; 4],
    pub dv: [f32; 4],
    /// Whether every sample of the block is inside.
    pub covers: bool,
    /// Bounds of the inverse depth over the block.
    pub low: f32,
    pub high: f32,
}

impl Planes {
    /// Edges in 0..3, inverse depth in 3; `None` when no sample of the block can be inside.
    #[inline(always)]
    pub fn at(setup: &Setup, x: usize, y: usize) -> Option<Self> {
        let at = setup.at(x as f64, y as f64);
        let side = BLOCK as f32 * 1.0001;
        let (mut value, mut du, mut dv) = ([0.0f32; 4], [0.0f32; 4], [0.0f32; 4]);
        let (mut high, mut low) = ([0.0f32; 4], [0.0f32; 4]);
        for i in 0..4 {
            (value[i], du[i], dv[i]) = (at[i] as f32, setup.du[i] as f32, setup.dv[i] as f32);
            high[i] = value[i] + side * (du[i].max(0.0) + dv[i].max(0.0));
            low[i] = value[i] + side * (du[i].min(0.0) + dv[i].min(0.0));
        }
        let (mut outside, mut covers) = (false, true);
        for i in 0..4 {
            outside |= high[i] < 0.0;
            covers &= low[i] >= 0.0;
        }
        if outside { None } else { Some(Self { value, du, dv, covers, low: low[3], high: high[3] }) }
    }

    /// Values at the centres of the pixel row `dy` of the block, at column offset 0.
    #[inline(always)]
    pub fn row(&self, dy: usize) -> [f32; 4] {
        let mut out = self.value;
        for i in 0..4 {
            out[i] += self.dv[i] * (dy as f32 + 0.5);
        }
        out
    }

    /// Values at the centres of the eight pixels of the row `dy`.
    #[inline(always)]
    pub fn centers<V: F32x8>(&self, dy: usize) -> [V; 4] {
        let row = self.row(dy);
        let x = V::load(&[0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5]);
        let mut out = [V::zero(); 4];
        for i in 0..4 {
            out[i] = V::splat(row[i]) + V::splat(self.du[i]) * x;
        }
        out
    }

    /// What the samples of a pixel add to its centre's values.
    #[inline(always)]
    pub fn sample_offsets<V: F32x8>(&self) -> [V; 4] {
        let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
        for s in 0..LANES {
            (x[s], y[s]) = (SAMPLES[s][0], SAMPLES[s][1]);
        }
        let (x, y) = (V::load(&x), V::load(&y));
        let mut out = [V::zero(); 4];
        for i in 0..4 {
            out[i] = V::splat(self.du[i]) * x + V::splat(self.dv[i]) * y;
        }
        out
    }
}

/// All bits where a point is inside of the three edges.
#[inline(always)]
pub fn inside<V: F32x8>(e: &[V; 4]) -> V {
    let zero = V::zero();
    e[0].ge(zero).and(e[1].ge(zero)).and(e[2].ge(zero))
}
