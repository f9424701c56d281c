//! Depth proximity of a candidate region (supplement, "Depth-Proximity Stopping Rule").

use crate::error::EvidenceError;
use crate::view::View;

/// Mean depths between which proximity falls from 1 to 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthRange {
    near_m: f64,
    far_m: f64,
}

impl DepthRange {
    /// Proximity is 1 up to `near_m` metres and 0 from `far_m` metres on.
    ///
    /// # Errors
    /// Unless `0 <= near_m < far_m`, both finite.
    pub fn new(near_m: f64, far_m: f64) -> Result<Self, EvidenceError> {
        let wrong = |argument, value, expected| Err(EvidenceError::OutOfRange { argument, value, expected });
        if !(near_m.is_finite() && near_m >= 0.0) {
            return wrong("near", near_m, "finite and not negative");
        }
        if !(far_m.is_finite() && far_m > near_m) {
            return wrong("far", far_m, "finite and greater than near");
        }
        Ok(Self { near_m, far_m })
    }

    /// `d = 1 − clip((z̄ − near) / (far − near), 0, 1)`; 0 without a valid depth.
    pub fn proximity(&self, region: &RegionDepth) -> f32 {
        region.mean_m.map_or(0.0, |z| (1.0 - ((z - self.near_m) / (self.far_m - self.near_m)).clamp(0.0, 1.0)) as f32)
    }
}

impl Default for DepthRange {
    /// The supplement's 0.3 and 1.2 m.
    fn default() -> Self {
        Self { near_m: 0.3, far_m: 1.2 }
    }
}

/// A region with fewer pixels is not valid.
pub const MIN_REGION_PX: usize = 500;

/// What depth says of a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionDepth {
    /// Pixels in the region, with or without depth.
    pub pixels: usize,
    /// Mean of the valid depths in metres; `None` when the region has none.
    pub mean_m: Option<f64>,
}

impl RegionDepth {
    /// Whether the region has enough pixels to be a candidate.
    pub fn is_valid(&self, min_region_px: usize) -> bool {
        self.pixels >= min_region_px
    }
}

/// Mean of the positive, finite depths inside `mask`.
///
/// `depth`: metres; 0, negative, NaN and infinite mean "unknown" and are left out.
///
/// # Errors
/// Images of two sizes.
pub fn region_depth(depth: View<'_, f32>, mask: View<'_, bool>) -> Result<RegionDepth, EvidenceError> {
    mask.same_size("mask", &depth, "depth")?;
    let (mut pixels, mut known, mut sum) = (0usize, 0usize, 0.0f64);
    for (&z, &inside) in depth.as_slice().iter().zip(mask.as_slice()) {
        let valid = inside && z > 0.0 && z.is_finite();
        pixels += usize::from(inside);
        known += usize::from(valid);
        sum += if valid { f64::from(z) } else { 0.0 };
    }
    Ok(RegionDepth { pixels, mean_m: (known > 0).then(|| sum / known as f64) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region(depth: &[f32], mask: &[bool]) -> RegionDepth {
        let n = depth.len() as u32;
        region_depth(View::new("depth", n, 1, depth).unwrap(), View::new("mask", n, 1, mask).unwrap()).unwrap()
    }

    #[test]
    fn proximity_falls_from_near_to_far() {
        for (z, d) in [(0.1, 1.0), (0.3, 1.0), (0.75, 0.5), (1.2, 0.0), (5.0, 0.0)] {
            assert!((DepthRange::default().proximity(&region(&[z], &[true])) - d).abs() < 1e-6, "{z}");
        }
    }

    #[test]
    fn unknown_depths_are_left_out_but_counted_as_pixels() {
        let r =
            region(&[0.5, f32::NAN, 0.0, -1.0, f32::INFINITY, 0.7, 9.0], &[true, true, true, true, true, true, false]);
        assert_eq!(r.pixels, 6);
        assert!((r.mean_m.unwrap() - 0.6).abs() < 1e-7);
    }

    #[test]
    fn no_valid_depth_is_zero() {
        assert_eq!(region(&[f32::NAN, 0.0], &[true; 2]), RegionDepth { pixels: 2, mean_m: None });
        let proximity = |depth: &[f32], mask: &[bool]| DepthRange::default().proximity(&region(depth, mask));
        assert_eq!(proximity(&[f32::NAN, 0.0], &[true; 2]), 0.0);
        assert_eq!(proximity(&[0.4, 0.4], &[false; 2]), 0.0);
    }

    #[test]
    fn validity_starts_at_500_pixels() {
        let r = |n| region(&vec![0.5; 600], &(0..600).map(|i| i < n).collect::<Vec<_>>());
        assert!(!r(499).is_valid(MIN_REGION_PX));
        assert!(r(500).is_valid(MIN_REGION_PX));
    }

    #[test]
    fn refuses_a_mask_of_another_size() {
        let e =
            region_depth(View::new("depth", 2, 2, &[1.0; 4]).unwrap(), View::new("mask", 4, 1, &[true; 4]).unwrap());
        assert_eq!(e.unwrap_err().to_string(), "mask must be 2x2 pixels like depth, found 4x1");
    }

    #[test]
    fn refuses_a_range_that_does_not_fall() {
        let text = |near, far| DepthRange::new(near, far).unwrap_err().to_string();
        assert_eq!(text(0.5, 0.5), "far must be finite and greater than near, found 0.5");
        assert_eq!(text(-0.1, 1.0), "near must be finite and not negative, found -0.1");
        assert!(DepthRange::new(f64::NAN, 1.0).is_err() && DepthRange::new(0.0, f64::INFINITY).is_err());
    }
}
