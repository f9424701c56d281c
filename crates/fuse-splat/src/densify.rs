//! Decides which Gaussians are cloned, split and removed, by the original's rules.
//!
//! With ḡ the mean length of the gradient of the projected position: ḡ ≥ threshold and largest
//! scale ≤ 0.01 extent → clone; larger → two halves instead. Then remove what is too transparent
//! and, once opacities have been reset, what is too large.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::TrainerConfig;
use crate::constants::{OPACITY, SCALE};
use crate::gaussians::logit;
use crate::stages::Density;
use crate::surgery::Patient;

/// One densification takes at most this part of the room below `max_gaussians`.
const ROOM_SHARE: usize = 16;

/// How the number of Gaussians changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Copies made.
    pub cloned: usize,
    /// Gaussians replaced by two halves.
    pub split: usize,
    /// Gaussians removed.
    pub pruned: usize,
}

/// One densification. `large` says whether Gaussians that are too large are removed too.
pub(crate) fn densify(
    patient: &mut Patient,
    config: &TrainerConfig,
    extent: f32,
    large: bool,
    rng: &mut ChaCha8Rng,
) -> Changes {
    let before = patient.len();
    let largest = |p: &Patient, i: usize| p.parameters.rows::<3>(i, SCALE).into_iter().fold(f32::MIN, f32::max).exp();
    let mut keep = vec![true; before];
    let mut changes = Changes::default();
    let room = config.max_gaussians.saturating_sub(before).div_ceil(ROOM_SHARE);
    for i in busiest(&patient.density, config.densify_gradient, room) {
        if largest(patient, i) <= config.dense_fraction * extent {
            patient.clone_one(i);
            changes.cloned += 1;
        } else {
            patient.split_one(i, normals(rng));
            patient.split_one(i, normals(rng));
            keep[i] = false;
            changes.split += 1;
        }
    }
    keep.resize(patient.len(), true);
    let transparent = logit(config.prune_opacity);
    for (i, keep) in keep.iter_mut().enumerate().filter(|(_, k)| **k) {
        let huge = large
            && (config.prune_radius.is_some_and(|limit| patient.density.radius[i] > limit)
                || config.prune_fraction.is_some_and(|limit| largest(patient, i) > limit * extent));
        if patient.parameters.get(i, OPACITY) < transparent || huge {
            *keep = false;
            changes.pruned += 1;
        }
    }
    if !keep.contains(&true) {
        // A map is never emptied.
        return Changes { pruned: 0, ..changes };
    }
    patient.retain(&keep);
    patient.density = Density::zeros(patient.len());
    changes
}

/// Gaussians whose mean gradient reaches the threshold, in order; where there is less room than
/// that (each adds one), those with the largest gradients.
fn busiest(density: &Density, threshold: f32, room: usize) -> Vec<usize> {
    let mean = |i: usize| if density.count[i] > 0.0 { density.gradient[i] / density.count[i] } else { 0.0 };
    let mut busy: Vec<usize> = (0..density.count.len()).filter(|&i| mean(i) >= threshold).collect();
    if busy.len() > room {
        busy.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
        busy.truncate(room);
        busy.sort_unstable();
    }
    busy
}

/// Three standard normal numbers (Box and Muller).
fn normals(rng: &mut ChaCha8Rng) -> [f32; 3] {
    std::array::from_fn(|_| {
        let u: f32 = 1.0 - rng.random::<f32>();
        let v: f32 = rng.random();
        (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
    })
}

#[cfg(test)]
mod tests {
    use rand_chacha::rand_core::SeedableRng as _;

    use super::*;
    use crate::Gaussians;
    use crate::constants::POSITION;

    /// Small and busy, large and busy, quiet, transparent.
    fn patient() -> Patient {
        let xyz: Vec<[f32; 3]> = (0..4).map(|i| [i as f32, 0.0, 0.0]).collect();
        let gaussians = Gaussians::from_points(&xyz, &[[0.5; 3]; 4]).unwrap();
        let mut p = Patient::new(gaussians.table);
        for (i, scale) in [0.001, 0.5, 0.5, 0.5].into_iter().enumerate() {
            for k in 0..3 {
                p.parameters.set(i, SCALE + k, f32::ln(scale));
            }
        }
        p.parameters.set(3, OPACITY, logit(0.004));
        p.density.gradient = vec![3e-3, 3e-3, 1e-3, 0.0];
        p.density.count = vec![10.0, 10.0, 10.0, 0.0];
        p
    }

    #[test]
    fn busy_ones_multiply_and_transparent_ones_go() {
        let (mut p, mut rng) = (patient(), ChaCha8Rng::seed_from_u64(1));
        let changes = densify(&mut p, &TrainerConfig::default(), 1.0, false, &mut rng);
        assert_eq!(changes, Changes { cloned: 1, split: 1, pruned: 1 });
        assert_eq!((p.len(), p.moments[0].len(), p.density.count.len()), (5, 5, 5));
        let x: Vec<f32> = (0..5).map(|i| p.parameters.get(i, POSITION)).collect();
        assert_eq!(x[..3], [0.0, 2.0, 0.0], "kept, kept, clone");
        assert!(x[3] != 1.0 && x[4] != 1.0 && x[3] != x[4], "halves are moved: {x:?}");
        assert_eq!(p.density, Density::zeros(5));
    }

    #[test]
    fn large_ones_go_only_after_a_reset_and_the_guard_holds() {
        let (mut p, mut rng) = (patient(), ChaCha8Rng::seed_from_u64(1));
        p.density.gradient[1] = 4e-3;
        let config = TrainerConfig {
            max_gaussians: 5,
            prune_fraction: Some(0.1),
            prune_radius: Some(20.0),
            ..TrainerConfig::default()
        };
        let changes = densify(&mut p, &config, 1.0, true, &mut rng);
        assert_eq!((changes.cloned, changes.split), (0, 1), "room for one more, the busiest");
        assert_eq!(changes.pruned, 4, "three larger than a tenth of the extent, one transparent");
        assert_eq!(p.len(), 1);

        // Nothing would be left: nothing is removed.
        let mut p = patient();
        p.density.radius[0] = 21.0;
        p.density.gradient.fill(0.0);
        assert_eq!(densify(&mut p, &config, 1.0, true, &mut rng), Changes::default());
        assert_eq!(p.len(), 4);
    }
}
