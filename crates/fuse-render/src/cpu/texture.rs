//! Mip-mapped, anisotropically filtered textures in linear light.
//!
//! Texels are kept as linear 16-bit values, so that filtering needs no decoding; level k + 1 is
//! the 2×2 (area-weighted for odd sizes) mean of level k.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use glam::{Vec2, Vec3A, Vec4};

use crate::Texture;

/// Most taps along the long axis of a footprint.
pub(crate) const MAX_TAPS: f32 = 6.0;

pub(crate) struct Level {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<[u16; 4]>,
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
pub(super) fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

impl MipChain {
    pub fn new(texture: Arc<Texture>) -> Self {
        Self { texture, levels: OnceLock::new() }
    }

    /// Finest first.
    pub fn levels(&self) -> &[Level] {
        self.levels.get_or_init(|| {
            let mut levels = vec![Level::new(&self.texture)];
            while let Some(next) = levels.last().and_then(Level::half) {
                levels.push(next);
            }
            levels
        })
    }

    /// Colour at `uv`, averaged over the parallelogram of the screen-space derivatives.
    ///
    /// The level follows the short axis of the footprint; up to [`MAX_TAPS`] trilinear taps run
    /// along the long one.
    pub fn sample(&self, uv: Vec2, du: Vec2, dv: Vec2) -> Vec3A {
        let levels = self.levels();
        let size = Vec2::new(levels[0].width as f32, levels[0].height as f32);
        let (a, b) = ((du * size).length(), (dv * size).length());
        let (long, short, axis) = if a >= b { (a, b, du) } else { (b, a, dv) };
        let taps = (long / short.max(1e-6)).min(MAX_TAPS).min(long.max(1.0)).round().max(1.0);
        // Beyond MAX_TAPS the level rises with the long axis: blur, never shimmer.
        let level = fast_log2((long / taps).max(1.0));
        let mut sum = Vec4::ZERO;
        let n = taps as u32;
        for k in 0..n {
            let t = (k as f32 + 0.5) / taps - 0.5;
            sum += trilinear(levels, uv + axis * t, level);
        }
        Vec3A::from_vec4(sum * (1.0 / (taps * 65535.0)))
    }
}

fn trilinear(levels: &[Level], uv: Vec2, level: f32) -> Vec4 {
    let last = levels.len() - 1;
    let low = (level as usize).min(last);
    let fine = levels[low].bilinear(uv);
    let t = level - low as f32;
    if low == last || t < 1.0 / 64.0 {
        return fine;
    }
    fine + (levels[low + 1].bilinear(uv) - fine) * t
}

/// log2 of a number ≥ 1, within 0.01; the same bits on every machine.
fn fast_log2(v: f32) -> f32 {
    let bits = v.to_bits();
    let exponent = (bits >> 23) as f32 - 127.0;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    exponent + (m - 1.0) * (1.346_607 - 0.346_607 * m)
}

impl Level {
    /// The texture itself, in linear light.
    fn new(texture: &Texture) -> Self {
        let mut decode = [0u16; 256];
        for (i, d) in decode.iter_mut().enumerate() {
            *d = (srgb_to_linear(i as f32 / 255.0) * 65535.0 + 0.5) as u16;
        }
        let texels = texture
            .texels
            .iter()
            .map(|t| [decode[t[0] as usize], decode[t[1] as usize], decode[t[2] as usize], u16::from(t[3]) * 257])
            .collect();
        Self { width: texture.width, height: texture.height, texels }
    }

    /// The next smaller level; `None` after 1×1.
    fn half(&self) -> Option<Self> {
        if self.width == 1 && self.height == 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut texels = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            let (y0, y1) = span(y, height, self.height);
            for x in 0..width {
                let (x0, x1) = span(x, width, self.width);
                let mut sum = [0u32; 4];
                for yy in y0..y1 {
                    for xx in x0..x1 {
                        let t = self.texels[(yy * self.width + xx) as usize];
                        for c in 0..4 {
                            sum[c] += u32::from(t[c]);
                        }
                    }
                }
                let n = (y1 - y0) * (x1 - x0);
                texels.push(sum.map(|s| ((s + n / 2) / n) as u16));
            }
        }
        Some(Self { width, height, texels })
    }

    #[inline(always)]
    fn texel(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.texels[y as usize * self.width as usize + x as usize];
        Vec4::new(f32::from(r), f32::from(g), f32::from(b), f32::from(a))
    }

    #[inline(always)]
    fn bilinear(&self, uv: Vec2) -> Vec4 {
        let (x0, x1, fx) = wrap(uv.x, self.width);
        let (y0, y1, fy) = wrap(uv.y, self.height);
        let top = self.texel(x0, y0) + (self.texel(x1, y0) - self.texel(x0, y0)) * fx;
        let bottom = self.texel(x0, y1) + (self.texel(x1, y1) - self.texel(x0, y1)) * fx;
        top + (bottom - top) * fy
    }
}

/// Source texels `[a, b)` that texel `i` of `to` covers out of `from`.
fn span(i: u32, to: u32, from: u32) -> (u32, u32) {
    let a = (u64::from(i) * u64::from(from) / u64::from(to)) as u32;
    let b = (u64::from(i + 1) * u64::from(from)).div_ceil(u64::from(to)) as u32;
    (a, b)
}

/// The two texels around coordinate `t` of a repeating axis, and the weight of the second.
#[inline(always)]
fn wrap(t: f32, size: u32) -> (u32, u32, f32) {
    // No library call: rounding down by way of integers.
    let whole = t as i32;
    let fraction = t - whole as f32;
    let fraction = if fraction < 0.0 { fraction + 1.0 } else { fraction };
    let x = fraction * size as f32 + 0.5;
    let high = x as u32;
    // Texel centres are at halves: the lower neighbour is one before `high`, around the seam.
    let b = if high >= size { 0 } else { high };
    let a = if high == 0 { size - 1 } else { (high - 1).min(size - 1) };
    (a, b, x - high as f32)
}
