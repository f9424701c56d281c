//! The grounding score of a candidate region.

use crate::depth::MIN_REGION_PX;
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
/// `confidence` is the segmenter's `s`, `proximity` the region's `d`, both in `[0, 1]`; without a
/// depth picture (`None`) the depth term is off.
///
/// # Errors
/// A confidence or proximity outside `[0, 1]` or NaN; weights that are negative or not finite.
pub fn grounding_score(
    confidence: f32,
    proximity: Option<f32>,
    pixels: usize,
    options: &GroundingOptions,
) -> Result<Option<f32>, EvidenceError> {
    let proximity = proximity.unwrap_or(0.0);
    in_range("score", confidence, (0.0..=1.0).contains(&confidence), "in [0, 1]")?;
    in_range("proximity", proximity, (0.0..=1.0).contains(&proximity), "in [0, 1]")?;
    for w in [options.semantic_weight, options.depth_weight] {
        in_range("weights", w, w.is_finite() && w >= 0.0, "finite and not negative")?;
    }
    let score = options.semantic_weight * confidence + options.depth_weight * proximity;
    Ok((pixels >= options.min_region_px).then_some(score))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(confidence: f32, proximity: Option<f32>, pixels: usize) -> Option<f32> {
        grounding_score(confidence, proximity, pixels, &GroundingOptions::default()).unwrap()
    }

    #[test]
    fn weighs_confidence_and_proximity() {
        assert!((score(0.8, Some(0.5), 500).unwrap() - 0.71).abs() < 1e-6);
        let text = GroundingOptions { semantic_weight: 1.0, depth_weight: 1.0, ..Default::default() };
        assert!((grounding_score(0.8, Some(0.5), 500, &text).unwrap().unwrap() - 1.3).abs() < 1e-6);
    }

    #[test]
    fn a_small_region_sets_no_score_however_near() {
        assert_eq!(score(1.0, Some(1.0), 499), None);
    }

    #[test]
    fn without_depth_confidence_alone_counts() {
        assert_eq!(score(1.0, None, 900), Some(0.7));
    }

    #[test]
    fn refuses_what_is_no_confidence() {
        for bad in [f32::NAN, -0.1, 1.1] {
            assert!(grounding_score(bad, None, 900, &GroundingOptions::default()).is_err());
            assert!(grounding_score(0.5, Some(bad), 900, &GroundingOptions::default()).is_err());
        }
    }
}
