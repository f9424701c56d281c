//! Rendering, and the gradient of the loss, as plain functions; twin of render.rs.

use fuse_camera::{Camera, RgbBuffer};

use super::arrays::table_words;
use super::device::Device;
use super::engine::{table, truth};
use super::pipeline::{Pipeline, Settings};
use crate::constants::MAX_DEGREE;
use crate::render::{Drawn, check_size};
use crate::stages::View;
use crate::table::Table;
use crate::{Gaussians, Rendering, SplatError};

/// Draws the Gaussians as `camera` sees them, over `background` (RGB in [0, 1]); as
/// [`crate::render()`].
///
/// # Errors
/// If the image is larger than 4096 pixels a side, or the GPU fails.
pub fn render(
    device: &Device,
    gaussians: &Gaussians,
    camera: &Camera,
    background: [f32; 3],
) -> Result<Rendering, SplatError> {
    let view = View::new(camera)?;
    let settings = Settings { degree: MAX_DEGREE, background, lambda: 0.0, slot: 0 };
    let mut p = load(device, gaussians, &view, &settings)?;
    p.forward()?;
    let n = view.pixels();
    let color: Vec<f32> = p.read(p.encoder(), |a| &a.color, 3 * n)?;
    let transmittance: Vec<f32> = p.read(p.encoder(), |a| &a.transmittance, n)?;
    let depth: Vec<f32> = p.read(p.encoder(), |a| &a.depth, n)?;
    Drawn { color: &color, transmittance: &transmittance, depth: &depth }.rendering(&view)
}

/// The training loss of one view and its derivative with respect to the 59 parameters of every
/// Gaussian; as [`crate::loss_gradient`].
///
/// # Errors
/// If image and camera differ in size, or are too large, or the GPU fails.
pub fn loss_gradient(
    device: &Device,
    gaussians: &Gaussians,
    camera: &Camera,
    image: &RgbBuffer,
    degree: u32,
    lambda: f32,
) -> Result<(f64, Table), SplatError> {
    let view = View::new(camera)?;
    check_size(image, &view)?;
    let settings = Settings { degree: degree.min(MAX_DEGREE), background: [0.0; 3], lambda, slot: 0 };
    let mut p = load(device, gaussians, &view, &settings)?;
    let truth = truth(device, image)?;
    p.forward()?;
    let mut encoder = p.encoder();
    p.backward(&mut encoder, &truth)?;
    let n = gaussians.len();
    let gradient = p.read(encoder, |a| &a.gradient, table_words(n))?;
    let loss: Vec<f32> = p.read(p.encoder(), |a| &a.losses, 1)?;
    Ok((f64::from(loss[0]), table(&gradient, n)))
}

/// A pipeline with Gaussians and a view in it.
pub(super) fn load(
    device: &Device,
    gaussians: &Gaussians,
    view: &View,
    settings: &Settings,
) -> Result<Pipeline, SplatError> {
    let mut p = Pipeline::new(device);
    p.arrays.table.write(&device.gpu, gaussians.table.numbers())?;
    p.arrays.density.write(&device.gpu, &vec![0f32; 3 * gaussians.len().max(1)])?;
    p.prepare(view, gaussians.len(), settings)?;
    Ok(p)
}
