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
use fuse_camera::simd::{F32x8, Kernel, dispatch};

/// Rows of a task; a larger band repeats less at its rims.
const BAND: usize = 120;
/// Rows that are made in one step.
const STEP: usize = 4;
/// Rows by which windows lag behind the newest rows: the window's length less one, in whole steps.
const LAG: usize = (SSIM_WINDOW - 1).next_multiple_of(STEP);
/// Rows of a ring: what a step's windows span.
const ROWS: usize = LAG + STEP;
/// Columns of a ring: one vector.
const LANES: usize = 8;
/// Zeros to the left and to the right of a padded row.
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
    /// Red, green, blue planes in [0, 255], rows filled up to whole vectors.
    bytes: Vec<[u8; LANES]>,
    /// B y and B y², laid out alike.
    blurs: Vec<[[f32; LANES]; 2]>,
}

impl Target {
    /// From row-major pixels.
    pub fn new(level: Level, pixels: &[[u8; 3]], width: usize, height: usize) -> Self {
        let columns = width.div_ceil(LANES);
        let mut bytes = vec![[0; LANES]; 3 * height * columns];
        for (c, plane) in bytes.chunks_mut(height * columns).enumerate() {
            for (row, line) in pixels.chunks(width).zip(plane.chunks_mut(columns)) {
                for (v, pixel) in line.as_flattened_mut().iter_mut().zip(row) {
                    *v = pixel[c];
                }
            }
        }
        let mut blurs = vec![[[0.0; LANES]; 2]; bytes.len()];
        let planes = blurs.par_chunks_mut(height * columns).zip(bytes.par_chunks(height * columns));
        planes.for_each(|(blurs, bytes)| dispatch(level, BlurPlane { bytes, width, blurs }));
        Self { width, height, bytes, blurs }
    }

    /// Vectors in a row.
    fn columns(&self) -> usize {
        self.width.div_ceil(LANES)
    }

    /// Where the vectors of a row are.
    fn range(&self, channel: usize, y: usize) -> std::ops::Range<usize> {
        let start = (channel * self.height + y) * self.columns();
        start..start + self.columns()
    }
}

/// The last rows of `N` fields, column by column: a window down the rows is read from a few cache
/// lines that follow one another.
type Ring<const N: usize> = Vec<[[[f32; LANES]; ROWS]; N]>;

/// A row with room for the window on both sides.
fn padded(columns: usize) -> Vec<f32> {
    vec![0.0; columns * LANES + 2 * PAD]
}

/// Blurs `N` padded rows along; the results go into row `row` of the ring.
#[inline(always)]
fn blur_rows<V: F32x8, const N: usize>(w: &[V; HALF + 1], rows: [&[f32]; N], ring: &mut Ring<N>, row: usize) {
    for (i, fields) in ring.iter_mut().enumerate() {
        for k in 0..N {
            let Some(window) = rows[k][i * LANES..].first_chunk::<{ LANES + 2 * PAD }>() else { return };
            let at = |j: usize| V::load_slice(&window[PAD - HALF + j..]);
            let mut sum = w[HALF] * at(HALF);
            for j in 0..HALF {
                sum = w[j].mul_add(at(j) + at(2 * HALF - j), sum);
            }
            sum.store(&mut fields[k][row % ROWS]);
        }
    }
}

/// Blurs down the [`STEP`] windows of which the first begins at row `top`.
#[inline(always)]
fn blur_down<V: F32x8>(w: &[V; HALF + 1], rows: &[[f32; LANES]; ROWS], top: usize) -> [V; STEP] {
    let mut v = [V::zero(); SSIM_WINDOW + STEP - 1];
    for j in 0..v.len() {
        v[j] = V::load(&rows[(top + j) % ROWS]);
    }
    let mut sums = [V::zero(); STEP];
    for o in 0..STEP {
        sums[o] = w[HALF] * v[o + HALF];
        for k in 0..HALF {
            sums[o] = w[k].mul_add(v[o + k] + v[o + 2 * HALF - k], sums[o]);
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

/// The grey levels of a vector, in [0, 1].
#[inline(always)]
fn unpack<V: F32x8>(bytes: &[u8; LANES]) -> V {
    V::load_bytes(bytes) * V::splat(1.0 / 255.0)
}

struct BlurPlane<'a> {
    bytes: &'a [[u8; LANES]],
    width: usize,
    blurs: &'a mut [[[f32; LANES]; 2]],
}

impl Kernel for BlurPlane<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: F32x8>(self) {
        let w = weights::<V>();
        let columns = self.width.div_ceil(LANES);
        let height = self.bytes.len() / columns;
        let mut ring: Ring<2> = vec![[[[0.0; LANES]; ROWS]; 2]; columns];
        let (mut row, mut squares) = (padded(columns), padded(columns));
        // Rows in here are numbered r = y + HALF, so that they begin at zero.
        for top in (0..height + LAG).step_by(STEP) {
            for r in top..top + STEP {
                row.fill(0.0);
                if let Some(y) = r.checked_sub(HALF).filter(|&y| y < height) {
                    let bytes = self.bytes[y * columns..(y + 1) * columns].as_flattened();
                    for (v, &b) in row[PAD..].iter_mut().zip(bytes) {
                        *v = f32::from(b) * (1.0 / 255.0);
                    }
                }
                for (s, v) in squares.iter_mut().zip(&row) {
                    *s = v * v;
                }
                blur_rows(&w, [&row, &squares], &mut ring, r);
            }
            let Some(first) = top.checked_sub(LAG) else { continue };
            for (column, fields) in ring.iter().enumerate() {
                let mean = blur_down(&w, &fields[0], first);
                let square = blur_down(&w, &fields[1], first);
                for o in 0..STEP.min(height - first) {
                    let [to_mean, to_square] = &mut self.blurs[(first + o) * columns + column];
                    mean[o].store(to_mean);
                    square[o].store(to_square);
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
            let mut values = [0.0; LANES];
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
    along: Ring<3>,
    /// Blurs along the rows of ∂s/∂μ, ∂s/∂(B x²), ∂s/∂(B xy).
    slopes: Ring<3>,
    /// Padded rows: x, x², x y.
    rows: [Vec<f32>; 3],
    /// Padded rows: the three slopes of four rows.
    lines: [[Vec<f32>; 3]; STEP],
}

impl Scratch {
    fn new(columns: usize) -> Self {
        use std::array::from_fn;
        Self {
            along: vec![[[[0.0; LANES]; ROWS]; 3]; columns],
            slopes: vec![[[[0.0; LANES]; ROWS]; 3]; columns],
            rows: from_fn(|_| padded(columns)),
            lines: from_fn(|_| from_fn(|_| padded(columns))),
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
        let mut s = Scratch::new(self.target.columns());
        let height = self.out.len() / width;
        let n = width * self.target.height;
        let image = &self.image[self.channel * n..][..n];
        let band = BandView { first: self.first, height, channel: self.channel, target: self.target, image };
        let (mut l1, mut ssim) = (0.0, 0.0);
        for top in (0..height + 2 * LAG).step_by(STEP) {
            for r in top..top + STEP {
                along_row(&w, &band, r, &mut s);
            }
            let Some(first) = top.checked_sub(LAG) else { continue };
            ssim += slopes_rows::<V>(&w, &band, first, &mut s);
            let Some(last) = first.checked_sub(LAG) else { continue };
            l1 += gradient_rows::<V>(&w, &band, self.lambda, last, &s, self.out);
        }
        [l1, ssim]
    }
}

struct BandView<'a> {
    first: usize,
    height: usize,
    channel: usize,
    target: &'a Target,
    /// The channel's plane.
    image: &'a [f32],
}

impl BandView<'_> {
    /// Image row of shifted row `r`, if it is in the image.
    #[inline(always)]
    fn row(&self, r: usize) -> Option<usize> {
        (self.first + r).checked_sub(2 * HALF).filter(|&y| y < self.target.height)
    }

    /// x and y of an image row.
    #[inline(always)]
    fn pixels(&self, y: usize) -> (&[f32], &[[u8; LANES]]) {
        let width = self.target.width;
        (&self.image[y * width..(y + 1) * width], &self.target.bytes[self.target.range(self.channel, y)])
    }
}

/// Row `r` of x, x², x y, blurred along, into the ring.
#[inline(always)]
fn along_row<V: F32x8>(w: &[V; HALF + 1], band: &BandView<'_>, r: usize, s: &mut Scratch) {
    let [x, xx, xy] = &mut s.rows;
    match band.row(r) {
        Some(row) => {
            let (image, bytes) = band.pixels(row);
            let images = image.chunks(LANES).zip(bytes);
            let rows = x[PAD..].chunks_exact_mut(LANES).zip(xx[PAD..].chunks_exact_mut(LANES));
            let rows = rows.zip(xy[PAD..].chunks_exact_mut(LANES));
            for ((image, bytes), ((x, xx), xy)) in images.zip(rows) {
                let (vx, vy) = (load_lanes::<V>(image), unpack::<V>(bytes));
                vx.store_slice(x);
                (vx * vx).store_slice(xx);
                (vx * vy).store_slice(xy);
            }
        }
        None => [x, xx, xy].into_iter().for_each(|row| row.fill(0.0)),
    }
    blur_rows(w, s.rows.each_ref().map(|row| &row[..]), &mut s.along, r);
}

/// Four rows of slopes, blurred along, into the ring; returns Σ s over the rows that belong to
/// the band. `first` is the first row of the first window; the slopes' rows are numbered like it.
#[inline(always)]
fn slopes_rows<V: F32x8>(w: &[V; HALF + 1], band: &BandView<'_>, first: usize, s: &mut Scratch) -> f64 {
    let width = band.target.width;
    let centres: [Option<usize>; STEP] = std::array::from_fn(|o| band.row(first + o + HALF));
    // A row outside the image reads another row's blurs; what comes of it is not used.
    let blurs = centres.map(|row| &band.target.blurs[band.target.range(band.channel, row.unwrap_or(0))]);
    let mut ssim = [V::zero(); STEP];
    for (i, fields) in s.along.iter().enumerate() {
        let mean = blur_down(w, &fields[0], first);
        let square = blur_down(w, &fields[1], first);
        let product = blur_down(w, &fields[2], first);
        let lanes = (width - i * LANES).min(LANES);
        for o in 0..STEP {
            let [mean_y, square_y] = &blurs[o][i];
            let (value, slopes) = ssim_slopes(mean[o], square[o], product[o], V::load(mean_y), V::load(square_y));
            ssim[o] = ssim[o] + keep(value, lanes);
            for k in 0..3 {
                keep(slopes[k], lanes).store_slice(&mut s.lines[o][k][PAD + i * LANES..]);
            }
        }
    }
    let mut sum = 0.0;
    for o in 0..STEP {
        if centres[o].is_none() {
            s.lines[o].iter_mut().for_each(|line| line.fill(0.0));
        }
        blur_rows(w, s.lines[o].each_ref().map(|line| &line[..]), &mut s.slopes, first + o);
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
    if lanes == LANES {
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
    for (i, fields) in s.slopes.iter().enumerate() {
        let d_mean = blur_down(w, &fields[0], last);
        let d_xx = blur_down(w, &fields[1], last);
        let d_xy = blur_down(w, &fields[2], last);
        for o in 0..STEP.min(band.height - last) {
            let (image, bytes) = band.pixels(band.first + last + o);
            let (vx, vy) = (load_lanes::<V>(&image[i * LANES..]), unpack::<V>(&bytes[i]));
            let difference = vx - vy;
            let positive = V::splat(1.0).and(difference.gt(V::zero()));
            let negative = V::splat(1.0).and(V::zero().gt(difference));
            l1[o] = l1[o] + difference.max(difference.neg());
            let ssim = (vx + vx).mul_add(d_xx[o], d_mean[o]) + vy * d_xy[o];
            let gradient = (positive - negative).mul_add(sign_scale, ssim * ssim_scale);
            store_lanes(gradient, &mut out[(last + o) * width..(last + o + 1) * width][i * LANES..]);
        }
    }
    l1.iter().flat_map(|v| v.to_array()).map(f64::from).sum()
}
