//! Rendering, and the gradient of the loss, as plain functions.

use std::cell::Cell;

use fuse_camera::simd::Level;
use fuse_camera::{Buffer, Camera, RgbBuffer};
use rayon::prelude::*;

use crate::constants::MAX_DEGREE;
use crate::cpu::loss::Target;
use crate::cpu::{Pipeline, project_backward};
use crate::stages::View;
use crate::table::Table;
use crate::{Gaussians, SplatError};

/// Pixels that a thread converts at least.
const CHUNK: usize = 1 << 15;

thread_local! {
    /// Buffers of the thread's last rendering, for its next: fresh ones take longer to map than to fill.
    static PIPELINE: Cell<Option<Box<Pipeline>>> = const { Cell::new(None) };
}

/// A rendered view.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Colour, clamped to [0, 1].
    pub color: Buffer<[f32; 3]>,
    /// 1 − what the pixel lets through, in [0, 1].
    pub alpha: Buffer<f32>,
    /// Mean depth of what is drawn (Σ wᵢ zᵢ / Σ wᵢ), metres along the optical axis; 0 where nothing
    /// is.
    pub depth: Buffer<f32>,
}

/// Draws the Gaussians as `camera` sees them, over `background` (RGB in [0, 1]).
///
/// # Errors
/// If the image is larger than 4096 pixels a side.
pub fn render(gaussians: &Gaussians, camera: &Camera, background: [f32; 3]) -> Result<Rendering, SplatError> {
    render_at(fuse_camera::simd::level(), gaussians, camera, background)
}

/// [`render`] with a given SIMD level.
pub fn render_at(
    level: Level,
    gaussians: &Gaussians,
    camera: &Camera,
    background: [f32; 3],
) -> Result<Rendering, SplatError> {
    let view = View::new(camera)?;
    let mut pipeline = PIPELINE.take().unwrap_or_default();
    pipeline.level = level;
    pipeline.forward(&view, MAX_DEGREE, background, &gaussians.table, true);
    let image = &pipeline.image;
    let rendering =
        Drawn { color: &image.color, transmittance: &image.transmittance, depth: &image.depth }.rendering(&view);
    PIPELINE.set(Some(pipeline));
    rendering
}

/// Planes as a backend leaves them.
pub(crate) struct Drawn<'a> {
    /// Red, green, blue.
    pub color: &'a [f32],
    pub transmittance: &'a [f32],
    /// Σ wᵢ zᵢ, metres.
    pub depth: &'a [f32],
}

impl Drawn<'_> {
    pub fn rendering(&self, view: &View) -> Result<Rendering, SplatError> {
        let n = view.pixels();
        let color = (0..n)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|i| [0, 1, 2].map(|c| self.color[c * n + i].clamp(0.0, 1.0)))
            .collect();
        let alpha: Vec<f32> = self.transmittance.par_iter().with_min_len(CHUNK).map(|t| 1.0 - t).collect();
        let depth = self
            .depth
            .par_iter()
            .zip(&alpha)
            .with_min_len(CHUNK)
            .map(|(&d, &a)| if a > 0.0 { d / a } else { 0.0 })
            .collect();
        let buffer = |e: fuse_camera::BufferError| SplatError::Input(e.to_string());
        let (w, h) = (view.width as u32, view.height as u32);
        Ok(Rendering {
            color: Buffer::from_vec(w, h, color).map_err(buffer)?,
            alpha: Buffer::from_vec(w, h, alpha).map_err(buffer)?,
            depth: Buffer::from_vec(w, h, depth).map_err(buffer)?,
        })
    }
}

/// The training loss of one view, (1 − λ) L1 + λ (1 − SSIM), and its derivative with respect to
/// the 59 parameters of every Gaussian; harmonics up to `degree`, black background.
///
/// # Errors
/// If image and camera differ in size, or are too large.
pub fn loss_gradient(
    level: Level,
    gaussians: &Gaussians,
    camera: &Camera,
    image: &RgbBuffer,
    degree: u32,
    lambda: f32,
) -> Result<(f64, Table), SplatError> {
    let view = View::new(camera)?;
    let target = target(level, image, &view)?;
    let mut pipeline = Pipeline::new(level);
    pipeline.forward(&view, degree.min(MAX_DEGREE), [0.0; 3], &gaussians.table, false);
    let loss = pipeline.backward(&view, &target, lambda);
    let gathered = pipeline.gathered(&view, degree.min(MAX_DEGREE));
    Ok((loss, project_backward::gradient(level, gathered, &gaussians.table)))
}

/// A true image for a view.
pub(crate) fn target(level: Level, image: &RgbBuffer, view: &View) -> Result<Target, SplatError> {
    check_size(image, view)?;
    Ok(Target::new(level, image.as_slice(), view.width, view.height))
}

/// Refuses an image that is not as large as its camera says.
pub(crate) fn check_size(image: &RgbBuffer, view: &View) -> Result<(), SplatError> {
    let (w, h) = (image.width() as usize, image.height() as usize);
    if (w, h) != (view.width, view.height) {
        return Err(SplatError::Input(format!(
            "the image is {w}x{h} but its camera is {}x{}",
            view.width, view.height
        )));
    }
    Ok(())
}

/// Peak signal-to-noise ratio of two images in [0, 1], decibel: −10 log10 of the mean squared
/// difference; infinite for equal images.
///
/// # Errors
/// If the lengths differ or are zero.
pub fn psnr(a: &[f32], b: &[f32]) -> Result<f64, SplatError> {
    if a.len() != b.len() || a.is_empty() {
        return Err(SplatError::Input(format!(
            "PSNR needs two images of one size, found {} and {} values",
            a.len(),
            b.len()
        )));
    }
    let sum: f64 = a.iter().zip(b).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum();
    Ok(-10.0 * (sum / a.len() as f64).log10())
}
