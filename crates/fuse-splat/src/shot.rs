//! A view to train on, at the resolutions at which it is looked at.

use std::sync::Arc;

use fuse_camera::simd::Level;
use fuse_camera::{Camera, RgbBuffer};

use crate::cpu::loss::Target;
use crate::stages::View;
use crate::{SplatError, TrainerConfig, checkpoint};

/// Smaller than this, a side is not halved: windows of SSIM would see little but the rim.
const SMALLEST: usize = 24;

/// One picture with its camera. Clones share the picture.
#[derive(Clone, Debug)]
pub(crate) struct Shot {
    pub camera: Camera,
    /// Checksum of the picture.
    pub print: u32,
    full: (View, Arc<Target>),
    /// Half as wide and half as high; only where the schedule looks at it.
    half: Option<(View, Arc<Target>)>,
    /// See [`TrainerConfig::matched_low_pass`].
    matched: bool,
}

impl Shot {
    /// Also keeps the picture at half its resolution where the schedule looks at it.
    ///
    /// # Errors
    /// If picture and camera differ in size, or are larger than 4096 pixels a side.
    pub fn new(level: Level, image: &RgbBuffer, camera: &Camera, config: &TrainerConfig) -> Result<Self, SplatError> {
        let view = View::new(camera)?;
        let target = crate::render::target(level, image, &view)?;
        let matched = config.matched_low_pass;
        let half = if config.fine_iterations.is_some() && view.width.min(view.height) >= 2 * SMALLEST {
            let half = view.halved(matched);
            let target = crate::render::target(level, &halve(image)?, &half)?;
            Some((half, Arc::new(target)))
        } else {
            None
        };
        Ok(Self { camera: *camera, print: checkpoint::print(image), full: (view, Arc::new(target)), half, matched })
    }

    /// Replaces the camera.
    ///
    /// # Errors
    /// If the picture is of another size.
    pub fn set_camera(&mut self, index: usize, camera: &Camera) -> Result<(), SplatError> {
        let new = View::new(camera)?;
        let (view, target) = &mut self.full;
        if (new.width, new.height) != (target.width, target.height) {
            return Err(SplatError::Input(format!(
                "view {index} is {}x{}, its new camera {}x{}",
                target.width, target.height, new.width, new.height
            )));
        }
        (self.camera, *view) = (*camera, new);
        if let Some((view, _)) = &mut self.half {
            *view = new.halved(self.matched);
        }
        Ok(())
    }

    /// Whether it is half the resolution (only where there is one and it is asked for), view and
    /// picture.
    pub fn at(&self, half: bool) -> (bool, &View, &Target) {
        match self.half.as_ref().filter(|_| half) {
            Some((view, target)) => (true, view, target),
            None => (false, &self.full.0, &self.full.1),
        }
    }
}

/// The mean of each two by two pixels, rounded; an odd last row or column is left out.
pub(crate) fn halve(image: &RgbBuffer) -> Result<RgbBuffer, SplatError> {
    let (w, h) = (image.width() / 2, image.height() / 2);
    let mut out = Vec::with_capacity((w * h) as usize);
    for y in 0..h {
        let rows = [image.row(2 * y), image.row(2 * y + 1)];
        for x in 0..w as usize {
            out.push(std::array::from_fn(|c| {
                let sum: u32 = rows.iter().flat_map(|r| &r[2 * x..2 * x + 2]).map(|p| u32::from(p[c])).sum();
                ((sum + 2) / 4) as u8
            }));
        }
    }
    RgbBuffer::from_vec(w, h, out).map_err(|e| SplatError::Input(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Gaussians;
    use crate::constants::{OPACITY, SCALE};
    use crate::cpu::Pipeline;

    #[test]
    fn a_quarter_of_the_pixels_are_means_of_four() {
        let pixels = (0..5 * 5).map(|i| [i as u8, 10 * i as u8, 7]).collect();
        let image = RgbBuffer::from_vec(5, 5, pixels).unwrap();
        // (0 + 1 + 5 + 6) / 4 = 3, (2 + 3 + 7 + 8) / 4 = 5, ten rows' worth further down 10 more.
        assert_eq!(halve(&image).unwrap().as_slice(), [[3, 30, 7], [5, 50, 7], [13, 130, 7], [15, 150, 7]]);
    }

    /// Gaussians no wider than a pixel, drawn at half the resolution and as the mean of four pixels.
    #[test]
    fn the_matched_low_pass_draws_what_means_of_pixels_show() {
        let xyz: Vec<[f32; 3]> =
            (0..48).map(|i| [0.08 * (i % 8) as f32 - 0.28, 0.09 * (i / 8) as f32 - 0.22, 1.0]).collect();
        let mut gaussians = Gaussians::from_points(&xyz, &[[0.9; 3]; 48]).unwrap();
        for i in 0..48 {
            (0..3).for_each(|k| gaussians.set(i, SCALE + k, f32::ln(0.005)));
            gaussians.set(i, OPACITY, 0.0);
        }
        let view = View {
            width: 96,
            height: 64,
            fx: 120.0,
            fy: 120.0,
            cx: 48.0,
            cy: 32.0,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
            center: [0.0; 3],
            low_pass: crate::constants::LOW_PASS,
        };
        let drawn = |view: &View| {
            let mut pipeline = Pipeline::new(fuse_camera::simd::level());
            pipeline.forward(view, 0, [0.0; 3], gaussians.table(), false);
            pipeline.image.color[..view.pixels()].to_vec()
        };
        let full = drawn(&view);
        let mean = |i: usize| {
            let (x, y) = (2 * (i % 48), 2 * (i / 48));
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| full[(y + dy) * 96 + x + dx]).iter().sum::<f32>() / 4.0
        };
        let error = |matched: bool| {
            let half = drawn(&view.halved(matched));
            half.iter().enumerate().map(|(i, v)| (v - mean(i)).powi(2)).sum::<f32>().sqrt()
        };
        let (matched, plain) = (error(true), error(false));
        // Not all of it: a wider splat is as opaque, so that it is brighter in sum.
        assert!(matched < 0.5 * plain && plain > 0.5, "{matched} with, {plain} without");
    }
}
