//! Random numbers that are a function of view, pixel and stage.
//!
//! Philox 4x32-7 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011) turns a key and a
//! counter into four words, in as few rounds as pass all of its authors' tests; Box and Muller's method turns two words
//! into two normal numbers. Logarithm, sine and cosine are polynomials of exactly rounded operations: the same bits on
//! any machine.

/// Numbers of as many pixels side by side.
pub(super) const LANES: usize = 8;
const ROUNDS: usize = 7;
const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// What the numbers are for; each has its own.
#[derive(Clone, Copy)]
pub(super) enum Stream {
    Color,
    Depth,
    /// One for the whole frame.
    Frame,
}

/// Names a view's numbers.
#[derive(Clone, Copy)]
pub(super) struct Key([u32; 2]);

/// Four numbers for each of the lanes.
pub(super) type Four<T> = [[T; LANES]; 4];

impl Key {
    pub fn new(view: u64) -> Self {
        Self([view as u32, (view >> 32) as u32])
    }

    /// Words for the pixels from `first` on.
    #[inline(always)]
    pub fn words(self, stream: Stream, first: u32) -> Four<u32> {
        // Words are the lower halves; what the upper ones hold is never read.
        let mut c = [[0; LANES], [stream as u64; LANES], [0; LANES], [0; LANES]];
        for (i, pixel) in c[0].iter_mut().enumerate() {
            *pixel = u64::from(first.wrapping_add(i as u32));
        }
        let mut key = self.0;
        for _ in 0..ROUNDS {
            let (low, high) = (products(&c[0], MULTIPLIERS[0]), products(&c[2], MULTIPLIERS[1]));
            c = [mixed(&high, &c[1], key[0]), high, mixed(&low, &c[3], key[1]), low];
            key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
        }
        let mut words = [[0; LANES]; 4];
        for (words, c) in words.iter_mut().zip(&c) {
            for (word, c) in words.iter_mut().zip(c) {
                *word = *c as u32;
            }
        }
        words
    }
}

/// Both halves of the products of words.
#[inline(always)]
fn products(words: &[u64; LANES], by: u32) -> [u64; LANES] {
    let mut out = [0; LANES];
    for (out, word) in out.iter_mut().zip(words) {
        *out = u64::from(*word as u32) * u64::from(by);
    }
    out
}

/// Upper halves of products, with words and a part of the key.
#[inline(always)]
fn mixed(products: &[u64; LANES], words: &[u64; LANES], key: u32) -> [u64; LANES] {
    let mut out = [0; LANES];
    for i in 0..LANES {
        out[i] = (products[i] >> 32) ^ words[i] ^ u64::from(key);
    }
    out
}

/// Evenly spread in [0, 1).
#[inline(always)]
pub(super) fn uniform(word: u32) -> f32 {
    (word >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// Two independent normal numbers of mean 0 and variance 1 for each lane, at most 5.8.
#[inline(always)]
pub(super) fn normals(a: &[u32; LANES], b: &[u32; LANES]) -> [[f32; LANES]; 2] {
    let mut out = [[0.0; LANES]; 2];
    for i in 0..LANES {
        // In (0, 1]: the logarithm is finite.
        let radius = (-2.0 * ln(1.0 - uniform(a[i]))).sqrt();
        let (sin, cos) = turn(b[i]);
        out[0][i] = radius * cos;
        out[1][i] = radius * sin;
    }
    out
}

/// Natural logarithm of positive normal numbers, within 1e-7 relative.
#[inline(always)]
fn ln(v: f32) -> f32 {
    // The mantissa in [√½, √2): the exponent is that of v / √½.
    let shifted = v.to_bits().wrapping_sub(std::f32::consts::FRAC_1_SQRT_2.to_bits());
    let exponent = shifted as i32 >> 23;
    let m = f32::from_bits(v.to_bits().wrapping_sub((exponent << 23) as u32));
    // ln m = 2 artanh((m - 1) / (m + 1))
    let s = (m - 1.0) / (m + 1.0);
    let q = s * s;
    let series = 2.0 + q * (2.0 / 3.0 + q * (2.0 / 5.0 + q * (2.0 / 7.0 + q * (2.0 / 9.0))));
    exponent as f32 * std::f32::consts::LN_2 + s * series
}

/// Sine and cosine of an angle: the word is the turn in units of 2⁻³².
#[inline(always)]
fn turn(word: u32) -> (f32, f32) {
    // The nearest quarter, and the rest within an eighth of a turn.
    let quarter = word.wrapping_add(1 << 29) >> 30;
    let rest = word.wrapping_sub(quarter << 30) as i32;
    let x = rest as f32 * (std::f32::consts::TAU / 4_294_967_296.0);
    let q = x * x;
    let sin = x * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0 - q * (1.0 / 362_880.0)))));
    let cos = 1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q * (1.0 / 40_320.0))));
    let (s, c) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let s = f32::from_bits(s.to_bits() ^ (quarter & 2) << 30);
    let c = f32::from_bits(c.to_bits() ^ ((quarter + 1) & 2) << 30);
    (s, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_gives_the_published_words() {
        // Known answer of the Random123 library: philox4x32-7 of counter and key zero.
        let words = Key::new(0).words(Stream::Color, 0);
        assert_eq!(words.map(|w| w[0]), [0x5f6f_b709, 0x0d89_3f64, 0x4f12_1f81, 0x4f73_0a48]);
        let later = Key::new(0).words(Stream::Color, 3);
        assert_eq!(later.map(|w| w[0]), words.map(|w| w[3]));
        assert_ne!(Key::new(0).words(Stream::Depth, 0), words);
        assert_ne!(Key::new(1 << 40).words(Stream::Color, 0), words);
    }

    #[test]
    fn functions_are_those_of_the_library() {
        for i in 1..5000u32 {
            let v = i as f32 / 5000.0;
            assert!((ln(v) - v.ln()).abs() <= 3e-7 * v.ln().abs().max(0.1), "ln {v}");
            let word = i.wrapping_mul(0x9E37_79B9);
            let angle = f64::from(word) / 4_294_967_296.0 * std::f64::consts::TAU;
            let (s, c) = turn(word);
            assert!((f64::from(s) - angle.sin()).abs() < 2e-7, "sin {angle}");
            assert!((f64::from(c) - angle.cos()).abs() < 2e-7, "cos {angle}");
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn numbers_are_normal_and_independent() {
        let n = 1 << 17;
        let (mut sums, mut cross, mut beyond) = ([0.0f64; 4], 0.0f64, 0);
        for first in (0..n).step_by(LANES) {
            let w = Key::new(5).words(Stream::Color, first);
            let [a, b] = normals(&w[0], &w[1]);
            for (a, b) in a.into_iter().zip(b) {
                let (a, b) = (f64::from(a), f64::from(b));
                sums = [sums[0] + a, sums[1] + a * a, sums[2] + a.powi(3), sums[3] + a.powi(4)];
                cross += a * b;
                beyond += u32::from(a.abs() > 1.959_964);
            }
        }
        let n = f64::from(n);
        let deviations = |moment: f64, expected: f64, variance: f64| (moment / n - expected) / (variance / n).sqrt();
        // Moments of a normal number: 0, 1, 0, 3; each mean within four of its standard deviations.
        assert!(deviations(sums[0], 0.0, 1.0).abs() < 4.0);
        assert!(deviations(sums[1], 1.0, 2.0).abs() < 4.0);
        assert!(deviations(sums[2], 0.0, 15.0).abs() < 4.0);
        assert!(deviations(sums[3], 3.0, 96.0).abs() < 4.0);
        assert!(deviations(cross, 0.0, 1.0).abs() < 4.0);
        assert!(deviations(f64::from(beyond), 0.05, 0.05 * 0.95).abs() < 4.0);
    }
}
