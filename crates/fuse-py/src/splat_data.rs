//! Folders of posed photos to train on, and how close a map comes to them.

use std::path::PathBuf;

use fuse_camera::RgbBuffer;
use fuse_splat::SplatError;
use fuse_splat::data::{Dataset, Photo};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::array;
use crate::camera::Camera;
use crate::enter::enter;
use crate::error::input;
use crate::splat::Gaussians;

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<SplatDataset>()?;
    module.add_function(wrap_pyfunction!(splat_quality, module)?)?;
    module.add_function(wrap_pyfunction!(ssim, module)?)
}

/// Views and sparse points of a COLMAP or nerfstudio folder. Photos are read on demand.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct SplatDataset {
    inner: Dataset,
}

type Points<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>);
type Read<'py> = (Bound<'py, PyArray3<u8>>, Camera);

impl SplatDataset {
    fn view(&self, index: usize) -> Result<&fuse_splat::data::SourceView, SplatError> {
        let count = self.inner.views.len();
        self.inner
            .views
            .get(index)
            .ok_or_else(|| SplatError::Input(format!("view {index} does not exist, there are {count}")))
    }
}

#[pymethods]
impl SplatDataset {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        enter(py, || Dataset::open(&folder)).map(|inner| Self { inner })
    }
    /// `colmap` or `nerfstudio`.
    #[getter]
    fn kind(&self) -> &'static str {
        self.inner.kind
    }
    /// Of the views, sorted.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.inner.views.iter().map(|v| v.name.clone()).collect()
    }
    /// What was left out or made up.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.inner.notes.clone()
    }
    /// Positions (N, 3) and colours (N, 3) in [0, 1] of the sparse points, float32.
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Points<'py>> {
        let flat = |list: &[[f32; 3]]| array::into_2d(py, list.as_flattened().to_vec(), 3, list.len() as u32);
        Ok((flat(&self.inner.xyz)?, flat(&self.inner.rgb)?))
    }
    /// The camera of a view whose photo is made `downscale` times smaller, without distortion.
    fn camera(&self, py: Python<'_>, index: usize, downscale: u32) -> PyResult<Camera> {
        enter(py, || self.view(index)?.camera_at(downscale)).map(|inner| Camera { inner })
    }
    /// Photos, decoded in parallel, undistorted and made smaller, with their cameras.
    #[allow(clippy::needless_pass_by_value, reason = "lists arrive as vectors")]
    fn read<'py>(&self, py: Python<'py>, indices: Vec<usize>, downscale: u32) -> PyResult<Vec<Read<'py>>> {
        let read = || indices.par_iter().map(|&i| self.view(i)?.read(downscale)).collect::<Result<Vec<_>, _>>();
        enter(py, read)?.into_iter().map(|photo| to_python(py, photo)).collect()
    }
    fn __len__(&self) -> usize {
        self.inner.views.len()
    }
}

fn to_python(py: Python<'_>, photo: Photo) -> PyResult<Read<'_>> {
    let (w, h) = (photo.image.width(), photo.image.height());
    let image = array::into_3d(py, photo.image.into_vec().into_flattened(), w, h, 3)?;
    Ok((image, Camera { inner: photo.camera }))
}

fn picture(name: &str, image: &Bound<'_, PyAny>) -> PyResult<RgbBuffer> {
    let view = array::view::<u8>(name, image, 3, "(H, W, 3) uint8")?;
    let (pixels, width, height) = array::rgb(name, &view)?;
    RgbBuffer::from_vec(width, height, pixels.to_vec()).map_err(|e| input(e.to_string()))
}

/// PSNR (decibel) and SSIM of a rendering, in 8 bits, against an (H, W, 3) uint8 image.
#[pyfunction]
fn splat_quality(
    py: Python<'_>,
    gaussians: &Gaussians,
    camera: &Camera,
    image: &Bound<'_, PyAny>,
    background: [f32; 3],
) -> PyResult<(f64, f64)> {
    let image = picture("image", image)?;
    let quality = enter(py, || fuse_splat::quality(&gaussians.inner, &camera.inner, &image, background))?;
    Ok((quality.psnr, quality.ssim))
}

/// Structural similarity of two (H, W, 3) uint8 images.
#[pyfunction]
fn ssim(py: Python<'_>, a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> PyResult<f64> {
    let (a, b) = (picture("a", a)?, picture("b", b)?);
    enter(py, || fuse_splat::ssim(&a, &b))
}
