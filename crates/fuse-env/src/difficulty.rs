//! How hard episodes are: every knob in one place, with what it does.

use serde::{Deserialize, Serialize};

use crate::episode::{DISTRACTORS, GOOD_FRACTION, GOOD_PX, START_FRACTION};

/// The knobs; absent ones in JSON are the defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Difficulty {
    /// Bounds of the share of the target that the start shows, within 0.05 to 0.6 (the default). Lower: harder to
    /// recognise before moving.
    pub start_fraction: [f32; 2],
    /// Pixels that the target would have at the start if it stood alone, at least: its hiding must come from other
    /// objects, not from being far away or cut by the picture's edge. Default 500.
    pub start_unoccluded_px: u32,
    /// Actions from the start to the first good view, at least. Default 2: one move does not show it.
    pub least_moves: u32,
    /// Distractors that look or are handled like the target without serving the verb, at most. Default 3.
    pub near_misses: u32,
    /// Distractors that are tall enough to hide something behind them, at most. Default 3.
    pub tall_occluders: u32,
    /// Height from which an object counts as tall, standing as it was made to, metres. Default 0.09.
    pub tall_from_m: f32,
    /// Chance of a further valid object among the distractors, for each of two. Default 0.3.
    pub second_target: f64,
    /// Fewest and most distractors, within 7 to 14; none: as the scene says. Default none.
    pub distractors: Option<[u32; 2]>,
    /// Visible pixels of the target that some reachable view must have, at least 500 (the default).
    pub good_px: u32,
    /// Visible share of the target in that view, at least 0.8 (the default).
    pub good_fraction: f32,
}

impl Default for Difficulty {
    fn default() -> Self {
        Self {
            start_fraction: START_FRACTION,
            start_unoccluded_px: 500,
            least_moves: 2,
            near_misses: 3,
            tall_occluders: 3,
            tall_from_m: 0.09,
            second_target: 0.3,
            distractors: None,
            good_px: GOOD_PX,
            good_fraction: GOOD_FRACTION,
        }
    }
}

/// A knob out of its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("difficulty `{knob}` must be {expected}, found {found}")]
pub struct KnobError {
    knob: &'static str,
    expected: String,
    found: String,
}

impl Difficulty {
    /// Checks every knob.
    pub fn check(&self) -> Result<(), KnobError> {
        let within = |v: f32, [low, high]: [f32; 2]| v >= low && v <= high;
        let [low, high] = self.start_fraction;
        let (least, most) = (START_FRACTION[0], START_FRACTION[1]);
        let ordered = low < high && within(low, START_FRACTION) && within(high, START_FRACTION);
        require("start_fraction", format!("two rising numbers in {least} to {most}"), ordered, &self.start_fraction)?;
        let px = self.start_unoccluded_px;
        require("start_unoccluded_px", "1 to 100000".into(), (1..=100_000).contains(&px), &px)?;
        require("least_moves", "1 to 9".into(), (1..=9).contains(&self.least_moves), &self.least_moves)?;
        require("near_misses", "0 to 14".into(), self.near_misses <= 14, &self.near_misses)?;
        require("tall_occluders", "0 to 14".into(), self.tall_occluders <= 14, &self.tall_occluders)?;
        require("tall_from_m", "0 to 1".into(), within(self.tall_from_m, [0.0, 1.0]), &self.tall_from_m)?;
        let chance = (0.0..=1.0).contains(&self.second_target);
        require("second_target", "0 to 1".into(), chance, &self.second_target)?;
        let [fewest, most] = DISTRACTORS;
        if let Some([low, high]) = self.distractors {
            let inside = fewest <= low && low <= high && high <= most;
            require("distractors", format!("two numbers in {fewest} to {most}"), inside, &[low, high])?;
        }
        let px = (GOOD_PX..=100_000).contains(&self.good_px);
        require("good_px", format!("{GOOD_PX} to 100000"), px, &self.good_px)?;
        let share = within(self.good_fraction, [GOOD_FRACTION, 1.0]);
        require("good_fraction", format!("{GOOD_FRACTION} to 1"), share, &self.good_fraction)
    }
}

fn require(knob: &'static str, expected: String, ok: bool, found: &impl std::fmt::Debug) -> Result<(), KnobError> {
    if ok { Ok(()) } else { Err(KnobError { knob, expected, found: format!("{found:?}") }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_sound_and_mistakes_are_named() {
        Difficulty::default().check().unwrap();
        let wrong = Difficulty { start_fraction: [0.0, 0.5], ..Difficulty::default() };
        assert_eq!(
            wrong.check().unwrap_err().to_string(),
            "difficulty `start_fraction` must be two rising numbers in 0.05 to 0.6, found [0.0, 0.5]"
        );
        let wrong = Difficulty { good_px: 400, ..Difficulty::default() };
        assert!(wrong.check().unwrap_err().to_string().contains("`good_px` must be 500 to 100000, found 400"));
        let wrong = Difficulty { second_target: f64::NAN, ..Difficulty::default() };
        assert!(wrong.check().is_err());
        assert!(
            serde_json::from_str::<Difficulty>("{\"near_mises\": 2}").unwrap_err().to_string().contains("near_mises")
        );
        let read: Difficulty = serde_json::from_str("{\"near_misses\": 5}").unwrap();
        assert_eq!(read, Difficulty { near_misses: 5, ..Difficulty::default() });
    }
}
