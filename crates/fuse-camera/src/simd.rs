//! Which vector instructions the kernels use: chosen once at run time, recorded with results.
//!
//! Results are bit-identical for any number of threads at one level; two levels agree within
//! the kernels' stated tolerances (fused multiply-add rounds once, not twice).

mod lanes;
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::sync::OnceLock;

pub use lanes::{F32x8, Floats, I32x8, Kernel, WideKernel, dispatch, dispatch_wide, prefetch};

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Whatever the build target guarantees (SSE2 on x86-64, NEON on arm64).
    #[default]
    Portable,
    /// AVX2 and FMA.
    Avx2Fma,
    /// AVX-512 (F, VL, BW, DQ): sixteen lanes where a kernel is made for them, and twice the
    /// registers for the others, which then compute the same bits as with AVX2.
    Avx512,
}

impl Level {
    /// The name that is written into results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2Fma => "avx2+fma",
            Self::Avx512 => "avx512",
        }
    }
}

/// The level in use: the machine's best, or less where the environment variable `FUSE_SIMD` names
/// another (`portable`, `avx2+fma`), so that two machines give the same bits. Decided at the first
/// call.
pub fn level() -> Level {
    static LEVEL: OnceLock<Level> = OnceLock::new();
    *LEVEL.get_or_init(|| {
        let wanted = std::env::var("FUSE_SIMD");
        let named = [Level::Portable, Level::Avx2Fma].into_iter().find(|l| Ok(l.name()) == wanted.as_deref());
        named.map_or_else(best, |l| l.min(best()))
    })
}

/// The best level that this machine has.
pub fn best() -> Level {
    static BEST: OnceLock<Level> = OnceLock::new();
    *BEST.get_or_init(detect)
}

#[cfg(target_arch = "x86_64")]
fn detect() -> Level {
    use std::is_x86_feature_detected as has;
    if !(has!("avx2") && has!("fma")) {
        Level::Portable
    } else if has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq") {
        Level::Avx512
    } else {
        Level::Avx2Fma
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn detect() -> Level {
    Level::Portable
}
