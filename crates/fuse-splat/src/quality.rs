//! How close a rendering is to a photo, as the field reports it.

use fuse_camera::{Camera, RgbBuffer};

use crate::cpu::loss::{Target, loss};
use crate::{Gaussians, SplatError, psnr, render};

/// Rendering against photo, both in 8 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Peak signal-to-noise ratio, decibel.
    pub psnr: f64,
    /// Structural similarity, [`ssim`].
    pub ssim: f64,
}

/// Draws `camera`'s view over `background` and compares it with `image`.
///
/// # Errors
/// If image and camera differ in size, or are larger than 4096 pixels a side.
pub fn quality(
    gaussians: &Gaussians,
    camera: &Camera,
    image: &RgbBuffer,
    background: [f32; 3],
) -> Result<Quality, SplatError> {
    let drawn = render(gaussians, camera, background)?.color;
    let bytes = drawn.as_slice().iter().map(|p| p.map(|v| (v * 255.0).round() as u8)).collect();
    let drawn =
        RgbBuffer::from_vec(drawn.width(), drawn.height(), bytes).map_err(|e| SplatError::Input(e.to_string()))?;
    let unit =
        |b: &RgbBuffer| -> Vec<f32> { b.as_slice().as_flattened().iter().map(|&v| f32::from(v) / 255.0).collect() };
    let ssim = ssim(&drawn, image)?;
    Ok(Quality { psnr: psnr(&unit(&drawn), &unit(image))?, ssim })
}

/// Structural similarity of two images: the mean over pixels and channels, with a Gaussian window
/// of 11 × 11 pixels (σ = 1.5) and zeros around the images, as the original 3DGS measures it.
///
/// # Errors
/// If the images differ in size or are empty.
pub fn ssim(a: &RgbBuffer, b: &RgbBuffer) -> Result<f64, SplatError> {
    let (w, h) = (a.width() as usize, a.height() as usize);
    if (a.width(), a.height()) != (b.width(), b.height()) || w * h == 0 {
        return Err(SplatError::Input(format!(
            "SSIM needs two images of one size, found {w}x{h} and {}x{}",
            b.width(),
            b.height()
        )));
    }
    let level = fuse_camera::simd::level();
    let target = Target::new(level, b.as_slice(), w, h);
    let planes: Vec<f32> = (0..3).flat_map(|c| a.as_slice().iter().map(move |p| f32::from(p[c]) / 255.0)).collect();
    // The training's loss, with nothing but its D-SSIM: 1 − SSIM.
    Ok(1.0 - loss(level, &planes, &target, 1.0, &mut Vec::new()))
}
