//! Grey rows, in units in which 8-bit images are whole numbers.
//!
//! `0.299 R + 0.587 G + 0.114 B` of bytes, in thousandths, is an integer of at most 255 000, and
//! so are the Sobel sums of it (at most 1 020 000 < 2²⁴): `f32` holds them without rounding, and
//! two colours of the same grey have no gradient between them.

use rayon::prelude::*;

use crate::error::{EvidenceError, finite};
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
        let pixels = self.row(y);
        #[cfg(target_arch = "x86_64")]
        if AVX2 {
            // SAFETY: `AVX2` is only true where the machine has it.
            return unsafe { bytes_avx2(pixels, out) };
        }
        bytes(pixels, out);
    }
}

#[inline(always)]
fn bytes(pixels: &[[u8; 3]], out: &mut [f32]) {
    for (o, &[r, g, b]) in out.iter_mut().zip(pixels) {
        *o = (299 * i32::from(r) + 587 * i32::from(g) + 114 * i32::from(b)) as f32;
    }
}

/// The same integers, eight pixels at a time: two shuffles spread the bytes to 16 bits, as
/// `R G` and `B 0` pairs, and a multiply-add of pairs weighs them.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
fn bytes_avx2(pixels: &[[u8; 3]], out: &mut [f32]) {
    use std::arch::x86_64::*;

    // Pixels 0..4 start at byte 0 of the low half, pixels 4..8 at byte 4 of the high half.
    let pick = |first: i8, second: i8| {
        let at = |start: i8, pixel: i8, channel: i8| if channel < 0 { -1 } else { start + 3 * pixel + channel };
        let mut index = [-1i8; 32];
        for pixel in 0..8i8 {
            let start = if pixel < 4 { 0 } else { 4 };
            index[4 * pixel as usize] = at(start, pixel % 4, first);
            index[4 * pixel as usize + 2] = at(start, pixel % 4, second);
        }
        // SAFETY: 32 bytes are read from an array of 32.
        unsafe { _mm256_loadu_si256(index.as_ptr().cast()) }
    };
    let (red_green, blue) = (pick(0, 1), pick(2, -1));
    let weights = |low: i32, high: i32| _mm256_set1_epi32(high << 16 | low);
    let (w_red_green, w_blue) = (weights(299, 587), weights(114, 0));

    let (blocks, rest) = pixels.as_chunks::<8>();
    let (out_blocks, out_rest) = out.as_chunks_mut::<8>();
    for (block, out) in blocks.iter().zip(out_blocks) {
        let bytes = block.as_ptr().cast::<u8>();
        // SAFETY: bytes 0..16 and 8..24 of the block's 24; eight floats are written to eight.
        unsafe {
            let (low, high) = (_mm_loadu_si128(bytes.cast()), _mm_loadu_si128(bytes.add(8).cast()));
            let both = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(low), high);
            let rg = _mm256_madd_epi16(_mm256_shuffle_epi8(both, red_green), w_red_green);
            let b = _mm256_madd_epi16(_mm256_shuffle_epi8(both, blue), w_blue);
            _mm256_storeu_ps(out.as_mut_ptr(), _mm256_cvtepi32_ps(_mm256_add_epi32(rg, b)));
        }
    }
    bytes(rest, out_rest);
}

impl GreySource for View<'_, [f32; 3]> {
    #[inline(always)]
    fn row<const AVX2: bool>(&self, y: usize, out: &mut [f32]) {
        for (o, &[r, g, b]) in out.iter_mut().zip(self.row(y)) {
            *o = 76_245.0 * r + 149_685.0 * g + 29_070.0 * b;
        }
    }
}

/// A float image in 8 bits, `255 clip(v, 0, 1)` to the nearest (ties to even), in parallel.
///
/// # Errors
/// NaN or an infinity.
pub fn quantize(view: View<'_, [f32; 3]>) -> Result<Vec<[u8; 3]>, EvidenceError> {
    const BLOCK: usize = 1 << 14;
    let mut bytes = vec![[0u8; 3]; view.as_slice().len()];
    let blocks = bytes.par_chunks_mut(BLOCK).zip(view.as_slice().par_chunks(BLOCK));
    let all_finite = blocks
        .map(|(out, values)| block_to_bytes(values.as_flattened(), out.as_flattened_mut()))
        .reduce(|| true, |a, b| a && b);
    if !all_finite {
        finite("rendered", view.as_slice().as_flattened())?;
    }
    Ok(bytes)
}

/// Whether all values were finite; bytes of those that are not mean nothing.
fn block_to_bytes(values: &[f32], out: &mut [u8]) -> bool {
    #[cfg(target_arch = "x86_64")]
    if fuse_camera::simd::level() >= fuse_camera::simd::Level::Avx2Fma {
        // SAFETY: the level is only chosen on a machine that has AVX2.
        return unsafe { block_to_bytes_avx2(values, out) };
    }
    block_to_bytes_at(values, out)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn block_to_bytes_avx2(values: &[f32], out: &mut [u8]) -> bool {
    block_to_bytes_at(values, out)
}

#[inline(always)]
fn block_to_bytes_at(values: &[f32], out: &mut [u8]) -> bool {
    let mut largest = 0;
    for (o, &v) in out.iter_mut().zip(values) {
        // The exponent of NaN and infinities is all ones.
        largest = largest.max(v.to_bits() & 0x7f80_0000);
        // At 2²³ floats are whole numbers: the sum is rounded, and its last byte is the number.
        *o = (v.clamp(0.0, 1.0) * 255.0 + 8_388_608.0).to_bits() as u8;
    }
    largest < 0x7f80_0000
}
