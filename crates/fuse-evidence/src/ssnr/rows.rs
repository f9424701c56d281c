//! The loops over one row, written so that they vectorise: slices of equal length, no branches.
//!
//! Each is inlined into a caller that is compiled for the level in use; `FMA` says whether that
//! level has a fused multiply-add (without one, `mul_add` is a slow library call).

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

/// Sobel gradient `(x, y)` at `x` of three grey rows that are padded by one on the left.
#[inline(always)]
fn sobel<const FMA: bool>(above: &[f32], row: &[f32], below: &[f32], x: usize) -> (f32, f32) {
    let (a0, a1, a2) = (above[x], above[x + 1], above[x + 2]);
    let (b0, b2) = (row[x], row[x + 2]);
    let (c0, c1, c2) = (below[x], below[x + 1], below[x + 2]);
    let gx = fma::<FMA>(2.0, b2 - b0, (a2 - a0) + (c2 - c0));
    let gy = fma::<FMA>(2.0, c1 - a1, (c0 - a0) + (c2 - a2));
    (gx, gy)
}

/// One row of the two images, three grey rows each, padded by one at both ends.
pub type Neighbourhood<'a> = [&'a [f32]; 3];

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
    let [ia, ib, ic] = [&observed[0][..n + 2], &observed[1][..n + 2], &observed[2][..n + 2]];
    let [ra, rb, rc] = [&rendered[0][..n + 2], &rendered[1][..n + 2], &rendered[2][..n + 2]];
    match gradient {
        Gradient::Magnitude => {
            for x in 0..n {
                let (ix, iy) = sobel::<FMA>(ia, ib, ic, x);
                let (rx, ry) = sobel::<FMA>(ra, rb, rc, x);
                let s = fma::<FMA>(ix, ix, iy * iy);
                let d = s.sqrt() - fma::<FMA>(rx, rx, ry * ry).sqrt();
                signal[x] = s;
                noise[x] = d * d;
            }
        }
        Gradient::Vector => {
            for x in 0..n {
                let (ix, iy) = sobel::<FMA>(ia, ib, ic, x);
                let (rx, ry) = sobel::<FMA>(ra, rb, rc, x);
                let (dx, dy) = (ix - rx, iy - ry);
                signal[x] = fma::<FMA>(ix, ix, iy * iy);
                noise[x] = fma::<FMA>(dx, dx, dy * dy);
            }
        }
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

/// Sums of eleven neighbours from sums of three: `row` and its `triples` start five pixels left
/// of the window's centre. Positive terms only, so nothing cancels.
#[inline(always)]
fn eleven(row: &[f32], triples: &[f32], x: usize) -> f32 {
    (triples[x] + triples[x + 3]) + (triples[x + 6] + (row[x + 9] + row[x + 10]))
}

/// Rows of horizontal sums that the vertical sum needs: `row[-9], row[-10]` of the sums
/// themselves, `row[-1], row[-2]` to make the next triple, `triple[-3], triple[-6]`.
pub struct History<'a> {
    /// Horizontal sums 1, 2, 9 and 10 rows ago.
    pub rows: [&'a [f32]; 4],
    /// Vertical triples 3 and 6 rows ago.
    pub triples: [&'a [f32]; 2],
}

/// Takes a row (padded by [`RADIUS`]) and its triples through the horizontal sum; writes that and
/// the vertical triple, and the vertical sum of eleven rows to `window`.
#[inline(always)]
pub fn windows(
    row: &[f32],
    triples: &[f32],
    history: &History<'_>,
    sum: &mut [f32],
    triple: &mut [f32],
    window: &mut [f32],
) {
    let n = window.len();
    let (row, triples) = (&row[..n + 10], &triples[..n + 8]);
    let [r1, r2, r9, r10] = history.rows;
    let (r1, r2, r9, r10) = (&r1[..n], &r2[..n], &r9[..n], &r10[..n]);
    let (t3, t6) = (&history.triples[0][..n], &history.triples[1][..n]);
    let (sum, triple) = (&mut sum[..n], &mut triple[..n]);
    for x in 0..n {
        let s = eleven(row, triples, x);
        let t = (s + r1[x]) + r2[x];
        sum[x] = s;
        triple[x] = t;
        window[x] = (t + t3[x]) + (t6[x] + (r9[x] + r10[x]));
    }
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
    signal: &[f32],
    noise: &[f32],
    epsilon: f32,
    scale: f32,
    offset: f32,
    out: &mut [f32],
) {
    const DB_PER_OCTAVE: f32 = 3.010_3;
    let n = out.len();
    let (signal, noise) = (&signal[..n], &noise[..n]);
    for x in 0..n {
        let ratio = (signal[x] + epsilon) / (noise[x] + epsilon);
        let db = (DB_PER_OCTAVE * log2::<FMA>(ratio)).clamp(-CLIP_DB, CLIP_DB);
        out[x] = fma::<FMA>(db, scale, offset);
    }
}

/// `out = A / (B + ε)`.
#[inline(always)]
pub fn ratios(signal: &[f32], noise: &[f32], epsilon: f32, out: &mut [f32]) {
    let n = out.len();
    let (signal, noise) = (&signal[..n], &noise[..n]);
    for x in 0..n {
        out[x] = signal[x] / (noise[x] + epsilon);
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
