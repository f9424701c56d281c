//! The one door into Rust: releases the GIL, keeps panics on this side.

use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::prelude::*;

use crate::error::raise;

/// Runs `work` without the GIL; its error becomes an exception (see [`raise`]), a panic a `FuseError`-less
/// `RuntimeError` that asks for a report.
pub fn enter<T: Send, E: std::fmt::Display + Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, E> + Send,
) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_or_else(
        |panic| {
            let text = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("no message");
            Err(pyo3::exceptions::PyRuntimeError::new_err(format!(
                "a bug in fuse's native code, please report it: {text}"
            )))
        },
        |result| result.map_err(|e| raise(&e)),
    )
}
