//! What a real camera makes of an exact picture: blur, exposure and noise of its colours, noise of its depth.
//!
//! | stage | what it does |
//! | --- | --- |
//! | defocus, motion (`blur.rs`) | each point of light becomes a disc, then a streak |
//! | exposure | linear light times `2^stops` |
//! | shot and read noise (`color.rs`) | variance `shot² v + read²` for linear light `v`, each channel by itself |
//! | depth noise (`depth.rs`) | deviation `a + b z²`, lost pixels along edges, steps of inverse depth |
//!
//! Everything is off by default, and what is off changes no byte. Colours are worked on in linear light: sRGB is
//! undone before and done again, with clipping, after. Ids are never touched. Random numbers are a function of view,
//! pixel and stage (`random.rs`), not of the order of the work: the same bits on any number of threads and at any
//! SIMD level.

mod blur;
mod color;
mod depth;
mod random;

use serde::Deserialize;

use crate::Frame;
use random::Key;

/// Largest diameter of the disc, pixels; the work grows with its square.
const MAX_DEFOCUS_PX: f32 = 16.0;
/// Longest streak, pixels.
const MAX_MOTION_PX: f32 = 64.0;

/// An optional camera between the renderer and whoever looks; [`Sensor::default`] changes nothing.
///
/// Linear light is 1 at white, the largest value that the picture can hold.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// Chooses the noise, for who makes the number of a view from it.
    pub seed: u64,
    /// Exposure, stops: linear light times `2^stops`; -8 to 8.
    pub exposure_stops: f32,
    /// Standard deviation of what each view's exposure is off by, stops; 0 to 4.
    pub exposure_jitter_stops: f32,
    /// Diameter of the disc that defocus makes of a point, pixels, the same all over the picture; 0 to 16.
    pub defocus_px: f32,
    /// Length of the streak that motion makes of a point, pixels; 0 to 64.
    pub motion_px: f32,
    /// Direction of the streak, degrees from the rows (0) towards the columns (90).
    pub motion_deg: f32,
    /// Standard deviation of the shot noise at white, share of white: `1 / √(electrons at white)`; 0 to 1.
    pub shot_noise: f32,
    /// Standard deviation of the read noise, share of white; 0 to 1.
    pub read_noise: f32,
    /// `a` of the depth's standard deviation `a + b z²`, metres; 0 to 1.
    pub depth_noise_m: f32,
    /// `b` of the depth's standard deviation `a + b z²`, 1/m; 0 to 1.
    pub depth_noise_per_m: f32,
    /// Chance that a pixel beside a jump of the depth is lost (0); 0 to 1.
    pub depth_edge_dropout: f32,
    /// Step of inverse depth, 1/m: depths are `1 / (k · step)` for whole `k`, `step z²` apart; 0 to 1, 0 for none.
    pub depth_step_per_m: f32,
}

/// A setting out of its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("sensor: {name} must be from {low} to {high}, found {found}")]
pub struct SensorError {
    name: &'static str,
    low: f32,
    high: f32,
    found: f32,
}

impl Sensor {
    /// Refuses settings out of their ranges, NaN among them.
    ///
    /// # Errors
    /// [`SensorError`] names the first.
    pub fn check(&self) -> Result<(), SensorError> {
        let ranges = [
            ("exposure_stops", self.exposure_stops, -8.0, 8.0),
            ("exposure_jitter_stops", self.exposure_jitter_stops, 0.0, 4.0),
            ("defocus_px", self.defocus_px, 0.0, MAX_DEFOCUS_PX),
            ("motion_px", self.motion_px, 0.0, MAX_MOTION_PX),
            ("motion_deg", self.motion_deg, -360.0, 360.0),
            ("shot_noise", self.shot_noise, 0.0, 1.0),
            ("read_noise", self.read_noise, 0.0, 1.0),
            ("depth_noise_m", self.depth_noise_m, 0.0, 1.0),
            ("depth_noise_per_m", self.depth_noise_per_m, 0.0, 1.0),
            ("depth_edge_dropout", self.depth_edge_dropout, 0.0, 1.0),
            ("depth_step_per_m", self.depth_step_per_m, 0.0, 1.0),
        ];
        match ranges.into_iter().find(|(_, found, low, high)| !(low..=high).contains(&found)) {
            None => Ok(()),
            Some((name, found, low, high)) => Err(SensorError { name, low, high, found }),
        }
    }

    /// What it makes of an exact frame; ids stay. `view` stands for seed and view: the same number gives the same
    /// noise. Settings are those that [`Sensor::check`] lets through.
    pub fn expose(&self, frame: &mut Frame, view: u64) {
        let key = Key::new(view);
        color::expose(self, key, &mut frame.rgb);
        depth::measure(self, key, &mut frame.depth);
    }
}
