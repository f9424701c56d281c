//! The grounding score of a candidate region.

use crate::depth::{MIN_REGION_PX, RegionDepth};
use crate::error::{EvidenceError, in_range};

/// How confidence and proximity are weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundingOptions {
    /// `λ_s`, weight of the segmenter's confidence.
    pub semantic_weight: f32,
    /// `λ_d`, weight of depth proximity.
    pub depth_weight: f32,
    /// A region with fewer pixels cannot set the score.
    pub min_region_px: usize,
}

impl Default for GroundingOptions {
    /// The supplement's 0.7 and 0.3 (the main text has 1 and 1), 500 pixels.
    fn default() -> Self {
        Self { semantic_weight: 0.7, depth_weight: 0.3, min_region_px: MIN_REGION_PX }
    }
}

/// `r = λ_s s + λ_d d`; `None` for a region that is too small to set the score.
///
/// # Errors
/// A confidence outside `[0, 1]` or NaN; weights that are negative or not finite.
pub fn grounding_score(
    confidence: f32,
    region: &RegionDepth,
    options: &GroundingOptions,
) -> Result<Option<f32>, EvidenceError> {
    in_range("score", confidence, (0.0..=1.0).contains(&confidence), "in [0, 1]")?;
    for w in [options.semantic_weight, options.depth_weight] {
        in_range("weights", w, w.is_finite() && w >= 0.0, "finite and not negative")?;
    }
    Ok(region
        .is_valid(options.min_region_px)
        .then(|| options.semantic_weight * confidence + options.depth_weight * region.proximity()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const REGION: RegionDepth = RegionDepth { pixels: 500, mean_m: Some(0.75) };

    #[test]
    fn weighs_confidence_and_proximity() {
        let score = |options: &GroundingOptions| grounding_score(0.8, &REGION, options).unwrap().unwrap();
        assert!((score(&GroundingOptions::default()) - 0.71).abs() < 1e-6);
        let text = GroundingOptions { semantic_weight: 1.0, depth_weight: 1.0, ..Default::default() };
        assert!((score(&text) - 1.3).abs() < 1e-6);
    }

    #[test]
    fn a_small_region_sets_no_score_however_near() {
        let small = RegionDepth { pixels: 499, mean_m: Some(0.1) };
        assert_eq!(grounding_score(1.0, &small, &GroundingOptions::default()), Ok(None));
    }

    #[test]
    fn without_depth_confidence_alone_counts() {
        let blind = RegionDepth { pixels: 900, mean_m: None };
        assert_eq!(grounding_score(1.0, &blind, &GroundingOptions::default()), Ok(Some(0.7)));
    }

    #[test]
    fn refuses_what_is_no_confidence() {
        for bad in [f32::NAN, -0.1, 1.1] {
            assert!(grounding_score(bad, &REGION, &GroundingOptions::default()).is_err());
        }
    }
}
