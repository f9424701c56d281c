//! The triangles of one view and the tiles that they touch.
//!
//! Triangles are set up and sorted into tiles chunk by chunk, each chunk by one thread and into memory
//! of its own, which is kept from frame to frame: nothing is joined, and little is asked of the system.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::geometry::Geometry;
use super::raster::{TILE_HEIGHT, TILE_WIDTH};
use super::transform::{Sampling, Setup, Vertex, View};

/// Triangles of a chunk, a power of two.
const CHUNK: usize = 2048;

/// Setups of one view, chunk by chunk. A setup's number is `chunk * CHUNK + place`.
#[derive(Default)]
pub(super) struct Binned {
    vertices: Vec<Vertex>,
    chunks: Vec<Chunk>,
    pub tiles_x: usize,
}

#[derive(Default)]
struct Chunk {
    setups: Vec<Setup>,
    /// Places in `setups` by tile, and where each tile's begin.
    order: Vec<u16>,
    starts: Vec<u32>,
}

/// The setups of one chunk that may touch a tile, in the order of the triangles.
pub(super) struct List<'a> {
    /// Number of the chunk's first setup.
    pub first: u32,
    pub setups: &'a [Setup],
    /// Places in `setups`.
    pub order: &'a [u16],
}

impl Binned {
    pub fn new(view: &View, geometry: &Geometry, sampling: Sampling) -> Self {
        let mut binned = Self::default();
        binned.fill(view, geometry, sampling);
        binned
    }

    /// Replaces everything by what another view sees.
    pub fn fill(&mut self, view: &View, geometry: &Geometry, sampling: Sampling) {
        self.tiles_x = (view.width as usize).div_ceil(TILE_WIDTH);
        let tiles = self.tiles_x * (view.height as usize).div_ceil(TILE_HEIGHT);
        view.vertices(geometry, &mut self.vertices);
        self.chunks.resize_with(geometry.triangles.len().div_ceil(CHUNK), Chunk::default);
        let (vertices, tiles_x) = (&self.vertices[..], self.tiles_x);
        self.chunks.par_iter_mut().enumerate().for_each(|(i, chunk)| {
            let triangles = i * CHUNK..((i + 1) * CHUNK).min(geometry.triangles.len());
            chunk.setups.clear();
            view.setups(geometry, vertices, triangles, sampling, &mut chunk.setups);
            chunk.sort(tiles_x, tiles);
        });
    }

    #[inline(always)]
    pub fn setup(&self, number: u32) -> &Setup {
        &self.chunks[number as usize / CHUNK].setups[number as usize % CHUNK]
    }

    /// All setups, in the order of the triangles.
    pub fn setups(&self) -> impl Iterator<Item = &Setup> {
        self.chunks.iter().flat_map(|c| &c.setups)
    }

    /// Number of lists that each tile has.
    pub fn lists(&self) -> usize {
        self.chunks.len()
    }

    /// The `i`-th list of the tile in this column and row.
    #[inline(always)]
    pub fn list(&self, x: usize, y: usize, i: usize) -> List<'_> {
        let (chunk, t) = (&self.chunks[i], y * self.tiles_x + x);
        let order = &chunk.order[chunk.starts[t] as usize..chunk.starts[t + 1] as usize];
        List { first: (i * CHUNK) as u32, setups: &chunk.setups, order }
    }

    /// Whether nothing touches the tile.
    pub fn is_empty(&self, x: usize, y: usize) -> bool {
        (0..self.lists()).all(|i| self.list(x, y, i).order.is_empty())
    }
}

impl Chunk {
    /// Sorts the setups into tiles.
    fn sort(&mut self, tiles_x: usize, tiles: usize) {
        // Counts, then ends; writing from the last setup on turns ends into starts.
        self.starts.clear();
        self.starts.resize(tiles + 1, 0);
        for s in &self.setups {
            let (columns, rows) = s.tiles();
            for y in rows {
                for count in &mut self.starts[y * tiles_x..][columns.clone()] {
                    *count += 1;
                }
            }
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.order.clear();
        self.order.resize(end as usize, 0);
        for (i, s) in self.setups.iter().enumerate().rev() {
            let (columns, rows) = s.tiles();
            for y in rows {
                for start in &mut self.starts[y * tiles_x..][columns.clone()] {
                    *start -= 1;
                    self.order[*start as usize] = i as u16;
                }
            }
        }
    }
}

/// Memory for views, kept between them; as many as were ever in use at once.
#[derive(Default)]
pub(super) struct Pool(Mutex<Vec<Binned>>);

impl Pool {
    /// Runs `work` with what a view sees.
    pub fn with<R>(&self, view: &View, geometry: &Geometry, sampling: Sampling, work: impl FnOnce(&Binned) -> R) -> R {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut binned = kept.unwrap_or_default();
        binned.fill(view, geometry, sampling);
        let result = work(&binned);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(binned);
        result
    }
}
