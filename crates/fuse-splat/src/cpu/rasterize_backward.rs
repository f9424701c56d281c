//! Gradient of the blending, front to back.
//!
//! With Rᵢ = Σ_c G_c (Σⱼ≥ᵢ wⱼ cⱼ + T b)_c, the part of colour · gradient that splat i and all
//! behind it contribute, R₀ = G · C and Rᵢ₊₁ = Rᵢ − uᵢ with uᵢ = wᵢ G · cᵢ:
//! αᵢ dL/dαᵢ = uᵢ − Rᵢ₊₁ αᵢ/(1 − αᵢ). One running scalar a pixel; no transmittance is stored.
//! Where α is clamped at 0.99 it does not depend on the exponent.
//!
//! A task owns a tile; each pair of Gaussian and tile has its own place for nine sums, so that
//! nothing is added atomically and the order of summation is fixed.

use fuse_camera::simd::Level;
use rayon::prelude::*;

use super::rasterize::{AHEAD, BLOCK, BLOCK_COLUMNS, Broadcast, TILE_PIXELS, TilePlane, clamps, copy_line, vectors};
use crate::constants::{ALPHA_MAX, BLOCK_HEIGHT, BLOCK_WIDTH, TILE_BLOCKS, TILE_HEIGHT, TILE_WIDTH};
use crate::stages::{PairGradient, Pairs, Splat, View};
use fuse_camera::simd::{Floats, WideKernel, dispatch_wide, prefetch};

/// Floats of a cache line.
const CACHE_LINE: usize = 16;

/// Fills `gradients`, one a pair, from the drawn image and the loss's gradient with respect to it
/// (three planes each).
pub(crate) fn rasterize_backward(
    level: Level,
    view: &View,
    splats: &[Splat],
    pairs: &Pairs,
    color: &[f32],
    gradient: &[f32],
    gradients: &mut Vec<PairGradient>,
) {
    gradients.resize(pairs.gaussian.len(), [0.0; 9]);
    let mut rest = &mut gradients[..];
    let mut tiles = Vec::with_capacity(pairs.offsets.len());
    for (tile, range) in pairs.offsets.windows(2).take(view.tiles_x() * view.tiles_y()).enumerate() {
        let range = range[0] as usize..range[1] as usize;
        let (own, others) = rest.split_at_mut(range.len());
        rest = others;
        let (gaussian, mask) = (&pairs.gaussian[range.clone()], &pairs.mask[range]);
        tiles.push(TileBackward { view, splats, tile, gaussian, mask, color, gradient, out: own });
    }
    tiles.into_par_iter().for_each(|tile| dispatch_wide(level, tile));
}

struct TileBackward<'a> {
    view: &'a View,
    splats: &'a [Splat],
    tile: usize,
    gaussian: &'a [u32],
    mask: &'a [u64],
    color: &'a [f32],
    gradient: &'a [f32],
    out: &'a mut [PairGradient],
}

/// State of a tile.
#[repr(C, align(64))]
struct Tile {
    transmittance: TilePlane,
    /// R.
    remaining: TilePlane,
    /// G.
    gradient: [TilePlane; 3],
    /// α and α/(1 − α) of one splat, by place in its list of vectors.
    alpha: TilePlane,
    odds: TilePlane,
}

impl Tile {
    const EMPTY: Self = Self {
        transmittance: [1.0; TILE_PIXELS + 16],
        remaining: [0.0; TILE_PIXELS + 16],
        gradient: [[0.0; TILE_PIXELS + 16]; 3],
        alpha: [0.0; TILE_PIXELS + 16],
        odds: [0.0; TILE_PIXELS + 16],
    };
}

impl WideKernel for TileBackward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Floats>(self) {
        if self.gaussian.is_empty() {
            return;
        }
        let (column, row) = (self.tile % self.view.tiles_x(), self.tile / self.view.tiles_x());
        let origin = [(column * TILE_WIDTH) as f32, (row * TILE_HEIGHT) as f32];
        let mut tile = Tile::EMPTY;
        self.load::<V>(column, row, &mut tile);
        self.prefetch_next(column + 1, row);
        for (k, ((&g, &mask), out)) in self.gaussian.iter().zip(self.mask).zip(self.out).enumerate() {
            if let Some(&soon) = self.gaussian.get(k + AHEAD) {
                prefetch(self.splats, soon as usize);
            }
            *out = [0.0; 9];
            if mask != 0 {
                let splat = &self.splats[g as usize];
                *out = if clamps(splat) {
                    pair_gradient::<V, true>(splat, origin, mask, &mut tile)
                } else {
                    pair_gradient::<V, false>(splat, origin, mask, &mut tile)
                };
            }
        }
    }
}

impl TileBackward<'_> {
    /// The next tile, which this thread most probably works on next.
    #[inline(always)]
    fn prefetch_next(&self, column: usize, row: usize) {
        let (width, n) = (self.view.width, self.view.pixels());
        for y in row * TILE_HEIGHT..((row + 1) * TILE_HEIGHT).min(self.view.height) {
            for c in 0..3 {
                let at = c * n + y * width + column * TILE_WIDTH;
                for line in [0, CACHE_LINE] {
                    prefetch(self.color, at + line);
                    prefetch(self.gradient, at + line);
                }
            }
        }
    }

    /// Rows of the image → blocks. Pixels outside the image have no gradient.
    #[inline(always)]
    fn load<V: Floats>(&self, column: usize, row: usize, tile: &mut Tile) {
        let (width, n) = (self.view.width, self.view.pixels());
        let (left, top) = (column * TILE_WIDTH, row * TILE_HEIGHT);
        for c in 0..3 {
            // Where there is no pixel, the gradient is zero and the colour is of no account.
            let mut color = [0.0; TILE_PIXELS + 16];
            let gradient = &mut tile.gradient[c];
            for block in 0..TILE_BLOCKS {
                let x = left + block % BLOCK_COLUMNS * BLOCK_WIDTH;
                let y = top + block / BLOCK_COLUMNS * BLOCK_HEIGHT;
                if x >= width || y >= self.view.height {
                    continue;
                }
                let columns = BLOCK_WIDTH.min(width - x);
                for line in 0..BLOCK_HEIGHT.min(self.view.height - y) {
                    let at = c * n + (y + line) * width + x;
                    let pixel = block * BLOCK + line * BLOCK_WIDTH;
                    copy_line(&self.color[at..at + columns], &mut color[pixel..pixel + BLOCK_WIDTH]);
                    copy_line(&self.gradient[at..at + columns], &mut gradient[pixel..pixel + BLOCK_WIDTH]);
                }
            }
            for at in (0..TILE_PIXELS).step_by(V::LANES) {
                let product = V::load_slice(&color[at..])
                    .mul_add(V::load_slice(&gradient[at..]), V::load_slice(&tile.remaining[at..]));
                product.store_slice(&mut tile.remaining[at..]);
            }
        }
    }
}

/// The nine sums of one splat over the blocks in `mask`; advances the tile's state past it.
#[inline(always)]
fn pair_gradient<V: Floats, const CLAMP: bool>(
    splat: &Splat,
    origin: [f32; 2],
    mask: u64,
    tile: &mut Tile,
) -> PairGradient {
    let s = Broadcast::<V>::new(splat, origin);
    let places = tile.alpha.chunks_exact_mut(V::LANES).zip(tile.odds.chunks_exact_mut(V::LANES));
    for (at, (alpha, odds)) in vectors::<V>(mask).zip(places) {
        let a = s.alpha::<CLAMP>(at);
        a.store_slice(alpha);
        (a / (V::splat(1.0) - a)).store_slice(odds);
    }
    let mut color = [V::zero(); 3];
    let mut moment = [V::zero(); 6];
    let places = tile.alpha.chunks_exact(V::LANES).zip(tile.odds.chunks_exact(V::LANES));
    for (at, (alpha, odds)) in vectors::<V>(mask).zip(places) {
        let alpha = V::load_slice(alpha);
        let t = V::load_slice(&tile.transmittance[at..]);
        let w = alpha * t;
        (t - w).store_slice(&mut tile.transmittance[at..]);

        let [red, green, blue] = &tile.gradient;
        let (red, green, blue) = (V::load_slice(&red[at..]), V::load_slice(&green[at..]), V::load_slice(&blue[at..]));
        color[0] = w.mul_add(red, color[0]);
        color[1] = w.mul_add(green, color[1]);
        color[2] = w.mul_add(blue, color[2]);
        let dot = s.color[2].mul_add(blue, s.color[1].mul_add(green, s.color[0] * red));
        let u = w * dot;
        let remaining = V::load_slice(&tile.remaining[at..]) - u;
        remaining.store_slice(&mut tile.remaining[at..]);

        // Where nothing is drawn, u and the odds are zero, and so is this.
        let g = u - remaining * V::load_slice(odds);
        let g = if CLAMP { g - g.where_ge(alpha, V::splat(ALPHA_MAX)) } else { g };
        let (dx, dy) = s.offset(at);
        let (gx, gy) = (g * dx, g * dy);
        moment[0] = moment[0] + g;
        moment[1] = moment[1] + gx;
        moment[2] = moment[2] + gy;
        moment[3] = gx.mul_add(dx, moment[3]);
        moment[4] = gx.mul_add(dy, moment[4]);
        moment[5] = gy.mul_add(dy, moment[5]);
    }
    let [m0, m1, m2, m3, m4, m5] = moment;
    let first = V::sums([color[0], color[1], color[2], m0, m1, m2, m3, m4]);
    let last = V::sums([m5; 8])[0];
    [first[0], first[1], first[2], first[3], first[4], first[5], first[6], first[7], last]
}
