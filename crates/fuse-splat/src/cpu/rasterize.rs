//! Blending: splats of a tile, nearest first → colour, opacity, depth.
//!
//! C = Σᵢ wᵢ cᵢ + T b, wᵢ = αᵢ Tᵢ, Tᵢ = Πⱼ﹤ᵢ (1 − αⱼ), αᵢ = min(0.99, 2^pᵢ), skipped where
//! αᵢ < 1/255; b is the background.
//!
//! A task owns a row of tiles, hence a band of the image. The splat is in the outer loop, the
//! state of the tile's 64 blocks of eight pixels stays in the first-level cache. A vector holds one
//! block or, with sixteen lanes, two side by side, of which one may lie outside the mask. A vector
//! is alive while one of its pixels lets through at least 1e-4; every eighth splat looks. The masks
//! less what was not alive are written back, so that the backward pass does the same work.

use fuse_camera::simd::Level;
use rayon::prelude::*;

use crate::constants::{
    ALPHA_MAX, BLOCK_HEIGHT, BLOCK_WIDTH, LOG2_ALPHA_MAX, LOG2_ALPHA_MIN, TILE_BLOCKS, TILE_HEIGHT, TILE_WIDTH,
    TRANSMITTANCE_MIN,
};
use crate::stages::{Pairs, Planes, Splat, View};
use fuse_camera::simd::{Floats, WideKernel, dispatch_wide, prefetch};

/// Blocks side by side in a tile.
pub(super) const BLOCK_COLUMNS: usize = TILE_WIDTH / BLOCK_WIDTH;
/// Pixels of a block.
pub(super) const BLOCK: usize = BLOCK_WIDTH * BLOCK_HEIGHT;
/// Splats by which memory is asked for ahead of its use.
pub(super) const AHEAD: usize = 6;
/// Splats between two looks at which blocks are alive.
const LOOK: usize = 8;

/// What the forward pass leaves.
#[derive(Debug, Default)]
pub(crate) struct Image {
    /// Red, green, blue.
    pub color: Planes,
    /// What each pixel lets through; like the depth only filled on request, training needs neither.
    pub transmittance: Vec<f32>,
    /// Σ wᵢ zᵢ, metres.
    pub depth: Vec<f32>,
}

/// Draws all tiles.
pub(crate) fn rasterize(
    level: Level,
    view: &View,
    background: [f32; 3],
    splats: &[Splat],
    pairs: &mut Pairs,
    with_depth: bool,
    image: &mut Image,
) {
    let n = view.pixels();
    image.color.resize(3 * n, 0.0);
    for plane in [&mut image.transmittance, &mut image.depth] {
        plane.resize(if with_depth { n } else { 0 }, 0.0);
    }
    bands(view, background, splats, pairs, image).into_par_iter().for_each(|band| dispatch_wide(level, band));
}

/// One row of tiles and its part of the image.
struct Band<'a> {
    view: &'a View,
    background: [f32; 3],
    splats: &'a [Splat],
    row: usize,
    offsets: &'a [u32],
    gaussian: &'a [u32],
    mask: &'a mut [u64],
    color: [&'a mut [f32]; 3],
    /// Transmittance and depth.
    extra: Option<[&'a mut [f32]; 2]>,
}

fn bands<'a>(
    view: &'a View,
    background: [f32; 3],
    splats: &'a [Splat],
    pairs: &'a mut Pairs,
    image: &'a mut Image,
) -> Vec<Band<'a>> {
    let tiles = view.tiles_x();
    let size = TILE_HEIGHT * view.width;
    let mut mask = &mut pairs.mask[..];
    let mut planes = image.color.chunks_mut(view.pixels()).map(|p| p.chunks_mut(size));
    let (Some(mut red), Some(mut green), Some(mut blue)) = (planes.next(), planes.next(), planes.next()) else {
        return Vec::new();
    };
    let mut transmittance = image.transmittance.chunks_mut(size);
    let mut depth = image.depth.chunks_mut(size);
    let mut out = Vec::with_capacity(view.tiles_y());
    for row in 0..view.tiles_y() {
        let offsets = &pairs.offsets[row * tiles..=(row + 1) * tiles];
        let (first, last) = (offsets[0] as usize, offsets[tiles] as usize);
        let (own, rest) = mask.split_at_mut(last - first);
        mask = rest;
        if let (Some(r), Some(g), Some(b)) = (red.next(), green.next(), blue.next()) {
            out.push(Band {
                view,
                background,
                splats,
                row,
                offsets,
                gaussian: &pairs.gaussian[first..last],
                mask: own,
                color: [r, g, b],
                extra: transmittance.next().zip(depth.next()).map(|(t, d)| [t, d]),
            });
        }
    }
    out
}

/// Pixels of a tile.
pub(super) const TILE_PIXELS: usize = TILE_WIDTH * TILE_HEIGHT;
/// One value for each pixel of a tile, block by block, and a gap: planes that lie 4 KiB apart make
/// the processor take a load from one for a load of what was just stored to the other.
pub(super) type TilePlane = [f32; TILE_PIXELS + 16];

/// State of a tile.
#[repr(C, align(64))]
struct Tile {
    transmittance: TilePlane,
    color: [TilePlane; 3],
    depth: TilePlane,
    /// α of one splat, by place in its list of vectors.
    alpha: TilePlane,
}

impl Tile {
    const EMPTY: Self = Self {
        transmittance: [1.0; TILE_PIXELS + 16],
        color: [[0.0; TILE_PIXELS + 16]; 3],
        depth: [0.0; TILE_PIXELS + 16],
        alpha: [0.0; TILE_PIXELS + 16],
    };
}

impl WideKernel for Band<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Floats>(mut self) {
        let base = self.offsets[0] as usize;
        for column in 0..self.view.tiles_x() {
            let range = self.offsets[column] as usize - base..self.offsets[column + 1] as usize - base;
            let origin = [(column * TILE_WIDTH) as f32, (self.row * TILE_HEIGHT) as f32];
            let mut tile = Tile::EMPTY;
            let (gaussian, mask) = (&self.gaussian[range.clone()], &mut self.mask[range]);
            if self.extra.is_some() {
                draw_tile::<V, true>(origin, self.splats, gaussian, mask, &mut tile);
            } else {
                draw_tile::<V, false>(origin, self.splats, gaussian, mask, &mut tile);
            }
            self.store::<V>(column, &mut tile);
        }
    }
}

/// Offsets of the pixel centres from the tile's corner.
#[repr(C, align(64))]
pub(super) struct Offsets {
    pub x: TilePlane,
    pub y: TilePlane,
}

pub(super) static OFFSETS: Offsets = {
    let mut offsets = Offsets { x: [0.0; TILE_PIXELS + 16], y: [0.0; TILE_PIXELS + 16] };
    let mut i = 0;
    while i < TILE_PIXELS {
        let (block, lane) = (i / BLOCK, i % BLOCK);
        offsets.x[i] = (block % BLOCK_COLUMNS * BLOCK_WIDTH + lane % BLOCK_WIDTH) as f32 + 0.5;
        offsets.y[i] = (block / BLOCK_COLUMNS * BLOCK_HEIGHT + lane / BLOCK_WIDTH) as f32 + 0.5;
        i += 1;
    }
    offsets
};

/// The splat's numbers in all lanes, its mean relative to the tile's corner.
pub(super) struct Broadcast<V> {
    mean: [V; 2],
    a: V,
    b: V,
    c: V,
    log2_opacity: V,
    pub color: [V; 3],
}

impl<V: Floats> Broadcast<V> {
    #[inline(always)]
    pub fn new(splat: &Splat, origin: [f32; 2]) -> Self {
        Self {
            mean: [V::splat(splat.mean[0] - origin[0]), V::splat(splat.mean[1] - origin[1])],
            a: V::splat(splat.a),
            b: V::splat(splat.b),
            c: V::splat(splat.c),
            log2_opacity: V::splat(splat.log2_opacity),
            color: [V::splat(splat.color[0]), V::splat(splat.color[1]), V::splat(splat.color[2])],
        }
    }

    /// (dx, dy) at the pixels of the vector that begins at pixel `at` of the tile.
    #[inline(always)]
    pub fn offset(&self, at: usize) -> (V, V) {
        (V::load_slice(&OFFSETS.x[at..]) - self.mean[0], V::load_slice(&OFFSETS.y[at..]) - self.mean[1])
    }

    /// α at the pixels of a vector, clamped only where `CLAMP` says that it can be necessary.
    #[inline(always)]
    pub fn alpha<const CLAMP: bool>(&self, at: usize) -> V {
        let (dx, dy) = self.offset(at);
        let linear = self.b.mul_add(dy, self.a * dx);
        let constant = (self.c * dy).mul_add(dy, self.log2_opacity);
        let p = linear.mul_add(dx, constant);
        let alpha = if CLAMP { p.exp2().min(V::splat(ALPHA_MAX)) } else { p.exp2() };
        // The test is on the exponent: far from the mean, 2^p wraps.
        alpha.where_ge(p, V::splat(LOG2_ALPHA_MIN))
    }
}

/// Can α reach its clamp?
#[inline(always)]
pub(super) fn clamps(splat: &Splat) -> bool {
    splat.log2_opacity >= LOG2_ALPHA_MAX
}

/// The first pixels, in the tile, of the vectors in which a mask has a block.
#[inline(always)]
pub(super) fn vectors<V: Floats>(mask: u64) -> impl Iterator<Item = usize> {
    let mut first = if V::LANES == BLOCK { mask } else { (mask | mask >> 1) & 0x5555_5555_5555_5555 };
    std::iter::from_fn(move || {
        let block = first.trailing_zeros() as usize;
        first &= first.wrapping_sub(1);
        // Even numbers are all there are with sixteen lanes, but the compiler does not know.
        let at = block * BLOCK;
        (at <= TILE_PIXELS - V::LANES).then_some(at)
    })
}

#[inline(always)]
fn draw_tile<V: Floats, const DEPTH: bool>(
    origin: [f32; 2],
    splats: &[Splat],
    gaussian: &[u32],
    mask: &mut [u64],
    tile: &mut Tile,
) {
    let (mut alive, mut drawn) = (u64::MAX, 0);
    for (k, (&g, mask)) in gaussian.iter().zip(mask).enumerate() {
        if let Some(&soon) = gaussian.get(k + AHEAD) {
            prefetch(splats, soon as usize);
        }
        if k.is_multiple_of(LOOK) {
            alive = still_alive::<V>(tile, alive, drawn);
            drawn = 0;
        }
        *mask &= alive;
        if *mask == 0 {
            continue;
        }
        drawn |= *mask;
        let splat = &splats[g as usize];
        if clamps(splat) {
            draw_pair::<V, DEPTH, true>(splat, origin, *mask, tile);
        } else {
            draw_pair::<V, DEPTH, false>(splat, origin, *mask, tile);
        }
    }
}

/// One splat on one tile: first all α, then all blending. In one loop more values are alive than
/// AVX2 has registers.
#[inline(always)]
fn draw_pair<V: Floats, const DEPTH: bool, const CLAMP: bool>(
    splat: &Splat,
    origin: [f32; 2],
    mask: u64,
    tile: &mut Tile,
) {
    let s = Broadcast::<V>::new(splat, origin);
    let depth = V::splat(splat.depth);
    for (at, alpha) in vectors::<V>(mask).zip(tile.alpha.chunks_exact_mut(V::LANES)) {
        s.alpha::<CLAMP>(at).store_slice(alpha);
    }
    for (at, alpha) in vectors::<V>(mask).zip(tile.alpha.chunks_exact(V::LANES)) {
        let t = V::load_slice(&tile.transmittance[at..]);
        let w = V::load_slice(alpha) * t;
        (t - w).store_slice(&mut tile.transmittance[at..]);
        for (sum, color) in tile.color.iter_mut().zip(s.color) {
            w.mul_add(color, V::load_slice(&sum[at..])).store_slice(&mut sum[at..]);
        }
        if DEPTH {
            w.mul_add(depth, V::load_slice(&tile.depth[at..])).store_slice(&mut tile.depth[at..]);
        }
    }
}

/// `alive` less the vectors among those in `drawn` without a pixel that is not finished.
#[inline(always)]
fn still_alive<V: Floats>(tile: &Tile, alive: u64, drawn: u64) -> u64 {
    let vector = (1 << (V::LANES / BLOCK)) - 1;
    let mut still = alive;
    for at in vectors::<V>(drawn) {
        if !V::load_slice(&tile.transmittance[at..]).any_ge(V::splat(TRANSMITTANCE_MIN)) {
            still &= !(vector << (at / BLOCK));
        }
    }
    still
}

impl Band<'_> {
    /// Blocks → rows of the image, background added.
    #[inline(always)]
    fn store<V: Floats>(&mut self, column: usize, tile: &mut Tile) {
        let width = self.view.width;
        let rows = self.color[0].len() / width;
        for (plane, background) in tile.color.iter_mut().zip(self.background) {
            let vectors = plane.chunks_exact_mut(V::LANES).zip(tile.transmittance.chunks_exact(V::LANES));
            for (color, t) in vectors {
                let sum = V::load_slice(t).mul_add(V::splat(background), V::load_slice(color));
                sum.store_slice(color);
            }
        }
        for b in 0..TILE_BLOCKS {
            let x = column * TILE_WIDTH + b % BLOCK_COLUMNS * BLOCK_WIDTH;
            let y = b / BLOCK_COLUMNS * BLOCK_HEIGHT;
            if x >= width || y >= rows {
                continue;
            }
            let put = |from: &TilePlane, plane: &mut [f32]| {
                for (line, y) in from[b * BLOCK..(b + 1) * BLOCK].chunks_exact(BLOCK_WIDTH).zip(y..rows) {
                    copy_line(line, &mut plane[y * width + x..(y + 1) * width]);
                }
            };
            for (from, plane) in tile.color.iter().zip(&mut self.color) {
                put(from, plane);
            }
            if let Some([transmittance, depth]) = &mut self.extra {
                put(&tile.transmittance, transmittance);
                put(&tile.depth, depth);
            }
        }
    }
}

/// Copies a line of a block to or from the image, as much of it as both hold.
#[inline(always)]
pub(super) fn copy_line(from: &[f32], to: &mut [f32]) {
    match (from.first_chunk::<BLOCK_WIDTH>(), to.first_chunk_mut::<BLOCK_WIDTH>()) {
        (Some(from), Some(to)) => *to = *from,
        _ => from.iter().zip(to).for_each(|(f, t)| *t = *f),
    }
}
