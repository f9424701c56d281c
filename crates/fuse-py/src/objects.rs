//! The object catalogue: generating, importing, listing, preview pictures.

use std::collections::BTreeMap;
use std::path::PathBuf;

use fuse_env::catalogue::{self, Category, ObjectRecord, Split};
use fuse_env::import::{self, Import, ImportOptions};
use fuse_env::library;
use fuse_env::objects::preview::preview;
use fuse_render::Model;
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::array::into_3d;
use crate::enter::enter;
use crate::error::input;

/// A folder with `catalogue.json` and the model files that it names.
///
/// ObjectCatalogue(directory)
///
/// Raises InputError that names the file when something is missing or not what it should be.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct ObjectCatalogue {
    inner: catalogue::Catalogue,
}

impl ObjectCatalogue {
    fn record(&self, id: &str) -> PyResult<&ObjectRecord> {
        self.inner.get(id).ok_or_else(|| input(format!("the catalogue has no object `{id}`")))
    }
}

#[pymethods]
impl ObjectCatalogue {
    #[new]
    fn new(py: Python<'_>, directory: &str) -> PyResult<Self> {
        Ok(Self { inner: enter(py, || catalogue::Catalogue::load(directory))? })
    }

    fn __len__(&self) -> usize {
        self.inner.records().len()
    }

    /// All objects as dictionaries: id, category, split, file, size_m, seed, resting (a list of
    /// dictionaries with quaternion [x, y, z, w], height, probability); of an imported one, seed is
    /// None and `imported` tells of its file.
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let rows = self.inner.records().iter().map(|r| row(py, r)).collect::<PyResult<Vec<_>>>()?;
        PyList::new(py, rows)
    }

    /// Where an object's model file lies.
    fn path(&self, id: &str) -> PyResult<String> {
        Ok(self.inner.path(self.record(id)?).display().to_string())
    }

    /// (pixels, pixels, 3) uint8 sRGB picture of an object in its `pose`-th resting pose, turned
    /// by `yaw` radians, on a plain table, by a camera that looks down by `down` degrees.
    #[pyo3(signature = (id, pixels=160, yaw=0.5, pose=0, down=32.0))]
    fn preview<'py>(
        &self,
        py: Python<'py>,
        id: &str,
        pixels: u32,
        yaw: f32,
        pose: usize,
        down: f64,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let record = self.record(id)?;
        let model = enter(py, || self.inner.model(record))?;
        picture(py, record, &model, (pixels, yaw, pose, down))
    }

    /// What the library says about categories: category -> verb -> reason why it is valid for it.
    fn valid_for(&self) -> BTreeMap<&'static str, BTreeMap<String, String>> {
        self.inner.categories().iter().map(|c| (c.id.id(), c.valid_for.clone())).collect()
    }
}

/// A record's model in a resting pose.
fn picture<'py>(
    py: Python<'py>,
    record: &ObjectRecord,
    model: &Model,
    (pixels, yaw, pose, down): (u32, f32, usize, f64),
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    if !(16..=2048).contains(&pixels) || !yaw.is_finite() {
        return Err(input(format!("pixels must be in 16 to 2048 and yaw finite, found {pixels} and {yaw}")));
    }
    if !(1.0..=89.0).contains(&down) {
        return Err(input(format!("down must be 1 to 89 degrees, found {down}")));
    }
    let Some(resting) = record.resting.get(pose) else {
        return Err(input(format!("`{}` has {} resting poses, no pose {pose}", record.id, record.resting.len())));
    };
    let picture = enter(py, || preview(model, resting, yaw, down, pixels))?;
    into_3d(py, picture.as_slice().as_flattened().to_vec(), pixels, pixels, 3)
}

/// A model file turned into an object, not yet in a library.
///
/// ImportedObject(path, category, split="eval", metres_per_unit=1.0, up=None, id=None)
///
/// A category that the shipped set does not have is a new one. `up`: the file's axis that points up,
/// by default y for glTF and z for OBJ. Raises InputError that names the file when it cannot be an
/// object.
#[pyclass(frozen, module = "fuse_grounding")]
pub struct ImportedObject {
    inner: Import,
}

#[pymethods]
impl ImportedObject {
    #[new]
    #[pyo3(signature = (path, category, split="eval", metres_per_unit=1.0, up=None, id=None))]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        category: &str,
        split: &str,
        metres_per_unit: f64,
        up: Option<&str>,
        id: Option<String>,
    ) -> PyResult<Self> {
        let category = Category::named(category).map_err(|e| input(e.to_string()))?;
        let split: Split = split.parse().map_err(|e: catalogue::CatalogueError| input(e.to_string()))?;
        let up = up.map(str::parse).transpose().map_err(|e: String| input(e))?;
        let options = ImportOptions { category, split, metres_per_unit, up, id };
        Ok(Self { inner: enter(py, || import::import(&path, &options))? })
    }

    /// As one of `ObjectCatalogue.records()`.
    fn record<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        row(py, &self.inner.record)
    }

    /// As `ObjectCatalogue.preview`.
    #[pyo3(signature = (pixels=160, yaw=0.5, pose=0, down=32.0))]
    fn preview<'py>(
        &self,
        py: Python<'py>,
        pixels: u32,
        yaw: f32,
        pose: usize,
        down: f64,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        picture(py, &self.inner.record, &self.inner.model, (pixels, yaw, pose, down))
    }

    /// Puts it into a library with a picture of it (PNG bytes); `verbs`: what its category is valid
    /// for. Raises InputError when the library has an object of that name, unless `replace`.
    #[pyo3(signature = (library, png, verbs, replace=false))]
    fn save(&self, py: Python<'_>, library: PathBuf, png: &[u8], verbs: Vec<String>, replace: bool) -> PyResult<()> {
        enter(py, || library::add(&library, &self.inner, png, &verbs, replace))
    }
}

/// Metres of a unit: m, cm, mm, in.
#[pyfunction]
fn unit_metres(name: &str) -> PyResult<f64> {
    import::unit(name).map_err(input)
}

/// Longest side of most things of a category, metres, from and to; None for one that is not shipped.
#[pyfunction]
fn typical_size(category: &str) -> Option<[f64; 2]> {
    category.parse().ok().and_then(import::typical)
}

fn row<'py>(py: Python<'py>, record: &ObjectRecord) -> PyResult<Bound<'py, PyDict>> {
    let poses = record
        .resting
        .iter()
        .map(|pose| {
            let d = PyDict::new(py);
            d.set_item("quaternion", pose.quaternion)?;
            d.set_item("height", pose.height)?;
            d.set_item("probability", pose.probability)?;
            Ok(d)
        })
        .collect::<PyResult<Vec<_>>>()?;
    let d = PyDict::new(py);
    d.set_item("id", &record.id)?;
    d.set_item("category", record.category.id())?;
    d.set_item("split", record.split.id())?;
    d.set_item("file", &record.file)?;
    d.set_item("size_m", record.size_m)?;
    d.set_item("seed", record.seed)?;
    d.set_item("resting", poses)?;
    if let Some(found) = &record.imported {
        // As the file has it.
        let text = serde_json::to_string(found).map_err(|e| input(format!("`{}`: {e}", record.id)))?;
        d.set_item("imported", py.import("json")?.call_method1("loads", (text,))?)?;
    }
    Ok(d)
}

/// (id, label for people) of every category that can be generated.
#[pyfunction]
fn object_categories() -> Vec<(&'static str, &'static str)> {
    Category::ALL.iter().map(|c| (c.id(), c.label())).collect()
}

/// Writes a catalogue of generated objects into a folder: a GLB each and catalogue.json, the
/// same bytes every time. `categories`: ids, every one when None. Returns the objects' ids.
#[pyfunction]
#[pyo3(signature = (directory, categories=None))]
fn write_objects(py: Python<'_>, directory: &str, categories: Option<Vec<String>>) -> PyResult<Vec<String>> {
    let chosen = match categories {
        None => Category::ALL.to_vec(),
        Some(ids) => {
            ids.iter().map(|id| id.parse().map_err(|e| input(format!("{e}")))).collect::<PyResult<Vec<Category>>>()?
        }
    };
    let records = enter(py, || catalogue::write(directory, &chosen))?;
    Ok(records.into_iter().map(|r| r.id).collect())
}

/// Writes one generated object, any seed, as a GLB.
#[pyfunction]
fn write_object(py: Python<'_>, path: &str, category: &str, split: &str, seed: u64) -> PyResult<()> {
    let category: Category = category.parse().map_err(|e| input(format!("{e}")))?;
    let split: Split = split.parse().map_err(|e| input(format!("{e}")))?;
    let Some(model) =
        enter(py, || Ok::<_, fuse_render::ModelError>(fuse_env::objects::generate(category, split, seed)))?
    else {
        return Err(input(format!("category `{category}` has no generator")));
    };
    enter(py, || fuse_render::save_glb(&model, path))
}

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<ObjectCatalogue>()?;
    module.add_class::<ImportedObject>()?;
    module.add_function(wrap_pyfunction!(unit_metres, module)?)?;
    module.add_function(wrap_pyfunction!(typical_size, module)?)?;
    module.add_function(wrap_pyfunction!(object_categories, module)?)?;
    module.add_function(wrap_pyfunction!(write_objects, module)?)?;
    module.add_function(wrap_pyfunction!(write_object, module)?)
}
