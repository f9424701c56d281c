//! Rust errors become typed Python exceptions, here and nowhere else.
//!
//! `FuseError(Exception)` is the root; `InputError(FuseError, ValueError)` is anything that the
//! caller can put right: the command line turns it into exit status 2.

use std::any::Any;
use std::fmt::Display;

use fuse_camera::gpu::GpuError;
use fuse_env::world::WorldError;
use fuse_render::gpu::RenderError;
use fuse_splat::SplatError;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyTuple, PyType};

static FUSE_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static INPUT_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();

fn new_type(py: Python<'_>, name: &str, doc: &str, bases: Bound<'_, PyTuple>) -> PyResult<Py<PyType>> {
    let namespace = pyo3::types::PyDict::new(py);
    namespace.set_item("__module__", "fuse_grounding.errors")?;
    namespace.set_item("__doc__", doc)?;
    Ok(py.get_type::<PyType>().call1((name, bases, namespace))?.cast_into::<PyType>()?.unbind())
}

/// Adds the exception types to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let root = FUSE_ERROR.get_or_try_init(py, || {
        new_type(
            py,
            "FuseError",
            "Root of every error that FUSE raises.",
            PyTuple::new(py, [py.get_type::<PyException>()])?,
        )
    })?;
    let input = INPUT_ERROR.get_or_try_init(py, || {
        let bases = PyTuple::new(py, [root.bind(py).clone(), py.get_type::<PyValueError>()])?;
        new_type(py, "InputError", "An argument or a file is not what was expected; the message names it.", bases)
    })?;
    module.add("FuseError", root)?;
    module.add("InputError", input)
}

/// An `InputError` with this message.
pub fn input(message: impl Into<String>) -> PyErr {
    typed(&INPUT_ERROR, message.into())
}

/// An error as Python sees it: an `InputError`, or a `FuseError` where the machine failed.
pub fn raise<E: Display + 'static>(error: &E) -> PyErr {
    let any = error as &dyn Any;
    let gpu = match (any.downcast_ref(), any.downcast_ref()) {
        (Some(WorldError::Gpu(gpu)), _) | (_, Some(RenderError::Gpu(gpu))) => Some(gpu),
        _ => any.downcast_ref(),
    };
    let failed = any.downcast_ref().is_some_and(SplatError::is_failure) || gpu.is_some_and(GpuError::is_failure);
    typed(if failed { &FUSE_ERROR } else { &INPUT_ERROR }, error.to_string())
}

fn typed(kind: &PyOnceLock<Py<PyType>>, message: String) -> PyErr {
    Python::attach(|py| match kind.get(py) {
        Some(t) => PyErr::from_type(t.bind(py).clone(), message),
        None => PyValueError::new_err(message),
    })
}
