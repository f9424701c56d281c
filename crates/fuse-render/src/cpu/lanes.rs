//! Vectors of eight points at once.
//!
//! No fused multiply-add is used here or by what builds on this, so that every instruction set
//! gives the same bits.

use std::ops::{Add, Mul, Sub};

use fuse_camera::simd::F32x8;
use glam::Vec3A;

/// Eight vectors, or eight colours.
#[derive(Clone, Copy)]
pub(super) struct V3<V> {
    pub x: V,
    pub y: V,
    pub z: V,
}

impl<V: F32x8> V3<V> {
    /// The same vector eight times.
    #[inline(always)]
    pub fn splat(v: Vec3A) -> Self {
        Self { x: V::splat(v.x), y: V::splat(v.y), z: V::splat(v.z) }
    }

    /// The same number in all components.
    #[inline(always)]
    pub fn all(v: V) -> Self {
        Self { x: v, y: v, z: v }
    }

    #[inline(always)]
    pub fn load(v: &[[f32; 8]; 3]) -> Self {
        Self { x: V::load(&v[0]), y: V::load(&v[1]), z: V::load(&v[2]) }
    }

    #[inline(always)]
    pub fn store(self, to: &mut [[f32; 8]; 3]) {
        self.x.store(&mut to[0]);
        self.y.store(&mut to[1]);
        self.z.store(&mut to[2]);
    }

    #[inline(always)]
    pub fn dot(self, o: Self) -> V {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    #[inline(always)]
    pub fn scale(self, by: V) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }

    /// Of unit length; `other` where there is no length.
    #[inline(always)]
    pub fn normalize_or(self, other: Self) -> Self {
        let square = self.dot(self);
        let unit = self.scale(V::splat(1.0) / square.max(V::splat(1e-30)).sqrt());
        unit.select(square.gt(V::splat(1e-30)), other)
    }

    #[inline(always)]
    pub fn lerp(self, o: Self, t: V) -> Self {
        self + (o - self).scale(t)
    }

    /// `self` where the mask is set.
    #[inline(always)]
    pub fn select(self, mask: V, other: Self) -> Self {
        Self { x: self.x.select(mask, other.x), y: self.y.select(mask, other.y), z: self.z.select(mask, other.z) }
    }

    #[inline(always)]
    pub fn max_element(self) -> V {
        self.x.max(self.y).max(self.z)
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl<V: F32x8> $trait for V3<V> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self { x: self.x $op o.x, y: self.y $op o.y, z: self.z $op o.z }
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);

/// Between `low` and `high`.
#[inline(always)]
pub(super) fn clamp<V: F32x8>(v: V, low: f32, high: f32) -> V {
    v.max(V::splat(low)).min(V::splat(high))
}

/// `a` to `b`.
#[inline(always)]
pub(super) fn lerp<V: F32x8>(a: V, b: V, t: V) -> V {
    a + (b - a) * t
}

/// All bits where `v < o`.
#[inline(always)]
pub(super) fn less<V: F32x8>(v: V, o: V) -> V {
    o.gt(v)
}
