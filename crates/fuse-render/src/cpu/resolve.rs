//! From the samples of a tile to the colours of its pixels.
//!
//! Each triangle in a pixel is shaded once, at the mean of the samples it covers, and weighted
//! with their number.

use std::ops::Range;

use fuse_camera::simd::{self, F32x8, Kernel};
use glam::Vec3A;

use super::geometry::Geometry;
use super::points::{Fragment, GROUP};
use super::raster::{LANES, SAMPLES, Tile};
use super::shade::{Group, Shade, Shading};
use super::transform::Setup;

/// Fragments of one tile and their colours, and which of them make up each pixel.
#[derive(Default)]
pub(super) struct Colors {
    fragments: Vec<Fragment>,
    /// The same, surface by surface, and where each fragment went.
    sorted: Vec<Fragment>,
    places: Vec<u32>,
    /// Surfaces of the tile, and the end of each one's fragments.
    runs: Vec<(u32, u32)>,
    /// Colours of `sorted`.
    colors: Vec<Vec3A>,
    groups: Vec<Group>,
    /// Samples of each fragment.
    covered: Vec<u8>,
    /// Number of fragments of each pixel, and samples of it that show the background.
    pixels: Vec<(u8, u8)>,
    /// Next pixel and fragment to be read.
    read: (usize, usize),
}

impl Colors {
    /// Lists what the pixels of a tile show, row by row.
    pub fn resolve(&mut self, tile: &Tile, columns: Range<usize>, rows: Range<usize>) {
        self.fragments.clear();
        self.covered.clear();
        self.pixels.clear();
        self.read = (0, 0);
        simd::dispatch(simd::level(), Resolve { colors: self, tile, columns, rows });
    }

    #[inline(always)]
    fn pixel_of(&mut self, samples: &[u32; LANES], x: u16, y: u16) {
        let first = samples[0];
        let mut other = 0;
        for sample in samples {
            other |= sample ^ first;
        }
        if other == 0 {
            if first == 0 {
                self.pixels.push((0, LANES as u8));
            } else {
                self.add(Fragment { setup: first - 1, x, y, dx: 0.0, dy: 0.0 }, LANES as u8);
                self.pixels.push((1, 0));
            }
            return;
        }
        self.several(samples, x, y);
    }

    /// A pixel that shows more than one thing.
    fn several(&mut self, samples: &[u32; LANES], x: u16, y: u16) {
        let (mut count, mut background) = (0, 0);
        for (i, &key) in samples.iter().enumerate() {
            let Some(setup) = key.checked_sub(1) else {
                background += 1;
                continue;
            };
            if samples[..i].contains(&key) {
                continue;
            }
            let (mut n, mut dx, mut dy) = (0u8, 0.0, 0.0);
            for (s, _) in samples.iter().enumerate().filter(|(_, k)| **k == key) {
                n += 1;
                dx += SAMPLES[s][0];
                dy += SAMPLES[s][1];
            }
            let share = 1.0 / f32::from(n);
            self.add(Fragment { setup, x, y, dx: dx * share, dy: dy * share }, n);
            count += 1;
        }
        self.pixels.push((count, background));
    }

    #[inline(always)]
    fn add(&mut self, fragment: Fragment, samples: u8) {
        self.fragments.push(fragment);
        self.covered.push(samples);
    }

    /// Shades the fragments, those of one surface together.
    pub fn shade(&mut self, geometry: &Geometry, shading: &Shading, setups: &[Setup], eye: Vec3A) {
        self.sort(geometry, setups);
        self.colors.clear();
        self.colors.resize(self.sorted.len(), Vec3A::ZERO);
        let (fragments, colors, groups) = (&self.sorted[..], &mut self.colors[..], &mut self.groups);
        simd::dispatch(simd::level(), Shade { geometry, shading, setups, eye, fragments, colors, groups });
    }

    /// Puts the fragments of each surface into groups of their own, the last one filled up with
    /// its last fragment.
    fn sort(&mut self, geometry: &Geometry, setups: &[Setup]) {
        let surface = |f: &Fragment| {
            let triangle = setups[f.setup as usize].triangle as usize;
            geometry.parts[geometry.triangle_part[triangle] as usize].surface
        };
        self.runs.clear();
        self.places.clear();
        // Here a place is the number of the run, until the runs' lengths are known.
        for fragment in &self.fragments {
            let surface = surface(fragment);
            let run = self.runs.iter().position(|r| r.0 == surface).unwrap_or_else(|| {
                self.runs.push((surface, 0));
                self.runs.len() - 1
            });
            self.runs[run].1 += 1;
            self.places.push(run as u32);
        }
        let mut end = 0;
        for run in &mut self.runs {
            let length = run.1;
            run.1 = end;
            end += length.next_multiple_of(GROUP as u32);
        }
        self.sorted.clear();
        self.sorted.resize(end as usize, Fragment::default());
        for (fragment, place) in self.fragments.iter().zip(&mut self.places) {
            let next = &mut self.runs[*place as usize].1;
            *place = *next;
            self.sorted[*next as usize] = *fragment;
            *next += 1;
        }
        for (_, next) in &self.runs {
            let end = next.next_multiple_of(GROUP as u32);
            for i in *next..end {
                self.sorted[i as usize] = self.sorted[*next as usize - 1];
            }
        }
    }

    /// Display-linear colour of the next pixel, row by row.
    #[inline]
    pub fn pixel(&mut self, background: Vec3A) -> Vec3A {
        let (pixel, first) = self.read;
        let (count, open) = self.pixels[pixel];
        let end = first + usize::from(count);
        self.read = (pixel + 1, end);
        if open == 0 && count == 1 {
            return self.colors[self.places[first] as usize];
        }
        let mut sum = background * f32::from(open);
        for (place, n) in self.places[first..end].iter().zip(&self.covered[first..end]) {
            sum += self.colors[*place as usize] * f32::from(*n);
        }
        sum * (1.0 / LANES as f32)
    }
}

struct Resolve<'a> {
    colors: &'a mut Colors,
    tile: &'a Tile,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Kernel for Resolve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        for y in self.rows {
            for x in self.columns.start..self.columns.end {
                self.colors.pixel_of(self.tile.samples(x, y), x as u16, y as u16);
            }
        }
    }
}
