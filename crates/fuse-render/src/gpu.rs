//! The GPU twin of `cpu.rs`: the same scene through wgpu, with the feature `gpu`.
//!
//! | stage | shader |
//! | --- | --- |
//! | transform and raster, once a sample | `raster.wgsl` |
//! | depth and id at the pixel centre | `centers.wgsl` (with `geometry.wgsl`) |
//! | shade | `pixels.wgsl` (with `geometry.wgsl`, `texture.wgsl`, `shadow.wgsl`, `shadow/baked.wgsl`, `occlusion.wgsl`, `shade.wgsl`, `light.wgsl`) |
//! | count of amodal pixels | `count.wgsl` |
//!
//! What does not depend on the camera (world-space triangles, mip chains, shadow maps and baked shares
//! of the lamp, ambient occlusion) is made by the CPU, so that both backends read the same numbers, and uploaded once.
//! Visibility is the GPU's own rasteriser's, whose edges are fixed-point: pixels on an edge may fall on
//! its other side. Depth is not read from the depth buffer but from the triangle's plane.
//! WebGPU's default limits; no optional feature.

#[cfg(feature = "gpu")]
mod choice;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod memory;
#[cfg(feature = "gpu")]
mod render;
#[doc(hidden)]
pub mod shaders;
#[cfg(feature = "gpu")]
mod upload;
#[cfg(feature = "gpu")]
mod view;

#[cfg(feature = "gpu")]
pub use choice::{Backend, Choice};
#[cfg(feature = "gpu")]
pub use device::Device;
#[cfg(feature = "gpu")]
pub use render::{GpuRenderer, RenderError};
