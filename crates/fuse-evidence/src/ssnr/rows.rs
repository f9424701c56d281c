//! The loops over one row, written so that they vectorise: slices of equal length, no branches.
//!
//! Each is inlined into a caller that is compiled for the level in use; `FMA` says whether that
//! level has a fused multiply-add (without one, `mul_add` is a slow library call).

// One index into many rows says best which pixels meet.
#![allow(clippy::needless_range_loop)]

use std::mem::MaybeUninit;

use super::{CLIP_DB, Gradient};

/// Pixels on either side of the centre of a window.
pub const RADIUS: usize = 5;

#[inline(always)]
fn fma<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// Floats of a row, one of them at the start of a cache line: a load or store of eight floats that
/// straddles two lines costs twice.
pub struct Row {
    data: Vec<f32>,
    start: usize,
    len: usize,
}

impl Row {
    /// `len` zeros, the one at `aligned` at the start of a line.
    pub fn new(len: usize, aligned: usize) -> Self {
        const LINE: usize = 64 / size_of::<f32>();
        let data = vec![0.0; len + 2 * LINE];
        // The heap block stays where it is for as long as the vector is not grown.
        let first = data.as_ptr().align_offset(64).min(LINE);
        Self { data, start: first + (LINE - aligned % LINE) % LINE, len }
    }

    /// The floats.
    #[inline(always)]
    pub fn get(&self) -> &[f32] {
        &self.data[self.start..self.start + self.len]
    }

    /// The floats.
    #[inline(always)]
    pub fn get_mut(&mut self) -> &mut [f32] {
        &mut self.data[self.start..self.start + self.len]
    }
}

/// Index into `0..n` of `i` reflected at the borders without repeating them, as often as needed.
pub fn reflect(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    if last == 0 {
        return 0;
    }
    let folded = i.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// Fills `pad` elements at each end of `row` by reflection of what lies between.
pub fn reflect_ends(row: &mut [f32], pad: usize) {
    let n = row.len() - 2 * pad;
    if n > pad {
        for k in 1..=pad {
            row[pad - k] = row[pad + k];
            row[pad + n - 1 + k] = row[pad + n - 1 - k];
        }
        return;
    }
    for k in 1..=pad {
        row[pad - k] = row[pad + reflect(-(k as isize), n)];
        row[pad + n - 1 + k] = row[pad + reflect((n - 1 + k) as isize, n)];
    }
}

/// Horizontal half of both Sobel kernels, of a grey row that is padded by one at both ends:
/// `across = g[x + 1] − g[x − 1]`, `smooth = g[x − 1] + 2 g[x] + g[x + 1]`.
#[inline(always)]
pub fn horizontal<const FMA: bool>(grey: &[f32], across: &mut [f32], smooth: &mut [f32]) {
    let n = across.len();
    let smooth = &mut smooth[..n];
    let (left, here, right) = (&grey[..n], &grey[1..][..n], &grey[2..][..n]);
    for x in 0..n {
        across[x] = right[x] - left[x];
        smooth[x] = fma::<FMA>(2.0, here[x], left[x] + right[x]);
    }
}

/// What a row's Sobel gradient is made of.
#[derive(Clone, Copy)]
pub struct Neighbourhood<'a> {
    /// `across` of the row above, of the row and of the row below.
    pub across: [&'a [f32]; 3],
    /// `smooth` of the rows above and below.
    pub smooth: [&'a [f32]; 2],
}

impl<'a> Neighbourhood<'a> {
    /// Cut to `n` pixels, so that the compiler sees that all are as long.
    #[inline(always)]
    fn cut(&self, n: usize) -> [&'a [f32]; 5] {
        let ([a, b, c], [d, e]) = (self.across, self.smooth);
        [&a[..n], &b[..n], &c[..n], &d[..n], &e[..n]]
    }
}

/// `signal = |∇I|²` and `noise = (|∇I| − |∇R|)²` or `|∇I − ∇R|²`, both as long as the image is
/// wide.
#[inline(always)]
pub fn gradients<const FMA: bool>(
    observed: Neighbourhood<'_>,
    rendered: Neighbourhood<'_>,
    gradient: Gradient,
    signal: &mut [f32],
    noise: &mut [f32],
) {
    let n = signal.len();
    let noise = &mut noise[..n];
    let [ia, ib, ic, id, ie] = observed.cut(n);
    let [ra, rb, rc, rd, re] = rendered.cut(n);
    match gradient {
        Gradient::Magnitude => {
            for x in 0..n {
                let (ix, iy) = (fma::<FMA>(2.0, ib[x], ia[x] + ic[x]), ie[x] - id[x]);
                let (rx, ry) = (fma::<FMA>(2.0, rb[x], ra[x] + rc[x]), re[x] - rd[x]);
                let s = fma::<FMA>(ix, ix, iy * iy);
                let d = s.sqrt() - fma::<FMA>(rx, rx, ry * ry).sqrt();
                signal[x] = s;
                noise[x] = d * d;
            }
        }
        Gradient::Vector => {
            for x in 0..n {
                let (ix, iy) = (fma::<FMA>(2.0, ib[x], ia[x] + ic[x]), ie[x] - id[x]);
                let (rx, ry) = (fma::<FMA>(2.0, rb[x], ra[x] + rc[x]), re[x] - rd[x]);
                let (dx, dy) = (ix - rx, iy - ry);
                signal[x] = fma::<FMA>(ix, ix, iy * iy);
                noise[x] = fma::<FMA>(dx, dx, dy * dy);
            }
        }
    }
}

/// What the vertical sums of a pair of rows take from earlier pairs. With rows `s(2k), s(2k + 1)`
/// of pair `k`: `pair(k) = s(2k) + s(2k + 1)`, `four(k) = pair(k − 1) + pair(k)`.
pub struct History<'a> {
    /// `pair(k − 1)` and `pair(k − 5)`.
    pub pairs: [&'a [f32]; 2],
    /// `four(k − 1)` and `four(k − 3)`.
    pub fours: [&'a [f32]; 2],
    /// `s(2k − 9)`.
    pub odd: &'a [f32],
}

/// Sums over eleven rows, ending with the even and the odd row of a pair: all terms positive and
/// in a fixed order, so that nothing cancels and no bit depends on where a band begins.
#[inline(always)]
pub fn vertical(
    even: &[f32],
    odd: &[f32],
    history: &History<'_>,
    pair: &mut [f32],
    four: &mut [f32],
    windows: [&mut [f32]; 2],
) {
    let n = pair.len();
    let (even, odd, four) = (&even[..n], &odd[..n], &mut four[..n]);
    let ([p1, p5], [f1, f3]) = (history.pairs, history.fours);
    let (p1, p5, f1, f3, o5) = (&p1[..n], &p5[..n], &f1[..n], &f3[..n], &history.odd[..n]);
    let [w0, w1] = windows;
    let (w0, w1) = (&mut w0[..n], &mut w1[..n]);
    for x in 0..n {
        let p = even[x] + odd[x];
        let middle = f1[x] + f3[x];
        pair[x] = p;
        four[x] = p1[x] + p;
        w0[x] = (p5[x] + even[x]) + middle;
        w1[x] = (o5[x] + p) + middle;
    }
}

/// `out[x] = row[x] + row[x + 1] + row[x + 2]`.
#[inline(always)]
pub fn triples(row: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (a, b, c) = (&row[..n], &row[1..][..n], &row[2..][..n]);
    for x in 0..n {
        out[x] = (a[x] + b[x]) + c[x];
    }
}

/// A row of vertical sums, padded by [`RADIUS`], with its [`triples`].
#[derive(Clone, Copy)]
pub struct Sums<'a> {
    /// The sums.
    pub row: &'a [f32],
    /// `row[x] + row[x + 1] + row[x + 2]`.
    pub triples: &'a [f32],
}

impl<'a> Sums<'a> {
    /// The parts of a sum of eleven neighbours, cut to `n` pixels.
    #[inline(always)]
    fn parts(&self, n: usize) -> [&'a [f32]; 5] {
        let (row, triples) = (self.row, self.triples);
        [&triples[..n], &triples[3..][..n], &triples[6..][..n], &row[9..][..n], &row[10..][..n]]
    }
}

#[inline(always)]
fn eleven(parts: &[&[f32]; 5], x: usize) -> f32 {
    let [a, b, c, d, e] = parts;
    (a[x] + b[x]) + (c[x] + (d[x] + e[x]))
}

/// `log₂ v` for finite `v > 0`, to within 4e-7.
#[inline(always)]
fn log2<const FMA: bool>(v: f32) -> f32 {
    // Splits v = 2^e (1 + f) with 1 + f in [√½, √2).
    let bits = v.to_bits() as i32;
    let e = (bits - 0x3f35_04f3) >> 23;
    let f = f32::from_bits((bits - (e << 23)) as u32) - 1.0;
    // log₂(1 + f) / f, fitted for the smallest largest error of f times it.
    let mut p = 0.171_081_72;
    for c in [-0.272_515_4, 0.297_048_63, -0.358_984_2, 0.480_486_3, -0.721_375_1, 1.442_699_2] {
        p = fma::<FMA>(p, f, c);
    }
    fma::<FMA>(p, f, e as f32)
}

/// `out = offset + scale · clip(10 log₁₀ ((A + ε) / (B + ε)), ±30)`.
#[inline(always)]
pub fn decibels<const FMA: bool>(
    signal: Sums<'_>,
    noise: Sums<'_>,
    epsilon: f32,
    scale: f32,
    offset: f32,
    out: &mut [MaybeUninit<f32>],
) {
    const DB_PER_OCTAVE: f32 = 3.010_3;
    let n = out.len();
    let (signal, noise) = (signal.parts(n), noise.parts(n));
    for x in 0..n {
        let ratio = (eleven(&signal, x) + epsilon) / (eleven(&noise, x) + epsilon);
        let db = (DB_PER_OCTAVE * log2::<FMA>(ratio)).clamp(-CLIP_DB, CLIP_DB);
        out[x].write(fma::<FMA>(db, scale, offset));
    }
}

/// `out = A / (B + ε)`.
#[inline(always)]
pub fn ratios(signal: Sums<'_>, noise: Sums<'_>, epsilon: f32, out: &mut [MaybeUninit<f32>]) {
    let n = out.len();
    let (signal, noise) = (signal.parts(n), noise.parts(n));
    for x in 0..n {
        out[x].write(eleven(&signal, x) / (eleven(&noise, x) + epsilon));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_never_repeats_the_edge() {
        let indices: Vec<usize> = (-5..9).map(|i| reflect(i, 4)).collect();
        assert_eq!(indices, [1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!((reflect(-5, 1), reflect(3, 1), reflect(-3, 2)), (0, 0, 1));
        let mut row = [0.0, 0.0, 1.0, 2.0, 3.0, 0.0, 0.0];
        reflect_ends(&mut row, 2);
        assert_eq!(row, [3.0, 2.0, 1.0, 2.0, 3.0, 2.0, 1.0]);
    }

    #[test]
    fn log2_is_close_everywhere_and_exact_at_powers_of_two() {
        for e in -40..40 {
            assert_eq!(log2::<false>((e as f32).exp2()), e as f32);
        }
        let mut v = 1e-9f32;
        while v < 1e9 {
            let error = f64::from(log2::<false>(v)) - f64::from(v).log2();
            assert!(error.abs() < 4e-7 + f64::from(v).log2().abs() * 6e-8, "{v}: {error}");
            v *= 1.000_37;
        }
    }
}
