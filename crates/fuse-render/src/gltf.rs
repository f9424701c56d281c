//! glTF 2.0 and GLB files.

mod accessor;
mod container;
mod material;

use std::path::Path;

use glam::{Affine2, Mat4, Vec2, Vec3};
use gltf::mesh::Mode;

use self::material::{Painted, Textures};
use crate::model::{self, Material, Mesh, Model, ModelError};

/// Reads a `.glb` or `.gltf` file; buffers and images may lie beside it, not outside its folder.
///
/// # Errors
/// [`ModelError`] that names the file and what is wrong with it.
pub fn load_gltf(path: impl AsRef<Path>) -> Result<Model, ModelError> {
    load_noted(path.as_ref()).map(|(model, _)| model)
}

/// As [`load_gltf`], and what was left out or stood for something else, in sentences.
pub(crate) fn load_noted(path: &Path) -> Result<(Model, Vec<String>), ModelError> {
    let name = path.display().to_string();
    let bytes = model::read_bounded(path).map_err(|source| ModelError::Io { path: name.clone(), source })?;
    parse(&bytes, path.parent()).map_err(|reason| ModelError::Invalid { path: name, reason })
}

/// Reads GLB (or self-contained glTF) bytes; `name` stands for the file in messages.
///
/// # Errors
/// As [`load_gltf`].
pub fn from_glb(bytes: &[u8], name: &str) -> Result<Model, ModelError> {
    parse(bytes, None).map(|(model, _)| model).map_err(|reason| ModelError::Invalid { path: name.into(), reason })
}

fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<(Model, Vec<String>), String> {
    let (json, blob) = container::split(bytes)?;
    let root = container::parse(json)?;
    let document = gltf::Document::from_json(root).map_err(|e| format!("it is not sound: {e}"))?;
    let buffers = container::read_buffers(&document, blob, folder)?;
    let textures = Textures::new(&buffers, folder, document.images().count());
    let mut importer = Importer {
        document: &document,
        buffers: &buffers,
        textures,
        placements: vec![],
        left: model::Budget::default(),
        model: Model::default(),
        notes: vec![],
    };
    importer.run()?;
    Ok((importer.model, importer.notes))
}

struct Importer<'a> {
    document: &'a gltf::Document,
    buffers: &'a [Vec<u8>],
    textures: Textures<'a>,
    /// How each material's texture is put on: set of coordinates, what is done to them.
    placements: Vec<(u32, Option<Affine2>)>,
    left: model::Budget,
    model: Model,
    notes: Vec<String>,
}

impl Importer<'_> {
    fn run(&mut self) -> Result<(), String> {
        let document = self.document;
        for m in document.materials() {
            let Painted { material, set, transform } = material::material(&m, &mut self.textures, &mut self.notes)?;
            self.model.materials.push(material);
            self.placements.push((set, transform));
        }
        let default = self.model.materials.len();
        let scene = document.default_scene().or_else(|| document.scenes().next());
        let Some(scene) = scene else { return Err("it has no scene".into()) };
        let (mut default_used, mut skinned, mut morphed, mut flat) = (false, false, false, 0);
        // An explicit stack, bounded by the node count: node trees in damaged files may loop.
        let mut stack: Vec<(gltf::Node<'_>, Mat4)> = scene.nodes().map(|n| (n, y_up_to_z_up())).collect();
        stack.reverse();
        let mut budget = document.nodes().count();
        while let Some((node, parent)) = stack.pop() {
            budget = budget.checked_sub(1).ok_or("its nodes do not form a tree")?;
            let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
            skinned |= node.skin().is_some() && node.mesh().is_some();
            for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
                morphed |= primitive.morph_targets().next().is_some();
                if matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                    default_used |= self.primitive(&primitive, world, default)?;
                } else {
                    flat += 1;
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
            let flat = if flat > 0 { format!(", only {flat} primitives of points or lines") } else { String::new() };
            return Err(format!("it has no triangles{flat}"));
        }
        for (found, note) in [
            (flat > 0, "points and lines are left out"),
            (skinned, "it is skinned: taken in the pose in which its mesh is stored"),
            (morphed, "it has morph targets: taken without them"),
            (document.animations().next().is_some(), "it is animated: taken as it stands without its animations"),
        ] {
            if found {
                self.notes.push(note.into());
            }
        }
        self.model.check()
    }

    /// Appends a primitive's triangles; returns whether it uses the default material.
    fn primitive(&mut self, p: &gltf::Primitive<'_>, world: Mat4, default: usize) -> Result<bool, String> {
        use gltf::Semantic::{Normals, Positions, TexCoords};
        let Some(accessor) = p.get(&Positions) else { return Ok(false) };
        self.left.take(accessor.count(), p.indices().map_or(accessor.count(), |a| a.count()))?;
        let positions: Vec<[f32; 3]> = accessor::vectors(self.buffers, &accessor, "positions")?;
        let n = positions.len();
        let indices: Vec<u32> = match p.indices() {
            Some(a) => accessor::indices(self.buffers, &a)?,
            None => (0..n as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(format!("a triangle uses vertex {bad}, but there are {n}"));
        }
        let mut triangles = triangles(p.mode(), &indices);
        if world.determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let positions: Vec<Vec3> = positions.into_iter().map(|p| world.transform_point3(Vec3::from(p))).collect();
        let normals: Vec<Vec3> = match p.get(&Normals) {
            Some(a) => {
                let matrix = world.inverse().transpose();
                let given: Vec<[f32; 3]> = accessor::vectors(self.buffers, &a, "normals")?;
                given.into_iter().map(|n| matrix.transform_vector3(Vec3::from(n)).normalize_or(Vec3::Z)).collect()
            }
            None => model::smooth_normals(&positions, &triangles),
        };
        let material = p.material().index();
        let (set, transform) = material.and_then(|m| self.placements.get(m).copied()).unwrap_or((0, None));
        let uvs: Vec<Vec2> = match p.get(&TexCoords(set)) {
            Some(a) => {
                let given: Vec<[f32; 2]> = accessor::vectors(self.buffers, &a, "texture coordinates")?;
                let put = |uv| transform.map_or(uv, |t| t.transform_point2(uv));
                given.into_iter().map(|uv| put(Vec2::from(uv))).collect()
            }
            None => vec![Vec2::ZERO; n],
        };
        let mesh = Mesh { positions, normals, uvs, triangles, material: material.unwrap_or(default) };
        self.model.meshes.push(mesh);
        Ok(material.is_none())
    }
}

/// A list, strip or fan as a list; what strips use to turn round is left out.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    let kept = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    match mode {
        Mode::TriangleStrip => {
            let turn = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] };
            indices.windows(3).enumerate().map(turn).filter(kept).collect()
        }
        Mode::TriangleFan => {
            let Some((&first, rest)) = indices.split_first() else { return vec![] };
            rest.windows(2).map(|w| [first, w[0], w[1]]).filter(kept).collect()
        }
        _ => indices.as_chunks().0.to_vec(),
    }
}

/// glTF is y up, right-handed: `(x, y, z) → (x, -z, y)`.
fn y_up_to_z_up() -> Mat4 {
    Mat4::from_cols_array_2d(&[[1., 0., 0., 0.], [0., 0., 1., 0.], [0., -1., 0., 0.], [0., 0., 0., 1.]])
}
