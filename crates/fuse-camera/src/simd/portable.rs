//! Lanes as plain arrays.

use std::array::from_fn;
use std::ops::{Add, Div, Mul, Sub};

use super::lanes::{F32x8, Floats, HALF_ROOT, I32x8};

/// Plain arrays, for whatever the build target has.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub struct Portable([f32; 8]);

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
    type Int = PortableInt;

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
    fn or(self, o: Self) -> Self {
        Self(from_fn(|i| f32::from_bits(self.0[i].to_bits() | o.0[i].to_bits())))
    }
    #[inline(always)]
    fn mask_bits(self) -> u8 {
        (0..8).fold(0, |bits, i| bits | ((self.0[i].to_bits() >> 31) as u8) << i)
    }
    #[inline(always)]
    fn to_int(self) -> PortableInt {
        PortableInt(self.0.map(|v| v as i32))
    }
    #[inline(always)]
    fn truncate(self) -> [i32; 8] {
        self.0.map(|v| v as i32)
    }
    #[inline(always)]
    fn transpose(rows: [Self; 8]) -> [Self; 8] {
        from_fn(|i| Self(from_fn(|j| rows[j].0[i])))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let e: [i32; 8] = from_fn(|i| (self.0[i].to_bits() as i32).wrapping_sub(HALF_ROOT) >> 23);
        let m = from_fn(|i| f32::from_bits((self.0[i].to_bits() as i32).wrapping_sub(e[i] << 23) as u32));
        (Self(from_fn(|i| e[i] as f32)), Self(m))
    }
}

/// Integers as plain arrays.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub struct PortableInt([i32; 8]);

macro_rules! integer_operator {
    ($trait:ident, $method:ident, $wrapping:ident) => {
        impl $trait for PortableInt {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self(from_fn(|i| self.0[i].$wrapping(o.0[i])))
            }
        }
    };
}
integer_operator!(Add, add, wrapping_add);
integer_operator!(Sub, sub, wrapping_sub);
integer_operator!(Mul, mul, wrapping_mul);

impl I32x8 for PortableInt {
    type Float = Portable;

    #[inline(always)]
    fn splat(v: i32) -> Self {
        Self([v; 8])
    }
    #[inline(always)]
    fn load(v: &[u32; 8]) -> Self {
        Self(v.map(|v| v as i32))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; 8]) {
        *to = self.0.map(|v| v as u32);
    }
    #[inline(always)]
    fn to_array(self) -> [i32; 8] {
        self.0
    }
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        Self(from_fn(|i| self.0[i] & o.0[i]))
    }
    #[inline(always)]
    fn shift_right<const N: i32>(self) -> Self {
        Self(self.0.map(|v| (v as u32 >> N) as i32))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(from_fn(|i| self.0[i].min(o.0[i])))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(from_fn(|i| self.0[i].max(o.0[i])))
    }
    #[inline(always)]
    fn equal(self, o: Self) -> Portable {
        Portable(from_fn(|i| mask(self.0[i] == o.0[i])))
    }
    #[inline(always)]
    fn select(self, mask: Portable, other: Self) -> Self {
        Self(from_fn(|i| if mask.0[i].to_bits() != 0 { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn to_float(self) -> Portable {
        Portable(self.0.map(|v| v as f32))
    }
    #[inline(always)]
    fn gather(self, table: &[u32]) -> Self {
        let last = table.len() - 1;
        Self(self.0.map(|i| table[(i as u32 as usize).min(last)] as i32))
    }
    #[inline(always)]
    fn gather_pairs(self, table: &[u32]) -> (Self, Self) {
        let last = table.len() - 2;
        let at = self.0.map(|i| (i as u32 as usize).min(last));
        (Self(at.map(|i| table[i] as i32)), Self(at.map(|i| table[i + 1] as i32)))
    }
    #[inline(always)]
    fn as_float(self) -> Portable {
        Portable(self.0.map(|v| f32::from_bits(v as u32)))
    }
}
