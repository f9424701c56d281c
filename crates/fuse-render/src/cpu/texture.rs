//! Mip-mapped, anisotropically filtered textures in linear light.
//!
//! A texel is a word of three 10-bit square roots of linear values: what an 8-bit sRGB texture
//! holds keeps its steps, eight can be fetched at once, and squaring gives linear light. Level
//! k + 1 is the 2×2 (area-weighted for odd sizes) mean of level k in linear light.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use fuse_camera::simd::{F32x8, I32x8};

use super::lanes::{V3, clamp, less};
use crate::Texture;

/// Most taps along the long axis of a footprint.
pub(crate) const MAX_TAPS: f32 = 4.0;
/// Length of a footprint that one tap serves, in widths.
pub(crate) const ASPECT: f32 = 1.6;
/// How much longer than the texels of its level a tap's part of the footprint may be.
pub(crate) const STRETCH: f32 = 1.3;
/// Share of the way from one level to the next over which the nearer one is taken alone, at each end.
pub(crate) const ALONE: f32 = 0.35;
/// Largest value of a channel.
pub(crate) const ONE: f32 = 1023.0;

/// Side of the squares that texels are kept in, a power of two: what is near in the picture is
/// near in memory.
pub(crate) const SQUARE: u32 = 1 << SHIFT;
const SHIFT: i32 = 4;
/// Words of a row of a square: its texels, and the one to the right of them once more, so that
/// neighbours are read in one.
pub(crate) const ROW: u32 = SQUARE + 1;

pub(crate) struct Level {
    pub width: u32,
    pub height: u32,
    /// Squares of a row of them.
    pub across: u32,
    /// `r << 20 | g << 10 | b`, square by square.
    pub texels: Vec<u32>,
}

/// A texture and its smaller copies, made when first sampled: depth and ids need none.
pub(crate) struct MipChain {
    texture: Arc<Texture>,
    levels: OnceLock<Vec<Level>>,
}

/// Chains by texture identity, so that instances share them.
#[derive(Default)]
pub(super) struct MipCache(HashMap<*const Texture, Arc<MipChain>>);

impl MipCache {
    pub fn get(&mut self, texture: &Arc<Texture>) -> Arc<MipChain> {
        self.0.entry(Arc::as_ptr(texture)).or_insert_with(|| Arc::new(MipChain::new(texture.clone()))).clone()
    }
}

/// sRGB transfer function, [0, 1] → [0, 1].
pub(crate) fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Pairs of numbers, eight of each.
type V2<V> = [V; 2];

impl MipChain {
    pub fn new(texture: Arc<Texture>) -> Self {
        Self { texture, levels: OnceLock::new() }
    }

    /// Finest first.
    pub fn levels(&self) -> &[Level] {
        // By the one thread that came first: if it waited for others it might be given a tile that waits for it.
        self.levels.get_or_init(|| {
            let mut levels = vec![Level::new(&self.texture)];
            while let Some(next) = levels.last().and_then(Level::half) {
                levels.push(next);
            }
            levels
        })
    }

    /// Linear colours at `uv`, each averaged over the parallelogram of its screen-space
    /// derivatives.
    ///
    /// The level follows the short axis of the footprint; up to [`MAX_TAPS`] trilinear taps run
    /// along the long one, each for a part of it that is up to [`ASPECT`] times as long as wide.
    #[inline(always)]
    pub(super) fn sample<V: F32x8>(&self, uv: V2<V>, du: V2<V>, dv: V2<V>) -> V3<V> {
        let levels = self.levels();
        let size = [V::splat(levels[0].width as f32), V::splat(levels[0].height as f32)];
        let (a, b) = (length(du, size), length(dv, size));
        let first = a.ge(b);
        let (long, short) = (a.max(b), a.min(b));
        let axis = [du[0].select(first, dv[0]), du[1].select(first, dv[1])];
        let one = V::splat(1.0);
        let wanted = (long / short.max(V::splat(1e-6))).min(long.max(one)) * V::splat(1.0 / ASPECT);
        let taps = (wanted + V::splat(0.5)).to_int().to_float().max(one).min(V::splat(MAX_TAPS));
        // Beyond MAX_TAPS the level rises with the long axis: blur, never shimmer.
        let level = log2(short.max(long * V::splat(1.0 / STRETCH) / taps).max(one));
        let last = V::Int::splat(levels.len() as i32 - 1);
        let low = level.to_int().min(last);
        let t = level - low.to_float();
        // One level alone serves near its own scale.
        let t = clamp((t - V::splat(ALONE)) * V::splat(1.0 / (1.0 - 2.0 * ALONE)), 0.0, 1.0);
        let blend = t.gt(V::zero()).and(less(low.to_float(), last.to_float()));
        let chosen = low.to_array();
        let uniform = low.equal(V::Int::splat(chosen[0])).mask_bits() == u8::MAX;
        let blended = blend.mask_bits() != 0;
        let step = one / taps;
        let mut most = 0.0f32;
        for n in taps.to_array() {
            most = most.max(n);
        }
        let mut sum = V3::all(V::zero());
        for k in 0..most as u32 {
            let k = V::splat(k as f32);
            let offset = (k + V::splat(0.5)) * step - V::splat(0.5);
            let at = [uv[0] + axis[0] * offset, uv[1] + axis[1] * offset];
            let mut color =
                if uniform { levels[chosen[0] as usize].bilinear(at) } else { several(levels, &chosen, 0, at) };
            if blended {
                let coarse = if uniform {
                    levels[(chosen[0] as usize + 1).min(levels.len() - 1)].bilinear(at)
                } else {
                    several(levels, &chosen, 1, at)
                };
                color = color.lerp(coarse, t.and(blend));
            }
            let active = less(k, taps);
            sum = sum + V3 { x: color.x.and(active), y: color.y.and(active), z: color.z.and(active) };
        }
        sum.scale(step * V::splat(1.0 / (ONE * ONE)))
    }
}

/// Length in units of `1 / size`.
#[inline(always)]
fn length<V: F32x8>(d: V2<V>, size: V2<V>) -> V {
    let (x, y) = (d[0] * size[0], d[1] * size[1]);
    (x * x + y * y).sqrt()
}

/// Bilinear samples where points have levels of their own, `up` levels above `chosen`.
#[inline(always)]
fn several<V: F32x8>(levels: &[Level], chosen: &[i32; 8], up: usize, at: V2<V>) -> V3<V> {
    let mut out = V3::all(V::zero());
    let (mut low, mut high) = (i32::MAX, 0);
    for l in chosen {
        (low, high) = (low.min(*l), high.max(*l));
    }
    for l in low..=high {
        let mut here = [0.0; 8];
        let mut any = false;
        for i in 0..8 {
            here[i] = f32::from(u8::from(chosen[i] == l));
            any |= chosen[i] == l;
        }
        if any {
            let level = &levels[(l as usize + up).min(levels.len() - 1)];
            out = level.bilinear(at).select(V::load(&here).gt(V::zero()), out);
        }
    }
    out
}

/// log2 of numbers ≥ 1, within 0.01.
#[inline(always)]
fn log2<V: F32x8>(v: V) -> V {
    let (exponent, m) = v.split_exponent();
    // The mantissa is in [√½, √2).
    let x = m - V::splat(1.0);
    exponent + x * (V::splat(std::f32::consts::LOG2_E) - x * (V::splat(0.721_348) - x * V::splat(0.42)))
}

impl Level {
    /// The texture itself.
    fn new(texture: &Texture) -> Self {
        let mut decode = [0u32; 256];
        for (i, d) in decode.iter_mut().enumerate() {
            *d = root(srgb_to_linear(i as f32 / 255.0));
        }
        let texel = |x: u32, y: u32| {
            let t = texture.texels[y as usize * texture.width as usize + x as usize];
            pack([t[0], t[1], t[2]].map(|c| decode[c as usize]))
        };
        Self::fill(texture.width, texture.height, texel)
    }

    /// From its texels.
    fn fill(width: u32, height: u32, texel: impl Fn(u32, u32) -> u32) -> Self {
        let across = width.div_ceil(SQUARE);
        let mut texels = vec![0; (across * height.div_ceil(SQUARE) * ROW * SQUARE) as usize];
        for (band, squares) in texels.chunks_mut((across * ROW * SQUARE) as usize).enumerate() {
            for (i, row) in squares.chunks_mut(ROW as usize).enumerate() {
                let (square, y) = (i as u32 / SQUARE, band as u32 * SQUARE + i as u32 % SQUARE);
                if y < height {
                    for (k, out) in row.iter_mut().enumerate() {
                        // The texel to the right of the last one is the first one.
                        let x = square * SQUARE + k as u32;
                        *out = if x < width { texel(x, y) } else { texel(0, y) };
                    }
                }
            }
        }
        Self { width, height, across, texels }
    }

    fn at(&self, x: u32, y: u32) -> u32 {
        let square = y / SQUARE * self.across + x / SQUARE;
        self.texels[(square * ROW * SQUARE + y % SQUARE * ROW + x % SQUARE) as usize]
    }

    /// The next smaller level; `None` after 1×1.
    fn half(&self) -> Option<Self> {
        if self.width == 1 && self.height == 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let texel = |x: u32, y: u32| {
            let ((x0, x1), (y0, y1)) = (span(x, width, self.width), span(y, height, self.height));
            let mut sum = [0u32; 3];
            for yy in y0..y1 {
                for xx in x0..x1 {
                    let t = self.at(xx, yy);
                    for (s, c) in sum.iter_mut().zip([t >> 20, t >> 10 & 1023, t & 1023]) {
                        *s += c * c;
                    }
                }
            }
            let n = ((y1 - y0) * (x1 - x0)) as f32;
            pack(sum.map(|s| root(s as f32 / (n * ONE * ONE))))
        };
        Some(Self::fill(width, height, texel))
    }

    /// Squares of the stored values, in [0, 1023²], between the four texels around `uv`.
    #[inline(always)]
    fn bilinear<V: F32x8>(&self, uv: V2<V>) -> V3<V> {
        let (x0, _, fx) = wrap(uv[0], self.width);
        let (y0, y1, fy) = wrap(uv[1], self.height);
        let inner = V::Int::splat(SQUARE as i32 - 1);
        let square = V::Int::splat((ROW * SQUARE) as i32);
        let x = x0.shift_right::<SHIFT>() * square + x0.and(inner);
        let band = V::Int::splat((self.across * ROW * SQUARE) as i32);
        let row = V::Int::splat(ROW as i32);
        let (a, b) = (y0.shift_right::<SHIFT>() * band + y0.and(inner) * row + x).gather_pairs(&self.texels);
        let above = linear::<V>(a).lerp(linear(b), fx);
        let (a, b) = (y1.shift_right::<SHIFT>() * band + y1.and(inner) * row + x).gather_pairs(&self.texels);
        let below = linear::<V>(a).lerp(linear(b), fx);
        above.lerp(below, fy)
    }
}

/// The channels of packed texels, squared.
#[inline(always)]
fn linear<V: F32x8>(texel: V::Int) -> V3<V> {
    let ten = V::Int::splat(1023);
    let (r, g, b) = (
        texel.shift_right::<20>().to_float(),
        texel.shift_right::<10>().and(ten).to_float(),
        texel.and(ten).to_float(),
    );
    V3 { x: r * r, y: g * g, z: b * b }
}

/// The stored form of a linear value in [0, 1].
fn root(v: f32) -> u32 {
    (v.sqrt() * ONE + 0.5) as u32
}

fn pack([r, g, b]: [u32; 3]) -> u32 {
    r << 20 | g << 10 | b
}

/// Source texels `[a, b)` that texel `i` of `to` covers out of `from`.
fn span(i: u32, to: u32, from: u32) -> (u32, u32) {
    let a = (u64::from(i) * u64::from(from) / u64::from(to)) as u32;
    let b = (u64::from(i + 1) * u64::from(from)).div_ceil(u64::from(to)) as u32;
    (a, b)
}

/// The two texels around coordinate `t` of a repeating axis, and the weight of the second.
#[inline(always)]
fn wrap<V: F32x8>(t: V, size: u32) -> (V::Int, V::Int, V) {
    let (zero, one) = (V::Int::splat(0), V::Int::splat(1));
    let last = V::Int::splat(size as i32 - 1);
    // No library call: rounding down by way of integers.
    let fraction = t - t.to_int().to_float();
    let fraction = (fraction + V::splat(1.0)).select(less(fraction, V::zero()), fraction);
    let x = fraction * V::splat(size as f32) + V::splat(0.5);
    let high = x.to_int();
    // Texel centres are at halves: the lower neighbour is one before `high`, around the seam.
    let b = zero.select(less(last.to_float(), high.to_float()), high);
    let a = last.select(high.equal(zero), (high - one).min(last));
    (a, b, x - high.to_float())
}
