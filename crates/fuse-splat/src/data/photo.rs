//! Photos as training wants them: decoded, undistorted, made smaller, with the camera that fits.

use std::path::Path;

use fuse_camera::{Camera, Pinhole, RgbBuffer};
use image::{DynamicImage, ImageDecoder as _, ImageReader};
use rayon::prelude::*;

use super::{Lens, SourceView};
use crate::SplatError;

/// A photo and its pinhole camera.
#[derive(Clone, Debug)]
pub struct Photo {
    /// 8-bit colour; transparent pixels fade to black.
    pub image: RgbBuffer,
    /// Size and intrinsics of `image`.
    pub camera: Camera,
}

impl SourceView {
    /// Size of the photo that [`Self::read`] makes, `downscale` times smaller, and its camera.
    ///
    /// # Errors
    /// If the distortion cannot be taken out, or nothing is left of the photo.
    pub fn camera_at(&self, downscale: u32) -> Result<Camera, SplatError> {
        let fail = |what: String| SplatError::file(&self.path, what);
        let flat = self.lens.undistorted(&self.camera.intrinsics).map_err(fail)?;
        let n = downscale.max(1);
        let (width, height) = (flat.width / n, flat.height / n);
        let scale = |v: f64| v / f64::from(n);
        let intrinsics = Pinhole::new(width, height, scale(flat.fx), scale(flat.fy), scale(flat.cx), scale(flat.cy))
            .map_err(|e| fail(format!("made {n} times smaller: {e}")))?;
        Ok(Camera { intrinsics, pose: self.camera.pose })
    }

    /// Decodes the photo, takes out the lens's distortion and averages `downscale` × `downscale`
    /// pixels into one; what is left over at the right and bottom is cut off.
    ///
    /// # Errors
    /// If the file is no PNG or JPEG, or its size is not the camera's.
    pub fn read(&self, downscale: u32) -> Result<Photo, SplatError> {
        let camera = self.camera_at(downscale)?;
        let fail = |what: String| SplatError::file(&self.path, what);
        let intrinsics = &self.camera.intrinsics;
        let pixels = decode(&self.path, (intrinsics.width, intrinsics.height)).map_err(fail)?;
        let flat = if self.lens.is_none() {
            pixels
        } else {
            let target = self.lens.undistorted(intrinsics).map_err(fail)?;
            undistort(&pixels, intrinsics, &self.lens, &target)
        };
        let small = shrink(flat, intrinsics.width as usize, downscale.max(1) as usize, &camera.intrinsics);
        let image = RgbBuffer::from_vec(camera.intrinsics.width, camera.intrinsics.height, small)
            .map_err(|e| fail(e.to_string()))?;
        Ok(Photo { image, camera })
    }
}

/// The pixels; the size is checked before they are decoded.
fn decode(path: &Path, expected: (u32, u32)) -> Result<Vec<[u8; 3]>, String> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(|e| e.to_string())?;
    let decoder = reader.into_decoder().map_err(|e| format!("not a PNG or JPEG: {e}"))?;
    let found = decoder.dimensions();
    if found != expected {
        return Err(format!(
            "the image is {}x{} but its camera {}x{}; the photos must be those that the poses were found for",
            found.0, found.1, expected.0, expected.1
        ));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|e| format!("the image is broken: {e}"))?;
    if !image.color().has_alpha() {
        return Ok(image.into_rgb8().into_raw().as_chunks().0.to_vec());
    }
    let over_black = |p: &[u8; 4]| [0, 1, 2].map(|c| ((u16::from(p[c]) * u16::from(p[3]) + 127) / 255) as u8);
    Ok(image.into_rgba8().into_raw().as_chunks().0.iter().map(over_black).collect())
}

/// Bilinear, from where the lens put each pixel.
fn undistort(pixels: &[[u8; 3]], source: &Pinhole, lens: &Lens, target: &Pinhole) -> Vec<[u8; 3]> {
    let (w, h) = (source.width as usize, source.height as usize);
    let mut out = vec![[0; 3]; target.width as usize * target.height as usize];
    out.par_chunks_mut(target.width as usize).enumerate().for_each(|(j, row)| {
        for (i, pixel) in row.iter_mut().enumerate() {
            let (u, v) = lens.source(source, target, i as f64 + 0.5, j as f64 + 0.5);
            // From continuous coordinates to those of pixel centres; the last pixel has no right
            // neighbour, and counts as its own.
            let x = (u - 0.5).clamp(0.0, (w - 1) as f64);
            let y = (v - 0.5).clamp(0.0, (h - 1) as f64);
            let (x0, y0) = (x as usize, y as usize);
            let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
            let (fx, fy) = (x - x0 as f64, y - y0 as f64);
            for c in 0..3 {
                let at = |x: usize, y: usize| f64::from(pixels[y * w + x][c]);
                let top = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
                let bottom = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
                pixel[c] = (top * (1.0 - fy) + bottom * fy).round() as u8;
            }
        }
    });
    out
}

/// Means of `n` × `n` pixels.
fn shrink(pixels: Vec<[u8; 3]>, width: usize, n: usize, to: &Pinhole) -> Vec<[u8; 3]> {
    if n == 1 {
        return pixels;
    }
    let (w, h, area) = (to.width as usize, to.height as usize, (n * n) as u32);
    (0..w * h)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % w * n, i / w * n);
            let mut sum = [area / 2; 3];
            for row in y..y + n {
                for p in &pixels[row * width + x..row * width + x + n] {
                    for c in 0..3 {
                        sum[c] += u32::from(p[c]);
                    }
                }
            }
            sum.map(|s| (s / area) as u8)
        })
        .collect()
}
