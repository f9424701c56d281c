//! One band of rows, from pixels to SSNR, in one pass over rows that stay in the cache.

use std::mem::swap;

use super::Gradient;
use super::grey::GreySource;
use super::rows::{self, History, RADIUS, Row, reflect};
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
    rows: [Row; 4],
    held: [Option<usize>; 4],
}

impl<'a, S: GreySource> GreyRing<'a, S> {
    fn new(source: &'a S, width: usize) -> Self {
        Self { source, rows: std::array::from_fn(|_| Row::new(width + 2, 1)), held: [None; 4] }
    }

    /// Makes the row if it is not there.
    #[inline(always)]
    fn load<const FMA: bool>(&mut self, y: usize) {
        if self.held[y % 4] != Some(y) {
            let row = self.rows[y % 4].get_mut();
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
        self.load::<FMA>(above);
        self.load::<FMA>(y);
        self.load::<FMA>(below);
        [self.rows[above % 4].get(), self.rows[y % 4].get(), self.rows[below % 4].get()]
    }
}

/// Window sums of one quantity, fed row by row.
struct Windows {
    /// The current row, padded by [`RADIUS`] at both ends.
    row: Row,
    /// Its horizontal triples.
    triples: Row,
    /// Horizontal sums of the last eleven rows.
    sums: [Row; 11],
    /// Vertical triples of the last seven.
    vertical: [Row; 7],
    /// Where the next horizontal sum and vertical triple are written.
    next: (Row, Row),
    /// Sums over the last eleven rows.
    window: Row,
}

impl Windows {
    fn new(width: usize) -> Self {
        Self {
            row: Row::new(width + 2 * RADIUS, RADIUS),
            triples: Row::new(width + 2 * RADIUS - 2, 0),
            sums: std::array::from_fn(|_| Row::new(width, 0)),
            vertical: std::array::from_fn(|_| Row::new(width, 0)),
            next: (Row::new(width, 0), Row::new(width, 0)),
            window: Row::new(width, 0),
        }
    }

    /// Adds the current row as the `i`-th.
    #[inline(always)]
    fn push(&mut self, i: usize) {
        rows::reflect_ends(self.row.get_mut(), RADIUS);
        rows::triples(self.row.get(), self.triples.get_mut());
        // Slots of rows that do not exist yet hold zeros or sums that are not read further.
        let sum = |ago: usize| (i + 77 - ago) % 11;
        let triple = |ago: usize| (i + 77 - ago) % 7;
        let sums = |ago| self.sums[sum(ago)].get();
        let history = History {
            rows: [sums(1), sums(2), sums(9), sums(10)],
            triples: [self.vertical[triple(3)].get(), self.vertical[triple(6)].get()],
        };
        let (next_sum, next_triple) = (self.next.0.get_mut(), self.next.1.get_mut());
        rows::windows(self.row.get(), self.triples.get(), &history, next_sum, next_triple, self.window.get_mut());
        swap(&mut self.sums[sum(0)], &mut self.next.0);
        swap(&mut self.vertical[triple(0)], &mut self.next.1);
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
                &mut signal.row.get_mut()[inner.clone()],
                &mut noise.row.get_mut()[inner.clone()],
            );
            signal.push(i);
            noise.push(i);
            // The window of row y is complete five rows below it.
            if let Some(row) = i.checked_sub(2 * RADIUS) {
                let out = &mut out[row * self.width..(row + 1) * self.width];
                self.finish::<FMA>(signal.window.get(), noise.window.get(), out);
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
