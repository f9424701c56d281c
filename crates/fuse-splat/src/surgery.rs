//! Edits to the set of Gaussians, with everything that belongs to each: moments and statistics.

use crate::constants::{OPACITY, PARAMETERS, POSITION, ROTATION, SCALE};
use crate::gaussians::logit;
use crate::stages::Density;
use crate::table::Table;

/// Scales of the two halves of a split Gaussian are divided by this (the original's 0.8 · 2).
pub(crate) const SPLIT_SHRINK: f32 = 1.6;

/// The Gaussians under training.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Patient {
    pub parameters: Table,
    /// Adam's first and second moments.
    pub moments: [Table; 2],
    pub density: Density,
}

impl Patient {
    pub fn new(parameters: Table) -> Self {
        let n = parameters.len();
        Self { parameters, moments: [Table::zeros(n), Table::zeros(n)], density: Density::zeros(n) }
    }

    pub fn len(&self) -> usize {
        self.parameters.len()
    }

    /// Appends a Gaussian without a past.
    pub fn push(&mut self, vector: &[f32; PARAMETERS]) {
        self.parameters.push(vector);
        for m in &mut self.moments {
            m.push(&[0.0; PARAMETERS]);
        }
        self.density.gradient.push(0.0);
        self.density.count.push(0.0);
        self.density.radius.push(0.0);
    }

    /// Keeps the Gaussians `i` with `keep[i]`.
    pub fn retain(&mut self, keep: &[bool]) {
        self.parameters.retain(keep);
        for m in &mut self.moments {
            m.retain(keep);
        }
        let d = &mut self.density;
        for list in [&mut d.gradient, &mut d.count, &mut d.radius] {
            let mut flags = keep.iter();
            list.retain(|_| flags.next().copied().unwrap_or(false));
        }
    }

    /// Appends a copy of Gaussian `i`, as the original does: same place, no moments.
    pub fn clone_one(&mut self, i: usize) {
        self.push(&self.parameters.vector(i));
    }

    /// Appends a half of Gaussian `i`: at a point drawn from it (`normal`: three standard normal
    /// numbers), its scales divided by 1.6. The caller removes `i`.
    pub fn split_one(&mut self, i: usize, normal: [f32; 3]) {
        let mut v = self.parameters.vector(i);
        let offset: [f32; 3] = std::array::from_fn(|k| v[SCALE + k].exp() * normal[k]);
        let rotated = rotate([v[ROTATION], v[ROTATION + 1], v[ROTATION + 2], v[ROTATION + 3]], offset);
        for k in 0..3 {
            v[POSITION + k] += rotated[k];
            v[SCALE + k] -= SPLIT_SHRINK.ln();
        }
        self.push(&v);
    }

    /// Opacities above `limit` fall to it; the moments of all opacities are forgotten.
    pub fn reset_opacity(&mut self, limit: f32) {
        for i in 0..self.len() {
            self.parameters.set(i, OPACITY, self.parameters.get(i, OPACITY).min(logit(limit)));
            for m in &mut self.moments {
                m.set(i, OPACITY, 0.0);
            }
        }
    }
}

/// Rotates `v` by a quaternion of any length.
fn rotate(q: [f32; 4], v: [f32; 3]) -> [f32; 3] {
    let length = q.iter().map(|x| x * x).sum::<f32>().max(1e-24).sqrt();
    let [w, x, y, z] = q.map(|c| c / length);
    let cross =
        |a: [f32; 3], b: [f32; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let t = cross([x, y, z], v).map(|c| 2.0 * c);
    let u = cross([x, y, z], t);
    std::array::from_fn(|k| v[k] + w * t[k] + u[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_and_statistics_move_with_their_gaussians() {
        let mut p = Patient::new(Table::zeros(0));
        for i in 0..20 {
            p.push(&std::array::from_fn(|r| i as f32 + r as f32 / 100.0));
            p.moments[0].set(i, 30, i as f32);
            p.moments[1].set(i, 58, i as f32);
            p.density.radius[i] = i as f32;
        }
        p.clone_one(4);
        let keep: Vec<bool> = (0..21).map(|i| i % 2 == 0).collect();
        p.retain(&keep);
        assert_eq!((p.len(), p.moments[1].len(), p.density.count.len()), (11, 11, 11));
        for i in 0..10 {
            let own = (2 * i) as f32;
            assert_eq!(p.parameters.get(i, 0), own);
            assert_eq!((p.moments[0].get(i, 30), p.moments[1].get(i, 58), p.density.radius[i]), (own, own, own));
        }
        assert_eq!(p.parameters.vector(10), p.parameters.vector(2));
        assert_eq!(p.moments[0].vector(10), [0.0; PARAMETERS]);
    }

    #[test]
    fn halves_lie_along_the_gaussians_own_axes() {
        let mut v = [0.0; PARAMETERS];
        // A quarter turn about z takes the long x axis to y. Length two on purpose.
        let h = 2.0 * std::f32::consts::FRAC_1_SQRT_2;
        v[ROTATION..ROTATION + 4].copy_from_slice(&[h, 0.0, 0.0, h]);
        v[SCALE..SCALE + 3].copy_from_slice(&[3f32.ln(), 0.0, 0.0]);
        let mut p = Patient::new(Table::zeros(0));
        p.push(&v);
        p.split_one(0, [1.0, 0.0, 0.0]);
        let place: [f32; 3] = p.parameters.rows(1, POSITION);
        assert!(place[0].abs() < 1e-6 && (place[1] - 3.0).abs() < 1e-6 && place[2].abs() < 1e-6);
        assert!((p.parameters.get(1, SCALE).exp() - 3.0 / 1.6).abs() < 1e-6);
    }
}
