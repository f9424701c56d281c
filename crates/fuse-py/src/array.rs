//! NumPy in: checked for shape, dtype and finiteness, borrowed without a copy where contiguous.
//! NumPy out: the Rust vector becomes the array's memory.

use fuse_evidence::recycle;
use numpy::ndarray::{Array2, Array3, ArrayView, Dimension, Ix2};
use numpy::{
    Element, IntoPyArray, PyArray, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::PyClass;
use pyo3::prelude::*;
use pyo3::pyclass::boolean_struct::True;

use crate::error::input;

/// What an argument turned out to be, for messages.
fn describe(value: &Bound<'_, PyAny>) -> String {
    match value.cast::<PyUntypedArray>() {
        Ok(a) => {
            let shape: Vec<String> = a.shape().iter().map(ToString::to_string).collect();
            format!("{} array of shape ({})", a.dtype(), shape.join(", "))
        }
        Err(_) => value.get_type().name().map_or_else(|_| "something else".into(), |n| n.to_string()),
    }
}

/// A C-contiguous read-only view of `value` with element type `T` and the given number of axes.
///
/// `expected` says in words what the argument should be, for example `"(H, W, 3) uint8"`.
/// A non-contiguous array is copied once.
///
/// # Errors
/// `InputError` that names the argument, what was found and what was expected.
pub fn view<'py, T: Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    axes: usize,
    expected: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let wrong = || input(format!("{name} must be a {expected} array, found {}", describe(value)));
    let array = value.cast::<PyArrayDyn<T>>().map_err(|_| wrong())?;
    if array.ndim() != axes {
        return Err(wrong());
    }
    if array.is_c_contiguous() {
        return array.try_readonly().map_err(|_| input(format!("{name} is being written to elsewhere")));
    }
    let copy = value.py().import("numpy")?.call_method1("ascontiguousarray", (value,))?;
    copy.cast::<PyArrayDyn<T>>().map_err(|_| wrong())?.try_readonly().map_err(|_| wrong())
}

/// Anything that NumPy takes for float64 of the given shape.
///
/// # Errors
/// `InputError` that names the argument, what was found and what was expected.
pub fn floats<'py>(name: &str, value: &Bound<'py, PyAny>, shape: &[usize]) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    let wrong = || input(format!("{name} must be numbers of shape {shape:?}, found {}", describe(value)));
    let array = value.py().import("numpy")?.call_method1("asarray", (value, "float64")).map_err(|_| wrong())?;
    let array = array.cast::<PyArrayDyn<f64>>().map_err(|_| wrong())?;
    if array.shape() != shape {
        return Err(wrong());
    }
    array.try_readonly().map_err(|_| input(format!("{name} is being written to elsewhere")))
}

/// A whole number that is not negative.
///
/// # Errors
/// `InputError` that names the argument and what was found.
pub fn whole(name: &str, value: &Bound<'_, PyAny>) -> PyResult<u32> {
    value.extract::<u32>().map_err(|_| match value.repr() {
        Ok(found) => input(format!("{name} must be a whole number from 0 to {}, found {found}", u32::MAX)),
        Err(e) => e,
    })
}

/// An `(H, W, 3)` uint8 image as pixels with its size `(width, height)`.
pub fn rgb<'a>(name: &str, array: &'a PyReadonlyArrayDyn<'_, u8>) -> PyResult<(&'a [[u8; 3]], u32, u32)> {
    let shape = array.shape();
    if shape.len() != 3 || shape[2] != 3 || shape[0] == 0 || shape[1] == 0 {
        return Err(input(format!("{name} must be a (H, W, 3) uint8 array with H, W > 0, found shape {shape:?}")));
    }
    let flat = array.as_slice().map_err(|_| input(format!("{name} must be contiguous")))?;
    Ok((flat.as_chunks().0, shape[1] as u32, shape[0] as u32))
}

/// Refuses NaN and infinities.
pub fn finite(name: &str, values: &[f32]) -> PyResult<()> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(i) => Err(input(format!("{name} must be finite, found {} at flat index {i}", values[i]))),
    }
}

/// A row-major `(height, width)` vector as a NumPy array, without a copy.
pub fn into_2d<T: Element>(py: Python<'_>, data: Vec<T>, width: u32, height: u32) -> PyResult<Bound<'_, PyArray2<T>>> {
    let array = Array2::from_shape_vec((height as usize, width as usize), data)
        .map_err(|e| input(format!("internal image size mismatch: {e}")))?;
    Ok(array.into_pyarray(py))
}

/// Memory of an array that goes back to `fuse_evidence::recycle` with the array.
#[pyclass(frozen, module = "fuse_grounding._core")]
struct Lent {
    data: Array2<f32>,
}

impl Drop for Lent {
    fn drop(&mut self) {
        recycle::give(std::mem::take(&mut self.data).into_raw_vec_and_offset().0);
    }
}

/// As [`into_2d`]; the memory is used again once the array, and every view of it, is gone.
pub fn lend_2d(py: Python<'_>, data: Vec<f32>, width: u32, height: u32) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let data = Array2::from_shape_vec((height as usize, width as usize), data)
        .map_err(|e| input(format!("internal image size mismatch: {e}")))?;
    lend(&Bound::new(py, Lent { data })?)
}

/// A Python object whose numbers arrays may show.
pub trait Lender: PyClass<Frozen = True> + Sync {
    /// Number of axes.
    type Axes: Dimension;
    /// Its numbers; they never change.
    fn numbers(&self) -> PyResult<ArrayView<'_, f32, Self::Axes>>;
}

impl Lender for Lent {
    type Axes = Ix2;
    fn numbers(&self) -> PyResult<ArrayView<'_, f32, Ix2>> {
        Ok(self.data.view())
    }
}

/// An array of memory that `owner` holds.
pub fn lend<'py, L: Lender>(owner: &Bound<'py, L>) -> PyResult<Bound<'py, PyArray<f32, L::Axes>>> {
    let view = owner.get().numbers()?;
    // SAFETY: the array keeps its owner alive, which is frozen: the memory neither moves nor is
    // reached in another way while the array lives.
    Ok(unsafe { PyArray::borrow_from_array(&view, owner.clone().into_any()) })
}

/// A row-major `(height, width, channels)` vector as a NumPy array, without a copy.
pub fn into_3d<T: Element>(
    py: Python<'_>,
    data: Vec<T>,
    width: u32,
    height: u32,
    channels: usize,
) -> PyResult<Bound<'_, PyArray3<T>>> {
    let array = Array3::from_shape_vec((height as usize, width as usize, channels), data)
        .map_err(|e| input(format!("internal image size mismatch: {e}")))?;
    Ok(array.into_pyarray(py))
}
