//! Adam, a block at a time.
//!
//! m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g²,
//! x ← x − r/(1 − β₁ᵗ) · m / (√(v/(1 − β₂ᵗ)) + ε).

use crate::constants::{ADAM_EPSILON, BETA1, BETA2, PARAMETERS, REST, REST_PER_CHANNEL};
use crate::table::Block;
use fuse_camera::simd::F32x8;

/// What one step needs beyond the gradient.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    /// Learning rate of each of the 59 parameters, over 1 − β₁ᵗ.
    rates: [f32; PARAMETERS],
    /// 1/(1 − β₂ᵗ).
    correction: f32,
    /// Harmonics beyond the constant one that are in use, per channel.
    harmonics: usize,
}

impl Step {
    /// Step number `t` (from 1) with the given learning rates. Harmonics above `degree` are left
    /// alone: they never had a gradient, so that their moments are zero.
    pub fn new(rates: &[f32; PARAMETERS], t: u32, degree: u32) -> Self {
        let power = |beta: f32| 1.0 - f64::from(beta).powf(f64::from(t));
        let first = power(BETA1);
        Self {
            rates: rates.map(|r| (f64::from(r) / first) as f32),
            correction: (1.0 / power(BETA2)) as f32,
            harmonics: ((degree + 1) * (degree + 1) - 1) as usize,
        }
    }

    /// Updates eight Gaussians in place.
    #[inline(always)]
    pub fn apply<V: F32x8>(&self, gradient: &[V; PARAMETERS], x: &mut Block, first: &mut Block, second: &mut Block) {
        for row in 0..REST {
            self.row(gradient[row], row, x, first, second);
        }
        for channel in 0..3 {
            let start = REST + channel * REST_PER_CHANNEL;
            for row in start..start + self.harmonics.min(REST_PER_CHANNEL) {
                self.row(gradient[row], row, x, first, second);
            }
        }
    }

    #[inline(always)]
    fn row<V: F32x8>(&self, g: V, row: usize, x: &mut Block, first: &mut Block, second: &mut Block) {
        let s = V::splat;
        let m = V::load(&first.0[row]).mul_add(s(BETA1), s(1.0 - BETA1) * g);
        let v = V::load(&second.0[row]).mul_add(s(BETA2), s(1.0 - BETA2) * g * g);
        m.store(&mut first.0[row]);
        v.store(&mut second.0[row]);
        let denominator = (v * s(self.correction)).sqrt() + s(ADAM_EPSILON);
        let x = &mut x.0[row];
        (V::load(x) - s(self.rates[row]) * m / denominator).store(x);
    }
}
