//! Grey rows, in units in which 8-bit images are whole numbers.
//!
//! `0.299 R + 0.587 G + 0.114 B` of bytes, in thousandths, is an integer of at most 255 000, and
//! so are the Sobel sums of it (at most 1 020 000 < 2²⁴): `f32` holds them without rounding, and
//! two colours of the same grey have no gradient between them.

use crate::view::View;

/// White in units of a grey row.
pub const UNITS: f64 = 255_000.0;

/// Something that has rows of grey.
pub trait GreySource: Sync {
    /// Writes row `y` in units of 1 / [`UNITS`] to `out`, as long as the image is wide.
    fn row<const AVX2: bool>(&self, y: usize, out: &mut [f32]);
}

impl GreySource for View<'_, [u8; 3]> {
    #[inline(always)]
    fn row<const AVX2: bool>(&self, y: usize, out: &mut [f32]) {
        for (o, &[r, g, b]) in out.iter_mut().zip(self.row(y)) {
            *o = (299 * i32::from(r) + 587 * i32::from(g) + 114 * i32::from(b)) as f32;
        }
    }
}

impl GreySource for View<'_, [f32; 3]> {
    #[inline(always)]
    fn row<const AVX2: bool>(&self, y: usize, out: &mut [f32]) {
        for (o, &[r, g, b]) in out.iter_mut().zip(self.row(y)) {
            *o = 76_245.0 * r + 149_685.0 * g + 29_070.0 * b;
        }
    }
}

/// A float image seen through 8 bits: `floor(255 clip(v, 0, 1) + 1/2)`.
pub struct Quantized<'a>(pub View<'a, [f32; 3]>);

impl GreySource for Quantized<'_> {
    #[inline(always)]
    fn row<const AVX2: bool>(&self, y: usize, out: &mut [f32]) {
        // Finite and in range, so truncation is the floor.
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as i32;
        for (o, &[r, g, b]) in out.iter_mut().zip(self.0.row(y)) {
            *o = (299 * byte(r) + 587 * byte(g) + 114 * byte(b)) as f32;
        }
    }
}
