//! The scene flattened to one list of world-space triangles.

use glam::{Mat3, Vec2, Vec3, Vec3A};

use super::texture::{MipCache, MipChain};
use crate::{Scene, SceneError};

/// Most triangles of a scene.
const MAX_TRIANGLES: usize = 1 << 26;

/// A run of triangles with one id and one surface.
pub(crate) struct Part {
    pub id: u32,
    pub surface: u32,
    pub double_sided: bool,
}

/// A material ready for shading.
pub(crate) struct Surface {
    /// Linear factor on the texture.
    pub base: Vec3A,
    pub texture: Option<std::sync::Arc<MipChain>>,
    pub metallic: f32,
    pub roughness: f32,
}

/// A vertex, all in one place: half a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(crate) struct Vertex {
    pub position: Vec3,
    /// Unit.
    pub normal: Vec3,
    pub uv: Vec2,
}

impl Vertex {
    /// Position, normal, texture coordinates.
    #[inline(always)]
    pub fn row(&self) -> [f32; 8] {
        let Self { position: p, normal: n, uv } = self;
        [p.x, p.y, p.z, n.x, n.y, n.z, uv.x, uv.y]
    }
}

/// World-space triangles; vertex arrays are parallel, triangle arrays are parallel.
pub(crate) struct Geometry {
    pub positions: Vec<Vec3>,
    /// The same with what is interpolated along.
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
    pub triangle_part: Vec<u32>,
    /// Unit normals of the triangles, counter-clockwise side.
    pub facets: Vec<Vec3A>,
    pub parts: Vec<Part>,
    pub surfaces: Vec<Surface>,
}

impl Geometry {
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let triangles: usize = scene.instances.iter().map(|i| i.model.triangle_count()).sum();
        let vertices: usize = scene.instances.iter().flat_map(|i| &i.model.meshes).map(|m| m.positions.len()).sum();
        if triangles > MAX_TRIANGLES || vertices > MAX_TRIANGLES {
            return Err(SceneError::TooLarge { triangles: triangles.max(vertices), limit: MAX_TRIANGLES });
        }
        let mut geometry = Self {
            positions: Vec::with_capacity(vertices),
            vertices: Vec::with_capacity(vertices),
            triangles: Vec::with_capacity(triangles),
            triangle_part: Vec::with_capacity(triangles),
            facets: Vec::with_capacity(triangles),
            parts: Vec::new(),
            surfaces: Vec::new(),
        };
        let mut mips = MipCache::default();
        for (index, instance) in scene.instances.iter().enumerate() {
            geometry.append(instance, &mut mips).map_err(|reason| SceneError::Model {
                index,
                id: instance.id,
                reason,
            })?;
        }
        Ok(geometry)
    }

    fn append(&mut self, instance: &crate::Instance, mips: &mut MipCache) -> Result<(), String> {
        let (model, transform) = (&instance.model, &instance.transform);
        model.check()?;
        let matrix = Mat3::from(transform.matrix3);
        let det = matrix.determinant();
        if !transform.is_finite() || !det.is_finite() || det == 0.0 {
            return Err(format!("its transform is not finite and invertible: {transform:?}"));
        }
        let normal_matrix = matrix.inverse().transpose();
        let first_surface = self.surfaces.len();
        for material in &model.materials {
            let [r, g, b, _] = material.base_color;
            self.surfaces.push(Surface {
                base: Vec3A::new(r, g, b),
                texture: material.base_color_texture.as_ref().map(|t| mips.get(t)),
                metallic: material.metallic.clamp(0.0, 1.0),
                roughness: material.roughness.clamp(0.045, 1.0),
            });
        }
        for mesh in &model.meshes {
            let first = self.positions.len() as u32;
            let part = self.parts.len() as u32;
            self.parts.push(Part {
                id: instance.id,
                surface: (first_surface + mesh.material) as u32,
                double_sided: model.materials[mesh.material].double_sided,
            });
            self.positions.extend(mesh.positions.iter().map(|&p| transform.transform_point3(p)));
            let others = mesh.normals.iter().zip(&mesh.uvs);
            self.vertices.extend(self.positions[first as usize..].iter().zip(others).map(|(&position, (&n, &uv))| {
                Vertex { position, normal: (normal_matrix * n).normalize_or(Vec3::Z), uv }
            }));
            // A mirroring transform turns triangles inside out.
            let order = if det > 0.0 { [0, 1, 2] } else { [0, 2, 1] };
            self.triangles.extend(mesh.triangles.iter().map(|t| order.map(|k| first + t[k])));
            self.triangle_part.extend(std::iter::repeat_n(part, mesh.triangles.len()));
            let placed = &self.triangles[self.facets.len()..];
            self.facets.extend(placed.iter().map(|t| {
                let [a, b, c] = t.map(|v| Vec3A::from(self.positions[v as usize]));
                (b - a).cross(c - a).normalize_or(Vec3A::Z)
            }));
        }
        Ok(())
    }

    /// Bounds of the vertices of parts that `keep` accepts.
    pub fn bounds(&self, keep: impl Fn(&Part) -> bool) -> Option<(Vec3, Vec3)> {
        let mut bounds: Option<(Vec3, Vec3)> = None;
        for (triangle, &part) in self.triangles.iter().zip(&self.triangle_part) {
            if keep(&self.parts[part as usize]) {
                for &v in triangle {
                    let p = self.positions[v as usize];
                    bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
                }
            }
        }
        bounds
    }
}
