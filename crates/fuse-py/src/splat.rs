//! 3D Gaussians: files, rendering, training.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};

use fuse_camera::RgbBuffer;
use fuse_camera::gpu::Software;
use fuse_splat::constants::PARAMETERS;
use fuse_splat::gpu::Choice;
use fuse_splat::{LANES, RefineStats, SplatError, TrainerConfig};
use numpy::ndarray::{ArrayView3, Ix3};
use numpy::{PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array;
use crate::camera::Camera;
use crate::enter::enter;
use crate::error::input;

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Gaussians>()?;
    module.add_class::<SplatTrainer>()?;
    module.add_function(wrap_pyfunction!(render_gaussians, module)?)?;
    module.add_function(wrap_pyfunction!(splat_device, module)?)?;
    module.add_function(wrap_pyfunction!(checkpoint_note, module)?)?;
    module.add_function(wrap_pyfunction!(psnr, module)?)
}

/// An `(N, 3)` float32 array as triples, checked to be finite.
fn triples(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[f32; 3]>> {
    let view = array::view::<f32>(name, value, 2, "(N, 3) float32")?;
    if view.shape()[1] != 3 {
        return Err(input(format!("{name} must be a (N, 3) float32 array, found shape {:?}", view.shape())));
    }
    let flat = view.as_slice().map_err(|_| input(format!("{name} must be contiguous")))?;
    array::finite(name, flat)?;
    Ok(flat.as_chunks().0.to_vec())
}

/// A map of Gaussians. Read-only: training makes new ones.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct Gaussians {
    pub inner: fuse_splat::Gaussians,
}

#[pymethods]
impl Gaussians {
    /// xyz (N, 3) float32 metres, rgb (N, 3) float32 in [0, 1].
    #[staticmethod]
    fn from_points(py: Python<'_>, xyz: &Bound<'_, PyAny>, rgb: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (xyz, rgb) = (triples("xyz", xyz)?, triples("rgb", rgb)?);
        enter(py, || fuse_splat::Gaussians::from_points(&xyz, &rgb)).map(|inner| Self { inner })
    }
    #[staticmethod]
    fn from_ply(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        enter(py, || fuse_splat::Gaussians::from_ply(&path)).map(|inner| Self { inner })
    }
    fn save_ply(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        enter(py, || self.inner.save_ply(&path))
    }
    #[staticmethod]
    fn from_spz(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        enter(py, || fuse_splat::Gaussians::from_spz(&path)).map(|inner| Self { inner })
    }
    fn save_spz(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        enter(py, || self.inner.save_spz(&path))
    }
    /// (N, 59) float32, rearranged from [`Self::blocks`].
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let n = self.inner.len();
        let rows = py.detach(|| {
            let mut rows = Vec::with_capacity(PARAMETERS * n);
            (0..n).for_each(|i| rows.extend(self.inner.vector(i)));
            rows
        });
        array::into_2d(py, rows, PARAMETERS as u32, n as u32)
    }
    /// (blocks, 59, 8) float32: the memory itself, read-only.
    fn blocks<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let blocks = array::lend(slf)?;
        blocks.try_readwrite().map_err(|e| input(e.to_string()))?.make_nonwriteable();
        Ok(blocks)
    }
    fn __len__(&self) -> usize {
        self.inner.len()
    }
}

impl array::Lender for Gaussians {
    type Axes = Ix3;
    fn numbers(&self) -> PyResult<ArrayView3<'_, f32>> {
        let table = self.inner.table();
        ArrayView3::from_shape((table.blocks().len(), PARAMETERS, LANES), table.numbers())
            .map_err(|e| input(e.to_string()))
    }
}

/// What `cpu`, `gpu` or `auto` takes on this machine.
fn take(device: &str) -> Result<Choice, SplatError> {
    Choice::take(device.parse()?, Software::from_env())
}

/// Its name.
#[pyfunction]
fn splat_device(py: Python<'_>, device: &str) -> PyResult<String> {
    enter(py, || take(device).map(|choice| choice.to_string()))
}

type Rendered<'py> = (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>);

/// Image (H, W, 3) in [0, 1], alpha (H, W) in [0, 1], depth (H, W) metres.
#[pyfunction]
fn render_gaussians<'py>(
    py: Python<'py>,
    gaussians: &Gaussians,
    camera: &Camera,
    background: [f32; 3],
    device: &str,
) -> PyResult<Rendered<'py>> {
    if !background.iter().all(|v| (0.0..=1.0).contains(v)) {
        return Err(input(format!("background must be three numbers in [0, 1], found {background:?}")));
    }
    let r = enter(py, || take(device)?.render(&gaussians.inner, &camera.inner, background))?;
    let (w, h) = (r.alpha.width(), r.alpha.height());
    Ok((
        array::into_3d(py, r.color.into_vec().into_flattened(), w, h, 3)?,
        array::into_2d(py, r.alpha.into_vec(), w, h)?,
        array::into_2d(py, r.depth.into_vec(), w, h)?,
    ))
}

/// Peak signal-to-noise ratio of two (H, W, 3) float32 images in [0, 1], decibel.
#[pyfunction]
fn psnr(py: Python<'_>, a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> PyResult<f64> {
    let (a, b) =
        (array::view::<f32>("a", a, 3, "(H, W, 3) float32")?, array::view::<f32>("b", b, 3, "(H, W, 3) float32")?);
    if a.shape() != b.shape() {
        return Err(input(format!("a and b must have one shape, found {:?} and {:?}", a.shape(), b.shape())));
    }
    let contiguous = |_| input("images must be contiguous");
    let (a, b) = (a.as_slice().map_err(contiguous)?, b.as_slice().map_err(contiguous)?);
    array::finite("a", a)?;
    array::finite("b", b)?;
    enter(py, || fuse_splat::psnr(a, b))
}

/// The note of a checkpoint.
#[pyfunction]
fn checkpoint_note(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    enter(py, || fuse_splat::Trainer::checkpoint_note(&path))
}

/// Training that stops and resumes while views arrive.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct SplatTrainer {
    inner: Mutex<fuse_splat::Trainer>,
}

impl SplatTrainer {
    /// Taken without the GIL only: whoever holds the lock may be waiting for the GIL.
    fn lock(&self) -> Result<MutexGuard<'_, fuse_splat::Trainer>, SplatError> {
        self.inner.lock().map_err(|_| SplatError::Input("this trainer failed in an earlier call".into()))
    }
}

#[pymethods]
impl SplatTrainer {
    #[new]
    fn new(py: Python<'_>, gaussians: &Gaussians, config: &Bound<'_, PyDict>, device: &str) -> PyResult<Self> {
        let config = trainer_config(config)?;
        let trainer = enter(py, || take(device)?.trainer(gaussians.inner.clone(), config))?;
        Ok(Self { inner: Mutex::new(trainer) })
    }
    /// image (H, W, 3) uint8; returns the view's index.
    fn add_view(&self, py: Python<'_>, image: &Bound<'_, PyAny>, camera: &Camera) -> PyResult<usize> {
        let view = array::view::<u8>("image", image, 3, "(H, W, 3) uint8")?;
        let (pixels, width, height) = array::rgb("image", &view)?;
        enter(py, || {
            let image =
                RgbBuffer::from_vec(width, height, pixels.to_vec()).map_err(|e| SplatError::Input(e.to_string()))?;
            self.lock()?.add_view(&image, &camera.inner)
        })
    }
    fn set_camera(&self, py: Python<'_>, index: usize, camera: &Camera) -> PyResult<()> {
        enter(py, || self.lock()?.set_camera(index, &camera.inner))
    }
    /// Returns how many points were added.
    fn add_points(&self, py: Python<'_>, xyz: &Bound<'_, PyAny>, rgb: &Bound<'_, PyAny>) -> PyResult<usize> {
        let (xyz, rgb) = (triples("xyz", xyz)?, triples("rgb", rgb)?);
        enter(py, || self.lock()?.add_points(&xyz, &rgb))
    }
    /// Ctrl-C ends it after the iteration that it fell into. `following` more are to come in later
    /// calls.
    fn refine<'py>(&self, py: Python<'py>, iterations: u32, following: u32) -> PyResult<Bound<'py, PyDict>> {
        let mut interrupt = None;
        let mut proceed = || match Python::attach(|py| py.check_signals()) {
            Ok(()) => true,
            Err(e) => {
                interrupt = Some(e);
                false
            }
        };
        let stats = enter(py, || self.lock()?.refine_while(iterations, following, &mut proceed))?;
        match interrupt {
            Some(e) => Err(e),
            None => describe(py, &stats),
        }
    }
    /// A twin that goes its own way from here.
    fn fork(&self, py: Python<'_>) -> PyResult<Self> {
        enter(py, || self.lock().map(|t| t.fork())).map(|twin| Self { inner: Mutex::new(twin) })
    }
    fn gaussians(&self, py: Python<'_>) -> PyResult<Gaussians> {
        enter(py, || Ok::<_, SplatError>(self.lock()?.gaussians())).map(|inner| Gaussians { inner })
    }
    fn save_checkpoint(&self, py: Python<'_>, path: PathBuf, note: &str) -> PyResult<()> {
        enter(py, || self.lock()?.save_checkpoint(&path, note))
    }
    /// Returns the note.
    fn load_checkpoint(&self, py: Python<'_>, path: PathBuf) -> PyResult<String> {
        enter(py, || self.lock()?.load_checkpoint(&path))
    }
    /// What it runs on.
    fn device(&self, py: Python<'_>) -> PyResult<String> {
        enter(py, || self.lock().map(|t| t.runs_on()))
    }
    /// (iterations so far, views).
    fn progress(&self, py: Python<'_>) -> PyResult<(u32, usize)> {
        enter(py, || self.lock().map(|t| (t.iteration(), t.view_count())))
    }
}

/// The statistics of a call as a dictionary; stages as a dictionary in it.
fn describe<'py>(py: Python<'py>, stats: &RefineStats) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("iterations", stats.iterations)?;
    out.set_item("total_iterations", stats.total_iterations)?;
    out.set_item("loss_first", stats.loss_first)?;
    out.set_item("loss", stats.loss)?;
    out.set_item("gaussians", stats.gaussians)?;
    out.set_item("cloned", stats.changes.cloned)?;
    out.set_item("split", stats.changes.split)?;
    out.set_item("pruned", stats.changes.pruned)?;
    out.set_item("opacity_resets", stats.opacity_resets)?;
    out.set_item("seconds", stats.seconds)?;
    let stages = PyDict::new(py);
    let s = &stats.stages;
    for (name, seconds) in [
        ("project", s.project),
        ("sort", s.sort),
        ("intersect", s.intersect),
        ("rasterize", s.rasterize),
        ("loss", s.loss),
        ("rasterize_backward", s.rasterize_backward),
        ("project_backward", s.project_backward),
        ("densify", s.densify),
    ] {
        stages.set_item(name, seconds)?;
    }
    out.set_item("stage_seconds", stages)?;
    Ok(out)
}

/// Settings by name; what is not named keeps its default, an unknown name is refused.
fn trainer_config(settings: &Bound<'_, PyDict>) -> PyResult<TrainerConfig> {
    let mut c = TrainerConfig::default();
    for (key, value) in settings {
        let name: String = key.extract()?;
        macro_rules! fields {
            ($($field:ident),*) => {
                match name.as_str() {
                    $(stringify!($field) => {
                        c.$field = value.extract().map_err(|_| {
                            input(format!("{name} cannot be {value:?}"))
                        })?;
                    })*
                    _ => return Err(input(format!("unknown trainer setting `{name}`"))),
                }
            };
        }
        fields!(
            position_rate,
            position_rate_end,
            position_steps,
            feature_rate,
            opacity_rate,
            scale_rate,
            rotation_rate,
            lambda_dssim,
            degree,
            degree_interval,
            densify_start,
            densify_end,
            densify_interval,
            densify_gradient,
            dense_fraction,
            prune_opacity,
            prune_fraction,
            prune_radius,
            opacity_reset_interval,
            opacity_reset_margin,
            max_gaussians,
            fine_iterations,
            matched_low_pass,
            step_iterations,
            rate_gain,
            favour_new,
            extent,
            background,
            seed
        );
    }
    Ok(c)
}
