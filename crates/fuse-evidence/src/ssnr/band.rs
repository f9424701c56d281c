//! One band of rows, from pixels to SSNR, in one pass over rows that stay in the cache.

use std::mem::take;

use super::Gradient;
use super::grey::GreySource;
use super::rows::{self, History, RADIUS, reflect};
use crate::view::View;

/// What is written for window sums `A` and `B`.
#[derive(Clone, Copy)]
pub enum Finish {
    /// `offset + scale · clip(10 log₁₀ ((A + ε) / (B + ε)), ±30)`.
    Decibel {
        /// Factor.
        scale: f32,
        /// Summand.
        offset: f32,
    },
    /// `A / (B + ε)`.
    Ratio,
}

/// What all bands of a comparison share.
#[derive(Clone, Copy)]
pub struct Band {
    /// Width of the image.
    pub width: usize,
    /// Height of the image.
    pub height: usize,
    /// `ε` in squared grey units.
    pub epsilon: f32,
    /// How gradients are compared.
    pub gradient: Gradient,
    /// What is written.
    pub finish: Finish,
}

/// The last grey rows of one image, padded by one at both ends. Row `y` lies in slot `y % 4`: the
/// three neighbours of a row, reflected or not, never share a slot.
struct GreyRing<'a, S> {
    source: &'a S,
    rows: [Vec<f32>; 4],
    held: [Option<usize>; 4],
}

impl<'a, S: GreySource> GreyRing<'a, S> {
    fn new(source: &'a S, width: usize) -> Self {
        Self { source, rows: std::array::from_fn(|_| vec![0.0; width + 2]), held: [None; 4] }
    }

    /// Makes the row if it is not there.
    #[inline(always)]
    fn load<const FMA: bool>(&mut self, y: usize) {
        if self.held[y % 4] != Some(y) {
            let row = &mut self.rows[y % 4];
            let n = row.len() - 1;
            self.source.row::<FMA>(y, &mut row[1..n]);
            rows::reflect_ends(row, 1);
            self.held[y % 4] = Some(y);
        }
    }

    /// The row `y` between its neighbours, reflected at the top and bottom of the image.
    #[inline(always)]
    fn around<const FMA: bool>(&mut self, y: usize, height: usize) -> [&[f32]; 3] {
        let above = reflect(y as isize - 1, height);
        let below = reflect(y as isize + 1, height);
        for row in [above, y, below] {
            self.load::<FMA>(row);
        }
        [above, y, below].map(|row| self.rows[row % 4].as_slice())
    }
}

/// Window sums of one quantity, fed row by row.
struct Windows {
    /// The current row, padded by [`RADIUS`] at both ends.
    row: Vec<f32>,
    /// Its horizontal triples.
    triples: Vec<f32>,
    /// Horizontal sums of the last eleven rows.
    sums: [Vec<f32>; 11],
    /// Vertical triples of the last seven.
    vertical: [Vec<f32>; 7],
    /// Sums over the last eleven rows.
    window: Vec<f32>,
}

impl Windows {
    fn new(width: usize) -> Self {
        let zeros = |n| vec![0.0; n];
        Self {
            row: zeros(width + 2 * RADIUS),
            triples: zeros(width + 2 * RADIUS - 2),
            sums: std::array::from_fn(|_| zeros(width)),
            vertical: std::array::from_fn(|_| zeros(width)),
            window: zeros(width),
        }
    }

    /// Adds the current row as the `i`-th.
    #[inline(always)]
    fn push(&mut self, i: usize) {
        rows::reflect_ends(&mut self.row, RADIUS);
        rows::triples(&self.row, &mut self.triples);
        // Slots of rows that do not exist yet hold zeros or sums that are not read further.
        let ago = |n: usize| (i + 77 - n) % 11;
        let triple_ago = |n: usize| (i + 77 - n) % 7;
        let mut sum = take(&mut self.sums[ago(0)]);
        let mut triple = take(&mut self.vertical[triple_ago(0)]);
        let history = History {
            rows: [1, 2, 9, 10].map(|n| self.sums[ago(n)].as_slice()),
            triples: [3, 6].map(|n| self.vertical[triple_ago(n)].as_slice()),
        };
        rows::windows(&self.row, &self.triples, &history, &mut sum, &mut triple, &mut self.window);
        self.sums[ago(0)] = sum;
        self.vertical[triple_ago(0)] = triple;
    }
}

impl Band {
    /// Computes the rows of `out`, the first of which is row `first` of the image.
    pub fn run<R: GreySource>(&self, first: usize, observed: &View<'_, [u8; 3]>, rendered: &R, out: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if fuse_camera::simd::level() == fuse_camera::simd::Level::Avx2Fma {
            // SAFETY: the level is only chosen on a machine that has AVX2 and FMA.
            return unsafe { self.run_avx2(first, observed, rendered, out) };
        }
        self.run_at::<false, R>(first, observed, rendered, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2<R: GreySource>(&self, first: usize, observed: &View<'_, [u8; 3]>, rendered: &R, out: &mut [f32]) {
        self.run_at::<true, R>(first, observed, rendered, out);
    }

    #[inline(always)]
    fn run_at<const FMA: bool, R: GreySource>(
        &self,
        first: usize,
        observed: &View<'_, [u8; 3]>,
        rendered: &R,
        out: &mut [f32],
    ) {
        let mut observed = GreyRing::new(observed, self.width);
        let mut rendered = GreyRing::new(rendered, self.width);
        let (mut signal, mut noise) = (Windows::new(self.width), Windows::new(self.width));
        let inner = RADIUS..RADIUS + self.width;
        let count = out.len() / self.width;
        for i in 0..count + 2 * RADIUS {
            let y = reflect((first + i) as isize - RADIUS as isize, self.height);
            rows::gradients::<FMA>(
                observed.around::<FMA>(y, self.height),
                rendered.around::<FMA>(y, self.height),
                self.gradient,
                &mut signal.row[inner.clone()],
                &mut noise.row[inner.clone()],
            );
            signal.push(i);
            noise.push(i);
            // The window of row y is complete five rows below it.
            if let Some(row) = i.checked_sub(2 * RADIUS) {
                let out = &mut out[row * self.width..(row + 1) * self.width];
                self.finish::<FMA>(&signal.window, &noise.window, out);
            }
        }
    }

    #[inline(always)]
    fn finish<const FMA: bool>(&self, signal: &[f32], noise: &[f32], out: &mut [f32]) {
        match self.finish {
            Finish::Decibel { scale, offset } => {
                rows::decibels::<FMA>(signal, noise, self.epsilon, scale, offset, out);
            }
            Finish::Ratio => rows::ratios(signal, noise, self.epsilon, out),
        }
    }
}
