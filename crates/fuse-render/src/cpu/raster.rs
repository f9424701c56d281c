//! Coverage and depth, one tile at a time.
//!
//! Edge functions are evaluated in double precision at the corner of an 8×8 block and from there
//! in single precision with the same operations whatever the triangle, so that two triangles
//! that share an edge agree about every sample. Eight samples are tested at once: the eight of a
//! pixel ([`Tile::draw_area`]) or the centres of eight pixels ([`Tile::draw_centers`]
//! and [`super::mask`]). No fused multiply-add is used, so every instruction set gives the same bits.

// Lanes run side by side through several arrays: indices say that better than zipped iterators.
#![allow(clippy::needless_range_loop)]

mod planes;

use fuse_camera::simd::{self, F32x8, I32x8, Kernel};

use super::binned::Binned;
use super::transform::{Setup, View};
pub(super) use planes::{Planes, inside};

/// Tile size in pixels; a multiple of the block size.
pub(super) const TILE_WIDTH: usize = 32;
/// See [`TILE_WIDTH`].
pub(super) const TILE_HEIGHT: usize = 16;
/// Side of the blocks whose corners are evaluated in double precision.
pub(super) const BLOCK: usize = 8;
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

/// Largest offset of a sample along an axis, and a bit for rounding.
const REACH: f32 = 0.44;

/// Most pixels in the bounds of a triangle that counts as small.
const FEW: usize = 6;

type Lanes = [f32; LANES];

/// What a block shows, in area mode.
#[derive(Clone, Copy)]
enum Block {
    Nothing,
    /// One triangle, of this key, at all samples. They are not written one by one: most of a picture
    /// are large triangles.
    One(u32, Planes),
    /// What the tile's samples say.
    Samples,
}

const BLOCKS: usize = TILE_WIDTH / BLOCK * (TILE_HEIGHT / BLOCK);

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
    /// Largest inverse depth of each pixel, centre mode; empty for that of the near plane.
    limits: Vec<Lanes>,
    /// For each block, an inverse depth that all its samples reach.
    floor: [f32; BLOCKS],
    /// Area mode; [`Block::Samples`] everywhere in centre mode.
    blocks: [Block; BLOCKS],
    area: bool,
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
            limits: Vec::new(),
            floor: [0.0; BLOCKS],
            blocks: [Block::Samples; BLOCKS],
            area: lanes == LANES,
        }
    }

    /// Hides what has a larger inverse depth than `limit` of the image's pixel, until the next
    /// call; centre mode.
    pub fn limit(&mut self, limit: impl Fn(usize, usize) -> f32) {
        let groups = TILE_WIDTH / LANES;
        let (x, y) = (self.x, self.y);
        let row = |i: usize| (i % groups * LANES, i / groups);
        self.limits.clear();
        self.limits.extend((0..groups * TILE_HEIGHT).map(|i| {
            let (dx, dy) = row(i);
            std::array::from_fn(|s| limit(x + dx + s, y + dy))
        }));
    }

    /// Empties the tile and moves its first pixel to `(x, y)`.
    pub fn reset(&mut self, x: usize, y: usize) {
        (self.x, self.y) = (x, y);
        self.floor.fill(0.0);
        if self.area {
            self.blocks.fill(Block::Nothing);
        } else {
            self.inverse_depth.fill([0.0; LANES]);
            self.nearest.fill([0; LANES]);
        }
    }

    /// Number of the block of the pixel `(x, y)` of the image.
    #[inline(always)]
    fn block(&self, x: usize, y: usize) -> usize {
        (y - self.y) / BLOCK * (TILE_WIDTH / BLOCK) + (x - self.x) / BLOCK
    }

    /// The key at all samples of the block of the pixel `(x, y)` of the image, 0 where there is nothing,
    /// if they are known to be the same, area mode.
    #[inline(always)]
    pub fn whole_block(&self, x: usize, y: usize) -> Option<u32> {
        match &self.blocks[self.block(x, y)] {
            Block::Nothing => Some(0),
            Block::One(key, _) => Some(*key),
            Block::Samples => None,
        }
    }

    /// The samples of the pixel `(x, y)` of the image in other blocks, area mode.
    #[inline(always)]
    pub fn samples(&self, x: usize, y: usize) -> &[u32; LANES] {
        &self.nearest[(y - self.y) * TILE_WIDTH + (x - self.x)]
    }

    /// Writes the samples of the block whose first pixel is `(x, y)`.
    #[inline(always)]
    fn write<V: F32x8>(&mut self, shown: &Block, x: usize, y: usize) {
        for dy in 0..BLOCK {
            let at = (y + dy - self.y) * TILE_WIDTH + (x - self.x);
            let (depths, keys) = (&mut self.inverse_depth[at..at + BLOCK], &mut self.nearest[at..at + BLOCK]);
            match shown {
                Block::Samples => {}
                Block::Nothing => {
                    depths.fill([0.0; LANES]);
                    keys.fill([0; LANES]);
                }
                Block::One(key, planes) => {
                    let (offsets, values) = (planes.sample_offsets::<V>()[3], planes.centers::<V>(dy)[3].to_array());
                    for dx in 0..BLOCK {
                        (offsets + V::splat(values[dx])).store(&mut depths[dx]);
                        keys[dx] = [*key; LANES];
                    }
                }
            }
        }
    }

    /// Whether a block shows one triangle only, after the triangle `planes` has been drawn there; if not,
    /// the samples are ready to be drawn on.
    #[inline(always)]
    fn takes_whole<V: F32x8>(&mut self, planes: &Planes, key: u32, x: usize, y: usize) -> bool {
        let block = self.block(x, y);
        let shown = self.blocks[block];
        let behind = match &shown {
            Block::Samples => return false,
            Block::Nothing => true,
            Block::One(_, other) => other.high <= planes.low,
        };
        if behind && planes.covers && planes.high <= self.max_inverse_depth {
            self.blocks[block] = Block::One(key, *planes);
            return true;
        }
        self.write::<V>(&shown, x, y);
        self.blocks[block] = Block::Samples;
        false
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

    /// Keys of one pixel row, centre mode.
    pub fn center_keys(&self, row: usize) -> &[u32] {
        let groups = TILE_WIDTH / LANES;
        self.nearest[row * groups..(row + 1) * groups].as_flattened()
    }

    /// Draws all samples of every pixel. Keys are the numbers of the setups plus one; of triangles
    /// at the same depth the first one shows.
    pub fn draw_area(&mut self, binned: &Binned) {
        simd::dispatch(simd::level(), Area { tile: self, binned });
    }

    /// Draws pixel centres only; see [`Tile::draw_area`].
    pub fn draw_centers(&mut self, binned: &Binned) {
        simd::dispatch(simd::level(), Centers { tile: self, binned });
    }

    /// Whether a triangle may show in a block; remembers the depth that it gives the block.
    #[inline(always)]
    fn visits(&mut self, planes: &Planes, x: usize, y: usize) -> bool {
        let block = self.block(x, y);
        if planes.high < self.floor[block] {
            return false;
        }
        if planes.covers && planes.high <= self.max_inverse_depth && self.limits.is_empty() {
            self.floor[block] = self.floor[block].max(planes.low);
        }
        true
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

/// Replaces what is no nearer, where `inside` is set.
#[inline(always)]
fn replace<V: F32x8>(z: &mut Lanes, nearest: &mut [u32; LANES], depth: V, inside: V, key: V::Int) {
    let old = V::load(z);
    let shows = inside.and(depth.ge(old));
    depth.select(shows, old).store(z);
    key.select(shows, V::Int::load(nearest)).store(nearest);
}

// No closures in kernels: they would not be compiled for the caller's instruction set. Lists are drawn from their end, where the nearest things of a scene usually
// are (the room comes first), and a triangle replaces what is as near as it is.

struct Area<'a> {
    tile: &'a mut Tile,
    binned: &'a Binned,
}

impl Kernel for Area<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        let (x, y) = (self.tile.x / TILE_WIDTH, self.tile.y / TILE_HEIGHT);
        for i in (0..self.binned.lists()).rev() {
            let list = self.binned.list(x, y, i);
            for &place in list.order.iter().rev() {
                area::<V>(self.tile, &list.setups[usize::from(place)], list.first + u32::from(place) + 1);
            }
        }
    }
}

#[inline(always)]
fn area<V: F32x8>(tile: &mut Tile, setup: &Setup, number: u32) {
    let (x0, x1, y0, y1) = tile.clip(setup);
    let limit = V::splat(tile.max_inverse_depth);
    let all = V::zero().ge(V::zero());
    let key = V::Int::splat(number as i32);
    // Of small triangles every pixel is looked at; larger ones first tell which to look at.
    let few = (x1 - x0) * (y1 - y0) <= FEW;
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            if !tile.visits(&planes, bx, by) || tile.takes_whole::<V>(&planes, number, bx, by) {
                continue;
            }
            let offsets = planes.sample_offsets::<V>();
            let safe = planes.high <= tile.max_inverse_depth;
            if few {
                for y in by.max(y0)..(by + BLOCK).min(y1) {
                    let row = planes.row(y - by);
                    for x in bx.max(x0)..(bx + BLOCK).min(x1) {
                        let mut e = offsets;
                        for i in 0..4 {
                            e[i] = offsets[i] + V::splat(row[i] + planes.du[i] * ((x - bx) as f32 + 0.5));
                        }
                        let mut shows = inside(&e);
                        if !safe {
                            shows = shows.and(limit.ge(e[3]));
                        }
                        if shows.mask_bits() != 0 {
                            let at = (y - tile.y) * TILE_WIDTH + (x - tile.x);
                            replace(&mut tile.inverse_depth[at], &mut tile.nearest[at], e[3], shows, key);
                        }
                    }
                }
                continue;
            }
            // How far an edge's value at a sample can be from that at the centre.
            let mut margin = [V::zero(); 3];
            for i in 0..3 {
                margin[i] = V::splat((planes.du[i].abs() + planes.dv[i].abs()) * REACH);
            }
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let e = planes.centers::<V>(y - by);
                let (mut near, mut full) = (all, all);
                for i in 0..3 {
                    near = near.and((e[i] + margin[i]).ge(V::zero()));
                    full = full.and(e[i].ge(margin[i]));
                }
                let mut pixels = near.mask_bits() & columns(bx, x0, x1);
                let full = full.mask_bits();
                let values = [e[0].to_array(), e[1].to_array(), e[2].to_array(), e[3].to_array()];
                while pixels != 0 {
                    let dx = pixels.trailing_zeros() as usize;
                    pixels &= pixels - 1;
                    let at = (y - tile.y) * TILE_WIDTH + (bx + dx - tile.x);
                    let depth = offsets[3] + V::splat(values[3][dx]);
                    let mut shows = all;
                    if full >> dx & 1 == 0 {
                        let mut e = offsets;
                        for i in 0..3 {
                            e[i] = offsets[i] + V::splat(values[i][dx]);
                        }
                        shows = inside(&e);
                    }
                    if !safe {
                        shows = shows.and(limit.ge(depth));
                    }
                    replace(&mut tile.inverse_depth[at], &mut tile.nearest[at], depth, shows, key);
                }
            }
        }
    }
}

struct Centers<'a> {
    tile: &'a mut Tile,
    binned: &'a Binned,
}

impl Kernel for Centers<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        let (x, y) = (self.tile.x / TILE_WIDTH, self.tile.y / TILE_HEIGHT);
        for i in (0..self.binned.lists()).rev() {
            let list = self.binned.list(x, y, i);
            for &place in list.order.iter().rev() {
                centers::<V>(self.tile, &list.setups[usize::from(place)], list.first + u32::from(place) + 1);
            }
        }
    }
}

#[inline(always)]
fn centers<V: F32x8>(tile: &mut Tile, setup: &Setup, key: u32) {
    let (x0, x1, y0, y1) = tile.clip(setup);
    let near = [tile.max_inverse_depth; LANES];
    let key = V::Int::splat(key as i32);
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            if !tile.visits(&planes, bx, by) {
                continue;
            }
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let e = planes.centers::<V>(y - by);
                let at = ((y - tile.y) * TILE_WIDTH + (bx - tile.x)) / LANES;
                let limit = V::load(tile.limits.get(at).unwrap_or(&near));
                let shows = inside(&e).and(limit.ge(e[3]));
                replace(&mut tile.inverse_depth[at], &mut tile.nearest[at], e[3], shows, key);
            }
        }
    }
}

/// Bits of the columns `[x0, x1)` in the group of eight that begins at `bx`.
#[inline(always)]
pub(super) fn columns(bx: usize, x0: usize, x1: usize) -> u8 {
    let low = x0.saturating_sub(bx).min(LANES);
    let high = (x1 - bx).min(LANES);
    (((1u32 << high) - 1) & !((1u32 << low) - 1)) as u8
}
