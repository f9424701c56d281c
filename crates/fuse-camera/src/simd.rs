//! Which vector instructions the kernels use: chosen once at run time, recorded with results.
//!
//! Results are bit-identical for any number of threads at one level; two levels agree within
//! the kernels' stated tolerances (fused multiply-add rounds once, not twice).

use std::sync::OnceLock;

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Whatever the build target guarantees (SSE2 on x86-64, NEON on arm64).
    #[default]
    Portable,
    /// AVX2 and FMA.
    Avx2Fma,
}

impl Level {
    /// The name that is written into results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2Fma => "avx2+fma",
        }
    }
}

/// The level in use: the machine's best, or `portable` when the environment variable
/// `FUSE_SIMD=portable` asks for it. Decided at the first call.
pub fn level() -> Level {
    static LEVEL: OnceLock<Level> = OnceLock::new();
    *LEVEL.get_or_init(|| match std::env::var("FUSE_SIMD").as_deref() {
        Ok("portable") => Level::Portable,
        _ => best(),
    })
}

/// The best level that this machine has.
pub fn best() -> Level {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
        return Level::Avx2Fma;
    }
    Level::Portable
}
