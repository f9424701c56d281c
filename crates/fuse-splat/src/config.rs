//! Settings of the training; defaults are the supplement's, and the original's where it is silent.

use crate::SplatError;
use crate::constants::MAX_DEGREE;

/// Settings of a [`crate::Trainer`].
#[derive(Clone, Debug, PartialEq)]
pub struct TrainerConfig {
    /// Position rate at the start, times the scene's extent (supplement: 1.6e-4).
    pub position_rate: f32,
    /// Position rate at `position_steps`, times the scene's extent (supplement: 1.6e-6).
    pub position_rate_end: f32,
    /// Iterations over which the position rate falls, log-linearly (original: 30,000).
    pub position_steps: u32,
    /// Rate of the constant harmonic; the others have a twentieth (supplement: 2.5e-3).
    pub feature_rate: f32,
    /// Rate of the opacity's logit (supplement: 2.5e-2).
    pub opacity_rate: f32,
    /// Rate of the scales' logarithm (supplement: 5e-3).
    pub scale_rate: f32,
    /// Rate of the quaternions (supplement: 1e-3).
    pub rotation_rate: f32,
    /// Weight of D-SSIM, λ (original: 0.2).
    pub lambda_dssim: f32,
    /// Highest degree of the harmonics (supplement: 3).
    pub degree: u32,
    /// Iterations after which the degree rises by one (original: 1000).
    pub degree_interval: u32,
    /// First iteration after which the number of Gaussians may change (supplement: 500).
    pub densify_start: u32,
    /// Last such iteration (supplement: 15,000).
    pub densify_end: u32,
    /// Iterations between two densifications (supplement: 100).
    pub densify_interval: u32,
    /// Mean gradient of the projected position, normalised device units, from which a Gaussian is
    /// cloned or split (original: 2e-4).
    pub densify_gradient: f32,
    /// Times the scene's extent: larger Gaussians are split, smaller ones cloned (original: 0.01).
    pub dense_fraction: f32,
    /// Gaussians less opaque are removed (original: 0.005).
    pub prune_opacity: f32,
    /// Times the scene's extent: larger Gaussians are removed once opacities have been reset.
    /// `None`: none are. The original's 0.1 fits cameras spread as wide as what they see; on a ring
    /// around a table it takes away the walls and the floor, again and again.
    pub prune_fraction: Option<f32>,
    /// Gaussians with a larger radius on an image, pixels, are removed once opacities have been
    /// reset. `None`: none are, as in the original, which names 20 pixels but forgets the radii
    /// just before it looks at them.
    pub prune_radius: Option<f32>,
    /// Iterations between two resets of the opacities (supplement: 3000).
    pub opacity_reset_interval: u32,
    /// A reset that falls into the last so many iterations of a call waits for the next call: the
    /// map is looked at between calls, and after a reset it is worse for more than a thousand
    /// iterations. Refinements of 400 iterations never reset; long trainings do. 0: never wait.
    pub opacity_reset_margin: u32,
    /// No Gaussians are added beyond this number, which keeps a refinement within seconds (ours).
    /// One densification takes at most a sixteenth of what is left, the busiest Gaussians first, so
    /// that views that come later find room too.
    pub max_gaussians: usize,
    /// So many iterations at the end of a call look at the views at full resolution, those before at
    /// half of it, which costs a third. `None`: all at full resolution, as in the original.
    pub fine_iterations: Option<u32>,
    /// Views at half the resolution are drawn with the low-pass of full pixels and of their mean, which
    /// is narrower in their wider pixels: nearer to the means of full pixels, so that Gaussians shrink
    /// less there, to grow again at full resolution (ours).
    pub matched_low_pass: bool,
    /// Iterations of the original that one step stands for: a call takes so many times fewer steps,
    /// and all that is due by iteration comes as often in it as ever. Calls whose lengths are
    /// multiples of this do together what one long call does. 1: every iteration is a step (ours).
    pub step_iterations: u32,
    /// Times all learning rates; larger steps where there are fewer of them (ours).
    pub rate_gain: f32,
    /// In the first so many steps after new views came to a trained map, every second looks at these
    /// (ours). 0: in shuffled rounds only, as in the original.
    pub favour_new: u32,
    /// Extent of the scene, metres; `None`: 1.1 times the largest distance of a camera from the
    /// cameras' mean, as in the original.
    pub extent: Option<f32>,
    /// RGB behind everything, in [0, 1].
    pub background: [f32; 3],
    /// Seed of the order of the views and of the places of split Gaussians.
    pub seed: u64,
}

impl Default for TrainerConfig {
    fn default() -> Self {
        Self {
            position_rate: 1.6e-4,
            position_rate_end: 1.6e-6,
            position_steps: 30_000,
            feature_rate: 2.5e-3,
            opacity_rate: 2.5e-2,
            scale_rate: 5e-3,
            rotation_rate: 1e-3,
            lambda_dssim: 0.2,
            degree: MAX_DEGREE,
            degree_interval: 1000,
            densify_start: 500,
            densify_end: 15_000,
            densify_interval: 100,
            densify_gradient: 2e-4,
            dense_fraction: 0.01,
            prune_opacity: 0.005,
            prune_fraction: None,
            prune_radius: None,
            opacity_reset_interval: 3000,
            opacity_reset_margin: 1000,
            max_gaussians: 40_000,
            fine_iterations: None,
            matched_low_pass: false,
            step_iterations: 1,
            rate_gain: 1.0,
            favour_new: 0,
            extent: None,
            background: [0.0; 3],
            seed: 0,
        }
    }
}

impl TrainerConfig {
    /// Refuses values out of range, by name.
    ///
    /// # Errors
    /// Names the first such value, what was found and what is expected.
    pub fn check(&self) -> Result<(), SplatError> {
        let positive = [
            ("position_rate", self.position_rate),
            ("position_rate_end", self.position_rate_end),
            ("feature_rate", self.feature_rate),
            ("opacity_rate", self.opacity_rate),
            ("scale_rate", self.scale_rate),
            ("rotation_rate", self.rotation_rate),
            ("densify_gradient", self.densify_gradient),
            ("dense_fraction", self.dense_fraction),
            ("rate_gain", self.rate_gain),
            ("prune_fraction", self.prune_fraction.unwrap_or(1.0)),
            ("prune_radius", self.prune_radius.unwrap_or(1.0)),
            ("extent", self.extent.unwrap_or(1.0)),
        ];
        let refuse = |name: &str, value: String, expected: &str| {
            Err(SplatError::Input(format!("{name} must be {expected}, found {value}")))
        };
        if let Some((name, v)) = positive.iter().find(|(_, v)| !v.is_finite() || *v <= 0.0) {
            return refuse(name, v.to_string(), "finite and positive");
        }
        let fractions = [
            ("lambda_dssim", self.lambda_dssim),
            ("prune_opacity", self.prune_opacity),
            ("background", self.background[0]),
            ("background", self.background[1]),
            ("background", self.background[2]),
        ];
        if let Some((name, v)) = fractions.iter().find(|(_, v)| !(0.0..=1.0).contains(v)) {
            return refuse(name, v.to_string(), "in [0, 1]");
        }
        let counts = [
            ("position_steps", self.position_steps),
            ("degree_interval", self.degree_interval),
            ("densify_interval", self.densify_interval),
            ("opacity_reset_interval", self.opacity_reset_interval),
            ("step_iterations", self.step_iterations),
        ];
        if let Some((name, v)) = counts.iter().find(|(_, v)| *v == 0) {
            return refuse(name, v.to_string(), "at least 1");
        }
        let most = self.densify_interval.min(self.opacity_reset_interval);
        if self.step_iterations > most {
            let expected = format!("at most {most}, the shorter of densify_interval and opacity_reset_interval");
            return refuse("step_iterations", self.step_iterations.to_string(), &expected);
        }
        if self.degree > MAX_DEGREE {
            return refuse("degree", self.degree.to_string(), "at most 3");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_named() {
        TrainerConfig::default().check().unwrap();
        let message = |config: TrainerConfig| config.check().unwrap_err().to_string();
        let config = TrainerConfig { scale_rate: f32::NAN, ..TrainerConfig::default() };
        assert_eq!(message(config), "scale_rate must be finite and positive, found NaN");
        let config = TrainerConfig { lambda_dssim: 1.5, ..TrainerConfig::default() };
        assert_eq!(message(config), "lambda_dssim must be in [0, 1], found 1.5");
        let config = TrainerConfig { densify_interval: 0, ..TrainerConfig::default() };
        assert_eq!(message(config), "densify_interval must be at least 1, found 0");
        let config = TrainerConfig { step_iterations: 101, ..TrainerConfig::default() };
        assert!(message(config).starts_with("step_iterations must be at most 100, the shorter of"));
        let config = TrainerConfig { degree: 4, ..TrainerConfig::default() };
        assert_eq!(message(config), "degree must be at most 3, found 4");
    }
}
