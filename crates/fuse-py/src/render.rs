//! Model files and the tabletop renderer.

use std::sync::Arc;

use fuse_camera::gpu::{GpuError, Software};
use fuse_render::gpu::{Choice, RenderError};
use fuse_render::{Instance, Light, Material, Mesh, RenderOptions, Scene};
use glam::{Affine3A, Mat4, Vec2, Vec3};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::array;
use crate::camera::Camera;
use crate::enter::enter;
use crate::error::input;

/// A textured triangle model, metres, z up. Made by load_model().
#[pyclass(frozen, module = "fuse_grounding")]
pub struct Model {
    pub inner: Arc<fuse_render::Model>,
}

type Frame<'py> = (Bound<'py, PyArray3<u8>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>);

#[pymethods]
impl Model {
    /// Number of triangles.
    #[getter]
    fn triangle_count(&self) -> usize {
        self.inner.triangle_count()
    }
    /// Axis-aligned bounds ((x, y, z) low, (x, y, z) high), metres.
    #[getter]
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        let (lo, hi) = self.inner.bounds().unwrap_or_default();
        (lo.to_array(), hi.to_array())
    }
    /// Names of the materials.
    #[getter]
    fn materials(&self) -> Vec<String> {
        self.inner.materials.iter().map(|m| m.name.clone()).collect()
    }
    /// Writes a GLB file; the same model gives the same bytes.
    fn save_glb(&self, py: Python<'_>, path: std::path::PathBuf) -> PyResult<()> {
        enter(py, || fuse_render::save_glb(&self.inner, path))
    }
    fn __repr__(&self) -> String {
        let (lo, hi) = self.bounds();
        let size: Vec<String> = (0..3).map(|i| format!("{:.3}", hi[i] - lo[i])).collect();
        format!("Model({} triangles, {} m)", self.triangle_count(), size.join(" x "))
    }
}

/// Reads a model file: .glb, .gltf or .obj. Raises InputError that names the file and its fault.
#[pyfunction]
fn load_model(py: Python<'_>, path: std::path::PathBuf) -> PyResult<Model> {
    let inner = enter(py, || fuse_render::load(path))?;
    Ok(Model { inner: Arc::new(inner) })
}

/// Renders models on a plain grey floor.
///
/// models: list of Model; transforms: (N, 4, 4) float32, world from model; camera: Camera;
/// ids: list of N instance ids (1..N unless given); floor: height of the floor in metres, None
/// for none; background: linear RGB where nothing is hit; shadows: soft shadow and ambient
/// occlusion; device: `cpu`, `gpu`, or `auto` for a real GPU if there is one, else the CPU.
///
/// Returns (rgb (H, W, 3) uint8, depth (H, W) float32 metres with 0 for nothing, ids (H, W)
/// uint32).
#[pyfunction]
#[pyo3(signature = (models, transforms, camera, *, ids=None, floor=Some(0.0), background=[0.55, 0.57, 0.6], shadows=true, device="cpu"))]
#[allow(clippy::too_many_arguments)]
fn render_models<'py>(
    py: Python<'py>,
    models: Vec<PyRef<'py, Model>>,
    transforms: &Bound<'py, PyAny>,
    camera: &Camera,
    ids: Option<Vec<u32>>,
    floor: Option<f32>,
    background: [f32; 3],
    shadows: bool,
    device: &str,
) -> PyResult<Frame<'py>> {
    let view = array::view::<f32>("transforms", transforms, 3, "(N, 4, 4) float32")?;
    let flat = view.as_slice().map_err(|_| input("transforms must be contiguous"))?;
    if view.as_array().shape() != [models.len(), 4, 4] {
        return Err(input(format!(
            "transforms must have shape ({}, 4, 4), one for each model, found {:?}",
            models.len(),
            view.as_array().shape()
        )));
    }
    array::finite("transforms", flat)?;
    let ids = ids.unwrap_or_else(|| (1..=models.len() as u32).collect());
    if ids.len() != models.len() {
        return Err(input(format!("ids must hold one id for each of {} models, found {}", models.len(), ids.len())));
    }
    if floor.is_some_and(|z| !z.is_finite()) {
        return Err(input("floor must be finite"));
    }
    let mut instances: Vec<Instance> = Vec::with_capacity(models.len() + 1);
    for ((model, matrix), id) in models.iter().zip(flat.as_chunks::<16>().0).zip(ids) {
        let matrix = Mat4::from_cols_array(matrix).transpose();
        if matrix.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(input("the last row of each transform must be (0, 0, 0, 1)"));
        }
        instances.push(Instance { model: model.inner.clone(), transform: Affine3A::from_mat4(matrix), id });
    }
    instances.extend(floor.map(floor_instance));
    // The lamp stands as high over this floor as over a table by default.
    let mut light = Light::default();
    light.position.z += floor.unwrap_or(0.0) - 0.75;
    let scene = Scene { instances, light, background: Vec3::from(background) };
    let options = RenderOptions { shadows, ambient_occlusion: shadows, ..RenderOptions::default() };
    let camera = camera.inner;
    let choice = enter(py, || take(device))?;
    let frame = enter(py, move || {
        let prepared = choice.prepare(scene, &options)?;
        Ok::<_, RenderError>(prepared.render(&camera)?)
    })?;
    let (w, h) = (frame.rgb.width(), frame.rgb.height());
    let rgb = frame.rgb.into_vec().into_flattened();
    Ok((
        array::into_3d(py, rgb, w, h, 3)?,
        array::into_2d(py, frame.depth.into_vec(), w, h)?,
        array::into_2d(py, frame.instance.into_vec(), w, h)?,
    ))
}

/// What `cpu`, `gpu` or `auto` takes on this machine.
pub fn take(device: &str) -> Result<Choice, GpuError> {
    Choice::take(device.parse()?, Software::from_env())
}

/// Its name.
#[pyfunction]
fn render_device(py: Python<'_>, device: &str) -> PyResult<String> {
    enter(py, || take(device).map(|choice| choice.to_string()))
}

/// A matt grey square of 20 m.
fn floor_instance(height: f32) -> Instance {
    let corners = [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)];
    let mesh = Mesh {
        positions: corners.iter().map(|&(x, y)| Vec3::new(x, y, 0.0)).collect(),
        normals: vec![Vec3::Z; 4],
        uvs: vec![Vec2::ZERO; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material: 0,
    };
    let material = Material { base_color: [0.5, 0.5, 0.5, 1.0], roughness: 0.9, ..Material::default() };
    let model = fuse_render::Model { meshes: vec![mesh], materials: vec![material] };
    Instance { model: Arc::new(model), transform: Affine3A::from_translation(Vec3::Z * height), id: 0 }
}

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Model>()?;
    module.add_function(wrap_pyfunction!(load_model, module)?)?;
    module.add_function(wrap_pyfunction!(render_device, module)?)?;
    module.add_function(wrap_pyfunction!(render_models, module)?)
}
