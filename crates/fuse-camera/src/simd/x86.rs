//! The lanes on x86-64: eight with AVX2 and FMA, sixteen with AVX-512.

use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

use super::lanes::{F32x8, Floats, HALF_ROOT, I32x8, Kernel, WideKernel};

/// The same instructions on the same eight lanes as [`run`], but with 32 registers instead of 16.
///
/// # Safety
/// The machine has AVX2, FMA and the named parts of AVX-512.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512bw,avx512dq")]
pub(super) unsafe fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

/// # Safety
/// The machine has AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

/// # Safety
/// The machine has AVX2, FMA and the named parts of AVX-512.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512bw,avx512dq")]
pub(super) unsafe fn run_wide_avx512<K: WideKernel>(kernel: K) -> K::Output {
    kernel.run::<Avx512>()
}

/// # Safety
/// The machine has AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn run_wide<K: WideKernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

#[inline(always)]
pub(super) fn prefetch<T>(value: &T) {
    // SAFETY: every x86-64 processor has the instruction, and it changes no state but the caches'.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast()) }
}

/// Private to this module: a value can only come into being inside a kernel that one of the
/// functions above started, which is why each `unsafe` block below may rely on AVX2 and FMA.
#[derive(Clone, Copy)]
pub struct Avx2(__m256);

/// The same with eight integers.
#[derive(Clone, Copy)]
pub struct Avx2Int(__m256i);

/// The same for AVX-512: only [`run_wide_avx512`] makes one.
#[derive(Clone, Copy)]
struct Avx512(__m512);

macro_rules! intrinsic {
    ($e:expr) => {
        // SAFETY: the instructions are present, see `Avx2` and `Avx512`.
        unsafe { $e }
    };
}

macro_rules! operator {
    ($type:ident, $trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for $type {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self(intrinsic!($intrinsic(self.0, o.0)))
            }
        }
    };
}
operator!(Avx2, Add, add, _mm256_add_ps);
operator!(Avx2, Sub, sub, _mm256_sub_ps);
operator!(Avx2, Mul, mul, _mm256_mul_ps);
operator!(Avx2, Div, div, _mm256_div_ps);
operator!(Avx2Int, Add, add, _mm256_add_epi32);
operator!(Avx2Int, Sub, sub, _mm256_sub_epi32);
operator!(Avx2Int, Mul, mul, _mm256_mullo_epi32);
operator!(Avx512, Add, add, _mm512_add_ps);
operator!(Avx512, Sub, sub, _mm512_sub_ps);
operator!(Avx512, Mul, mul, _mm512_mul_ps);
operator!(Avx512, Div, div, _mm512_div_ps);

impl Floats for Avx2 {
    const LANES: usize = 8;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(intrinsic!(_mm256_set1_ps(v)))
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
        Self(intrinsic!(_mm256_fmadd_ps(self.0, a.0, b.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_min_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn where_ge(self, a: Self, b: Self) -> Self {
        self.and(a.ge(b))
    }
    #[inline(always)]
    fn any_ge(self, o: Self) -> bool {
        intrinsic!(_mm256_movemask_ps(self.ge(o).0)) != 0
    }
    #[inline(always)]
    fn add_exponent(self, t: Self) -> Self {
        let n = intrinsic!(_mm256_slli_epi32::<23>(_mm256_castps_si256(t.0)));
        Self(intrinsic!(_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(self.0), n))))
    }
    #[inline(always)]
    fn sums(v: [Self; 8]) -> [f32; 8] {
        let add = |a: __m256, b: __m256| intrinsic!(_mm256_hadd_ps(a, b));
        let a = add(add(v[0].0, v[1].0), add(v[2].0, v[3].0));
        let b = add(add(v[4].0, v[5].0), add(v[6].0, v[7].0));
        let lows = intrinsic!(_mm256_permute2f128_ps::<0x20>(a, b));
        let highs = intrinsic!(_mm256_permute2f128_ps::<0x31>(a, b));
        (Self(lows) + Self(highs)).to_array()
    }
}

impl F32x8 for Avx2 {
    type Int = Avx2Int;

    #[inline(always)]
    fn load(v: &[f32; 8]) -> Self {
        // The pointer is valid for eight unaligned reads: it comes from an array.
        Self(intrinsic!(_mm256_loadu_ps(v.as_ptr())))
    }
    #[inline(always)]
    fn load_bytes(v: &[u8; 8]) -> Self {
        let bytes = intrinsic!(_mm_cvtsi64_si128(i64::from_le_bytes(*v)));
        Self(intrinsic!(_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes))))
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; 8]) {
        intrinsic!(_mm256_storeu_ps(to.as_mut_ptr(), self.0))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_max_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(intrinsic!(_mm256_sqrt_ps(self.0)))
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_cmp_ps::<_CMP_GE_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    fn gt(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_and_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn select(self, mask: Self, other: Self) -> Self {
        Self(intrinsic!(_mm256_blendv_ps(other.0, self.0, mask.0)))
    }
    #[inline(always)]
    fn or(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_or_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn mask_bits(self) -> u8 {
        intrinsic!(_mm256_movemask_ps(self.0)) as u8
    }
    #[inline(always)]
    fn to_int(self) -> Avx2Int {
        Avx2Int(intrinsic!(_mm256_cvttps_epi32(self.0)))
    }
    #[inline(always)]
    fn truncate(self) -> [i32; 8] {
        let mut out = [0; 8];
        // The pointer is valid for eight unaligned writes: it comes from an array.
        intrinsic!(_mm256_storeu_si256(out.as_mut_ptr().cast(), _mm256_cvttps_epi32(self.0)));
        out
    }
    #[inline(always)]
    fn transpose(rows: [Self; 8]) -> [Self; 8] {
        // Halves of 128 bits on their own: pairs of rows, fours, then the halves of eight. No closures:
        // `map` would not be compiled for the caller's instruction set.
        let [a, b, c, d, e, f, g, h] = rows;
        macro_rules! both {
            ($low:ident, $high:ident, $x:expr, $y:expr) => {
                let $low = intrinsic!(_mm256_unpacklo_ps($x.0, $y.0));
                let $high = intrinsic!(_mm256_unpackhi_ps($x.0, $y.0));
            };
        }
        both!(ab0, ab1, a, b);
        both!(cd0, cd1, c, d);
        both!(ef0, ef1, e, f);
        both!(gh0, gh1, g, h);
        macro_rules! columns {
            ($ab:ident, $cd:ident, $ef:ident, $gh:ident, $halves:literal) => {{
                let top = intrinsic!(_mm256_shuffle_ps::<$halves>($ab, $cd));
                let bottom = intrinsic!(_mm256_shuffle_ps::<$halves>($ef, $gh));
                (
                    Self(intrinsic!(_mm256_permute2f128_ps::<0x20>(top, bottom))),
                    Self(intrinsic!(_mm256_permute2f128_ps::<0x31>(top, bottom))),
                )
            }};
        }
        let (c0, c4) = columns!(ab0, cd0, ef0, gh0, 0x44);
        let (c1, c5) = columns!(ab0, cd0, ef0, gh0, 0xee);
        let (c2, c6) = columns!(ab1, cd1, ef1, gh1, 0x44);
        let (c3, c7) = columns!(ab1, cd1, ef1, gh1, 0xee);
        [c0, c1, c2, c3, c4, c5, c6, c7]
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let bits = intrinsic!(_mm256_castps_si256(self.0));
        let e = intrinsic!(_mm256_srai_epi32::<23>(_mm256_sub_epi32(bits, _mm256_set1_epi32(HALF_ROOT))));
        let m = intrinsic!(_mm256_castsi256_ps(_mm256_sub_epi32(bits, _mm256_slli_epi32::<23>(e))));
        (Self(intrinsic!(_mm256_cvtepi32_ps(e))), Self(m))
    }
}

impl I32x8 for Avx2Int {
    type Float = Avx2;

    #[inline(always)]
    fn splat(v: i32) -> Self {
        Self(intrinsic!(_mm256_set1_epi32(v)))
    }
    #[inline(always)]
    fn load(v: &[u32; 8]) -> Self {
        // The pointer is valid for eight unaligned reads: it comes from an array.
        Self(intrinsic!(_mm256_loadu_si256(v.as_ptr().cast())))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; 8]) {
        // The pointer is valid for eight unaligned writes: it comes from an array.
        intrinsic!(_mm256_storeu_si256(to.as_mut_ptr().cast(), self.0))
    }
    #[inline(always)]
    fn to_array(self) -> [i32; 8] {
        let mut out = [0; 8];
        // The pointer is valid for eight unaligned writes: it comes from an array.
        intrinsic!(_mm256_storeu_si256(out.as_mut_ptr().cast(), self.0));
        out
    }
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_and_si256(self.0, o.0)))
    }
    #[inline(always)]
    fn shift_right<const N: i32>(self) -> Self {
        Self(intrinsic!(_mm256_srli_epi32::<N>(self.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_min_epi32(self.0, o.0)))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(intrinsic!(_mm256_max_epi32(self.0, o.0)))
    }
    #[inline(always)]
    fn equal(self, o: Self) -> Avx2 {
        Avx2(intrinsic!(_mm256_castsi256_ps(_mm256_cmpeq_epi32(self.0, o.0))))
    }
    #[inline(always)]
    fn select(self, mask: Avx2, other: Self) -> Self {
        self.as_float().select(mask, other.as_float()).as_int()
    }
    #[inline(always)]
    fn to_float(self) -> Avx2 {
        Avx2(intrinsic!(_mm256_cvtepi32_ps(self.0)))
    }
    #[inline(always)]
    fn gather(self, table: &[u32]) -> Self {
        // Places are signed to the instruction: the table has less than 2³¹ words.
        let last = i32::try_from(table.len().wrapping_sub(1)).expect("between one and 2³¹ words");
        let at = intrinsic!(_mm256_min_epu32(self.0, _mm256_set1_epi32(last)));
        // Every place is inside the table.
        Self(intrinsic!(_mm256_i32gather_epi32::<4>(table.as_ptr().cast(), at)))
    }
    #[inline(always)]
    fn gather_pairs(self, table: &[u32]) -> (Self, Self) {
        let last = i32::try_from(table.len().wrapping_sub(2)).ok().filter(|l| *l >= 0);
        let last = last.expect("between two and 2³¹ words");
        let at = intrinsic!(_mm256_min_epu32(self.0, _mm256_set1_epi32(last)));
        let mut places = [0i32; 8];
        intrinsic!(_mm256_storeu_si256(places.as_mut_ptr().cast(), at));
        // Every place and the one after it are inside the table. One by one: quicker than the
        // gather instruction on the processors that this was measured on.
        let base = table.as_ptr();
        let pair = |i: usize| intrinsic!(base.add(places[i] as usize)).cast::<f64>();
        let two = |i: usize| intrinsic!(_mm_loadh_pd(_mm_load_sd(pair(i)), pair(i + 1)));
        let four = |i: usize| intrinsic!(_mm256_castpd_ps(_mm256_set_m128d(two(i + 2), two(i))));
        let (low, high) = (four(0), four(4));
        // Halves of 128 bits are shuffled on their own: 0 1 4 5, 2 3 6 7.
        let first = intrinsic!(_mm256_castps_si256(_mm256_shuffle_ps::<0x88>(low, high)));
        let second = intrinsic!(_mm256_castps_si256(_mm256_shuffle_ps::<0xdd>(low, high)));
        (
            Self(intrinsic!(_mm256_permute4x64_epi64::<0xd8>(first))),
            Self(intrinsic!(_mm256_permute4x64_epi64::<0xd8>(second))),
        )
    }
    #[inline(always)]
    fn as_float(self) -> Avx2 {
        Avx2(intrinsic!(_mm256_castsi256_ps(self.0)))
    }
}

impl Avx2 {
    #[inline(always)]
    fn as_int(self) -> Avx2Int {
        Avx2Int(intrinsic!(_mm256_castps_si256(self.0)))
    }
}

impl Floats for Avx512 {
    const LANES: usize = 16;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(intrinsic!(_mm512_set1_ps(v)))
    }
    #[inline(always)]
    fn load_slice(v: &[f32]) -> Self {
        let v: &[f32; 16] = v.first_chunk().expect("at least sixteen values");
        // The pointer is valid for sixteen unaligned reads: it comes from an array.
        Self(intrinsic!(_mm512_loadu_ps(v.as_ptr())))
    }
    #[inline(always)]
    fn store_slice(self, to: &mut [f32]) {
        let to: &mut [f32; 16] = to.first_chunk_mut().expect("at least sixteen places");
        intrinsic!(_mm512_storeu_ps(to.as_mut_ptr(), self.0))
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self(intrinsic!(_mm512_fmadd_ps(self.0, a.0, b.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(intrinsic!(_mm512_min_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn where_ge(self, a: Self, b: Self) -> Self {
        Self(intrinsic!(_mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(a.0, b.0), self.0)))
    }
    #[inline(always)]
    fn any_ge(self, o: Self) -> bool {
        intrinsic!(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(self.0, o.0)) != 0
    }
    #[inline(always)]
    fn add_exponent(self, t: Self) -> Self {
        let n = intrinsic!(_mm512_slli_epi32::<23>(_mm512_castps_si512(t.0)));
        Self(intrinsic!(_mm512_castsi512_ps(_mm512_add_epi32(_mm512_castps_si512(self.0), n))))
    }
    #[inline(always)]
    fn sums(v: [Self; 8]) -> [f32; 8] {
        let mut halves = [Avx2::zero(); 8];
        for (half, v) in halves.iter_mut().zip(v) {
            let low = intrinsic!(_mm512_castps512_ps256(v.0));
            *half = Avx2(low) + Avx2(intrinsic!(_mm512_extractf32x8_ps::<1>(v.0)));
        }
        Avx2::sums(halves)
    }
}
