//! Observations of a tabletop scene: colour, exact metric depth and instance ids. On the CPU,
//! bit-identical for any number of threads, and with the feature `gpu` on a GPU. A [`Sensor`] makes of
//! them what a real camera would.

mod cpu;
mod glb;
mod gltf;
pub mod gpu;
mod light;
mod model;
mod obj;
mod scene;
mod sensor;

use std::path::Path;

pub use cpu::Renderer;
pub use glb::{save_glb, to_glb};
pub use gltf::{from_glb, load_gltf};
pub use light::{Light, SoftBox};
pub use model::{Material, Mesh, Model, ModelError, Texture};
pub use obj::load_obj;
pub use scene::{Amodal, Frame, Instance, RenderOptions, Scene, SceneError};
pub use sensor::{Sensor, SensorError};

/// Reads a model file by its extension: `.glb`, `.gltf` or `.obj`.
///
/// # Errors
/// [`ModelError`] that names the file and what is wrong with it.
pub fn load(path: impl AsRef<Path>) -> Result<Model, ModelError> {
    load_noted(path).map(|(model, _)| model)
}

/// As [`load`], and what was left out or stood for something else, a sentence each.
///
/// # Errors
/// As [`load`].
pub fn load_noted(path: impl AsRef<Path>) -> Result<(Model, Vec<String>), ModelError> {
    let path = path.as_ref();
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("glb" | "gltf") => gltf::load_noted(path),
        Some("obj") => obj::load_noted(path),
        _ => Err(ModelError::Invalid {
            path: path.display().to_string(),
            reason: "its name must end in .glb, .gltf or .obj".into(),
        }),
    }
}
