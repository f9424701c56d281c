//! The GPU twin of `cpu.rs`: WGSL compute shaders through wgpu.

#[doc(hidden)]
pub mod shaders;
