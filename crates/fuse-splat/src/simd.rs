//! Lanes of f32 at the machine's SIMD level, and the one place where the level is chosen.
//!
//! A kernel is a struct with its arguments that implements [`Kernel`]; its `run` is generic over
//! [`F32x8`] and, like everything it calls, `#[inline(always)]`, so that the whole kernel is
//! compiled once for each level inside a function that enables its instructions, and once for the
//! build target. A [`WideKernel`] also works with sixteen lanes where the level has them.

use std::array::from_fn;
use std::ops::{Add, Div, Mul, Sub};

use fuse_camera::simd::Level;

#[cfg(target_arch = "x86_64")]
mod x86;

/// Lanes of f32, a multiple of eight of them.
pub(crate) trait Floats:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Number of lanes.
    const LANES: usize;

    fn splat(v: f32) -> Self;
    /// The values at the start of `v`.
    fn load_slice(v: &[f32]) -> Self;
    /// Writes to the first places of `to`.
    fn store_slice(self, to: &mut [f32]);
    /// `self · a + b`, rounded once where the level has FMA.
    fn mul_add(self, a: Self, b: Self) -> Self;
    fn min(self, o: Self) -> Self;
    /// `self` in the lanes with `a ≥ b`, zero in the others, and where one of them is NaN.
    fn where_ge(self, a: Self, b: Self) -> Self;
    /// Whether a lane has `self ≥ o`.
    fn any_ge(self, o: Self) -> bool;
    /// Adds the integer in the low bits of `t` (a float of the form 1.5·2²³ + n) to the exponent.
    fn add_exponent(self, t: Self) -> Self;
    /// The sums over the lanes of each of eight vectors.
    fn sums(v: [Self; 8]) -> [f32; 8];

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
pub(crate) trait F32x8: Floats {
    fn load(v: &[f32; 8]) -> Self;
    /// Eight integers.
    fn load_bytes(v: &[u8; 8]) -> Self;
    fn store(self, to: &mut [f32; 8]);
    fn max(self, o: Self) -> Self;
    fn sqrt(self) -> Self;
    /// Mask of lanes with `self ≥ o`; false for NaN.
    fn ge(self, o: Self) -> Self;
    /// Mask of lanes with `self > o`; false for NaN.
    fn gt(self, o: Self) -> Self;
    /// Bitwise and.
    fn and(self, o: Self) -> Self;
    /// `self` where the mask is set, else `other`.
    fn select(self, mask: Self, other: Self) -> Self;
    /// Rounded towards zero, for lanes within ±2³¹.
    fn truncate(self) -> [i32; 8];
    /// `(e, m)` with `self = m · 2^e`, `m ∈ [√½, √2)`, for positive normal lanes.
    fn split_exponent(self) -> (Self, Self);

    #[inline(always)]
    fn neg(self) -> Self {
        Self::zero() - self
    }

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

/// Work that is compiled for every level.
pub(crate) trait Kernel {
    type Output;
    /// Must be `#[inline(always)]`.
    fn run<V: F32x8>(self) -> Self::Output;
}

/// Work on as many lanes as the level has.
pub(crate) trait WideKernel {
    type Output;
    /// Must be `#[inline(always)]`.
    fn run<V: Floats>(self) -> Self::Output;
}

/// Runs a kernel at `level`, or portably where the machine lacks that level.
#[inline]
pub(crate) fn dispatch<K: Kernel>(level: Level, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    match level.min(fuse_camera::simd::best()) {
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
pub(crate) fn dispatch_wide<K: WideKernel>(level: Level, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    match level.min(fuse_camera::simd::best()) {
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
pub(crate) fn prefetch<T>(values: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(value) = values.get(at) {
        x86::prefetch(value);
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, at);
}

/// Plain arrays, for whatever the build target has.
#[derive(Clone, Copy)]
#[repr(align(32))]
struct Portable([f32; 8]);

macro_rules! portable_operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self(from_fn(|i| self.0[i] $op o.0[i]))
            }
        }
    };
}
portable_operator!(Add, add, +);
portable_operator!(Sub, sub, -);
portable_operator!(Mul, mul, *);
portable_operator!(Div, div, /);

fn mask(set: bool) -> f32 {
    f32::from_bits(if set { u32::MAX } else { 0 })
}

impl Floats for Portable {
    const LANES: usize = 8;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([v; 8])
    }
    #[inline(always)]
    fn load_slice(v: &[f32]) -> Self {
        Self::load(v.first_chunk().expect("at least eight values"))
    }
    #[inline(always)]
    fn store_slice(self, to: &mut [f32]) {
        self.store(to.first_chunk_mut().expect("at least eight places"));
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        // Not f32::mul_add, which is a slow library call where the target has no FMA.
        self * a + b
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(from_fn(|i| if self.0[i] < o.0[i] { self.0[i] } else { o.0[i] }))
    }
    #[inline(always)]
    fn where_ge(self, a: Self, b: Self) -> Self {
        self.and(a.ge(b))
    }
    #[inline(always)]
    fn any_ge(self, o: Self) -> bool {
        (0..8).any(|i| self.0[i] >= o.0[i])
    }
    #[inline(always)]
    fn add_exponent(self, t: Self) -> Self {
        Self(from_fn(|i| f32::from_bits(self.0[i].to_bits().wrapping_add(t.0[i].to_bits() << 23))))
    }
    #[inline(always)]
    fn sums(v: [Self; 8]) -> [f32; 8] {
        from_fn(|i| {
            let a = v[i].0;
            ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7]))
        })
    }
}

impl F32x8 for Portable {
    #[inline(always)]
    fn load(v: &[f32; 8]) -> Self {
        Self(*v)
    }
    #[inline(always)]
    fn load_bytes(v: &[u8; 8]) -> Self {
        Self(v.map(f32::from))
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; 8]) {
        *to = self.0;
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(from_fn(|i| if self.0[i] > o.0[i] { self.0[i] } else { o.0[i] }))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(from_fn(|i| self.0[i].sqrt()))
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self {
        Self(from_fn(|i| mask(self.0[i] >= o.0[i])))
    }
    #[inline(always)]
    fn gt(self, o: Self) -> Self {
        Self(from_fn(|i| mask(self.0[i] > o.0[i])))
    }
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        Self(from_fn(|i| f32::from_bits(self.0[i].to_bits() & o.0[i].to_bits())))
    }
    #[inline(always)]
    fn select(self, mask: Self, other: Self) -> Self {
        Self(from_fn(|i| if mask.0[i].to_bits() != 0 { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn truncate(self) -> [i32; 8] {
        self.0.map(|v| v as i32)
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let e: [i32; 8] = from_fn(|i| (self.0[i].to_bits() as i32).wrapping_sub(HALF_ROOT) >> 23);
        let m = from_fn(|i| f32::from_bits((self.0[i].to_bits() as i32).wrapping_sub(e[i] << 23) as u32));
        (Self(from_fn(|i| e[i] as f32)), Self(m))
    }
}

/// Bits of √½, the lower end of the mantissas that `split_exponent` returns.
const HALF_ROOT: i32 = 0x3f35_04f3;

#[cfg(test)]
mod tests {
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
        for level in [Level::Portable, Level::Avx2Fma, fuse_camera::simd::best()] {
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
            let [narrow, wide] =
                [Level::Avx2Fma, fuse_camera::simd::best()].map(|level| dispatch_wide(level, Wide(&x)));
            assert_eq!(narrow.0, wide.0);
            assert_eq!((narrow.1, narrow.2), (wide.1, wide.2));
            assert_eq!(wide.2, x.map(|v| v >= 0.25));
            let total: f32 = x.iter().sum();
            for i in 0..8 {
                assert!((wide.3[i] - total * i as f32).abs() < 1e-3, "{i}");
            }
        }
    }
}
