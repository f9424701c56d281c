//! One iteration on the GPU: the stages in their order. passes.rs says how each is recorded.

use std::time::Instant;

use super::arrays::Arrays;
use super::device::Device;
use super::memory::{Array, Landing, uniform};
use super::passes::{DEPTH_PASSES, SORT_BITS};
use crate::SplatError;
use crate::cpu::{StageSeconds, lap};
use crate::stages::View;

/// `Frame` of common.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Frame {
    camera: [[f32; 4]; 3],
    center: [f32; 3],
    degree: u32,
    background: [f32; 3],
    lambda: f32,
    focal: [f32; 2],
    principal: [f32; 2],
    pub size: [u32; 2],
    pub tiles: [u32; 2],
    pub gaussians: u32,
    pub pairs: u32,
    slot: u32,
    low_pass: f32,
}

/// What an image is made with, beside view and Gaussians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// Of the harmonics.
    pub degree: u32,
    pub background: [f32; 3],
    /// λ of the loss.
    pub lambda: f32,
    /// Where the loss goes in the list of losses.
    pub slot: u32,
}

/// Arrays and small change of all stages, kept between iterations.
#[derive(Debug)]
pub(crate) struct Pipeline {
    pub device: Device,
    pub arrays: Arrays,
    pub landing: Landing,
    pub seconds: StageSeconds,
    pub(super) frame: Frame,
    pub(super) frame_buffer: wgpu::Buffer,
    /// First bit of each pass of the sort.
    pub(super) shifts: Vec<wgpu::Buffer>,
    clock: Instant,
}

impl Pipeline {
    pub fn new(device: &Device) -> Self {
        let gpu = &device.gpu;
        Self {
            device: device.clone(),
            arrays: Arrays::new(gpu),
            landing: Landing::new(gpu, 4096),
            seconds: StageSeconds::default(),
            frame: Frame::default(),
            frame_buffer: uniform(gpu, "frame", &Frame::default()),
            shifts: (0..DEPTH_PASSES).map(|pass| uniform(gpu, "shift", &[pass * SORT_BITS, 0, 0, 0])).collect(),
            clock: Instant::now(),
        }
    }

    pub fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    pub fn submit(&self, encoder: wgpu::CommandEncoder) {
        self.device.gpu.queue.submit([encoder.finish()]);
    }

    /// Reads `words` words of an array after all that was recorded.
    pub fn read<T: bytemuck::Pod>(
        &mut self,
        encoder: wgpu::CommandEncoder,
        array: impl Fn(&Arrays) -> &Array,
        words: usize,
    ) -> Result<Vec<T>, SplatError> {
        array(&self.arrays).read(&self.device.gpu, encoder, 0..words, &mut self.landing)
    }

    /// Room and settings for an image of `n` Gaussians; they are in `arrays.table` already.
    pub fn prepare(&mut self, view: &View, n: usize, settings: &Settings) -> Result<(), SplatError> {
        self.arrays.fit_view(&self.device.gpu, view)?;
        self.arrays.fit_gaussians(&self.device.gpu, n)?;
        let r = &view.rotation;
        self.frame = Frame {
            camera: std::array::from_fn(|i| [r[i][0], r[i][1], r[i][2], view.translation[i]]),
            center: view.center,
            degree: settings.degree,
            background: settings.background,
            lambda: settings.lambda,
            focal: [view.fx, view.fy],
            principal: [view.cx, view.cy],
            size: [view.width as u32, view.height as u32],
            tiles: [view.tiles_x() as u32, view.tiles_y() as u32],
            gaussians: n as u32,
            pairs: 0,
            slot: settings.slot,
            low_pass: view.low_pass,
        };
        self.write_frame();
        Ok(())
    }

    pub(super) fn write_frame(&self) {
        self.device.gpu.queue.write_buffer(&self.frame_buffer, 0, bytemuck::bytes_of(&self.frame));
    }

    pub(super) fn gaussians(&self) -> usize {
        self.frame.gaussians as usize
    }

    /// Draws the image: `project` … `rasterize`. How many pairs there are is known half-way, which
    /// is the one moment at which an iteration waits for the GPU.
    pub fn forward(&mut self) -> Result<(), SplatError> {
        self.clock = Instant::now();
        let mut encoder = self.encoder();
        let mut pairs = 0;
        if self.gaussians() > 0 {
            self.project(&mut encoder);
            self.lap(&mut encoder, |s| &mut s.project)?;
            self.sort(&mut encoder)?;
            self.lap(&mut encoder, |s| &mut s.sort)?;
            self.count_tiles(&mut encoder);
            pairs = self.total_pairs(encoder)?;
            encoder = self.encoder();
        }
        self.set_pairs(pairs)?;
        self.sort_tiles(&mut encoder)?;
        self.lap(&mut encoder, |s| &mut s.intersect)?;
        self.rasterize(&mut encoder);
        self.lap(&mut encoder, |s| &mut s.rasterize)?;
        self.submit(encoder);
        Ok(())
    }

    /// The loss of the drawn image and all gradients: `loss` … `project_backward`.
    pub fn backward(&mut self, encoder: &mut wgpu::CommandEncoder, truth: &Array) -> Result<(), SplatError> {
        self.clock = Instant::now();
        self.loss(encoder, truth);
        self.lap(encoder, |s| &mut s.loss)?;
        self.rasterize_backward(encoder);
        self.lap(encoder, |s| &mut s.rasterize_backward)?;
        self.project_backward(encoder);
        self.lap(encoder, |s| &mut s.project_backward)
    }

    /// Ends a stage; if stages are timed, waits for it.
    pub fn lap(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        to: impl Fn(&mut StageSeconds) -> &mut f64,
    ) -> Result<(), SplatError> {
        if self.device.timed {
            let done = std::mem::replace(encoder, self.encoder());
            self.submit(done);
            self.device.gpu.wait()?;
            lap(&mut self.clock, to(&mut self.seconds));
        }
        Ok(())
    }
}
