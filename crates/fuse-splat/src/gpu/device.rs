//! An open GPU with the compiled stages.

use std::sync::Arc;

use fuse_camera::gpu::{Gpu, Software};
use wgpu::ComputePipeline;

use super::shaders::{self, Stage};
use crate::SplatError;

/// A GPU that draws and trains Gaussians. Clones share it.
#[derive(Clone, Debug)]
pub struct Device {
    pub(crate) gpu: Gpu,
    pub(crate) kernels: Arc<Kernels>,
    pub(crate) timed: bool,
}

impl Device {
    /// Compiles the stages for an open GPU.
    ///
    /// # Errors
    /// If its driver refuses them.
    pub fn new(gpu: Gpu) -> Result<Self, SplatError> {
        let kernels = Arc::new(Kernels::new(&gpu));
        gpu.check()?;
        Ok(Self { gpu, kernels, timed: false })
    }

    /// Opens the best GPU, see [`Gpu::open`].
    ///
    /// # Errors
    /// If there is none, or it cannot be used.
    pub fn open(software: Software) -> Result<Self, SplatError> {
        Self::new(Gpu::open(software)?)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        self.gpu.name()
    }

    /// Waits for every stage, so that [`crate::StageSeconds`] can tell them apart. Slower: without
    /// this, stages follow one another without the CPU, and no times are taken.
    pub fn timed(mut self) -> Self {
        self.timed = true;
        self
    }
}

/// The compiled entry points.
#[derive(Debug)]
pub(crate) struct Kernels {
    pub project: ComputePipeline,
    pub scan: ComputePipeline,
    pub depth_keys: ComputePipeline,
    pub sort_count: ComputePipeline,
    pub sort_scatter: ComputePipeline,
    pub intersect_count: ComputePipeline,
    pub intersect_emit: ComputePipeline,
    pub intersect_ranges: ComputePipeline,
    pub rasterize: ComputePipeline,
    pub loss_slopes: ComputePipeline,
    pub loss_gradient: ComputePipeline,
    pub loss_total: ComputePipeline,
    pub rasterize_backward: ComputePipeline,
    pub project_backward: ComputePipeline,
    pub adam: ComputePipeline,
}

impl Kernels {
    fn new(gpu: &Gpu) -> Self {
        let module = |stage: &Stage| {
            gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(stage.name),
                source: wgpu::ShaderSource::Wgsl(stage.source().into()),
            })
        };
        let pipeline = |module: &wgpu::ShaderModule, entry: &'static str| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: None,
                module,
                entry_point: Some(entry),
                // The stages write what they read; zeroing 12 KiB first would cost every tile.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            })
        };
        let single = |stage: &Stage| pipeline(&module(stage), stage.name);
        let (sort, intersect, loss) = (module(&shaders::SORT), module(&shaders::INTERSECT), module(&shaders::LOSS));
        Self {
            project: single(&shaders::PROJECT),
            scan: single(&shaders::SCAN),
            depth_keys: pipeline(&sort, "depth_keys"),
            sort_count: pipeline(&sort, "count"),
            sort_scatter: pipeline(&sort, "scatter"),
            intersect_count: pipeline(&intersect, "count"),
            intersect_emit: pipeline(&intersect, "emit"),
            intersect_ranges: pipeline(&intersect, "ranges"),
            rasterize: single(&shaders::RASTERIZE),
            loss_slopes: pipeline(&loss, "slopes"),
            loss_gradient: pipeline(&loss, "gradient"),
            loss_total: pipeline(&loss, "total"),
            rasterize_backward: single(&shaders::RASTERIZE_BACKWARD),
            project_backward: single(&shaders::PROJECT_BACKWARD),
            adam: single(&shaders::ADAM),
        }
    }
}
