//! What is due when: rates, degree of the harmonics, densification, resets.

use crate::TrainerConfig;
use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, REST, ROTATION, SCALE};

/// The harmonics beyond the constant one learn at this fraction of its rate, as in the original.
const REST_FRACTION: f32 = 1.0 / 20.0;

/// Learning rate of each parameter in iteration `i` (from 1); `extent` in metres.
///
/// `step`: iterations that this step stands for. Position: exp((1 − τ) ln r₀ + τ ln r₁) · extent, τ = min(i/steps, 1).
pub(crate) fn rates(config: &TrainerConfig, iteration: u32, step: u32, extent: f32) -> [f32; PARAMETERS] {
    let tau = (iteration as f32 / config.position_steps as f32).min(1.0);
    let position = ((1.0 - tau) * config.position_rate.ln() + tau * config.position_rate_end.ln()).exp();
    let mut rates = [config.feature_rate * REST_FRACTION; PARAMETERS];
    rates[POSITION..POSITION + 3].fill(position * extent);
    rates[SCALE..SCALE + 3].fill(config.scale_rate);
    rates[ROTATION..ROTATION + 4].fill(config.rotation_rate);
    rates[OPACITY] = config.opacity_rate;
    rates[DC..REST].fill(config.feature_rate);
    // The last step of a call may stand for fewer iterations than the others.
    let gain = config.rate_gain * step as f32 / config.step_iterations as f32;
    rates.map(|rate| gain * rate)
}

/// Degree of the harmonics in iteration `i` (from 1).
pub(crate) fn degree(config: &TrainerConfig, iteration: u32) -> u32 {
    (iteration / config.degree_interval).min(config.degree)
}

/// Whether an iteration looks at half the resolution, with so many `left` in this and the following
/// calls, itself among them.
pub(crate) fn coarse(config: &TrainerConfig, left: u32) -> bool {
    config.fine_iterations.is_some_and(|fine| left > fine)
}

/// The last multiple of `interval` up to iteration `i`, if it lies within the last `step`.
fn due(interval: u32, iteration: u32, step: u32) -> Option<u32> {
    let last = iteration - iteration % interval;
    (last > 0 && last > iteration.saturating_sub(step)).then_some(last)
}

/// Whether Gaussians are cloned, split and removed after a step of `step` iterations to the `i`-th.
pub(crate) fn densify_after(config: &TrainerConfig, iteration: u32, step: u32) -> bool {
    due(config.densify_interval, iteration, step).is_some_and(|i| i > config.densify_start && i < config.densify_end)
}

/// Whether the opacities are reset after it.
pub(crate) fn reset_after(config: &TrainerConfig, iteration: u32, step: u32) -> bool {
    due(config.opacity_reset_interval, iteration, step).is_some_and(|i| i < config.densify_end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_official_schedule() {
        let c = TrainerConfig::default();
        let position = |i| rates(&c, i, 1, 2.0)[POSITION + 2];
        assert!((position(0) / 3.2e-4 - 1.0).abs() < 1e-5);
        assert!((position(15_000) / 3.2e-5 - 1.0).abs() < 1e-4);
        assert!((position(50_000) / 3.2e-6 - 1.0).abs() < 1e-4);
        let r = rates(&c, 1, 1, 1.0);
        assert_eq!(
            [r[SCALE], r[ROTATION + 3], r[OPACITY], r[DC + 2], r[REST], r[58]],
            [5e-3, 1e-3, 2.5e-2, 2.5e-3, 1.25e-4, 1.25e-4]
        );
        assert_eq!([999, 1000, 2500, 9999].map(|i| degree(&c, i)), [0, 1, 2, 3]);
        let due: Vec<u32> = (0..16_000).filter(|&i| densify_after(&c, i, 1)).collect();
        assert_eq!((due[0], due[1], due[due.len() - 1]), (600, 700, 14_900));
        let due: Vec<u32> = (0..20_000).filter(|&i| reset_after(&c, i, 1)).collect();
        assert_eq!(due, [3000, 6000, 9000, 12_000]);
    }

    #[test]
    fn steps_of_several_iterations_miss_nothing_and_repeat_nothing() {
        let c = TrainerConfig { densify_interval: 100, ..TrainerConfig::default() };
        let due: Vec<u32> = (0..16_000).step_by(3).filter(|&i| densify_after(&c, i, 3)).collect();
        assert_eq!((due[0], due[1], due[2], due.len()), (600, 702, 801, 144));
        assert_eq!((0..20_000).step_by(7).filter(|&i| reset_after(&c, i, 7)).count(), 4);
    }
}
