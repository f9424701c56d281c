//! Structural signal-to-noise ratio between an observation and a rendering of the map.
//!
//! With Sobel gradients `∇I` (observed) and `∇R` (rendered) and 11×11 windows `N(u)`:
//!
//! ```text
//! A(u) = Σ_{v ∈ N(u)} |∇I(v)|²
//! B(u) = Σ_{v ∈ N(u)} (|∇I(v)| − |∇R(v)|)²        magnitudes (the supplement), or
//!        Σ_{v ∈ N(u)} |∇I(v) − ∇R(v)|²            vectors
//! SSNR(u) = 10 log₁₀ ((A(u) + ε) / (B(u) + ε)),    ε = 1e-8, clipped to ±30 dB
//! U_geo(u) = α (1 − (SSNR(u) + 30) / 60),          α = 0.8
//! ```
//!
//! Grey is `0.299 R + 0.587 G + 0.114 B` in `[0, gray_range]`, not rounded. The Sobel kernels are
//! 3×3 and not normalised. Borders are reflected without repeating the edge pixel (OpenCV's
//! `BORDER_REFLECT_101`), for gradients and for window sums.

mod band;
mod grey;
mod rows;

use fuse_camera::Buffer;

use crate::error::{EvidenceError, finite, in_range};
use crate::recycle;
use crate::view::View;
use band::{Band, Finish};
use grey::{GreySource, UNITS};

/// Regulariser of both window sums, for grey in `[0, 1]`.
pub const EPSILON: f64 = 1e-8;
/// SSNR is clipped to `[-CLIP_DB, CLIP_DB]`.
pub const CLIP_DB: f32 = 30.0;
/// Scale of geometric uncertainty in the paper.
pub const ALPHA: f32 = 0.8;

/// What is compared with the observation.
#[derive(Clone, Copy, Debug)]
pub enum Rendered<'a> {
    /// 8-bit sRGB.
    U8(View<'a, [u8; 3]>),
    /// sRGB in `[0, 1]`; clipped and rounded to 8 bits, like the observation.
    Quantized(View<'a, [f32; 3]>),
    /// sRGB in `[0, 1]`, used as it is.
    F32(View<'a, [f32; 3]>),
}

/// How gradients are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gradient {
    /// `(|∇I| − |∇R|)²`.
    #[default]
    Magnitude,
    /// `|∇I − ∇R|²`.
    Vector,
}

/// What the paper leaves open about SSNR.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SsnrOptions {
    /// Largest grey value, 1 or 255 as a rule: matters only against [`EPSILON`].
    pub gray_range: f32,
    /// How gradients are compared.
    pub gradient: Gradient,
    /// SSNR in decibels where there is no rendering.
    pub missing_db: f32,
}

impl Default for SsnrOptions {
    /// Grey in `[0, 1]`, magnitudes, 0 dB without a rendering.
    fn default() -> Self {
        Self { gray_range: 1.0, gradient: Gradient::Magnitude, missing_db: 0.0 }
    }
}

/// How SSNR becomes an uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normalization {
    /// `α (1 − (SSNR + 30) / 60)` (supplement).
    #[default]
    Decibel,
    /// `α (1 − Norm(A / (B + ε)))` with `Norm` from the image's smallest to its largest value
    /// (main text, the evidence map). An image that is alike everywhere gives `α / 2`.
    Spatial,
}

/// Settings of [`geometric_uncertainty`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertaintyOptions {
    /// The comparison itself.
    pub ssnr: SsnrOptions,
    /// From SSNR to uncertainty.
    pub normalization: Normalization,
    /// Largest uncertainty, `α`.
    pub alpha: f32,
}

impl Default for UncertaintyOptions {
    fn default() -> Self {
        Self { ssnr: SsnrOptions::default(), normalization: Normalization::Decibel, alpha: ALPHA }
    }
}

/// SSNR in decibels, clipped to ±30. Without a rendering: `options.missing_db` everywhere.
///
/// # Errors
/// Images of two sizes; a rendering with NaN or infinities; options out of range.
pub fn ssnr(
    observed: View<'_, [u8; 3]>,
    rendered: Option<Rendered<'_>>,
    options: &SsnrOptions,
) -> Result<Buffer<f32>, EvidenceError> {
    check(options)?;
    match rendered {
        None => Ok(Buffer::filled(observed.width(), observed.height(), options.missing_db)),
        Some(r) => compare(observed, r, options, Finish::Decibel { scale: 1.0, offset: 0.0 }),
    }
}

/// Geometric uncertainty in `[0, alpha]`: high where the map explains the observation badly.
/// Without a rendering: that of `missing_db` everywhere (0.4 by default).
///
/// # Errors
/// As [`ssnr`]; also an `alpha` that is negative or not finite.
pub fn geometric_uncertainty(
    observed: View<'_, [u8; 3]>,
    rendered: Option<Rendered<'_>>,
    options: &UncertaintyOptions,
) -> Result<Buffer<f32>, EvidenceError> {
    check(&options.ssnr)?;
    let alpha = options.alpha;
    in_range("alpha", alpha, alpha.is_finite() && alpha >= 0.0, "finite and not negative")?;
    // α (1 − (dB + 30) / 60) = α / 2 − dB α / 60
    let (scale, offset) = (-alpha / (2.0 * CLIP_DB), 0.5 * alpha);
    match (rendered, options.normalization) {
        (None, _) => {
            let value = options.ssnr.missing_db * scale + offset;
            Ok(Buffer::filled(observed.width(), observed.height(), value))
        }
        (Some(r), Normalization::Decibel) => compare(observed, r, &options.ssnr, Finish::Decibel { scale, offset }),
        (Some(r), Normalization::Spatial) => {
            let mut ratio = compare(observed, r, &options.ssnr, Finish::Ratio)?;
            invert(ratio.as_mut_slice(), alpha);
            Ok(ratio)
        }
    }
}

/// `α (1 − (v − min) / (max − min))` in place; `α / 2` when all are alike.
fn invert(values: &mut [f32], alpha: f32) {
    let (min, max) = values.iter().fold((f32::INFINITY, 0.0f32), |(lo, hi), &v| (lo.min(v), hi.max(v)));
    let range = max - min;
    for v in values {
        *v = if range > 0.0 { alpha * (1.0 - (*v - min) / range) } else { 0.5 * alpha };
    }
}

fn check(options: &SsnrOptions) -> Result<(), EvidenceError> {
    let (range, missing) = (options.gray_range, options.missing_db);
    in_range("gray_range", range, range.is_finite() && range > 0.0, "positive and finite")?;
    in_range("missing_db", missing, (-CLIP_DB..=CLIP_DB).contains(&missing), "in [-30, 30] dB")
}

fn compare(
    observed: View<'_, [u8; 3]>,
    rendered: Rendered<'_>,
    options: &SsnrOptions,
    finish: Finish,
) -> Result<Buffer<f32>, EvidenceError> {
    let data = match rendered {
        Rendered::U8(r) => {
            r.same_size("rendered", &observed, "observed")?;
            bands(observed, r, options, finish)
        }
        Rendered::Quantized(r) => {
            r.same_size("rendered", &observed, "observed")?;
            let bytes = grey::quantize(r)?;
            bands(observed, View::new("rendered", r.width(), r.height(), &bytes)?, options, finish)
        }
        Rendered::F32(r) => {
            r.same_size("rendered", &observed, "observed")?;
            finite("rendered", r.as_slice().as_flattened())?;
            bands(observed, r, options, finish)
        }
    };
    let expected = data.len();
    Buffer::from_vec(observed.width(), observed.height(), data).map_err(|_| EvidenceError::Length {
        argument: "observed",
        found: 0,
        expected,
    })
}

/// Splits the image into bands of rows, one task each. A pixel's value does not depend on the
/// band that it is in: window sums are added in a fixed order, never updated from a neighbour's.
fn bands(observed: View<'_, [u8; 3]>, rendered: impl GreySource, options: &SsnrOptions, finish: Finish) -> Vec<f32> {
    let (width, height) = (observed.width() as usize, observed.height() as usize);
    // The kernels count grey in whole units, so ε is what is scaled.
    let unit = UNITS / f64::from(options.gray_range);
    let band = Band { width, height, epsilon: (EPSILON * unit * unit) as f32, gradient: options.gradient, finish };
    let mut data = recycle::take(width * height);
    let mut parts = data.spare_capacity_mut()[..width * height].chunks_mut(rows_per_band(height) * width);
    rayon::in_place_scope(|scope| {
        // This thread takes the first band, which saves it from waiting for another to wake.
        let mine = parts.next();
        for (i, part) in (1..).zip(parts) {
            let rendered = &rendered;
            scope.spawn(move |_| band.run(i * rows_per_band(height), &observed, rendered, part));
        }
        if let Some(part) = mine {
            band.run(0, &observed, &rendered, part);
        }
    });
    // SAFETY: the parts make up the whole, and each band has written all of its own; a band that
    // panics is passed on by the scope.
    unsafe { data.set_len(width * height) };
    data
}

/// An even number of rows, so that bands of any height pair the same rows. One band a thread: each
/// makes ten rows of its neighbours again.
fn rows_per_band(height: usize) -> usize {
    let threads = rayon::current_num_threads();
    height.div_ceil(2 * threads).max(16) * 2
}

#[cfg(test)]
mod tests;
