//! Semantic evidence and geometric uncertainty in one map.

use fuse_camera::Buffer;

use crate::error::{EvidenceError, finite, in_range};
use crate::view::View;

/// `E = w_s S + w_g U_geo` (supplement; both weights are 1 in the paper).
///
/// # Errors
/// Maps of two sizes, values that are not finite, weights that are negative or not finite.
pub fn fuse(
    semantic: &Buffer<f32>,
    geometric: &Buffer<f32>,
    semantic_weight: f32,
    geometric_weight: f32,
) -> Result<Buffer<f32>, EvidenceError> {
    fuse_views(semantic.into(), geometric.into(), semantic_weight, geometric_weight)
}

/// [`fuse`] for borrowed maps.
///
/// # Errors
/// As [`fuse`].
pub fn fuse_views(
    semantic: View<'_, f32>,
    geometric: View<'_, f32>,
    semantic_weight: f32,
    geometric_weight: f32,
) -> Result<Buffer<f32>, EvidenceError> {
    for (name, w) in [("semantic_weight", semantic_weight), ("geometric_weight", geometric_weight)] {
        in_range(name, w, w.is_finite() && w >= 0.0, "finite and not negative")?;
    }
    combine(semantic, geometric, |s, g| semantic_weight * s + geometric_weight * g)
}

/// `U_func = (1 − S) + U_geo` (main text): recorded as a diagnostic, planned with only on request.
///
/// # Errors
/// Maps of two sizes, values that are not finite.
pub fn functional_uncertainty(semantic: View<'_, f32>, geometric: View<'_, f32>) -> Result<Buffer<f32>, EvidenceError> {
    combine(semantic, geometric, |s, g| 1.0 - s + g)
}

fn combine(
    semantic: View<'_, f32>,
    geometric: View<'_, f32>,
    f: impl Fn(f32, f32) -> f32,
) -> Result<Buffer<f32>, EvidenceError> {
    geometric.same_size("geometric", &semantic, "semantic")?;
    finite("semantic", semantic.as_slice())?;
    finite("geometric", geometric.as_slice())?;
    let mut out = Buffer::filled(semantic.width(), semantic.height(), 0.0);
    for ((o, &s), &g) in out.as_mut_slice().iter_mut().zip(semantic.as_slice()).zip(geometric.as_slice()) {
        *o = f(s, g);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: &[f32]) -> Buffer<f32> {
        Buffer::from_vec(values.len() as u32, 1, values.to_vec()).unwrap()
    }

    #[test]
    fn weighs_and_adds() {
        let (s, g) = (map(&[1.0, 0.5]), map(&[0.25, 0.5]));
        assert_eq!(fuse(&s, &g, 1.0, 1.0).unwrap().into_vec(), [1.25, 1.0]);
        assert_eq!(fuse(&s, &g, 0.0, 2.0).unwrap().into_vec(), [0.5, 1.0]);
        let u = functional_uncertainty((&s).into(), (&g).into()).unwrap();
        assert_eq!(u.into_vec(), [0.25, 1.0]);
    }

    #[test]
    fn refuses_other_sizes_and_nan() {
        let text = |s: &[f32], g: &[f32], w| fuse(&map(s), &map(g), w, 1.0).unwrap_err().to_string();
        assert_eq!(text(&[0.0], &[0.0; 2], 1.0), "geometric must be 1x1 pixels like semantic, found 2x1");
        assert_eq!(text(&[0.0; 9], &[f32::NAN; 9], 1.0), "geometric must be finite, found NaN at flat index 0");
        assert_eq!(text(&[0.0], &[0.0], -1.0), "semantic_weight must be finite and not negative, found -1");
    }
}
