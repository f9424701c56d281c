//! The GPU twin of `cpu.rs`: compute shaders through wgpu, with the feature `gpu`.
//!
//! | stage | shaders |
//! | --- | --- |
//! | `project` | `project.wgsl` (with `geometry.wgsl`, `sh.wgsl`) |
//! | `sort` | `sort.wgsl`, `scan.wgsl` |
//! | `intersect` | `intersect.wgsl`, then `sort.wgsl` by tile |
//! | `rasterize` | `rasterize.wgsl` (with `tile.wgsl`) |
//! | `loss` | `loss.wgsl` |
//! | `rasterize_backward` | `rasterize_backward.wgsl` (with `tile.wgsl`) |
//! | `project_backward` | `project_backward.wgsl` (with `geometry.wgsl`, `sh.wgsl`) |
//! | `adam` | `adam.wgsl` |
//!
//! Stages, arrays and order of summation are those of the CPU: no float atomics, no subgroups,
//! WebGPU's default limits. The same adapter gives the same bits again; two adapters, or an adapter
//! and the CPU, round differently.

#[cfg(feature = "gpu")]
mod arrays;
#[cfg(feature = "gpu")]
mod choice;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod engine;
#[cfg(feature = "gpu")]
mod memory;
#[cfg(feature = "gpu")]
mod passes;
#[cfg(feature = "gpu")]
mod pipeline;
#[cfg(feature = "gpu")]
mod render;
#[doc(hidden)]
pub mod shaders;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub mod twins;

#[cfg(feature = "gpu")]
pub use choice::Choice;
#[cfg(feature = "gpu")]
pub use device::Device;
#[cfg(feature = "gpu")]
pub(crate) use engine::Engine;
#[cfg(feature = "gpu")]
pub(crate) use pipeline::Settings;
#[cfg(feature = "gpu")]
pub use render::{loss_gradient, render};
