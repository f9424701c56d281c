//! A prepared scene on the GPU: what the CPU's renderer made of it, in the shaders' form.

use std::collections::HashMap;
use std::iter::once;
use std::ops::Range;
use std::sync::Arc;

use fuse_camera::gpu::{Gpu, GpuError};
use glam::{UVec3, Vec3A};

use super::memory::{filled, uniform};
use super::shaders::SHADOW_MAPS;
use crate::Renderer;
use crate::cpu::geometry::Geometry;
use crate::cpu::occlusion::Occlusion;
use crate::cpu::shade::Lamp;
use crate::cpu::shadow::{self, Shadow};
use crate::cpu::texture::MipChain;

/// The buffers of a scene.
pub(super) struct Buffers {
    pub vertices: wgpu::Buffer,
    pub triangles: wgpu::Buffer,
    pub parts: wgpu::Buffer,
    pub texels: wgpu::Buffer,
    pub levels: wgpu::Buffer,
    pub extremes: wgpu::Buffer,
    pub soft_boxes: wgpu::Buffer,
    pub light: wgpu::Buffer,
    pub cells: wgpu::TextureView,
}

/// Consecutive triangles of one id that are culled alike.
pub(super) struct Run {
    pub vertices: Range<u32>,
    pub double_sided: bool,
    pub id: u32,
}

/// `Vertex` of common.wgsl.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Vertex {
    position: [f32; 3],
    u: f32,
    normal: [f32; 3],
    v: f32,
}

/// `Part` of common.wgsl.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Part {
    base: [f32; 3],
    id: u32,
    metallic: f32,
    roughness: f32,
    first_level: u32,
    level_count: u32,
}

/// `SoftBox` of light.wgsl.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct SoftBox {
    direction: [f32; 3],
    sharpness: f32,
    color: [f32; 4],
}

/// `Map` of light.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
struct Map {
    center: [f32; 2],
    focal: f32,
    radius: f32,
    first_level: u32,
    level_count: u32,
    layers: [u32; 2],
    layer_side: u32,
    layer_scale: f32,
    layer_nearest: f32,
    pad: u32,
}

/// `Light` of light.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
struct Light {
    position: [f32; 3],
    radius: f32,
    intensity: [f32; 3],
    exposure: f32,
    sky: [f32; 3],
    box_count: u32,
    ground: [f32; 3],
    map_count: u32,
    background: [f32; 3],
    occlusion: u32,
    low: [f32; 3],
    cell: f32,
    high: [f32; 4],
    size: [u32; 4],
    maps: [Map; SHADOW_MAPS],
}

/// Levels of mip chains and shadow maps; see `levels` in texture.wgsl.
#[derive(Default)]
struct Levels {
    rows: Vec<[u32; 4]>,
    /// Words so far, of textures with the shadow's layers, and of shadow extremes.
    texels: u64,
    extremes: u64,
}

impl Levels {
    /// Adds a texture; first row and count.
    fn texture(&mut self, chain: &MipChain) -> (u32, u32) {
        let first = self.rows.len();
        for level in chain.levels() {
            // More than 2³² words are refused with the buffer that should hold them.
            self.rows.push([self.texels as u32, level.width, level.height, level.across]);
            self.texels += level.texels.len() as u64;
        }
        (first as u32, (self.rows.len() - first) as u32)
    }

    /// Adds a shadow map.
    fn shadow(&mut self, map: &shadow::Map) -> Map {
        let first = self.rows.len();
        for level in &map.levels {
            let (side, length) = (level.side as u32, level.near.len() as u64);
            self.rows.push([self.extremes as u32, side, side, (self.extremes + length) as u32]);
            self.extremes += 2 * length;
        }
        let layers = [0, 1].map(|k| {
            let first = self.texels as u32;
            self.texels += map.baked.layers[k].len() as u64;
            first
        });
        Map {
            center: map.center.to_array(),
            focal: map.focal,
            radius: map.radius,
            first_level: first as u32,
            level_count: (self.rows.len() - first) as u32,
            layers,
            layer_side: map.baked.side as u32,
            layer_scale: map.baked.scale,
            layer_nearest: map.baked.nearest,
            pad: 0,
        }
    }
}

impl Buffers {
    pub fn new(gpu: &Gpu, scene: &Renderer) -> Result<Self, GpuError> {
        let (geometry, shading) = (&scene.geometry, &scene.shading);
        let mut levels = Levels::default();
        let mut chains: Vec<Arc<MipChain>> = Vec::new();
        let parts = parts(geometry, &mut levels, &mut chains);
        let maps = shading.shadow.as_ref().map_or(&[][..], |s| &s.maps);
        let light =
            light(&shading.light, scene.background, shading.shadow.as_ref(), shading.occlusion.as_ref(), &mut levels);
        let layers = maps.iter().flat_map(|m| m.baked.layers.iter().map(|l| &l[..]));
        let texels = chains.iter().flat_map(|c| c.levels().iter().map(|l| &l.texels[..])).chain(layers);
        let extremes = maps.iter().flat_map(|m| m.levels.iter().flat_map(|l| [&l.near[..], &l.far[..]]));
        let vertices: Vec<Vertex> = (geometry.vertices.iter())
            .map(|v| Vertex { position: v.position.to_array(), u: v.uv.x, normal: v.normal.to_array(), v: v.uv.y })
            .collect();
        let corners = geometry.triangles.iter().zip(&geometry.triangle_part);
        let triangles: Vec<[u32; 4]> = corners.map(|(&[a, b, c], &part)| [a, b, c, part]).collect();
        let soft_boxes: Vec<SoftBox> = (shading.light.soft_boxes.iter())
            .map(|b| SoftBox {
                direction: b.direction.to_array(),
                sharpness: b.sharpness,
                color: b.color.extend(0.0).to_array(),
            })
            .collect();
        Ok(Self {
            vertices: filled(gpu, "the scene's vertices", once(&vertices[..]))?,
            triangles: filled(gpu, "the scene's triangles", once(&triangles[..]))?,
            parts: filled(gpu, "the scene's materials", once(&parts[..]))?,
            texels: filled(gpu, "the scene's textures and shadow layers", texels)?,
            levels: filled(gpu, "levels of textures and shadow maps", once(&levels.rows[..]))?,
            extremes: filled(gpu, "the scene's shadow maps", extremes)?,
            soft_boxes: filled(gpu, "the scene's soft boxes", once(&soft_boxes[..]))?,
            light: uniform(gpu, "light", &light),
            cells: cells(gpu, shading.occlusion.as_ref()),
        })
    }
}

/// The triangles in their order, as few draws as can be.
pub(super) fn runs(geometry: &Geometry) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (triangle, &part) in geometry.triangle_part.iter().enumerate() {
        let part = &geometry.parts[part as usize];
        let end = 3 * (triangle as u32 + 1);
        match runs.last_mut() {
            Some(run) if run.double_sided == part.double_sided && run.id == part.id => run.vertices.end = end,
            _ => runs.push(Run { vertices: end - 3..end, double_sided: part.double_sided, id: part.id }),
        }
    }
    runs
}

/// Parts with their surfaces; each texture once.
fn parts(geometry: &Geometry, levels: &mut Levels, chains: &mut Vec<Arc<MipChain>>) -> Vec<Part> {
    let mut known: HashMap<*const MipChain, (u32, u32)> = HashMap::new();
    let mut texture = |chain: &Arc<MipChain>| {
        *known.entry(Arc::as_ptr(chain)).or_insert_with(|| {
            chains.push(chain.clone());
            levels.texture(chain)
        })
    };
    let part = |part: &crate::cpu::geometry::Part| {
        let surface = &geometry.surfaces[part.surface as usize];
        let (first_level, level_count) = surface.texture.as_ref().map_or((0, 0), &mut texture);
        let (metallic, roughness) = (surface.metallic, surface.roughness);
        Part { base: surface.base.to_array(), id: part.id, metallic, roughness, first_level, level_count }
    };
    geometry.parts.iter().map(part).collect()
}

fn light(
    lamp: &Lamp,
    background: Vec3A,
    shadow: Option<&Shadow>,
    occlusion: Option<&Occlusion>,
    levels: &mut Levels,
) -> Light {
    let mut light = Light {
        position: lamp.position.to_array(),
        radius: lamp.radius,
        intensity: lamp.intensity.to_array(),
        exposure: lamp.exposure,
        sky: lamp.sky.to_array(),
        box_count: lamp.soft_boxes.len() as u32,
        ground: lamp.ground.to_array(),
        background: background.to_array(),
        ..Light::default()
    };
    for (slot, map) in light.maps.iter_mut().zip(shadow.map_or(&[][..], |s| &s.maps)) {
        *slot = levels.shadow(map);
        light.map_count += 1;
    }
    if let Some(grid) = occlusion {
        light.occlusion = 1;
        (light.low, light.cell) = (grid.low.to_array(), grid.cell);
        light.high = grid.high.extend(0.0).to_array();
        light.size = grid.size.extend(0).to_array();
    }
    light
}

/// The grid of ambient occlusion as a texture of one byte a channel.
fn cells(gpu: &Gpu, occlusion: Option<&Occlusion>) -> wgpu::TextureView {
    let size = occlusion.map_or(UVec3::ONE, |o| o.size + UVec3::X * 2);
    let extent = wgpu::Extent3d { width: size.x, height: size.y, depth_or_array_layers: size.z };
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("ambient occlusion"),
        size: extent,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D3,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    if let Some(grid) = occlusion {
        let rows =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * size.x), rows_per_image: Some(size.y) };
        gpu.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(&grid.cells), rows, extent);
    }
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}
