//! Semantic evidence: the strongest detection at each pixel.

use fuse_camera::Buffer;
use rayon::prelude::*;

use crate::error::{EvidenceError, in_range};

/// Pixels of work per task.
const BLOCK: usize = 1 << 14;

/// `S(u) = max_ij s_ij 1[u ∈ m_ij]` over all labels and masks; 0 where no mask is.
///
/// `masks`: row-major, `width * height` each; `scores` in `[0, 1]`, one a mask. With `normalize`
/// the map is divided by its maximum (the main text's "after normalization to [0, 1]"), unless it
/// is zero everywhere.
///
/// # Errors
/// Lengths that do not fit, or a score outside `[0, 1]` or NaN.
pub fn semantic_map(
    width: u32,
    height: u32,
    masks: &[&[bool]],
    scores: &[f32],
    normalize: bool,
) -> Result<Buffer<f32>, EvidenceError> {
    if width == 0 || height == 0 {
        return Err(EvidenceError::TooSmall { argument: "masks", width, height, minimum: 1 });
    }
    if scores.len() != masks.len() {
        return Err(EvidenceError::Length { argument: "scores", found: scores.len(), expected: masks.len() });
    }
    let pixels = width as usize * height as usize;
    for (mask, &score) in masks.iter().zip(scores) {
        if mask.len() != pixels {
            return Err(EvidenceError::Length { argument: "masks", found: mask.len(), expected: pixels });
        }
        in_range("scores", score, (0.0..=1.0).contains(&score), "in [0, 1]")?;
    }

    let mut map = Buffer::filled(width, height, 0.0f32);
    map.as_mut_slice().par_chunks_mut(BLOCK).enumerate().for_each(|(i, out)| {
        for (mask, &score) in masks.iter().zip(scores) {
            for (o, &m) in out.iter_mut().zip(&mask[i * BLOCK..]) {
                *o = o.max(f32::from(u8::from(m)) * score);
            }
        }
    });
    if normalize {
        let largest = map.as_slice().iter().copied().fold(0.0, f32::max);
        if largest > 0.0 {
            map.as_mut_slice().iter_mut().for_each(|v| *v /= largest);
        }
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_mask_wins_at_each_pixel() {
        let (a, b) = ([true, true, false, false], [false, true, true, false]);
        let map = |normalize| semantic_map(4, 1, &[&a, &b], &[0.25, 0.5], normalize).unwrap().into_vec();
        assert_eq!(map(false), [0.25, 0.5, 0.5, 0.0]);
        assert_eq!(map(true), [0.5, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn nothing_detected_is_zero_also_normalised() {
        for normalize in [false, true] {
            assert_eq!(semantic_map(2, 1, &[], &[], normalize).unwrap().into_vec(), [0.0, 0.0]);
            assert_eq!(semantic_map(2, 1, &[&[false; 2]], &[0.7], normalize).unwrap().into_vec(), [0.0, 0.0]);
        }
    }

    #[test]
    fn masks_longer_than_one_block_keep_their_places() {
        let (w, h) = (300, 200);
        let mask: Vec<bool> = (0..w * h).map(|i| i % 7 == 3).collect();
        let map = semantic_map(w as u32, h as u32, &[&mask], &[0.5], false).unwrap();
        assert!(map.as_slice().iter().zip(&mask).all(|(&v, &m)| v == if m { 0.5 } else { 0.0 }));
    }

    #[test]
    fn refuses_what_it_cannot_use() {
        let mask = [true; 4];
        let text = |r: Result<Buffer<f32>, EvidenceError>| r.unwrap_err().to_string();
        assert_eq!(text(semantic_map(2, 2, &[&mask], &[f32::NAN], false)), "scores must be in [0, 1], found NaN");
        assert_eq!(text(semantic_map(2, 2, &[&mask], &[], false)), "scores must have 1 elements, found 0");
        assert_eq!(text(semantic_map(3, 2, &[&mask], &[0.1], false)), "masks must have 6 elements, found 4");
    }
}
