//! Wavefront OBJ files with their MTL.

mod lines;

use std::cell::RefCell;
use std::io::{BufReader, Cursor};
use std::path::{Component, Path};
use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::model::{self, MOST_CORNERS, MOST_VERTICES, Material, Mesh, Model, ModelError};

/// Reads an `.obj` file. Axes are taken as z up, metres; materials and textures may lie beside
/// it, not outside its folder.
///
/// # Errors
/// [`ModelError`] that names the file and what is wrong with it.
pub fn load_obj(path: impl AsRef<Path>) -> Result<Model, ModelError> {
    load_noted(path.as_ref()).map(|(model, _)| model)
}

/// As [`load_obj`], and what was left out or stood for something else, in sentences.
pub(crate) fn load_noted(path: &Path) -> Result<(Model, Vec<String>), ModelError> {
    let name = path.display().to_string();
    let bytes = model::read_bounded(path).map_err(|source| ModelError::Io { path: name.clone(), source })?;
    parse(&bytes, path.parent().unwrap_or(Path::new("."))).map_err(|reason| ModelError::Invalid { path: name, reason })
}

/// Why a file beside the model was not read.
enum Refused {
    /// It is not there.
    Missing(String),
    /// What a person is told.
    For(String),
}

fn read_beside(folder: &Path, file: &Path) -> Result<Vec<u8>, Refused> {
    let name = file.display().to_string();
    // OBJ files from Windows have its separators.
    let outside = |p: &Path| !p.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if outside(file) || name.contains(':') || outside(Path::new(&name.replace('\\', "/"))) {
        return Err(Refused::For(format!("it refers to {name}; only files in its own folder are read")));
    }
    model::read_bounded(&folder.join(name.replace('\\', "/"))).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Refused::Missing(name),
        _ => Refused::For(format!("it refers to {name}, which cannot be read: {e}")),
    })
}

fn parse(bytes: &[u8], folder: &Path) -> Result<(Model, Vec<String>), String> {
    let mut notes = lines::check(bytes)?;
    // The reader replaces what the callback returns; the first true cause is kept here.
    let (trouble, missing) = (RefCell::new(None), RefCell::new(vec![]));
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let (shapes, materials) =
        tobj::load_obj_buf(&mut Cursor::new(bytes), &options, |file| match read_beside(folder, file) {
            // What is missing is grey; what is outside is not even looked for.
            Err(Refused::Missing(name)) => {
                missing.borrow_mut().push(name);
                Ok(Default::default())
            }
            Ok(data) => tobj::load_mtl_buf(&mut BufReader::new(Cursor::new(data))),
            Err(Refused::For(reason)) => {
                trouble.borrow_mut().get_or_insert(reason);
                Err(tobj::LoadError::OpenFileFailed)
            }
        })
        .map_err(|e| format!("it is not a sound OBJ file: {e}"))?;
    if let Some(reason) = trouble.into_inner() {
        return Err(reason);
    }
    notes.extend(missing.into_inner().into_iter().map(|m| format!("its material file {m} is missing: grey instead")));
    let materials = materials.map_err(|e| format!("its material file is damaged: {e}"))?;
    let mut out = Model::default();
    for m in &materials {
        out.materials.push(material(m, folder)?);
    }
    let default = out.materials.len();
    for shape in shapes {
        let mesh = mesh(&shape.mesh, default)?;
        if !mesh.triangles.is_empty() {
            out.meshes.push(mesh);
        }
    }
    if out.meshes.iter().any(|m| m.material == default) {
        out.materials.push(Material::default());
    }
    if out.triangle_count() == 0 {
        return Err("it has no triangles".into());
    }
    out.check()?;
    Ok((out, notes))
}

fn material(m: &tobj::Material, folder: &Path) -> Result<Material, String> {
    let texture = match &m.diffuse_texture {
        Some(file) => {
            let bytes = read_beside(folder, Path::new(file)).map_err(|r| match r {
                Refused::Missing(name) => format!("its texture {name} is missing; put it beside the model"),
                Refused::For(reason) => reason,
            })?;
            Some(Arc::new(model::decode_texture(&bytes).map_err(|e| format!("the texture {file} {e}"))?))
        }
        None => None,
    };
    // A texture replaces the diffuse colour, as most exporters expect.
    let [r, g, b] = if texture.is_some() { [1.0; 3] } else { m.diffuse.unwrap_or([0.8; 3]) };
    Ok(Material {
        name: m.name.clone(),
        base_color: [r, g, b, m.dissolve.unwrap_or(1.0)],
        base_color_texture: texture,
        metallic: 0.0,
        // Blinn-Phong exponent to GGX: α² = 2 / (n + 2).
        roughness: m.shininess.map_or(0.8, |n| (2.0 / (n.max(0.0) + 2.0)).sqrt().sqrt()),
        double_sided: true,
    })
}

fn mesh(m: &tobj::Mesh, default: usize) -> Result<Mesh, String> {
    let positions: Vec<Vec3> = m.positions.as_chunks().0.iter().map(|&p| Vec3::from_array(p)).collect();
    let n = positions.len();
    let triangles: Vec<[u32; 3]> = m.indices.as_chunks().0.to_vec();
    if let Some(bad) = triangles.iter().flatten().find(|&&i| i as usize >= n) {
        return Err(format!("a face uses vertex {bad}, but there are {n}"));
    }
    let normals = if m.normals.len() == 3 * n {
        m.normals.as_chunks().0.iter().map(|&v| Vec3::from_array(v).normalize_or(Vec3::Z)).collect()
    } else {
        model::smooth_normals(&positions, &triangles)
    };
    let uvs = if m.texcoords.len() == 2 * n {
        // OBJ's v grows upwards.
        m.texcoords.as_chunks().0.iter().map(|&[u, v]| Vec2::new(u, 1.0 - v)).collect()
    } else {
        vec![Vec2::ZERO; n]
    };
    Ok(Mesh { positions, normals, uvs, triangles, material: m.material_id.unwrap_or(default) })
}
