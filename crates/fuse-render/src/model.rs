//! Textured triangle models, as they come from glTF and OBJ files or from a generator.
//!
//! Models are kept in the world's axes: z up, metres. glTF files are y up; loading and writing
//! convert.

use std::io::Read as _;
use std::path::Path;
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

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.meshes.iter().map(|m| m.triangles.len()).sum()
    }

    /// Checks that lengths agree, indices are in range and numbers are finite.
    ///
    /// # Errors
    /// What was found and what was expected, in words.
    pub fn check(&self) -> Result<(), String> {
        for (i, material) in self.materials.iter().enumerate() {
            let numbers = material.base_color.iter().chain([&material.metallic, &material.roughness]);
            if !numbers.into_iter().all(|v| v.is_finite()) {
                return Err(format!("material {i} ({}) has a number that is not finite", material.name));
            }
            if let Some(t) = &material.base_color_texture {
                let expected = t.width as usize * t.height as usize;
                if expected == 0 || t.texels.len() != expected {
                    return Err(format!(
                        "the texture of material {i} ({}) is {}x{} but holds {} texels",
                        material.name,
                        t.width,
                        t.height,
                        t.texels.len()
                    ));
                }
            }
        }
        self.meshes.iter().enumerate().try_for_each(|(i, mesh)| self.check_mesh(i, mesh))
    }

    fn check_mesh(&self, i: usize, mesh: &Mesh) -> Result<(), String> {
        let n = mesh.positions.len();
        if mesh.normals.len() != n || mesh.uvs.len() != n {
            return Err(format!(
                "mesh {i} has {n} positions, {} normals, {} texture coordinates; expected as many of each",
                mesh.normals.len(),
                mesh.uvs.len()
            ));
        }
        if mesh.material >= self.materials.len() {
            return Err(format!("mesh {i} uses material {}, but there are {}", mesh.material, self.materials.len()));
        }
        if let Some(t) = mesh.triangles.iter().find(|t| t.iter().any(|&v| v as usize >= n)) {
            return Err(format!("mesh {i} has a triangle {t:?}, but only {n} vertices"));
        }
        if let Some(v) = mesh.positions.iter().position(|p| !p.is_finite()) {
            return Err(format!("mesh {i}, vertex {v}: position {} is not finite", mesh.positions[v]));
        }
        if let Some(v) = mesh.normals.iter().position(|p| !p.is_finite()) {
            return Err(format!("mesh {i}, vertex {v}: normal {} is not finite", mesh.normals[v]));
        }
        if let Some(v) = mesh.uvs.iter().position(|p| !p.is_finite()) {
            return Err(format!("mesh {i}, vertex {v}: texture coordinate {} is not finite", mesh.uvs[v]));
        }
        Ok(())
    }
}

/// Bytes of a file up to which it is read.
const LARGEST_FILE: u64 = 1 << 30;

/// A file's bytes, unless they are too many for a model or it is no file.
pub(crate) fn read_bounded(path: &Path) -> std::io::Result<Vec<u8>> {
    let refuse = |text: String| Err(std::io::Error::other(text));
    let file = std::fs::File::open(path)?;
    let kind = file.metadata()?;
    if !kind.is_file() {
        return refuse("it is not a file".into());
    }
    if kind.len() > LARGEST_FILE {
        return refuse(format!("it has {} bytes, expected at most {LARGEST_FILE}", kind.len()));
    }
    let mut bytes = Vec::with_capacity(kind.len() as usize);
    file.take(LARGEST_FILE).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// How many more vertices and corners of triangles a file may have: parts may share data, so that a
/// small file can ask for many.
pub(crate) struct Budget {
    vertices: usize,
    corners: usize,
}

/// Vertices of a model file, at most.
pub(crate) const MOST_VERTICES: usize = 10_000_000;
/// Corners of its triangles.
pub(crate) const MOST_CORNERS: usize = 6 * MOST_VERTICES;

impl Default for Budget {
    fn default() -> Self {
        Self { vertices: MOST_VERTICES, corners: MOST_CORNERS }
    }
}

impl Budget {
    /// Asks for space before it is allocated.
    pub(crate) fn take(&mut self, vertices: usize, corners: usize) -> Result<(), String> {
        let less = |have: &mut usize, wanted: usize, most: usize, what: &str| {
            *have = have
                .checked_sub(wanted)
                .ok_or_else(|| format!("it has more than {most} {what}, expected a model of a thing on a table"))?;
            Ok::<(), String>(())
        };
        less(&mut self.vertices, vertices, MOST_VERTICES, "vertices")?;
        less(&mut self.corners, corners, MOST_CORNERS, "corners of triangles")
    }
}

impl Default for Material {
    /// glTF's default: white, but rough and dielectric.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_color_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            double_sided: false,
        }
    }
}

/// Longest side of a texture file, texels.
pub(crate) const MAX_TEXTURE_SIDE: u32 = 8192;

/// Decodes PNG or JPEG bytes.
pub(crate) fn decode_texture(bytes: &[u8]) -> Result<Texture, String> {
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| format!("cannot be read: {e}"))?;
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_TEXTURE_SIDE), Some(MAX_TEXTURE_SIDE));
    reader.limits(limits);
    if reader.format().is_none() {
        return Err("is neither a PNG nor a JPEG".into());
    }
    let image = reader.decode().map_err(|e| match e {
        image::ImageError::Limits(_) => format!("is larger than {MAX_TEXTURE_SIDE}x{MAX_TEXTURE_SIDE} texels"),
        e => format!("is neither a sound PNG nor a JPEG: {e}"),
    })?;
    let image = image.into_rgba8();
    let (width, height) = image.dimensions();
    Ok(Texture { width, height, texels: image.into_raw().as_chunks().0.to_vec() })
}

/// Area-weighted vertex normals.
pub(crate) fn smooth_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize]);
        let n = (b - a).cross(c - a);
        for &i in t {
            normals[i as usize] += n;
        }
    }
    normals.into_iter().map(|n| n.normalize_or(Vec3::Z)).collect()
}
