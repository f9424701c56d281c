//! glTF 2.0 and GLB files.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use glam::{Mat4, Vec2, Vec3};
use gltf::accessor::DataType;

use crate::model::{self, Material, Mesh, Model, ModelError, Texture};

/// Extensions that change nothing we read, or that [`Importer`] understands.
const UNDERSTOOD: [&str; 1] = ["KHR_mesh_quantization"];

/// Reads a `.glb` or `.gltf` file; buffers and images may lie beside it, not outside its folder.
///
/// # Errors
/// [`ModelError`] that names the file and what is wrong with it.
pub fn load_gltf(path: impl AsRef<Path>) -> Result<Model, ModelError> {
    let path = path.as_ref();
    let name = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| ModelError::Io { path: name.clone(), source })?;
    let folder = path.parent().map(Path::to_path_buf);
    parse(&bytes, folder.as_deref()).map_err(|reason| ModelError::Invalid { path: name, reason })
}

/// Reads GLB (or self-contained glTF) bytes; `name` stands for the file in messages.
///
/// # Errors
/// As [`load_gltf`].
pub fn from_glb(bytes: &[u8], name: &str) -> Result<Model, ModelError> {
    parse(bytes, None).map_err(|reason| ModelError::Invalid { path: name.into(), reason })
}

fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Model, String> {
    check_container(bytes)?;
    let unchecked = gltf::Gltf::from_slice_without_validation(bytes).map_err(|e| format!("it is not glTF 2.0: {e}"))?;
    for required in unchecked.extensions_required() {
        if required.contains("draco") || required.contains("meshopt") {
            return Err(format!("it needs {required}, which is not supported; save it without compression"));
        }
        if !UNDERSTOOD.contains(&required) {
            return Err(format!("it needs the extension {required}, which is not supported"));
        }
    }
    check_json(unchecked.as_json())?;
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(bytes).map_err(|e| format!("it is not sound: {e}"))?;
    let buffers = read_buffers(&document, blob, folder)?;
    let mut importer = Importer { document: &document, buffers, folder, textures: Vec::new(), model: Model::default() };
    importer.textures = vec![None; document.images().count()];
    importer.run()?;
    Ok(importer.model)
}

/// What the `gltf` crate does not check and panics on: positions from an accessor that does not
/// exist, images without a source or a type.
fn check_json(root: &gltf::json::Root) -> Result<(), String> {
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

/// GLB header: length and version, so that truncation is named as such.
fn check_container(bytes: &[u8]) -> Result<(), String> {
    if !bytes.starts_with(b"glTF") {
        return if bytes.is_empty() { Err("it is empty".into()) } else { Ok(()) };
    }
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    match (word(4), word(8)) {
        (Some(2), Some(length)) if length as usize <= bytes.len() => Ok(()),
        (Some(2), Some(length)) => {
            Err(format!("it is truncated: its header says {length} bytes, the file has {}", bytes.len()))
        }
        (Some(version), Some(_)) => Err(format!("its GLB version is {version}, expected 2")),
        _ => Err(format!("it is truncated: {} bytes, a GLB header has 12", bytes.len())),
    }
}

/// A file named by a relative URI, inside `folder`.
fn local_path(uri: &str, folder: Option<&Path>) -> Result<PathBuf, String> {
    let Some(folder) = folder else {
        return Err(format!("it refers to the file {uri:?}, but only its own bytes are at hand"));
    };
    let decoded = percent_decode(uri).ok_or_else(|| format!("it refers to {uri:?}, which is not a file name"))?;
    let relative = Path::new(&decoded);
    let inside = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if uri.contains(':') || !inside {
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

/// Bytes behind a URI: base64 data, or a file in the folder.
fn read_uri(uri: &str, folder: Option<&Path>) -> Result<Vec<u8>, String> {
    if uri.starts_with("data:") {
        return gltf::buffer::Data::from_source(gltf::buffer::Source::Uri(uri), None)
            .map(|d| d.0)
            .map_err(|e| format!("a data URI is damaged: {e}"));
    }
    let path = local_path(uri, folder)?;
    std::fs::read(&path).map_err(|e| format!("it refers to {uri:?}, which cannot be read: {e}"))
}

fn read_buffers(
    document: &gltf::Document,
    mut blob: Option<Vec<u8>>,
    folder: Option<&Path>,
) -> Result<Vec<Vec<u8>>, String> {
    document
        .buffers()
        .map(|buffer| {
            let data = match buffer.source() {
                gltf::buffer::Source::Bin => blob.take().ok_or("its binary chunk is missing")?,
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

struct Importer<'a> {
    document: &'a gltf::Document,
    buffers: Vec<Vec<u8>>,
    folder: Option<&'a Path>,
    /// By image index, decoded at first use.
    textures: Vec<Option<Arc<Texture>>>,
    model: Model,
}

impl Importer<'_> {
    fn run(&mut self) -> Result<(), String> {
        let mut default_used = false;
        for material in self.document.materials() {
            let m = self.material(&material)?;
            self.model.materials.push(m);
        }
        let default = self.model.materials.len();
        let scene = self.document.default_scene().or_else(|| self.document.scenes().next());
        let Some(scene) = scene else { return Err("it has no scene".into()) };
        // An explicit stack, bounded by the node count: node trees in damaged files may loop.
        let mut stack: Vec<(gltf::Node<'_>, Mat4)> = scene.nodes().map(|n| (n, y_up_to_z_up())).collect();
        stack.reverse();
        let mut budget = self.document.nodes().count();
        while let Some((node, parent)) = stack.pop() {
            budget = budget.checked_sub(1).ok_or("its nodes do not form a tree")?;
            let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
            for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
                if primitive.mode() == gltf::mesh::Mode::Triangles {
                    default_used |= self.primitive(&primitive, world, default)?;
                }
            }
            let mut children: Vec<_> = node.children().map(|c| (c, world)).collect();
            children.reverse();
            stack.extend(children);
        }
        if default_used {
            self.model.materials.push(Material::default());
        }
        if self.model.triangle_count() == 0 {
            return Err("it has no triangles".into());
        }
        self.model.check()
    }

    fn material(&mut self, material: &gltf::Material<'_>) -> Result<Material, String> {
        let pbr = material.pbr_metallic_roughness();
        let texture = match pbr.base_color_texture() {
            Some(info) => Some(self.texture(&info.texture().source())?),
            None => None,
        };
        Ok(Material {
            name: material.name().unwrap_or_default().into(),
            base_color: pbr.base_color_factor(),
            base_color_texture: texture,
            metallic: pbr.metallic_factor(),
            roughness: pbr.roughness_factor(),
            double_sided: material.double_sided(),
        })
    }

    fn texture(&mut self, image: &gltf::Image<'_>) -> Result<Arc<Texture>, String> {
        if let Some(texture) = &self.textures[image.index()] {
            return Ok(texture.clone());
        }
        let bytes = match image.source() {
            gltf::image::Source::View { view, .. } => self.view_bytes(&view)?.to_vec(),
            gltf::image::Source::Uri { uri, .. } => read_uri(uri, self.folder)?,
        };
        let texture = Arc::new(model::decode_texture(&bytes).map_err(|e| format!("image {}: {e}", image.index()))?);
        self.textures[image.index()] = Some(texture.clone());
        Ok(texture)
    }

    fn view_bytes(&self, view: &gltf::buffer::View<'_>) -> Result<&[u8], String> {
        let buffer = &self.buffers[view.buffer().index()];
        let end = view.offset().checked_add(view.length());
        end.and_then(|end| buffer.get(view.offset()..end))
            .ok_or_else(|| format!("buffer view {} reaches beyond its buffer of {} bytes", view.index(), buffer.len()))
    }

    /// Refuses accessors that reach beyond their data: the reader would panic on them.
    fn check_accessor(&self, accessor: &gltf::Accessor<'_>) -> Result<(), String> {
        let i = accessor.index();
        if accessor.sparse().is_some() {
            return Err(format!("accessor {i} is sparse, which is not supported"));
        }
        let Some(view) = accessor.view() else { return Err(format!("accessor {i} has no data")) };
        let available = self.view_bytes(&view)?.len();
        let size = accessor.size();
        let stride = view.stride().unwrap_or(size);
        let needed = accessor.count().checked_sub(1).and_then(|n| n.checked_mul(stride));
        let needed = needed.and_then(|n| n.checked_add(size)?.checked_add(accessor.offset()));
        match needed {
            Some(needed) if needed <= available && stride >= size => Ok(()),
            _ => Err(format!("accessor {i} reaches beyond its buffer view of {available} bytes")),
        }
    }

    /// Appends a triangle list; returns whether it uses the default material.
    fn primitive(&mut self, p: &gltf::Primitive<'_>, world: Mat4, default: usize) -> Result<bool, String> {
        use gltf::Semantic::{Normals, Positions, TexCoords};
        let Some(accessor) = p.get(&Positions) else { return Ok(false) };
        let used = [Some(accessor.clone()), p.get(&Normals), p.get(&TexCoords(0)), p.indices()];
        for a in used.iter().flatten() {
            self.check_accessor(a)?;
        }
        check_types(p)?;
        let reader = p.reader(|b| self.buffers.get(b.index()).map(Vec::as_slice));
        let positions: Vec<Vec3> = reader.read_positions().into_iter().flatten().map(Vec3::from).collect();
        let n = positions.len();
        let indices: Vec<u32> = match reader.read_indices() {
            Some(i) => i.into_u32().collect(),
            None => (0..n as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(format!("a triangle uses vertex {bad}, but there are {n}"));
        }
        let mut triangles: Vec<[u32; 3]> = indices.as_chunks().0.to_vec();
        if world.determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let world_positions: Vec<Vec3> = positions.iter().map(|&p| world.transform_point3(p)).collect();
        let normals: Vec<Vec3> = match reader.read_normals() {
            Some(normals) => {
                let matrix = world.inverse().transpose();
                normals.map(|n| matrix.transform_vector3(Vec3::from(n)).normalize_or(Vec3::Z)).collect()
            }
            None => model::smooth_normals(&world_positions, &triangles),
        };
        let uvs = match reader.read_tex_coords(0) {
            Some(uv) => uv.into_f32().map(Vec2::from).collect(),
            None => vec![Vec2::ZERO; n],
        };
        let material = p.material().index();
        let mesh = Mesh { positions: world_positions, normals, uvs, triangles, material: material.unwrap_or(default) };
        self.model.meshes.push(mesh);
        Ok(material.is_none())
    }
}

/// The reader assumes these element types; other ones would be misread or panic.
fn check_types(p: &gltf::Primitive<'_>) -> Result<(), String> {
    use gltf::Semantic::{Normals, Positions, TexCoords};
    use gltf::accessor::Dimensions::{Scalar, Vec2, Vec3};
    for (semantic, dimensions) in [(Positions, Vec3), (Normals, Vec3)] {
        if let Some(a) = p.get(&semantic)
            && (a.data_type(), a.dimensions()) != (DataType::F32, dimensions)
        {
            return Err(format!(
                "{semantic:?} are {:?} {:?}, expected 32-bit float Vec3",
                a.data_type(),
                a.dimensions()
            ));
        }
    }
    if let Some(a) = p.get(&TexCoords(0))
        && (a.dimensions() != Vec2 || !matches!(a.data_type(), DataType::F32 | DataType::U8 | DataType::U16))
    {
        return Err(format!("texture coordinates are {:?} {:?}", a.data_type(), a.dimensions()));
    }
    if let Some(a) = p.indices()
        && (a.dimensions() != Scalar || !matches!(a.data_type(), DataType::U8 | DataType::U16 | DataType::U32))
    {
        return Err(format!("indices are {:?} {:?}", a.data_type(), a.dimensions()));
    }
    Ok(())
}

/// glTF is y up, right-handed: `(x, y, z) → (x, -z, y)`.
fn y_up_to_z_up() -> Mat4 {
    Mat4::from_cols_array_2d(&[[1., 0., 0., 0.], [0., 0., 1., 0.], [0., -1., 0., 0.], [0., 0., 0., 1.]])
}
