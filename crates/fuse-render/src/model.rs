//! Textured triangle models, as they come from glTF and OBJ files or from a generator.
//!
//! Models are kept in the world's axes: z up, metres. glTF files are y up; loading and writing
//! convert.

use std::sync::Arc;

use glam::{Vec2, Vec3};

/// An 8-bit sRGB image with alpha, row-major, first row at the top (`v = 0`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// `width * height` texels, sRGB colour and linear alpha.
    pub texels: Vec<[u8; 4]>,
}

/// Metal-rough material (glTF 2.0's `pbrMetallicRoughness`).
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name for people.
    pub name: String,
    /// Linear base colour factor, multiplied with the texture.
    pub base_color: [f32; 4],
    /// Base colour texture, repeated outside [0, 1].
    pub base_color_texture: Option<Arc<Texture>>,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness in [0, 1].
    pub roughness: f32,
    /// Whether back faces are drawn.
    pub double_sided: bool,
}

/// Triangles of one material. Counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres, z up.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, as many as positions.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, as many as positions; `v` grows downwards as in glTF.
    pub uvs: Vec<Vec2>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Index into the model's materials.
    pub material: usize,
}

/// A thing that can be placed in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Parts.
    pub meshes: Vec<Mesh>,
    /// Materials of the parts.
    pub materials: Vec<Material>,
}

/// Why a model file was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file could not be read.
    #[error("cannot read {path}: {source}")]
    Io {
        /// File name.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a sound model.
    #[error("{path} is not a usable model: {reason}")]
    Invalid {
        /// File name.
        path: String,
        /// What was found and what was expected.
        reason: String,
    },
}

impl Model {
    /// Axis-aligned bounds `(low, high)` in metres; `None` for a model without vertices.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut points = self.meshes.iter().flat_map(|m| m.positions.iter().copied());
        let first = points.next()?;
        Some(points.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p))))
    }
}
