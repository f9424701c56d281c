//! Metrics that know the truth (supplement, "Metric computation").

/// Keeps quotients finite; far below one pixel or one micrometre.
const EPSILON: f64 = 1e-9;

/// Two masks, or a mask and an image, of different sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("masks must have the same number of pixels, found {0} and {1}")]
pub struct SizeMismatch(pub usize, pub usize);

/// `|a ∩ b| / |a ∪ b|`; 0 when both are empty.
pub fn iou(a: &[bool], b: &[bool]) -> Result<f64, SizeMismatch> {
    if a.len() != b.len() {
        return Err(SizeMismatch(a.len(), b.len()));
    }
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let any = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    Ok(if any == 0 { 0.0 } else { both as f64 / any as f64 })
}

/// `clip((P - P_min) / (P_max - P_min + ε), 0, 1)`: how large the target is, against the range over
/// the viewpoints.
pub fn pixel_ratio(pixels: f64, least: f64, most: f64) -> f64 {
    ((pixels - least) / (most - least + EPSILON)).clamp(0.0, 1.0)
}

/// `clip((D_max - D) / (D_max - D_min + ε), 0, 1)`: how near the target is, against the range over
/// the viewpoints.
pub fn distance_score(distance: f64, least: f64, most: f64) -> f64 {
    ((most - distance) / (most - least + EPSILON)).clamp(0.0, 1.0)
}

/// One minus the distance of the mask's centroid from the image's centre over the distance from
/// centre to corner; 0 for an empty mask. `mask` is row-major with `width` columns.
pub fn center_score(mask: &[bool], width: usize) -> f64 {
    let height = mask.len().checked_div(width).unwrap_or(0);
    let (mut n, mut x, mut y) = (0usize, 0.0, 0.0);
    for i in (0..mask.len()).filter(|i| mask[*i]) {
        n += 1;
        x += (i % width) as f64 + 0.5;
        y += (i / width) as f64 + 0.5;
    }
    if n == 0 {
        return 0.0;
    }
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let off = (x / n as f64 - cx).hypot(y / n as f64 - cy);
    1.0 - off / cx.hypot(cy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iou_counts_pixels() {
        let a = [true, true, false, false];
        assert_eq!(iou(&a, &[false, true, true, false]).unwrap(), 1.0 / 3.0);
        assert_eq!(iou(&a, &a).unwrap(), 1.0);
        assert_eq!(iou(&[false; 4], &[false; 4]).unwrap(), 0.0);
        assert_eq!(iou(&a, &[true]).unwrap_err(), SizeMismatch(4, 1));
    }

    #[test]
    fn ratios_are_clipped_and_survive_an_empty_range() {
        assert!((pixel_ratio(600.0, 200.0, 1000.0) - 0.5).abs() < 1e-9);
        assert_eq!(pixel_ratio(100.0, 200.0, 1000.0), 0.0);
        assert_eq!(pixel_ratio(5.0, 5.0, 5.0), 0.0);
        assert!((distance_score(0.9, 0.7, 1.1) - 0.5).abs() < 1e-8);
        assert_eq!(distance_score(1.3, 0.7, 1.1), 0.0);
    }

    #[test]
    fn center_score_is_one_in_the_middle_and_small_in_a_corner() {
        let mut mask = vec![false; 40 * 30];
        assert_eq!(center_score(&mask, 40), 0.0);
        for i in [14 * 40 + 19, 14 * 40 + 20, 15 * 40 + 19, 15 * 40 + 20] {
            mask[i] = true;
        }
        assert_eq!(center_score(&mask, 40), 1.0);
        let mut corner = vec![false; 40 * 30];
        corner[0] = true;
        // Centroid (0.5, 0.5) against centre (20, 15), corner at distance 25.
        let expected = 1.0 - 19.5f64.hypot(14.5) / 25.0;
        assert!((center_score(&corner, 40) - expected).abs() < 1e-12);
    }
}
