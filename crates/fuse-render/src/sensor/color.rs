//! Light to bytes: blur, exposure, shot and read noise in linear light.
//!
//! Shot noise is Poisson's, whose variance is proportional to the light, read noise has the same variance everywhere
//! (EMVA Standard 1288, linear camera model). Both are one normal number here: above some twenty electrons the
//! difference is not seen.

use std::sync::LazyLock;

use fuse_camera::simd::{self, F32x8, Kernel};
use fuse_camera::{Buffer, RgbBuffer};
use glam::Vec3A;
use rayon::prelude::*;

use super::Sensor;
use super::blur::{CHANNELS, Linear, blur};
use super::random::{Key, LANES, Stream, normals};
use crate::cpu::shade::SrgbTable;
use crate::cpu::texture::srgb_to_linear;

static ENCODE: LazyLock<SrgbTable> = LazyLock::new(SrgbTable::new);
static DECODE: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0)));

/// Colours as the sensor sees them; untouched where all of it is off.
pub(super) fn expose(sensor: &Sensor, key: Key, rgb: &mut RgbBuffer) {
    let s = sensor;
    let settings = [s.exposure_stops, s.exposure_jitter_stops, s.defocus_px, s.motion_px, s.shot_noise, s.read_noise];
    let (w, h) = (rgb.width() as usize, rgb.height() as usize);
    if settings.iter().all(|v| *v == 0.0) || w * h == 0 {
        return;
    }
    let picture = blur(sensor, linear(rgb));
    let gain = gain(sensor, key);
    let variance = [sensor.shot_noise * sensor.shot_noise, sensor.read_noise * sensor.read_noise];
    rgb.as_mut_slice().par_chunks_mut(w).zip(picture.data.par_chunks(w * CHANNELS)).enumerate().for_each(
        |(y, (out, light))| {
            let first = (y * w) as u32;
            simd::dispatch(simd::level(), Row { key, first, gain, variance, light, out });
        },
    );
}

/// sRGB undone.
fn linear(rgb: &Buffer<[u8; 3]>) -> Linear {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let mut data = vec![0.0; width * height * CHANNELS];
    data.par_chunks_mut(width * CHANNELS).zip(rgb.as_slice().par_chunks(width)).for_each(|(out, row)| {
        for (to, from) in out.iter_mut().zip(row.as_flattened()) {
            *to = DECODE[usize::from(*from)];
        }
    });
    Linear { width, height, data }
}

/// Factor of this view's exposure.
fn gain(sensor: &Sensor, key: Key) -> f32 {
    let words = key.words(Stream::Frame, 0);
    let [jitter, _] = normals(&words[0], &words[1]);
    f64::from(sensor.exposure_stops + sensor.exposure_jitter_stops * jitter[0]).exp2() as f32
}

/// One row of the picture.
struct Row<'a> {
    key: Key,
    /// Number of its first pixel.
    first: u32,
    gain: f32,
    /// At white, of shot and of read noise.
    variance: [f32; 2],
    light: &'a [f32],
    out: &'a mut [[u8; 3]],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        let [shot, read] = self.variance;
        let noisy = shot + read > 0.0;
        let groups = self.out.chunks_mut(LANES).zip(self.light.chunks(LANES * CHANNELS));
        for (i, (out, light)) in groups.enumerate() {
            let mut noise = [[0.0; LANES]; 4];
            if noisy {
                let words = self.key.words(Stream::Color, self.first + (i * LANES) as u32);
                let ([r, g], [b, _]) = (normals(&words[0], &words[1]), normals(&words[2], &words[3]));
                noise = [r, g, b, [0.0; LANES]];
            }
            for (k, (out, light)) in out.iter_mut().zip(light.as_chunks::<CHANNELS>().0).enumerate() {
                let clean = Vec3A::from_array(*light) * self.gain;
                let z = Vec3A::new(noise[0][k], noise[1][k], noise[2][k]);
                let variance = clean * shot + Vec3A::splat(read);
                let deviation = Vec3A::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt());
                *out = ENCODE.encode(clean + deviation * z);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undoing_srgb_and_doing_it_again_changes_nothing() {
        for byte in 0..=255u8 {
            assert_eq!(ENCODE.encode(Vec3A::splat(DECODE[usize::from(byte)])), [byte; 3]);
        }
    }
}
