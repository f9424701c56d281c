//! An open GPU with the compiled stages.

use std::sync::Arc;

use fuse_camera::gpu::{Gpu, GpuError, Software};

use super::shaders::{self, Stage};

/// Format of the images of keys.
pub(super) const KEYS: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of the depth buffer.
pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A GPU that renders scenes. Clones share it.
#[derive(Clone, Debug)]
pub struct Device {
    pub(super) gpu: Gpu,
    pub(super) pipelines: Arc<Pipelines>,
}

impl Device {
    /// Compiles the stages for an open GPU.
    ///
    /// # Errors
    /// If its driver refuses them.
    pub fn new(gpu: Gpu) -> Result<Self, GpuError> {
        let pipelines = Arc::new(Pipelines::new(&gpu));
        gpu.check()?;
        Ok(Self { gpu, pipelines })
    }

    /// Opens the best GPU, see [`Gpu::open`].
    ///
    /// # Errors
    /// If there is none, or it cannot be used.
    pub fn open(software: Software) -> Result<Self, GpuError> {
        Self::new(Gpu::open(software)?)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        self.gpu.name()
    }
}

/// The compiled stages.
#[derive(Debug)]
pub(super) struct Pipelines {
    /// For triangles that show their front only, and for those that show both sides; they share
    /// their bind group.
    pub raster: [wgpu::RenderPipeline; 2],
    pub raster_layout: wgpu::BindGroupLayout,
    pub centers: wgpu::ComputePipeline,
    pub pixels: wgpu::ComputePipeline,
    pub count: wgpu::ComputePipeline,
}

impl Pipelines {
    fn new(gpu: &Gpu) -> Self {
        let module = |stage: &Stage| {
            gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(stage.name),
                source: wgpu::ShaderSource::Wgsl(stage.source().into()),
            })
        };
        let compute = |stage: &Stage, entry: &'static str| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: None,
                module: &module(stage),
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        let raster = module(&shaders::RASTER);
        let raster_layout = raster_layout(gpu);
        Self {
            raster: [Some(wgpu::Face::Back), None].map(|cull| draw(gpu, &raster, &raster_layout, cull)),
            raster_layout,
            centers: compute(&shaders::RESOLVE_CENTERS, "centers"),
            pixels: compute(&shaders::RESOLVE_PIXELS, "pixels"),
            count: compute(&shaders::COUNT, "count"),
        }
    }
}

fn raster_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let buffer = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let storage = wgpu::BufferBindingType::Storage { read_only: true };
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("raster"),
        entries: &[buffer(0, wgpu::BufferBindingType::Uniform), buffer(1, storage), buffer(2, storage)],
    })
}

fn draw(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    layout: &wgpu::BindGroupLayout,
    cull_mode: Option<wgpu::Face>,
) -> wgpu::RenderPipeline {
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("raster"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("raster"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("transform"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState { cull_mode, ..wgpu::PrimitiveState::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("raster"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(KEYS.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
