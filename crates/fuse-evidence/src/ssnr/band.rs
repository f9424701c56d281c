//! One band of rows, from pixels to SSNR, in one pass over rows that stay in the cache.
//!
//! Rows come in pairs: grey and its horizontal Sobel halves ([`GreyRing`]), gradients, sums over
//! eleven rows ([`Columns`]), and at last, over these sums, the sums of eleven neighbours and the
//! ratio of the two images' sums.

use std::cell::Cell;
use std::mem::MaybeUninit;

use super::Gradient;
use super::grey::GreySource;
use super::rows::{self, History, Neighbourhood, RADIUS, Row, Sums, reflect};
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

/// Horizontal Sobel halves of the last rows of one image. Row `y` lies in slot `y % 4`: a row and
/// its neighbours, reflected or not, never share a slot.
struct GreyRing {
    /// Grey of the row that was made last, padded by one at both ends.
    grey: Row,
    across: [Row; 4],
    smooth: [Row; 4],
    held: [Option<usize>; 4],
}

impl GreyRing {
    fn new(width: usize) -> Self {
        let rows = || std::array::from_fn(|_| Row::new(width, 0));
        Self { grey: Row::new(width + 2, 1), across: rows(), smooth: rows(), held: [None; 4] }
    }

    /// Makes the row if it is not there.
    #[inline(always)]
    fn load<const FMA: bool>(&mut self, source: &impl GreySource, y: usize) {
        let slot = y % 4;
        if self.held[slot] != Some(y) {
            let grey = self.grey.get_mut();
            let inner = 1..grey.len() - 1;
            source.row::<FMA>(y, &mut grey[inner]);
            rows::reflect_ends(grey, 1);
            rows::horizontal::<FMA>(grey, self.across[slot].get_mut(), self.smooth[slot].get_mut());
            self.held[slot] = Some(y);
        }
    }

    /// The row `y` and its neighbours, reflected at the top and bottom of the image.
    #[inline(always)]
    fn around<const FMA: bool>(&mut self, source: &impl GreySource, y: usize, height: usize) -> Neighbourhood<'_> {
        let above = reflect(y as isize - 1, height);
        let below = reflect(y as isize + 1, height);
        self.load::<FMA>(source, above);
        self.load::<FMA>(source, y);
        self.load::<FMA>(source, below);
        let (across, smooth) = (&self.across, &self.smooth);
        Neighbourhood {
            across: [across[above % 4].get(), across[y % 4].get(), across[below % 4].get()],
            smooth: [smooth[above % 4].get(), smooth[below % 4].get()],
        }
    }
}

/// Sums of one quantity over eleven rows, fed with pairs of rows.
struct Columns {
    /// Even row of the current pair.
    even: Row,
    /// Odd rows, pair sums and sums of two pairs; pair `k` in slot `k % 6`.
    odd: [Row; 6],
    pairs: [Row; 6],
    fours: [Row; 6],
    /// Sums that end with the even and the odd row, padded by [`RADIUS`], and their triples.
    windows: [Row; 2],
    triples: [Row; 2],
}

impl Columns {
    fn new(width: usize) -> Self {
        let rows = || std::array::from_fn(|_| Row::new(width, 0));
        Self {
            even: Row::new(width, 0),
            odd: rows(),
            pairs: rows(),
            fours: rows(),
            windows: std::array::from_fn(|_| Row::new(width + 2 * RADIUS, RADIUS)),
            triples: std::array::from_fn(|_| Row::new(width + 2 * RADIUS - 2, 0)),
        }
    }

    /// Where row `i` is to be written.
    #[inline(always)]
    fn row(&mut self, i: usize) -> &mut [f32] {
        if i.is_multiple_of(2) { self.even.get_mut() } else { self.odd[i / 2 % 6].get_mut() }
    }

    /// Sums up to pair `k`, whose rows have been written. Before the sixth pair the sums are of no
    /// use: what the slots held before is in them.
    #[inline(always)]
    fn add_pair(&mut self, k: usize) {
        let slot = |ago: usize| (k + 6 - ago) % 6;
        let [pair, p1, p5] = disjoint(&mut self.pairs, [slot(0), slot(1), slot(5)]);
        let [four, f1, f3] = disjoint(&mut self.fours, [slot(0), slot(1), slot(3)]);
        let history =
            History { pairs: [p1.get(), p5.get()], fours: [f1.get(), f3.get()], odd: self.odd[slot(5)].get() };
        let [w0, w1] = &mut self.windows;
        let windows = [&mut w0.get_mut()[RADIUS..], &mut w1.get_mut()[RADIUS..]];
        let odd = self.odd[slot(0)].get();
        rows::vertical(self.even.get(), odd, &history, pair.get_mut(), four.get_mut(), windows);
        for (window, triples) in self.windows.iter_mut().zip(&mut self.triples) {
            rows::reflect_ends(window.get_mut(), RADIUS);
            rows::triples(window.get(), triples.get_mut());
        }
    }

    /// The sums that end with row `i % 2` of the current pair.
    #[inline(always)]
    fn sums(&self, i: usize) -> Sums<'_> {
        Sums { row: self.windows[i % 2].get(), triples: self.triples[i % 2].get() }
    }
}

/// Three different slots of a ring.
#[inline(always)]
fn disjoint(ring: &mut [Row; 6], slots: [usize; 3]) -> [&mut Row; 3] {
    match ring.get_disjoint_mut(slots) {
        Ok(rows) => rows,
        Err(_) => unreachable!("slots k, k - 1 and k - 3 or k - 5 differ modulo 6"),
    }
}

/// Rows that a band works in; each thread keeps one for its next band.
struct Scratch {
    width: usize,
    observed: GreyRing,
    rendered: GreyRing,
    signal: Columns,
    noise: Columns,
}

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

impl Scratch {
    fn take(width: usize) -> Box<Self> {
        if let Some(mut kept) = SCRATCH.take()
            && kept.width == width
        {
            kept.observed.held = [None; 4];
            kept.rendered.held = [None; 4];
            return kept;
        }
        Box::new(Self {
            width,
            observed: GreyRing::new(width),
            rendered: GreyRing::new(width),
            signal: Columns::new(width),
            noise: Columns::new(width),
        })
    }
}

impl Band {
    /// Computes and writes every element of `out`, the first of which is the first of row `first`
    /// (an even number) of the image.
    pub fn run<R: GreySource>(
        &self,
        first: usize,
        observed: &View<'_, [u8; 3]>,
        rendered: &R,
        out: &mut [MaybeUninit<f32>],
    ) {
        let mut scratch = Scratch::take(self.width);
        self.dispatch(&mut scratch, first, observed, rendered, out);
        SCRATCH.set(Some(scratch));
    }

    fn dispatch<R: GreySource>(
        &self,
        scratch: &mut Scratch,
        first: usize,
        observed: &View<'_, [u8; 3]>,
        rendered: &R,
        out: &mut [MaybeUninit<f32>],
    ) {
        #[cfg(target_arch = "x86_64")]
        if fuse_camera::simd::level() >= fuse_camera::simd::Level::Avx2Fma {
            // SAFETY: the level is only chosen on a machine that has AVX2 and FMA.
            return unsafe { self.run_avx2(scratch, first, observed, rendered, out) };
        }
        self.run_at::<false, R>(scratch, first, observed, rendered, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2<R: GreySource>(
        &self,
        scratch: &mut Scratch,
        first: usize,
        observed: &View<'_, [u8; 3]>,
        rendered: &R,
        out: &mut [MaybeUninit<f32>],
    ) {
        self.run_at::<true, R>(scratch, first, observed, rendered, out);
    }

    #[inline(always)]
    fn run_at<const FMA: bool, R: GreySource>(
        &self,
        scratch: &mut Scratch,
        first: usize,
        observed: &View<'_, [u8; 3]>,
        rendered: &R,
        out: &mut [MaybeUninit<f32>],
    ) {
        let Scratch { observed: observed_ring, rendered: rendered_ring, signal, noise, .. } = scratch;
        let mut out = out.chunks_exact_mut(self.width);
        // The window of row y begins five rows above it: pair k holds rows first - 5 + 2k and the next.
        for k in 0.. {
            for i in [2 * k, 2 * k + 1] {
                let y = reflect((first + i) as isize - RADIUS as isize, self.height);
                rows::gradients::<FMA>(
                    observed_ring.around::<FMA>(observed, y, self.height),
                    rendered_ring.around::<FMA>(rendered, y, self.height),
                    self.gradient,
                    signal.row(i),
                    noise.row(i),
                );
            }
            signal.add_pair(k);
            noise.add_pair(k);
            if k < RADIUS {
                continue;
            }
            for i in 0..2 {
                let Some(out) = out.next() else { return };
                self.finish::<FMA>(signal.sums(i), noise.sums(i), out);
            }
        }
    }

    #[inline(always)]
    fn finish<const FMA: bool>(&self, signal: Sums<'_>, noise: Sums<'_>, out: &mut [MaybeUninit<f32>]) {
        match self.finish {
            Finish::Decibel { scale, offset } => {
                rows::decibels::<FMA>(signal, noise, self.epsilon, scale, offset, out);
            }
            Finish::Ratio => rows::ratios(signal, noise, self.epsilon, out),
        }
    }
}
