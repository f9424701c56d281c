//! A scene on the GPU, seen from any camera: the order of the stages.

use std::sync::{Mutex, PoisonError};

use fuse_camera::gpu::{Gpu, GpuError};
use fuse_camera::{Buffer, Camera, DepthBuffer, IdBuffer};
use wgpu::BindingResource;

use super::device::{DEPTH, Device, KEYS};
use super::memory::{landing, read, storage, uniform};
use super::upload::{Buffers, Run, runs};
use super::view::View;
use crate::cpu::raster::LANES;
use crate::{Amodal, Frame, RenderOptions, Renderer, Scene, SceneError};

/// Why a scene cannot be rendered on a GPU.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A scene, ready to be seen from any camera; the twin of [`Renderer`].
///
/// The same adapter gives the same bits again; against the CPU some pixels of an edge fall on its
/// other side, and colours round differently.
pub struct GpuRenderer {
    device: Device,
    buffers: Buffers,
    runs: Vec<Run>,
    near: f32,
    ids: Vec<u32>,
    targets: Mutex<Option<Targets>>,
}

/// Images of one size, kept from frame to frame.
struct Targets {
    width: u32,
    height: u32,
    /// One for each sample.
    layers: Vec<wgpu::TextureView>,
    all: wgpu::TextureView,
    depth: wgpu::TextureView,
    /// Planes of colour, depth and id.
    image: wgpu::Buffer,
    landing: wgpu::Buffer,
    total: wgpu::Buffer,
}

impl GpuRenderer {
    /// Prepares a scene, as [`Renderer::new`] does, and hands it to the GPU.
    ///
    /// # Errors
    /// As there, and if the GPU cannot hold the scene.
    pub fn new(scene: Scene, options: &RenderOptions, device: &Device) -> Result<Self, RenderError> {
        let prepared = Renderer::new(scene, options)?;
        let buffers = Buffers::new(&device.gpu, &prepared)?;
        device.gpu.check()?;
        Ok(Self {
            device: device.clone(),
            buffers,
            runs: runs(&prepared.geometry),
            near: prepared.near,
            ids: prepared.ids,
            targets: Mutex::default(),
        })
    }

    /// Nonzero instance ids, ascending.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Colour, depth and ids.
    ///
    /// # Errors
    /// If the image is larger than the GPU allows, or it fails.
    pub fn render(&self, camera: &Camera) -> Result<Frame, GpuError> {
        self.with_targets(camera, |targets, view| {
            let mut encoder = self.encoder();
            for (sample, layer) in targets.layers.iter().enumerate() {
                self.raster(&mut encoder, targets, layer, view, sample as u32, None);
            }
            let b = &self.buffers;
            let bindings = [
                (0, view.as_entire_binding()),
                (1, b.vertices.as_entire_binding()),
                (2, b.triangles.as_entire_binding()),
                (3, b.parts.as_entire_binding()),
                (4, b.texels.as_entire_binding()),
                (5, b.levels.as_entire_binding()),
                (6, b.extremes.as_entire_binding()),
                (7, b.soft_boxes.as_entire_binding()),
                (8, targets.image.as_entire_binding()),
                (9, BindingResource::TextureView(&targets.all)),
                (10, BindingResource::TextureView(&b.cells)),
                (11, b.light.as_entire_binding()),
            ];
            self.compute(&mut encoder, &self.device.pipelines.pixels, &bindings, targets);
            let size = targets.pixels() * 4;
            read(&self.device.gpu, encoder, (&targets.image, 0, 3 * size), &targets.landing, |words| {
                let (rgb, rest) = words.split_at(words.len() / 3);
                let (depth, ids) = centers(targets, rest)?;
                let bytes = rgb.iter().map(|c| [*c as u8, (c >> 8) as u8, (c >> 16) as u8]).collect();
                Ok(Frame { rgb: targets.buffer(bytes)?, depth, instance: ids })
            })?
        })
    }

    /// Depth and ids without shading; equal to those of [`GpuRenderer::render`].
    ///
    /// # Errors
    /// As there.
    pub fn depth_ids(&self, camera: &Camera) -> Result<(DepthBuffer, IdBuffer), GpuError> {
        self.with_targets(camera, |targets, view| {
            let mut encoder = self.encoder();
            self.raster(&mut encoder, targets, &targets.layers[0], view, 0, None);
            let b = &self.buffers;
            let bindings = [
                (0, view.as_entire_binding()),
                (1, b.vertices.as_entire_binding()),
                (2, b.triangles.as_entire_binding()),
                (3, b.parts.as_entire_binding()),
                (8, targets.image.as_entire_binding()),
                (9, BindingResource::TextureView(&targets.all)),
            ];
            self.compute(&mut encoder, &self.device.pipelines.centers, &bindings, targets);
            let size = targets.pixels() * 4;
            let from = (&targets.image, size, 2 * size);
            read(&self.device.gpu, encoder, from, &targets.landing, |words| centers(targets, words))?
        })
    }

    /// Visible and unoccluded pixels of every nonzero id, ascending by id.
    ///
    /// # Errors
    /// As [`GpuRenderer::render`].
    pub fn amodal_all(&self, camera: &Camera) -> Result<Vec<Amodal>, GpuError> {
        let (_, visible) = self.depth_ids(camera)?;
        let mut counts: Vec<Amodal> = self.ids.iter().map(|&id| Amodal { id, ..Amodal::default() }).collect();
        for id in visible.as_slice() {
            if let Ok(k) = self.ids.binary_search(id) {
                counts[k].visible_px += 1;
            }
        }
        self.with_targets(camera, |targets, view| {
            for count in &mut counts {
                let mut encoder = self.encoder();
                self.raster(&mut encoder, targets, &targets.layers[0], view, 0, Some(count.id));
                encoder.clear_buffer(&targets.total, 0, None);
                let bindings =
                    [(9, BindingResource::TextureView(&targets.all)), (12, targets.total.as_entire_binding())];
                self.compute(&mut encoder, &self.device.pipelines.count, &bindings, targets);
                let from = (&targets.total, 0, 4);
                count.unoccluded_px =
                    read(&self.device.gpu, encoder, from, &targets.landing, |w| w.first().copied().unwrap_or(0))?;
            }
            Ok(counts)
        })
    }

    /// Runs `work` with images of the camera's size and its view.
    fn with_targets<R>(
        &self,
        camera: &Camera,
        work: impl FnOnce(&Targets, &wgpu::Buffer) -> Result<R, GpuError>,
    ) -> Result<R, GpuError> {
        let gpu = &self.device.gpu;
        let mut slot = self.targets.lock().unwrap_or_else(PoisonError::into_inner);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let targets = match slot.take() {
            Some(targets) if (targets.width, targets.height) == (width, height) => targets,
            _ => Targets::new(gpu, width, height)?,
        };
        let view = uniform(gpu, "view", &View::new(camera, self.near));
        // Images that an error left mapped are not kept.
        let result = work(&targets, &view)?;
        *slot = Some(targets);
        Ok(result)
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Draws the triangles of `only`, or all, at one sample into one layer.
    fn raster(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        layer: &wgpu::TextureView,
        view: &wgpu::Buffer,
        sample: u32,
        only: Option<u32>,
    ) {
        let pipelines = &self.device.pipelines;
        let group = self.group(
            &pipelines.raster_layout,
            &[
                (0, view.as_entire_binding()),
                (1, self.buffers.vertices.as_entire_binding()),
                (2, self.buffers.triangles.as_entire_binding()),
            ],
        );
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("raster"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: layer,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &targets.depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_bind_group(0, &group, &[]);
        for run in self.runs.iter().filter(|run| only.is_none_or(|id| id == run.id)) {
            pass.set_pipeline(&pipelines.raster[usize::from(run.double_sided)]);
            pass.draw(run.vertices.clone(), sample..sample + 1);
        }
    }

    /// One thread a pixel.
    fn compute(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        bindings: &[(u32, BindingResource<'_>)],
        targets: &Targets,
    ) {
        let group = self.group(&pipeline.get_bind_group_layout(0), bindings);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(targets.width.div_ceil(8), targets.height.div_ceil(8), 1);
    }

    fn group(&self, layout: &wgpu::BindGroupLayout, bindings: &[(u32, BindingResource<'_>)]) -> wgpu::BindGroup {
        let entries: Vec<_> = bindings
            .iter()
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding: *binding, resource: resource.clone() })
            .collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout, entries: &entries };
        self.device.gpu.device.create_bind_group(&descriptor)
    }
}

/// Depth and ids from their planes.
fn centers(targets: &Targets, words: &[u32]) -> Result<(DepthBuffer, IdBuffer), GpuError> {
    let (depth, ids) = words.split_at(words.len() / 2);
    Ok((targets.buffer(bytemuck::cast_slice(depth).to_vec())?, targets.buffer(ids.to_vec())?))
}

impl Targets {
    fn new(gpu: &Gpu, width: u32, height: u32) -> Result<Self, GpuError> {
        let allowed = gpu.device.limits().max_texture_dimension_2d;
        if width.max(height) > allowed {
            return Err(GpuError::ImageSize { width, height, allowed });
        }
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: LANES as u32 };
        let descriptor = wgpu::TextureDescriptor {
            label: Some("keys"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: KEYS,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        };
        let keys = gpu.device.create_texture(&descriptor);
        let depth = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("depth"),
            size: wgpu::Extent3d { depth_or_array_layers: 1, ..size },
            format: DEPTH,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            ..descriptor
        });
        let layer = |i: usize| {
            keys.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: i as u32,
                array_layer_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            })
        };
        let bytes = 12 * u64::from(width) * u64::from(height);
        Ok(Self {
            width,
            height,
            layers: (0..LANES).map(layer).collect(),
            all: keys.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..wgpu::TextureViewDescriptor::default()
            }),
            depth: depth.create_view(&wgpu::TextureViewDescriptor::default()),
            image: storage(gpu, "the image", bytes)?,
            landing: landing(gpu, bytes),
            total: storage(gpu, "a count", 4)?,
        })
    }

    fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    fn buffer<T>(&self, data: Vec<T>) -> Result<Buffer<T>, GpuError> {
        Buffer::from_vec(self.width, self.height, data).map_err(|e| GpuError::Failed(e.to_string()))
    }
}
