//! From the samples of a tile to the colours of its pixels.
//!
//! Each triangle in a pixel is shaded once, at the mean of the samples it covers, and weighted with
//! their number. But where all triangles of a pixel go on the one at its centre (same part, nearly the
//! same plane), that one is shaded for all, at the centre: they look the same, and pixels in which a fine
//! mesh has many triangles would take most of the time.

use std::ops::Range;

use fuse_camera::simd::{self, F32x8, I32x8, Kernel};
use glam::Vec3A;

use super::points::{Fragment, GROUP, Triangles};
use super::raster::{BLOCK, LANES, SAMPLES, Tile};
use super::shade::{Group, Shade, Shading};

/// Least cosine of the angle between triangles that go on one another.
pub(crate) const ALIKE: f32 = 0.95;
/// Largest distance in depth between them, as a share of the depth.
pub(crate) const NEARBY: f32 = 0.005;

/// Mean offset of the samples that are set in the index, pixels.
const MEANS: [[f32; 2]; 1 << LANES] = {
    let mut means = [[0.0; 2]; 1 << LANES];
    let mut mask = 1;
    while mask < means.len() {
        let (mut n, mut sum, mut s) = (0.0, [0.0, 0.0], 0);
        while s < LANES {
            if mask >> s & 1 != 0 {
                n += 1.0;
                sum = [sum[0] + SAMPLES[s][0], sum[1] + SAMPLES[s][1]];
            }
            s += 1;
        }
        means[mask] = [sum[0] / n, sum[1] / n];
        mask += 1;
    }
    means
};

/// Fragments of one tile and their colours, and which of them make up each pixel.
#[derive(Default)]
pub(super) struct Colors {
    fragments: Vec<Fragment>,
    /// The same, surface by surface.
    sorted: Vec<Fragment>,
    /// Where each fragment went there; the number of its run, until the runs' lengths are known.
    places: Vec<u32>,
    /// Surfaces of the tile, and number or end of each one's fragments.
    runs: Vec<(u32, u32)>,
    /// The last setup and its run.
    last: (u32, u32),
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
    pub fn resolve(&mut self, scene: &Triangles<'_>, tile: &Tile, columns: Range<usize>, rows: Range<usize>) {
        self.fragments.clear();
        self.covered.clear();
        self.pixels.clear();
        self.places.clear();
        self.runs.clear();
        self.last = (u32::MAX, 0);
        self.read = (0, 0);
        simd::dispatch(simd::level(), Resolve { colors: self, scene, tile, columns, rows });
    }

    #[inline(always)]
    fn pixel_of<V: F32x8>(&mut self, scene: &Triangles<'_>, samples: &[u32; LANES], x: u16, y: u16) {
        let keys = V::Int::load(samples);
        let mut left = u8::MAX;
        let (mut count, mut background) = (0, 0);
        while left != 0 {
            let key = samples[left.trailing_zeros() as usize];
            let covered = keys.equal(V::Int::splat(key as i32)).mask_bits();
            left &= !covered;
            let Some(setup) = key.checked_sub(1) else {
                background = covered.count_ones() as u8;
                continue;
            };
            // The first sample is the centre.
            if covered & 1 != 0 && scene.go_on::<V>((setup, x, y), samples, left) {
                self.add(scene, Fragment { setup, x, y, dx: 0.0, dy: 0.0 }, LANES as u8);
                self.pixels.push((1, 0));
                return;
            }
            let [dx, dy] = MEANS[covered as usize];
            let fragment = Fragment { setup, x, y, dx, dy };
            self.add(scene, fragment, covered.count_ones() as u8);
            count += 1;
        }
        self.pixels.push((count, background));
    }

    /// Pixels of one row that show one thing, or nothing for key 0.
    #[inline(always)]
    fn row(&mut self, scene: &Triangles<'_>, key: u32, columns: Range<usize>, y: u16) {
        let Some(setup) = key.checked_sub(1) else {
            self.pixels.extend(columns.map(|_| (0, LANES as u8)));
            return;
        };
        let (run, n) = (self.run(scene, setup), columns.len());
        self.runs[run as usize].1 += n as u32;
        self.fragments.extend(columns.map(|x| Fragment { setup, x: x as u16, y, dx: 0.0, dy: 0.0 }));
        self.places.extend(std::iter::repeat_n(run, n));
        self.covered.extend(std::iter::repeat_n(LANES as u8, n));
        self.pixels.extend(std::iter::repeat_n((1, 0), n));
    }

    #[inline(always)]
    fn add(&mut self, scene: &Triangles<'_>, fragment: Fragment, samples: u8) {
        let run = self.run(scene, fragment.setup);
        self.runs[run as usize].1 += 1;
        self.fragments.push(fragment);
        self.places.push(run);
        self.covered.push(samples);
    }

    /// Number of the run of a triangle's surface.
    #[inline(always)]
    fn run(&mut self, scene: &Triangles<'_>, setup: u32) -> u32 {
        if self.last.0 != setup {
            let surface = scene.geometry.parts[scene.binned.setup(setup).part as usize].surface;
            self.last = (setup, self.run_of(surface));
        }
        self.last.1
    }

    fn run_of(&mut self, surface: u32) -> u32 {
        let known = self.runs.iter().position(|r| r.0 == surface);
        known.unwrap_or_else(|| {
            self.runs.push((surface, 0));
            self.runs.len() - 1
        }) as u32
    }

    /// Shades the fragments, those of one surface together.
    pub fn shade(&mut self, scene: &Triangles<'_>, shading: &Shading, eye: Vec3A) {
        self.sort();
        self.colors.clear();
        self.colors.resize(self.sorted.len(), Vec3A::ZERO);
        let (fragments, colors, groups) = (&self.sorted[..], &mut self.colors[..], &mut self.groups);
        simd::dispatch(simd::level(), Shade { scene, shading, eye, fragments, colors, groups });
    }

    /// Puts the fragments of each surface into groups of their own, the last one filled up with
    /// its last fragment.
    fn sort(&mut self) {
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

impl Triangles<'_> {
    /// Whether the triangles at all samples of `left` go on the one at the centre `(setup, x, y)` of a pixel.
    #[inline(always)]
    fn go_on<V: F32x8>(&self, center: (u32, u16, u16), samples: &[u32; LANES], mut left: u8) -> bool {
        while left != 0 {
            let key = samples[left.trailing_zeros() as usize];
            left &= !V::Int::load(samples).equal(V::Int::splat(key as i32)).mask_bits();
            if key == 0 || !self.alike(center, key - 1) {
                return false;
            }
        }
        true
    }

    /// Whether a triangle goes on the one at the centre of a pixel, so that both look the same there.
    #[inline(always)]
    fn alike(&self, (setup, x, y): (u32, u16, u16), other: u32) -> bool {
        let (a, b) = (self.binned.setup(setup), self.binned.setup(other));
        if a.part != b.part {
            return false;
        }
        let facets = &self.geometry.facets;
        let (fa, fb) = (facets[a.triangle as usize], facets[b.triangle as usize]);
        let (u, v) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let (wa, wb) = (a.inverse_depth(u, v), b.inverse_depth(u, v));
        fa.dot(fb) >= ALIKE && (wa - wb).abs() <= f64::from(NEARBY) * wa
    }
}

struct Resolve<'a> {
    colors: &'a mut Colors,
    scene: &'a Triangles<'a>,
    tile: &'a Tile,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Kernel for Resolve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        for y in self.rows {
            for left in (self.columns.start..self.columns.end).step_by(BLOCK) {
                let columns = left..(left + BLOCK).min(self.columns.end);
                if let Some(key) = self.tile.whole_block(left, y) {
                    self.colors.row(self.scene, key, columns, y as u16);
                    continue;
                }
                for x in columns {
                    self.colors.pixel_of::<V>(self.scene, self.tile.samples(x, y), x as u16, y as u16);
                }
            }
        }
    }
}
