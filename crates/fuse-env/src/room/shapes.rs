//! Flat shapes with texture coordinates, gathered into a model.

use fuse_render::{Material, Mesh, Model};
use glam::{Vec2, Vec3};

/// Gathers shapes by material.
#[derive(Default)]
pub struct Builder {
    model: Model,
}

impl Builder {
    /// Adds a material and an empty mesh for it; returns the index that the shapes take.
    pub fn material(&mut self, material: Material) -> usize {
        self.model.materials.push(material);
        let index = self.model.materials.len() - 1;
        self.model.meshes.push(Mesh { material: index, ..Mesh::default() });
        index
    }

    /// What was gathered, without meshes that stayed empty.
    pub fn finish(mut self) -> Model {
        self.model.meshes.retain(|m| !m.triangles.is_empty());
        self.model
    }

    fn polygon(&mut self, material: usize, points: &[Vec3], uvs: &[Vec2], normal: Vec3) {
        let mesh = &mut self.model.meshes[material];
        let first = mesh.positions.len() as u32;
        mesh.positions.extend_from_slice(points);
        mesh.uvs.extend_from_slice(uvs);
        mesh.normals.extend(std::iter::repeat_n(normal, points.len()));
        // Halves of halves: few long edges, so that most of a round plate is a handful of triangles.
        let mut arcs = vec![(first, first + points.len() as u32 - 1)];
        while let Some((a, b)) = arcs.pop() {
            if b > a + 1 {
                let middle = a.midpoint(b);
                mesh.triangles.push([a, middle, b]);
                arcs.extend([(a, middle), (middle, b)]);
            }
        }
    }

    /// A rectangle that shows the whole texture: corners counter-clockwise seen from the front,
    /// from the lower left one.
    pub fn quad(&mut self, material: usize, corners: [Vec3; 4]) {
        let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize();
        let uvs = [Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.0)];
        self.polygon(material, &corners, &uvs, normal);
    }

    /// A rectangle whose texture repeats every `repeat` metres, beginning at a place of its own.
    fn tiled_quad(&mut self, material: usize, corners: [Vec3; 4], repeat: f32) {
        let (along, up) = (corners[1] - corners[0], corners[3] - corners[0]);
        // The grain of planks runs along the longer side.
        let swap = up.length() > along.length();
        let size = Vec2::new(along.length(), up.length()) / repeat;
        let start = (corners[0] * Vec3::new(0.731, 0.417, 0.593)).element_sum() * Vec2::new(1.0, 1.7);
        let uvs = [Vec2::ZERO, Vec2::new(size.x, 0.0), size, Vec2::new(0.0, size.y)]
            .map(|p| start + if swap { Vec2::new(p.y, p.x) } else { p });
        self.polygon(material, &corners, &uvs, along.cross(up).normalize());
    }

    /// An axis-aligned box; its texture repeats every `repeat` metres.
    pub fn cuboid(&mut self, material: usize, low: Vec3, high: Vec3, repeat: f32) {
        let at = |x: f32, y: f32, z: f32| low + (high - low) * Vec3::new(x, y, z);
        for corners in [
            [at(0., 0., 0.), at(1., 0., 0.), at(1., 0., 1.), at(0., 0., 1.)],
            [at(1., 0., 0.), at(1., 1., 0.), at(1., 1., 1.), at(1., 0., 1.)],
            [at(1., 1., 0.), at(0., 1., 0.), at(0., 1., 1.), at(1., 1., 1.)],
            [at(0., 1., 0.), at(0., 0., 0.), at(0., 0., 1.), at(0., 1., 1.)],
            [at(0., 0., 1.), at(1., 0., 1.), at(1., 1., 1.), at(0., 1., 1.)],
            [at(0., 1., 0.), at(1., 1., 0.), at(1., 0., 0.), at(0., 0., 0.)],
        ] {
            self.tiled_quad(material, corners, repeat);
        }
    }

    /// A horizontal convex plate seen from above at height `z`; the texture spans `size` metres
    /// from `corner`.
    pub fn plate(&mut self, material: usize, outline: &[Vec2], z: f32, corner: Vec2, size: Vec2) {
        let points: Vec<Vec3> = outline.iter().map(|p| p.extend(z)).collect();
        let uvs: Vec<Vec2> = outline.iter().map(|p| (*p - corner) / size).collect();
        self.polygon(material, &points, &uvs, Vec3::Z);
    }

    /// The outer faces between heights `low` and `high` along a counter-clockwise outline.
    pub fn skirt(&mut self, material: usize, outline: &[Vec2], low: f32, high: f32) {
        for (i, a) in outline.iter().enumerate() {
            let b = outline[(i + 1) % outline.len()];
            self.tiled_quad(material, [a.extend(low), b.extend(low), b.extend(high), a.extend(high)], 0.8);
        }
    }
}
