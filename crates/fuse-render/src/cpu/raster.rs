//! Coverage and depth, one tile at a time.
//!
//! Edge functions are evaluated in double precision at the corner of an 8×8 block and from there
//! in single precision with the same operations whatever the triangle, so that two triangles
//! that share an edge agree about every sample. Eight samples are tested at once: the eight of a
//! pixel ([`Tile::draw_area`]) or the centres of eight pixels ([`Tile::draw_centers`],
//! [`Mask::draw`]). No fused multiply-add is used, so every instruction set gives the same bits.

// Lanes run side by side through several arrays: indices say that better than zipped iterators.
#![allow(clippy::needless_range_loop)]

use fuse_camera::simd::{self, Level};
use glam::DVec3;

use super::transform::{Setup, View};

/// Tile size in pixels; a multiple of the block size.
pub(super) const TILE_WIDTH: usize = 64;
/// See [`TILE_WIDTH`].
pub(super) const TILE_HEIGHT: usize = 16;
/// Side of the blocks whose corners are evaluated in double precision.
const BLOCK: usize = 8;
/// Samples of a pixel, and pixels of a group.
pub(crate) const LANES: usize = 8;

/// Sample offsets from the pixel centre, pixels. The first is the centre, their mean is zero.
pub(crate) const SAMPLES: [[f32; 2]; LANES] = [
    [0.0, 0.0],
    [-0.0625, 0.25],
    [0.3125, 0.0],
    [-0.0625, -0.3125],
    [-0.375, 0.3125],
    [-0.375, -0.1875],
    [0.1875, 0.375],
    [0.375, -0.4375],
];

type Lanes = [f32; LANES];

/// Runs a kernel compiled for the level in use.
macro_rules! dispatch {
    ($level:expr, $portable:ident, $avx2:ident, $($argument:expr),*) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: these levels are reported only when the processor has AVX2.
            Level::Avx2Fma | Level::Avx512 => unsafe { $avx2($($argument),*) },
            _ => $portable($($argument),*),
        }
    };
}

/// Linear functions of one triangle at one block: value at the block's corner, and gradients.
struct Planes {
    value: [f32; 4],
    du: [f32; 4],
    dv: [f32; 4],
}

impl Planes {
    /// Edges in 0..3, inverse depth in 3; `None` when no sample of the block can be inside.
    #[inline(always)]
    fn at(setup: &Setup, x: usize, y: usize) -> Option<Self> {
        let (x, y) = (x as f64, y as f64);
        let rows = [setup.edges[0], setup.edges[1], setup.edges[2], setup.inverse_depth];
        let side = BLOCK as f32 * 1.0001;
        let mut planes = Self { value: [0.0; 4], du: [0.0; 4], dv: [0.0; 4] };
        let mut outside = false;
        for i in 0..4 {
            let r: DVec3 = rows[i];
            planes.value[i] = (r.x * x + r.y * y + r.z) as f32;
            planes.du[i] = r.x as f32;
            planes.dv[i] = r.y as f32;
            let highest = planes.value[i] + side * (planes.du[i].max(0.0) + planes.dv[i].max(0.0));
            outside |= highest < 0.0;
        }
        if outside { None } else { Some(planes) }
    }

    /// Values at the centres of the pixel row `dy` of the block, at column offset 0.
    #[inline(always)]
    fn row(&self, dy: usize) -> [f32; 4] {
        let mut out = self.value;
        for i in 0..4 {
            out[i] += self.dv[i] * (dy as f32 + 0.5);
        }
        out
    }

    /// Values at the centres of the eight pixels of the row `dy`.
    #[inline(always)]
    fn centers(&self, dy: usize) -> [Lanes; 4] {
        let row = self.row(dy);
        let mut out = [[0.0; LANES]; 4];
        for i in 0..4 {
            for s in 0..LANES {
                out[i][s] = row[i] + self.du[i] * (s as f32 + 0.5);
            }
        }
        out
    }

    /// What the samples of a pixel add to its centre's values.
    #[inline(always)]
    fn sample_offsets(&self) -> [Lanes; 4] {
        let mut out = [[0.0; LANES]; 4];
        for i in 0..4 {
            for s in 0..LANES {
                out[i][s] = self.du[i] * SAMPLES[s][0] + self.dv[i] * SAMPLES[s][1];
            }
        }
        out
    }
}

/// Which triangle is nearest at every sample of a tile.
///
/// In area mode element `LANES * pixel + sample`, in centre mode element `pixel`.
pub(super) struct Tile {
    x: usize,
    y: usize,
    inverse_depth: Vec<Lanes>,
    /// Index into the setups plus one; 0 where nothing was drawn.
    nearest: Vec<[u32; LANES]>,
    max_inverse_depth: f32,
    level: Level,
}

impl Tile {
    /// An empty tile. `lanes` is [`LANES`] samples a pixel in area mode, 1 in centre mode.
    pub fn new(view: &View, lanes: usize) -> Self {
        let groups = TILE_WIDTH * TILE_HEIGHT * lanes / LANES;
        Self {
            x: 0,
            y: 0,
            inverse_depth: vec![[0.0; LANES]; groups],
            nearest: vec![[0; LANES]; groups],
            max_inverse_depth: (1.0 / view.near) as f32,
            level: simd::level(),
        }
    }

    /// Empties the tile and moves its first pixel to `(x, y)`.
    pub fn reset(&mut self, x: usize, y: usize) {
        (self.x, self.y) = (x, y);
        self.inverse_depth.fill([0.0; LANES]);
        self.nearest.fill([0; LANES]);
    }

    /// The samples of the pixel `(x, y)` of the image, area mode.
    #[inline(always)]
    pub fn samples(&self, x: usize, y: usize) -> &[u32; LANES] {
        &self.nearest[(y - self.y) * TILE_WIDTH + (x - self.x)]
    }

    /// The pixel `(x, y)` of the image, centre mode.
    #[inline(always)]
    pub fn center(&self, x: usize, y: usize) -> u32 {
        let i = (y - self.y) * TILE_WIDTH + (x - self.x);
        self.nearest[i / LANES][i % LANES]
    }

    /// Inverse depths of one pixel row, centre mode.
    pub fn center_depths(&self, row: usize) -> &[f32] {
        let groups = TILE_WIDTH / LANES;
        self.inverse_depth[row * groups..(row + 1) * groups].as_flattened()
    }

    /// Draws all samples of every pixel; `key` is the setup's index plus one.
    pub fn draw_area(&mut self, setup: &Setup, key: u32) {
        dispatch!(self.level, area, area_avx2, self, setup, key);
    }

    /// Draws pixel centres only.
    pub fn draw_centers(&mut self, setup: &Setup, key: u32) {
        dispatch!(self.level, centers, centers_avx2, self, setup, key);
    }

    /// The part of the setup's bounds inside the tile: `x0, x1, y0, y1`, ends excluded.
    #[inline(always)]
    fn clip(&self, s: &Setup) -> (usize, usize, usize, usize) {
        (
            (s.x0 as usize).max(self.x),
            (s.x1 as usize + 1).min(self.x + TILE_WIDTH),
            (s.y0 as usize).max(self.y),
            (s.y1 as usize + 1).min(self.y + TILE_HEIGHT),
        )
    }
}

#[inline(always)]
fn depth_test(z: &mut Lanes, nearest: &mut [u32; LANES], e: &[Lanes; 4], limit: f32, key: u32) {
    for s in 0..LANES {
        let inside = (e[0][s] >= 0.0) & (e[1][s] >= 0.0) & (e[2][s] >= 0.0) & (e[3][s] > z[s]) & (e[3][s] <= limit);
        z[s] = if inside { e[3][s] } else { z[s] };
        nearest[s] = if inside { key } else { nearest[s] };
    }
}

// The kernels are plain nested loops: closures would not be compiled for the caller's
// instruction set.

#[inline(always)]
fn area(tile: &mut Tile, setup: &Setup, key: u32) {
    let (x0, x1, y0, y1) = tile.clip(setup);
    let limit = tile.max_inverse_depth;
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            let offsets = planes.sample_offsets();
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let row = planes.row(y - by);
                let first = (y - tile.y) * TILE_WIDTH;
                for x in bx.max(x0)..(bx + BLOCK).min(x1) {
                    let dx = (x - bx) as f32 + 0.5;
                    let mut e = offsets;
                    for i in 0..4 {
                        let center = row[i] + planes.du[i] * dx;
                        for s in 0..LANES {
                            e[i][s] += center;
                        }
                    }
                    let at = first + (x - tile.x);
                    depth_test(&mut tile.inverse_depth[at], &mut tile.nearest[at], &e, limit, key);
                }
            }
        }
    }
}

#[inline(always)]
fn centers(tile: &mut Tile, setup: &Setup, key: u32) {
    let (x0, x1, y0, y1) = tile.clip(setup);
    let limit = tile.max_inverse_depth;
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let e = planes.centers(y - by);
                let at = ((y - tile.y) * TILE_WIDTH + (bx - tile.x)) / LANES;
                depth_test(&mut tile.inverse_depth[at], &mut tile.nearest[at], &e, limit, key);
            }
        }
    }
}

/// Which pixel centres of an image a set of triangles covers: one bit a pixel.
pub(super) struct Mask {
    bytes_per_row: usize,
    bits: Vec<u8>,
    max_inverse_depth: f32,
    level: Level,
}

impl Mask {
    pub fn new(view: &View) -> Self {
        let bytes_per_row = (view.width as usize).div_ceil(LANES);
        Self {
            bytes_per_row,
            bits: vec![0; bytes_per_row * view.height as usize],
            max_inverse_depth: (1.0 / view.near) as f32,
            level: simd::level(),
        }
    }

    pub fn draw(&mut self, setup: &Setup) {
        dispatch!(self.level, mask, mask_avx2, self, setup);
    }

    /// Number of covered pixels.
    pub fn count(&self) -> u32 {
        self.bits.iter().map(|b| b.count_ones()).sum()
    }
}

#[inline(always)]
fn mask(mask: &mut Mask, setup: &Setup) {
    let (x0, x1) = (setup.x0 as usize, setup.x1 as usize + 1);
    let (y0, y1) = (setup.y0 as usize, setup.y1 as usize + 1);
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            // The bounds keep the bits beyond the image's right edge clear.
            let valid = columns(bx, x0, x1);
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let e = planes.centers(y - by);
                let mut bits = 0u8;
                for s in 0..LANES {
                    let inside = (e[0][s] >= 0.0)
                        & (e[1][s] >= 0.0)
                        & (e[2][s] >= 0.0)
                        & (e[3][s] > 0.0)
                        & (e[3][s] <= mask.max_inverse_depth);
                    bits |= u8::from(inside) << s;
                }
                mask.bits[y * mask.bytes_per_row + bx / LANES] |= bits & valid;
            }
        }
    }
}

/// Bits of the columns `[x0, x1)` in the group of eight that begins at `bx`.
#[inline(always)]
fn columns(bx: usize, x0: usize, x1: usize) -> u8 {
    let low = x0.saturating_sub(bx).min(LANES);
    let high = (x1 - bx).min(LANES);
    (((1u32 << high) - 1) & !((1u32 << low) - 1)) as u8
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn area_avx2(tile: &mut Tile, setup: &Setup, key: u32) {
    area(tile, setup, key);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn centers_avx2(tile: &mut Tile, setup: &Setup, key: u32) {
    centers(tile, setup, key);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn mask_avx2(m: &mut Mask, setup: &Setup) {
    mask(m, setup);
}
