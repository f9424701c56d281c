//! What this process draws and trains on, by a caller's wish: opened once a wish, kept to its end.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use fuse_camera::Camera;
use fuse_camera::gpu::{self, Request, Software};

use super::device::Device;
use crate::{Gaussians, Rendering, SplatError, Trainer, TrainerConfig};

/// What Gaussians are drawn and trained on. Its `Display` says so, for logs and records.
#[derive(Clone, Debug)]
pub enum Choice {
    /// The CPU, at [`fuse_camera::simd::level`].
    Cpu,
    /// A GPU with the compiled stages.
    Gpu(Device),
}

/// Choices made so far; compiling the stages takes seconds on some drivers.
static MADE: Mutex<Vec<(Request, Software, Choice)>> = Mutex::new(Vec::new());

impl Choice {
    /// Takes what `request` asks for, by the rule of [`fuse_camera::gpu::choose`]; asked again, it is
    /// the same, unless the GPU has failed since.
    ///
    /// # Errors
    /// If a GPU is asked for and there is none, or it cannot be used.
    pub fn take(request: Request, software: Software) -> Result<Self, SplatError> {
        if request == Request::Cpu {
            return Ok(Self::Cpu);
        }
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        made.retain(|(_, _, choice)| choice.works());
        if let Some((.., choice)) = made.iter().find(|(r, s, _)| (*r, *s) == (request, software)) {
            return Ok(choice.clone());
        }
        let choice = match gpu::choose(request, software)? {
            gpu::Choice::Cpu => Self::Cpu,
            gpu::Choice::Gpu(gpu) => Self::Gpu(Device::new(gpu)?),
        };
        made.push((request, software, choice.clone()));
        Ok(choice)
    }

    fn works(&self) -> bool {
        match self {
            Self::Cpu => true,
            Self::Gpu(device) => device.gpu.check().is_ok(),
        }
    }

    /// [`crate::render()`] on it.
    ///
    /// # Errors
    /// As there, and if the GPU fails.
    pub fn render(
        &self,
        gaussians: &Gaussians,
        camera: &Camera,
        background: [f32; 3],
    ) -> Result<Rendering, SplatError> {
        match self {
            Self::Cpu => crate::render(gaussians, camera, background),
            Self::Gpu(device) => super::render(device, gaussians, camera, background),
        }
    }

    /// A [`Trainer`] on it.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn trainer(&self, gaussians: Gaussians, config: TrainerConfig) -> Result<Trainer, SplatError> {
        match self {
            Self::Cpu => Trainer::new(gaussians, config),
            Self::Gpu(device) => Trainer::with_device(device, gaussians, config),
        }
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => gpu::Choice::Cpu.fmt(f),
            Self::Gpu(device) => write!(f, "gpu ({})", device.name()),
        }
    }
}
