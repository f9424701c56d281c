//! Which tiles, and which blocks of eight pixels of a tile, does each splat touch?
//!
//! The pixels with α ≥ 1/255 satisfy q(dx, dy) = −(a dx² + b dx dy + c dy²) ≤ r with
//! r = log2 o + log2 255: an ellipse. On the pixel row at height dy it covers
//! dx ∈ −b dy/2a ± √((b dy/2a)² − (c dy² + r)/a) (a < 0). Eight pixel rows are a vector; the spans
//! of the two rows of a block are joined, and a tile's 8×8 blocks become a 64-bit mask.
//!
//! Tasks own fixed ranges of Gaussians, so that the result does not depend on the threads. A
//! serial counting scatter in order of depth then lays the pairs out by tile.

use fuse_camera::simd::Level;
use rayon::prelude::*;

use crate::constants::{BLOCK_HEIGHT, BLOCK_WIDTH, LOG2_ALPHA_MIN, TILE_HEIGHT, TILE_WIDTH};
use crate::stages::{Entry, Pairs, Splat, View};
use fuse_camera::simd::{F32x8, Kernel, dispatch, prefetch};

/// Gaussians of one task.
pub(crate) const CHUNK: usize = 512;
/// Gaussians by which memory is asked for ahead of its use.
const AHEAD: usize = 8;
/// Pixels by which spans are widened against rounding; the rasteriser tests each pixel anyway.
const SLACK: f32 = 1e-2;
/// Rows of blocks in a tile.
const BLOCK_ROWS: usize = TILE_HEIGHT / BLOCK_HEIGHT;
/// Columns of blocks in a tile.
const BLOCK_COLUMNS: i32 = (TILE_WIDTH / BLOCK_WIDTH) as i32;

/// The entries of [`CHUNK`] Gaussians.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    pub entries: Vec<Entry>,
    /// First entry of each Gaussian of the chunk, and one past the last.
    pub starts: Vec<u32>,
}

/// Fills `chunks` with the entries of all splats, and `pairs` with the same by tile.
pub(crate) fn intersect(
    level: Level,
    view: &View,
    splats: &[Splat],
    order: &[u32],
    chunks: &mut Vec<Chunk>,
    pairs: &mut Pairs,
) {
    chunks.resize_with(splats.len().div_ceil(CHUNK), Chunk::default);
    splats
        .par_chunks(CHUNK)
        .zip(chunks.par_iter_mut())
        .for_each(|(splats, chunk)| dispatch(level, Intersect { view, splats, chunk }));
    scatter(view.tiles_x() * view.tiles_y(), order, chunks, pairs);
}

/// Counting sort by tile, in order of depth within a tile.
fn scatter(tiles: usize, order: &[u32], chunks: &mut [Chunk], pairs: &mut Pairs) {
    let mut cursor = vec![0u32; tiles + 1];
    for entry in chunks.iter().flat_map(|c| &c.entries) {
        cursor[entry.tile as usize] += 1;
    }
    let mut sum = 0;
    for c in &mut cursor {
        sum += std::mem::replace(c, sum);
    }
    pairs.offsets.clone_from(&cursor);
    pairs.gaussian.resize(sum as usize, 0);
    pairs.mask.resize(sum as usize, 0);
    for (k, &g) in order.iter().enumerate() {
        // In order of depth, one Gaussian's entries lie anywhere.
        if let Some(&soon) = order.get(k + AHEAD) {
            let Chunk { entries, starts } = &chunks[soon as usize / CHUNK];
            prefetch(entries, starts[soon as usize % CHUNK] as usize);
        }
        let Chunk { entries, starts } = &mut chunks[g as usize / CHUNK];
        let local = g as usize % CHUNK;
        for entry in &mut entries[starts[local] as usize..starts[local + 1] as usize] {
            let at = &mut cursor[entry.tile as usize];
            entry.slot = *at;
            pairs.gaussian[*at as usize] = g;
            pairs.mask[*at as usize] = entry.mask;
            *at += 1;
        }
    }
}

struct Intersect<'a> {
    view: &'a View,
    splats: &'a [Splat],
    chunk: &'a mut Chunk,
}

impl Kernel for Intersect<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(self) {
        let Chunk { entries, starts } = self.chunk;
        entries.clear();
        starts.clear();
        for splat in self.splats {
            starts.push(entries.len() as u32);
            if splat.depth > 0.0 {
                touch::<V>(self.view, splat, entries);
            }
        }
        starts.push(entries.len() as u32);
    }
}

/// Appends the tiles that one splat touches, row by row.
#[inline(always)]
fn touch<V: F32x8>(view: &View, splat: &Splat, entries: &mut Vec<Entry>) {
    let tile_of = |y: f32| (y.max(0.0) / TILE_HEIGHT as f32) as usize;
    let first = tile_of(splat.mean[1] - splat.extent[1] - SLACK);
    let last = tile_of(splat.mean[1] + splat.extent[1] + SLACK).min(view.tiles_y() - 1);
    let block_columns = view.width.div_ceil(BLOCK_WIDTH) as f32;
    for ty in first..=last {
        let (low, high) = block_spans::<V>(splat, (ty * TILE_HEIGHT) as f32, block_columns);
        let left = low.iter().fold(i32::MAX, |m, &v| m.min(v));
        let right = high.iter().fold(0, |m, &v| m.max(v));
        if left >= right {
            continue;
        }
        for tx in left / BLOCK_COLUMNS..=(right - 1) / BLOCK_COLUMNS {
            let mask = tile_mask(&low, &high, tx * BLOCK_COLUMNS);
            if mask != 0 {
                entries.push(Entry { tile: (ty * view.tiles_x()) as u32 + tx as u32, slot: 0, mask });
            }
        }
    }
}

/// For each row of blocks of the tile row that begins at pixel row `top`: the columns of blocks
/// `low..high` (across the image) that the splat touches; `low ≥ high` where it touches none.
#[inline(always)]
fn block_spans<V: F32x8>(splat: &Splat, top: f32, columns: f32) -> ([i32; BLOCK_ROWS], [i32; BLOCK_ROWS]) {
    const ROWS: [[f32; 8]; 2] =
        [[0.5, 2.5, 4.5, 6.5, 8.5, 10.5, 12.5, 14.5], [1.5, 3.5, 5.5, 7.5, 9.5, 11.5, 13.5, 15.5]];
    let s = V::splat;
    let inverse_a = -1.0 / splat.a;
    let reach = splat.log2_opacity - LOG2_ALPHA_MIN;
    let (mut low, mut high) = (s(1e9), s(-1e9));
    for rows in &ROWS {
        let dy = V::load(rows) + s(top - splat.mean[1]);
        let middle = dy * s(0.5 * splat.b * inverse_a);
        let squared = middle.mul_add(middle, (dy * dy).mul_add(s(splat.c), s(reach)) * s(inverse_a));
        let hit = squared.ge(V::zero());
        let half = squared.max(V::zero()).sqrt() + s(SLACK);
        let middle = middle + s(splat.mean[0]);
        low = low.min((middle - half).select(hit, s(1e9)));
        high = high.max((middle + half).select(hit, s(-1e9)));
    }
    // Pixel i has its centre at i + ½: the first at or after `low` is ceil(low − ½), here as a
    // truncation of low + ½ (nearly: the slack covers the rest), the last at or before `high` is
    // floor(high − ½).
    let scale = s(1.0 / BLOCK_WIDTH as f32);
    let low = ((low + s(0.499)) * scale).max(V::zero()).min(s(columns));
    let high = ((high + s(BLOCK_WIDTH as f32 - 0.5)) * scale).max(V::zero()).min(s(columns));
    (low.truncate(), high.truncate())
}

/// The blocks `low[r]..high[r]` of each row of the tile whose first column of blocks is `first`.
#[inline(always)]
fn tile_mask(low: &[i32; BLOCK_ROWS], high: &[i32; BLOCK_ROWS], first: i32) -> u64 {
    let mut mask = 0;
    for r in 0..BLOCK_ROWS {
        let from = (low[r] - first).clamp(0, BLOCK_COLUMNS);
        let to = (high[r] - first).clamp(0, BLOCK_COLUMNS);
        // Ones from bit `from` to below bit `to`; negative where there are none.
        let row = ((1 << to) - (1 << from)).max(0);
        mask |= (row as u64) << (r * BLOCK_COLUMNS as usize);
    }
    mask
}
