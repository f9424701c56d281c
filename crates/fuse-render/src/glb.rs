//! Writing GLB files.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use crate::model::{Material, Mesh, Model, ModelError, Texture};

/// JPEG quality of textures.
const JPEG_QUALITY: u8 = 88;

/// Little-endian binary chunk with the JSON of the buffer views and accessors into it.
#[derive(Default)]
struct Binary {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Binary {
    /// Appends bytes as a new view, 4-byte aligned; returns its index.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let target = target.map_or(String::new(), |t| format!(",\"target\":{t}"));
        self.views.push(format!(
            "{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{}{target}}}",
            self.bytes.len(),
            bytes.len()
        ));
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, count: usize, kind: &str, extra: &str) -> usize {
        self.accessors.push(format!(
            "{{\"bufferView\":{view},\"componentType\":{component},\"count\":{count},\"type\":\"{kind}\"{extra}}}"
        ));
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: impl Iterator<Item = [f32; N]>, kind: &str, extra: &str) -> usize {
        const ARRAY_BUFFER: u32 = 34962;
        const FLOAT: u32 = 5126;
        let bytes: Vec<u8> = values.flatten().flat_map(f32::to_le_bytes).collect();
        let view = self.view(&bytes, Some(ARRAY_BUFFER));
        self.accessor(view, FLOAT, bytes.len() / (4 * N), kind, extra)
    }

    fn indices(&mut self, triangles: &[[u32; 3]], vertices: usize) -> usize {
        const ELEMENT_ARRAY_BUFFER: u32 = 34963;
        let flat = triangles.iter().flatten();
        // 65535 is primitive restart and must not be used as an index.
        let (bytes, component): (Vec<u8>, u32) = if vertices < 65536 {
            (flat.flat_map(|&i| (i as u16).to_le_bytes()).collect(), 5123)
        } else {
            (flat.flat_map(|i| i.to_le_bytes()).collect(), 5125)
        };
        let view = self.view(&bytes, Some(ELEMENT_ARRAY_BUFFER));
        self.accessor(view, component, triangles.len() * 3, "SCALAR", "")
    }
}

/// A model as GLB bytes: one node, one primitive a mesh, each distinct texture once. The same
/// model gives the same bytes.
///
/// Opaque textures become JPEG (quality 88) where that is smaller than PNG; others PNG. Meshes
/// without triangles are left out.
pub fn to_glb(model: &Model) -> Vec<u8> {
    let mut binary = Binary::default();
    let primitives: Vec<String> =
        model.meshes.iter().filter(|m| !m.triangles.is_empty()).map(|m| primitive(&mut binary, m)).collect();
    let mut textures: Vec<&Arc<Texture>> = Vec::new();
    let materials: Vec<String> = model.materials.iter().map(|m| material(m, &mut textures)).collect();
    let images: Vec<String> = textures
        .iter()
        .map(|t| {
            let (bytes, mime) = encode(t);
            format!("{{\"bufferView\":{},\"mimeType\":\"{mime}\"}}", binary.view(&bytes, None))
        })
        .collect();
    let sources: Vec<String> = (0..images.len()).map(|i| format!("{{\"sampler\":0,\"source\":{i}}}")).collect();
    let mut json = String::from("{\"asset\":{\"version\":\"2.0\",\"generator\":\"fuse-render\"},\"scene\":0");
    json += ",\"scenes\":[{\"nodes\":[0]}]";
    if primitives.is_empty() {
        json += ",\"nodes\":[{}]";
    } else {
        json += ",\"nodes\":[{\"mesh\":0}]";
        array(&mut json, "meshes", &[format!("{{\"primitives\":[{}]}}", primitives.join(","))]);
    }
    array(&mut json, "materials", &materials);
    if !images.is_empty() {
        // Linear mip-mapped filtering, repeating.
        json += ",\"samplers\":[{\"magFilter\":9729,\"minFilter\":9987,\"wrapS\":10497,\"wrapT\":10497}]";
    }
    array(&mut json, "textures", &sources);
    array(&mut json, "images", &images);
    array(&mut json, "accessors", &binary.accessors);
    array(&mut json, "bufferViews", &binary.views);
    if !binary.bytes.is_empty() {
        array(&mut json, "buffers", &[format!("{{\"byteLength\":{}}}", binary.bytes.len())]);
    }
    json.push('}');
    container(json.into_bytes(), &binary.bytes)
}

/// Writes a model as a GLB file; nothing is left behind when writing fails.
///
/// # Errors
/// [`ModelError::Invalid`] when [`Model::check`] refuses the model, [`ModelError::Io`].
pub fn save_glb(model: &Model, path: impl AsRef<Path>) -> Result<(), ModelError> {
    let path = path.as_ref();
    let name = path.display().to_string();
    model.check().map_err(|reason| ModelError::Invalid { path: name.clone(), reason })?;
    let partial = path.with_extension("glb.partial");
    std::fs::write(&partial, to_glb(model)).and_then(|()| std::fs::rename(&partial, path)).map_err(|source| {
        let _ = std::fs::remove_file(&partial);
        ModelError::Io { path: name, source }
    })
}

fn array(json: &mut String, key: &str, items: &[String]) {
    if !items.is_empty() {
        // Writing to a string cannot fail.
        let _ = write!(json, ",\"{key}\":[{}]", items.join(","));
    }
}

fn container(mut json: Vec<u8>, binary: &[u8]) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let chunks: &[(&[u8; 4], &[u8])] =
        if binary.is_empty() { &[(b"JSON", &json)] } else { &[(b"JSON", &json), (b"BIN\0", binary)] };
    let length = 12 + chunks.iter().map(|(_, data)| 8 + data.len()).sum::<usize>();
    let mut out = Vec::with_capacity(length);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&(length as u32).to_le_bytes());
    for (kind, data) in chunks {
        out.extend_from_slice(&(data.len() as u32).to_le_bytes());
        out.extend_from_slice(*kind);
        out.extend_from_slice(data);
    }
    out
}

/// z up → glTF's y up.
fn y_up(p: Vec3) -> [f32; 3] {
    [p.x, p.z, -p.y]
}

fn primitive(binary: &mut Binary, mesh: &Mesh) -> String {
    let positions: Vec<[f32; 3]> = mesh.positions.iter().copied().map(y_up).collect();
    let fold = |f: fn(f32, f32) -> f32| -> [f32; 3] {
        positions.iter().copied().reduce(|a, b| std::array::from_fn(|i| f(a[i], b[i]))).unwrap_or_default()
    };
    let bounds = format!(",\"min\":{:?},\"max\":{:?}", fold(f32::min), fold(f32::max));
    let position = binary.floats(positions.iter().copied(), "VEC3", &bounds);
    let normal = binary.floats(mesh.normals.iter().copied().map(y_up), "VEC3", "");
    let uv = binary.floats(mesh.uvs.iter().map(|uv| uv.to_array()), "VEC2", "");
    let indices = binary.indices(&mesh.triangles, mesh.positions.len());
    format!(
        "{{\"attributes\":{{\"POSITION\":{position},\"NORMAL\":{normal},\"TEXCOORD_0\":{uv}}},\
         \"indices\":{indices},\"material\":{}}}",
        mesh.material
    )
}

fn material<'a>(m: &'a Material, textures: &mut Vec<&'a Arc<Texture>>) -> String {
    let texture = m.base_color_texture.as_ref().map_or(String::new(), |t| {
        let index = textures.iter().position(|known| Arc::ptr_eq(known, t)).unwrap_or_else(|| {
            textures.push(t);
            textures.len() - 1
        });
        format!(",\"baseColorTexture\":{{\"index\":{index}}}")
    });
    let mut name = String::new();
    for c in m.name.chars() {
        match c {
            '"' | '\\' => name.extend(['\\', c]),
            c if c.is_control() => name.push(' '),
            c => name.push(c),
        }
    }
    format!(
        "{{\"name\":\"{name}\",\"doubleSided\":{},\"pbrMetallicRoughness\":{{\"baseColorFactor\":{:?},\
         \"metallicFactor\":{:?},\"roughnessFactor\":{:?}{texture}}}}}",
        m.double_sided, m.base_color, m.metallic, m.roughness
    )
}

/// Smaller of PNG and JPEG; PNG when there is transparency.
fn encode(texture: &Texture) -> (Vec<u8>, &'static str) {
    let (w, h) = (texture.width, texture.height);
    let opaque = texture.texels.iter().all(|t| t[3] == 255);
    let rgb: Vec<u8> = texture.texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect();
    let mut png = Vec::new();
    let written = if opaque {
        PngEncoder::new(&mut png).write_image(&rgb, w, h, ExtendedColorType::Rgb8)
    } else {
        PngEncoder::new(&mut png).write_image(texture.texels.as_flattened(), w, h, ExtendedColorType::Rgba8)
    };
    // Encoding a checked texture into memory cannot fail.
    debug_assert!(written.is_ok());
    let mut jpeg = Vec::new();
    if opaque
        && JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY).encode(&rgb, w, h, ExtendedColorType::Rgb8).is_ok()
        && jpeg.len() < png.len()
    {
        return (jpeg, "image/jpeg");
    }
    (png, "image/png")
}
