//! The loss and its gradient with respect to the image, fused.
//!
//! L = (1 − λ) mean |x − y| + λ (1 − mean s), s the SSIM of 11×11 Gaussian windows (σ = 1.5, zero
//! padding, as in the original), means over pixels and channels. With B the window's blur,
//! μ = B x, σ² = B x² − μ², σxy = B xy − μx μy:
//! s = (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2)),
//! dL/dx = (1 − λ)/n sign(x − y) − λ/n (B ∂s/∂μ + 2x B ∂s/∂(Bx²) + y B ∂s/∂(Bxy)).
//!
//! A task owns a band of rows of one channel and walks down it, four rows at a time: blur along
//! the rows into a ring, blur down the ring, differentiate, blur along the rows into a second
//! ring, blur down that. The blurs of the true image are made once a view.

use std::sync::LazyLock;

use fuse_camera::simd::Level;
use rayon::prelude::*;

use crate::constants::{SSIM_C1, SSIM_C2, SSIM_SIGMA, SSIM_WINDOW};
use crate::simd::{F32x8, Kernel, dispatch};

/// Rows of a task; a larger band repeats less at its rims.
const BAND: usize = 120;
/// Rows that are made in one step.
const STEP: usize = 4;
/// Rows by which windows lag behind the newest rows: the window's length less one, in whole steps.
const LAG: usize = (SSIM_WINDOW - 1).next_multiple_of(STEP);
/// Rows of a ring of blurs: what a step's windows span.
const BLURS: usize = LAG + STEP;
/// Rows of a ring of images: what lies between the newest rows and the gradient's.
const IMAGES: usize = 32;
/// Zeros to the left of a padded row.
const PAD: usize = 8;
/// Half the window.
const HALF: usize = SSIM_WINDOW / 2;

/// The window's weights from its rim to its middle; the whole window adds up to one.
static WEIGHTS: LazyLock<[f32; HALF + 1]> = LazyLock::new(|| {
    let w: [f64; SSIM_WINDOW] = std::array::from_fn(|i| {
        let d = i as f64 - HALF as f64;
        (-d * d / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()
    });
    let sum: f64 = w.iter().sum();
    std::array::from_fn(|i| (w[i] / sum) as f32)
});

/// A true image with what the loss needs of it.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    pub width: usize,
    pub height: usize,
    /// Red, green, blue planes, 8 bits a value.
    bytes: Vec<u8>,
    /// B y, three planes.
    mean: Vec<f32>,
    /// B y², three planes.
    square: Vec<f32>,
}

impl Target {
    /// From row-major pixels.
    pub fn new(level: Level, pixels: &[[u8; 3]], width: usize, height: usize) -> Self {
        let bytes: Vec<u8> = (0..3).flat_map(|c| pixels.iter().map(move |p| p[c])).collect();
        let n = width * height;
        let mut target = Self { width, height, bytes, mean: vec![0.0; 3 * n], square: vec![0.0; 3 * n] };
        let (mut mean, mut square) = (std::mem::take(&mut target.mean), std::mem::take(&mut target.square));
        let planes = mean.par_chunks_mut(n).zip(square.par_chunks_mut(n)).enumerate();
        planes.for_each(|(c, (mean, square))| {
            dispatch(level, BlurPlane { bytes: &target.bytes[c * n..(c + 1) * n], width, height, mean, square });
        });
        (target.mean, target.square) = (mean, square);
        target
    }
}

/// Length of a row with room for the window on both sides, in whole vectors.
fn stride(width: usize) -> usize {
    width.next_multiple_of(8) + 2 * PAD
}

/// Blurs along a padded row; `out` is padded alike, its padding is left alone.
#[inline(always)]
fn blur_row<V: F32x8>(w: &[V; HALF + 1], row: &[f32], out: &mut [f32]) {
    let n = out.len() - 2 * PAD;
    for x in (0..n).step_by(8) {
        let window = &row[PAD - HALF + x..][..8 + 2 * HALF];
        let mut sum = w[HALF] * V::load_slice(&window[HALF..]);
        for k in 0..HALF {
            let pair = V::load_slice(&window[k..]) + V::load_slice(&window[2 * HALF - k..]);
            sum = w[k].mul_add(pair, sum);
        }
        sum.store_slice(&mut out[PAD + x..]);
    }
}

/// Padded rows, indexed by row number modulo `ROWS`.
struct Ring<const ROWS: usize> {
    lines: Vec<f32>,
    stride: usize,
}

impl<const ROWS: usize> Ring<ROWS> {
    fn new(stride: usize) -> Self {
        Self { lines: vec![0.0; ROWS * stride], stride }
    }

    #[inline(always)]
    fn line(&self, row: usize) -> &[f32] {
        &self.lines[row % ROWS * self.stride..][..self.stride]
    }

    #[inline(always)]
    fn line_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.lines[row % ROWS * self.stride..][..self.stride]
    }

    /// The rows of [`STEP`] windows that begin at rows `top`, `top + 1` and so on.
    #[inline(always)]
    fn windows(&self, top: usize) -> [&[f32]; SSIM_WINDOW + STEP - 1] {
        std::array::from_fn(|j| self.line(top + j))
    }
}

/// Blurs down [`STEP`] windows at once, at column `x`.
#[inline(always)]
fn blur_down<V: F32x8>(w: &[V; HALF + 1], rows: &[&[f32]; SSIM_WINDOW + STEP - 1], x: usize) -> [V; STEP] {
    let mut v = [V::zero(); SSIM_WINDOW + STEP - 1];
    for (v, row) in v.iter_mut().zip(rows) {
        *v = V::load_slice(&row[PAD + x..]);
    }
    let mut sums = [V::zero(); STEP];
    for (o, sum) in sums.iter_mut().enumerate() {
        *sum = w[HALF] * v[o + HALF];
        for k in 0..HALF {
            *sum = w[k].mul_add(v[o + k] + v[o + 2 * HALF - k], *sum);
        }
    }
    sums
}

#[inline(always)]
fn weights<V: F32x8>() -> [V; HALF + 1] {
    let mut out = [V::zero(); HALF + 1];
    for (v, &w) in out.iter_mut().zip(WEIGHTS.iter()) {
        *v = V::splat(w);
    }
    out
}

/// Bytes of an image row → a padded row in [0, 1]; zeros for a row outside the image.
#[inline(always)]
fn unpack(bytes: Option<&[u8]>, out: &mut [f32]) {
    match bytes {
        Some(bytes) => {
            for (v, &b) in out[PAD..].iter_mut().zip(bytes) {
                *v = f32::from(b) * (1.0 / 255.0);
            }
        }
        None => out.fill(0.0),
    }
}

struct BlurPlane<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    mean: &'a mut [f32],
    square: &'a mut [f32],
}

impl Kernel for BlurPlane<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(self) {
        let w = weights::<V>();
        let stride = stride(self.width);
        let mut rings: [Ring<BLURS>; 2] = [Ring::new(stride), Ring::new(stride)];
        let (mut row, mut squares) = (vec![0.0; stride], vec![0.0; stride]);
        // Rows in here are numbered r = y + HALF, so that they begin at zero.
        for top in (0..self.height + LAG).step_by(STEP) {
            for r in top..top + STEP {
                let y = r.checked_sub(HALF).filter(|&y| y < self.height);
                unpack(y.map(|y| &self.bytes[y * self.width..(y + 1) * self.width]), &mut row);
                for (s, v) in squares.iter_mut().zip(&row) {
                    *s = v * v;
                }
                blur_row(&w, &row, rings[0].line_mut(r));
                blur_row(&w, &squares, rings[1].line_mut(r));
            }
            let Some(first) = top.checked_sub(LAG) else { continue };
            let rows = first..(first + STEP).min(self.height);
            for (ring, plane) in rings.iter().zip([&mut *self.mean, &mut *self.square]) {
                let windows = ring.windows(first);
                for x in (0..self.width).step_by(8) {
                    let blurred = blur_down(&w, &windows, x);
                    for (y, v) in rows.clone().zip(blurred) {
                        store_lanes(v, &mut plane[y * self.width + x..(y + 1) * self.width]);
                    }
                }
            }
        }
    }
}

/// The values of `from`, zero beyond its end.
#[inline(always)]
fn load_lanes<V: F32x8>(from: &[f32]) -> V {
    match from.first_chunk() {
        Some(chunk) => V::load(chunk),
        None => {
            let mut values = [0.0; 8];
            values[..from.len()].copy_from_slice(from);
            V::load(&values)
        }
    }
}

/// As many lanes as `to` has room for.
#[inline(always)]
fn store_lanes<V: F32x8>(v: V, to: &mut [f32]) {
    match to.first_chunk_mut() {
        Some(chunk) => v.store(chunk),
        None => {
            let lanes = to.len();
            to.copy_from_slice(&v.to_array()[..lanes]);
        }
    }
}

/// The loss; fills `gradient` (three planes) with its derivative with respect to `image`.
pub(crate) fn loss(level: Level, image: &[f32], target: &Target, lambda: f32, gradient: &mut Vec<f32>) -> f64 {
    let n = target.width * target.height;
    gradient.resize(3 * n, 0.0);
    let bands: Vec<(usize, usize, &mut [f32])> = gradient
        .chunks_mut(n)
        .enumerate()
        .flat_map(|(c, plane)| {
            plane.chunks_mut(BAND * target.width).enumerate().map(move |(b, out)| (c, b * BAND, out))
        })
        .collect();
    let sums: Vec<[f64; 2]> = bands
        .into_par_iter()
        .map(|(c, first, out)| dispatch(level, LossBand { image, target, lambda, channel: c, first, out }))
        .collect();
    let [l1, ssim] = sums.iter().fold([0.0; 2], |s, v| [s[0] + v[0], s[1] + v[1]]);
    let (lambda, n) = (f64::from(lambda), (3 * n) as f64);
    (1.0 - lambda) * l1 / n + lambda * (1.0 - ssim / n)
}

struct LossBand<'a> {
    image: &'a [f32],
    target: &'a Target,
    lambda: f32,
    channel: usize,
    /// First image row of the band.
    first: usize,
    out: &'a mut [f32],
}

/// Working memory of one band.
struct Scratch {
    /// Blurs along the rows of x, x², x y.
    along: [Ring<BLURS>; 3],
    /// Blurs along the rows of ∂s/∂μ, ∂s/∂(B x²), ∂s/∂(B xy).
    slopes: [Ring<BLURS>; 3],
    /// Padded rows: x, y, x², x y.
    rows: [Vec<f32>; 4],
    /// Padded rows: the three slopes of four rows.
    lines: [[Vec<f32>; 3]; STEP],
    /// x and y of the last rows.
    images: [Ring<IMAGES>; 2],
}

impl Scratch {
    fn new(stride: usize) -> Self {
        use std::array::from_fn;
        Self {
            along: from_fn(|_| Ring::new(stride)),
            slopes: from_fn(|_| Ring::new(stride)),
            rows: from_fn(|_| vec![0.0; stride]),
            lines: from_fn(|_| from_fn(|_| vec![0.0; stride])),
            images: from_fn(|_| Ring::new(stride)),
        }
    }
}

impl Kernel for LossBand<'_> {
    type Output = [f64; 2];

    /// Row numbers inside are shifted by 2·HALF against the image, so that they are not negative:
    /// r = y − first + 2·HALF.
    #[inline(always)]
    fn run<V: F32x8>(self) -> [f64; 2] {
        let (width, w) = (self.target.width, weights::<V>());
        let stride = stride(width);
        let mut s = Scratch::new(stride);
        let height = self.out.len() / width;
        let (out, band) = (&mut *self.out, BandView { first: self.first, height, target: self.target });
        let (mut l1, mut ssim) = (0.0, 0.0);
        for top in (0..height + 2 * LAG).step_by(STEP) {
            for r in top..top + STEP {
                along_row(&w, self.image, &band, self.channel, r, &mut s);
            }
            let Some(first) = top.checked_sub(LAG) else { continue };
            ssim += slopes_rows::<V>(&w, &band, self.channel, first, &mut s);
            let Some(last) = first.checked_sub(LAG) else { continue };
            l1 += gradient_rows::<V>(&w, &band, self.lambda, last, &s, out);
        }
        [l1, ssim]
    }
}

struct BandView<'a> {
    first: usize,
    height: usize,
    target: &'a Target,
}

impl BandView<'_> {
    /// Image row of shifted row `r`, if it is in the image.
    #[inline(always)]
    fn row(&self, r: usize) -> Option<usize> {
        (self.first + r).checked_sub(2 * HALF).filter(|&y| y < self.target.height)
    }

    fn range(&self, channel: usize, y: usize) -> std::ops::Range<usize> {
        let width = self.target.width;
        let start = (channel * self.target.height + y) * width;
        start..start + width
    }
}

/// Row `r` of x, x², x y, blurred along, into the rings.
#[inline(always)]
fn along_row<V: F32x8>(
    w: &[V; HALF + 1],
    image: &[f32],
    band: &BandView<'_>,
    channel: usize,
    r: usize,
    s: &mut Scratch,
) {
    let [x, y, xx, xy, ..] = &mut s.rows;
    let range = band.row(r).map(|row| band.range(channel, row));
    match &range {
        Some(range) => x[PAD..PAD + band.target.width].copy_from_slice(&image[range.clone()]),
        None => x.fill(0.0),
    }
    unpack(range.map(|range| &band.target.bytes[range]), y);
    for (((x, y), xx), xy) in x.iter().zip(&*y).zip(&mut *xx).zip(&mut *xy) {
        *xx = x * x;
        *xy = x * y;
    }
    blur_row(w, x, s.along[0].line_mut(r));
    blur_row(w, xx, s.along[1].line_mut(r));
    blur_row(w, xy, s.along[2].line_mut(r));
    s.images[0].line_mut(r).copy_from_slice(x);
    s.images[1].line_mut(r).copy_from_slice(y);
}

/// Four rows of slopes, blurred along, into the rings; returns Σ s over the rows that belong to
/// the band. `first` is the first row of the first window; the slopes' rows are numbered like it.
#[inline(always)]
fn slopes_rows<V: F32x8>(w: &[V; HALF + 1], band: &BandView<'_>, channel: usize, first: usize, s: &mut Scratch) -> f64 {
    let width = band.target.width;
    let mut sum = 0.0;
    let centres: [Option<usize>; STEP] = std::array::from_fn(|o| band.row(first + o + HALF));
    let mut ssim = [V::zero(); STEP];
    let windows = s.along.each_ref().map(|ring| ring.windows(first));
    for x in (0..width).step_by(8) {
        let mean = blur_down(w, &windows[0], x);
        let square = blur_down(w, &windows[1], x);
        let product = blur_down(w, &windows[2], x);
        let lanes = (width - x).min(8);
        for o in 0..STEP {
            let Some(row) = centres[o] else { continue };
            let at = band.range(channel, row).start + x;
            let mean_y = load_lanes(&band.target.mean[at..at + lanes]);
            let square_y = load_lanes(&band.target.square[at..at + lanes]);
            let (value, slopes) = ssim_slopes(mean[o], square[o], product[o], mean_y, square_y);
            ssim[o] = ssim[o] + keep(value, lanes);
            for (slope, line) in slopes.into_iter().zip(&mut s.lines[o]) {
                keep(slope, lanes).store_slice(&mut line[PAD + x..]);
            }
        }
    }
    for o in 0..STEP {
        for (line, ring) in s.lines[o].iter_mut().zip(&mut s.slopes) {
            if centres[o].is_none() {
                line.fill(0.0);
            }
            blur_row(w, line, ring.line_mut(first + o));
        }
        // Slopes' row n has its centre at row n + HALF; the band's own begin at 2·HALF.
        let inside = (HALF..HALF + band.height).contains(&(first + o));
        if inside && centres[o].is_some() {
            sum += ssim[o].to_array().iter().map(|&v| f64::from(v)).sum::<f64>();
        }
    }
    sum
}

/// The first `lanes` lanes, zero in the others.
#[inline(always)]
fn keep<V: F32x8>(v: V, lanes: usize) -> V {
    if lanes == 8 {
        return v;
    }
    let mut values = v.to_array();
    values[lanes..].fill(0.0);
    V::load(&values)
}

/// SSIM and its derivatives with respect to B x, B x² and B xy.
#[inline(always)]
fn ssim_slopes<V: F32x8>(mx: V, xx: V, xy: V, my: V, yy: V) -> (V, [V; 3]) {
    let s = V::splat;
    let (mxx, mxy, myy) = (mx * mx, mx * my, my * my);
    let a1 = s(2.0).mul_add(mxy, s(SSIM_C1));
    let a2 = s(2.0).mul_add(xy - mxy, s(SSIM_C2));
    let b1 = mxx + myy + s(SSIM_C1);
    let b2 = (xx - mxx) + (yy - myy) + s(SSIM_C2);
    let inverse = s(1.0) / (b1 * b2);
    let value = a1 * a2 * inverse;
    let d_xx = (value * b1 * inverse).neg();
    let d_xy = s(2.0) * a1 * inverse;
    let direct = s(2.0) * (my * a2 - value * mx * b2) * inverse;
    let d_mean = direct - my * d_xy - s(2.0) * mx * d_xx;
    (value, [d_mean, d_xx, d_xy])
}

/// Four rows of the gradient; returns Σ |x − y| over those in the band. `last` is the first row of
/// the first window of slopes, so that the gradient's first row is `last + 2·HALF`.
#[inline(always)]
fn gradient_rows<V: F32x8>(
    w: &[V; HALF + 1],
    band: &BandView<'_>,
    lambda: f32,
    last: usize,
    s: &Scratch,
    out: &mut [f32],
) -> f64 {
    let width = band.target.width;
    let n = (3 * width * band.target.height) as f32;
    let (sign_scale, ssim_scale) = (V::splat((1.0 - lambda) / n), V::splat(-lambda / n));
    let mut l1 = [V::zero(); STEP];
    let windows = s.slopes.each_ref().map(|ring| ring.windows(last));
    for x in (0..width).step_by(8) {
        let d_mean = blur_down(w, &windows[0], x);
        let d_xx = blur_down(w, &windows[1], x);
        let d_xy = blur_down(w, &windows[2], x);
        for o in 0..STEP {
            let row = last + o;
            if row >= band.height {
                break;
            }
            let vx = V::load_slice(&s.images[0].line(row + 2 * HALF)[PAD + x..]);
            let vy = V::load_slice(&s.images[1].line(row + 2 * HALF)[PAD + x..]);
            let difference = vx - vy;
            let positive = V::splat(1.0).and(difference.gt(V::zero()));
            let negative = V::splat(1.0).and(V::zero().gt(difference));
            l1[o] = l1[o] + difference.max(difference.neg());
            let ssim = (vx + vx).mul_add(d_xx[o], d_mean[o]) + vy * d_xy[o];
            let gradient = (positive - negative).mul_add(sign_scale, ssim * ssim_scale);
            store_lanes(gradient, &mut out[row * width + x..(row + 1) * width]);
        }
    }
    l1.iter().flat_map(|v| v.to_array()).map(f64::from).sum()
}
