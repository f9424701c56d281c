//! What surrounds a glTF's data: GLB chunks, names of extensions, files beside it.

use std::path::{Component, Path, PathBuf};

use gltf::json::Value;
use gltf::json::deserialize::from_slice;

use crate::model::read_bounded;

/// Extensions that may be required: they are read, or change nothing that is.
const UNDERSTOOD: [&str; 5] = [
    "KHR_mesh_quantization",
    "KHR_materials_unlit",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_texture_transform",
    "KHR_lights_punctual",
];

/// Splits a file into its JSON and its binary chunk, if it is GLB; else all of it is JSON.
pub fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    if bytes.is_empty() {
        return Err("it is empty".into());
    }
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(format!("it is truncated: {} bytes, a GLB header has 12", bytes.len()));
    };
    if version != 2 {
        return Err(format!("its GLB version is {version}, expected 2"));
    }
    let length = length as usize;
    if length > bytes.len() {
        return Err(format!("it is truncated: its header says {length} bytes, the file has {}", bytes.len()));
    }
    let (mut json, mut binary, mut at, mut number) = (None, None, 12, 0);
    while at + 8 <= length {
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else { break };
        let start = at + 8;
        let Some(chunk) = start.checked_add(size as usize).filter(|end| *end <= length).map(|end| &bytes[start..end])
        else {
            return Err(format!("chunk {number} claims {size} bytes, but {} are left of the file", length - start));
        };
        match (number, kind) {
            (0, b"JSON") => json = Some(chunk),
            (0, _) => return Err(format!("its first chunk is {:?}, expected JSON", String::from_utf8_lossy(kind))),
            (1, b"BIN\0") => binary = Some(chunk),
            // Others are to be skipped.
            _ => {}
        }
        at = start + (size as usize).next_multiple_of(4);
        number += 1;
    }
    json.map(|json| (json, binary)).ok_or_else(|| "its GLB container holds no JSON chunk".into())
}

/// Parses the JSON, refuses by name what cannot be read, and takes the names of extensions out that
/// the reader of the rest need not know.
pub fn parse(json: &[u8]) -> Result<gltf::json::Root, String> {
    let broken = |e: gltf::json::Error| format!("it is not glTF 2.0: {e}");
    let value: Value = from_slice(json).map_err(broken)?;
    match value.pointer("/asset/version").and_then(Value::as_str) {
        Some(version) if version.starts_with("2.") => {}
        Some(version) => return Err(format!("it is not glTF 2.0: its version is {version:?}")),
        None => return Err("it is not glTF 2.0: asset.version is missing".into()),
    }
    let names = |key: &str| value.get(key).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
    for required in names("extensionsRequired") {
        if required.contains("draco") || required.contains("meshopt") {
            return Err(format!("it needs {required}, which is not supported; save it without compression"));
        }
        if required.contains("basisu") || required.contains("webp") || required.contains("dds") {
            return Err(format!("it needs {required}, which is not supported; save its textures as PNG or JPEG"));
        }
        if !UNDERSTOOD.contains(&required) {
            return Err(format!("it needs the extension {required}, which is not supported"));
        }
    }
    for (i, texture) in value.get("textures").and_then(Value::as_array).into_iter().flatten().enumerate() {
        if texture.get("source").is_none() {
            let other = texture.get("extensions").and_then(Value::as_object).and_then(|e| e.keys().next());
            let other = other.map_or_else(String::new, |name| format!(" other than that of {name}"));
            return Err(format!("texture {i} has no image{other}, expected a PNG or JPEG"));
        }
    }
    let mut root: gltf::json::Root = from_slice(json).map_err(broken)?;
    root.extensions_required.clear();
    check(&root)?;
    Ok(root)
}

/// What the `gltf` crate does not check and panics on: positions from an accessor that does not
/// exist, images without a source or a type.
fn check(root: &gltf::json::Root) -> Result<(), String> {
    let semantic = gltf::json::validation::Checked::Valid(gltf::Semantic::Positions);
    for primitive in root.meshes.iter().flat_map(|m| &m.primitives) {
        if let Some(index) = primitive.attributes.get(&semantic)
            && index.value() >= root.accessors.len()
        {
            return Err(format!(
                "its positions are accessor {}, but there are {}",
                index.value(),
                root.accessors.len()
            ));
        }
    }
    for (i, image) in root.images.iter().enumerate() {
        if image.buffer_view.is_none() && image.uri.is_none() {
            return Err(format!("image {i} has neither a buffer view nor a URI"));
        }
        if image.buffer_view.is_some() && image.mime_type.is_none() {
            return Err(format!("image {i} is in a buffer view but its MIME type is missing"));
        }
    }
    Ok(())
}

/// The bytes of every buffer, at least as many as it claims.
pub fn read_buffers(
    document: &gltf::Document,
    mut blob: Option<&[u8]>,
    folder: Option<&Path>,
) -> Result<Vec<Vec<u8>>, String> {
    document
        .buffers()
        .map(|buffer| {
            let data = match buffer.source() {
                gltf::buffer::Source::Bin => blob.take().ok_or("its binary chunk is missing")?.to_vec(),
                gltf::buffer::Source::Uri(uri) => read_uri(uri, folder)?,
            };
            if data.len() < buffer.length() {
                let (i, expected, found) = (buffer.index(), buffer.length(), data.len());
                return Err(format!("buffer {i} is truncated: {found} bytes, expected {expected}"));
            }
            Ok(data)
        })
        .collect()
}

/// Bytes behind a URI: base64 data, or a file in the folder.
pub fn read_uri(uri: &str, folder: Option<&Path>) -> Result<Vec<u8>, String> {
    if uri.starts_with("data:") {
        return gltf::buffer::Data::from_source(gltf::buffer::Source::Uri(uri), None)
            .map(|d| d.0)
            .map_err(|e| format!("a data URI is damaged: {e}"));
    }
    let path = local_path(uri, folder)?;
    read_bounded(&path).map_err(|e| format!("it refers to {uri:?}, which cannot be read: {e}"))
}

/// A file named by a relative URI, inside `folder`.
fn local_path(uri: &str, folder: Option<&Path>) -> Result<PathBuf, String> {
    let Some(folder) = folder else {
        return Err(format!("it refers to the file {uri:?}, but only its own bytes are at hand"));
    };
    let decoded = percent_decode(uri).ok_or_else(|| format!("it refers to {uri:?}, which is not a file name"))?;
    let relative = Path::new(&decoded);
    let inside = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if uri.contains(':') || decoded.contains('\\') || !inside {
        return Err(format!("it refers to {uri:?}; only files in its own folder are read"));
    }
    Ok(folder.join(relative))
}

fn percent_decode(uri: &str) -> Option<String> {
    let mut out = Vec::with_capacity(uri.len());
    let mut bytes = uri.bytes();
    while let Some(b) = bytes.next() {
        if b == b'%' {
            let (high, low) = (char::from(bytes.next()?).to_digit(16)?, char::from(bytes.next()?).to_digit(16)?);
            out.push((high * 16 + low) as u8);
        } else {
            out.push(b);
        }
    }
    String::from_utf8(out).ok()
}
