//! Randomised training pictures.

use fuse_env::catalogue::Split;
use fuse_env::randomized::{self, Options, Picture};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::array::{into_2d, into_3d};
use crate::enter::enter;
use crate::error::input;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(randomized_pictures, module)?)
}

/// randomized_pictures(seed, count, *, width=640, height=480, split="train", amodal=False)
///
/// `count` randomised tabletop pictures of `seed`: a list of (rgb (H, W, 3) uint8, ids (H, W) uint32,
/// objects), an object being {"id", "category", "visible_px", "unoccluded_px"}. Sixteen pictures share a
/// room. `split` is "train" or "dev"; unoccluded_px is 0 unless `amodal`. The same bits for the same
/// arguments. Raises InputError for another split and for an empty picture.
#[pyfunction]
#[pyo3(signature = (seed, count, *, width=640, height=480, split="train", amodal=false))]
fn randomized_pictures<'py>(
    py: Python<'py>,
    seed: u64,
    count: usize,
    width: u32,
    height: u32,
    split: &str,
    amodal: bool,
) -> PyResult<Bound<'py, PyList>> {
    let split = match split {
        "train" => Split::Train,
        "dev" => Split::Dev,
        other => return Err(input(format!("split must be `train` or `dev`, found `{other}`"))),
    };
    let options = Options { width, height, split, amodal };
    let pictures = enter(py, || randomized::pictures(seed, count, &options))?;
    let list = PyList::empty(py);
    for picture in pictures {
        list.append(convert(py, picture, width, height)?)?;
    }
    Ok(list)
}

fn convert<'py>(py: Python<'py>, picture: Picture, width: u32, height: u32) -> PyResult<Bound<'py, PyAny>> {
    let objects = PyList::empty(py);
    for seen in &picture.objects {
        let object = PyDict::new(py);
        object.set_item("id", seen.id)?;
        object.set_item("category", seen.category.id())?;
        object.set_item("visible_px", seen.visible_px)?;
        object.set_item("unoccluded_px", seen.unoccluded_px)?;
        objects.append(object)?;
    }
    let rgb = into_3d(py, picture.rgb.into_vec().into_flattened(), width, height, 3)?;
    let ids = into_2d(py, picture.ids.into_vec(), width, height)?;
    Ok((rgb, ids, objects).into_pyobject(py)?.into_any())
}
