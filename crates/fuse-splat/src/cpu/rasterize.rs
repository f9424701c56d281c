//! Blending: splats of a tile, nearest first → colour, opacity, depth.
//!
//! C = Σᵢ wᵢ cᵢ + T b, wᵢ = αᵢ Tᵢ, Tᵢ = Πⱼ﹤ᵢ (1 − αⱼ), αᵢ = min(0.99, 2^pᵢ), skipped where
//! αᵢ < 1/255; b is the background.
//!
//! A task owns a row of tiles, hence a band of the image. The splat is in the outer loop, the
//! state of the tile's 64 blocks of eight pixels stays in the first-level cache. A block is alive
//! while one of its pixels lets through at least 1e-4; every eighth splat looks. The blocks that
//! were drawn are written back to the masks, so that the backward pass does the same work.

use fuse_camera::simd::Level;
use rayon::prelude::*;

use crate::constants::{
    ALPHA_MAX, BLOCK_HEIGHT, BLOCK_WIDTH, LOG2_ALPHA_MAX, LOG2_ALPHA_MIN, TILE_BLOCKS, TILE_HEIGHT, TILE_WIDTH,
    TRANSMITTANCE_MIN,
};
use crate::simd::{F32x8, Kernel, dispatch};
use crate::stages::{Pairs, Planes, Splat, View};

/// Blocks side by side in a tile.
pub(super) const BLOCK_COLUMNS: usize = TILE_WIDTH / BLOCK_WIDTH;
/// Splats between two looks at which blocks are alive.
const LOOK: usize = 8;

/// What the forward pass leaves.
#[derive(Debug, Default)]
pub(crate) struct Image {
    /// Red, green, blue.
    pub color: Planes,
    /// What each pixel lets through.
    pub transmittance: Vec<f32>,
    /// Σ wᵢ zᵢ, metres; only filled on request.
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
    image.transmittance.resize(n, 0.0);
    image.depth.resize(if with_depth { n } else { 0 }, 0.0);
    bands(view, background, splats, pairs, image).into_par_iter().for_each(|band| dispatch(level, band));
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
    transmittance: &'a mut [f32],
    depth: Option<&'a mut [f32]>,
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
        if let (Some(r), Some(g), Some(b), Some(t)) = (red.next(), green.next(), blue.next(), transmittance.next()) {
            out.push(Band {
                view,
                background,
                splats,
                row,
                offsets,
                gaussian: &pairs.gaussian[first..last],
                mask: own,
                color: [r, g, b],
                transmittance: t,
                depth: depth.next(),
            });
        }
    }
    out
}

/// What a block of eight pixels has gathered.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct BlockState {
    transmittance: [f32; 8],
    color: [[f32; 8]; 3],
    depth: [f32; 8],
}

/// State of a tile.
struct Tile {
    blocks: [BlockState; TILE_BLOCKS],
    /// α of one splat, by place in its list of blocks.
    alpha: [[f32; 8]; TILE_BLOCKS],
}

impl Tile {
    const EMPTY: Self = Self {
        blocks: [BlockState { transmittance: [1.0; 8], color: [[0.0; 8]; 3], depth: [0.0; 8] }; TILE_BLOCKS],
        alpha: [[0.0; 8]; TILE_BLOCKS],
    };
}

impl Kernel for Band<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(mut self) {
        let base = self.offsets[0] as usize;
        for column in 0..self.view.tiles_x() {
            let range = self.offsets[column] as usize - base..self.offsets[column + 1] as usize - base;
            let origin = [(column * TILE_WIDTH) as f32, (self.row * TILE_HEIGHT) as f32];
            let mut tile = Tile::EMPTY;
            let (gaussian, mask) = (&self.gaussian[range.clone()], &mut self.mask[range]);
            if self.depth.is_some() {
                draw_tile::<V, true>(origin, self.splats, gaussian, mask, &mut tile);
            } else {
                draw_tile::<V, false>(origin, self.splats, gaussian, mask, &mut tile);
            }
            self.store::<V>(column, &tile);
        }
    }
}

/// Offsets of a block's eight pixel centres from the tile's corner.
pub(super) struct BlockOffsets {
    pub x: [[f32; 8]; TILE_BLOCKS],
    pub y: [[f32; 8]; TILE_BLOCKS],
}

pub(super) static OFFSETS: BlockOffsets = {
    let columns = TILE_WIDTH / BLOCK_WIDTH;
    let mut offsets = BlockOffsets { x: [[0.0; 8]; TILE_BLOCKS], y: [[0.0; 8]; TILE_BLOCKS] };
    let mut b = 0;
    while b < TILE_BLOCKS {
        let mut lane = 0;
        while lane < 8 {
            offsets.x[b][lane] = ((b % columns) * BLOCK_WIDTH + lane % BLOCK_WIDTH) as f32 + 0.5;
            offsets.y[b][lane] = ((b / columns) * BLOCK_HEIGHT + lane / BLOCK_WIDTH) as f32 + 0.5;
            lane += 1;
        }
        b += 1;
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

impl<V: F32x8> Broadcast<V> {
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

    /// (dx, dy) at the pixels of a block.
    #[inline(always)]
    pub fn offset(&self, block: usize) -> (V, V) {
        (V::load(&OFFSETS.x[block]) - self.mean[0], V::load(&OFFSETS.y[block]) - self.mean[1])
    }

    /// α at the pixels of a block, clamped only where `CLAMP` says that it can be necessary.
    #[inline(always)]
    pub fn alpha<const CLAMP: bool>(&self, block: usize) -> V {
        let (dx, dy) = self.offset(block);
        let linear = self.b.mul_add(dy, self.a * dx);
        let constant = (self.c * dy).mul_add(dy, self.log2_opacity);
        let p = linear.mul_add(dx, constant);
        let alpha = if CLAMP { p.exp2().min(V::splat(ALPHA_MAX)) } else { p.exp2() };
        // The test is on the exponent: far from the mean, 2^p wraps.
        alpha.and(p.ge(V::splat(LOG2_ALPHA_MIN)))
    }
}

/// Can α reach its clamp?
#[inline(always)]
pub(super) fn clamps(splat: &Splat) -> bool {
    splat.log2_opacity >= LOG2_ALPHA_MAX
}

/// The numbers of the blocks in a mask.
#[inline(always)]
pub(super) fn blocks(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let block = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (block < TILE_BLOCKS).then_some(block)
    })
}

#[inline(always)]
fn draw_tile<V: F32x8, const DEPTH: bool>(
    origin: [f32; 2],
    splats: &[Splat],
    gaussian: &[u32],
    mask: &mut [u64],
    tile: &mut Tile,
) {
    let mut alive = u64::MAX;
    for (k, (&g, mask)) in gaussian.iter().zip(mask).enumerate() {
        if k.is_multiple_of(LOOK) && k > 0 {
            alive = still_alive::<V>(tile, alive);
        }
        *mask &= alive;
        if *mask == 0 {
            continue;
        }
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
fn draw_pair<V: F32x8, const DEPTH: bool, const CLAMP: bool>(
    splat: &Splat,
    origin: [f32; 2],
    mask: u64,
    tile: &mut Tile,
) {
    let s = Broadcast::<V>::new(splat, origin);
    let depth = V::splat(splat.depth);
    for (block, alpha) in blocks(mask).zip(&mut tile.alpha) {
        s.alpha::<CLAMP>(block).store(alpha);
    }
    for (block, alpha) in blocks(mask).zip(&tile.alpha) {
        let state = &mut tile.blocks[block];
        let t = V::load(&state.transmittance);
        let w = V::load(alpha) * t;
        (t - w).store(&mut state.transmittance);
        for (sum, color) in state.color.iter_mut().zip(s.color) {
            w.mul_add(color, V::load(sum)).store(sum);
        }
        if DEPTH {
            w.mul_add(depth, V::load(&state.depth)).store(&mut state.depth);
        }
    }
}

/// Of the blocks in `alive`, those with a pixel that is not finished.
#[inline(always)]
fn still_alive<V: F32x8>(tile: &Tile, alive: u64) -> u64 {
    let mut still = alive;
    for block in blocks(alive) {
        if V::load(&tile.blocks[block].transmittance).ge(V::splat(TRANSMITTANCE_MIN)).bits() == 0 {
            still &= !(1 << block);
        }
    }
    still
}

impl Band<'_> {
    /// Blocks → rows of the image, background added.
    #[inline(always)]
    fn store<V: F32x8>(&mut self, column: usize, tile: &Tile) {
        let width = self.view.width;
        let rows = self.transmittance.len() / width;
        for (b, state) in tile.blocks.iter().enumerate() {
            let x = column * TILE_WIDTH + b % BLOCK_COLUMNS * BLOCK_WIDTH;
            let y = b / BLOCK_COLUMNS * BLOCK_HEIGHT;
            if x >= width || y >= rows {
                continue;
            }
            let put = |values: V, plane: &mut [f32]| {
                let lines = values.to_array();
                for (line, y) in lines.chunks_exact(BLOCK_WIDTH).zip(y..rows) {
                    copy_line(line, &mut plane[y * width + x..(y + 1) * width]);
                }
            };
            let t = V::load(&state.transmittance);
            put(t, self.transmittance);
            for (c, plane) in self.color.iter_mut().enumerate() {
                put(t.mul_add(V::splat(self.background[c]), V::load(&state.color[c])), plane);
            }
            if let Some(depth) = &mut self.depth {
                put(V::load(&state.depth), depth);
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
