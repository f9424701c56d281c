//! What can go wrong that the caller can put right.

/// A file or an argument is not what was expected; the message names it.
#[derive(Debug, thiserror::Error)]
pub enum SplatError {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{path}: {what}")]
    File {
        /// The file.
        path: String,
        /// What was found and what was expected.
        what: String,
    },
    /// An argument is out of range.
    #[error("{0}")]
    Input(String),
    /// There is no GPU, or it failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] fuse_camera::gpu::GpuError),
}

impl SplatError {
    /// Whether the machine failed, and nothing that the caller could put right was wrong.
    pub fn is_failure(&self) -> bool {
        #[cfg(feature = "gpu")]
        if let Self::Gpu(e) = self {
            return e.is_failure();
        }
        false
    }

    pub(crate) fn io(path: &std::path::Path, source: std::io::Error) -> Self {
        Self::Io { path: path.display().to_string(), source }
    }

    pub(crate) fn file(path: &std::path::Path, what: impl Into<String>) -> Self {
        Self::File { path: path.display().to_string(), what: what.into() }
    }
}
