//! Adam, a block at a time.
//!
//! m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g²,
//! x ← x − r/(1 − β₁ᵗ) · m / (√(v/(1 − β₂ᵗ)) + ε).

use crate::constants::{ADAM_EPSILON, BETA1, BETA2, PARAMETERS};
use crate::simd::F32x8;
use crate::table::Block;

/// What one step needs beyond the gradient.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    /// Learning rate of each of the 59 parameters, over 1 − β₁ᵗ.
    rates: [f32; PARAMETERS],
    /// 1/(1 − β₂ᵗ).
    correction: f32,
}

impl Step {
    /// Step number `t` (from 1) with the given learning rates.
    pub fn new(rates: &[f32; PARAMETERS], t: u32) -> Self {
        let power = |beta: f32| 1.0 - f64::from(beta).powf(f64::from(t));
        let first = power(BETA1);
        Self { rates: rates.map(|r| (f64::from(r) / first) as f32), correction: (1.0 / power(BETA2)) as f32 }
    }

    /// Updates eight Gaussians in place.
    #[inline(always)]
    pub fn apply<V: F32x8>(&self, gradient: &[V; PARAMETERS], x: &mut Block, first: &mut Block, second: &mut Block) {
        let s = V::splat;
        for row in 0..PARAMETERS {
            let g = gradient[row];
            let m = V::load(&first.0[row]).mul_add(s(BETA1), s(1.0 - BETA1) * g);
            let v = V::load(&second.0[row]).mul_add(s(BETA2), s(1.0 - BETA2) * g * g);
            m.store(&mut first.0[row]);
            v.store(&mut second.0[row]);
            let denominator = (v * s(self.correction)).sqrt() + s(ADAM_EPSILON);
            let x = &mut x.0[row];
            (V::load(x) - s(self.rates[row]) * m / denominator).store(x);
        }
    }
}
