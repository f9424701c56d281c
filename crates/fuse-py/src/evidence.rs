//! Evidence maps, action scores, gate, stopping rule.

use fuse_camera::{ACTION_COUNT, Action, Buffer};
use fuse_evidence::depth::{DepthRange, region_depth};
use fuse_evidence::grounding::GroundingOptions;
use fuse_evidence::regions::{Coupled, Stride};
use fuse_evidence::ssnr::{Gradient, Normalization, Rendered, SsnrOptions, UncertaintyOptions};
use fuse_evidence::{EvidenceError, View, fusion, gate, grounding, patience, regions, semantic};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::array;
use crate::enter::enter;
use crate::error::input;

/// Adds this file's classes and functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Patience>()?;
    module.add_function(wrap_pyfunction!(ssnr, module)?)?;
    module.add_function(wrap_pyfunction!(geometric_uncertainty, module)?)?;
    module.add_function(wrap_pyfunction!(semantic_map, module)?)?;
    module.add_function(wrap_pyfunction!(fuse_maps, module)?)?;
    module.add_function(wrap_pyfunction!(functional_uncertainty, module)?)?;
    module.add_function(wrap_pyfunction!(action_regions, module)?)?;
    module.add_function(wrap_pyfunction!(action_scores, module)?)?;
    module.add_function(wrap_pyfunction!(choose_action, module)?)?;
    module.add_function(wrap_pyfunction!(action_entropy, module)?)?;
    module.add_function(wrap_pyfunction!(depth_proximity, module)?)?;
    module.add_function(wrap_pyfunction!(grounding_score, module)?)
}

/// The variant that a word stands for.
fn option<T: Copy>(name: &str, value: &str, known: &[(&str, T)]) -> PyResult<T> {
    known.iter().find(|(word, _)| *word == value).map(|(_, variant)| *variant).ok_or_else(|| {
        let words: Vec<String> = known.iter().map(|(word, _)| format!("'{word}'")).collect();
        input(format!("{name} must be {}, found '{value}'", words.join(" or ")))
    })
}

fn coupled_option(value: &str) -> PyResult<Coupled> {
    let known = [("union", Coupled::Union), ("quadrant", Coupled::Quadrant), ("mean", Coupled::Mean)];
    option("coupled", value, &known)
}

/// The elements of a contiguous array.
fn flat<'a, T: numpy::Element>(name: &str, array: &'a PyReadonlyArrayDyn<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| input(format!("{name} must be contiguous")))
}

/// An `(H, W)` array as an image.
fn image<'a, T: numpy::Element>(name: &'static str, array: &'a PyReadonlyArrayDyn<'_, T>) -> PyResult<View<'a, T>> {
    let shape = array.shape();
    checked(View::new(name, shape[1] as u32, shape[0] as u32, flat(name, array)?))
}

fn checked<T>(result: Result<T, EvidenceError>) -> PyResult<T> {
    result.map_err(|e| input(e.to_string()))
}

fn map<'py>(py: Python<'py>, buffer: Buffer<f32>) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (width, height) = (buffer.width(), buffer.height());
    array::lend_2d(py, buffer.into_vec(), width, height)
}

/// A rendering as it came: bytes or floats.
enum Rendering<'py> {
    U8(PyReadonlyArrayDyn<'py, u8>),
    F32(PyReadonlyArrayDyn<'py, f32>),
}

impl<'py> Rendering<'py> {
    fn new(value: &Bound<'py, PyAny>) -> PyResult<Self> {
        const EXPECTED: &str = "(H, W, 3) uint8 or float32";
        if value.cast::<PyArrayDyn<f32>>().is_ok() {
            array::view("rendered", value, 3, EXPECTED).map(Self::F32)
        } else {
            array::view("rendered", value, 3, EXPECTED).map(Self::U8)
        }
    }

    fn get(&self, float_render: bool) -> PyResult<Rendered<'_>> {
        match self {
            Self::U8(array) => {
                let (pixels, width, height) = array::rgb("rendered", array)?;
                Ok(Rendered::U8(checked(View::new("rendered", width, height, pixels))?))
            }
            Self::F32(array) => {
                let shape = array.shape();
                if shape[2] != 3 {
                    return Err(input(format!("rendered must have shape (H, W, 3), found shape {shape:?}")));
                }
                let (pixels, _) = flat("rendered", array)?.as_chunks::<3>();
                let view = checked(View::new("rendered", shape[1] as u32, shape[0] as u32, pixels))?;
                Ok(if float_render { Rendered::F32(view) } else { Rendered::Quantized(view) })
            }
        }
    }
}

/// Runs a comparison of an observation with a rendering without the GIL.
fn compare<'py>(
    py: Python<'py>,
    observed: &Bound<'py, PyAny>,
    rendered: Option<&Bound<'py, PyAny>>,
    float_render: bool,
    work: impl FnOnce(View<'_, [u8; 3]>, Option<Rendered<'_>>) -> Result<Buffer<f32>, EvidenceError> + Send,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let observed = array::view::<u8>("observed", observed, 3, "(H, W, 3) uint8")?;
    let (pixels, width, height) = array::rgb("observed", &observed)?;
    let view = checked(View::new("observed", width, height, pixels))?;
    let rendering = rendered.map(Rendering::new).transpose()?;
    let rendered = rendering.as_ref().map(|r| r.get(float_render)).transpose()?;
    let result = enter(py, || work(view, rendered))?;
    map(py, result)
}

fn ssnr_options(gradient: &str, gray_range: f32, missing_db: f32) -> PyResult<SsnrOptions> {
    let known = [("magnitude", Gradient::Magnitude), ("vector", Gradient::Vector)];
    Ok(SsnrOptions { gray_range, gradient: option("gradient", gradient, &known)?, missing_db })
}

/// SSNR in decibels; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (observed, rendered, gradient, gray_range, missing_db, float_render))]
fn ssnr<'py>(
    py: Python<'py>,
    observed: &Bound<'py, PyAny>,
    rendered: Option<&Bound<'py, PyAny>>,
    gradient: &str,
    gray_range: f32,
    missing_db: f32,
    float_render: bool,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let options = ssnr_options(gradient, gray_range, missing_db)?;
    compare(py, observed, rendered, float_render, |o, r| fuse_evidence::ssnr::ssnr(o, r, &options))
}

/// Geometric uncertainty; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (observed, rendered, alpha, normalization, gradient, gray_range, missing_db, float_render))]
#[allow(clippy::too_many_arguments)]
fn geometric_uncertainty<'py>(
    py: Python<'py>,
    observed: &Bound<'py, PyAny>,
    rendered: Option<&Bound<'py, PyAny>>,
    alpha: f32,
    normalization: &str,
    gradient: &str,
    gray_range: f32,
    missing_db: f32,
    float_render: bool,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let known = [("decibel", Normalization::Decibel), ("spatial", Normalization::Spatial)];
    let options = UncertaintyOptions {
        ssnr: ssnr_options(gradient, gray_range, missing_db)?,
        normalization: option("normalization", normalization, &known)?,
        alpha,
    };
    compare(py, observed, rendered, float_render, |o, r| fuse_evidence::ssnr::geometric_uncertainty(o, r, &options))
}

/// Semantic map; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (masks, scores, normalize))]
fn semantic_map<'py>(
    py: Python<'py>,
    masks: &Bound<'py, PyAny>,
    scores: &Bound<'py, PyAny>,
    normalize: bool,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let masks = array::view::<bool>("masks", masks, 3, "(N, H, W) bool")?;
    let scores = array::view::<f32>("scores", scores, 1, "(N,) float32")?;
    let (height, width) = (masks.shape()[1], masks.shape()[2]);
    let each: Vec<&[bool]> = flat("masks", &masks)?.chunks_exact((height * width).max(1)).collect();
    let scores = flat("scores", &scores)?;
    let result = enter(py, || semantic::semantic_map(width as u32, height as u32, &each, scores, normalize))?;
    map(py, result)
}

/// Two `(H, W)` float32 maps into one, without the GIL.
fn combine<'py>(
    py: Python<'py>,
    semantic: &Bound<'py, PyAny>,
    geometric: &Bound<'py, PyAny>,
    work: impl FnOnce(View<'_, f32>, View<'_, f32>) -> Result<Buffer<f32>, EvidenceError> + Send,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let semantic = array::view::<f32>("semantic", semantic, 2, "(H, W) float32")?;
    let geometric = array::view::<f32>("geometric", geometric, 2, "(H, W) float32")?;
    let (s, g) = (image("semantic", &semantic)?, image("geometric", &geometric)?);
    let result = enter(py, || work(s, g))?;
    map(py, result)
}

/// Evidence map; documented in `fuse_grounding.evidence` as `fuse`.
#[pyfunction]
#[pyo3(signature = (semantic, geometric, semantic_weight, geometric_weight))]
fn fuse_maps<'py>(
    py: Python<'py>,
    semantic: &Bound<'py, PyAny>,
    geometric: &Bound<'py, PyAny>,
    semantic_weight: f32,
    geometric_weight: f32,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    combine(py, semantic, geometric, |s, g| fusion::fuse_views(s, g, semantic_weight, geometric_weight))
}

/// Functional uncertainty; documented in `fuse_grounding.evidence`.
#[pyfunction]
fn functional_uncertainty<'py>(
    py: Python<'py>,
    semantic: &Bound<'py, PyAny>,
    geometric: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    combine(py, semantic, geometric, fusion::functional_uncertainty)
}

/// Regions of all actions; documented in `fuse_grounding.evidence` as `regions`.
#[pyfunction]
#[pyo3(signature = (height, width, coupled))]
fn action_regions<'py>(
    py: Python<'py>,
    height: u32,
    width: u32,
    coupled: &str,
) -> PyResult<Bound<'py, PyArray3<bool>>> {
    let coupled = coupled_option(coupled)?;
    let mut masks = Vec::with_capacity(ACTION_COUNT * height as usize * width as usize);
    for action in Action::all() {
        masks.extend(checked(regions::region(width, height, action, coupled))?);
    }
    array::into_3d(py, masks, height, ACTION_COUNT as u32, width as usize)
}

/// Scores of all actions; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (evidence, coupled))]
fn action_scores<'py>(
    py: Python<'py>,
    evidence: &Bound<'py, PyAny>,
    coupled: &str,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let coupled = coupled_option(coupled)?;
    let evidence = array::view::<f32>("evidence", evidence, 2, "(H, W) float32")?;
    let view = image("evidence", &evidence)?;
    let scores = enter(py, || regions::action_scores(view, coupled))?;
    Ok(scores.to_vec().into_pyarray(py))
}

/// `(15,)` elements.
fn per_action<'a, T: Copy + numpy::Element>(
    name: &'static str,
    array: &'a PyReadonlyArrayDyn<'_, T>,
) -> PyResult<&'a [T; ACTION_COUNT]> {
    let values = flat(name, array)?;
    values.try_into().map_err(|_| input(format!("{name} must have {ACTION_COUNT} elements, found {}", values.len())))
}

/// The action to take; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (scores, mask, stride, noop))]
fn choose_action(scores: &Bound<'_, PyAny>, mask: &Bound<'_, PyAny>, stride: &str, noop: bool) -> PyResult<usize> {
    let stride = option("stride", stride, &[("one", Stride::One), ("two", Stride::Two)])?;
    let scores = array::view::<f32>("scores", scores, 1, "(15,) float32")?;
    let mask = array::view::<bool>("mask", mask, 1, "(15,) bool")?;
    let action = regions::choose(per_action("scores", &scores)?, per_action("mask", &mask)?, stride, noop);
    checked(action).map(Action::index)
}

/// Entropy of a planner's choice; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (values, temperature, mask))]
fn action_entropy(values: &Bound<'_, PyAny>, temperature: f32, mask: Option<&Bound<'_, PyAny>>) -> PyResult<f32> {
    let values = array::view::<f32>("values", values, 1, "(N,) float32")?;
    let mask = mask.map(|m| array::view::<bool>("mask", m, 1, "(N,) bool")).transpose()?;
    let mask = mask.as_ref().map(|m| flat("mask", m)).transpose()?;
    checked(gate::action_entropy(flat("values", &values)?, temperature, mask))
}

/// Proximity of a region; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (depth, mask, near, far, min_pixels))]
fn depth_proximity(
    py: Python<'_>,
    depth: &Bound<'_, PyAny>,
    mask: &Bound<'_, PyAny>,
    near: f64,
    far: f64,
    min_pixels: usize,
) -> PyResult<f32> {
    let range = checked(DepthRange::new(near, far))?;
    let depth = array::view::<f32>("depth", depth, 2, "(H, W) float32")?;
    let mask = array::view::<bool>("mask", mask, 2, "(H, W) bool")?;
    let (depth, mask) = (image("depth", &depth)?, image("mask", &mask)?);
    let region = enter(py, || region_depth(depth, mask))?;
    Ok(if region.is_valid(min_pixels) { range.proximity(&region) } else { 0.0 })
}

/// Grounding score of a region; documented in `fuse_grounding.evidence`.
#[pyfunction]
#[pyo3(signature = (score, proximity, pixels, weights, min_pixels))]
fn grounding_score(
    score: f32,
    proximity: Option<f32>,
    pixels: usize,
    weights: (f32, f32),
    min_pixels: usize,
) -> PyResult<Option<f32>> {
    let options = GroundingOptions { semantic_weight: weights.0, depth_weight: weights.1, min_region_px: min_pixels };
    checked(grounding::grounding_score(score, proximity, pixels, &options))
}

/// Counts observations in a row that bring nothing better (Algorithm 1: r_best, k_fail).
///
/// Patience(k=5)
///
/// k: observations without strict improvement after which to stop, at least 1 (the paper's K).
#[pyclass(module = "fuse_grounding")]
pub struct Patience {
    inner: patience::Patience,
}

#[pymethods]
impl Patience {
    #[new]
    #[pyo3(signature = (k = 5))]
    fn new(k: i64) -> PyResult<Self> {
        let k = u32::try_from(k)
            .map_err(|_| input(format!("k must be a whole number from 1 to {}, found {k}", u32::MAX)))?;
        Ok(Self { inner: checked(patience::Patience::new(k))? })
    }

    /// Takes in the score of the next observation, None when nothing in it could be scored.
    ///
    /// Returns whether it is strictly better than all before. An equal or missing score counts
    /// against patience. Raises InputError for NaN and infinities, and then counts nothing.
    #[pyo3(signature = (score, /))]
    fn observe(&mut self, score: Option<f64>) -> PyResult<bool> {
        checked(self.inner.observe(score))
    }

    /// Whether k observations in a row brought nothing better.
    #[getter]
    fn exhausted(&self) -> bool {
        self.inner.exhausted()
    }

    /// The best score so far, None before the first.
    #[getter]
    fn best(&self) -> Option<f64> {
        self.inner.best()
    }

    /// Observations since the best one.
    #[getter]
    fn failures(&self) -> u32 {
        self.inner.failures()
    }

    /// The limit.
    #[getter]
    fn k(&self) -> u32 {
        self.inner.limit()
    }

    fn __repr__(&self) -> String {
        let best = self.inner.best().map_or_else(|| "None".into(), |b| format!("{b:.4}"));
        format!("Patience(k={}, failures={}, best={best})", self.inner.limit(), self.inner.failures())
    }
}
