//! Materials and textures of glTF files.

use std::path::Path;
use std::sync::Arc;

use glam::{Affine2, Vec2};

use super::accessor::view_bytes;
use super::container::read_uri;
use crate::model::{self, Material, Texture};

/// Texels of all textures of a file, at most: four of the largest.
const MOST_TEXELS: usize = 4 * (model::MAX_TEXTURE_SIDE as usize) * (model::MAX_TEXTURE_SIDE as usize);

/// A material with how its texture is put on.
pub struct Painted {
    pub material: Material,
    /// Set of texture coordinates.
    pub set: u32,
    /// What is done to them.
    pub transform: Option<Affine2>,
}

/// Textures of a file by image, each decoded at first use.
pub struct Textures<'a> {
    pub buffers: &'a [Vec<u8>],
    pub folder: Option<&'a Path>,
    decoded: Vec<Option<Arc<Texture>>>,
    texels: usize,
}

impl<'a> Textures<'a> {
    pub fn new(buffers: &'a [Vec<u8>], folder: Option<&'a Path>, images: usize) -> Self {
        Self { buffers, folder, decoded: vec![None; images], texels: 0 }
    }

    fn of(&mut self, image: &gltf::Image<'_>) -> Result<Arc<Texture>, String> {
        let i = image.index();
        if let Some(Some(texture)) = self.decoded.get(i) {
            return Ok(texture.clone());
        }
        let (bytes, name) = match image.source() {
            gltf::image::Source::View { view, .. } => (view_bytes(self.buffers, &view)?.to_vec(), format!("image {i}")),
            gltf::image::Source::Uri { uri, .. } => {
                let name = if uri.starts_with("data:") { format!("image {i}") } else { format!("image {i} ({uri})") };
                (read_uri(uri, self.folder)?, name)
            }
        };
        let texture = Arc::new(model::decode_texture(&bytes).map_err(|e| format!("{name} {e}"))?);
        self.texels += texture.texels.len();
        if self.texels > MOST_TEXELS {
            return Err(format!("its textures have more than {MOST_TEXELS} texels together; make them smaller"));
        }
        self.decoded[i] = Some(texture.clone());
        Ok(texture)
    }
}

/// A material as metal and roughness; says in `notes` what it stood for.
pub fn material(
    m: &gltf::Material<'_>,
    textures: &mut Textures<'_>,
    notes: &mut Vec<String>,
) -> Result<Painted, String> {
    let pbr = m.pbr_metallic_roughness();
    let (mut color, mut info) = (pbr.base_color_factor(), pbr.base_color_texture());
    let (mut metallic, mut roughness) = (pbr.metallic_factor(), pbr.roughness_factor());
    let mut note = |text: &str| {
        if !notes.iter().any(|n| n == text) {
            notes.push(text.to_owned());
        }
    };
    if let Some(old) = m.pbr_specular_glossiness() {
        (color, info) = (old.diffuse_factor(), old.diffuse_texture());
        (metallic, roughness) = (0.0, 1.0 - old.glossiness_factor());
        note("KHR_materials_pbrSpecularGlossiness: diffuse colour and gloss are taken, specular colour is not");
    } else if m.unlit() {
        (metallic, roughness) = (0.0, 1.0);
        note("KHR_materials_unlit: drawn lit, as a matt surface of that colour");
    }
    let texture = info.as_ref().map(|info| textures.of(&info.texture().source())).transpose()?;
    let transform = info.as_ref().and_then(gltf::texture::Info::texture_transform);
    let set = transform.as_ref().and_then(gltf::texture::TextureTransform::tex_coord);
    Ok(Painted {
        set: set.or_else(|| info.as_ref().map(gltf::texture::Info::tex_coord)).unwrap_or(0),
        // Scaled, turned, shifted; glTF's angle runs against ours because v grows downwards.
        transform: transform.map(|t| {
            Affine2::from_scale_angle_translation(Vec2::from(t.scale()), -t.rotation(), Vec2::from(t.offset()))
        }),
        material: Material {
            name: m.name().unwrap_or_default().into(),
            base_color: color,
            base_color_texture: texture,
            metallic: metallic.clamp(0.0, 1.0),
            roughness: roughness.clamp(0.0, 1.0),
            double_sided: m.double_sided(),
        },
    })
}
