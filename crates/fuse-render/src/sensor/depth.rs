//! What a structured-light or stereo camera measures of exact depth.
//!
//! Such a camera measures inverse depth, as a shift between two pictures: an error of the shift grows with the square
//! of the depth (Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", 2012), and so do the steps of
//! a shift that is told in whole fractions of a pixel. Beside a jump of the depth one of the two pictures does not see the
//! point.

use fuse_camera::simd::{self, F32x8, Kernel};
use fuse_camera::{Buffer, DepthBuffer};
use rayon::prelude::*;

use super::Sensor;
use super::random::{Key, LANES, Stream, normals, uniform};

/// Second difference of inverse depth from which a pixel is beside a jump, 1/m: 2 cm at 1 m, 8 cm at 2 m. It is zero
/// on every plane, however steeply seen.
const JUMP: f32 = 0.02;

/// Depth as measured, 0 where nothing is; untouched where all of it is off.
pub(super) fn measure(sensor: &Sensor, key: Key, depth: &mut DepthBuffer) {
    let s = sensor;
    let settings = [s.depth_noise_m, s.depth_noise_per_m, s.depth_edge_dropout, s.depth_step_per_m];
    let (w, h) = (depth.width() as usize, depth.height() as usize);
    if settings.iter().all(|v| *v == 0.0) || w * h == 0 {
        return;
    }
    let mut measured = Buffer::filled(depth.width(), depth.height(), 0.0);
    let exact = depth.as_slice();
    measured.as_mut_slice().par_chunks_mut(w).enumerate().for_each(|(y, out)| {
        simd::dispatch(simd::level(), Row { sensor, key, exact, y, out });
    });
    *depth = measured;
}

/// One row of the picture.
struct Row<'a> {
    sensor: &'a Sensor,
    key: Key,
    /// The whole picture.
    exact: &'a [f32],
    y: usize,
    out: &'a mut [f32],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        let (s, w) = (self.sensor, self.out.len());
        let row = &self.exact[self.y * w..][..w];
        for (i, (out, exact)) in self.out.chunks_mut(LANES).zip(row.chunks(LANES)).enumerate() {
            let words = self.key.words(Stream::Depth, (self.y * w + i * LANES) as u32);
            let [noise, _] = normals(&words[0], &words[1]);
            for ((out, z), n) in out.iter_mut().zip(exact).zip(noise) {
                let measured = z + (s.depth_noise_m + s.depth_noise_per_m * z * z) * n;
                *out = if *z > 0.0 { told(measured, s.depth_step_per_m) } else { 0.0 };
            }
            if s.depth_edge_dropout > 0.0 {
                for (k, out) in out.iter_mut().enumerate() {
                    let chosen = uniform(words[2][k]) < s.depth_edge_dropout;
                    if chosen && beside_jump(self.exact, w, i * LANES + k, self.y) {
                        *out = 0.0;
                    }
                }
            }
        }
    }
}

/// A measured depth in the steps that the camera tells; 0 for what it cannot tell.
#[inline(always)]
fn told(depth: f32, step: f32) -> f32 {
    let depth = depth.max(0.0);
    if step == 0.0 || depth == 0.0 {
        return depth;
    }
    // Rounded by conversion: floor() is a library call. Too near for the number is as near as it goes.
    let shift = (1.0 / (depth * step) + 0.5) as u32;
    if shift == 0 { 0.0 } else { 1.0 / (shift as f32 * step) }
}

#[inline(always)]
fn beside_jump(exact: &[f32], w: usize, x: usize, y: usize) -> bool {
    let h = exact.len() / w;
    let (left, right) = (x.saturating_sub(1), (x + 1).min(w - 1));
    let (up, down) = (y.saturating_sub(1), (y + 1).min(h - 1));
    let here = inverse(exact[y * w + x]);
    let bend = |a: usize, b: usize| (inverse(exact[a]) - here - (here - inverse(exact[b]))).abs() > JUMP;
    // At the picture's edge one neighbour is unknown: nothing can be said there.
    (right - left == 2 && bend(y * w + left, y * w + right)) || (down - up == 2 && bend(up * w + x, down * w + x))
}

/// 1/m; nothing is infinitely far.
#[inline(always)]
fn inverse(depth: f32) -> f32 {
    if depth == 0.0 { 0.0 } else { 1.0 / depth }
}
