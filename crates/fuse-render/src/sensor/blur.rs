//! Point spread: the disc of a lens out of focus, the streak of a camera that moves while the shutter is open.
//!
//! Each is a list of shifted copies with weights that add up to 1, sampled linearly between pixels. Beyond the
//! picture its edge goes on.

use fuse_camera::simd::{self, F32x8, Kernel};
use rayon::prelude::*;

use super::Sensor;

/// Linear colour, row by row, the channels of a pixel side by side.
pub(super) struct Linear {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

/// Numbers a pixel.
pub(super) const CHANNELS: usize = 3;

/// Points along a radius of the disc, and along a pixel of the streak.
const DENSITY: usize = 8;

/// How light of one pixel spreads: weights of the pixels around it.
#[derive(Debug)]
pub(super) struct Spread {
    reach: usize,
    /// `(2 reach + 1)²` weights, row by row.
    weights: Vec<f32>,
}

impl Spread {
    /// Of points around the pixel, evenly weighted: each goes to the four pixels around it.
    fn of(points: impl Iterator<Item = (f64, f64)> + Clone, radius: f64) -> Self {
        let reach = radius.ceil() as usize;
        let side = 2 * reach + 1;
        let share = 1.0 / points.clone().count() as f64;
        // One more than needed: the last neighbours of a point at the very rim have weight 0.
        let mut weights = vec![0.0; (side + 1) * (side + 1)];
        for (x, y) in points {
            let (x, y) = (x + reach as f64, y + reach as f64);
            let (column, row) = (x.floor(), y.floor());
            let (fx, fy) = (x - column, y - row);
            let at = row as usize * (side + 1) + column as usize;
            weights[at] += share * (1.0 - fx) * (1.0 - fy);
            weights[at + 1] += share * fx * (1.0 - fy);
            weights[at + side + 1] += share * (1.0 - fx) * fy;
            weights[at + side + 2] += share * fx * fy;
        }
        let rows = weights.chunks(side + 1).take(side);
        Self { reach, weights: rows.flat_map(|row| row[..side].iter().map(|w| *w as f32)).collect() }
    }

    /// A disc, evenly bright.
    fn disc(diameter: f64) -> Self {
        let n = DENSITY as i32 * (diameter / 2.0).ceil().max(1.0) as i32;
        let radius = diameter / 2.0;
        // Cell middles of a square grid, so that the disc is the same on all sides.
        let middle = move |i: i32| (f64::from(i) + 0.5) / f64::from(n);
        let points = (-n..n).flat_map(move |j| (-n..n).map(move |i| (middle(i), middle(j))));
        let inside = points.filter(|(x, y)| x * x + y * y <= 1.0);
        Self::of(inside.map(move |(x, y)| (x * radius, y * radius)), radius)
    }

    /// A straight line through the middle.
    fn streak(length: f64, degrees: f64) -> Self {
        let n = DENSITY as i32 * length.ceil().max(1.0) as i32;
        let (sin, cos) = exact_direction(degrees);
        let along = move |i: i32| ((f64::from(i) + 0.5) / f64::from(n) - 0.5) * length;
        Self::of((0..n).map(along).map(move |s| (s * cos, s * sin)), length / 2.0)
    }

    /// Weights that are not zero, with row and column from the top left.
    fn taps(&self) -> Vec<(usize, usize, f32)> {
        let side = 2 * self.reach + 1;
        let place = |(i, w): (usize, &f32)| (i / side, i % side, *w);
        self.weights.iter().enumerate().map(place).filter(|t| t.2 != 0.0).collect()
    }

    /// The picture as this spreads it.
    fn apply(&self, picture: &Linear) -> Linear {
        let (w, h, reach) = (picture.width, picture.height, self.reach);
        let stride = (w + 2 * reach) * CHANNELS;
        let mut padded = vec![0.0; stride * (h + 2 * reach)];
        padded.par_chunks_mut(stride).enumerate().for_each(|(y, row)| {
            let from = y.saturating_sub(reach).min(h - 1) * w * CHANNELS;
            let source = &picture.data[from..from + w * CHANNELS];
            let (left, rest) = row.split_at_mut(reach * CHANNELS);
            let (middle, right) = rest.split_at_mut(w * CHANNELS);
            middle.copy_from_slice(source);
            left.chunks_mut(CHANNELS).for_each(|p| p.copy_from_slice(&source[..CHANNELS]));
            right.chunks_mut(CHANNELS).for_each(|p| p.copy_from_slice(&source[(w - 1) * CHANNELS..]));
        });
        let taps = self.taps();
        let mut data = vec![0.0; w * h * CHANNELS];
        data.par_chunks_mut(w * CHANNELS).enumerate().for_each(|(y, out)| {
            simd::dispatch(simd::level(), Row { taps: &taps, source: &padded[y * stride..], stride, out });
        });
        Linear { width: w, height: h, data }
    }
}

/// One row of the result: multiply and add, never fused, in the order of the taps.
struct Row<'a> {
    taps: &'a [(usize, usize, f32)],
    /// From the first row that the result needs.
    source: &'a [f32],
    stride: usize,
    out: &'a mut [f32],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        for &(dy, dx, weight) in self.taps {
            let source = &self.source[dy * self.stride + dx * CHANNELS..][..self.out.len()];
            for (out, v) in self.out.iter_mut().zip(source) {
                *out += weight * v;
            }
        }
    }
}

/// Sine and cosine, exact for quarters of a turn.
fn exact_direction(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => degrees.to_radians().sin_cos(),
    }
}

/// Defocus, then motion; the picture itself where both are off.
pub(super) fn blur(sensor: &Sensor, picture: Linear) -> Linear {
    let mut picture = picture;
    if sensor.defocus_px > 0.0 {
        picture = Spread::disc(f64::from(sensor.defocus_px)).apply(&picture);
    }
    if sensor.motion_px > 0.0 {
        picture = Spread::streak(f64::from(sensor.motion_px), f64::from(sensor.motion_deg)).apply(&picture);
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum, mean and mean square of the shifts of a spread.
    fn moments(spread: &Spread) -> [f64; 6] {
        let mut m = [0.0; 6];
        for (row, column, w) in spread.taps() {
            let (x, y) = (column as f64 - spread.reach as f64, row as f64 - spread.reach as f64);
            let of = [1.0, x, y, x * x, y * y, x * y];
            m.iter_mut().zip(of).for_each(|(m, v)| *m += f64::from(w) * v);
        }
        m
    }

    #[test]
    fn a_disc_has_its_size() {
        for diameter in [0.3, 1.0, 2.0, 5.5, 16.0f64] {
            let m = moments(&Spread::disc(diameter));
            assert!((m[0] - 1.0).abs() < 1e-5 && m[1].abs() < 1e-5 && m[2].abs() < 1e-5, "{diameter}: {m:?}");
            // d²/16 along each axis, and at most 1/4 for the sampling between pixels.
            let disc = diameter * diameter / 16.0;
            for spread in [m[3], m[4]] {
                assert!((disc * 0.98..disc * 1.02 + 0.25).contains(&spread), "{diameter}: {spread} for {disc}");
            }
            assert!(m[5].abs() < 1e-5);
        }
    }

    #[test]
    fn a_streak_has_its_length_and_direction() {
        for (length, degrees) in [(6.0, 0.0), (9.0, 90.0), (12.0, 30.0f64)] {
            let m = moments(&Spread::streak(length, degrees));
            assert!((m[0] - 1.0).abs() < 1e-5 && m[1].abs() < 1e-4 && m[2].abs() < 1e-4, "{m:?}");
            let (sin, cos) = degrees.to_radians().sin_cos();
            let line = length * length / 12.0;
            assert!((m[3] - line * cos * cos).abs() < 0.26, "{m:?}");
            assert!((m[4] - line * sin * sin).abs() < 0.26, "{m:?}");
            assert!((m[5] - line * sin * cos).abs() < 0.1, "{m:?}");
        }
        let flat = Spread::streak(6.0, 0.0);
        assert!(flat.taps().iter().all(|t| t.0 == flat.reach), "rows mix in a streak along them");
    }
}
