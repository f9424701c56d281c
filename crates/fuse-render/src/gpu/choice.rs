//! What this process renders on, by a caller's wish: opened once a wish, kept to its end.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use fuse_camera::gpu::{self, GpuError, Request, Software};
use fuse_camera::{Camera, DepthBuffer, IdBuffer};

use super::device::Device;
use super::render::{GpuRenderer, RenderError};
use crate::{Amodal, Frame, RenderOptions, Renderer, Scene};

/// What scenes are rendered on. Its `Display` says so, for logs and records.
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
    pub fn take(request: Request, software: Software) -> Result<Self, GpuError> {
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

    /// Prepares a scene on it.
    ///
    /// # Errors
    /// As [`Renderer::new`] and [`GpuRenderer::new`].
    pub fn prepare(&self, scene: Scene, options: &RenderOptions) -> Result<Backend, RenderError> {
        Ok(match self {
            Self::Cpu => Backend::Cpu(Box::new(Renderer::new(scene, options)?)),
            Self::Gpu(device) => Backend::Gpu(Box::new(GpuRenderer::new(scene, options, device)?)),
        })
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

/// A prepared scene on either backend.
pub enum Backend {
    /// On the CPU; never fails.
    Cpu(Box<Renderer>),
    /// On a GPU.
    Gpu(Box<GpuRenderer>),
}

impl Backend {
    /// Nonzero instance ids, ascending.
    pub fn ids(&self) -> &[u32] {
        match self {
            Self::Cpu(r) => r.ids(),
            Self::Gpu(r) => r.ids(),
        }
    }

    /// Colour, depth and ids.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn render(&self, camera: &Camera) -> Result<Frame, GpuError> {
        match self {
            Self::Cpu(r) => Ok(r.render(camera)),
            Self::Gpu(r) => r.render(camera),
        }
    }

    /// Depth and ids without shading; equal to those of [`Backend::render`].
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn depth_ids(&self, camera: &Camera) -> Result<(DepthBuffer, IdBuffer), GpuError> {
        match self {
            Self::Cpu(r) => Ok(r.depth_ids(camera)),
            Self::Gpu(r) => r.depth_ids(camera),
        }
    }

    /// Visible and unoccluded pixels of every nonzero id, ascending by id.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn amodal_all(&self, camera: &Camera) -> Result<Vec<Amodal>, GpuError> {
        match self {
            Self::Cpu(r) => Ok(r.amodal_all(camera)),
            Self::Gpu(r) => r.amodal_all(camera),
        }
    }
}
