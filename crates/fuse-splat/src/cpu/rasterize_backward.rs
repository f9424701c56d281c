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

use super::rasterize::{BLOCK_COLUMNS, Broadcast, blocks, clamps, copy_line};
use crate::constants::{ALPHA_MAX, BLOCK_HEIGHT, BLOCK_WIDTH, TILE_BLOCKS, TILE_HEIGHT, TILE_WIDTH};
use crate::simd::{F32x8, Kernel, dispatch};
use crate::stages::{PairGradient, Pairs, Splat, View};

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
    tiles.into_par_iter().for_each(|tile| dispatch(level, tile));
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

/// What the backward pass knows of a block of eight pixels.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct BlockState {
    transmittance: [f32; 8],
    /// R.
    remaining: [f32; 8],
    /// G.
    gradient: [[f32; 8]; 3],
}

/// State of a tile.
struct Tile {
    blocks: [BlockState; TILE_BLOCKS],
    /// α and α/(1 − α) of one splat, by place in its list of blocks.
    alpha: [[[f32; 8]; 2]; TILE_BLOCKS],
}

impl Tile {
    const EMPTY: Self = Self {
        blocks: [BlockState { transmittance: [1.0; 8], remaining: [0.0; 8], gradient: [[0.0; 8]; 3] }; TILE_BLOCKS],
        alpha: [[[0.0; 8]; 2]; TILE_BLOCKS],
    };
}

impl Kernel for TileBackward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(self) {
        if self.gaussian.is_empty() {
            return;
        }
        let (column, row) = (self.tile % self.view.tiles_x(), self.tile / self.view.tiles_x());
        let origin = [(column * TILE_WIDTH) as f32, (row * TILE_HEIGHT) as f32];
        let mut tile = Tile::EMPTY;
        self.load::<V>(column, row, &mut tile);
        for ((&g, &mask), out) in self.gaussian.iter().zip(self.mask).zip(self.out) {
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
    /// Rows of the image → blocks. Pixels outside the image have no gradient.
    #[inline(always)]
    fn load<V: F32x8>(&self, column: usize, row: usize, tile: &mut Tile) {
        let (width, n) = (self.view.width, self.view.pixels());
        let (left, top) = (column * TILE_WIDTH, row * TILE_HEIGHT);
        for block in 0..TILE_BLOCKS {
            let x = left + block % BLOCK_COLUMNS * BLOCK_WIDTH;
            let y = top + block / BLOCK_COLUMNS * BLOCK_HEIGHT;
            if x >= width || y >= self.view.height {
                continue;
            }
            let columns = BLOCK_WIDTH.min(width - x);
            let state = &mut tile.blocks[block];
            let mut remaining = V::zero();
            for c in 0..3 {
                let mut color = [0.0; 8];
                for line in 0..BLOCK_HEIGHT.min(self.view.height - y) {
                    let at = c * n + (y + line) * width + x;
                    let lane = line * BLOCK_WIDTH;
                    copy_line(&self.color[at..at + columns], &mut color[lane..lane + BLOCK_WIDTH]);
                    copy_line(&self.gradient[at..at + columns], &mut state.gradient[c][lane..lane + BLOCK_WIDTH]);
                }
                remaining = V::load(&color).mul_add(V::load(&state.gradient[c]), remaining);
            }
            remaining.store(&mut state.remaining);
        }
    }
}

/// The nine sums of one splat over the blocks in `mask`; advances the tile's state past it.
#[inline(always)]
fn pair_gradient<V: F32x8, const CLAMP: bool>(
    splat: &Splat,
    origin: [f32; 2],
    mask: u64,
    tile: &mut Tile,
) -> PairGradient {
    let s = Broadcast::<V>::new(splat, origin);
    for (block, [alpha, odds]) in blocks(mask).zip(&mut tile.alpha) {
        let a = s.alpha::<CLAMP>(block);
        a.store(alpha);
        (a / (V::splat(1.0) - a)).store(odds);
    }
    let mut color = [V::zero(); 3];
    let mut moment = [V::zero(); 6];
    for (block, [alpha, odds]) in blocks(mask).zip(&tile.alpha) {
        let state = &mut tile.blocks[block];
        let alpha = V::load(alpha);
        let t = V::load(&state.transmittance);
        let w = alpha * t;
        (t - w).store(&mut state.transmittance);

        let [red, green, blue] = &state.gradient;
        let (red, green, blue) = (V::load(red), V::load(green), V::load(blue));
        color[0] = w.mul_add(red, color[0]);
        color[1] = w.mul_add(green, color[1]);
        color[2] = w.mul_add(blue, color[2]);
        let dot = s.color[2].mul_add(blue, s.color[1].mul_add(green, s.color[0] * red));
        let u = w * dot;
        let remaining = V::load(&state.remaining) - u;
        remaining.store(&mut state.remaining);

        // Where nothing is drawn, u and the odds are zero, and so is this.
        let g = u - remaining * V::load(odds);
        let g = if CLAMP { g.and(V::splat(ALPHA_MAX).gt(alpha)) } else { g };
        let (dx, dy) = s.offset(block);
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
