//! The Gaussians of a trainer while they are on the GPU.
//!
//! Between two calls of `refine` the CPU's copy is the truth, during a call the GPU's. Densification
//! and resets of opacities are decided by `densify.rs` and `surgery.rs` on the CPU, from what the
//! GPU gathered: that is every hundredth iteration, and the rule has one home.

use std::sync::Arc;

use fuse_camera::RgbBuffer;

use super::arrays::table_words;
use super::device::Device;
use super::memory::Array;
use super::pipeline::{Pipeline, Settings};
use crate::SplatError;
use crate::constants::{BETA1, BETA2, PARAMETERS};
use crate::cpu::StageSeconds;
use crate::stages::{Density, View};
use crate::surgery::Patient;
use crate::table::Table;

/// Losses that wait on the GPU to be read.
const LOSSES: usize = 1024;

/// Gaussians, true images and stages on the GPU.
#[derive(Debug)]
pub(crate) struct Engine {
    pipeline: Pipeline,
    truths: Vec<Arc<Array>>,
    gaussians: usize,
    waiting: usize,
    losses: Vec<f64>,
}

impl Engine {
    pub fn new(device: &Device) -> Self {
        Self { pipeline: Pipeline::new(device), truths: Vec::new(), gaussians: 0, waiting: 0, losses: Vec::new() }
    }

    /// Another between two calls: the Gaussians are the caller's, the true images are shared.
    pub fn fork(&self) -> Self {
        Self { truths: self.truths.clone(), ..Self::new(&self.pipeline.device) }
    }

    pub fn name(&self) -> &str {
        self.pipeline.device.name()
    }

    pub fn add_view(&mut self, image: &RgbBuffer) -> Result<(), SplatError> {
        self.truths.push(Arc::new(truth(&self.pipeline.device, image)?));
        Ok(())
    }

    /// To the GPU.
    pub fn upload(&mut self, patient: &Patient) -> Result<(), SplatError> {
        let (gpu, arrays) = (&self.pipeline.device.gpu, &mut self.pipeline.arrays);
        arrays.table.write(gpu, patient.parameters.numbers())?;
        arrays.first.write(gpu, patient.moments[0].numbers())?;
        arrays.second.write(gpu, patient.moments[1].numbers())?;
        let d = &patient.density;
        arrays.density.write(gpu, &[&d.gradient[..], &d.count, &d.radius].concat())?;
        arrays.losses.resize(gpu, LOSSES)?;
        self.gaussians = patient.len();
        Ok(())
    }

    /// And back; `patient` is left alone if that fails.
    pub fn download(&mut self, patient: &mut Patient) -> Result<(), SplatError> {
        let (p, n) = (&mut self.pipeline, self.gaussians);
        let parameters = p.read(p.encoder(), |a| &a.table, table_words(n))?;
        let first = p.read(p.encoder(), |a| &a.first, table_words(n))?;
        let second = p.read(p.encoder(), |a| &a.second, table_words(n))?;
        let density: Vec<f32> = p.read(p.encoder(), |a| &a.density, 3 * n)?;
        patient.parameters = table(&parameters, n);
        patient.moments = [table(&first, n), table(&second, n)];
        patient.density = Density {
            gradient: density[..n].to_vec(),
            count: density[n..2 * n].to_vec(),
            radius: density[2 * n..].to_vec(),
        };
        Ok(())
    }

    /// One iteration, number `t` (from 1), on view `index`; does not wait for its end. The loss
    /// comes with [`Self::take_losses`].
    pub fn iterate(
        &mut self,
        index: usize,
        view: &View,
        mut settings: Settings,
        rates: &[f32; PARAMETERS],
        t: u32,
    ) -> Result<(), SplatError> {
        if self.waiting == LOSSES {
            self.collect_losses()?;
        }
        settings.slot = self.waiting as u32;
        let p = &mut self.pipeline;
        p.arrays.rates.write(&p.device.gpu, &step(rates, t))?;
        p.prepare(view, self.gaussians, &settings)?;
        p.forward()?;
        let mut encoder = p.encoder();
        p.backward(&mut encoder, &self.truths[index])?;
        p.adam(&mut encoder);
        p.lap(&mut encoder, |s| &mut s.project_backward)?;
        p.submit(encoder);
        self.waiting += 1;
        Ok(())
    }

    fn collect_losses(&mut self) -> Result<(), SplatError> {
        let encoder = self.pipeline.encoder();
        let losses: Vec<f32> = self.pipeline.read(encoder, |a| &a.losses, self.waiting)?;
        self.losses.extend(losses.into_iter().map(f64::from));
        self.waiting = 0;
        Ok(())
    }

    /// The losses of all iterations since the last call.
    pub fn take_losses(&mut self) -> Result<Vec<f64>, SplatError> {
        self.collect_losses()?;
        Ok(std::mem::take(&mut self.losses))
    }

    /// Seconds of the stages since the last call; zeros unless the device is timed.
    pub fn take_seconds(&mut self) -> StageSeconds {
        std::mem::take(&mut self.pipeline.seconds)
    }
}

/// What adam.wgsl needs: rates over 1 − β₁ᵗ, and 1/(1 − β₂ᵗ); as `Step` in cpu/adam.rs.
pub(super) fn step(rates: &[f32; PARAMETERS], t: u32) -> [f32; PARAMETERS + 1] {
    let power = |beta: f32| 1.0 - f64::from(beta).powf(f64::from(t));
    let first = power(BETA1);
    std::array::from_fn(|row| match rates.get(row) {
        Some(rate) => (f64::from(*rate) / first) as f32,
        None => (1.0 / power(BETA2)) as f32,
    })
}

/// A true image for loss.wgsl.
pub(super) fn truth(device: &Device, image: &RgbBuffer) -> Result<Array, SplatError> {
    let pixels: Vec<u32> = image.as_slice().iter().map(|&[r, g, b]| u32::from_le_bytes([r, g, b, 0])).collect();
    Array::with(&device.gpu, "true image", &pixels)
}

/// A table of `n` vectors from its numbers, [`Table::numbers`].
pub(super) fn table(words: &[f32], n: usize) -> Table {
    let mut table = Table::zeros(n);
    let size = crate::LANES * PARAMETERS;
    for (block, words) in table.blocks_mut().iter_mut().zip(words.chunks_exact(size)) {
        block.0.as_flattened_mut().copy_from_slice(words);
    }
    table
}
