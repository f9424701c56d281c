//! `Camera`: intrinsics and pose.

use fuse_camera::{Pinhole, Pose};
use nalgebra::{Matrix3, Vector3};
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::array;
use crate::error::input;

/// A pinhole camera with its pose.
///
/// Camera(width, height, fx, fy, cx, cy, rotation, translation)
///
/// rotation: (3, 3) numbers, world to camera; translation: (3,) numbers, metres; so that
/// x_camera = rotation @ x_world + translation. World: right-handed, z up. Camera: x right,
/// y down, z forward. Pixel centres are at half-integers. Raises InputError on values that are
/// not finite or a rotation that is not orthonormal (1e-6).
#[pyclass(frozen, from_py_object, module = "fuse_grounding")]
#[derive(Clone)]
pub struct Camera {
    pub inner: fuse_camera::Camera,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width, height, fx, fy, cx, cy, rotation, translation))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        width: &Bound<'_, PyAny>,
        height: &Bound<'_, PyAny>,
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        rotation: &Bound<'_, PyAny>,
        translation: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let (width, height) = (array::whole("width", width)?, array::whole("height", height)?);
        let intrinsics = Pinhole::new(width, height, fx, fy, cx, cy).map_err(|e| input(e.to_string()))?;
        let rotation = array::floats("rotation", rotation, &[3, 3])?;
        let translation = array::floats("translation", translation, &[3])?;
        let (r, t) = (rotation.as_array(), translation.as_array());
        let matrix = Matrix3::from_fn(|i, j| r[[i, j]]);
        let translation = Vector3::from_fn(|i, _| t[i]);
        if !translation.iter().all(|v| v.is_finite()) {
            return Err(input("translation must be finite"));
        }
        let skew = (matrix * matrix.transpose() - Matrix3::identity()).norm();
        if skew.is_nan() || skew >= 1e-6 || matrix.determinant() < 0.0 {
            return Err(input(format!(
                "rotation must be orthonormal with determinant 1, found |RRᵀ - 1| = {skew:.2e}"
            )));
        }
        Ok(Self { inner: fuse_camera::Camera { intrinsics, pose: Pose::from_matrix(matrix, translation) } })
    }

    #[getter]
    fn width(&self) -> u32 {
        self.inner.intrinsics.width
    }
    #[getter]
    fn height(&self) -> u32 {
        self.inner.intrinsics.height
    }
    #[getter]
    fn fx(&self) -> f64 {
        self.inner.intrinsics.fx
    }
    #[getter]
    fn fy(&self) -> f64 {
        self.inner.intrinsics.fy
    }
    #[getter]
    fn cx(&self) -> f64 {
        self.inner.intrinsics.cx
    }
    #[getter]
    fn cy(&self) -> f64 {
        self.inner.intrinsics.cy
    }
    /// (3, 3) float64, world to camera.
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let m = self.inner.pose.rotation.to_rotation_matrix();
        numpy::ndarray::Array2::from_shape_fn((3, 3), |(i, j)| m[(i, j)]).into_pyarray(py)
    }
    /// (3,) float64, metres, world to camera.
    #[getter]
    fn translation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.inner.pose.translation.as_slice().to_vec().into_pyarray(py)
    }
    /// Camera centre in the world, (3,) float64, metres.
    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.inner.pose.center().coords.as_slice().to_vec().into_pyarray(py)
    }
    /// The same view at another image size.
    fn resized(&self, width: u32, height: u32) -> PyResult<Self> {
        let intrinsics = self.inner.intrinsics.resized(width, height).map_err(|e| input(e.to_string()))?;
        Ok(Self { inner: fuse_camera::Camera { intrinsics, pose: self.inner.pose } })
    }
    fn __repr__(&self) -> String {
        let (k, c) = (&self.inner.intrinsics, self.inner.pose.center());
        format!("Camera({}x{}, fx={:.2}, center=({:.3}, {:.3}, {:.3}))", k.width, k.height, k.fx, c.x, c.y, c.z)
    }
}
