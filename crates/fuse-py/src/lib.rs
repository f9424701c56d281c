//! Python bindings of FUSE: convert, release the GIL, call, convert. No logic lives here.

mod array;
mod camera;
mod enter;
mod error;

use pyo3::prelude::*;

/// The compiled part of `fuse_grounding`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("simd_level", fuse_camera::simd::level().name())?;
    module.add_class::<camera::Camera>()?;
    error::register(module)?;
    Ok(())
}

/// Adds `fill`'s contents as the submodule `name`, importable as `fuse_grounding._core.name`.
#[allow(dead_code)]
fn submodule(
    parent: &Bound<'_, PyModule>,
    name: &str,
    fill: impl FnOnce(&Bound<'_, PyModule>) -> PyResult<()>,
) -> PyResult<()> {
    let py = parent.py();
    let child = PyModule::new(py, name)?;
    fill(&child)?;
    parent.add_submodule(&child)?;
    py.import("sys")?.getattr("modules")?.set_item(format!("fuse_grounding._core.{name}"), &child)
}
