//! Lanes of f32 at the machine's SIMD level, and the one place where the level is chosen.
//!
//! A kernel is a struct with its arguments that implements [`Kernel`]; its `run` is generic over
//! [`F32x8`] and, like everything it calls, `#[inline(always)]`, so that the whole kernel is
//! compiled once for each level inside a function that enables its instructions, and once for the
//! build target. A [`WideKernel`] also works with sixteen lanes where the level has them.

use std::ops::{Add, Div, Mul, Sub};

use super::portable::Portable;
use super::{Level, best};

#[cfg(target_arch = "x86_64")]
use super::x86;

/// Lanes of f32, a multiple of eight of them.
pub trait Floats: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// Number of lanes.
    const LANES: usize;

    /// The same value in every lane.
    fn splat(v: f32) -> Self;
    /// The values at the start of `v`.
    fn load_slice(v: &[f32]) -> Self;
    /// Writes to the first places of `to`.
    fn store_slice(self, to: &mut [f32]);
    /// `self · a + b`, rounded once where the level has FMA.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// The smaller of each pair; `o` where one is NaN.
    fn min(self, o: Self) -> Self;
    /// `self` in the lanes with `a ≥ b`, zero in the others, and where one of them is NaN.
    fn where_ge(self, a: Self, b: Self) -> Self;
    /// Whether a lane has `self ≥ o`.
    fn any_ge(self, o: Self) -> bool;
    /// Adds the integer in the low bits of `t` (a float of the form 1.5·2²³ + n) to the exponent.
    fn add_exponent(self, t: Self) -> Self;
    /// The sums over the lanes of each of eight vectors.
    fn sums(v: [Self; 8]) -> [f32; 8];

    /// Zeros.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    /// `2^self`, relative error below 3e-7 for lanes in [-126, 126]; outside, the exponent wraps
    /// and the result means nothing: mask on the argument.
    #[inline(always)]
    fn exp2(self) -> Self {
        const MAGIC: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to the nearest integer.
        let t = self + Self::splat(MAGIC);
        let f = self - (t - Self::splat(MAGIC));
        let p = Self::splat(1.327_647_2e-3);
        let p = p.mul_add(f, Self::splat(9.675_541e-3));
        let p = p.mul_add(f, Self::splat(5.550_713e-2));
        let p = p.mul_add(f, Self::splat(0.240_221_2));
        let p = p.mul_add(f, Self::splat(0.693_146_94));
        let p = p.mul_add(f, Self::splat(1.0));
        p.add_exponent(t)
    }
}

/// Eight lanes of f32. Masks are lanes with all bits set or none.
pub trait F32x8: Floats {
    /// Its eight integers.
    type Int: I32x8<Float = Self>;

    /// Eight values.
    fn load(v: &[f32; 8]) -> Self;
    /// Eight integers.
    fn load_bytes(v: &[u8; 8]) -> Self;
    /// Writes the eight values.
    fn store(self, to: &mut [f32; 8]);
    /// The larger of each pair; `o` where one is NaN.
    fn max(self, o: Self) -> Self;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// Mask of lanes with `self ≥ o`; false for NaN.
    fn ge(self, o: Self) -> Self;
    /// Mask of lanes with `self > o`; false for NaN.
    fn gt(self, o: Self) -> Self;
    /// Bitwise and.
    fn and(self, o: Self) -> Self;
    /// Bitwise or.
    fn or(self, o: Self) -> Self;
    /// One bit a lane: its sign bit, which for a mask tells whether it is set.
    fn mask_bits(self) -> u8;
    /// Rounded towards zero, for lanes within ±2³¹.
    fn to_int(self) -> Self::Int;
    /// `self` where the mask is set, else `other`.
    fn select(self, mask: Self, other: Self) -> Self;
    /// Rounded towards zero, for lanes within ±2³¹.
    fn truncate(self) -> [i32; 8];
    /// Rows to columns: lane `j` of the `i`-th is lane `i` of the `j`-th.
    fn transpose(rows: [Self; 8]) -> [Self; 8];
    /// `(e, m)` with `self = m · 2^e`, `m ∈ [√½, √2)`, for positive normal lanes.
    fn split_exponent(self) -> (Self, Self);

    /// With the other sign.
    #[inline(always)]
    fn neg(self) -> Self {
        Self::zero() - self
    }

    /// The eight values.
    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        let mut out = [0.0; 8];
        self.store(&mut out);
        out
    }

    /// `exp(self)`, argument clamped to [-87, 87].
    #[inline(always)]
    fn exp(self) -> Self {
        (self.max(Self::splat(-87.0)).min(Self::splat(87.0)) * Self::splat(std::f32::consts::LOG2_E)).exp2()
    }

    /// `log2(self)` for positive normal lanes: log2 m = 2/ln 2 · artanh((m-1)/(m+1)).
    #[inline(always)]
    fn log2(self) -> Self {
        let (e, m) = self.split_exponent();
        let s = (m - Self::splat(1.0)) / (m + Self::splat(1.0));
        let s2 = s * s;
        let p = Self::splat(2.0 / 7.0);
        let p = p.mul_add(s2, Self::splat(2.0 / 5.0));
        let p = p.mul_add(s2, Self::splat(2.0 / 3.0));
        let p = p.mul_add(s2, Self::splat(2.0));
        (p * s).mul_add(Self::splat(std::f32::consts::LOG2_E), e)
    }
}

/// Eight lanes of i32; arithmetic wraps around.
pub trait I32x8: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Its eight floats.
    type Float: F32x8<Int = Self>;

    /// The same value in every lane.
    fn splat(v: i32) -> Self;
    /// Eight words.
    fn load(v: &[u32; 8]) -> Self;
    /// Writes the eight words.
    fn store(self, to: &mut [u32; 8]);
    /// The eight values.
    fn to_array(self) -> [i32; 8];
    /// Bitwise and.
    fn and(self, o: Self) -> Self;
    /// Shifted right by `N`, zeros coming in.
    fn shift_right<const N: i32>(self) -> Self;
    /// The smaller of each pair.
    fn min(self, o: Self) -> Self;
    /// The larger of each pair.
    fn max(self, o: Self) -> Self;
    /// Mask of the lanes that are equal.
    fn equal(self, o: Self) -> Self::Float;
    /// `self` where the mask is set, else `other`.
    fn select(self, mask: Self::Float, other: Self) -> Self;
    /// As floats, rounded to nearest.
    fn to_float(self) -> Self::Float;
    /// The words of a table at these places; a place beyond its end, and a negative one, reads the
    /// last word. The table must not be empty.
    fn gather(self, table: &[u32]) -> Self;
    /// The words of a table at these places and those after them; a place without a word after it,
    /// and a negative one, reads the last two. The table must have two words.
    fn gather_pairs(self, table: &[u32]) -> (Self, Self);
    /// The same bits as floats.
    fn as_float(self) -> Self::Float;
}

/// Work that is compiled for every level.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Does the work. Must be `#[inline(always)]`.
    fn run<V: F32x8>(self) -> Self::Output;
}

/// Work on as many lanes as the level has.
pub trait WideKernel {
    /// What it returns.
    type Output;
    /// Does the work. Must be `#[inline(always)]`.
    fn run<V: Floats>(self) -> Self::Output;
}

/// Runs a kernel at `level`, or portably where the machine lacks that level.
#[inline]
pub fn dispatch<K: Kernel>(level: Level, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    match level.min(best()) {
        // SAFETY: the machine was found to have AVX2, FMA and these parts of AVX-512.
        Level::Avx512 => return unsafe { x86::run_avx512(kernel) },
        // SAFETY: the machine was found to have AVX2 and FMA.
        Level::Avx2Fma => return unsafe { x86::run(kernel) },
        Level::Portable => {}
    }
    let _ = level;
    kernel.run::<Portable>()
}

/// The same with sixteen lanes where the level has them.
#[inline]
pub fn dispatch_wide<K: WideKernel>(level: Level, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    match level.min(best()) {
        // SAFETY: the machine was found to have AVX2, FMA and these parts of AVX-512.
        Level::Avx512 => return unsafe { x86::run_wide_avx512(kernel) },
        // SAFETY: the machine was found to have AVX2 and FMA.
        Level::Avx2Fma => return unsafe { x86::run_wide(kernel) },
        Level::Portable => {}
    }
    let _ = level;
    kernel.run::<Portable>()
}

/// Asks for the cache line of `values[at]`, if there is one, before it is needed.
#[inline(always)]
pub fn prefetch<T>(values: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(value) = values.get(at) {
        x86::prefetch(value);
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, at);
}

/// Bits of √½, the lower end of the mantissas that `split_exponent` returns.
pub(super) const HALF_ROOT: i32 = 0x3f35_04f3;

#[cfg(test)]
// Lanes are counted through several arrays at once.
#[allow(clippy::needless_range_loop)]
mod tests {
    use std::array::from_fn;

    use super::*;

    struct Elementary<'a>(&'a [f32; 8]);
    impl Kernel for Elementary<'_> {
        type Output = ([f32; 8], [f32; 8], [f32; 8]);
        #[inline(always)]
        fn run<V: F32x8>(self) -> Self::Output {
            let v = V::load(self.0);
            let sums = V::sums(from_fn(|i| v * V::splat(i as f32)));
            (v.exp2().to_array(), v.max(V::splat(1e-3)).log2().to_array(), sums)
        }
    }

    #[test]
    fn elementary_functions_agree_with_std_at_every_level() {
        for level in [Level::Portable, Level::Avx2Fma, best()] {
            for k in 0..4000 {
                let x: [f32; 8] = from_fn(|i| (k as f32 - 2000.0) * 0.0625 + i as f32 * 0.0071);
                let (exp, log, sums) = dispatch(level, Elementary(&x));
                let total: f64 = x.iter().map(|&v| f64::from(v)).sum();
                for i in 0..8 {
                    let e = f64::from(x[i]).exp2();
                    assert!((f64::from(exp[i]) / e - 1.0).abs() < 3e-7, "2^{} = {}", x[i], exp[i]);
                    let l = f64::from(x[i].max(1e-3)).log2();
                    assert!((f64::from(log[i]) - l).abs() < 4e-7 * l.abs().max(1.0), "log2 {} = {}", x[i], log[i]);
                    assert!((f64::from(sums[i]) - total * i as f64).abs() <= 1e-5 * (1.0 + total.abs() * i as f64));
                }
            }
        }
    }

    struct Transpose([[f32; 8]; 8]);
    impl Kernel for Transpose {
        type Output = [[f32; 8]; 8];
        #[inline(always)]
        fn run<V: F32x8>(self) -> Self::Output {
            V::transpose(self.0.map(|row| V::load(&row))).map(V::to_array)
        }
    }

    #[test]
    fn rows_become_columns_at_every_level() {
        let rows = from_fn(|j| from_fn(|i| (8 * j + i) as f32));
        for level in [Level::Portable, Level::Avx2Fma, best()] {
            assert_eq!(dispatch(level, Transpose(rows)), from_fn(|i| from_fn(|j| rows[j][i])), "{}", level.name());
        }
    }

    struct Wide<'a>(&'a [f32; 16]);
    impl WideKernel for Wide<'_> {
        /// 2^x, x where x ≥ ¼, the places in which a lane alone is found to be ≥ ¼, and sums.
        type Output = ([f32; 16], [f32; 16], [bool; 16], [f32; 8]);
        #[inline(always)]
        fn run<V: Floats>(self) -> Self::Output {
            let (mut power, mut kept, mut found, mut total) = ([0.0; 16], [0.0; 16], [false; 16], [0.0; 8]);
            let limit = V::splat(0.25);
            for at in (0..16).step_by(V::LANES) {
                let v = V::load_slice(&self.0[at..]);
                v.exp2().store_slice(&mut power[at..]);
                v.where_ge(v, limit).store_slice(&mut kept[at..]);
                let sums = V::sums(from_fn(|i| v * V::splat(i as f32)));
                total.iter_mut().zip(sums).for_each(|(t, s)| *t += s);
            }
            for lane in 0..16 {
                let alone: [f32; 16] = from_fn(|i| if i == lane { self.0[i] } else { f32::NAN });
                found[lane] = (0..16).step_by(V::LANES).any(|at| V::load_slice(&alone[at..]).any_ge(limit));
            }
            (power, kept, found, total)
        }
    }

    #[test]
    fn sixteen_lanes_do_what_eight_do() {
        for k in 0..400 {
            let x: [f32; 16] = from_fn(|i| ((k * 16 + i) as f32 * 0.37).sin() * 20.0 + if i == 3 { 0.25 } else { 0.0 });
            let [narrow, wide] = [Level::Avx2Fma, best()].map(|level| dispatch_wide(level, Wide(&x)));
            assert_eq!(narrow.0, wide.0);
            assert_eq!((narrow.1, narrow.2), (wide.1, wide.2));
            assert_eq!(wide.2, x.map(|v| v >= 0.25));
            let total: f32 = x.iter().sum();
            for i in 0..8 {
                assert!((wide.3[i] - total * i as f32).abs() < 1e-3, "{i}");
            }
        }
    }

    struct Integers<'a>(&'a [f32; 8], &'a [u32]);
    impl Kernel for Integers<'_> {
        /// Parts of `x · 5 - 3` as integers, single words, pairs of words, and a mask.
        type Output = ([i32; 8], [i32; 8], [[i32; 8]; 2], [u8; 2]);
        #[inline(always)]
        fn run<V: F32x8>(self) -> Self::Output {
            let (x, table) = (V::load(self.0), self.1);
            let three = V::Int::splat(3);
            let n = x.to_int() * V::Int::splat(5) - three;
            let parts = n.shift_right::<1>().and(V::Int::splat(0xff)).select(n.equal(three), n.min(three).max(n));
            let (a, b) = x.to_int().gather_pairs(table);
            let masks = [x.gt(V::splat(2.0)).mask_bits(), x.gt(V::splat(2.0)).or(n.equal(three)).mask_bits()];
            (parts.to_array(), n.gather(table).to_array(), [a.to_array(), b.to_array()], masks)
        }
    }

    #[test]
    fn integers_and_look_ups_are_the_same_at_every_level() {
        let table: Vec<u32> = (0..11).map(|i| i * 1000 + 7).collect();
        for k in 0..200 {
            let x: [f32; 8] = from_fn(|i| (k as f32 * 0.31 + i as f32 * 1.7) % 14.0 - 2.0);
            let results = [Level::Portable, Level::Avx2Fma, best()].map(|l| dispatch(l, Integers(&x, &table)));
            assert_eq!(results[0], results[1]);
            assert_eq!(results[0], results[2]);
            let (_, single, pairs, masks) = results[0];
            for i in 0..8 {
                let (n, whole) = (x[i] as i32 * 5 - 3, x[i] as i32);
                let word = |i: usize| i as i32 * 1000 + 7;
                // Negative places read the end of the table, like those beyond it.
                let place = |n: i32, last: usize| (n as u32 as usize).min(last);
                assert_eq!(single[i], word(place(n, 10)), "{n}");
                assert_eq!([pairs[0][i], pairs[1][i]], [word(place(whole, 9)), word(place(whole, 9) + 1)]);
                assert_eq!(masks[0] >> i & 1 == 1, x[i] > 2.0);
            }
        }
    }
}
