//! Python bindings of FUSE: convert, release the GIL, call, convert. No logic lives here.

mod array;
mod camera;
mod enter;
mod env;
mod error;
mod evidence;
mod objects;
mod randomized;
mod render;
mod splat;
mod splat_data;

use pyo3::prelude::*;

/// The compiled part of `fuse_grounding`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("simd_level", fuse_camera::simd::level().name())?;
    module.add_class::<camera::Camera>()?;
    error::register(module)?;
    render::register(module)?;
    env::register(module)?;
    objects::register(module)?;
    randomized::register(module)?;
    evidence::register(module)?;
    splat::register(module)?;
    splat_data::register(module)
}
